"""Closed loops by hand-made policies: dwell, delay, rules, endings; both backends, any grouping."""

from __future__ import annotations

import dataclasses
from contextlib import nullcontext as nothing

import casadi as ca
import numpy as np
import pytest

from capsyn import Ball, Box, simulate
from capsyn.controllers.command import NONE
from capsyn.errors import CapsynWarning
from capsyn.simulation import closed_loop, policy_loop
from capsyn.simulation.closed_loop import new_trials
from capsyn.simulation.experiment import set_up
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import plant_of
from support.closed_loops import (
    BACKENDS,
    grid_policy,
    linear_problem,
    random_grid_policy,
    relay,
    relay_problem,
    smooth_problems,
)

LINEAR = random_grid_policy(linear_problem())
NAN = float("nan")
both = pytest.mark.parametrize("backend", BACKENDS)


def same(one, two, rows=None, exact=True):
    """Assert that two trajectories are equal, or nearly so."""
    for name, a in vars(one).items():
        if name == "times" or not isinstance(a, np.ndarray | np.generic):
            continue
        a, b = (a if rows is None else a[rows]), np.asarray(getattr(two, name))
        a = np.asarray(a)
        if exact or a.dtype.kind != "f":
            assert a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), name
        else:
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=name)


LOOPS = {
    "plain": {},
    "delay": {"delay": 0.2},
    "delay of a part": {"delay": 0.0333},
    "delay of samples and a part": {"delay": 0.2777},
    "dwell": {"min_dwell": 0.25},
    "disturbance": {"disturbance": [0.1, -0.2, 0.05], "delay": 0.0777},
    "disturbance in time": {"disturbance": lambda t: [np.sin(t), 0.1, -t]},
    "noise": {"noise": [0.1, 0.0, 0.4], "seed": 3, "delay": 0.1234, "min_dwell": 0.15},
    "error": {"outside": "error", "noise": 0.2},
    "symbol": {"outside": 1, "noise": 0.2},
    "at once": {"outside": 1, "noise": 0.2, "min_dwell": 0.45, "outside_at_once": True},
    "default": {"outside": -1, "noise": 0.2, "disturbance": 0.3},
    "target": {"target": Ball([0.3, 0.3, 0.3], 0.4)},
    "stop": {"target": Box([0, 0, -1], [1, 1, 1]), "stop_at_target": True, "delay": 0.05},
    "parameters": {
        "model": lambda x, u, p: [p[0] * u[0] - x[1], u[1] + p[1] * x[0], u[2]],
        "parameters": {"a": 1.3, "b": -0.7},
        "delay": 0.111,
    },
}


@pytest.mark.parametrize("loop", LOOPS)
def test_compiled_is_numpy_to_the_last_bit_without_library_functions(loop):
    states = np.vstack([LINEAR.domain.sample(60, 1), [[-2, 0.5, 0.5], [0.5, 0.5, 1.5]]])
    options = {"substeps": 3} | LOOPS[loop]
    one, two = (simulate(LINEAR, states, 3, 10, backend=b, **options) for b in BACKENDS)
    same(one, two)
    assert one.switches.max() > 3 and np.isfinite(one.states[:, 0]).all()


@pytest.mark.parametrize("name", ["pendulum", "tank"])
def test_compiled_is_numpy_nearly_with_library_functions(name):
    policy = random_grid_policy(smooth_problems()[name])
    states = policy.domain.sample(40, 1)
    options = {"substeps": 3, "delay": 0.037, "noise": 0.02, "disturbance": 0.01}
    one, two = (simulate(policy, states, 0.5, 20, backend=b, **options) for b in BACKENDS)
    same(one, two, exact=False)


@pytest.mark.parametrize("count", [1, 31, 32, 33, 100])
@both
def test_a_trial_does_not_see_the_others(backend, count):
    states = LINEAR.domain.sample(100, 2)
    options = {"substeps": 2, "delay": 0.133, "min_dwell": 0.15, "target": Ball([0, 0, 0], 0.6)}
    options |= {"stop_at_target": True, "outside": "error", "noise": 0.1}
    whole = simulate(LINEAR, states, 2, 10, backend=backend, **options)
    part = simulate(LINEAR, states[:count], 2, 10, backend=backend, **options)
    same(whole, part, slice(count))
    assert {"target", "left the domain", "time"} >= set(whole.ended) and len(set(whole.ended)) > 1
    if count == 1:
        del options["noise"]
        whole = simulate(LINEAR, states, 2, 10, backend=backend, **options)
        for k in (0, 37, 99):
            same(whole, simulate(LINEAR, states[k], 2, 10, backend=backend, **options), k)


