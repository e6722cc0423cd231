"""What decides in discrete time: sensitivities of one sample, sequences, tails, against oracles."""

import casadi as ca
import numpy as np
import pytest
import scipy.linalg

from capsyn import Box, Problem, SsacSettings, Switching, simulate, synthesize
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import bind_default
from capsyn.controllers.ssac import batch_controller
from capsyn.errors import ProblemError, SynthesisError
from capsyn.modelling.transcription import transcribe
from capsyn.sources.finite_control_set import finite_control_set
from support.models.maps import (
    HARVESTS,
    WANTED,
    grown,
    iterated,
    stock,
    stock_costs,
    turned,
    turning,
    turning_cost,
)

STATES = np.linspace(0.05, 1.4, 2001)


def controller(problem, backend="c", **settings):
    """Return sSAC for a problem with other settings."""
    problem = problem.replace(settings=SsacSettings(**settings))
    return batch_controller(Formulation.of(problem, transcribe(problem)), backend)


def away(x):
    return (x - WANTED) ** 2


def nothing(z):
    return 0.0


@pytest.mark.parametrize("backend", ["c", "numpy"])
def test_the_exact_rule_is_brute_force_over_the_first_sample(backend):
    costs = np.stack([iterated(grown, away, away, STATES, [u, 0.5, 0.5, 0.5]) for u in HARVESTS], 1)
    ssac = controller(stock(), backend)
    solution = ssac.solve(STATES[:, None])
    np.testing.assert_allclose(solution.cost, costs[:, 1], rtol=1e-13)
    np.testing.assert_allclose(solution.gradients, costs - costs[:, 1:2], atol=1e-14)
    np.testing.assert_array_equal(ssac.symbols(STATES[:, None]), costs.argmin(axis=1))
    assert ssac.settings.steps == 4 and ssac.settings.sensitivity is None


def test_the_exact_rule_decides_as_all_sequences_do_and_the_first_order_one_does_not():
    best = stock_costs(STATES).argmin(axis=1)
    exact = controller(stock(), sensitivity="exact").symbols(STATES[:, None])
    first = controller(stock(), sensitivity="first order").symbols(STATES[:, None])
    assert (exact == best).mean() >= 0.999
    assert 0.3 < (first == best).mean() < 0.5


@pytest.mark.parametrize("backend", ["c", "numpy"])
def test_a_finite_control_set_is_brute_force_over_the_map_on_every_state(backend):
    control, best = finite_control_set(stock(), 4, backend=backend), stock_costs(STATES)
    np.testing.assert_allclose(control.costs(STATES[:, None]), best, atol=1e-14)
    np.testing.assert_array_equal(control(STATES[:, None]), best.argmin(axis=1))


def test_effort_and_prices_are_per_sample_whatever_the_sample_time():
    effort = np.array(HARVESTS) ** 2 * 0.02
    for time in (0.5, 8.0):
        problem = stock(sample_time=time, settings=SsacSettings(control_weight=0.02))
        costs = finite_control_set(problem, 1).costs(STATES[:, None])
        exact = np.stack([away(STATES) + away(grown(STATES, u)) for u in HARVESTS], 1) + effort
        np.testing.assert_allclose(costs, exact, atol=1e-14)
        problem = problem.replace(switching=Switching(price=0.01))
        control = finite_control_set(problem, 1)
        pays = exact + 0.01 * (np.arange(3) != 2)
        np.testing.assert_array_equal(control(STATES[:, None], 2), pays.argmin(axis=1))
        ssac = controller(problem.replace(horizon=1), control_weight=0.02, rule="steepest")
        own = ssac.chosen(ssac.masks(STATES[:, None])[:, 2])
        np.testing.assert_array_equal(own, pays.argmin(axis=1))


