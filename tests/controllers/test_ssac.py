"""Batch sSAC: kernel, NumPy and a plain reference agree; oracles; masks; steps."""

from __future__ import annotations

import dataclasses
import itertools

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from capsyn import Box, Problem, SsacSettings, problems, synthesize
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import ROUNDING, TIE
from capsyn.controllers.ssac import BatchController, Solution
from capsyn.controllers.steps import STEP_LADDER, STEP_SAMPLES
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.modelling.transcription import transcribe
from capsyn.problems import cart_pendulum, double_tank
from capsyn.synthesis.synthesize import problem_controller
from support.references import ssac as reference

BACKENDS = ["c", "numpy"]


def controller(problem: Problem, backend: str = "c", **changes) -> BatchController:
    """Return the controller of a problem, with some settings replaced."""
    problem = problem.replace(settings=dataclasses.replace(problem.settings, **changes))
    return problem_controller(problem, transcribe(problem), backend)


CASES = {
    "cart-pendulum": problems.plain("cart-pendulum"),
    "cart-pendulum-4, pushed": problems.plain("cart-pendulum-4").replace(default=1.5),
    "double-tank-a": problems.plain("double-tank-a"),
    "double-tank-b, open": problems.plain("double-tank-b").replace(default=[0.5, 0.2, 1.0]),
    "cart-pole": problems.plain("cart-pole"),
}


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("case", CASES)
def test_solves_are_those_of_the_reference(case, backend):
    problem, states = CASES[case], CASES[case].domain.sample(8, seed=1)
    batch = controller(problem, backend, steps=9)
    solution = batch.solve(states)
    scores, symbols = batch.scores(solution), batch.symbols(states)
    rounding = ROUNDING * np.finfo(float).eps / TIE
    for k, state in enumerate(states):
        result = reference.solve(problem, state, 9, rounding)
        assert solution.cost[k] == pytest.approx(result.cost, rel=1e-11)
        assert np.all(np.abs(solution.gradients[k] - result.gradients) <= 1e-11 * result.scales)
        np.testing.assert_allclose(solution.scales[k], result.scales, rtol=1e-11)
        wanted = reference.scores(problem, result)
        np.testing.assert_allclose(scores[k], wanted, atol=1e-10 * np.abs(wanted).max())
        assert symbols[k] == np.argmin(wanted)


@pytest.mark.parametrize("case", CASES)
def test_backends_agree_at_many_states(case):
    states = CASES[case].domain.sample(3000, seed=2)
    one, two = (controller(CASES[case], backend, steps=16).solve(states) for backend in BACKENDS)
    np.testing.assert_allclose(one.cost, two.cost, rtol=1e-11)
    assert np.all(np.abs(one.gradients - two.gradients) <= 1e-11 * two.scales)
    np.testing.assert_allclose(one.scales, two.scales, rtol=1e-9)


@st.composite
def smooth_problems(draw):
    """Return a random smooth problem with one input per state, whose gradients are the adjoint."""
    n = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    a, b, q = rng.normal(size=(n, n)) / n, rng.normal(size=(n, n)), rng.normal(size=(n, n))
    shift, default = rng.normal(size=n), rng.normal(size=n)
    bend = draw(st.sampled_from([ca.sin, ca.tanh, lambda v: v / (1 + v**2), ca.atan]))
    return Problem(
        name="smooth",
        dynamics=lambda x, u: ca.mtimes(a, bend(ca.mtimes(b, x) + shift)) + u,
        domain=Box(-np.ones(n), np.ones(n)),
        alphabet=np.eye(n) + default,
        default=default,
        horizon=draw(st.floats(0.1, 2.0)),
        running_cost=lambda x: ca.sumsqr(ca.sin(ca.mtimes(q, x))) + 0.1 * ca.exp(x[0]),
        terminal_cost=lambda x: ca.sumsqr(x - shift),
    )


