"""The closed loop of a policy with all that it costs: running cost, effort, and prices."""

from __future__ import annotations

import dataclasses
import threading
from dataclasses import dataclass

import numpy as np

from capsyn.controllers.command import TIME
from capsyn.execution.processors import pool_of
from capsyn.modelling.alphabet import Outside, check_outside
from capsyn.modelling.discrete import check_period
from capsyn.modelling.targets import target_program
from capsyn.policies.policy import Policy
from capsyn.programs.model import gathered_cost
from capsyn.programs.program import Program
from capsyn.simulation.closed_loop import Holds, Loop, new_trials
from capsyn.simulation.plant import Plant, choose_substeps, plant_of
from capsyn.simulation.policy_loop import run_policy

ACCURACY = 1e-6
"""Error of a sample that is allowed, in widths of the domain per time unit."""
PIECE = 1 << 18
"""Runge-Kutta steps that a thread goes without looking whether it is to stop."""


@dataclass(frozen=True, eq=False)
class ChargedLoop:
    """The closed loop of a policy, whose trials are charged for all that they do.

    A trial is charged its running cost, or where a problem has none its terminal cost as one; the
    effort ``u^T R u`` beyond that of the cheapest symbol, times the time that symbols are held; and
    for each switch its price times a sample, which is what it costs the decision. Effort and prices
    are charged times a scale.
    """

    policy: Policy
    plant: Plant  # whose running cost is what trials are charged
    loop: Loop  # with `paid`: effort and prices of a sample
    prices: np.ndarray  # (N + 1, N + 1) of switches [cost / time unit], infinite: forbidden
    end: Program | None  # x -> cost of where a trial ends, if any
    outside: Outside
    backend: str
    threads: int
    stopped: threading.Event  # set when work is to end

    @staticmethod
    def of(policy: Policy, rate: float, backend: str, threads: int) -> ChargedLoop:
        """Return the loop of a policy with its own model, at a rate [samples per time unit].

        It charges no effort and no prices; see `charging`.
        """
        plant = plant_of(policy)
        cost = gathered_cost(plant.running_cost, plant.terminal_cost)
        end = plant.terminal_cost.first if cost is plant.running_cost else None
        plant = dataclasses.replace(plant, running_cost=cost)
        period, rules = 1 / rate, policy.rules
        check_period(plant.sample_time, plant.time_unit, "rate", period)
        none = np.zeros((0, 1))
        loop = Loop(
            period,
            1,
            choose_substeps(plant, policy.controls, none, period, ACCURACY),
            Holds.of(rules, period),
            policy.outside_at_once,
            target_program(None, plant.space),
            False,
            policy.default_control,
        )
        rule = check_outside(policy.outside, policy.alphabet)
        return ChargedLoop(policy, plant, loop, rules.prices, end, rule, backend, threads,
                           threading.Event()).charging(0.0)  # fmt: skip

    def charging(self, scale: float) -> ChargedLoop:
        """Return the loop that charges effort and prices times a scale."""
        known = self.policy.rules.prices
        prices = np.where(
            np.isfinite(known), scale * np.where(np.isfinite(known), known, 0.0), np.inf
        )
        paid = paid_by(self.policy, scale) * self.charged_time
        return dataclasses.replace(
            self, loop=dataclasses.replace(self.loop, paid=paid), prices=prices
        )

    @property
    def charged_time(self) -> float:
        """What costs per time unit count over a sample."""
        return self.plant.charged_time(self.loop.period)

    def new(self, states: np.ndarray) -> np.ndarray:
        """Return trials (B,) before their first sample, from readings (B, n)."""
        none = np.zeros((len(states), 0))
        delays, push = np.zeros(len(states)), np.zeros_like(states)
        return new_trials(states, self.plant.m, delays, none, push, self.loop.period)

    def costs(self, trials: np.ndarray, samples: int) -> np.ndarray:
        """Return what trials (B,) have cost after some samples, infinite where they ended before.

        They run in place, in this thread, and go on from what they have cost so far.

        Raises
        ------
        InterruptedError
            It was `stopped` meanwhile.
        """
        loop = dataclasses.replace(self.loop, samples=samples)
        size = max(8, PIECE // max(1, samples * loop.substeps) // 8 * 8)
        for start in range(0, len(trials), size):
            if self.stopped.is_set():
                raise InterruptedError
            part = trials[start : start + size]
            run_policy(
                self.policy, self.outside, self.plant, loop, part, None, None, self.backend, 1
            )
        costs = np.where(trials["ended"] == TIME, trials["cost"], np.inf)
        return np.where(np.isnan(costs), np.inf, costs)

    def costs_from(self, states: np.ndarray, samples: int) -> np.ndarray:
        """Return what trials (B,) from readings (B, n) cost over some samples, by all threads."""
        trials, size = self.new(states), max(8, -(-len(states) // (8 * self.threads)))
        parts = [trials[k : k + size] for k in range(0, len(trials), size)]
        with pool_of(self.threads) as pool:
            return np.concatenate(list(pool.map(lambda part: self.costs(part, samples), parts)))


def efforts_of(policy: Policy) -> np.ndarray:
    """Return the efforts (N + 1,) of labels beyond that of the cheapest symbol [cost / time unit].

    They are those of the policy's settings; 0 without settings.
    """
    if policy.settings is None:
        return np.zeros(len(policy.controls))
    efforts = policy.settings.efforts(policy.controls)
    return np.asarray(efforts - efforts[:-1].min())


def paid_by(policy: Policy, scale: float) -> np.ndarray:
    """Return what labels of a policy are charged, by label before and taken [cost / time unit].

    That is (N + 1, N + 1): effort and prices, of transitions that are not forbidden, times a scale.
    """
    prices = policy.rules.prices
    return np.asarray(
        scale * np.where(np.isfinite(prices), prices, 0.0) + scale * efforts_of(policy)
    )
