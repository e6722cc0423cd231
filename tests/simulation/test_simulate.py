"""Trajectories: against SciPy under the same switching, shapes, costs, files, refusals."""

from __future__ import annotations

import csv
import dataclasses
import json

import casadi as ca
import numpy as np
import pytest

from capsyn import Ball, Box, online_controller, problems, simulate
from capsyn.errors import CapsynError, ProblemError
from support.closed_loops import (
    BACKENDS,
    grid_policy,
    integrate,
    linear_problem,
    random_grid_policy,
    relay,
    relay_problem,
    smooth_problems,
)

PROBLEMS = smooth_problems()
POLICIES = {name: random_grid_policy(problem) for name, problem in PROBLEMS.items()}
GAIN = np.array([[0.5, 0.1, 2], [0, 1.2, 3], [-9, 0, 0.9]])


def stretched(x, u, p):
    return [p[0] * x[1] + u[0], ca.sin(p[1] * x[2]) + u[1], u[2] - x[0]]


CASES = {
    "linear": ("linear", {}),
    "pendulum": ("pendulum", {}),
    "tank": ("tank", {}),
    "samples of delay": ("pendulum", {"delay": 0.1}),
    "a part of a sample of delay": ("linear", {"delay": 0.031}),
    "both": ("pendulum", {"delay": 0.127}),
    "constant disturbance": ("pendulum", {"disturbance": [0.3, -0.7]}),
    "one disturbance for all": ("linear", {"disturbance": 0.3, "delay": 0.02}),
    "disturbance in time": ("linear", {"disturbance": lambda t: [t, -0.5, np.cos(9 * t)]}),
    "function as plant": ("linear", {"model": lambda x, u: ca.mtimes(ca.DM(GAIN), x) + u**2}),
    "parameters": ("linear", {"model": stretched, "parameters": {"b": 0.7, "a": -1.5}}),
    "problem as plant": (
        "linear",
        {"model": linear_problem(seed=9).replace(running_cost=lambda x: x[0] ** 4)},
    ),
    "policy as plant": ("linear", {"model": random_grid_policy(linear_problem(seed=5), 2)}),
}


@pytest.mark.parametrize("case", CASES)
def test_trajectories_are_those_of_scipy_under_the_same_switching(case):
    name, options = CASES[case]
    problem, rate = PROBLEMS[name], 20
    states = problem.domain.sample(3, 4)
    found = simulate(POLICIES[name], states, 0.4, rate, outside="nearest", **options)
    delay, push = options.get("delay", 0.0), options.get("disturbance", 0.0)
    dynamics = None
    if case == "function as plant":

        def dynamics(x, u):
            return GAIN @ x + u**2

    elif case == "parameters":

        def dynamics(x, u):
            return np.array([0.7 * x[1] + u[0], np.sin(-1.5 * x[2]) + u[1], u[2] - x[0]])

    elif case == "problem as plant":
        problem = options["model"]
    elif case == "policy as plant":
        problem = linear_problem(seed=5)
    if callable(push):
        signal = push

        def push(t):
            return np.array(signal(np.floor(t * rate) / rate))

    for k, state in enumerate(states):
        timeline = [(-1.0, POLICIES[name].default)]
        timeline += [(j / rate + delay, u) for j, u in enumerate(found.controls[k])]
        x, cost = state, 0.0
        for j in range(8):
            x, part = integrate(
                problem, x, timeline, found.times[j], found.times[j + 1], push, dynamics
            )
            cost += part
            np.testing.assert_allclose(found.states[k, j + 1], x, rtol=1e-7, atol=1e-7)
            assert found.costs[k, j + 1] == pytest.approx(cost, rel=1e-6, abs=1e-8)
        wanted = cost + float(problem.functions()["terminal_cost"](x))
        assert found.cost[k] == pytest.approx(wanted, rel=1e-6)
    assert found.switches.max() > 0 or name == "tank"


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_symbols_are_those_of_the_policy(name):
    policy = POLICIES[name]
    found = simulate(policy, policy.domain.sample(5, 1), 1, 10, outside="nearest")
    for k in range(5):
        wanted = policy(found.states[k, :-1], outside="nearest")
        assert np.array_equal(found.symbols[k], wanted)
        table = np.vstack([policy.alphabet.values, policy.default])
        assert np.array_equal(found.controls[k], table[wanted])
        changes = (np.diff(found.controls[k], axis=0) != 0).any(axis=1).sum()
        assert found.switches[k] == changes
        assert found.outside[k] == (~policy.domain.contains(found.states[k, :-1])).sum()