@settings(max_examples=40, deadline=None, derandomize=True)
@given(smooth_problems())
def test_the_adjoint_is_the_gradient_of_the_cost(problem):
    check_adjoint(problem, "numpy")


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_adjoint_of_the_pendulum_with_full_actuation(backend):
    pendulum = problems.plain("cart-pendulum")
    full = pendulum.replace(
        dynamics=lambda x, u: [
            x[1] + u[0],
            cart_pendulum.GRAVITY / cart_pendulum.LENGTH * ca.sin(x[0]) + u[1],
        ],
        alphabet=[[1.0, 0.0], [0.0, 1.0]],
        default=[0.0, 0.0],
        running_cost=lambda x: ca.cos(x[0]) * x[1],
    )
    check_adjoint(full, backend)


def check_adjoint(problem: Problem, backend: str) -> None:
    n, delta = problem.domain.n, 1e-5
    batch, states = controller(problem, backend, steps=12), problem.domain.sample(5, seed=3)
    moves = delta * np.vstack([np.zeros(n), np.eye(n), -np.eye(n)])
    solution = batch.solve((states + moves[:, None]).reshape(-1, n))
    cost = solution.cost.reshape(2 * n + 1, 5)
    rho = solution.gradients[:5]  # one symbol per state moves that state alone, at rate 1
    differences = (cost[1 : n + 1] - cost[n + 1 :]).T / (2 * delta)
    size = np.linalg.norm(rho, axis=1, keepdims=True)
    # the cost is known to some rounding errors, which the difference divides by its step
    slack = 64 * np.finfo(float).eps * np.abs(cost).max() / delta
    assert np.all(np.abs(differences - rho) <= 1e-7 * size + slack)
    assert slack < 1e-7 * np.median(size)


def test_pendulum_gradients_are_those_of_the_energy_law():
    problem = problems.plain("cart-pendulum")
    batch = controller(problem)
    states = problem.domain.sample(100_000, seed=4)
    theta, omega = states.T
    energy = 0.5 * 2.0**2 * omega**2 + 9.81 * 2.0 * (np.cos(theta) - 1)
    slope = energy * 2.0 * omega * np.cos(theta)
    exact = slope[:, None] * problem.alphabet.values[:, 0]
    solution = batch.solve(states)
    np.testing.assert_allclose(solution.cost, 0.5 * energy**2, atol=1e-5 * np.ptp(energy) ** 2)
    error = np.abs(solution.gradients - exact) / np.abs(exact)
    assert np.median(error) <= 1e-5
    law = np.where(slope > 0, 1, 0)  # symbol 1 is -5 m/s^2
    assert (batch.symbols(states) != law).mean() <= 2e-5
    masks = batch.masks(states)[:, 0]
    assert (masks & (np.uint64(1) << law.astype(np.uint64)) != 0).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_tank_a_gradients_are_exact(backend):
    problem = problems.plain("double-tank-a")
    states = problem.domain.sample(5000, seed=5)
    offset = states - [0.8, 0.2]
    rates = [
        np.stack([np.asarray(rate, float) * np.ones(len(states)) for rate in tank_rates(states, u)])
        for u in problem.alphabet.values
    ]
    solution = controller(problem, backend).solve(states)
    exact = np.einsum("bi,sib->bs", 201 * offset, np.array(rates))
    np.testing.assert_allclose(solution.cost, 100.5 * (offset**2).sum(axis=1), rtol=1e-12)
    assert np.all(np.abs(solution.gradients - exact) <= 1e-12 * solution.scales)


