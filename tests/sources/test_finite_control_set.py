"""Finite-control-set predictive control: equal to brute force, compiled or not, in any order."""

import functools
import itertools

import casadi as ca
import numpy as np
import pytest

from capsyn import (
    Alphabet,
    Box,
    Problem,
    SsacSettings,
    Switching,
    agreement,
    problems,
    simulate,
)
from capsyn.cells.masks import COST_TIE, members
from capsyn.compression.judge import Judge
from capsyn.errors import CapsynWarning, KernelBuildError, ProblemError
from capsyn.sources.callables import problem_policy
from capsyn.sources.finite_control_set import MOST_DEPTH, finite_control_set

BACKENDS = ("c", "numpy")


def pendulum(symbols=(-5.0, 0.0, 5.0), **changes):
    return problems.plain("cart-pendulum").replace(
        alphabet=Alphabet(list(symbols)),
        running_cost=lambda x: 1 - ca.cos(x[0]) + 0.1 * x[1] ** 2,
        terminal_cost=lambda x: 2 * ca.sin(x[0]) ** 2 + x[1] ** 2,
        **{"switching": None, **changes},
    )


def slopes(x, u):
    """Return rates and cost of the same, written anew."""
    rates = np.stack([x[1], (9.81 * np.sin(x[0]) + u * np.cos(x[0])) / 2.0])
    return rates, 1 - np.cos(x[0]) + 0.1 * x[1] ** 2


@functools.cache
def brute_force(depth, period, blocks, steps, weight, prices=((0.0,) * 3,) * 3):
    """Return the least costs (B, N) by first symbol: every sequence from its beginning, alone."""
    values, states, h = (-5.0, 0.0, 5.0), pendulum().domain.sample(1000, 3), period / steps
    best = np.full((len(states), len(values)), np.inf)
    for sequence in itertools.product(range(len(values)), repeat=depth):
        x, total = states.T, np.zeros(len(states))
        for before, after in itertools.pairwise(sequence):
            total = total + prices[before][after] * period
        for symbol, held in zip(sequence, blocks):
            u = values[symbol]
            total = total + weight * u**2 * held * period
            for _ in range(held * steps):
                k1, c1 = slopes(x, u)
                k2, c2 = slopes(x + h / 2 * k1, u)
                k3, c3 = slopes(x + h / 2 * k2, u)
                k4, c4 = slopes(x + h * k3, u)
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                total = total + h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
        total = total + 2 * np.sin(x[0]) ** 2 + x[1] ** 2
        best[:, sequence[0]] = np.fmin(best[:, sequence[0]], total)
    return best


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    "depth, blocks, steps, weight",
    [(5, 1, 1, 0.0), (3, [1, 2, 3], 2, 0.01), (1, 4, 1, 0.0)],
)
def test_equal_to_brute_force(backend, depth, blocks, steps, weight):
    problem = pendulum()
    states = problem.domain.sample(1000, 3)
    held = (blocks,) * depth if isinstance(blocks, int) else tuple(blocks)
    wanted = brute_force(depth, 0.05, held, steps, weight)
    control = finite_control_set(
        problem, depth, sample_time=0.05, blocks=blocks, steps=steps, control_weight=weight,
        backend=backend,
    )  # fmt: skip
    assert control.backend == backend
    np.testing.assert_allclose(control.costs(states), wanted, rtol=1e-11)
    least = wanted.min(axis=1, keepdims=True)
    tied = wanted <= least * (1 + COST_TIE)
    np.testing.assert_array_equal(control(states), tied.argmax(axis=1))  # the lowest of ties
    masks = (tied << np.arange(3)).sum(axis=1).astype(np.uint64)
    np.testing.assert_array_equal(control.masks(states)[:, 0], masks)