def test_a_function_as_controller():
    seen = []

    def controller(time, states):
        assert states.ndim == 2 and len(states)
        seen.append((time, len(states)))
        return np.where(states > 0, -1.0, 1.0) + time

    problem, policy = relay_problem(default=0.5), relay([0, 1])
    options = {"model": problem, "target": Ball([0.0], 0.06), "stop_at_target": True}
    found = simulate(controller, [[0.5], [-0.29], [0.0]], 1, 10, **options)
    assert found.ended.tolist() == ["target"] * 3 and found.last[2] == 0
    assert [k for _, k in seen] == sorted((k for _, k in seen), reverse=True) and seen[0][1] == 2
    np.testing.assert_allclose([t for t, _ in seen], np.arange(len(seen)) / 10)
    assert found.symbols.max() == -2 and found.names == ("x", "u1")
    u = found.controls[0, : found.last[0], 0]
    np.testing.assert_allclose(found.states[0, 1 : found.last[0] + 1, 0], 0.5 + np.cumsum(u) / 10)
    late = simulate(lambda t, x: 0 * x, [0.5], 1, 10, model=problem, delay=0.4)
    np.testing.assert_allclose(late.states[:, 0], 0.5 + 0.5 * np.minimum(late.times, 0.4))
    same = simulate(lambda t, x: policy.control(x), [[0.5], [-0.3]], 1, 10, model=problem)
    own = simulate(policy, [[0.5], [-0.3]], 1, 10, backend="numpy")
    assert np.array_equal(same.states, own.states) and np.array_equal(same.switches, own.switches)
    held = simulate(lambda t, x: policy.control(x), [0.05], 1, 10, model=problem, min_dwell=0.3)
    assert held.controls.ravel().tolist() == [-1] * 3 + [1] * 3 + [-1] * 3 + [1]


def test_a_control_that_is_not_finite_ends_the_trial():
    def controller(time, states):
        return np.where((time > 0.25) & (states > 0), np.nan, 0.1)

    found = simulate(controller, [[0.5], [-0.5]], 1, 10, model=relay_problem())
    assert found.ended.tolist() == ["not finite", "time"] and found.last.tolist() == [3, 10]
    assert np.isfinite(found.states[0, :4]).all() and np.isnan(found.states[0, 4:]).all()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("shape", [(), (5,), (2, 3), (1, 1, 1)])
def test_shapes_follow_the_initial_states(backend, shape):
    policy = POLICIES["linear"]
    x0 = policy.domain.sample(int(np.prod(shape, dtype=int)), 2).reshape(*shape, 3)
    found = simulate(policy, x0, 0.7, 10, backend=backend, target=Ball([0, 0, 0], 0.5))
    assert found.times.shape == (8,) and found.states.shape == (*shape, 8, 3)
    assert found.symbols.shape == (*shape, 7) and found.controls.shape == (*shape, 7, 3)
    assert found.costs.shape == (*shape, 8)
    for name in ("terminal_cost", "switches", "outside", "ended", "last", "arrived", "cost"):
        assert np.shape(getattr(found, name)) == shape, name
    assert np.array_equal(found.states[..., 0, :], x0)
    assert found.names == ("x1", "x2", "x3", "u1", "u2", "u3")
    flat = simulate(policy, x0.reshape(-1, 3), 0.7, 10, backend=backend)
    assert np.array_equal(flat.states.reshape(found.states.shape), found.states)
    assert np.array_equal(flat.cost.reshape(shape), found.cost)


def test_the_arguments_are_left_alone_and_results_are_copies():
    x0 = np.array([0.1, 0.2, 0.3])
    found = simulate(POLICIES["linear"], x0, 1, 10)
    found.states[:] = 0
    assert x0.tolist() == [0.1, 0.2, 0.3]
    whole = simulate(relay(), [1], 1, 10)  # whole numbers are numbers
    assert whole.states[0] == 1.0 and whole.states.dtype == float