def tank_rates(states, u):
    x1, x2 = states.T
    head = np.where(x2 > double_tank.HEIGHT, x1 - x2 + double_tank.HEIGHT, x1)
    upper, lower = (z / (z**2 + double_tank.SMOOTHING**2) ** 0.25 for z in (head, x2))
    return u[0] - u[1] * upper, u[1] * upper - u[2] * lower


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_linear_quadratic_problems_match_matrix_exponentials(n):
    rng = np.random.default_rng(n)
    a, b, u, horizon = rng.normal(size=(n, n)), rng.normal(size=(n, n)), rng.normal(size=n), 0.8
    q, p = (root @ root.T for root in rng.normal(size=(2, n, n)))
    problem = Problem(
        name="linear",
        dynamics=lambda x, v: ca.mtimes(a, x) + ca.mtimes(b, v),
        domain=Box(-np.ones(n), np.ones(n)),
        alphabet=np.vstack([u + np.eye(n), -u]),
        default=u,
        horizon=horizon,
        running_cost=lambda x: ca.bilin(ca.DM(q), x, x),
        terminal_cost=lambda x: ca.bilin(ca.DM(p), x, x),
    )
    # z = (x, 1): z' = m z, cost z^T w z with w = int e^{m^T t} q e^{m t} dt + e^{m^T T} p e^{m T}
    m = np.zeros((n + 1, n + 1))
    m[:n, :n], m[:n, n] = a, b @ u
    wide_q, wide_p = (np.pad(weight, ((0, 1), (0, 1))) for weight in (q, p))
    block = expm(np.block([[-m.T, wide_q], [np.zeros_like(m), m]]) * horizon)
    flow = block[n + 1 :, n + 1 :]
    w = flow.T @ block[: n + 1, n + 1 :] + flow.T @ wide_p @ flow
    states = problem.domain.sample(200, seed=6)
    z = np.column_stack([states, np.ones(len(states))])
    rho = 2 * (z @ w)[:, :n]
    change = (problem.alphabet.values - u) @ b.T
    solution = controller(problem, steps=96).solve(states)
    cost = np.einsum("bi,ij,bj->b", z, w, z)
    np.testing.assert_allclose(solution.cost, cost, rtol=1e-7, atol=1e-8 * cost.max())
    assert np.all(np.abs(solution.gradients - rho @ change.T) <= 1e-7 * solution.scales)


@pytest.mark.parametrize("backend", BACKENDS)
def test_results_do_not_depend_on_batch_order_size_or_position(backend):
    problem = problems.plain("double-tank-b").replace(default=[0.5, 0.2, 1.0])
    batch = controller(problem, backend, steps=5)
    states = problem.domain.sample(2500, seed=7)  # more than a block of the NumPy backend
    whole = batch.solve(states)

    def same(solution: Solution, rows) -> None:
        for got, want in zip(dataclasses.astuple(solution), dataclasses.astuple(whole)):
            np.testing.assert_array_equal(got, want[rows])

    order = np.random.default_rng(0).permutation(len(states))
    same(batch.solve(states[order]), order)
    for rows in (slice(0, 1), slice(7, 70), slice(63, 128), slice(100, 2500, 3), slice(9, 9)):
        same(batch.solve(states[rows]), rows)
    assert batch.masks(states[:0]).shape == (0, 1)


def with_settings(batch: BatchController, settings: SsacSettings) -> BatchController:
    """Return a controller with other settings."""
    return dataclasses.replace(
        batch, formulation=dataclasses.replace(batch.formulation, settings=settings)
    )


def fixed(solution: Solution, **options) -> BatchController:
    """Return a controller of three symbols u = 0, 1, 2 whose every solve is this solution."""
    values = np.array([[0.0], [1.0], [2.0]])
    chosen = SsacSettings(steps=1, **options)
    return BatchController(
        lambda states, horizon, steps: dataclasses.astuple(solution),
        "numpy",
        Formulation(None, None, values, np.zeros(1), 1.0, chosen),
        chosen.efforts(values),
        (0, 1, 2, 3),
    )


def close_solution(seed: int, spread: float) -> Solution:
    """Return a solution of 150 states whose symbols tie often."""
    rng = np.random.default_rng(seed)
    scales = rng.uniform(0.1, 3.0, (150, 3))
    cost = rng.uniform(0, 0.5, 150)
    center = np.where(rng.random((150, 1)) < 0.5, -5 * cost[:, None], rng.normal(size=(150, 1)))
    mirrored = np.where(rng.random((150, 3)) < 0.3, -10 * cost[:, None] - center, center)
    offset = np.where(rng.random((150, 1)) < 0.2, -mirrored[:, :1], 0.0)  # some about 0
    return Solution(cost, mirrored + offset + spread * TIE * rng.normal(size=(150, 3)), scales)


