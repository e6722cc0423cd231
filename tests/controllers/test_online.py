"""Whole actions: reference, kernel and NumPy agree; formulas; loops; refusals."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

from capsyn import Box, Problem, SsacSettings, online_controller, problems, simulate, synthesize
from capsyn.errors import CapsynWarning, KernelBuildError, OutsideDomainError, ProblemError
from support.closed_loops import (
    BACKENDS,
    grid_policy,
    integrate,
    linear_problem,
    random_grid_policy,
    relay,
    relay_problem,
)
from support.references import action as reference_action

PENDULUM = problems.plain("cart-pendulum")
TANK = problems.plain("double-tank-b")
TWO_INPUTS = Problem(
    name="two inputs",
    dynamics=lambda x, u: [x[1] + 0.3 * u[1] * ca.cos(x[0]), ca.sin(x[0]) + u[0] * (1 + x[1] ** 2)],
    domain=Box([-1, -1], [1, 1]),
    alphabet=[[1, 0], [-1, 0], [0, 2], [0, -2]],
    default=[0.1, -0.2],
    horizon=0.8,
    running_cost=lambda x: x[0] ** 2 + 0.5 * x[1] ** 2,
    terminal_cost=lambda x: 3 * (x[0] - 0.2) ** 2 + x[1] ** 4,
    settings=SsacSettings(control_weight=0.1),
)


def with_settings(problem: Problem, **changes) -> Problem:
    return problem.replace(
        settings=dataclasses.replace(problem.settings, **{"steps": 10, **changes})
    )


def feed(time):
    return [3 * np.sin(5 * time)]


BACKGROUNDS = {
    rule: dataclasses.replace(random_grid_policy(PENDULUM, 3, seed=2), outside=rule)
    for rule in ("nearest", "error", 0, -1)
}
GAPS = {
    f"gaps, {rule}": dataclasses.replace(policy, gaps=True) for rule, policy in BACKGROUNDS.items()
}
CASES = {
    "now": (PENDULUM, {}, {}),
    "search": (with_settings(PENDULUM, application_time="search"), {}, {}),
    "steepest": (with_settings(TANK), {}, {}),
    "steepest, search": (with_settings(TANK, application_time="search"), {}, {}),
    "alpha_d": (
        with_settings(
            TWO_INPUTS, alpha_d=-0.3, application_time="search", control_weight=[[1, 0.2], [0.2, 2]]
        ),
        {},
        {},
    ),
    "to the default": (
        with_settings(PENDULUM, on_no_descent="default", application_time="search", gamma=-0.01),
        {},
        {},
    ),
    "no backtracks": (with_settings(TWO_INPUTS, max_backtracks=0, initial_duration=0.7), {}, {}),
    "many backtracks": (
        with_settings(TWO_INPUTS, max_backtracks=11, shrink=0.8, initial_duration=1.5, descent=0.2),
        {},
        {},
    ),
    "constant": (with_settings(PENDULUM, application_time="search"), {"default": 1.5}, {}),
    "feedforward": (
        with_settings(PENDULUM, application_time="search"),
        {"default": feed},
        {"time": 0.7},
    ),
    **{
        f"policy, {rule}": (
            with_settings(PENDULUM, application_time="search"),
            {"default": policy},
            {},
        )
        for rule, policy in {**BACKGROUNDS, **GAPS}.items()
    },
    "sac": (with_settings(PENDULUM), {"method": "sac"}, {}),
    "sac, search": (with_settings(PENDULUM, application_time="search"), {"method": "sac"}, {}),
    "sac, policy": (PENDULUM, {"method": "sac", "default": BACKGROUNDS["nearest"]}, {}),
    "sac, two inputs": (
        with_settings(
            TWO_INPUTS, control_weight=[[0.2, 0.1], [0.1, 0.3]], application_time="search"
        ),
        {"method": "sac", "limits": ([-0.5, -9], [9, 0.7])},
        {},
    ),
    "sac, alpha_d": (with_settings(TWO_INPUTS, alpha_d=-2.0), {"method": "sac"}, {}),
}


def build(case, backend):
    problem, options, at = CASES[case]
    if problem.settings.steps is None:
        problem = with_settings(problem)
    return problem, online_controller(problem, backend=backend, **options), at


def states_of(problem, count, seed=1):
    """Return states of the domain and a few beyond, where predictions leave it."""
    states = problem.domain.sample(count, seed)
    middle = (problem.domain.lower + problem.domain.upper) / 2
    states[: count // 4] = middle + 1.15 * (states[: count // 4] - middle)
    return states


@pytest.mark.parametrize("case", CASES)
def test_actions_are_those_of_the_reference(case):
    problem, controller, at = build(case, "c")
    _, options, _ = CASES[case]
    default, time = options.get("default", problem.default), at.get("time", 0.0)

    def signal(t, x):
        if callable(default) and not hasattr(default, "cells"):
            return default(time + t)
        if hasattr(default, "cells"):
            try:
                return default.control(x)
            except OutsideDomainError:
                return default.default
        return np.atleast_1d(default)

    states = states_of(problem, 6, 2)  # none where symbols tie
    found = controller.actions(states, schedule=True, **at)
    limits = options.get("limits")
    limits = limits and tuple(np.array(limit, dtype=float) for limit in limits)
    for k, state in enumerate(states):
        wanted = reference_action.find_action(
            problem, state, signal, problem.settings, "method" in options, limits
        )
        for name, value in vars(wanted).items():
            got = getattr(found, name)[k]
            np.testing.assert_allclose(got, value, rtol=1e-7, atol=1e-8, err_msg=f"{name} of {k}")
    assert (found.duration > 0).any()


def close(one, two):
    for name, a in vars(one).items():
        b = getattr(two, name)
        if a is not None:
            if a.dtype.kind == "i":
                assert np.array_equal(a, b), name
            else:
                np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("case", CASES)
def test_compiled_is_numpy(case):
    problem, compiled, at = build(case, "c")
    _, numpy, _ = build(case, "numpy")
    assert compiled.kernel is not None and numpy.kernel is None
    states = states_of(problem, 300, 5)
    one, two = (c.actions(states, schedule=True, **at) for c in (compiled, numpy))
    close(one, two)
    assert one.schedule.shape == (300, 11, problem.alphabet.m)
    without = compiled.actions(states, **at)
    assert without.schedule is None
    close(dataclasses.replace(one, schedule=None), without)
    part = compiled.actions(states[17], **at)
    for name, value in vars(part).items():
        if value is not None:
            assert np.array_equal(value, getattr(without, name)[17]), name


@pytest.mark.parametrize("steps", [1, 7, 8, 15, 16])
def test_the_schedule_is_whole_for_any_number_of_steps(steps):
    problem = with_settings(PENDULUM, steps=steps, application_time="search")
    options = {"default": lambda t: [4 * np.cos(3 * t)]}
    states = problem.domain.sample(100, 2)
    one, two = (
        online_controller(problem, backend=backend, **options).actions(states, schedule=True)
        for backend in BACKENDS
    )
    close(one, two)
    assert one.schedule.shape == (100, steps + 1, 1)
    assert one.application_time.max() == pytest.approx(1.2) or steps > 8


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("case", ["search", "to the default", "feedforward", "policy, error"])
def test_the_control_is_that_of_the_symbol_also_where_it_does_not_act(case, backend):
    problem, controller, at = build(case, backend)
    found = controller.actions(states_of(problem, 300), **at)
    chosen = found.symbol >= 0
    assert (chosen & (found.duration == 0)).any()
    assert np.array_equal(found.control[chosen], problem.alphabet.values[found.symbol[chosen]])


@pytest.mark.parametrize("rule", list(BACKGROUNDS))
def test_states_that_are_not_finite_get_no_action(rule):
    states = [[np.nan, 1.0], [1.0, np.inf], [9.0, np.nan], [1.0, 99.0], [np.nan, np.nan]]
    found = [
        online_controller(
            with_settings(PENDULUM), default=BACKGROUNDS[rule], backend=backend
        ).actions(states)
        for backend in BACKENDS
    ]
    for one in found:
        assert (one.duration[[0, 1, 2, 4]] == 0).all() and not np.isfinite(
            one.cost[[0, 1, 2]]
        ).any()
    assert np.array_equal(found[0].base, found[1].base)
    assert np.array_equal(found[0].base_symbol, found[1].base_symbol)
    assert np.array_equal(found[0].control, found[1].control)
    if isinstance(rule, int):
        assert found[0].base_symbol[[0, 1, 2, 4]].tolist() == [rule] * 4
    else:
        assert found[0].base_symbol[[0, 1, 2, 4]].tolist() == [-1] * 4


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_symbol_of_a_background_policy_is_told_the_default_is_minus_one(backend):
    policy = grid_policy(relay_problem(), [0, 1, 2, 2], [4])
    controller = online_controller(relay_problem(), default=policy, backend=backend)
    found = controller.actions([[-0.9], [-0.2], [0.1], [0.9]])
    assert found.base_symbol.tolist() == [0, 1, -1, -1]
    assert found.base.ravel().tolist() == [1, -1, 0, 0]
    alone = online_controller(relay_problem(), backend=backend)
    assert alone.actions([0.1]).base_symbol == -1


@pytest.mark.parametrize("on_no_descent", ["best", "default"])
@pytest.mark.parametrize("name", ["cart-pendulum", "cart-pendulum-4", "double-tank-a"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_symbol_at_once_is_that_of_a_policy(name, on_no_descent, backend):
    problem = with_settings(problems.plain(name), on_no_descent=on_no_descent)
    controller = online_controller(problem, backend=backend)
    ties = np.stack(np.meshgrid(*(np.linspace(0, 1, 17),) * 2), axis=-1).reshape(-1, 2)
    ties = problem.domain.lower + ties * problem.domain.widths
    states = np.vstack([problem.domain.sample(300, 3), ties])
    wanted = controller.numpy.chooser.symbols(states)
    assert np.array_equal(controller.actions(states).symbol, wanted)
    assert len(np.unique(wanted)) > 1


@pytest.mark.parametrize(
    "case", ["search", "steepest", "many backtracks", "sac, search", "constant"]
)
def test_an_accepted_action_lowers_the_cost_that_scipy_finds(case):
    problem, options, _ = CASES[case]
    problem = with_settings(problem, steps=60)
    controller = online_controller(problem, **options)
    states = problem.domain.sample(40, 8)
    found = controller.actions(states)
    rows = np.flatnonzero(found.duration > 0)[:6]
    assert len(rows) >= 4
    terminal = problem.functions()["terminal_cost"]
    for k in rows:
        base, stop = found.base[k], found.start[k] + found.duration[k]
        acting = [(0.0, base), (found.start[k], found.control[k]), (stop, base)]
        costs = []
        for timeline in ([(0.0, base)], acting):
            x, cost = integrate(problem, states[k], timeline, 0.0, problem.horizon)
            costs.append(cost + float(terminal(x)))
        assert costs[1] < costs[0]
        assert found.cost[k] == pytest.approx(costs[0], rel=1e-5)
        assert found.decrease[k] == pytest.approx(costs[0] - costs[1], rel=1e-4, abs=1e-9)


def line(**changes):
    """Return ``xdot = u`` that shall come to 0 within 1 s, whose answers are known."""
    settings = SsacSettings(**{"steps": 4, "rule": "steepest", "initial_duration": 1.0, **changes})
    return relay_problem(
        horizon=1.0, running_cost=None, terminal_cost=lambda x: x[0] ** 2, settings=settings
    )


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("x0", "backtracks", "duration"),
    [
        (0.0005, 10, 2.0**-10),
        (0.0005, 9, 0.0),
        (0.0005, 20, 2.0**-10),
        (0.005, 10, 2.0**-7),
        (0.6, 4, 1.0),
        (0.49, 4, 0.5),
        (0.2501, 1, 0.5),  # takes off less than 1 %, but nothing shorter may be tried
        (0.2501, 2, 0.25),
        (0.2499, 1, 0.0),
        (0.5001, 0, 1.0),
    ],
)
def test_the_duration_is_the_longest_that_takes_off_enough(backend, x0, backtracks, duration):
    controller = online_controller(line(max_backtracks=backtracks), backend=backend)
    found = controller.actions([[x0], [-x0]])
    assert found.symbol.tolist() == [1, 0] and found.start.tolist() == [0, 0]
    np.testing.assert_allclose(found.duration, duration, rtol=1e-12)
    wanted = x0**2 - (x0 - duration) ** 2
    np.testing.assert_allclose(found.decrease, wanted, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.gradient, -2 * x0)
    np.testing.assert_allclose(found.cost, x0**2)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_window_longer_than_the_horizon_is_the_horizon(backend):
    controller = online_controller(line(initial_duration=0.1), horizon=0.05, backend=backend)
    found = controller.actions([0.9])
    assert (found.start, found.duration, found.symbol) == (0.0, 0.05, 1)
    assert found.decrease == pytest.approx(0.81 - 0.85**2)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_window_around_a_later_time_is_clipped_at_both_ends(backend):
    # only the default signal's second half matters: acting is best where it pushes the wrong way
    problem = line(application_time="search", initial_duration=0.3, steps=10)
    found = [
        online_controller(
            problem, default=lambda t, at=at: [3.0 * (t > at)], backend=backend
        ).actions([0.5], schedule=True)
        for at in (0.46, 0.86, 0.06)
    ]
    times = [float(one.application_time) for one in found]
    np.testing.assert_allclose(times, [0.5, 0.9, 0.1])
    np.testing.assert_allclose([one.start for one in found], [0.2, 0.6, 0.0], atol=1e-12)
    np.testing.assert_allclose([one.duration for one in found], [0.6, 0.4, 0.4])
    assert np.array_equal(found[0].schedule, -np.ones((11, 1)))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_feedforward_signal_is_taken_at_the_right_time(backend):
    asked = []

    def signal(time):
        asked.append(time)
        return [np.cos(time)]

    controller = online_controller(line(), default=signal, backend=backend)
    asked.clear()
    found = controller.actions([0.1], time=2.0)
    middles = [2.125, 2.375, 2.625, 2.875]
    np.testing.assert_allclose(sorted(asked)[-5:], [2.0, *middles])
    assert found.base == np.cos(2.0)
    assert found.cost == pytest.approx((0.1 + np.cos(middles).mean()) ** 2)
    early = controller.actions([0.1], time=0.0)
    assert early.base == 1.0
    assert controller(2.0, [[0.1]]).shape == (1, 1)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("default", "symbol"), [(0.0, -1), (2.0, 0)])
def test_where_an_action_makes_no_difference_the_least_effort_wins(backend, default, symbol):
    problem = Problem(
        name="sideways",
        dynamics=lambda x, u: [u[0], 0 * x[1]],
        domain=Box([-1, -1], [1, 1]),
        alphabet=[1.0],
        default=default,
        horizon=1e-9,
        terminal_cost=lambda x: x[0] ** 2 + x[1] ** 2,
        settings=SsacSettings(steps=2, control_weight=1.0, on_no_descent="default"),
    )
    controller = online_controller(problem, backend=backend)
    states = [[1e-7, 1.0], [-1e-7, 1.0], [0.3, 1.0], [-0.3, 1.0]]
    found = controller.actions(states).symbol
    assert np.array_equal(found, controller.numpy.chooser.symbols(np.array(states)))
    assert found[:2].tolist() == [symbol] * 2 and set(found[2:]) == {-1, 0}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("backend", BACKENDS)
def test_an_infinite_prediction_is_no_reason_to_act(backend):
    problem = relay_problem(
        horizon=1.0,
        running_cost=None,
        terminal_cost=lambda x: 1e308 * x[0],
        settings=SsacSettings(steps=4, alpha_d=-1.0, control_weight=1.0, initial_duration=1.0),
    )
    controller = online_controller(problem, "sac", limits=(-1, -0.5), backend=backend)
    found = controller.actions([[2.0], [1.0]])
    assert np.isinf(found.cost[0]) and (found.gradient < 0).all()
    assert found.duration.tolist() == [0.0, 1.0]


def test_calling_gives_the_control_that_acts_at_once():
    problem = with_settings(PENDULUM, application_time="search")
    controller = online_controller(problem, default=1.5)
    states = problem.domain.sample(200, 6).reshape(4, 50, 2)
    found = controller.actions(states)
    controls = controller(0.0, states)
    assert controls.shape == (4, 50, 1)
    at_once = (found.duration > 0) & (found.start == 0)
    assert at_once.any() and not at_once.all()
    assert np.array_equal(controls[at_once], found.control[at_once])
    assert (controls[~at_once] == 1.5).all()


@pytest.mark.parametrize("case", ["search", "now", "policy, nearest", "feedforward", "sac, search"])
@pytest.mark.parametrize("delay", [0.0, 0.07])
def test_loops_run_default_control_action_default_control(case, delay):
    problem, controller, _ = build(case, "c")
    rate, samples, state = 5, 6, np.array([2.0, 1.0])
    found = simulate(controller, state, samples / rate, rate, delay=delay)
    timeline, symbols, switches, x = [(-1.0, controller.default)], [], -1, state
    for k in range(samples):
        action, now = controller.actions(x, time=k / rate), k / rate + delay
        first = action.base
        if action.duration > 0:
            if action.start > 0:
                timeline.append((now, action.base))
            else:
                first = action.control
            stop = action.start + action.duration
            if action.start < 1 / rate:
                timeline.append((now + action.start, action.control))
            if stop < 1 / rate:
                timeline.append((now + stop, action.base))
        else:
            timeline.append((now, action.base))
        assert np.array_equal(found.controls[k], first)
        at_once = action.duration > 0 and action.start == 0
        symbols.append(int(action.symbol if at_once else action.base_symbol))
        x, _ = integrate(problem, x, timeline, k / rate, (k + 1) / rate)
        np.testing.assert_allclose(found.states[k + 1], x, rtol=1e-6, atol=1e-7)
        x = found.states[k + 1]
    assert found.symbols.tolist() == symbols
    controls = [u for _, u in timeline[1:]]
    switches = sum((a != b).any() for a, b in zip(controls, controls[1:]))
    assert found.switches == switches


@pytest.mark.parametrize("dwell", [0.1, 0.3])
def test_with_a_dwell_time_an_action_is_held(dwell):
    controller = online_controller(line(initial_duration=0.05), backend="numpy")
    found = simulate(controller, [[0.33], [-0.33]], 1.2, 10, min_dwell=dwell)
    assert found.controls[0, 0] == -1.0 and found.controls[1, 0] == 1.0
    np.testing.assert_allclose(found.states[:, 3, 0], [0.03, -0.03], atol=1e-9)
    for k in range(2):
        changes = np.flatnonzero(np.diff(found.controls[k, :, 0])) + 1
        assert found.switches[k] == len(changes) > 0
        assert np.diff(np.concatenate([[0], changes])).min() >= round(dwell * 10)


def test_the_dwell_time_of_the_source_is_the_default():
    problem = line(initial_duration=0.05).replace(min_dwell=0.3)
    for source in (problem, relay(min_dwell=0.3)):
        controller = online_controller(source, backend="numpy")
        own, told, none = (
            simulate(controller, [0.33], 1.2, 10, **options)
            for options in ({}, {"min_dwell": 0.3}, {"min_dwell": 0.0})
        )
        assert controller.min_dwell == 0.3 and np.array_equal(own.states, told.states)
        assert not np.array_equal(own.states, none.states)


def test_loops_do_not_depend_on_the_others():
    controller = online_controller(with_settings(PENDULUM, application_time="search"))
    states = PENDULUM.domain.sample(20, 2)
    options = {"target": PENDULUM.target, "stop_at_target": True, "delay": 0.013}
    found = simulate(controller, states, 1, 20, **options)
    for k in (0, 7, 19):
        one = simulate(controller, states[k], 1, 20, **options)
        assert np.array_equal(one.states, found.states[k], equal_nan=True)
        assert one.switches == found.switches[k] and one.ended == found.ended[k]


def test_the_source_may_be_a_policy_with_a_model():
    problem = with_settings(PENDULUM)
    policy = random_grid_policy(problem)
    states = PENDULUM.domain.sample(50, 4)
    close(online_controller(policy).actions(states), online_controller(problem).actions(states))
    own = online_controller(policy)
    assert own.target == policy.target and own.horizon == 1.2
    other = online_controller(policy, horizon=0.5, settings=SsacSettings(steps=3, rule="steepest"))
    same = online_controller(
        problem.replace(horizon=0.5, settings=SsacSettings(steps=3, rule="steepest"))
    )
    close(other.actions(states), same.actions(states))


def test_steps_are_chosen_where_none_are_given():
    controller = online_controller(PENDULUM, backend="numpy")
    assert controller.steps == controller.settings.steps == controller.numpy.chooser.settings.steps
    assert controller.actions([1.0, 2.0], schedule=True).schedule.shape == (controller.steps + 1, 1)


@pytest.fixture(scope="module")
def swing_up():
    """Return the pendulum's policy, and how it and the policy as background do from 200 states."""
    policy = synthesize(PENDULUM)
    controller = online_controller(PENDULUM, default=policy, horizon=0.6)
    states = PENDULUM.domain.sample(200, 11)
    return [simulate(c, states, 10, 50) for c in (controller, policy)]


