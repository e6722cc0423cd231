"""Options of the controller."""

import dataclasses
import json

import numpy as np
import pytest

import capsyn
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.modelling.settings import MAX_STEPS, SsacSettings, usual_sample_time

SOME = [
    SsacSettings(),
    SsacSettings(gamma=-2.5, rule="steepest", on_no_descent="default", precision="single"),
    SsacSettings(alpha_d=-3.0, steps=24, tolerance=1e-3),
    SsacSettings(control_weight=0.25),
    SsacSettings(control_weight=[[2.0, 0.5], [0.5, 1.0]]),
    SsacSettings(application_time="search", initial_duration=0.3, shrink=0.7, max_backtracks=0),
    SsacSettings(descent=0.0, sample_time=0.02),
]

REFUSED = [
    ({"gamma": 1.0}, "`gamma` must be <= 0; got 1"),
    ({"gamma": float("nan")}, "`gamma` must be a finite number; got nan"),
    ({"gamma": "big"}, "`gamma` must be a number; got 'big'"),
    ({"alpha_d": 0.5}, "`alpha_d` must be <= 0; got 0.5"),
    (
        {"alpha_d": -1.0, "gamma": -2.0},
        "`alpha_d` must not be given together with `gamma`; got both",
    ),
    ({"control_weight": -1.0}, "`control_weight` must be a finite number >= 0; got -1.0"),
    ({"control_weight": None}, "`control_weight` must be a number >= 0; got None"),
    (
        {"control_weight": [1.0, 2.0]},
        "`control_weight` must be a matrix of numbers; got [1.0, 2.0]",
    ),
    ({"control_weight": [[1, 2], [3]]}, "`control_weight` must be numbers; got [[1, 2], [3]]"),
    (
        {"control_weight": [[1, 2], [3, 4]]},
        "`control_weight` must be a number or a symmetric (m, m) matrix; got [[1, 2], [3, 4]]",
    ),
    (
        {"control_weight": [[1, 2]]},
        "`control_weight` must be a number or a symmetric (m, m) matrix; got [[1, 2]]",
    ),
    (
        {"control_weight": [[]]},
        "`control_weight` must be a number or a symmetric (m, m) matrix; got [[]]",
    ),
    (
        {"control_weight": [[1, 2], [2, 1]]},
        "`control_weight` must be positive semidefinite; got [[1, 2], [2, 1]]",
    ),
    (
        {"control_weight": [[float("inf")]]},
        "`control_weight` must be finite; got [[inf]]",
    ),
    ({"rule": "best"}, "`rule` must be one of 'schedule', 'steepest'; got 'best'"),
    ({"on_no_descent": 0}, "`on_no_descent` must be one of 'best', 'default'; got 0"),
    ({"precision": "half"}, "`precision` must be one of 'double', 'single'; got 'half'"),
    ({"steps": 0}, f"`steps` must be a whole number >= 1 and <= {MAX_STEPS}; got 0"),
    (
        {"steps": MAX_STEPS + 1},
        f"`steps` must be a whole number >= 1 and <= {MAX_STEPS}; got {MAX_STEPS + 1}",
    ),
    ({"tolerance": 0.0}, "`tolerance` must be a finite number > 0; got 0.0"),
    (
        {"application_time": "later"},
        "`application_time` must be one of 'now', 'search'; got 'later'",
    ),
    ({"initial_duration": 0}, "`initial_duration` must be a finite number > 0; got 0"),
    ({"sample_time": -0.1}, "`sample_time` must be a finite number > 0; got -0.1"),
    ({"sample_time": float("inf")}, "`sample_time` must be a finite number > 0; got inf"),
    ({"max_backtracks": -1}, "`max_backtracks` must be a whole number >= 0 and <= 20; got -1"),
    ({"max_backtracks": 21}, "`max_backtracks` must be a whole number >= 0 and <= 20; got 21"),
    ({"max_backtracks": 4.0}, "`max_backtracks` must be a whole number >= 0 and <= 20; got 4.0"),
    ({"shrink": 0}, "`shrink` must be between 0 and 1; got 0"),
    ({"shrink": 1}, "`shrink` must be between 0 and 1; got 1"),
    ({"shrink": -0.5}, "`shrink` must be a finite number >= 0; got -0.5"),
    ({"descent": 1.0}, "`descent` must be between 0 and 1; got 1"),
    ({"descent": -0.01}, "`descent` must be a finite number >= 0; got -0.01"),
]