def brute_force_masks(batch: BatchController, solution: Solution, tie: float) -> np.ndarray:
    """Return the symbols that are best for some perturbation, by trying the extreme ones."""
    masks = np.zeros(len(solution.cost), dtype=np.uint64)
    for k, (gradients, scales) in enumerate(zip(solution.gradients, solution.scales)):
        wanted = batch.settings.gamma * solution.cost[k]
        if batch.settings.alpha_d is not None:
            wanted = batch.settings.alpha_d
        choices = [
            {g - tie * s, g + tie * s, float(np.clip(wanted, g - tie * s, g + tie * s))}
            for g, s in zip(gradients, scales)
        ]
        for perturbed in map(np.array, itertools.product(*choices)):
            distance = (perturbed - wanted) ** 2
            if batch.settings.rule == "steepest":
                distance = perturbed
            scores = distance + batch.efforts
            best = int(np.argmin(scores))
            without_descent = batch.settings.on_no_descent == "default" and perturbed[best] >= 0
            masks[k] |= np.uint64(1 << (3 if without_descent else best))
    return masks


@pytest.mark.parametrize("rule", ["schedule", "steepest"])
@pytest.mark.parametrize(
    "options",
    [{}, {"alpha_d": -0.3}, {"control_weight": 1e-5}, {"on_no_descent": "default"}],
    ids=str,
)
@pytest.mark.parametrize("spread", [0.3, 3.0])
def test_masks_hold_the_symbols_that_some_perturbation_makes_best(rule, options, spread):
    solution = close_solution(8, spread)
    batch = fixed(solution, rule=rule, **options)
    masks = batch.possible(solution)[:, 0]
    assert len(np.unique(masks)) >= 4
    inner = brute_force_masks(batch, solution, TIE * (1 - 1e-9))
    assert (inner & ~masks == 0).all()
    if "on_no_descent" not in options:  # there a set that is a little larger is allowed
        outer = brute_force_masks(batch, solution, TIE * (1 + 1e-9))
        assert (masks & ~outer == 0).all()
    symbols = batch.symbols(np.zeros((150, 1)))
    assert (masks >> np.where(symbols < 0, 3, symbols).astype(np.uint64) & np.uint64(1)).all()


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a", "cart-pole"])
@pytest.mark.parametrize("on_no_descent", ["best", "default"])
def test_masks_contain_the_symbol(name, on_no_descent):
    problem = problems.plain(name)
    batch = controller(problem, on_no_descent=on_no_descent, steps=8)
    states = np.vstack([problem.domain.sample(4000, seed=9), problem.domain.lower])
    symbols, masks = batch.symbols(states), batch.masks(states)[:, 0]
    bits = np.where(symbols < 0, len(problem.alphabet), symbols).astype(np.uint64)
    assert (masks >> bits & np.uint64(1) == 1).all()
    assert len(np.unique(symbols)) >= 2