def energy(states):
    return 2 * states[..., 1] ** 2 + 9.81 * 2 * (np.cos(states[..., 0]) - 1)


def test_a_policy_as_default_swings_up_from_everywhere(swing_up):
    found, _ = swing_up
    error = np.abs(energy(found.states))
    assert (error <= 0.05 * 4 * 9.81).any(axis=1).all()
    assert (found.arrived < 10).all() and set(found.ended) == {"time"}


def test_a_policy_as_default_is_no_worse_than_the_policy_alone(swing_up):
    means = [(0.5 * energy(found.states) ** 2).mean() for found in swing_up]
    assert means[0] <= means[1]


MIXED = relay_problem(dynamics=lambda x, u: [ca.sin(u[0])])
REFUSED = [
    ((relay_problem(), "mpc"), {}, "`method` must be one of 'ssac', 'sac'; got 'mpc'"),
    ((relay_problem(),), {"backend": "gpu"}, "`backend` must be one of"),
    ((3,), {}, "`source` must be a Problem or a Policy with a model; got 3"),
    ((relay(model=None),), {}, "`source` must be a Problem or a Policy with a model; got"),
    ((relay(settings=None),), {}, "`horizon` and `settings` must be given for a policy without"),
    ((relay(horizon=None),), {}, "`horizon` and `settings` must be given for a policy without"),
    ((relay_problem(),), {"horizon": 0}, "`horizon` must be a finite number > 0; got 0"),
    ((relay_problem(),), {"settings": {"steps": 3}}, "`settings` must be a"),
    (
        (relay_problem(),),
        {"default": [0, 0]},
        "`default` must have shape (1,), one entry per input",
    ),
    ((relay_problem(),), {"default": [np.nan]}, "`default` must be finite"),
    ((relay_problem(),), {"default": "off"}, "`default` must be numbers; got 'off'"),
    ((relay_problem(),), {"default": lambda t: [t, t]}, "`default` must have shape (1,)"),
    (
        (PENDULUM,),
        {"default": relay()},
        "`default` must be a policy of 2 state(s) and 1 input(s); got 1 and 1",
    ),
    (
        (relay_problem(),),
        {"settings": SsacSettings(control_weight=[[1, 0], [0, 1]])},
        "`control_weight` must be a number or have shape (1, 1)",
    ),
    ((MIXED, "sac"), {}, "`dynamics` must be affine in u for the method 'sac'"),
    (
        (relay_problem(), "sac"),
        {},
        "`control_weight` must be positive definite for the method 'sac'",
    ),
    (
        (TWO_INPUTS, "sac"),
        {"settings": SsacSettings(control_weight=[[1, 1], [1, 1]])},
        "`control_weight` must be positive definite for the method 'sac'",
    ),
    ((PENDULUM, "sac"), {"limits": 3}, "`limits` must be (lower, upper); got 3"),
    ((PENDULUM, "sac"), {"limits": (1, 2, 3)}, "`limits` must be (lower, upper); got (1, 2, 3)"),
    ((PENDULUM, "sac"), {"limits": ([1, 2], [3, 4])}, "`limits` must have shape (1,)"),
    ((PENDULUM, "sac"), {"limits": (2, 1)}, "`limits` must have lower <= upper; got (2, 1)"),
    ((PENDULUM, "sac"), {"limits": (-np.inf, 1)}, "`limits` must be finite"),
]


