"""What trials have in common, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from capsyn.controllers.online import OnlineController
from capsyn.modelling.domain import Box
from capsyn.modelling.switching import DEFAULT
from capsyn.modelling.targets import describe_target
from capsyn.policies.policy import Policy
from capsyn.simulation.exogenous import pairs_of_steps
from capsyn.simulation.experiment import Experiment
from capsyn.simulation.options import LoopOptions
from capsyn.validation import one_line
from capsyn.verification.trials import TrialOptions, Uniform


def conditions(controller: Any, options: TrialOptions, experiment: Experiment) -> dict[str, Any]:
    """Return what trials have in common, as plain data."""
    loop, rule = options.loop, experiment.outside
    domain, space = experiment.plant.domain, experiment.plant.space
    target = experiment.target
    unit = experiment.plant.time_unit
    return {
        **({} if unit == "s" else {"time_unit": unit}),
        "duration": loop.duration,
        "rate": experiment.rate,
        "within": options.within,
        "hold": options.hold,
        "target": None if target is None else describe_target(target, space),
        "initial": describe_target(options.initial or domain, domain),
        **_limits(loop, space),
        **_holds(experiment),
        "substeps": experiment.loop.substeps,
        "controller": _controller_name(controller),
        "model": "its own" if loop.model is None else _name(loop.model),
        "outside": rule if rule is None or isinstance(rule, str) else controller.symbol_name(rule),
        **({"outside_at_once": True} if experiment.loop.outside_at_once else {}),
        "noise": _plain(loop.noise),
        "delay": _plain(loop.delay),
        "disturbance": _plain(loop.disturbance),
        "parameters": {name: _plain(value) for name, value in loop.parameters.items()},
        **_told(loop.exogenous, experiment.plant.exogenous),
    }


def _limits(loop: LoopOptions, space: Box) -> dict[str, str]:
    """Return where trials must not be, and where they must stay, in words."""
    return {
        name: _name(given) if callable(given) else describe_target(given, space)
        for name in ("avoid", "stay_in")
        if (given := getattr(loop, name)) is not None
    }


def _told(given: Any, told: Box | None) -> dict[str, Any]:
    """Return what was told exogenous inputs along trials, by name."""
    if told is None:
        return {}
    if given is None or isinstance(given, Mapping):
        drawn = dict(zip(told.names, map(Uniform, told.lower, told.upper))) | dict(given or {})
        return {"exogenous": {name: _plain_told(value) for name, value in drawn.items()}}
    return {"exogenous": _plain_told(given, axes=1)}


def _plain_told(value: Any, axes: int = 0) -> Any:
    """Return what is told as plain data; numbers for each trial, of more `axes`, only as words."""
    if isinstance(value, Uniform) or callable(value) or pairs_of_steps(value) is not None:
        return _plain(value)
    return "given for each trial" if np.ndim(value) > axes else _plain(value)


def _holds(experiment: Experiment) -> dict[str, Any]:
    """Return the least times of symbols and inputs, of all symbols where they have the same."""
    holds, rate = experiment.loop.holds, experiment.rate
    each = (holds.symbols / rate).tolist()
    if len(set(each)) == 1 and not holds.inputs.any():
        return {"min_dwell": each[0]}
    alphabet = experiment.controller.alphabet
    names = (*alphabet.names, DEFAULT, *alphabet.inputs)
    times = zip(names, [*each, *(holds.inputs / rate).tolist()])
    return {"min_dwell": 0.0, "holds": {name: time for name, time in times if time}}


def _name(value: Any) -> str:
    """Return the name of a problem, a policy or a function."""
    return one_line(str(getattr(value, "name", getattr(value, "__name__", "a function"))))


def _controller_name(controller: Any) -> str:
    if isinstance(controller, Policy):
        return f"policy {controller.name}"
    return repr(controller) if isinstance(controller, OnlineController) else _name(controller)


def _plain(value: Any) -> Any:
    """Return a quantity of the trials as plain data."""
    if isinstance(value, Uniform):
        return {"low": _plain(value.low), "high": _plain(value.high)}
    if callable(value):
        return "a function of time"
    if (pairs := pairs_of_steps(value)) is not None:  # no other quantity has pairs
        return {repr(float(time)).removesuffix(".0"): _plain(step) for time, step in pairs}
    return np.asarray(value).tolist()
