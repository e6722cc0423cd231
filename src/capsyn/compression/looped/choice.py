"""The tree that does a policy's work in closed loop with least, or best within a budget."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from capsyn.compression.judge import Judge
from capsyn.compression.looped.loops import Loops, Outcome, Visits
from capsyn.compression.rows import rows_at
from capsyn.improvement.judged import Comparison
from capsyn.policies.guarantee import LoopFigures, cost_ratio
from capsyn.policies.policy import DecisionTree, Policy

CHOICE, JUDGING = 1, 2
"""Purposes of trials: that trees are chosen by, and that judge the chosen one."""
NEAR = 0.05
"""Share of success, and of cost, that the smallest tree may lose against the policy."""
FAILED = 10.0
"""Mean costs that a trial counts which fails where one of the policy does not."""
AT_ONCE = 10_000
"""States whose rows are looked up at a time."""


@dataclass(frozen=True)
class Budget:
    """What a tree may take: so much by a measure; None is as little as possible."""

    limit: int | None = None
    measure: Callable[[DecisionTree], int] = lambda tree: tree.node_count
    name: str = "nodes"

    @property
    def counts_nodes(self) -> bool:
        """Whether nodes are what is limited."""
        return self.name == "nodes"


class Candidate(NamedTuple):
    """A tree, and how its loops compare with those of the policy."""

    tree: DecisionTree
    fewer: float  # share of trials that succeed less, or are lost more, than with the policy
    ratio: float  # mean cost over that of the policy

    @property
    def score(self) -> float:
        """What the tree is chosen by; less is better."""
        return self.ratio + FAILED * self.fewer


@dataclass(frozen=True, eq=False)
class LoopChoice:
    """Trees of a policy, judged by their loops."""

    judge: Judge
    loops: Loops
    budget: Budget
    own: Outcome  # of the policy, on the trials of `CHOICE`
    candidates: list[Candidate]
    say: Callable[[str], None]

    @staticmethod
    def of(
        judge: Judge, loops: Loops, budget: Budget, say: Callable[[str], None] | None = None
    ) -> LoopChoice:
        """Return a choice among no trees yet."""
        own = loops.outcome(judge.policy, CHOICE)
        return LoopChoice(judge, loops, budget, own, [], say or (lambda text: None))

    def look(self, tree: DecisionTree) -> Candidate:
        """Return a tree as a candidate."""
        outcome = self.loops.outcome(tree, CHOICE)
        compared = Comparison.of(self.own.costs, outcome.costs, self.loops.options.confidence)
        ratio = cost_ratio(compared.before, compared.after)
        fewer = float(self.own.success.mean() - outcome.success.mean())
        lost = (compared.lost - compared.lost_before) / len(outcome.success)
        self.candidates.append(Candidate(tree, max(fewer, lost, 0.0), ratio))
        return self.candidates[-1]

    def near(self, one: Candidate) -> bool:
        """Return whether a tree is nearly as good as the policy."""
        return one.fewer <= NEAR * self.own.success.mean() and one.ratio <= 1 + NEAR

    def best(self) -> tuple[Candidate, int]:
        """Return the best candidate within the budget, and what it takes.

        Without a limit it is the smallest that is near the policy. Where none is, or none fits, it
        is the best, or that which takes least.
        """
        measure, limit = self.budget.measure, self.budget.limit
        some = sorted(self.candidates, key=lambda one: (one.score, one.tree.node_count))
        if limit is None:
            good = [one for one in some if self.near(one)]
            chosen = min(good, key=lambda one: one.tree.node_count, default=some[0])
            return chosen, measure(chosen.tree)
        if not self.budget.counts_nodes:
            most = self._nodes_within(limit)
            some = [one for one in some if one.tree.node_count <= most]
        least: tuple[Candidate, int] | None = None
        for one in some:
            size = measure(one.tree)
            if size <= limit:
                return one, size
            least = (one, size) if least is None or size < least[1] else least
        smallest = min(self.candidates, key=lambda one: one.tree.node_count)
        return least or (smallest, measure(smallest.tree))

    def _nodes_within(self, limit: int) -> int:
        """Return about how many nodes a limit allows, by bisection among the candidates."""
        sizes = sorted({one.tree.node_count: one.tree for one in self.candidates}.items())
        low, high = 0, len(sizes)
        while low < high:
            middle = (low + high) // 2
            if self.budget.measure(sizes[middle][1]) <= limit:
                low = middle + 1
            else:
                high = middle
        return sizes[max(low - 1, 0)][0]

    def outcomes(self, policy: Policy) -> tuple[Outcome, Outcome, Visits]:
        """Return what trials that no choice saw do under the policy and under another.

        And the states that the other visits.
        """
        own, other = (self.loops.outcome(each, JUDGING) for each in (self.judge.policy, policy))
        return own, other, self.loops.visits(policy, JUDGING, self.judge.states)

    def judged(self, one: Candidate, size: int) -> DecisionTree:
        """Return a tree with what it guarantees, from trials and states that no choice saw."""
        judge, loops, tree = self.judge, self.loops, one.tree
        own, outcome, seen = self.outcomes(tree)
        confidence = loops.options.confidence
        compared = Comparison.of(own.costs, outcome.costs, confidence)
        changed = 1.0 - judge.compare(tree, with_policy=True).share
        if tree.guarantee.mode == "linear":
            tree = dataclasses.replace(
                tree, guarantee=dataclasses.replace(tree.guarantee, changed=changed)
            )
        figures = LoopFigures(
            trials=len(outcome.success),
            successes=int(outcome.success.sum()),
            own_successes=int(own.success.sum()),
            cost=_finite(compared.after),
            own_cost=_finite(compared.before),
            low=_finite(compared.low),
            high=_finite(compared.high),
            lost=compared.lost,
            own_lost=compared.lost_before,
            switches=outcome.switches,
            own_switches=own.switches,
            visited=len(seen.states),
            agreeing=int(agreeing(judge, tree, seen).sum()),
            confidence=confidence,
            scale=loops.scale,
            duration=loops.options.loop.duration,
            rate=loops.rate,
            target=loops.has_target,
            limit=self.budget.limit,
            size=size,
            measure=self.budget.name,
        )
        tree = judge.judged(tree, None)
        return dataclasses.replace(
            tree, guarantee=dataclasses.replace(tree.guarantee, loop=figures)
        )


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def agreeing(judge: Judge, policy: Policy, visits: Visits) -> np.ndarray:
    """Return whether what follows the label in force (B,) at visited states is right."""
    every = np.arange(len(visits.states))
    parts = [
        rows_at(policy, visits.states[some])[np.arange(len(some)), visits.in_force[some]]
        for some in np.array_split(every, len(every) // AT_ONCE + 1)
    ]
    return np.asarray(judge.right(*visits)[every, np.concatenate(parts)])