@pytest.mark.parametrize(("arguments", "options", "message"), REFUSED)
def test_refusals_come_before_any_work(arguments, options, message, monkeypatch):
    from capsyn.controllers import online

    def work(*_, **__):
        raise AssertionError("work before the arguments are known to be good")

    monkeypatch.setattr(online, "batch_controller", work)
    with pytest.raises(ProblemError) as caught:
        online_controller(*arguments, **options)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


@pytest.mark.parametrize("states", [0.5, [0.5, 0.5], [["a"]]])
def test_states_of_another_shape_are_refused(states):
    controller = online_controller(relay_problem(), backend="numpy")
    with pytest.raises(ProblemError, match="`states` must"):
        controller.actions(states)


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_states_have_no_actions(backend):
    controller = online_controller(relay_problem(), backend=backend)
    found = controller.actions(np.zeros((0, 1)), schedule=True)
    assert found.symbol.shape == (0,) and found.schedule.shape == (0, 5, 1)


@pytest.mark.parametrize(
    "rates",
    [
        lambda x, u: [u[0] * u[1], x[0]],
        lambda x, u: [x[0], u[1] ** 2],
        lambda x, u: [ca.fmax(u[0], 0), x[0]],
        lambda x, u: [x[0] / (2 + u[0]), x[1]],
        lambda x, u: [ca.if_else(u[0] > 0, x[0], x[1]), x[1]],
    ],
)
def test_sac_refuses_what_is_not_affine(rates):
    with pytest.raises(ProblemError, match="`dynamics` must be affine in u for the method 'sac'"):
        online_controller(with_settings(TWO_INPUTS).replace(dynamics=rates), "sac")