def test_the_cost_is_the_integral_until_the_end_and_the_terminal_cost():
    problem = linear_problem()
    policy = random_grid_policy(problem)
    found = simulate(policy, problem.domain.sample(20, 4), 1, 200, target=Ball([0, 0, 0], 0.7))
    squares = (found.states**2).sum(axis=-1)
    quadrature = np.trapezoid(squares, found.times, axis=-1)
    np.testing.assert_allclose(found.costs[:, -1], quadrature, rtol=1e-3)
    np.testing.assert_allclose(found.terminal_cost, 2 * squares[:, -1], rtol=1e-12)
    np.testing.assert_allclose(found.cost, found.costs[:, -1] + found.terminal_cost)
    stopped = simulate(
        policy,
        problem.domain.sample(20, 4),
        1,
        200,
        target=Ball([0, 0, 0], 0.7),
        stop_at_target=True,
    )
    early = stopped.last < 200
    assert early.any() and not early.all()
    for k in range(20):
        last = stopped.last[k]
        assert stopped.cost[k] == pytest.approx(found.costs[k, last] + 2 * squares[k, last])
    assert np.array_equal(stopped.arrived, found.arrived, equal_nan=True)
    assert (stopped.terminal_cost[early] > 0).all()


@pytest.mark.parametrize(
    ("duration", "rate", "samples"), [(1, 10, 10), (0.96, 10, 10), (1.04, 10, 10), (0.06, 10, 1)]
)
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_duration_is_rounded_to_samples(backend, duration, rate, samples):
    found = simulate(relay(), [0.5], duration, rate, backend=backend)
    assert found.states.shape == (samples + 1, 1) and found.last == samples
    assert found.ended == "time" and np.isfinite(found.states).all()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.filterwarnings("ignore:a sample of 1 s is longer than the horizon")
def test_half_a_sample_is_none_or_one(backend):
    try:
        found = simulate(relay(), [0.5], 0.5, 1, backend=backend)
    except ProblemError as error:
        assert str(error).startswith("`duration` times `rate` must be")
    else:
        assert found.last == 1


def test_the_rate_comes_from_the_settings():
    policy = POLICIES["linear"]
    assert len(simulate(policy, [0, 0, 0.1], 2).times) == 21
    online = online_controller(linear_problem(), backend="numpy")
    assert len(simulate(online, [0, 0, 0.1], 0.2).times) == 3
    bare = dataclasses.replace(policy, settings=None, horizon=None)
    with pytest.raises(ProblemError, match="^`rate` must be given for a controller without sett"):
        simulate(bare, [0, 0, 0.1], 2)


def test_the_target_of_the_policy_is_the_default_and_another_is_taken_instead():
    policy = relay([1, 1], target=Ball([0.0], 0.01))
    assert simulate(policy, [0.5], 1, 10).arrived == 0.5
    assert simulate(policy, [0.5], 1, 10, target=Box([0.1], [0.25])).arrived == 0.3
    assert simulate(policy, [0.5], 1, 10, target=lambda x: x[0] < -0.25).arrived == 0.8
    assert np.isnan(simulate(relay([1, 1]), [0.5], 1, 10).arrived)


def written(path):
    with open(path, newline="") as file:
        return list(csv.reader(file))


def test_a_csv_file_of_one_trajectory_has_the_same_numbers(tmp_path):
    found = simulate(POLICIES["linear"], [1 / 3, 0.2, 0.3], 2, 10, delay=0.03)
    found.save(tmp_path / "one.csv")
    head, *rows = written(tmp_path / "one.csv")
    assert head == "time x1 x2 x3 cost symbol u1 u2 u3".split()
    assert len(rows) == 21 and all(len(row) == 9 for row in rows)
    numbers = np.array([[float(v) for v in row[:5]] for row in rows])
    assert np.array_equal(numbers[:, 0], found.times)
    assert np.array_equal(numbers[:, 1:4], found.states)
    assert np.array_equal(numbers[:, 4], found.costs)
    assert [int(row[5]) for row in rows[:-1]] == found.symbols.tolist()
    assert [[float(v) for v in row[6:]] for row in rows[:-1]] == found.controls.tolist()
    assert rows[-1][5:] == [""] * 4