@pytest.mark.parametrize("backend", BACKENDS)
def test_symbols_tie_on_the_lines_where_they_make_no_difference(backend):
    two = problems.plain("cart-pendulum")
    angles, rates = np.linspace(0, 2 * np.pi, 41), np.linspace(-5, 5, 40)
    at_rest = np.column_stack([angles, np.zeros(41)])
    level = np.array([[turn * np.pi, rate] for turn in (0.5, 1.5) for rate in rates])
    near = np.array([[1.0, 1e-3], [1.0, -1e-3], [np.pi / 2 + 1e-3, 1.0], [np.pi / 2 - 1e-3, 1.0]])
    batch = controller(two, backend)
    assert (batch.masks(np.vstack([at_rest, level]))[:, 0] == 0b11).all()
    np.testing.assert_array_equal(batch.masks(near)[:, 0], [0b01, 0b10, 0b10, 0b01])
    four = controller(problems.plain("cart-pendulum-4"), backend).masks(
        np.vstack([at_rest, level])
    )[:, 0]
    assert set(four) == {0b0110, 0b1111}  # where the cost is small, effort rules out -5 and 5
    tank = problems.plain("double-tank-a")
    empty = np.column_stack([np.linspace(0.05, 0.95, 30), np.zeros(30)])  # V3 is the lowest bit
    masks = controller(tank, backend).masks(empty)[:, 0]
    assert ((masks & np.uint64(0b01010101)) << np.uint64(1) == masks & np.uint64(0b10101010)).all()


def test_the_steepest_rule_and_an_absolute_sensitivity_choose_as_defined():
    problem = problems.plain("cart-pendulum-4")
    states = problem.domain.sample(3000, seed=10)
    efforts = 0.3 * problem.alphabet.values[:, 0] ** 2
    choices = {}
    for name, rule in {
        "steepest": {"rule": "steepest"},
        "absolute": {"alpha_d": -40.0},
        "gamma": {"gamma": -1.0},
    }.items():
        chosen = SsacSettings(control_weight=0.3, steps=24, **rule)
        batch = controller(problem.replace(settings=chosen))
        solution = batch.solve(states)
        wanted = {"absolute": -40.0, "gamma": -solution.cost[:, None]}
        scores = solution.gradients + efforts
        if name in wanted:
            scores = (solution.gradients - wanted[name]) ** 2 + efforts
        choices[name] = batch.symbols(states)
        np.testing.assert_array_equal(choices[name], np.argmin(scores, axis=1))
    assert len({tuple(symbols) for symbols in choices.values()}) == 3


def test_a_control_weight_matrix_charges_each_input_and_their_product():
    problem = problems.plain("double-tank-a")
    weight = np.array([[3.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]])
    states = problem.domain.sample(1000, seed=11)
    batch = controller(problem, control_weight=weight)
    efforts = [3 * u[0] + u[1] + u[0] * u[1] for u in problem.alphabet.values]  # u is 0 or 1
    np.testing.assert_allclose(batch.efforts, efforts, rtol=1e-15)
    dear = controller(problem, control_weight=1e9 * weight)
    assert set(dear.symbols(states)) <= {0, 1}  # V1 and V2 closed, V3 is free
    assert set(controller(problem).symbols(states)) > {0, 1}
    with pytest.raises(ProblemError, match="control_weight"):
        controller(problem, control_weight=np.eye(2))


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_default_replaces_symbols_without_descent(backend):
    problem = problems.plain("cart-pole").replace(alphabet=[2.0, 5.0])  # pushes one way only
    states = problem.domain.sample(2000, seed=12)
    best = controller(problem, backend)
    careful = controller(problem, backend, on_no_descent="default")
    symbols, gradients = best.symbols(states), best.solve(states).gradients
    uphill = np.take_along_axis(gradients, symbols[:, None], axis=1)[:, 0] >= 0
    assert 0.2 < uphill.mean() < 0.8
    np.testing.assert_array_equal(careful.symbols(states), np.where(uphill, -1, symbols))
    clear = np.abs(gradients).min(axis=1) > 1e-3
    masks = careful.masks(states[clear])[:, 0]
    assert (masks == np.where(uphill, 0b100, best.masks(states)[:, 0])[clear]).all()


def wild_problem(**changes) -> Problem:
    """Return a problem without a result for x1 < 0, and one that overflows for x2 > 30."""
    options = {
        "name": "wild",
        "dynamics": lambda x, u: [-ca.log(x[0]) / 50 + u[0], x[1] ** 3 - x[1] + 0.1 * u[0]],
        "domain": Box([-1, -40], [1, 40]),
        "alphabet": [-0.1, 0.1, 0.2],
        "default": 0.0,
        "horizon": 0.2,
        "running_cost": lambda x: x[0] ** 2 + x[1] ** 2,
    }
    return Problem(**options | changes)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("rule", ["schedule", "steepest"])