def test_sac_takes_what_is_affine_and_switched():
    problem = with_settings(TWO_INPUTS).replace(
        dynamics=lambda x, u: [
            ca.if_else(x[0] > 0, u[0], -2 * u[1]) / (1 + x[1] ** 2),
            ca.sin(x[0]) - 3 * u[1] + 1,
        ]
    )
    controller = online_controller(problem, "sac")
    assert np.isfinite(controller.actions(problem.domain.sample(50)).control).all()


def test_a_linear_sac_has_the_answer_of_the_formula_at_once():
    problem = linear_problem(2).replace(settings=SsacSettings(steps=6, control_weight=2.0))
    controller = online_controller(problem, "sac", limits=([-99, -99], [99, 99]))
    states = problem.domain.sample(20, 2)
    found = controller.actions(states)
    step = 1e-6 * np.eye(2)
    for k, x in enumerate(states):
        after, before = (controller.actions(x + sign * step).cost for sign in (1, -1))
        rho = (after - before) / 2e-6  # and h is the identity
        size = np.outer(rho, rho)
        wanted = np.linalg.solve(
            size + 2 * np.eye(2), size @ problem.default - 5 * found.cost[k] * rho
        )
        np.testing.assert_allclose(found.control[k], wanted, rtol=1e-5, atol=1e-7)
        assert found.symbol[k] == -2


def test_it_works_without_a_compiler(monkeypatch):
    from capsyn.controllers.action_kernel import ActionKernel

    def fail(*_):
        raise KernelBuildError("no compiler")

    monkeypatch.setattr(ActionKernel, "build", staticmethod(fail))
    with pytest.warns(CapsynWarning, match="solving with NumPy"):
        assert online_controller(relay_problem()).kernel is None
    with pytest.raises(KernelBuildError):
        online_controller(relay_problem(), backend="c")
