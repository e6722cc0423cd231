"""Predictions under a default law: adjoints, insertion gradients, and where laws do not go."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from capsyn import Box, Policy, Problem, SsacSettings, synthesize
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import bind_default
from capsyn.controllers.ssac import policy_controller
from capsyn.modelling.transcription import transcribe
from capsyn.synthesis.synthesize import problem_controller
from support.backends import backends
from support.processes.command_line import capsyn, error_of

STEPS = 6


def random_problem(seed, n, told, terms=4):
    """Return a problem of random polynomials and waves, of n states and a law of them and w.

    Rates, costs and law are sums of random terms, of sizes for which a horizon of 1 is not stiff.
    """
    rng, m = np.random.default_rng([5, seed]), int(1 + seed % 2)
    k = told

    def sums(count, size, quiet=False):
        """Return `count` sums of random terms of `size` variables."""
        draw = [
            [
                (
                    rng.uniform(-1, 1),
                    *rng.integers(0, size, 2),
                    rng.integers(4),
                    rng.uniform(0.5, 2),
                )
                for _ in range(terms)
            ]
            for _ in range(count)
        ]

        def of(z):
            totals = []
            for row in draw:
                total = 0
                for factor, i, j, kind, pace in row:
                    one = (z[i], z[i] * z[j], ca.sin(pace * z[i]), ca.cos(pace * z[i] + z[j]))
                    total += factor * one[kind]
                totals.append(total)
            return totals

        return of

    f, running, terminal = sums(n, n + m + k), sums(1, n + k), sums(1, n + k)
    law = sums(m, n + k)
    arguments = {
        "dynamics": lambda x, u, *w: f(ca.vertcat(x, u, *w)),
        "running_cost": lambda x, *w: running(ca.vertcat(x, *w))[0] + ca.sumsqr(x),
        "terminal_cost": lambda x, *w: terminal(ca.vertcat(x, *w))[0] + ca.sumsqr(x),
        "default": lambda x, *w: law(ca.vertcat(x, *w)),
    }
    values = rng.uniform(-1, 1, (3, m))
    return Problem(
        name="random",
        domain=Box([-1] * n, [1] * n),
        exogenous=None if not k else Box([-1] * k, [1] * k),
        alphabet=values,
        horizon=0.5,
        settings=SsacSettings(steps=STEPS),
        **arguments,
    )


def costs(problem, count):
    """Return what gives the costs (B,) of readings (n + k, B) by Runge-Kutta steps under the law.

    With `first` and a `time`, that symbol's control acts for so long before, over one step.
    """
    maps = {name: function.map(count) for name, function in problem.functions().items()}

    def rates(z, u=None):
        u = maps["default"](z) if u is None else np.tile(u[:, None], count)
        return maps["dynamics"](z, u).full(), maps["running_cost"](z).full()[0]

    def step(z, total, h, u=None):
        k1, c1 = rates(z, u)
        k2, c2 = rates(z + h / 2 * k1, u)
        k3, c3 = rates(z + h / 2 * k2, u)
        k4, c4 = rates(z + h * k3, u)
        total = total + h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
        return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), total

    def cost(z, first=None, time=0.0, steps=STEPS):
        total, rest = np.zeros(count), problem.horizon
        if first is not None:
            z, total = step(z, total, time, problem.alphabet.values[first])
            rest -= time
        for _ in range(steps):
            z, total = step(z, total, rest / steps)
        return total + maps["terminal_cost"](z).full()[0]

    return cost


def predicted(problem, backend="numpy", **changes):
    """Return the controller of a problem, with some settings replaced."""
    problem = problem.replace(settings=dataclasses.replace(problem.settings, **changes))
    return problem_controller(problem, transcribe(problem), backend)


def adjoint_of(controller, z):
    """Return the adjoint (n + k, B) at t0 of the programs that a controller solves with."""
    formulation = controller.formulation
    model = bind_default(formulation.model, formulation.default)
    dt, path = [formulation.horizon / STEPS], [z]
    for _ in range(STEPS):
        path.append(model.step.evaluate(path[-1], dt)[0])
    rho = model.terminal_cost.evaluate(path[-1])[1]
    for state in reversed(path[:-1]):
        (rho,) = model.adjoint.evaluate(state, dt, rho)
    return np.broadcast_to(rho, z.shape)


CASES = st.tuples(st.integers(0, 10**6), st.integers(1, 5), st.integers(0, 2))


@settings(max_examples=25, deadline=None)
@given(CASES)
def test_the_adjoint_is_the_gradient_of_the_discretised_cost(case):
    problem = random_problem(*case)
    n, z = problem.domain.n, problem.space.sample(4, 1).T
    cost = costs(problem, 4)
    controller = predicted(problem)
    solution = controller.solve(np.ascontiguousarray(z.T))
    assert np.allclose(solution.cost, cost(z), rtol=1e-12)
    rho, wanted = adjoint_of(controller, z), np.zeros((n, 4))
    for i in range(n):  # fourth order: errors of 1e-8 and of rounding
        for weight, far in ((8, 1), (-1, 2)):
            h = np.zeros((problem.space.n, 1))
            h[i] = far * 1e-5
            wanted[i] += weight * (cost(z + h) - cost(z - h)) / 12e-5
    size = np.linalg.norm(wanted, axis=0) + 1e-3 * np.abs(solution.cost)
    calm = np.abs(solution.cost) < 1e9  # differences say little where the cost explodes
    assume(calm.any())
    assert (np.abs(rho[:n] - wanted) <= 1e-7 * size)[:, calm].all()
    assert not rho[n:].any()


@settings(max_examples=10, deadline=None)
@given(CASES)
def test_insertion_gradients_are_those_of_short_actions(case):
    problem, many = random_problem(*case), 96
    cost = costs(problem, 3)
    z = problem.space.sample(3, 2).T
    controller = predicted(problem, steps=many)
    solution = controller.solve(np.ascontiguousarray(z.T))
    for symbol in range(len(problem.alphabet)):
        # (J(t) - J(0)) / t of duration t, extrapolated to 0
        durations = 1e-4 * np.array([1.0, 2.0, 4.0])
        start = cost(z, steps=many)
        one, two, four = ((cost(z, symbol, t, many) - start) / t for t in durations)
        wanted = (8 * one - 6 * two + four) / 3
        size = np.linalg.norm(solution.gradients, axis=1) + 1e-2 * np.abs(solution.cost)
        assert (np.abs(solution.gradients[:, symbol] - wanted) <= 2e-6 * size).all()


def test_a_law_is_followed_at_every_instant():
    """``x' = u`` under ``u = -2 x``: ``x = x0 exp(-2 t)``, ``J0 = x0^2 (1 - exp(-4 T)) / 4``."""
    problem = Problem(
        name="decay",
        dynamics=lambda x, u: u,
        domain=Box([-1], [1]),
        alphabet=[-1, 1],
        default=lambda x: -2 * x,
        horizon=1.5,
        running_cost=lambda x: x[0] ** 2,
        settings=SsacSettings(steps=200),
    )
    x = np.array([[0.3], [-0.8]])
    solution = predicted(problem).solve(x)
    share = (1 - np.exp(-6)) / 4
    assert np.allclose(solution.cost, share * x[:, 0] ** 2, rtol=1e-9)
    wanted = 2 * share * x * (np.array([[-1.0, 1.0]]) + 2 * x)  # rho (u - law(x))
    assert np.allclose(solution.gradients, wanted, rtol=1e-8)