@pytest.mark.parametrize("on_no_descent", ["best", "default"])
@pytest.mark.filterwarnings("error")
def test_solves_that_are_not_finite_have_no_label(backend, rule, on_no_descent):
    batch = controller(wild_problem(), backend, steps=20, rule=rule, on_no_descent=on_no_descent)
    fine = np.array([[0.5, 0.1], [0.7, -0.2], [0.9, 0.3]])
    no_result = np.array([[-0.5, 0.1], [0.5, 30.0], [np.nan, 0.0], [0.5, np.inf], [0.5, 1e200]])
    alone = batch.symbols(fine), batch.masks(fine)[:, 0]
    mixed = np.vstack([fine, no_result])
    np.testing.assert_array_equal(batch.symbols(mixed), [*alone[0], -1, -1, -1, -1, -1])
    np.testing.assert_array_equal(batch.masks(mixed)[:, 0], [*alone[1], 0, 0, 0, 0, 0])
    assert (alone[1] > 0).all()


@pytest.mark.parametrize("rule", ["schedule", "steepest"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_one_infinite_symbol_or_cost_takes_the_label_of_the_whole_state(backend, rule):
    states = np.array([[0.0, 0.5], [0.5, 0.5]])
    division = wild_problem(
        dynamics=lambda x, u: [u[0] / (x[0] * ca.fmax(u[0], 0)), u[0] - x[1]], default=0.1
    )
    hidden = wild_problem(
        dynamics=lambda x, u: [u[0] - x[0], u[0] - x[1]],
        running_cost=None,
        terminal_cost=lambda x: ca.floor(1 / x[0]) + x[1],
        default=0.0,
    )
    for problem in (division, hidden):
        batch = controller(problem, backend, steps=2, rule=rule)
        solution = batch.solve(states)
        assert not (np.isfinite(solution.cost) & np.isfinite(solution.gradients).all(axis=1))[0]
        np.testing.assert_array_equal(batch.symbols(states) < 0, batch.masks(states)[:, 0] == 0)
        assert batch.symbols(states)[0] == -1


def test_single_precision_agrees_and_is_labelled():
    problem = problems.plain("cart-pendulum")
    states = problem.domain.sample(5000, seed=13)
    double = controller(problem, steps=24).solve(states)
    for backend in BACKENDS:
        batch = controller(problem, backend, steps=24, precision="single")
        single = batch.solve(states)
        assert batch.settings.precision == "single" and batch.settings.steps == 24
        error = np.abs(single.gradients - double.gradients)
        assert 0 < error.max() <= 1e-4 * double.scales.max()
        # of its own scale it is more near zero energy, where the whole adjoint vanishes
        assert np.percentile(error / double.scales, 99) <= 1e-4
        np.testing.assert_allclose(single.cost, double.cost, rtol=1e-4, atol=1e-2)
    policy = synthesize(problem, max_level=0, settings=batch.settings)
    assert policy.settings.precision == "single"


def doubling_error(batch: BatchController, problem: Problem, steps: int) -> float:
    states = problem.domain.sample(STEP_SAMPLES, 0)
    _, coarse, _ = batch.solver(states, problem.horizon, steps)
    _, fine, scales = batch.solver(states, problem.horizon, 2 * steps)
    return float(np.percentile(np.abs(coarse - fine) / scales, 99))


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-9])
def test_the_fewest_steps_that_meet_the_tolerance_are_chosen(tolerance):
    problem = problems.plain("cart-pendulum").replace(horizon=0.6)
    batch = controller(problem, tolerance=tolerance)
    steps = batch.settings.steps
    assert steps in STEP_LADDER[1:]
    assert doubling_error(batch, problem, steps) <= tolerance
    fewer = STEP_LADDER[STEP_LADDER.index(steps) - 1]
    assert doubling_error(batch, problem, fewer) > tolerance