PRICES = [[0.0, 0.3, 0.9], [0.2, 0.0, 0.2], [0.7, 0.1, 0.0]]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("depth, blocks, forbidden", [(4, 1, ()), (3, [1, 2, 3], [("1", "2")])])
def test_prices_are_paid_along_sequences(backend, depth, blocks, forbidden):
    alphabet = Alphabet([-5.0, 0.0, 5.0], names=["0", "1", "2"])
    switching = Switching(price=PRICES, forbidden=forbidden)
    problem = pendulum().replace(alphabet=alphabet, switching=switching)
    table = np.array(PRICES)
    for pair in forbidden:
        table[int(pair[0]), int(pair[1])] = np.inf
    held = (blocks,) * depth if isinstance(blocks, int) else tuple(blocks)
    wanted = brute_force(depth, 0.05, held, 1, 0.0, tuple(map(tuple, table.tolist())))
    control = finite_control_set(
        problem, depth, sample_time=0.05, blocks=blocks, control_weight=0, backend=backend
    )
    states = problem.domain.sample(1000, 3)
    np.testing.assert_allclose(control.costs(states), wanted, rtol=1e-11)
    assert control.in_force == 4
    sets = members(control.masks(states), 3)
    for j, first in enumerate([*table, np.zeros(3)]):  # leaving the default costs nothing
        total = wanted + first * 0.05
        tied = total <= total.min(axis=1, keepdims=True) * (1 + COST_TIE)
        np.testing.assert_array_equal(sets[:, j], tied)
        stays = tied[:, j] if j < 3 else np.zeros(len(states), bool)
        best = np.where(stays, j, tied.argmax(axis=1))
        np.testing.assert_array_equal(control(states, j if j < 3 else -1), best)
    assert (sets[:, 0] != sets[:, 3]).any() and not (forbidden and sets[:, 1, 2].any())


def test_a_share_is_of_the_spread_of_the_costs():
    problem = pendulum(switching=Switching(price="10%", hold=0.3))
    control = finite_control_set(problem, 3, sample_time=0.05)
    costs = control.costs(problem.domain.sample(20_000, 7))
    price = control.problem.switching.price
    free = finite_control_set(pendulum(), 3, sample_time=0.05).costs(
        problem.domain.sample(20_000, 7)
    )
    np.testing.assert_allclose(price * 0.05, 0.1 * np.median(np.ptp(free, axis=1)), rtol=0.05)
    assert (costs >= free).all() and (costs > free).any()
    policy = problem_policy(control, problem, max_level=1)
    assert policy.switching == Switching(price=price, hold=0.3) and policy.remembers


@pytest.mark.parametrize("price", [None, 0.5])
def test_a_delay_is_integrated_first(price):
    switching = None if price is None else Switching(price=price)
    problem = pendulum(delay=0.07, switching=switching, partitions=9, max_level=2)
    control = finite_control_set(problem, 2, sample_time=0.05)
    at_once = finite_control_set(problem.replace(delay=0.0), 2, sample_time=0.05)
    states = problem.domain.sample(500, 1)
    for j, u in enumerate([-5.0, 0.0, 5.0, 0.0]):
        held = simulate(
            lambda t, x, u=u: np.full((len(x), 1), u), states, 0.07, 1 / 0.07, model=problem,
            delay=0.0,
        )  # fmt: skip
        then = at_once.masks(held.states[:, -1])
        then = then if price is None else then[:, j]
        np.testing.assert_array_equal(control.masks(states)[:, j], then)
    policy = problem_policy(control, problem)
    assert policy.delay == 0.07 and policy.remembers and policy.switching == switching
    agree = [(policy(states, current=j) == control(states, j)).mean() for j in (-1, 0, 1, 2)]
    assert min(agree) > 0.85
    found = agreement(policy, 2000, controller=control)
    assert found.share > 0.85 and len(found.in_force_agreeing) == 4
    assert Judge.of(policy, 2000, 0, "auto", control).compare(policy).share > 0.75


def test_a_policy_of_another_switching_is_refused():
    priced = pendulum(switching=Switching(price=0.5))
    control = finite_control_set(priced, 2, sample_time=0.05)
    held = priced.replace(switching=Switching(price=0.5, hold=0.1))
    assert problem_policy(control, held, max_level=0).switching.hold == 0.1
    for other in (pendulum(), priced.replace(delay=0.1), pendulum(switching=Switching(price=0.4))):
        with pytest.raises(ProblemError, match="`problem` must have the prices, forbidden trans"):
            problem_policy(control, other)
    with pytest.raises(ProblemError, match="`current` must be symbols, -1 to 2, one or 5; got 7"):
        control(priced.domain.sample(5), 7)