@pytest.mark.parametrize("threads", [1, 2, 3, 7, 200])
def test_threads_change_nothing(threads):
    states = LINEAR.domain.sample(100, 2)
    options = {"substeps": 2, "noise": 0.1, "seed": 5, "disturbance": 0.1, "delay": 0.07}
    few, many = (simulate(LINEAR, states, 2, 10, threads=k, **options) for k in (1, threads))
    same(few, many)


@pytest.mark.parametrize("size", [1, 1000, 8 * 70 * 3 * 7, 8 * 32 * 3 * 20])
@both
def test_how_much_noise_is_drawn_ahead_changes_nothing(backend, size, monkeypatch):
    states = LINEAR.domain.sample(70, 2)
    options = {"substeps": 1, "noise": 0.1, "delay": 0.24, "disturbance": lambda t: t - 1}
    options |= {"min_dwell": 0.2, "target": Ball([0, 0, 0], 0.6), "backend": backend}
    once = simulate(LINEAR, states, 2, 10, **options)
    for module in (closed_loop, policy_loop):
        monkeypatch.setattr(module, "NOISE_BYTES", size)
    same(once, simulate(LINEAR, states, 2, 10, threads=2, **options))


@both
def test_noise_is_gaussian_on_what_the_controller_sees(backend):
    # far enough from the relay's edge at 0, the share of wrong symbols is that of the normal law
    policy = relay((1, 0), outside="nearest")
    still = {"model": lambda x, u: [0 * u[0]], "substeps": 1, "noise": 0.5, "backend": backend}
    found = simulate(policy, np.full((50, 1), 0.5), 20, 10, **still)
    assert np.mean(found.symbols == 1) == pytest.approx(0.1587, abs=0.01)
    assert (found.states == 0.5).all(), "the state itself has no noise"
    assert np.mean(found.outside) / 200 == pytest.approx(0.16, abs=0.01)
    again = simulate(policy, np.full((50, 1), 0.5), 20, 10, **still)
    same(found, again)
    other = simulate(policy, np.full((50, 1), 0.5), 20, 10, seed=1, **still)
    assert not np.array_equal(found.symbols, other.symbols)
    assert len({row.tobytes() for row in found.symbols}) == 50, "every trial has its own stream"
    quiet = simulate(policy, np.full((3, 1), 0.5), 20, 10, **still | {"noise": 0.0})
    assert (quiet.symbols == 0).all()


def test_noise_of_one_state_stays_there():
    problem = linear_problem(2)
    policy = grid_policy(problem, [0, 1, 0, 1], [2, 2])  # by the second state alone
    found = simulate(policy, [0.1, 0.5], 2, 10, noise=[5.0, 0.0], model=lambda x, u: [0, 0 * u[0]])
    assert (found.symbols == 1).all() and found.outside > 10


def relay_run(labels, x0, duration, backend, rate=10, **options):
    options = {"substeps": 1, "outside": "nearest"} | options
    return simulate(relay(labels), [x0], duration, rate, backend=backend, **options)


@both
def test_a_relay_by_hand(backend):
    found = relay_run([0, 1], -0.25, 1.0, backend)
    assert found.symbols.tolist() == [0, 0, 0, 1, 0, 1, 0, 1, 0, 1]
    assert found.controls.ravel().tolist() == [1, 1, 1, -1, 1, -1, 1, -1, 1, -1]
    np.testing.assert_allclose(
        found.states.ravel(), [-0.25, -0.15, -0.05, *[0.05, -0.05] * 4], atol=1e-14
    )
    assert found.switches == 7 and found.ended == "time" and found.last == 10
    assert found.outside == 0 and np.isnan(found.arrived)
    assert found.times.tolist() == (np.arange(11) / 10).tolist()


