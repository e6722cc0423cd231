"""Closed loops of a policy and of its trees: where they go, what they cost, which succeed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from capsyn.controllers.command import NONE
from capsyn.execution.processors import processors
from capsyn.improvement.charged_loop import ChargedLoop, paid_by
from capsyn.improvement.rollouts import charged_scale
from capsyn.policies.policy import Policy
from capsyn.programs.model import gathered_cost
from capsyn.random_streams import derived_seed, stream
from capsyn.simulation.closed_loop import Noise, new_record
from capsyn.simulation.experiment import Experiment
from capsyn.verification.monte_carlo import (
    RECORDED,
    Prepared,
    prepared,
    succeeded,
    switch_rate,
    went_on,
)
from capsyn.verification.trials import TrialOptions

LOOPS = 8
"""Purpose of all that is random here."""
SCALED = 500
"""Most samples of the loops that show what effort and prices count."""


class Outcome(NamedTuple):
    """What T trials of a policy did."""

    success: np.ndarray  # (T,) bool
    costs: np.ndarray  # (T,), infinite where a trial left the domain or was not finite
    switches: float  # per time unit, over all trials


class Visits(NamedTuple):
    """States that closed loops visit, and the labels in force there."""

    states: np.ndarray  # (B, n), exogenous inputs after the states
    in_force: np.ndarray  # (B,) ints; the default is N

    def first(self, count: int) -> Visits:
        """Return the first, at most `count`."""
        return Visits(self.states[:count], self.in_force[:count])


@dataclass(frozen=True, eq=False)
class Loops:
    """Closed loops of policies that differ in nothing but their cells and rows.

    A loop costs the running cost that it gathers, or the terminal cost over time where there is no
    running cost; and times a scale the effort beyond that of the cheapest symbol, and the price of
    each switch times a sample. What trials draw depends on their purpose alone.
    """

    policy: Policy
    options: TrialOptions
    scale: float  # of effort and prices
    tests: dict[int, tuple[Prepared, Experiment]] = field(default_factory=dict)  # by purpose

    @staticmethod
    def of(policy: Policy, options: TrialOptions) -> Loops:
        """Return the loops of a policy; `ProblemError` for options that do not fit it."""
        experiment = Loops(policy, options, 1.0)._test(0)[1]
        loop = options.loop
        samples = min(max(2, experiment.loop.samples), SCALED)
        if policy.model is None:  # then there are no prices and no settings either
            return Loops(policy, options, 1.0)
        threads = processors(loop.threads)
        known = ChargedLoop.of(policy, experiment.rate, loop.backend, threads)
        return Loops(policy, options, charged_scale(known, samples))

    def _test(self, purpose: int) -> tuple[Prepared, Experiment]:
        """Return the trials of a purpose, and what they run in; drawn once."""
        if purpose in self.tests:
            return self.tests[purpose]
        seed = derived_seed(self.options.loop.seed, LOOPS, purpose)
        loop = dataclasses.replace(self.options.loop, seed=seed)
        test = prepared(self.policy, dataclasses.replace(self.options, loop=loop))
        plant = test.experiment.plant
        cost = gathered_cost(plant.running_cost, plant.terminal_cost)
        charged = plant.charged_time(test.experiment.loop.period)
        paid = paid_by(self.policy, self.scale) * charged
        self.tests[purpose] = test, test.charging(cost, paid)
        return self.tests[purpose]

    def outcome(self, policy: Policy, purpose: int) -> Outcome:
        """Return what the trials of a purpose do under a policy."""
        test, experiment = self._test(purpose)
        trials = test.trials.copy()
        dataclasses.replace(experiment, controller=policy).run(trials, test.noise, None)
        regular = went_on(trials)
        success = regular
        if experiment.target is not None:
            success = succeeded(test.options, experiment, trials)
        costs = np.where(regular, trials["cost"], np.inf)
        return Outcome(success, costs, switch_rate(experiment, trials))

    def visits(self, policy: Policy, purpose: int, count: int) -> Visits:
        """Return about `count` of the states that the trials of a purpose visit, in no order.

        For states outside the domain there are the nearest ones in it where these decide.
        """
        test, experiment = self._test(purpose)
        experiment = dataclasses.replace(experiment, controller=policy)
        samples, plant, noise = experiment.loop.samples, experiment.plant, test.noise
        size = max(1, RECORDED // (8 * (samples + 1) * (plant.n + plant.m + 2)))
        rng = stream(self.options.loop.seed, LOOPS, purpose, 1)
        share = min(1.0, 2 * count / (samples * len(test.trials)))
        states, in_force = list[np.ndarray](), list[np.ndarray]()
        for start in range(0, len(test.trials), size):
            some = test.trials[start : start + size].copy()
            part = slice(start, start + len(some))
            own = None if noise is None else Noise(noise.deviations[part], noise.seeds[part])
            record = new_record(len(some), samples, plant.n, plant.m)
            experiment.run(some, own, record)
            before = np.full(record.symbols.shape, -1)
            before[:, 1:] = record.symbols[:, :-1]
            seen = (record.symbols != NONE) & (rng.random(before.shape) < share)
            states.append(record.states[:, :-1][seen])
            in_force.append(before[seen])
        found, now = np.concatenate(states), np.concatenate(in_force)
        kept = np.isfinite(found).all(axis=1)
        if experiment.outside != "nearest":
            kept &= self.policy.space.contains(found)
        order = rng.permutation(np.flatnonzero(kept))[:count]
        space, now = self.policy.space, now[order]
        inside = np.clip(space.wrap(found[order]), space.lower, space.upper)
        return Visits(inside, np.where(now < 0, len(self.policy.alphabet), now))

    @property
    def rate(self) -> float:
        """Samples per time unit."""
        return self._test(0)[1].rate

    @property
    def has_target(self) -> bool:
        """Whether trials are to arrive somewhere; else they succeed where they go on to the end."""
        return self._test(0)[1].target is not None