def test_costs_under_a_saturated_law_are_those_of_an_accurate_integration():
    problem = random_problem(4, 2, 1).replace(
        default=lambda x, w: [ca.fmin(ca.fmax(-3 * x[0] - w[0], -0.5), 0.5)],
        alphabet=[-1.0, 0.0, 1.0],
    )
    z, functions = problem.space.sample(5, 3), problem.functions()
    found = predicted(problem, steps=400).solve(z).cost

    def slope(t, y):
        u = functions["default"](y[:3])
        return [
            *functions["dynamics"](y[:3], u).full()[:, 0],
            float(functions["running_cost"](y[:3])),
        ]

    for row, cost in zip(z, found):
        end = solve_ivp(slope, (0, problem.horizon), [*row, 0.0], rtol=1e-9, atol=1e-11).y[:, -1]
        assert cost == pytest.approx(end[3] + float(functions["terminal_cost"](end[:3])), rel=1e-5)


@backends
@pytest.mark.parametrize(("n", "told"), [(1, 0), (2, 2), (4, 1)])
def test_a_constant_law_is_the_constant(n, told, backend):
    law = random_problem(7, n, told)
    constant = np.linspace(-0.4, 0.7, law.alphabet.m)
    law = law.replace(default=lambda *_: list(constant))
    plain, z = law.replace(default=constant), law.space.sample(500)
    assert law.has_law and np.array_equal(law.default_control, plain.default_control)
    one, two = (predicted(problem, backend).solve(z) for problem in (law, plain))
    for name in ("cost", "gradients", "scales"):
        found, wanted = getattr(one, name), getattr(two, name)
        assert (np.abs(found - wanted) <= 1e-12 * np.abs(two.scales).max()).all()
    masks = [predicted(problem, backend).masks(z) for problem in (law, plain)]
    assert np.array_equal(*masks)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("case", range(4))
