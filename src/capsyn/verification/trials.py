"""Trials from random initial states: their options, and what is drawn for each."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.targets import check_initial, placed
from capsyn.simulation.exogenous import ExogenousSignal, exogenous_signal
from capsyn.simulation.experiment import per_state
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import Plant
from capsyn.simulation.tracking import check_tracked
from capsyn.statistics import check_confidence
from capsyn.validation import describe, finite_number, keep, whole_number

MOST_TRIALS = 10**8
JUDGED_BY = ("avoid", "stay_in", "costs")
"""Arguments of `monte_carlo` alone, which trees and tuning are not judged by."""


@dataclass(frozen=True)
class Uniform:
    """A quantity that every trial draws anew, uniformly between two bounds.

    Parameters
    ----------
    low, high : float or (n,)
        Bounds of the quantity [its unit], ``low <= high``.
    """

    low: Any
    high: Any


@dataclass(frozen=True)
class TrialOptions:
    """What `monte_carlo` is asked for, checked as far as it can be without the plant.

    The fields are its arguments; those of a closed loop are in `loop`.

    Raises
    ------
    ProblemError
        A value that cannot be used.
    """

    loop: LoopOptions
    trials: int = 1000
    initial: Ball | Box | None = None
    tolerance: float | None = None
    within: Any = None
    hold: float = 0.0
    confidence: float = 0.95
    track: Mapping[str, str | float] | None = None

    @staticmethod
    def names() -> set[str]:
        """Return the names of all arguments."""
        fields = (*dataclasses.fields(TrialOptions), *dataclasses.fields(LoopOptions))
        return {field.name for field in fields} - {"loop", *JUDGED_BY}

    @staticmethod
    def of(*, without: Collection[str] = (), **arguments: Any) -> TrialOptions:
        """Return the options that arguments of `monte_carlo` mean, by name.

        Those `without` are none here.

        Raises
        ------
        ProblemError
            There is no argument of a name, or a value cannot be used.
        """
        for name in arguments:
            if name not in TrialOptions.names() or name in (*without, *JUDGED_BY):
                raise ProblemError(f"there is no argument `{name}` of closed loops")
        shared = {f.name for f in dataclasses.fields(LoopOptions)}
        loop = LoopOptions(**{name: v for name, v in arguments.items() if name in shared})
        return TrialOptions(loop, **{n: v for n, v in arguments.items() if n not in shared})

    def __post_init__(self) -> None:
        keep(self, trials=whole_number("trials", self.trials, least=1, most=MOST_TRIALS))
        keep(self, confidence=check_confidence(self.confidence))
        duration = self.loop.duration
        within = duration if self.within is None else self.within
        keep(self, within=finite_number("within", within, above=0.0))
        keep(self, hold=finite_number("hold", self.hold, least=0.0))
        if self.track is not None:
            check_tracked(self.track)
            if self.loop.executor is not None:
                raise ProblemError("`track` must be left out with an `executor`")
        for name in ("hold", "within"):
            time = getattr(self, name)
            if time > duration:
                raise ProblemError(
                    f"`{name}` must be at most the duration {duration:g}; got {time:g}"
                )


@dataclass(frozen=True, eq=False)
class Drawn:
    """What trials draw; the fields are those of `capsyn.verification.outcome.MonteCarlo`."""

    initial: np.ndarray
    parameters: Mapping[str, np.ndarray]
    delays: np.ndarray
    disturbances: np.ndarray
    noises: np.ndarray
    exogenous: np.ndarray


def drawn_parameters(options: TrialOptions) -> dict[str, np.ndarray]:
    """Return the parameters of the plant by name, (T,) each."""
    seed = options.loop.seed
    return {
        name: _draw(f"parameters {name}", value, options.trials, 1, [seed, 1, k + 1])[:, 0]
        for k, (name, value) in enumerate(options.loop.parameters.items())
    }


def drawn_exogenous(
    options: TrialOptions, told: Box | None, period: float, samples: int
) -> ExogenousSignal:
    """Return the exogenous inputs of trials of some samples, each `period` long.

    What is not given by name is drawn from its box, and constant along a trial.
    """
    given, count, seed = options.loop.exogenous, options.trials, options.loop.seed
    if told is not None and (given is None or isinstance(given, Mapping)):
        drawn = told.sample(count, [seed, 8])
        given = {name: drawn[:, i] for i, name in enumerate(told.names)} | dict(given or {})
        for k, (name, value) in enumerate(given.items()):
            if isinstance(value, Uniform):
                one = _draw(f"exogenous {name}", value, count, 1, [seed, 9, k])
                given[name] = one[:, 0]
    return exogenous_signal(given, told, (count,), period, samples)


def draw(
    options: TrialOptions,
    plant: Plant,
    parameters: Mapping[str, np.ndarray],
    exogenous: np.ndarray,
) -> Drawn:
    """Return what trials of a plant draw besides their parameters, each from its own stream."""
    loop, count, n, seed = options.loop, options.trials, plant.states, options.loop.seed
    initial, domain = options.initial, plant.domain
    check_initial(initial, domain)
    states = placed(domain.sample(count, [seed, 6]), initial, domain, [seed, 7])
    disturbances, noises = np.zeros((count, n)), np.zeros((count, n))
    if loop.disturbance is not None and not callable(loop.disturbance):
        disturbances = _draw("disturbance", loop.disturbance, count, n, [seed, 2])
    delays = _draw("delay", loop.delay, count, 1, [seed, 3], least=0.0)[:, 0]
    if loop.noise is not None:
        given = loop.noise.low if isinstance(loop.noise, Uniform) else loop.noise
        size = plant.n if np.shape(given) == (plant.n,) else n
        noises = _draw("noise", loop.noise, count, size, [seed, 4], least=0.0)
    return Drawn(states, parameters, delays, disturbances, noises, exogenous)


def _draw(
    name: str, value: Any, count: int, size: int, seed: list[int], least: float | None = None
) -> np.ndarray:
    """Return (count, size) values, the same for all trials or drawn for each."""
    if not isinstance(value, Uniform):
        return np.tile(per_state(name, value, size, least), (count, 1))
    low = per_state(f"{name} low", value.low, size, least)
    high = per_state(f"{name} high", value.high, size)
    if (high < low).any():
        raise ProblemError(f"`{name}` must have low <= high; got {describe(value)}")
    return low + (high - low) * np.random.default_rng(seed).random((count, size))
