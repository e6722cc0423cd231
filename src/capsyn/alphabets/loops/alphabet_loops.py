"""Closed loops of sSAC without cells, under many alphabets at once, from the same starts."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.alphabets.candidates import with_alphabet
from capsyn.alphabets.loops.by_numpy import decision, part_of
from capsyn.alphabets.loops.chooser import choices_of, chooser_source, chooses
from capsyn.alphabets.loops.stand_in import in_numbers, stand_in_trials
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.ssac import BatchController, batch_controller
from capsyn.execution.memory import check_memory
from capsyn.execution.processors import processors
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.problem import Problem
from capsyn.modelling.transcription import transcribe
from capsyn.native.compiled import compiled
from capsyn.programs.model import gathered_cost
from capsyn.programs.program import Program
from capsyn.simulation.closed_loop import Noise, Record, new_record, run
from capsyn.simulation.figures import own_figures
from capsyn.simulation.kernel import SimulationKernel
from capsyn.simulation.policy_loop import run_compiled
from capsyn.verification.monte_carlo import Prepared, succeeded, went_on
from capsyn.verification.trials import TrialOptions

FIGURES = ("cost", "effort", "fuel", "time", "switches", "failures")
"""What is told of each loop; see `LoopFigures`."""
AT_ONCE = 1 << 17
"""Trials that run at once, of alphabets of few symbols."""
USES = 1 << 24
"""Most counts of uses of all of them."""
SPREAD_STATES = 512
"""Random states at which what symbols differ by is seen, for prices that are shares."""


@dataclass(frozen=True, eq=False)
class LoopFigures:
    """What closed loops under A alphabets from S starts did.

    Parameters
    ----------
    figures : dict of name to (A, S)
        ``cost`` [cost], ``effort``, the integral of ``u^T u``, ``fuel``, the integral of the sum of
        ``|u|``, ``time`` to the target, or all of it where a loop fails [time unit], ``switches``
        of a loop, and ``failures``, 1 where a loop does not succeed (see `capsyn.monte_carlo`).
    lost : (A, S)
        Loops that left the domain where that ends them, or whose states or costs are not finite.
    used : list of (N,)
        Samples that each symbol of each alphabet was in force.
    """

    figures: dict[str, np.ndarray]
    lost: np.ndarray
    used: list[np.ndarray]


@dataclass(frozen=True, eq=False)
class AlphabetLoops:
    """Closed loops of sSAC without cells, each among the symbols of an alphabet of its own.

    Alphabets are sets of places in a pool of symbols. What they decide is what `BatchController`
    decides for a problem with this alphabet; build the loops by `of`.
    """

    problem: Problem  # with the pool as its alphabet
    formulation: Formulation  # of the problem that was given, its settings with steps
    test: Prepared  # trials from all starts, under the pool
    kernel: SimulationKernel | None
    cost: Program  # x -> what loops gather [cost / time unit]
    backend: str
    threads: int

    @staticmethod
    def of(
        problem: Problem,
        pool: Alphabet,
        plan: TrialOptions,
        cost: Program | None = None,
        backend: str = "auto",
        threads: int | None = None,
    ) -> AlphabetLoops:
        """Return the loops of a problem, whose own alphabet is not used, from the starts of a plan.

        `cost` is the running cost that loops gather; by default the problem's own.
        """
        model = transcribe(problem)
        controller = batch_controller(Formulation.of(problem, model, in_numbers(problem)), backend)
        cost = cost or gathered_cost(model.running_cost, model.terminal_cost)
        formulation = controller.formulation
        given = with_alphabet(problem, pool)
        test = stand_in_trials(given, formulation, plan)
        kernel = None
        if chooses(formulation):
            plant, loop = test.experiment.plant, test.experiment.loop
            plant = dataclasses.replace(plant, running_cost=cost)
            queue = test.trials.dtype["queue"].shape[0]
            discrete = plant.sample_time is not None
            kernel = compiled(
                lambda: SimulationKernel.build(
                    *plant.in_loops, loop.inside, queue, discrete,
                    chooser_source(problem, formulation),
                ),
                backend, "simulating",
            )  # fmt: skip
        threads = processors(threads)
        return AlphabetLoops(given, formulation, test, kernel, cost, backend, threads)

    @property
    def pool(self) -> Alphabet:
        """The symbols that alphabets choose from."""
        return self.problem.alphabet

    @property
    def starts(self) -> int:
        """Number of starts S."""
        return self.test.options.trials

    def over(self, pool: Alphabet, plan: TrialOptions | None = None) -> AlphabetLoops:
        """Return the loops with another pool, and from the starts of another plan if one is given.

        The kernel is the same, and steps between samples are.
        """
        problem = with_alphabet(self.problem, pool)
        plan = plan or self.test.options
        plan = dataclasses.replace(
            plan,
            loop=dataclasses.replace(plan.loop, substeps=self.test.experiment.loop.substeps)
            if self.formulation.model.sample_time is None
            else plan.loop,
        )
        test = stand_in_trials(problem, self.formulation, plan)
        return dataclasses.replace(self, problem=problem, test=test)

    def run(
        self, sets: Sequence[Sequence[int]], starts: slice | np.ndarray = slice(None)
    ) -> LoopFigures:
        """Return what loops under alphabets, sets of places in the pool, do from some starts."""
        alphabets = [np.unique(np.asarray(own, dtype=np.int64)) for own in sets]
        chosen = np.arange(self.starts)[starts]
        longest = max(map(len, alphabets), default=1)
        size = max(1, min(AT_ONCE, USES // longest) // max(1, len(chosen)))
        parts = []
        for first in range(0, len(alphabets), size):
            some = alphabets[first : first + size]
            trials = np.tile(self.test.trials[chosen], len(some))
            trials["alphabet"] = np.repeat(np.arange(len(some)), len(chosen))
            uses = self.advance(some, trials, _part(self.test.noise, np.tile(chosen, len(some))))
            parts.append(self._found(some, trials, uses))
        return LoopFigures(
            {name: np.concatenate([part.figures[name] for part in parts]) for name in FIGURES},
            np.concatenate([part.lost for part in parts]),
            [used for part in parts for used in part.used],
        )

    def visited(self, own: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the states (M, n) at samples of loops under an alphabet, and their symbols (M,).

        These are the states of all starts until their ends; the symbols are those in force.
        """
        trials, plant = self.test.trials.copy(), self.test.experiment.plant
        trials["alphabet"] = 0
        samples = self.test.experiment.loop.samples
        check_memory(
            8.0 * len(trials) * samples * (plant.n + plant.m + 2), "`duration` times `rate`"
        )
        record = new_record(len(trials), samples, plant.n, plant.m)
        noise = self.test.noise
        self.advance([np.unique(np.asarray(own, dtype=np.int64))], trials, noise, record)
        there = record.symbols >= 0
        return record.states[:, :-1][there], record.symbols[there]

    def advance(
        self,
        alphabets: Sequence[np.ndarray],
        trials: np.ndarray,
        noise: Noise | None,
        record: Record | None = None,
    ) -> np.ndarray:
        """Run trials in place, each among the symbols of its alphabet (N,), ascending.

        Returns the samples (T, longest) that each symbol of its alphabet was in force, those of
        least effort first.
        """
        uses = np.zeros((len(trials), max(map(len, alphabets))), dtype=np.int32)
        experiment = self.test.charging(self.cost)
        if self.kernel is None:
            self._by_numpy(alphabets, trials, noise, uses, record)
            return uses
        assert experiment.outside is not None
        priced = self._priced(alphabets)
        choices = choices_of(self.formulation, self._efforts, alphabets, uses, priced)
        run_compiled(
            self.kernel, experiment.controller, experiment.outside, experiment.loop, trials,
            noise, record, self.threads, choices,
        )  # fmt: skip
        return uses

    def figures(self, trials: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the figures (T,) of trials that have run, by name, and which are lost (T,)."""
        experiment, options = self.test.experiment, self.test.options
        lost = ~went_on(trials)
        failed, time = lost, trials["end"] / experiment.rate
        if experiment.target is not None:
            failed = ~succeeded(options, experiment, trials) | lost
            time = np.where(failed, options.loop.duration, trials["arrived"] / experiment.rate)
        found = {
            "cost": trials["cost"],
            **own_figures(experiment, trials),
            "time": time,
            "switches": trials["switches"].astype(float),
            "failures": failed.astype(float),
        }
        return found, lost

    def _found(
        self, alphabets: Sequence[np.ndarray], trials: np.ndarray, uses: np.ndarray
    ) -> LoopFigures:
        """Return the figures of trials, equally many of each alphabet."""
        shape = (len(alphabets), -1)
        figures, lost = self.figures(trials)
        used = []
        for own, row in zip(alphabets, uses.reshape(*shape, uses.shape[1]).sum(axis=1)):
            counts = np.empty(len(own), dtype=np.int64)
            counts[np.argsort(self._efforts[own], kind="stable")] = row[: len(own)]
            used.append(counts)
        return LoopFigures(
            {name: values.reshape(shape).copy() for name, values in figures.items()},
            lost.reshape(shape),
            used,
        )

    @functools.cached_property
    def _efforts(self) -> np.ndarray:
        """Control efforts (K + 1,) of the pool, the default's last."""
        controls = np.vstack([self.pool.values, self.formulation.default])
        return self.formulation.settings.efforts(controls)

    @functools.cached_property
    def _prices(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Prices of switches in the pool, (K + 1, K + 1), and what a spread of 1 adds to them."""
        switching = self.problem.switching
        if switching is None:
            return None
        given = (self.pool, self.problem.default_control)
        plain, more = (switching.with_spread(spread).prices(*given) for spread in (0.0, 1.0))
        return plain, np.where(np.isinf(plain), 0.0, more - np.where(np.isinf(plain), 0.0, plain))

    def _priced(
        self, alphabets: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        if self._prices is None:
            return None
        spreads = np.zeros(len(alphabets))
        if self._prices[1].any():
            spreads = np.array([self._spread(own) for own in alphabets])
        return *self._prices, spreads

    @functools.cached_property
    def _solver(self) -> BatchController:
        """SSAC among the whole pool; its steps are those of the problem that was given."""
        problem = self.problem.replace(settings=self.formulation.settings)
        return batch_controller(
            Formulation.of(problem, transcribe(problem), in_numbers(problem)), self.backend
        )

    def _spread(self, own: np.ndarray) -> float:
        """Return what the scores of an alphabet differ by, as for its own problem; see `priced`."""
        solution = self._seen
        gradients, scales = solution.gradients[:, own], solution.scales[:, own]
        few = part_of(self._solver, own, None)
        return few.spread(dataclasses.replace(solution, gradients=gradients, scales=scales))

    @functools.cached_property
    def _seen(self) -> Any:
        return self._solver.solve(self.problem.space.sample(SPREAD_STATES, 1))

    def _by_numpy(
        self,
        alphabets: Sequence[np.ndarray],
        trials: np.ndarray,
        noise: Noise | None,
        uses: np.ndarray,
        record: Record | None,
    ) -> None:
        """Run trials in place, one alphabet after the other."""
        experiment, priced = self.test.charging(self.cost), self._priced(alphabets)
        plant, samples = experiment.plant, experiment.loop.samples
        for k, own in enumerate(alphabets):
            part = np.flatnonzero(trials["alphabet"] == k)
            prices = None
            if priced is not None:
                labels = np.append(own, len(self.pool))
                prices = (priced[0] + priced[2][k] * priced[1])[np.ix_(labels, labels)]
            some, seen = trials[part], new_record(len(part), samples, plant.n, plant.m)
            few = part_of(self._solver, own, prices)
            table, outside = experiment.controller.controls, experiment.outside
            assert outside is not None
            decide = decision(few, own, table, self.problem.space, outside)
            run(decide, plant, experiment.loop, some, _part(noise, part), seen)
            trials[part] = some
            order = own[np.argsort(self._efforts[own], kind="stable")]
            uses[part, : len(own)] = (seen.symbols[:, :, None] == order).sum(axis=1)
            if record is not None:
                for name, values in vars(seen).items():
                    getattr(record, name)[part] = values


def _part(noise: Noise | None, trials: np.ndarray) -> Noise | None:
    """Return the noise of some trials (T,), by their numbers."""
    if noise is None:
        return None
    return Noise(noise.deviations[trials], [noise.seeds[int(k)] for k in trials])