def test_a_csv_file_of_many_trajectories_ends_each_where_it_ended(tmp_path):
    policy = relay([1, 1], target=Ball([0.0], 0.05))
    found = simulate(policy, [[[0.5], [0.2]], [[-0.85], [0.0]]], 0.4, 10, stop_at_target=True)
    found.save(str(tmp_path / "many.CSV"))
    head, *rows = written(tmp_path / "many.CSV")
    assert head == ["trial", "time", "x", "cost", "symbol", "u1"]
    assert [int(row[0]) for row in rows] == [0] * 5 + [1] * 3 + [2] * 3 + [3]
    ends = [row for row in rows if row[4] == ""]
    assert [float(row[1]) for row in ends] == [0.4, 0.2, 0.2, 0.0]
    states = [float(row[2]) for row in rows if row[0] == "2"]
    assert states == found.states[1, 0, :3, 0].tolist()


@pytest.mark.parametrize("x0", [[0.9], [[0.9], [-0.9], [-1.5]], [-1.5]])
def test_a_json_file_has_the_same_numbers(x0, tmp_path):
    found = simulate(relay([1, 1]), x0, 0.3, 10, target=Ball([0.8], 0.01))
    found.save(tmp_path / "t.json")
    data = json.loads((tmp_path / "t.json").read_text(), parse_constant=pytest.fail)
    left_out = {"time_unit", "exogenous", "exogenous_names", "exogenous_units", "entered"}
    assert set(data) == {field.name for field in dataclasses.fields(found)} - left_out
    figures = data["figures"]
    assert set(figures) == {"effort", "fuel"}
    assert all(np.array_equal(figures[name], found.figures[name]) for name in figures)
    for name in data.keys() - {"figures"}:
        value = getattr(found, name)
        if isinstance(value, np.ndarray | np.generic):
            kind = np.asarray(value).dtype
            again = np.array(data[name], dtype=float if kind.kind == "f" else kind)
            assert np.array_equal(again, value, equal_nan=kind.kind == "f"), name
        else:
            assert tuple(data[name]) == value
    assert data == json.loads(json.dumps(found.to_json(), allow_nan=False))


@pytest.mark.parametrize("name", ["t.txt", "t", "t.csv.gz", "csv"])
def test_other_endings_are_refused_and_nothing_is_written(name, tmp_path):
    found = simulate(relay(), [0.5], 1, 10)
    with pytest.raises(ProblemError, match="a trajectory must end in .csv or .json; got"):
        found.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_told(tmp_path):
    with pytest.raises(CapsynError) as caught:
        simulate(relay(), [0.5], 1, 10).save(tmp_path / "none" / "t.csv")
    assert "\n" not in str(caught.value)


