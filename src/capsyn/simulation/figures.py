"""What loops gather beside their cost: effort, fuel, costs by name, and where they must not be.

Costs by name, and samples in a set, are those of the same trials once more, with another running
cost or another target: what is random in them has streams of its own.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from capsyn.errors import ProblemError, warn
from capsyn.modelling.exogenous import of_states
from capsyn.modelling.targets import INSIDE, Target, check_target, target_program
from capsyn.modelling.transcription import target_condition, user_program
from capsyn.programs.builder import ProgramBuilder
from capsyn.programs.program import Program
from capsyn.simulation.closed_loop import Noise
from capsyn.simulation.experiment import Experiment
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import Plant
from capsyn.validation import describe

OWN = ("effort", "fuel")
"""Figures that every trial has: the integrals of ``u^T u`` and of the sum of ``|u|``.

In discrete time they are sums over samples, as costs are.
"""


@dataclasses.dataclass(frozen=True)
class Gathered:
    """What trials gather beside their cost, checked: programs of states."""

    costs: dict[str, Program]  # x -> rate, by name
    forbidden: Program | None  # x -> whether it is where it must not be
    stays: bool  # whether states must stay in a set

    @staticmethod
    def of(options: LoopOptions, plant: Plant) -> Gathered:
        """Return what options ask for; `ProblemError` where they cannot be used."""
        costs = {}
        for name, function in options.costs.items():
            taken = not isinstance(name, str) or not name.isprintable() or name in (*OWN, "cost")
            if taken or not callable(function):
                raise ProblemError(
                    "`costs` must be functions of x by names other than cost, effort and fuel; "
                    f"got {describe(name)}: {describe(function)}"
                )
            told, ports = plant.told, (("x", plant.n),)
            costs[name] = user_program("costs", function, ports, (("cost", 1),), told=told)
        return Gathered(costs, _forbidden(options, plant), options.stay_in is not None)

    def figures(
        self, experiment: Experiment, trials: np.ndarray, before: np.ndarray, noise: Noise | None
    ) -> dict[str, np.ndarray]:
        """Return the figures (T,) of trials that have run, by name; `before` they had not."""
        found = own_figures(experiment, trials)
        for name, program in self.costs.items():
            plant = dataclasses.replace(experiment.plant, running_cost=program)
            loop = dataclasses.replace(experiment.loop, paid=None)
            run = before.copy()
            dataclasses.replace(experiment, plant=plant, loop=loop).run(run, noise, None)
            found[name] = run["cost"].copy()
            if lost := int((~np.isfinite(found[name])).sum()):
                warn(
                    f"the cost '{name}' is not finite in {lost} of {len(run)} loops, which no mean "
                    "of it counts"
                )
        return found

    def entered(
        self, experiment: Experiment, trials: np.ndarray, before: np.ndarray, noise: Noise | None
    ) -> np.ndarray:
        """Return when trials (T,) first were where they must not be [time unit]; NaN where never.

        That is looked at at every sample until their end. A state that is not finite is outside the
        set in which it must stay.
        """
        if self.forbidden is None:
            return np.full(len(trials), np.nan)
        loop = dataclasses.replace(experiment.loop, inside=self.forbidden, stop_at_target=True)
        run = before.copy()
        dataclasses.replace(experiment, loop=loop).run(run, noise, None)
        sample = run["arrived"]
        never = (sample < 0) | (sample > trials["end"])
        left = never & self.stays & ~np.isfinite(trials["state"]).all(axis=1)
        sample, never = np.where(left, trials["end"], sample), never & ~left
        return np.where(never, np.nan, sample / experiment.rate)


def own_figures(experiment: Experiment, trials: np.ndarray) -> dict[str, np.ndarray]:
    """Return the figures (T,) that every trial has, of trials that have run, by name; see `OWN`."""
    mapped = experiment.plant.sample_time is not None
    return {name: trials[name] * (experiment.rate if mapped else 1.0) for name in OWN}


def _forbidden(options: LoopOptions, plant: Plant) -> Program | None:
    """Return whether a state is to be avoided, or beyond where it is to stay."""
    avoid, stay = (_set(name, getattr(options, name), plant) for name in ("avoid", "stay_in"))
    if avoid is None and stay is None:
        return None
    builder = ProgramBuilder()
    x = [builder.input() for _ in range(plant.n)]
    parts = []
    if avoid is not None:
        parts += builder.call(target_program(avoid, plant.space), x)
    if stay is not None:
        (inside,) = builder.call(target_program(stay, plant.space), x)
        parts.append(builder.apply("not", inside))
    result = parts[0] if len(parts) == 1 else builder.apply("or", *parts)
    return builder.build("forbidden", (("x", plant.n),), INSIDE, [result])


def _set(name: str, given: Target | None, plant: Plant) -> Target | None:
    if callable(given) and not isinstance(given, Program):
        given = target_condition(given, plant.states, plant.told, name)
    given = of_states(given, plant.domain, plant.exogenous)
    check_target(given, plant.space, name)
    return given
