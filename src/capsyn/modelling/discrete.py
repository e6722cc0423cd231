"""Discrete-time models: what a problem, or a policy, whose dynamics are a map must say."""

from __future__ import annotations

import dataclasses
from typing import Any

from capsyn.errors import ProblemError
from capsyn.modelling.settings import MAX_STEPS
from capsyn.validation import describe, finite_number, keep, true_or_false, whole_number

PART = 1e-9
"""Samples by which a time that must be a whole number of them may be off, by rounding."""


def whole_samples(name: str, time: float, sample_time: float, least: int = 0) -> int:
    """Return how many steps of a map, each of a sample time, make a time; a `ProblemError` else."""
    samples = time / sample_time
    whole = round(min(samples, 2.0**52))
    if abs(samples - whole) > PART * max(1, whole) or whole < least:
        raise ProblemError(
            f"`{name}` must be a whole number of samples of {sample_time:g}, those of the "
            f"discrete-time model; got {time:g}"
        )
    return whole


def refuse_map(source: Any, name: str, why: str) -> None:
    """Raise `ProblemError` where a problem or a policy is in discrete time."""
    if source.discrete:
        raise ProblemError(
            f"`{name}` must have dynamics that are rates, not the map of a discrete-time model: "
            + why
        )


def charged_time(own: float | None, period: float) -> float:
    """Return what a cost per time unit counts over a period [time unit].

    Of a map, which has its `own` sample time, costs are per sample and count once.
    """
    return period if own is None else 1.0


def check_period(own: float | None, unit: str, name: str, period: float) -> None:
    """Raise unless a sample time, or one over a ``"rate"``, as `name` says, is a map's `own`.

    An own one of None is that of rates, which have any; times are in a unit.
    """
    if own is None or abs(period / own - 1) <= PART:
        return
    wanted, got = (1 / own, 1 / period) if name == "rate" else (own, period)
    raise ProblemError(
        f"`{name}` must be {wanted:g}, or left out: the model is a map that is sampled every "
        f"{own:g} {unit}; got {got:g}"
    )


def horizon_time(source: Any) -> float | None:
    """Return the horizon of a problem or a policy as a time [time unit], if it has one."""
    if source.horizon is None or not source.discrete:
        return source.horizon
    period = source.settings.sample_time if source.settings else source.model.sample_time
    return float(source.horizon * period)


def horizon_text(policy: Any) -> str:
    """Return the horizon of a policy that has settings, and its steps, in words."""
    horizon, unit, settings = policy.horizon, policy.time_unit, policy.settings
    if policy.discrete:
        each = f"{settings.sample_time!r} {unit}"
        kind = settings.sensitivity or "exact"
        return f"horizon {horizon:g} samples of a discrete-time model, each {each}, {kind}"
    return f"horizon {horizon!r} {unit}, {settings.steps} steps"


def check_discrete(problem: Any) -> None:
    """Check what is said of a map, and keep the settings with the problem's sample time."""
    true_or_false("discrete", problem.discrete)
    if problem.sample_time is not None:
        time = finite_number("sample_time", problem.sample_time, above=0.0)
        settings = dataclasses.replace(problem.settings, sample_time=time)
        keep(problem, sample_time=time, settings=settings)
    settings = problem.settings
    if not problem.discrete:
        if settings.sensitivity is not None:
            raise ProblemError(
                "`sensitivity` must be left out unless the problem is `discrete`: rates have mode "
                f"insertion gradients; got {settings.sensitivity!r}"
            )
        return
    if problem.sample_time is None:
        raise ProblemError(
            "`sample_time` must be given for a `discrete` problem: the time of one step of its map"
        )
    whole_samples("delay", problem.delay, problem.sample_time)


def check_samples(problem: Any) -> None:
    """Check the horizon of a map, in samples, and that no other steps are asked for."""
    if not problem.discrete:
        return
    horizon = problem.horizon
    if isinstance(horizon, float) and horizon.is_integer():
        horizon = int(horizon)
    if not isinstance(horizon, int) or isinstance(horizon, bool):
        raise ProblemError(
            "`horizon` must be a whole number of samples for a `discrete` problem; got "
            + describe(problem.horizon)
        )
    samples = whole_number("horizon", horizon, least=1, most=MAX_STEPS)
    steps = problem.settings.steps if problem.settings else None
    if steps not in (None, samples):
        raise ProblemError(
            "`steps` must be left out for a `discrete` problem: its map is iterated once a sample; "
            f"got {steps}"
        )
    keep(problem, horizon=float(samples))


def check_map(policy: Any) -> None:
    """Raise `ProblemError` unless a policy fits the map that its model is, if it is one."""
    if not policy.discrete:
        return
    time, settings = policy.model.sample_time, policy.settings
    if settings is not None and abs(settings.sample_time / time - 1) > PART:
        raise ProblemError(
            f"`settings` must have the sample time of the model's map, {time:g}; got "
            f"{settings.sample_time:g}"
        )
    if policy.horizon is not None:
        check_samples(policy)
    whole_samples("delay", policy.delay, time)