@pytest.mark.parametrize("law", [False, True])
def test_the_adjoint_is_the_gradient_of_the_iterated_cost(law):
    problem = turning(settings=SsacSettings(sensitivity="first order", rule="steepest"))
    if law:
        problem = problem.replace(default=lambda x, w: -0.5 * x[1] - w[0])
    control = (lambda z: -0.5 * z[1] - z[2]) if law else (lambda z: 0.0)

    def cost(z, samples):
        total = 0.0
        for _ in range(samples):
            total = total + turning_cost(z)
            z = turned(z, control(z))
        return total

    z = problem.space.sample(50, 3)
    formulation = Formulation.of(problem, transcribe(problem))
    for backend in ("c", "numpy"):
        solution = batch_controller(formulation, backend).solve(z)
        np.testing.assert_allclose(solution.cost, cost(z.T, 6), rtol=1e-12)
        after, step = turned(z.T, control(z.T)), 1e-6
        rho = np.zeros((2, len(z)))
        for i in range(2):
            side = np.zeros((3, 1))
            side[i] = step
            rho[i] = (cost(after + side, 5) - cost(after - side, 5)) / (2 * step)
        for k, u in enumerate([-1.0, 0.0, 1.0]):
            change = turned(z.T, u) - after
            expected = (rho * change[:2]).sum(axis=0)
            np.testing.assert_allclose(solution.gradients[:, k], expected, atol=1e-8)


def test_the_exact_rule_needs_no_derivative_and_follows_a_law():
    problem = turning(
        running_cost=lambda x, w: ca.sqrt(ca.fabs(x[1])) + ca.floor(2 * x[0]),
        default=lambda x, w: -0.5 * x[1] - w[0],
    )
    z = np.vstack([problem.space.sample(50, 4), [[0.3, 0.0, 0.0]]])
    z[-1, 1] = 0.0  # where the root has no slope

    def running(z):
        return np.sqrt(np.abs(z[1])) + np.floor(2 * z[0])

    def cost(u):
        total, x = running(z.T), turned(z.T, u)
        for _ in range(5):
            total, x = total + running(x), turned(x, -0.5 * x[1] - x[2])
        return total

    for backend in ("c", "numpy"):
        solution = controller(problem, backend).solve(z)
        expected = np.stack([cost(u) for u in (-1.0, 0.0, 1.0)], axis=1)
        np.testing.assert_allclose(solution.gradients + solution.cost[:, None], expected, 1e-12)


def test_linear_maps_and_quadratic_costs_have_the_answers_of_the_textbook():
    a, b = np.array([[1.0, 0.1], [-0.2, 0.95]]), np.array([0.005, 0.1])
    q = np.diag([1.0, 0.1])
    problem = Problem(
        name="linear",
        dynamics=lambda x, u: ca.DM(a) @ x + ca.DM(b) * u[0],
        discrete=True,
        sample_time=0.1,
        domain=Box([-1, -1], [1, 1]),
        alphabet=[-1.0, 0.0, 1.0],
        default=0.0,
        horizon=7,
        running_cost=lambda x: ca.dot(x, ca.DM(q) @ x),
        tail="riccati:0.1",
    )
    r = 0.1 * np.trace(q) / 10
    inputs = (b * np.sqrt(2 / 3))[:, None]  # of the mean of b b^T u^2 over the symbols
    p = scipy.linalg.solve_discrete_are(a, inputs, q, [[r]])
    states = problem.domain.sample(100, 0)
    ends = problem.functions()["terminal_cost"](states.T)
    np.testing.assert_allclose(np.array(ends)[0], np.einsum("si,ij,sj->s", states, p, states))
    powers = [np.linalg.matrix_power(a, k) for k in range(8)]
    m = sum(power.T @ q @ power for power in powers[:7]) + powers[7].T @ p @ powers[7]
    solution = controller(problem, sensitivity="first order").solve(states)
    np.testing.assert_allclose(solution.cost, np.einsum("si,ij,sj->s", states, m, states), 1e-12)
    rest = sum(power.T @ q @ power for power in powers[:6]) + powers[6].T @ p @ powers[6]
    rho = 2 * states @ a.T @ rest
    np.testing.assert_allclose(solution.gradients, np.outer(rho @ b, [-1, 0, 1]), atol=1e-13)
    exact = controller(problem).solve(states).gradients
    second = np.array([1, 0, 1]) * (b @ rest @ b)
    np.testing.assert_allclose(exact, np.outer(rho @ b, [-1, 0, 1]) + second, atol=1e-12)
    assert problem.replace(horizon=None).horizon == 2.0


