"""Effort, fuel, costs by name and sets to avoid: against recorded loops, on both backends."""

import casadi as ca
import numpy as np
import pytest

import capsyn
from capsyn import Ball, Box, monte_carlo, simulate
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.statistics import mean_interval
from support.backends import needs_compiler


@pytest.fixture(scope="module")
def policy():
    problem = capsyn.Problem(
        name="cart",
        dynamics=lambda x, u: [x[1], u[0] - 0.5 * u[1]],
        domain=Box([-2, -2], [2, 2], names=["x", "v"]),
        alphabet=[[-1, 0.5], [0, 0], [1, -2]],
        default=[0.5, 0],
        horizon=1.0,
        running_cost=lambda x: x[0] ** 2 + x[1] ** 2,
        target=Ball([0, 0], 0.3),
        settings=capsyn.SsacSettings(control_weight=0.05, sample_time=0.05),
        outside="nearest",
        max_level=1,
    )
    return capsyn.synthesize(problem)


COSTS = {"potential": lambda x: x[0] ** 2, "speed": lambda x: ca.fabs(x[1])}
BACKENDS = ["numpy", pytest.param("c", marks=needs_compiler)]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("delay", [0.0, 0.05, 0.08])
def test_figures_of_a_trajectory_are_those_of_its_samples(policy, backend, delay):
    x0 = policy.domain.sample(20, 3)
    found = simulate(policy, x0, 3.0, delay=delay, costs=COSTS, backend=backend, substeps=2)
    late, part = divmod(delay, 0.05)
    idle = np.broadcast_to(policy.default, found.controls[:, :1].shape)
    whole = np.concatenate([np.repeat(idle, 3, axis=1), found.controls], axis=1)
    now, before = (whole[:, 3 - int(late) - k :][:, :60] for k in (0, 1))
    for name, size in {"effort": np.square, "fuel": np.abs}.items():
        rate = (size(before) * part + size(now) * (0.05 - part)).sum(axis=(1, 2))
        assert np.allclose(found.figures[name], rate, rtol=1e-9)
    own = policy.model.running_cost  # the same sum by another name is the cost itself
    again = simulate(policy, x0, 3.0, delay=delay, costs={"own": lambda x: x[0] ** 2 + x[1] ** 2},
                     backend=backend, substeps=2)  # fmt: skip
    assert own is not None and np.array_equal(again.figures["own"], found.cost)
    assert (found.figures["potential"] < found.cost).all()


@needs_compiler
def test_both_backends_give_the_same_figures(policy):
    box = Box([0.1], [0.4], names=["v"])
    options = {"duration": 2.0, "noise": 0.1, "delay": 0.07, "avoid": box, "costs": COSTS}
    one, two = (monte_carlo(policy, 50, backend=name, **options) for name in ("c", "numpy"))
    for name in ("effort", "fuel", "potential", "speed"):
        assert np.array_equal(one.figures[name], two.figures[name])
    assert np.array_equal(one.entered, two.entered, equal_nan=True)
    assert np.isfinite(one.entered).any() and not one.success[np.isfinite(one.entered)].any()


def test_a_trial_fails_that_enters_what_it_avoids_or_leaves_where_it_stays(policy):
    x0 = policy.domain.sample(40, 5)
    plain = simulate(policy, x0, 4.0)
    sets = {
        "avoid": (
            Box([0.5], [0.8], names=["x"]),
            lambda x: (x[..., 0] >= 0.5) & (x[..., 0] <= 0.8),
        ),
        "stay_in": (lambda x: x[0] < 1.5, lambda x: ~(x[..., 0] < 1.5)),
    }
    for name, (given, wrong) in sets.items():
        found = simulate(policy, x0, 4.0, **{name: given})
        bad = wrong(plain.states)
        first = np.where(bad.any(axis=1), plain.times[bad.argmax(axis=1)], np.nan)
        assert np.array_equal(found.entered, first, equal_nan=True)
        assert 0 < np.isfinite(first).sum() < 40
        assert np.array_equal(found.states, plain.states)
        told = monte_carlo(policy, 60, duration=4.0, **{name: given})
        free = monte_carlo(policy, 60, duration=4.0)
        assert np.array_equal(told.success, free.success & np.isnan(told.entered))
        data = told.to_json()
        assert data["trials_entered"] == np.isfinite(told.entered).sum() > 0
        assert name in data["conditions"] and "trials_entered" not in free.to_json()
        late = told.entered[np.isfinite(told.entered)]
        assert (late <= told.times[np.isfinite(told.entered)]).all()  # none after the arrival