@both
def test_the_first_command_is_no_switch_even_of_the_control_zero(backend):
    for labels, switches in (([2, 2], 0), ([2, 1], 0), ([0, 2], 1)):
        found = relay_run(labels, -0.05, 0.5, backend)
        assert found.switches == switches
    assert found.symbols.tolist() == [0, -1, -1, -1, -1]
    assert found.controls.ravel().tolist() == [1, 0, 0, 0, 0]


@both
def test_symbols_of_one_control_are_no_switch(backend):
    problem = relay_problem(default=1.0)  # the default is what symbol 0 is, too
    policy = grid_policy(problem, [0, 2], [2], outside="nearest")
    found = simulate(policy, [-0.25], 0.6, 10, backend=backend, substeps=1, min_dwell=0.5)
    assert found.symbols.tolist() == [0, 0, 0, -1, -1, -1] and found.switches == 0


@pytest.mark.parametrize(
    ("dwell", "rate", "samples"),
    [
        (0.0, 10, 1),
        (1e-12, 10, 1),
        (0.1, 10, 1),
        (0.1000001, 10, 2),
        (0.15, 10, 2),
        (0.2, 10, 2),
        (0.3, 10, 3),
        (0.29, 100, 29),
        (0.07, 100, 7),
        (0.0025, 400, 1),
        (1e300, 10, None),
    ],
)
@both
def test_controls_are_held_for_the_dwell_time_rounded_up(backend, dwell, rate, samples):
    policy = relay([0, 1])
    chatter = {"model": lambda x, u: [u[0] * 1e3], "outside": "nearest", "substeps": 1}
    told = (
        pytest.warns(CapsynWarning, match="longer than the run") if samples is None else nothing()
    )
    with told:
        found = simulate(
            policy, [-0.1], 100 / rate, rate, min_dwell=dwell, backend=backend, **chatter
        )
    changes = np.flatnonzero(np.diff(found.symbols)) + 1
    assert found.switches == len(changes)
    if samples is None:
        assert len(changes) == 0
    else:
        held = np.diff(np.concatenate([[0], changes]))
        assert held.min() == samples and held[0] == samples


@both
def test_dwell_counts_from_the_last_switch_not_the_last_command(backend):
    # what is wanted by sample: 0 0 0 0 1 1 0 0 ..; at sample 6 the control is 2 samples old
    def wanted(k):
        return -0.5 if k not in (4, 5) else 0.5

    places = [wanted(k) for k in range(12)]
    model = {"model": lambda x, u: [0 * u[0]], "substeps": 1, "backend": backend}

    def jump(t):
        k = round(t * 10)
        return [(places[k + 1] - places[k]) * 10] if k < 11 else [0.0]

    for dwell, symbols in {
        0.0: [0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0],
        0.2: [0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0],
        0.3: [0, 0, 0, 0, 1, 1, 1, 0, 0, 0, 0],
        0.4: [0, 0, 0, 0, 1, 1, 1, 1, 0, 0, 0],
        0.5: [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 0],
        0.6: [0] * 11,
    }.items():
        found = simulate(relay([0, 1]), [-0.5], 1.1, 10, disturbance=jump, min_dwell=dwell, **model)
        assert found.symbols.tolist() == symbols, dwell


@both
def test_the_dwell_time_of_the_policy_is_the_default(backend):
    slow = relay([0, 1], min_dwell=0.4, outside="nearest")
    found = simulate(slow, [-0.05], 2, 10, backend=backend, substeps=1)
    assert found.symbols[:9].tolist() == [0] * 4 + [1] * 4 + [0]
    found = simulate(slow, [-0.05], 2, 10, backend=backend, substeps=1, min_dwell=0.0)
    assert found.symbols[:4].tolist() == [0, 1, 0, 1]


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.3, 0.05, 0.025, 0.325, 0.7999999999999999, 5.0])
@both
def test_the_plant_gets_each_control_after_the_delay(backend, delay):
    policy = grid_policy(relay_problem(default=3.0), [0, 1], [2], outside="nearest")
    found = simulate(policy, [-0.9], 3, 10, delay=delay, backend=backend, substeps=1)
    times = np.arange(31) / 10
    controls = found.controls.ravel()

    def integral(until):
        """Of the control that acts, up to a time."""
        total = 3.0 * min(until, delay)
        for k, u in enumerate(controls):
            total += u * min(max(until - delay - times[k], 0), 0.1)
        return total

    wanted = -0.9 + np.array([integral(t) for t in times])
    np.testing.assert_allclose(found.states[:, 0], wanted, atol=1e-12)
    assert found.controls[0] == 1.0, "what the controller gave, not what acts"