def test_the_sample_time_is_that_of_the_predictions():
    fast = pendulum(settings=SsacSettings(sample_time=1e-4), max_level=0)
    for said, samples in ((None, 100), (0.005, 2)):  # None: the problem's own
        policy = problem_policy(finite_control_set(fast, 1, sample_time=said), fast)
        assert policy.settings.sample_time == (said or 1e-4) and policy.horizon is None
        assert len(simulate(policy, [0.2, 0.0], 0.01).times) == samples + 1


@pytest.mark.parametrize("backend", BACKENDS)
def test_ties_go_to_the_lowest_symbol(backend):
    problem = Problem(
        name="integrator", dynamics=lambda x, u: [u[0]], domain=Box([-1], [1]),
        alphabet=Alphabet([-1, 0, 1]), default=0.0, horizon=1.0, terminal_cost=lambda x: x[0] ** 2,
    )  # fmt: skip
    control = finite_control_set(problem, 2, sample_time=0.25, backend=backend)
    # at 0 the ends are reached by (-, +), (0, 0), (+, -): all tie; at 0.5 only (-, -)
    assert control.masks(np.array([[0.0], [0.5], [0.25], [-0.5]]))[:, 0].tolist() == [7, 1, 3, 4]
    assert control(np.array([[0.0], [0.5], [0.25], [-0.5]])).tolist() == [0, 0, 0, 2]


@pytest.mark.parametrize("backend", BACKENDS)
def test_states_without_a_finite_cost_have_no_symbol(backend):
    problem = Problem(
        name="blow-up", dynamics=lambda x, u: [u[0] + 0 * x[0]], domain=Box([-1], [2]),
        alphabet=Alphabet([-1, 1]), default=0.0, horizon=1.0,
        running_cost=lambda x: ca.sqrt(x[0]),
    )  # fmt: skip
    control = finite_control_set(problem, 1, sample_time=0.5, backend=backend)
    states = np.array([[-0.9], [0.2], [1.5], [np.nan]])
    # beyond 0, which the symbol -1 reaches from 0.2, the root is that of 0
    assert control(states).tolist() == [-1, 0, 0, -1]
    assert control.masks(states)[:, 0].tolist() == [0, 1, 1, 0]
    costs = control.costs(states)
    assert np.isinf(costs[[0, 3]]).all() and np.isfinite(costs[1:3]).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_results_do_not_depend_on_order_or_threads(backend):
    problem = pendulum()
    one = finite_control_set(problem, 3, sample_time=0.05, backend=backend, threads=1)
    three = finite_control_set(problem, 3, sample_time=0.05, backend=backend, threads=3)
    states = problem.domain.sample(10_001, 4)
    order = np.random.default_rng(0).permutation(len(states))
    costs = one.costs(states)
    assert np.array_equal(three.costs(states[order]), costs[order])
    assert np.array_equal(one.costs(states[77:78]), costs[77:78])
    assert one(states[:0]).shape == (0,)


def test_a_policy_of_it_carries_the_problem():
    problem = pendulum(partitions=6, max_level=2, horizon=0.7, min_dwell=0.01)
    control = finite_control_set(problem, 4, sample_time=0.1)
    policy = problem_policy(control, problem)
    states = problem.domain.sample(5000, 1)
    assert (policy(states) == control(states)).mean() > 0.9
    assert policy.model is not None and policy.min_dwell == 0.01
    assert policy.settings.sample_time == 0.1 and policy.horizon is None
    assert policy.domain == problem.domain and policy.name == "cart-pendulum"
    assert simulate(policy, [0.2, 0.0], 1.0, 100.0).ended == "time"
    coarse = problem_policy(control, problem, max_level=0, name="coarse")
    assert coarse.cells.leaf_count == 36 and coarse.name == "coarse"


def test_the_effort_is_that_of_the_settings_unless_told():
    dear = pendulum(settings=SsacSettings(control_weight=1e3))
    states = dear.domain.sample(50, 1)
    assert (finite_control_set(dear, 2, sample_time=0.1)(states) == 1).all()
    free = finite_control_set(dear, 2, sample_time=0.1, control_weight=0)(states)
    assert set(free.tolist()) >= {0, 2}