@pytest.mark.parametrize(("options", "message"), REFUSED)
def test_refusals(options, message):
    with pytest.raises(ProblemError) as caught:
        SsacSettings(**options)
    assert str(caught.value) == message


@pytest.mark.parametrize("settings", SOME)
def test_json_round_trip_is_equality(settings):
    text = json.dumps(settings.to_json(), allow_nan=False)
    again = SsacSettings(**json.loads(text))
    assert again == settings and hash(again) == hash(settings)


def test_settings_differ_where_a_field_differs():
    assert len(set(SOME)) == len(SOME)
    with pytest.raises(dataclasses.FrozenInstanceError):
        SOME[0].gamma = -1.0


def test_efforts_are_quadratic_forms():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    weight = root @ root.T
    weight = (weight + weight.T) / 2
    values = rng.normal(size=(5, 3))
    settings = SsacSettings(control_weight=weight)
    wanted = [v @ weight @ v for v in values]
    assert np.allclose(settings.efforts(values), wanted, rtol=1e-12)
    scalar = SsacSettings(control_weight=0.5).efforts(values)
    assert np.allclose(scalar, 0.5 * (values**2).sum(axis=1), rtol=1e-12)


def test_efforts_refuse_another_number_of_inputs():
    with pytest.raises(ProblemError) as caught:
        SsacSettings(control_weight=np.eye(2)).efforts(np.zeros((4, 3)))
    assert str(caught.value) == "`control_weight` must be a number or have shape (3, 3); got (2, 2)"
    assert SsacSettings(control_weight=[[2.0]]).efforts(np.array([[3.0]])) == [18.0]


def test_a_singular_weight_and_a_rounded_one_are_semidefinite():
    SsacSettings(control_weight=[[1, 1], [1, 1]])
    column = np.random.default_rng(1).normal(size=(4, 1))
    SsacSettings(control_weight=column @ column.T)


@pytest.mark.parametrize(
    ("horizon", "time"),
    [(0.8, 0.005), (1.0, 0.01), (0.5, 0.005), (0.2, 0.002), (2.5, 0.02), (5e-5, 5e-7), (9e3, 50.0)],
)
def test_a_sample_time_that_nothing_says_is_a_hundredth_of_the_horizon(horizon, time):
    assert usual_sample_time(horizon) == time
    assert SsacSettings().sampled(horizon).period == time
    assert SsacSettings(sample_time=0.3).sampled(horizon).period == 0.3


def test_the_sample_time_of_a_problem_follows_the_horizon_unless_it_is_said():
    def sampled(**changes):
        return capsyn.Problem(
            name="line",
            dynamics=lambda x, u: [u[0]],
            domain=capsyn.Box([-1], [1]),
            alphabet=[-1, 1],
            default=0,
            running_cost=lambda x: x[0] ** 2,
            max_level=0,
            **{"horizon": 1.0} | changes,
        )

    problem = sampled()
    assert problem.settings.period == 0.01
    assert problem.replace(horizon=4.0).settings.period == 0.02
    assert problem.replace(settings=SsacSettings(gamma=-2.0), horizon=4.0).settings.period == 0.02
    said = sampled(settings=SsacSettings(sample_time=0.01))
    assert said.replace(horizon=4.0).settings.period == 0.01
    assert said.replace(settings=SsacSettings(gamma=-2.0)).settings.period == 0.01
    policy = capsyn.synthesize(problem)
    assert policy.settings.sample_time == 0.01
    assert len(capsyn.simulate(policy, [0.5], 1.0).times) == 101
    with pytest.warns(CapsynWarning, match="a sample of 2 s is longer than the horizon of 1 s"):
        capsyn.simulate(policy, [0.5], 4.0, rate=0.5)
    with pytest.raises(ProblemError, match="`settings` must say a `sample_time`"):
        dataclasses.replace(policy, horizon=None, settings=SsacSettings())