ONLINE = online_controller(relay_problem(), backend="numpy")
REFUSED = [
    (relay(), {"duration": 0}, "`duration` must be a finite number > 0; got 0"),
    (relay(), {"duration": "long"}, "`duration` must be a number > 0; got 'long'"),
    (relay(), {"duration": float("nan")}, "`duration` must be a finite number > 0"),
    (relay(), {"rate": 0}, "`rate` must be a finite number > 0; got 0"),
    (relay(), {"rate": -10}, "`rate` must be a finite number > 0; got -10"),
    (relay(), {"rate": 0.1}, "`duration` times `rate` must be 1 to 1e+09 samples; got 0.1"),
    (relay(), {"rate": 1e10}, "`duration` times `rate` must be 1 to 1e+09 samples; got 1e+10"),
    (relay(), {"backend": "gpu"}, "`backend` must be one of"),
    (relay(), {"threads": 0}, "`threads` must be a whole number >= 1"),
    (3, {}, "`controller` must be a Policy, an OnlineController or a function of time and states"),
    (relay(), {"x0": 0.5}, "`x0` must be finite numbers of shape (..., 1); got "),
    (relay(), {"x0": [0.5, 0.5]}, "`x0` must be finite numbers of shape (..., 1)"),
    (relay(), {"x0": [float("nan")]}, "`x0` must be finite numbers of shape (..., 1); got "),
    (relay(), {"x0": ["a"]}, "`x0` must be numbers; got ['a']"),
    (relay(), {"min_dwell": -1}, "`min_dwell` must be a finite number >= 0; got -1"),
    (relay(), {"min_dwell": float("inf")}, "`min_dwell` must be a finite number >= 0; got inf"),
    (relay(), {"delay": -0.1}, "`delay` must be a finite number >= 0; got -0.1"),
    (relay(), {"noise": -1}, "`noise` must be >= 0; got -1"),
    (relay(), {"noise": [1, 2]}, "`noise` must be a finite number; got [1, 2]"),
    (relay(), {"noise": 1, "seed": -1}, "`seed` must be a whole number >= 0; got -1"),
    (relay(), {"seed": 0.5}, "`seed` must be a whole number >= 0; got 0.5"),
    (relay(), {"substeps": 0}, "`substeps` must be a whole number >= 1"),
    (relay(), {"substeps": 1.5}, "`substeps` must be a whole number >= 1"),
    (relay(), {"substeps": 2**62}, "`substeps` must be a whole number >= 1 and <= "),
    (relay(), {"disturbance": [1, 2]}, "`disturbance` must be a finite number; got"),
    (relay(), {"disturbance": lambda t: [t, t]}, "`disturbance` must be a finite number; got"),
    (relay(), {"disturbance": lambda t: np.nan}, "`disturbance` must be a finite number; got"),
    (relay(), {"outside": "far"}, '`outside` must be "error", "nearest" or a symbol'),
    (relay(), {"outside": 2}, '`outside` must be "error", "nearest" or a symbol'),
    (ONLINE, {"outside": "nearest"}, "`outside` must be given for policies only"),
    (relay(), {"target": 3}, "`target` must be a Ball, a Box or a function of the state; got 3"),
    (relay(), {"target": Ball([0, 0], 1)}, "`target` must have 1 dimension(s)"),
    (relay(), {"target": Ball([3], 1)}, "`target` must meet the domain; it lies outside"),
    (relay(), {"target": lambda x: [x, x]}, "`target` must return a scalar"),
    (relay(), {"stop_at_target": True}, "`target` must be given to stop at it"),
    (
        relay(),
        {"parameters": {"k": "a"}, "model": lambda x, u, p: u},
        "`parameters k` must be a nu",
    ),
    (relay(), {"parameters": {"k": 1}}, "`parameters` need a `model` that is a function"),
    (
        relay(model=None),
        {},
        "`model` must be a Problem, or a Policy with a model, for a controller",
    ),
    (
        relay(),
        {"model": problems.plain("cart-pendulum")},
        "`model` must have 1 state(s) and 1 input",
    ),
    (
        lambda t, x: x[0],
        {"model": relay_problem()},
        "`controller` must return controls of shape (1",
    ),
    (lambda t, x: "a", {"model": relay_problem()}, "`controller` must be numbers; got 'a'"),
]


@pytest.mark.parametrize(("controller", "options", "message"), REFUSED)
def test_refusals(controller, options, message):
    arguments = {"x0": [0.5], "duration": 1, "rate": 10} | options
    with pytest.raises(ProblemError) as caught:
        simulate(controller, **arguments)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options", [{"x0": [np.nan]}, {"delay": -1}, {"noise": -1}, {"noise": 1, "seed": "a"}]
)
def test_arguments_are_checked_before_any_work(options, monkeypatch):
    from capsyn.simulation import experiment

    def work(*_):
        raise AssertionError("work before the arguments are known to be good")

    monkeypatch.setattr(experiment, "choose_substeps", work)
    with pytest.raises(ProblemError):
        simulate(relay(), **{"x0": [0.5], "duration": 1, "rate": 10} | options)


def test_one_policy_everywhere_holds_its_control():
    found = simulate(grid_policy(relay_problem(), [0], [1]), [-0.5], 1, 10)
    np.testing.assert_allclose(found.states[:, 0], -0.5 + found.times, atol=1e-12)
    np.testing.assert_allclose(found.costs[-1], (0.5**3 + 0.5**3) / 3, rtol=1e-9)
