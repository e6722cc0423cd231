"""What each symbol costs when a policy takes over after one sample: rollouts [1]_.

References
----------
.. [1] D. P. Bertsekas, Rollout, policy iteration, and distributed reinforcement learning, Athena
   Scientific, 2020.
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np

from capsyn.cells.masks import cheapest, masks_of_members, word_count
from capsyn.controllers.ssac import policy_controller
from capsyn.improvement.charged_loop import ChargedLoop, efforts_of
from capsyn.random_streams import derived_seed

HELD = 1 << 40
"""Samples that an input has been held which may change."""
SCALED, SCALING = 128, 1
"""Random states at which what symbols differ by is seen, and the purpose of their seed."""


@dataclass(frozen=True)
class Start:
    """How a trial begins: a label in force for one sample, and what its timers say after it."""

    label: int
    held: int  # samples that it has been held
    held_inputs: tuple[int, ...]  # likewise of each input


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Costs of holding each label for one sample and then following a policy.

    ``Q_i(x)`` is what the loop charges for holding label i for exactly one sample from x, or longer
    where it has a least time that is running, and then following the policy, until a horizon ends.
    Then there is the terminal cost, if the loop has one.
    """

    loop: ChargedLoop
    samples: int  # of a horizon, 2 at least
    labels: tuple[int, ...]  # that are tried: symbols, and N, the default, where the policy has it
    in_force: int  # labels in force that are told apart: 1, or N + 1, the default last

    @staticmethod
    def of(loop: ChargedLoop, samples: int) -> Rollouts:
        """Return the rollouts of the policy in a loop over so many samples."""
        policy = loop.policy
        count = len(policy.alphabet)
        usual = bool(policy.volume_shares[count])
        remembers = policy.switching is not None or policy.remembers
        labels = tuple(range(count + usual))
        return Rollouts(loop, samples, labels, count + 1 if remembers else 1)

    @functools.cached_property
    def _plan(self) -> tuple[list[Start], np.ndarray]:
        """Starts that differ, and which of them (J, I) a label in force and the next one have."""
        holds, controls = self.loop.loop.holds, self.loop.policy.controls
        locks = np.maximum(holds.inputs, 1)
        starts: dict[Start, int] = {}
        table = np.zeros((self.in_force, len(self.labels)), dtype=int)
        for j in range(self.in_force):
            for i in self.labels:
                enters = self.in_force == 1 or holds.kinds[i] != holds.kinds[j]
                changed = enters if self.in_force == 1 else controls[i] != controls[j]
                timers = np.where(changed, 1, locks)
                held = 1 if enters else max(1, int(holds.symbols[i]))
                start = Start(i, held, tuple(timers.tolist()))
                table[j, i] = starts.setdefault(start, len(starts))
        return list(starts), table

    def costs(self, states: np.ndarray) -> np.ndarray:
        """Return the costs (B, J, I) of the labels tried, for each label in force.

        The price of the first switch is among them. They are infinite where a trial left the domain
        under a rule that ends it, or is not finite, and where a transition is forbidden.
        """
        starts, table = self._plan
        found = np.stack([self._from(states, start) for start in starts], axis=1)[:, table]
        if self.in_force > 1:
            found += self.loop.prices[:, list(self.labels)] * self.loop.charged_time
        return np.asarray(found)

    def _from(self, states: np.ndarray, start: Start) -> np.ndarray:
        """Return the costs (B,) of trials from states (B, n) that begin with a label."""
        loop = self.loop
        settings, control = loop.loop, loop.policy.controls[start.label]
        x, zeros = np.ascontiguousarray(states.T), np.zeros(len(states))
        u = np.repeat(control[:, None], len(states), axis=1)
        still, none = np.zeros_like(x), np.zeros((0, 1))
        period = np.full(len(states), settings.period)
        then, cost = loop.plant.advance(x, zeros, u, none, still, period, settings.substeps)
        trials = loop.new(np.ascontiguousarray(then.T))
        assert settings.paid is not None
        trials["cost"] = cost + settings.paid[start.label, start.label]
        trials["symbol"] = -1 if start.label == len(loop.policy.alphabet) else start.label
        trials["control"], trials["held"] = control, start.held
        trials["held_inputs"] = start.held_inputs
        costs = loop.costs(trials, self.samples - 1)
        if loop.end is not None:
            costs = costs + loop.end.evaluate(trials["state"].T)[0][0]
        return np.where(np.isnan(costs), np.inf, costs)

    def scored(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return masks (B, J, W), or (B, W), of the labels that cost least, and scores (B, 1, S).

        Where no cost is finite it is the policy's own label. Scores are what labels save against
        the mean of all, of the default in force, without prices [cost / time unit].
        """
        costs = self.costs(states)
        count = len(self.loop.policy.alphabet)
        good = cheapest(costs)
        lost = np.asarray(~good.any(axis=2))
        if lost.any():
            good = self._own(states, good, lost)
        masks = masks_of_members(good, word_count(count + 1))
        entering = costs[:, -1]
        with np.errstate(invalid="ignore"):
            saved = entering.mean(axis=1, keepdims=True) - entering
        scores = saved[:, None] / self.loop.charged_time
        return (masks[:, 0] if self.in_force == 1 else masks), scores

    def _own(self, states: np.ndarray, good: np.ndarray, lost: np.ndarray) -> np.ndarray:
        """Return which labels (B, J, I) are best, the policy's own where all are `lost` (B, J)."""
        policy = self.loop.policy
        for j in range(self.in_force):
            some = np.flatnonzero(lost[:, j])
            now = len(policy.alphabet) if self.in_force == 1 else j
            own = policy.leaves(states[some], True, in_force=np.full(len(some), now, np.int32))
            good[some, j] = own[:, None] == np.array(self.labels)
        return good


def charged_scale(loop: ChargedLoop, samples: int) -> float:
    """Return what effort and prices count in closed loops, beside the cost of their trials.

    They count as much, against what symbols differ by, as they do for the controller that the
    policy came from: of its horizon and terminal cost closed loops know nothing.
    """
    policy = loop.policy
    prices = policy.rules.prices
    if not np.ptp(efforts_of(policy)[:-1]) and not prices[np.isfinite(prices)].any():
        return 1.0
    known = policy.statistics.get("improve", {}).get("scale")
    controller = policy_controller(policy, loop.backend) if known is None else None
    if controller is None:
        return 1.0 if known is None else float(known)
    states = policy.space.sample(SCALED, derived_seed(0, SCALING))
    own = controller.spread(controller.solve(states))
    rollouts = Rollouts.of(dataclasses.replace(loop, end=None), samples)
    costs = rollouts.costs(states)[:, -1]
    spreads = np.ptp(costs[np.isfinite(costs).all(axis=1)], axis=1) / loop.charged_time
    scale = float(np.median(spreads)) / own if spreads.size and own > 0 else 1.0
    return scale if np.isfinite(scale) and scale > 0 else 1.0
