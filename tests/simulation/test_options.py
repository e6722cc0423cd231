"""Loop options: each said once, and carried on whole by the functions that list them."""

import dataclasses
import inspect

import pytest

from capsyn import Ball, monte_carlo, simulate
from capsyn.errors import ProblemError
from capsyn.simulation import simulate as simulation
from capsyn.simulation.options import LoopOptions
from capsyn.verification import monte_carlo as verification
from support.closed_loops import relay

DEFAULTS = {field.name: field.default for field in dataclasses.fields(LoopOptions)}
VALUES = {
    "duration": 3.0,
    "rate": 7.0,
    "model": "m",
    "parameters": {"a": 1.0},
    "disturbance": 0.1,
    "noise": 0.2,
    "delay": 0.3,
    "min_dwell": 0.4,
    "outside": "nearest",
    "outside_at_once": True,
    "target": Ball([0], 1),
    "stop_at_target": True,
    "substeps": 5,
    "seed": 6,
    "backend": "numpy",
    "threads": 8,
    "executor": "e",
    "exogenous": [0.7],
    "avoid": Ball([0], 2),
    "stay_in": Ball([0], 3),
    "costs": {"a": abs},
}


@pytest.mark.parametrize("function", [simulate, monte_carlo])
def test_functions_have_the_defaults_of_the_options(function):
    said = {name: p.default for name, p in inspect.signature(function).parameters.items()}
    own = {name: value for name, value in said.items() if value is not inspect.Parameter.empty}
    assert all(own[name] == DEFAULTS[name] for name in own.keys() & DEFAULTS.keys())


def test_every_option_is_one_of_the_functions():
    known = {name for f in (simulate, monte_carlo) for name in inspect.signature(f).parameters}
    assert set(DEFAULTS) == set(VALUES) and set(DEFAULTS) <= known


def test_simulate_carries_every_option_on(monkeypatch):
    monkeypatch.setattr(simulation, "trajectories", lambda controller, x0, options: options)
    values = {name: value for name, value in VALUES.items() if name != "executor"}
    assert vars(simulate(relay(), [0.5], **values)) == values | {"executor": None}


def test_monte_carlo_carries_every_option_on(monkeypatch):
    monkeypatch.setattr(verification, "try_out", lambda controller, options: options)
    left_out = ("stop_at_target", "executor")
    values = {name: value for name, value in VALUES.items() if name not in left_out}
    trials = {
        "trials": 9,
        "initial": Ball([0], 2),
        "tolerance": 0.5,
        "within": 2.0,
        "hold": 1.0,
        "confidence": 0.9,
        "track": {"x": 1.0},
    }
    options = vars(monte_carlo(relay(), **trials, **values))
    loop = options.pop("loop")
    assert options == trials and vars(loop) == values | {"stop_at_target": False, "executor": None}


def test_monte_carlo_carries_an_executor_on(monkeypatch):
    monkeypatch.setattr(verification, "try_out", lambda controller, options: options)
    assert monte_carlo(relay(), executor="e").loop.executor == "e"
    with pytest.raises(ProblemError, match="`track` must be left out with an `executor`"):
        monte_carlo(relay(), executor="e", track={"x": 1.0})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "`seed` must be a whole number >= 0"),
        ({"duration": 0}, "`duration` must be a finite number > 0"),
        ({"rate": 0}, "`rate` must be a finite number > 0"),
        ({"parameters": 3}, "`parameters` must be a mapping of names; got 3"),
        ({"min_dwell": -1}, "`min_dwell` must be a finite number >= 0"),
        ({"outside_at_once": 1}, "`outside_at_once` must be True or False; got 1"),
        ({"substeps": 0}, "`substeps` must be a whole number >= 1"),
        ({"backend": "x"}, "`backend` must be one of"),
        ({"threads": 0}, "`threads` must be a whole number >= 1"),
    ],
)
def test_what_can_be_checked_alone_is_checked_at_once(options, message):
    with pytest.raises(ProblemError) as caught:
        LoopOptions(**options)
    assert str(caught.value).startswith(message)