@both
def test_a_delay_beyond_the_experiment_needs_no_memory(backend):
    found = simulate(relay(), [-0.9], 1, 1000, delay=1e9, backend=backend, substeps=1)
    assert (found.states == -0.9).all()


@both
@pytest.mark.parametrize(
    ("rule", "symbols", "outside", "ended", "last"),
    [
        ("nearest", [1, 1, 1, 1, 1, 1], 3, "time", 6),
        ("error", [1, 1, 1, -2, -2, -2], 1, "left the domain", 3),
        (0, [1, 1, 1, 0, 1, 0], 2, "time", 6),
        ("1.0", [1, 1, 1, 0, 1, 0], 2, "time", 6),
        (-1, [1, 1, 1, -1, -1, -1], 3, "time", 6),
    ],
)
def test_rules_outside_the_domain(backend, rule, symbols, outside, ended, last):
    policy = relay([1, 1])
    rule = policy.alphabet.names[0] if rule == "1.0" else rule
    found = simulate(policy, [-0.75], 0.6, 10, outside=rule, backend=backend, substeps=1)
    assert found.symbols.tolist() == symbols
    assert (found.outside, found.ended, found.last) == (outside, ended, last)
    assert np.isnan(found.states[last + 1 :]).all() and np.isnan(found.costs[last + 1 :]).all()
    assert np.isfinite(found.states[: last + 1]).all()
    assert np.isnan(found.controls[last:]).all() and np.isfinite(found.controls[:last]).all()
    own = simulate(
        dataclasses.replace(policy, outside=rule), [-0.75], 0.6, 10, backend=backend, substeps=1
    )
    same(found, own)


@both
def test_the_measured_state_is_what_is_outside(backend):
    policy, still = relay([0, 1]), {"model": lambda x, u: [0 * u[0]], "substeps": 1}
    found = simulate(policy, [0.9], 5, 10, noise=0.2, outside="nearest", backend=backend, **still)
    assert 5 < found.outside < 45 and (found.states == 0.9).all()
    found = simulate(policy, [0.9], 5, 10, noise=0.2, outside="error", backend=backend, **still)
    assert found.ended == "left the domain" and found.outside == 1
    found = simulate(policy, [0.9], 5, 10, noise=0.2, outside=-1, backend=backend, **still)
    assert found.outside == (found.symbols == -1).sum()
    found = simulate(policy, [9.0], 1, 10, outside="nearest", backend=backend, **still)
    assert found.outside == 10 and found.symbols.tolist() == [1] * 10


@both
@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize(
    ("rule", "ended"), [("nearest", "not finite"), ("error", "not finite"), (0, "time")]
)
def test_a_measurement_that_is_not_finite(backend, rule, ended):
    still = {"model": lambda x, u: [0 * u[0]], "substeps": 1, "noise": 1.7e308, "seed": 8}
    found = simulate(relay([1, 1]), np.zeros((9, 1)), 5, 10, outside=rule, backend=backend, **still)
    if rule != "error":
        assert set(found.ended) == {ended}
    else:
        assert set(found.ended) <= {"not finite", "left the domain"}
    assert np.isfinite(found.states[:, 0]).all() and (found.outside >= 1).all()


@both
def test_a_finite_escape_ends_as_not_finite(backend):
    problem = relay_problem(
        dynamics=lambda x, u: [x[0] ** 2 + 0 * u[0]], domain=Box([-4], [4], names=["x"])
    )
    policy = grid_policy(problem, [0, 1], [2], outside="nearest", target=Ball([0], 0.01))
    found = simulate(policy, [[1.0], [-1.0], [0.5], [0.0]], 5, 10, backend=backend, substeps=4)
    assert found.ended.tolist() == ["not finite", "time", "not finite", "time"]
    assert 9 <= found.last[0] <= 12 and 19 <= found.last[2] <= 22
    assert not np.isfinite(found.states[0, found.last[0]]).all()
    for k in (0, 2):
        last = found.last[k]
        assert np.isfinite(found.states[k, :last]).all()
        assert np.isnan(found.states[k, last + 1 :]).all()
        assert (found.symbols[k, last:] == NONE).all() and (found.symbols[k, :last] != NONE).all()
    assert found.arrived.tolist()[3] == 0.0 and np.isnan(found.arrived[:3]).all()
    np.testing.assert_allclose(found.states[1, :, 0], -1 / (1 + found.times), rtol=1e-4)