def test_a_tail_of_a_map_needs_a_goal_that_it_can_hold():
    def grows(x, u):
        return [1.5 * x[0], 0.5 * x[1] + u[0]]

    more = {"running_cost": lambda x: ca.dot(x, x), "terminal_cost": None, "tail": "riccati"}
    plane = {"domain": Box([-1, -1], [1, 1]), "alphabet": [-1.0, 1.0], "default": 0.0}
    with pytest.raises(ProblemError, match=r"moves there as \(1.5\)\^k no symbol changes"):
        stock(dynamics=grows, target=None, **more, **plane)


def test_single_precision_and_delays_count_in_samples():
    problem = stock(delay=1.0)
    ssac, ahead = controller(stock()), controller(problem)
    assert ahead.in_force == 4
    masks = ahead.masks(STATES[:, None])
    for label, u in enumerate((*HARVESTS, 0.5)):
        there = grown(grown(STATES, u), u)
        np.testing.assert_array_equal(ahead.chosen(masks[:, label]), ssac.symbols(there[:, None]))
    delayed = finite_control_set(problem, 4).masks(STATES[:, None])
    plain = finite_control_set(stock(), 4)
    there = grown(grown(STATES, 1.0), 1.0)
    np.testing.assert_array_equal(delayed[:, 2], plain.masks(there[:, None]))
    rough = controller(stock(), precision="single")
    assert (rough.symbols(STATES[:, None]) == ssac.symbols(STATES[:, None])).mean() > 0.998


def test_where_the_map_is_not_a_number_no_symbol_is_chosen_and_the_reason_is_told():
    root = stock(
        dynamics=lambda x, u: [ca.sqrt(x[0] - 0.5 * u[0])],
        running_cost=lambda x: x[0] ** 2,
        terminal_cost=None,
    )
    x = np.array([[0.2], [1.0]])
    for backend in ("c", "numpy"):
        assert controller(root, backend).symbols(x).tolist() == [-1, 2]
        run = simulate(lambda t, x: np.full((len(x), 1), 0.5), [0.2], 1, model=root)
        assert run.ended == "not finite" and np.isnan(run.states[1, 0])
    with pytest.raises(SynthesisError, match="dynamics.* is not finite: sqrt of an expression"):
        synthesize(root)
    with pytest.raises(SynthesisError, match="mul of .*, 1 after the start of the pred"):
        synthesize(stock(dynamics=lambda x, u: [1e200 * x[0] * x[0] + u[0]], horizon=20))


def test_a_default_that_costs_far_more_makes_no_symbols_tie():
    cliff = stock(
        dynamics=lambda x, u: [x[0] + u[0]],
        domain=Box([0], [1]),
        alphabet=[-0.3, -0.4, -0.5],
        default=2.0,
        horizon=3,
        running_cost=lambda x: 1e12 * (x[0] > 4) + x[0] ** 2,
        terminal_cost=None,
        target=None,
        settings=SsacSettings(rule="steepest"),
    )
    x = np.linspace(0, 1, 201)
    there = x[:, None] + [-0.3, -0.4, -0.5]
    best = (there**2 + (there + 2) ** 2).argmin(axis=1)
    for backend in ("c", "numpy"):
        formulation = Formulation.of(cliff, transcribe(cliff))
        ssac = batch_controller(formulation, backend)
        assert (ssac.solve(x[:, None]).cost[x > 0.01] > 1e11).all()
        np.testing.assert_array_equal(ssac.symbols(x[:, None]), best)


def test_a_law_or_constant_is_bound_as_in_continuous_time():
    model = bind_default(transcribe(stock()), np.array([0.5]))
    assert model.sample_time == 0.5
    state, cost = model.step.evaluate([STATES[:3]], [0.123])
    np.testing.assert_allclose(state[0], grown(STATES[:3], 0.5))
    np.testing.assert_allclose(cost[0], away(STATES[:3]))