def stiff(rate) -> Problem:
    """Return a problem whose exact solution decays much faster than 4 steps can follow."""
    return Problem(
        name="stiff",
        dynamics=lambda x, u: [rate(x[0]) + u[0]],
        domain=Box([-1], [1]),
        alphabet=[-1.0, 1.0],
        default=0.0,
        horizon=1.0,
        running_cost=lambda x: x[0] ** 2,
    )


@pytest.mark.parametrize("rate", [lambda x: -100 * x, lambda x: -100 * x**3])
def test_steps_that_are_too_long_to_be_stable_are_never_chosen(rate):
    problem = stiff(rate)
    batch = controller(problem)
    states = problem.domain.sample(500, seed=14)
    exact = with_settings(batch, SsacSettings(steps=20_000))
    true, found = exact.solve(states), batch.solve(states)
    assert np.isfinite(true.gradients).all()
    error = np.abs(found.gradients - true.gradients) / true.scales
    assert np.percentile(error, 99) < 1e-4


def motor(horizon) -> Problem:
    """Return a motor whose current settles in 1 ms, to be predicted over seconds."""
    return Problem(
        name="motor",
        dynamics=lambda x, u: [x[1], 50 * x[2] - 0.1 * x[1], 1000 * (u[0] - x[2] - 0.05 * x[1])],
        domain=Box([-3, -50, -20], [3, 50, 20]),
        alphabet=[-12.0, 0.0, 12.0],
        default=0.0,
        horizon=horizon,
        running_cost=lambda x: x[0] ** 2 + 0.001 * x[1] ** 2,
        settings=SsacSettings(rule="steepest"),
    )


@pytest.mark.parametrize("horizon", [1.0, 5.0, 10.0])
def test_unstable_steps_that_agree_on_garbage_are_seen(horizon):
    problem = motor(horizon)
    batch, states = controller(problem), problem.domain.sample(300, seed=3)
    steps = round(5000 * horizon)
    exact = with_settings(batch, dataclasses.replace(batch.settings, steps=steps))
    assert batch.settings.steps > 350 * horizon  # Runge-Kutta is unstable below 1000 / 2.79
    assert np.mean(batch.symbols(states) == exact.symbols(states)) > 0.99


def test_a_horizon_that_no_steps_resolve_is_refused_as_stiff():
    with pytest.raises(ProblemError, match="`horizon` must be shorter, or `steps` .* is stiff"):
        controller(motor(12.5))


def test_steps_are_chosen_with_a_warning_where_more_do_not_help():
    problem = problems.plain("cart-pendulum")
    with pytest.warns(
        CapsynWarning, match="step-doubling check reached .* not the tolerance 1e-06"
    ):
        batch = controller(problem, precision="single")
    assert batch.settings.steps < STEP_LADDER[-1]
    assert doubling_error(batch, problem, batch.settings.steps) < 1e-4


def test_states_that_never_have_a_result_do_not_count_in_the_choice_of_steps():
    problem = wild_problem(dynamics=lambda x, u: [ca.log(x[0]) + 2 + u[0], -x[1] + u[0]])
    box = problem.replace(domain=Box([-1, 0], [1, 1]))
    alone = problem.replace(domain=Box([0.5, 0], [1, 1]))
    assert controller(box, tolerance=1e-3).settings.steps <= 32
    assert controller(alone, tolerance=1e-3).settings.steps <= 32


def test_the_backend_is_checked():
    with pytest.raises(ProblemError, match="`backend` must be one of 'auto', 'c', 'numpy'"):
        controller(problems.plain("cart-pole"), "fortran")


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("shape", [(5, 3), (5, 5)])
def test_states_of_another_size_are_refused(backend, shape):
    batch = controller(problems.plain("cart-pole"), backend)
    with pytest.raises(ValueError, match="must have shape"):
        batch.solve(np.zeros(shape))