@both
def test_a_state_that_is_not_finite_is_in_no_target(backend):
    problem = relay_problem(dynamics=lambda x, u: [x[0] ** 2 + 0 * u[0]])
    policy = grid_policy(problem, [0, 1], [2], outside="nearest")
    options = {"backend": backend, "substeps": 2, "stop_at_target": True}
    for beyond in (
        lambda x: ca.logic_not(ca.fabs(x[0]) < 1e300),
        lambda x: ca.logic_not(x[0] < 1e300),
    ):
        found = simulate(policy, [[0.9], [0.8]], 5, 10, target=beyond, **options)
        assert set(found.ended) == {"not finite"} and np.isnan(found.arrived).all()


def test_delays_are_whole_samples_and_a_rest():
    delays = np.array([0, 0.1, 0.2, 0.3, 0.7999999999999999, 0.7, 0.25, 1e-12, 0.0999])
    none = np.zeros((9, 0))
    trials = new_trials(np.zeros((9, 2)), 3, delays, none, np.zeros((9, 2)), 0.1)
    assert trials["delay"].tolist() == [0, 1, 2, 3, 8, 7, 2, 0, 0]
    np.testing.assert_allclose(trials["rest"], [0] * 6 + [0.05, 0, 0.0999], atol=1e-15)
    assert (trials["rest"][[0, 1, 2, 3, 4, 5, 7]] == 0).all(), "nothing too short to integrate"
    assert trials["queue"].shape == (9, 16, 3)
    few = new_trials(np.zeros((1, 2)), 3, np.array([0.2]), none[:1], np.zeros((1, 2)), 0.1)
    assert few["queue"].shape == (1, 4, 3), "a power of two above the delay"


def test_trials_with_delays_of_their_own_are_the_same_in_any_group():
    states = LINEAR.domain.sample(70, 3)
    options = {"outside": "nearest", "target": Ball([0, 0, 0], 0.6), "substeps": 2}
    delays = np.tile([0.05, 0.1, 0.233, 0.0, 0.2], 14)
    delays[[31, 63, 69]] = 0.0  # the last of each block has no part of a sample

    def after(rows, backend):
        loop = LoopOptions(2.0, 10, backend=backend, threads=1, **options)
        experiment = set_up(LINEAR, plant_of(LINEAR), loop)
        trials = experiment.trials(states[rows], delays[rows], np.zeros((len(rows), 0)))
        experiment.run(trials, None, None)
        return trials[[name for name in trials.dtype.names if name not in ("queue", "parameters")]]

    everyone = np.arange(70)
    whole = {backend: after(everyone, backend) for backend in BACKENDS}
    assert (whole["c"]["symbol"] == -1).any()
    for name in whole["c"].dtype.names:
        assert np.array_equal(whole["c"][name], whole["numpy"][name]), name
    for backend in BACKENDS:
        for rows in (everyone[::-1], everyone[:1], everyone[7:23]):
            assert np.array_equal(after(rows, backend), whole[backend][rows])


@both
def test_a_start_in_the_target_outside_and_at_the_last_sample(backend):
    policy = relay([1, 1], target=Ball([0.0], 0.05))
    options = {"backend": backend, "substeps": 1, "stop_at_target": True}
    found = simulate(policy, [[0.0], [0.34], [-0.9], [0.5], [0.95]], 0.5, 10, **options)
    assert found.ended.tolist() == ["target", "target", "left the domain", "target", "time"]
    assert found.last.tolist() == [0, 3, 2, 5, 5]
    np.testing.assert_array_equal(found.arrived, [0.0, 0.3, NAN, 0.5, NAN])
    assert found.symbols[0].tolist() == [-2] * 5
    found = simulate(policy, [[0.0], [0.34]], 0.5, 10, **options | {"stop_at_target": False})
    assert found.ended.tolist() == ["time"] * 2 and found.arrived.tolist() == [0.0, 0.3]
    found = simulate(policy, [0.7], 0.3, 10, **options | {"target": Ball([0.7], 0.15)})
    assert (found.arrived, found.last) == (0.0, 0)