def test_backends_agree(case, precision):
    problem = random_problem(case, 1 + case, case % 3)
    z = problem.space.sample(300, 4)
    one, two = (predicted(problem, b, precision=precision).solve(z) for b in ("c", "numpy"))
    rounding = 1e-13 if precision == "double" else 2e-5
    assert np.allclose(one.cost, two.cost, rtol=rounding * 10, atol=rounding)
    assert (np.abs(one.gradients - two.gradients) <= rounding * 100 * (1 + two.scales)).all()
    exact = predicted(problem, "numpy").solve(z)
    assert (np.abs(one.gradients - exact.gradients) <= 1e-3 * (1e-2 + exact.scales)).all()


def test_formulations_with_a_law_are_told_to_other_processes():
    problem = random_problem(3, 3, 1)
    formulation = Formulation.of(problem, transcribe(problem))
    again = Formulation.from_text(formulation.to_text())
    assert again.model == formulation.model and again.model.prediction is not None
    assert again.to_text() == formulation.to_text()


def test_the_model_of_a_law_is_in_the_file_and_decides_there(tmp_path):
    problem = random_problem(8, 2, 1).replace(partitions=3, max_level=1)
    policy = synthesize(problem)
    policy.save(tmp_path / "law.cap")
    again = Policy.load(tmp_path / "law.cap")
    assert again.model == policy.model and again.model.prediction is not None
    z = problem.space.sample(200)
    one, two = problem_controller(problem, policy.model), policy_controller(again)
    assert np.array_equal(one.masks(z), two.masks(z))


ROOM = """
import capsyn
problem = capsyn.Problem(
    name="room", dynamics=lambda x, u, w: [(w[0] - x[0]) / 300 - 0.05 * u[0]],
    domain=capsyn.Box([18], [28]), exogenous=capsyn.Box([20], [38], names=["outdoor"]),
    alphabet=[0, 1, 2], default=lambda x, w: [0.1 * (x[0] - 22)], horizon=20.0,
    running_cost=lambda x, w: (x[0] - 22) ** 2, partitions=3, max_level=1,
)
"""


def test_a_default_on_the_command_line_takes_the_place_of_a_law(tmp_path):
    (tmp_path / "room.py").write_text(ROOM)
    synth = ("synth", "room.py:problem", "--max-level", "0")
    capsyn(*synth, "-o", "law.cap", cwd=tmp_path)
    capsyn(*synth, "--default", "0.5", "-o", "constant.cap", cwd=tmp_path)
    law, constant = (Policy.load(tmp_path / f"{name}.cap") for name in ("law", "constant"))
    assert law.model.prediction is not None and law.default.tolist() == [0.1 * (23 - 22)]
    assert constant.model.prediction is None and constant.default.tolist() == [0.5]
    to_default = ("synth", "room.py:problem", "--on-no-descent", "default", "-o", "x.cap")
    assert "`on_no_descent` must be 'best' where" in error_of(*to_default, cwd=tmp_path)
    loop = ("simulate", "law.cap", "--x0", "25", "--exogenous", "outdoor=30", "--online", "ssac")
    assert "`default` must be given, a constant or a policy" in error_of(*loop, cwd=tmp_path)
    capsyn(*loop, "--background", "--duration", "2", cwd=tmp_path)