def test_means_have_their_interval(policy):
    found = monte_carlo(policy, 200, duration=2.0, confidence=0.9, track={"x": 0.0})
    data = found.to_json()
    for figure in (data["figures"]["fuel"], data["tracking"]["x - 0.0"]["rms"]):
        assert figure["min"] <= figure["low"] < figure["mean"] < figure["high"] <= figure["max"]
    values = found.figures["fuel"]
    assert (data["figures"]["fuel"]["low"], data["figures"]["fuel"]["high"]) == mean_interval(
        values, 0.9
    )
    scipy = pytest.importorskip("scipy.stats")
    wanted = scipy.t.interval(0.9, 199, values.mean(), scipy.sem(values))
    assert np.allclose(mean_interval(values, 0.9), wanted)
    assert mean_interval(values[:1], 0.9) is None


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_state_that_is_not_finite_has_left_where_it_must_stay(policy, backend):
    """Within a sample: at the one before it is inside."""
    blow = {"model": lambda x, u: [1 + 0 * u[0], ca.exp(1000 * x[0])], "rate": 1.0, "substeps": 1}
    run = blow | {"backend": backend}
    sets = {"stay_in": Box([-2, -2], [2, 2]), "avoid": Box([1, 1], [2, 2])}
    x0 = [[-0.1, 0.0], [-2.0, 0.0]]
    found = simulate(policy, x0, 2.0, stay_in=sets["stay_in"], **run)
    assert np.isfinite(found.states[0, 0]).all() and not np.isfinite(found.states[0, 1]).all()
    assert np.array_equal(found.entered, [1.0, np.nan], equal_nan=True)
    assert np.isnan(simulate(policy, x0, 2.0, avoid=sets["avoid"], **run).entered).all()
    start, far = Box([-0.1, 0.0], [-0.1, 0.0]), Ball([1.5, 1.5], 0.1)
    trials = monte_carlo(policy, 3, duration=2.0, initial=start, target=far, **run, **sets)
    assert trials.to_json()["trials_entered"] == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"costs": [1]}, "`costs` must be a mapping"),
        ({"costs": {"fuel": lambda x: x[0]}}, "other than cost, effort and fuel; got 'fuel'"),
        ({"costs": {"a": 3}}, "got 'a': 3"),
        ({"costs": {"a": lambda x: x[7]}}, "`costs` failed on symbols"),
        ({"avoid": lambda x: x[0]}, "must return a condition"),
        ({"avoid": Box([5], [6], names=["x"])}, "`avoid` must meet the domain"),
        ({"stay_in": 3}, "`stay_in` must be a Ball, a Box or a function"),
    ],
)
def test_refusals(policy, options, message):
    for run in (
        lambda: simulate(policy, [0, 0], 1.0, **options),
        lambda: monte_carlo(policy, 3, duration=1.0, **options),
    ):
        with pytest.raises(ProblemError, match=message):
            run()


def test_a_cost_that_is_not_finite_is_told_with_how_often(policy):
    costs = {"odd": lambda x: ca.log(x[0] - 100)}
    with pytest.warns(CapsynWarning, match="the cost 'odd' is not finite in 3 of 3 loops"):
        assert np.isnan(
            simulate(policy, policy.domain.sample(3), 0.2, costs=costs).figures["odd"]
        ).all()


@pytest.mark.parametrize("name", ["avoid", "stay_in"])
def test_a_set_that_is_no_condition_is_named(policy, name):
    with pytest.raises(ProblemError, match=f"`{name}` must return a condition"):
        simulate(policy, [0.1, 0.1], 0.2, **{name: lambda x: x[0]})