@both
def test_the_target_counts_before_the_rule_outside(backend):
    policy = relay([1, 1])
    options = {"backend": backend, "substeps": 1, "outside": "error"}
    found = simulate(policy, [3.0], 1, 10, target=Ball([2], 1.5), stop_at_target=True, **options)
    assert found.ended == "target"
    found = simulate(policy, [3.0], 1, 10, target=Ball([2], 1.5), **options)
    assert (found.ended, found.arrived, found.outside) == ("left the domain", 0.0, 1)


@both
def test_targets_on_a_circle_in_named_axes_and_as_conditions(backend):
    problem = relay_problem(
        dynamics=lambda x, u: [1.0, u[0]],
        domain=Box([0, -9], [1, 9], names=["angle", "speed"], periodic=[True, False]),
        running_cost=lambda x: x[1] ** 2,
    )
    policy = grid_policy(problem, [0] * 1, [1, 1])
    options = {"backend": backend, "substeps": 1}

    def arrives(target, x0):
        return float(simulate(policy, x0, 0.9, 100, target=target, **options).arrived)

    ball = Ball([0.0], 0.105, names=["angle"])
    assert arrives(ball, [0.5, 0]) == pytest.approx(0.40)
    assert arrives(ball, [0.95, 0]) == 0.0 == arrives(ball, [7.05, 0])
    assert arrives(Ball([3.0, 0.0], 0.105), [0.5, -0.4]) == pytest.approx(0.40)
    assert arrives(Box([0.9], [1.1], names=["angle"]), [0.5, 0]) == pytest.approx(0.40, abs=0.011)
    assert arrives(Box([0.7], [0.81], names=["speed"]), [0.5, 0]) == pytest.approx(0.7, abs=0.011)
    assert arrives(lambda x: x[0] + x[1] > 2.005, [0.5, 0]) == pytest.approx(0.76)
    assert arrives(lambda x: ca.logic_and(x[1] > 1, x[0] > 9), [0.5, 0]) != 0.0


@both
def test_trials_that_ended_stay_as_they_are(backend):
    policy = relay([1, 1], target=Ball([-0.5], 0.05))
    found = simulate(
        policy, [[-0.4], [0.9]], 1, 10, stop_at_target=True, backend=backend, substeps=1
    )
    assert found.last.tolist() == [1, 10]
    np.testing.assert_allclose(found.costs[0, :2], [0, 0.1 * (0.16 + 4 * 0.2025 + 0.25) / 6])
    assert np.isnan(found.costs[0, 2:]).all() and found.switches.tolist() == [0, 0]


@both
@pytest.mark.parametrize("shape", [(0, 1), (2, 0, 1)])
def test_no_states_at_all(backend, shape):
    found = simulate(relay(), np.zeros(shape), 1, 10, backend=backend, substeps=1, noise=0.1)
    assert found.states.shape == (*shape[:-1], 11, 1) and found.cost.shape == shape[:-1]


def test_trajectories_need_no_compiler(monkeypatch):
    from capsyn.errors import CapsynWarning, KernelBuildError
    from capsyn.simulation.kernel import SimulationKernel

    def fail(*_):
        raise KernelBuildError("no compiler", ["cc"], "")

    good = simulate(LINEAR, [0.1, 0.2, 0.3], 1, 10, backend="numpy", substeps=1)
    monkeypatch.setattr(SimulationKernel, "build", staticmethod(fail))
    with pytest.warns(CapsynWarning, match="simulating with NumPy"):
        same(good, simulate(LINEAR, [0.1, 0.2, 0.3], 1, 10, substeps=1))
    with pytest.raises(KernelBuildError):
        simulate(LINEAR, [0.1, 0.2, 0.3], 1, 10, backend="c", substeps=1)