def test_without_a_compiler_numpy_does_it(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.warns(CapsynWarning, match="predicting with NumPy: no C compiler found"):
        control = finite_control_set(pendulum(), 2, sample_time=0.05)
    assert control.backend == "numpy"
    with pytest.raises(KernelBuildError):
        finite_control_set(pendulum(), 2, sample_time=0.05, backend="c")


@pytest.mark.parametrize(
    "options, words",
    [
        ({"problem": 3}, "`problem` must be a capsyn.Problem; got 3"),
        ({"depth": 0}, "`depth` must be a whole number >= 1"),
        ({"depth": 201}, "`depth` must be a whole number >= 1 and <= 200; got 201"),
        ({"depth": 13}, r"`depth` must give at most 1,000,000 sequences; got 13, 3\^13 of them"),
        ({"sample_time": 0}, "`sample_time` must be a finite number > 0"),
        ({"blocks": [1, 2]}, "`blocks` must be a whole number or 3 of them"),
        ({"blocks": 0}, "`blocks` must be a whole number >= 1"),
        ({"steps": 1.5}, "`steps` must be a whole number"),
        ({"control_weight": -1}, "`control_weight` must be"),
        ({"backend": "gpu"}, "`backend` must be one of"),
        ({"threads": 0}, "`threads` must be a whole number >= 1"),
    ],
)
def test_bad_arguments_are_named(options, words):
    given = {"problem": pendulum(), "depth": 3, "sample_time": 0.05} | options
    with pytest.raises(ProblemError, match=words):
        finite_control_set(given.pop("problem"), given.pop("depth"), **given)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_single_symbol_may_have_the_most_moves(backend):
    problem = pendulum(symbols=[5.0])
    states = problem.domain.sample(20, 1)
    control = finite_control_set(problem, MOST_DEPTH, sample_time=1e-3, backend=backend)
    once = finite_control_set(problem, 1, sample_time=1e-3, blocks=MOST_DEPTH, backend="numpy")
    np.testing.assert_allclose(control.costs(states), once.costs(states), rtol=1e-9)


@pytest.mark.parametrize("backend", ["c", "numpy"])
@pytest.mark.parametrize("shape", [(2,), (4, 1), (4, 3), (1, 2, 2)])
def test_states_of_another_shape_are_refused(backend, shape):
    control = finite_control_set(
        problems.plain("cart-pendulum"), 2, sample_time=0.1, backend=backend
    )
    with pytest.raises(ProblemError, match=r"`states` must be of shape \(B, 2\)"):
        control(np.zeros(shape))


@pytest.mark.parametrize("values", [[-1.0, 1.0, 4.0], [1.0, -1.0, 4.0]])
def test_a_symbol_under_which_the_model_is_not_finite_is_none_the_others_are(values):
    problem = Problem(
        name="root", dynamics=lambda x, u: [ca.sqrt(x[0] * u[0]) - x[0]], domain=Box([0.05], [2]),
        alphabet=Alphabet(values), default=1.0, horizon=1.0, running_cost=lambda x: (x[0] - 1) ** 2,
    )  # fmt: skip
    costs = finite_control_set(problem, 1, sample_time=0.1, backend="numpy").costs([[0.5], [1.5]])
    undefined = values.index(-1.0)
    assert np.isinf(costs[:, undefined]).all()
    assert np.isfinite(np.delete(costs, undefined, axis=1)).all()


def test_a_prediction_that_is_lost_is_not_cheap_by_a_table():
    table = ca.interpolant("table", "linear", [[0.0, 1.0, 2.0]], [2.0, 1.0, 0.0])
    problem = Problem(
        name="log", dynamics=lambda x, u: [ca.log(x[0]) + u[0]], domain=Box([0.05], [2]),
        alphabet=Alphabet([-1.0, 1.0]), default=0.0, horizon=1.0,
        running_cost=lambda x: table(x[0]),
    )  # fmt: skip
    costs = finite_control_set(problem, 1, sample_time=0.5, backend="numpy").costs([[0.1], [1.0]])
    assert np.isinf(costs[0]).all() and np.isfinite(costs[1]).all()
