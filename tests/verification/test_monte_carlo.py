"""Monte Carlo: what is drawn, what counts as success, what the figures say."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from capsyn import Ball, Box, online_controller, problems, simulate
from capsyn.controllers.command import ENDINGS, LEFT_DOMAIN, NOT_FINITE, TARGET, TIME
from capsyn.errors import ProblemError
from capsyn.statistics import clopper_pearson
from capsyn.verification.monte_carlo import monte_carlo
from capsyn.verification.trials import Uniform
from support.closed_loops import (
    BACKENDS,
    assert_same_trials,
    linear_problem,
    random_grid_policy,
    relay,
    relay_problem,
    tank_interior,
)

LINEAR = random_grid_policy(linear_problem())
HOME = Ball([0, 0, 0], 0.5)
both = pytest.mark.parametrize("backend", BACKENDS)


def stretched(x, u, p):
    return [p[0] * x[1] + u[0], p[1] * u[1], u[2] - x[0]]


RANDOM = {
    "duration": 2,
    "rate": 10,
    "target": HOME,
    "substeps": 2,
    "model": stretched,
    "parameters": {"a": Uniform(-1, 1), "b": 0.7},
    "disturbance": Uniform([-0.1, 0, 0.2], 0.3),
    "noise": Uniform(0, [0.1, 0.2, 0]),
    "delay": Uniform(0.05, 0.35),
    "min_dwell": 0.2,
}


def test_the_same_seed_gives_the_same_and_another_another():
    one = monte_carlo(LINEAR, 70, seed=4, **RANDOM)
    assert_same_trials(one, monte_carlo(LINEAR, 70, seed=4, threads=1, **RANDOM))
    assert_same_trials(one, monte_carlo(LINEAR, 70, seed=4, threads=3, **RANDOM))
    slow = monte_carlo(LINEAR, 70, seed=4, backend="numpy", **RANDOM)
    for name in ("initial_cost", "final_cost"):  # solved by a kernel that contracts products
        np.testing.assert_allclose(getattr(slow, name), getattr(one, name), rtol=1e-11)
    assert_same_trials(
        one, dataclasses.replace(slow, initial_cost=one.initial_cost, final_cost=one.final_cost)
    )
    other = monte_carlo(LINEAR, 70, seed=5, **RANDOM)
    assert not np.isin(one.initial, other.initial).any()
    assert not np.isin(one.parameters["a"], other.parameters["a"]).any()
    assert 0 < one.success.sum() < 70 and one.success_rate == one.success.mean()


@both
@pytest.mark.parametrize("initial", [None, HOME, Box([-0.5], [0.5], names=["x2"])])
def test_the_first_trials_do_not_depend_on_how_many_there_are(backend, initial):
    options = RANDOM | {"initial": initial, "backend": backend}
    many = monte_carlo(LINEAR, 67, **options)
    for count in (1, 33):
        assert_same_trials(many, monte_carlo(LINEAR, count, **options), count)


def test_draws_are_within_their_bounds_and_independent(monkeypatch):
    from capsyn.verification import monte_carlo as module

    kept = {}
    noise = module.Noise

    def keep_noise(deviations, seeds):
        kept["noise"] = deviations
        kept["streams"] = [tuple(seed) for seed in seeds]
        return noise(deviations, seeds)

    def keep_trials(experiment, states, delays, parameters, push):
        kept.update(state=states, delay=delays[:, None], parameters=parameters, push=push)
        return trials(experiment, states, delays, parameters, push)

    from capsyn.simulation.experiment import Experiment

    trials = Experiment.trials
    monkeypatch.setattr(module, "Noise", keep_noise)
    monkeypatch.setattr(Experiment, "trials", keep_trials)
    options = RANDOM | {"initial": Box([-0.5, -1], [0.5, 0], names=["x3", "x1"]), "duration": 0.2}
    found = monte_carlo(LINEAR, 2000, **options)
    bounds = {
        "state": ([-1, -1, -0.5], [0, 1, 0.5]),
        "delay": ([0.05], [0.35]),
        "parameters": ([-1, 0.7], [1, 0.7]),
        "push": ([-0.1, 0, 0.2], [0.3] * 3),
        "noise": ([0] * 3, [0.1, 0.2, 0]),
    }
    columns = []
    for name, (low, high) in bounds.items():
        drawn, low, high = kept[name], np.array(low), np.array(high)
        assert drawn.shape == (2000, len(low))
        assert (drawn >= low).all() and (drawn <= high).all()
        np.testing.assert_allclose(drawn.mean(axis=0), (low + high) / 2, atol=0.03)
        np.testing.assert_allclose(drawn.std(axis=0), (high - low) / 12**0.5, atol=0.02)
        columns += [column for column in drawn.T if np.ptp(column)]
    off = np.corrcoef(columns) - np.eye(len(columns))
    assert len(columns) == 10 and np.abs(off).max() < 0.1
    assert len(set(kept["streams"])) == 2000
    assert np.array_equal(found.parameters["a"], kept["parameters"][:, 0])
    assert (found.parameters["b"] == 0.7).all()


def test_everything_of_one_number_is_drawn_from_a_stream_of_its_own(monkeypatch):
    from capsyn.verification import monte_carlo as module

    streams = []
    rng = np.random.default_rng

    def keep(seed):
        streams.append(tuple(np.atleast_1d(seed)))
        return rng(seed)

    monkeypatch.setattr(module.np.random, "default_rng", keep)
    draw = Uniform(0, 1)
    found = monte_carlo(
        READY,
        300,
        duration=0.2,
        rate=10,
        substeps=1,
        backend="numpy",
        model=lambda x, u, p: p[0] * u + p[1],
        parameters={"a": draw, "b": draw},
        delay=draw,
        disturbance=draw,
        noise=draw,
    )
    assert len(set(streams)) == len(streams) == 6 + 300
    columns = [found.initial[:, 0], *found.parameters.values()]
    assert np.abs(np.corrcoef(columns) - np.eye(3)).max() < 0.2


@pytest.mark.filterwarnings("ignore:a sample of 1 s is longer than the horizon")
def test_initial_states_are_drawn_from_the_domain_a_ball_or_named_axes():
    still = {"model": lambda x, u: 0 * u, "target": HOME, "rate": 1, "duration": 1, "substeps": 1}
    everywhere = monte_carlo(LINEAR, 500, **still).initial
    assert LINEAR.domain.contains(everywhere).all() and (np.ptp(everywhere, axis=0) > 1.9).all()
    ball = monte_carlo(LINEAR, 500, initial=Ball([0.2, 0, 0], 0.3), **still).initial
    assert (np.linalg.norm(ball - [0.2, 0, 0], axis=1) <= 0.3).all()
    line = monte_carlo(LINEAR, 500, initial=Ball([0.2], 0.1, names=["x3"]), **still).initial
    assert (np.abs(line[:, 2] - 0.2) <= 0.1).all()
    assert np.array_equal(line[:, :2], everywhere[:, :2])


@both
def test_a_failing_trial_fails_alone_too(backend):
    options = {"duration": 2, "rate": 10, "target": HOME, "substeps": 2, "delay": 0.07}
    options |= {"disturbance": [0.1, 0, 0], "backend": backend}
    found = monte_carlo(LINEAR, 80, **options)
    assert 0 < len(found.failures) < 80
    assert np.array_equal(found.failures, found.initial[~found.success])
    for k in [*np.flatnonzero(~found.success)[:3], *np.flatnonzero(found.success)[:3]]:
        one = simulate(LINEAR, found.initial[k], stop_at_target=True, **options)
        assert np.array_equal(one.states[one.last], found.final[k])
        assert one.ended == ENDINGS[found.ended[k]] and one.times[one.last] == found.times[k]
        assert np.array_equal(one.arrived, found.arrived[k], equal_nan=True)
        assert np.isfinite(one.arrived) == found.success[k]
        assert one.switches == found.switches[k] and one.outside == found.outside[k]


@both
def test_drawn_parameters_reproduce_a_trial(backend):
    options = {k: RANDOM[k] for k in ("duration", "rate", "target", "substeps", "model")}
    options |= {"backend": backend, "outside": "error"}
    found = monte_carlo(LINEAR, 40, parameters=RANDOM["parameters"], **options)
    for k in (0, 13, 39):
        values = {name: drawn[k] for name, drawn in found.parameters.items()}
        one = simulate(LINEAR, found.initial[k], parameters=values, stop_at_target=True, **options)
        assert np.array_equal(one.states[one.last], found.final[k])


DRIFT = {"model": lambda x, u: 1 + 0 * u, "rate": 10, "substeps": 1, "outside": "nearest"}


def drift(x0, **options):
    """Run one trial of ``xdot = 1`` from a place."""
    start = Box([x0 - 1e-9], [x0 + 1e-9])
    return monte_carlo(relay(), 1, **DRIFT | {"initial": start} | options)


@both
@pytest.mark.parametrize(
    ("options", "success", "arrived", "time"),
    [
        ({"duration": 2}, True, 0.5, 0.5),
        ({"duration": 0.4}, False, None, 0.4),
        ({"duration": 0.5}, True, 0.5, 0.5),
        ({"duration": 2, "within": 0.5}, True, 0.5, 0.5),
        ({"duration": 2, "within": 0.49}, False, 0.5, 0.5),
        ({"duration": 2, "within": 0.009, "rate": 1000 / 3, "start": -0.258}, True, 0.009, 0.009),
        ({"duration": 1.0, "hold": 0.3}, True, 0.5, 1.0),
        ({"duration": 1.0, "hold": 0.5}, True, 0.5, 1.0),
        ({"duration": 1.0, "hold": 0.55}, True, 0.5, 1.0),
        ({"duration": 1.0, "hold": 0.6}, False, 0.5, 1.0),
        ({"duration": 0.9, "hold": 0.41}, True, 0.5, 0.9),
        ({"duration": 0.9, "hold": 0.5}, False, 0.5, 0.9),
        ({"duration": 1.2, "hold": 0.1}, False, 0.5, 1.2),  # has left
        ({"duration": 1.0, "hold": 0.3, "within": 0.5}, True, 0.5, 1.0),
        ({"duration": 1.0, "hold": 0.3, "within": 0.4}, False, 0.5, 1.0),
        ({"duration": 1.0, "hold": 1.0}, False, 0.5, 1.0),
    ],
)
def test_success_by_hand(backend, options, success, arrived, time):
    # inside [-0.25, 0.35] from 0.5 s to 1.0 s
    target = Box([-0.25], [0.35])
    options = {"start": -0.7} | options
    found = drift(options.pop("start"), target=target, backend=backend, **options)
    assert found.success.tolist() == [success] and found.times[0] == pytest.approx(time)
    if arrived is None:
        assert np.isnan(found.arrived[0])
    else:
        assert found.arrived[0] == pytest.approx(arrived)
    stopped = found.ended[0] == TARGET
    assert stopped == ("hold" not in options and arrived is not None)
    assert found.conditions["within"] == options.get("within", options["duration"])


@both
def test_holding_from_the_start_to_the_end(backend):
    found = drift(-0.5, target=Ball([0], 0.75), duration=1, hold=1, backend=backend)
    assert found.success.all() and found.arrived[0] == 0.0
    found = drift(-0.5, target=Ball([0], 0.75), duration=1.04, hold=1.04, backend=backend)
    assert found.success.all(), "the duration is rounded to samples, and so is what is held"
    found = drift(-0.8, target=Ball([0], 0.75), duration=1, hold=1, backend=backend)
    assert not found.success.any()
    out_and_in = {"model": lambda x, u: -u, "rate": 10, "substeps": 1, "outside": "nearest"}
    found = monte_carlo(
        relay([0, 1]),
        20,
        **out_and_in,
        target=Box([-0.3], [0.3]),
        initial=Box([-0.25], [0.25]),
        duration=1,
        hold=0.2,
        backend=backend,
    )
    assert not found.success.any() and (found.arrived == 0).all()


@both
def test_what_leaves_or_escapes_does_not_hold(backend):
    found = drift(0.7, target=Ball([0.5], 0.6), duration=1, hold=0.1, outside="error")
    assert found.ended.tolist() == [LEFT_DOMAIN] and not found.success.any()
    assert found.outside.tolist() == [1]
    problem = relay_problem(dynamics=lambda x, u: [x[0] ** 2 + 0 * u[0]])
    found = monte_carlo(
        relay(),
        5,
        model=problem,
        rate=10,
        duration=9,
        substeps=3,
        initial=Box([0.5], [0.9]),
        outside="nearest",
        target=Box([-1], [2e9]),
        hold=1,
        backend=backend,
    )
    assert (found.ended == NOT_FINITE).all() and not found.success.any()
    assert (found.arrived == 0).all()
    json.dumps(found.to_json(), allow_nan=False)


def test_the_tolerance_is_another_radius_for_the_ball():
    policy = relay([0, 1], target=Ball([0.0], 0.3))
    options = {"rate": 100, "duration": 0.5, "trials": 300}
    wide, narrow = (monte_carlo(policy, tolerance=r, **options) for r in (0.45, 0.1))
    own = monte_carlo(policy, **options)
    for found, radius in ((own, 0.3), (wide, 0.45), (narrow, 0.1)):
        reaches = np.abs(found.initial[:, 0]) <= radius + 0.5
        clear = np.abs(np.abs(found.initial[:, 0]) - radius - 0.5) > 0.02
        assert np.array_equal(found.success[clear], reaches[clear])
        assert f"ball of radius {radius:g} around x = 0" in found.conditions["target"]
    named = relay([0, 1], target=Ball([0.0], 0.3, names=["x"]))
    assert_same_trials(narrow, monte_carlo(named, tolerance=0.1, **options))


def test_the_interval_is_that_of_clopper_and_pearson():
    policy = relay([0, 1], target=Ball([0.0], 0.3))
    options = {"rate": 100, "duration": 0.3}
    for confidence in (0.95, 0.6):
        found = monte_carlo(policy, 50, confidence=confidence, **options)
        wanted = clopper_pearson(int(found.success.sum()), 50, confidence)
        assert (found.low, found.high) == wanted and found.low < found.success_rate < found.high
        assert found.confidence == confidence
    whole = monte_carlo(policy, 50, tolerance=0.99, **options)
    assert whole.high == 1.0 == whole.success_rate and 0.9 < whole.low < 1


@pytest.mark.parametrize("online", [False, True])
def test_the_figures_are_plain_strict_json(online):
    problem = tank_interior().replace(target=Ball([0.75, 0.2], 0.05))
    controller = random_grid_policy(problem)
    options = {"rate": 20, "duration": 0.5, "confidence": np.float32(0.9), "outside": "error"}
    if online:
        controller = online_controller(problem)
        del options["outside"]
    found = monte_carlo(controller, 60, seed=3, **options)
    data = json.loads(json.dumps(found.to_json(), allow_nan=False), parse_constant=pytest.fail)
    assert data == found.to_json()
    assert data["trials"] == 60 and data["successes"] == found.success.sum()
    assert data["success_rate"] == data["successes"] / 60
    assert (data["low"], data["high"], data["seed"]) == (found.low, found.high, 3)
    assert data["failing_initial_states"] == found.failures.tolist()
    assert [trial["initial"] for trial in data["failing_trials"]] == found.failures.tolist()
    counts = {name: int((found.ended == k).sum()) for k, name in enumerate(ENDINGS)}
    assert data["ended"] == {name: count for name, count in counts.items() if count}
    times = found.arrived[found.success]
    assert data["time_to_target"]["median"] == np.median(times)
    assert data["time_to_target"]["min"] == times.min()
    assert data["time_to_target"]["max"] == times.max()
    assert data["time_to_target"]["95%"] == np.percentile(times, 95)
    ran = found.times > 0
    assert data["switches_per_second"]["mean"] == pytest.approx(
        (found.switches[ran] / found.times[ran]).mean()
    )
    assert data["trials_outside_domain"] == (found.outside > 0).sum()
    assert data["cost_decreased"] == (found.final_cost < found.initial_cost).mean()
    assert data["cost_left"]["max"] == (found.final_cost / found.initial_cost).max()
    start = online_controller(problem).actions(found.initial).cost
    np.testing.assert_allclose(found.initial_cost, start, rtol=1e-9)
    end = online_controller(problem).actions(found.final).cost
    np.testing.assert_allclose(found.final_cost, end, rtol=1e-9)


def test_figures_of_trials_without_arrivals_costs_or_time():
    bare = relay(model=None, target=Ball([0], 0.1))
    found = monte_carlo(
        bare, 4, model=relay_problem(), initial=Ball([0.0], 0.01), rate=10, duration=1
    )
    data = found.to_json()
    assert data["switches_per_second"] is None and data["cost_decreased"] is None
    assert data["cost_left"] is None and data["time_to_target"]["max"] == 0.0
    assert np.isnan(found.initial_cost).all() and np.isnan(found.final_cost).all()
    away = monte_carlo(bare, 150, model=still(), initial=Box([0.5], [0.9]), rate=10, duration=0.2)
    data = away.to_json()
    assert data["time_to_target"] is None and data["success_rate"] == 0.0 == data["low"]
    assert len(data["failing_initial_states"]) == 100 and len(away.failures) == 150
    json.dumps(data, allow_nan=False)


def still():
    """Return a plant that stays where it is."""
    return relay_problem(dynamics=lambda x, u: [0 * u[0]])


def test_the_conditions_are_told():
    found = monte_carlo(LINEAR, 2, **RANDOM)
    told = found.conditions
    assert told["noise"] == {"low": 0, "high": [0.1, 0.2, 0]} and told["model"] != "its own"
    assert told["delay"] == {"low": 0.05, "high": 0.35} and told["min_dwell"] == 0.2
    assert told["parameters"] == {"a": {"low": -1, "high": 1}, "b": 0.7}
    assert (told["duration"], told["rate"], told["hold"], told["substeps"]) == (2, 10, 0, 2)
    own = monte_carlo(relay(target=Ball([0], 0.1)), 2, rate=10, disturbance=lambda t: np.sin(t))
    assert own.conditions["disturbance"] == "a function of time"
    assert own.conditions["noise"] is None and own.conditions["model"] == "its own"
    json.dumps(own.to_json(), allow_nan=False)


def test_a_function_as_controller_and_a_predicate_as_target():
    found = monte_carlo(
        lambda t, x: np.where(x > 0, -1.0, 1.0),
        50,
        model=relay_problem(),
        target=lambda x: x[0] ** 2 < 0.01,
        rate=50,
        duration=0.5,
    )
    clear = np.abs(np.abs(found.initial[:, 0]) - 0.6) > 0.03
    assert np.array_equal(found.success[clear], np.abs(found.initial[clear, 0]) < 0.6)
    assert set(found.ended) == {TIME, TARGET}


READY = relay([0, 1], target=Ball([0], 0.1))
REFUSED = [
    (READY, {"trials": 0}, "`trials` must be a whole number >= 1"),
    (READY, {"trials": 10.0}, "`trials` must be a whole number >= 1"),
    (READY, {"trials": 10**9}, "`trials` must be a whole number >= 1 and <= 100000000"),
    (READY, {"seed": -1}, "`seed` must be a whole number >= 0; got -1"),
    (READY, {"confidence": 1}, "`confidence` must be a number between 0 and 1; got 1"),
    (READY, {"confidence": 0}, "`confidence` must be a finite number > 0; got 0"),
    (READY, {"duration": 0}, "`duration` must be a finite number > 0; got 0"),
    (READY, {"rate": 0}, "`rate` must be a finite number > 0; got 0"),
    (READY, {"rate": -1}, "`rate` must be a finite number > 0; got -1"),
    (READY, {"within": 0}, "`within` must be a finite number > 0; got 0"),
    (READY, {"hold": -1}, "`hold` must be a finite number >= 0; got -1"),
    (READY, {"hold": 1.5}, "`hold` must be at most the duration 1; got 1.5"),
    (relay(), {}, "`target` must be given: neither policy nor problem has one"),
    (READY, {"target": Ball([0, 0], 1)}, "`target` must have 1 dimension(s)"),
    (READY, {"target": Ball([9], 1)}, "`target` must meet the domain; it lies outside"),
    (READY, {"target": 3}, "`target` must be a Ball, a Box or a function of the state; got 3"),
    (READY, {"tolerance": 0}, "`tolerance` must be a finite number > 0; got 0"),
    (relay(), {"tolerance": 0.1}, "`target` must be given"),
    (
        READY,
        {"tolerance": 0.1, "target": Box([0], [1])},
        "`tolerance` must be given with a target that is a ball only",
    ),
    (
        READY,
        {"tolerance": 0.1, "target": lambda x: x[0] > 0},
        "`tolerance` must be given with a target that is a ball only",
    ),
    (READY, {"initial": 0.5}, "`initial` must be a Ball or a Box; got 0.5"),
    (READY, {"initial": lambda x: x}, "`initial` must be a Ball or a Box; got"),
    (READY, {"initial": Ball([0, 0], 1)}, "`initial` must have 1 dimension(s)"),
    (READY, {"initial": Ball([5], 1)}, "`initial` must meet the domain; it lies outside"),
    (READY, {"noise": [1, 1]}, "`noise` must be a finite number; got [1, 1]"),
    (READY, {"noise": -0.1}, "`noise` must be >= 0; got -0.1"),
    (READY, {"noise": Uniform(-1, 1)}, "`noise low` must be >= 0; got -1"),
    (READY, {"noise": Uniform(1, 0)}, "`noise` must have low <= high; got Uniform(low=1, high=0)"),
    (READY, {"delay": -1}, "`delay` must be >= 0; got -1"),
    (READY, {"delay": [1, 2]}, "`delay` must be a finite number; got [1, 2]"),
    (READY, {"delay": Uniform(0, np.inf)}, "`delay high` must be a finite number; got inf"),
    (READY, {"disturbance": [1, 2]}, "`disturbance` must be a finite number; got [1, 2]"),
    (READY, {"disturbance": "wind"}, "`disturbance` must be numbers; got 'wind'"),
    (READY, {"parameters": {"k": 1}}, "`parameters` need a `model`"),
    (
        READY,
        {"parameters": {"k": Uniform(2, 1)}, "model": lambda x, u, p: p * u},
        "`parameters k` must have low <= high",
    ),
    (relay(model=None, target=Ball([0], 1)), {}, "`model` must be a Problem, or a Policy with a m"),
    (
        READY,
        {"model": problems.plain("cart-pole")},
        "`model` must have 1 state(s) and 1 input(s) li",
    ),
    (READY, {"backend": "gpu"}, "`backend` must be one of"),
    (READY, {"threads": 0}, "`threads` must be a whole number >= 1"),
    (READY, {"outside": "far"}, '`outside` must be "error", "nearest" or a symbol'),
]


@pytest.mark.parametrize(("controller", "options", "message"), REFUSED)
def test_refusals(controller, options, message):
    arguments = {"trials": 10, "duration": 1, "rate": 10} | options
    with pytest.raises(ProblemError) as caught:
        monte_carlo(controller, **arguments)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_the_pendulum_policy_of_the_paper_swings_up_from_everywhere():
    from capsyn import synthesize

    found = monte_carlo(synthesize(problems.plain("cart-pendulum")), 300, duration=6, rate=200)
    assert found.success.all() and found.arrived.max() < 5
    assert found.low > 0.98 and found.to_json()["ended"] == {"target": 300}


def test_results_are_frozen():
    found = monte_carlo(READY, 2, rate=10, duration=1)
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.seed = 1
