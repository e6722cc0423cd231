"""How decision trees of a policy compare with the controller that the policy came from."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from capsyn.decision_tree import DecisionTree
from capsyn.masks import Label, masks_of_symbols
from capsyn.policy import Policy, cell_tree
from capsyn.ssac import BatchController, policy_controller
from capsyn.verification.agreement import Agreement, agreement

JUDGING = 2**32
"""Added to the seed for the states at which trees are judged: no fit uses these."""


@dataclass(frozen=True, eq=False)
class Judge:
    """sSAC by a policy's own model, or where it has none the policy, as judge of trees.

    Parameters
    ----------
    policy : Policy
        The policy.
    ssac : BatchController or None
        Its controller.
    states, seed : int
        How many random states a tree is judged at, and their seed.
    backend : "auto", "c" or "numpy"
        How sSAC is solved.
    """

    policy: Policy
    ssac: BatchController | None
    states: int
    seed: int
    backend: str

    @staticmethod
    def of(policy: Policy, states: int, seed: int, backend: str) -> Judge:
        """Return the judge of a policy."""
        return Judge(policy, policy_controller(policy, backend), states, seed, backend)

    @property
    def masks(self) -> Label:
        """States (B, n) to masks (B,) of the symbols that are right there."""
        if self.ssac is not None:
            return self.ssac.masks
        return masks_of_symbols(self.policy, len(self.policy.alphabet))

    def compare(self, policy: Policy, with_policy: bool = False) -> Agreement:
        """Return how a policy compares with the controller, or with the judge's own policy."""
        return agreement(
            policy,
            self.states,
            controller=self.policy if with_policy or self.ssac is None else None,
            seed=self.seed + JUDGING,
            backend=self.backend,
        )

    def judged(self, tree: DecisionTree, target: float | None = None, **known: Any) -> DecisionTree:
        """Return a tree with its agreement among what it guarantees."""
        found = self.compare(tree)
        guarantee = dataclasses.replace(
            tree.guarantee,
            controller="policy" if self.ssac is None else "ssac",
            states=found.states,
            agreeing=found.agreeing,
            confidence=found.confidence,
            low=found.low,
            high=found.high,
            **known,
        )
        return aimed(dataclasses.replace(tree, guarantee=guarantee), target)

    def advice(self, tree: DecisionTree) -> str:
        """Return that a tree has missed its target, and what would reach it."""
        had = tree.guarantee
        target = 1.0 if had.target is None else had.target
        text = (
            f"an agreement of {target:.6g} was not reached: the best tree of mode {had.mode} has "
            f"{tree.node_count} nodes and agrees at {had.agreement:.3%} of {had.states} states (at "
            f"least {had.low:.3%} with {had.confidence:.0%} confidence)"
        )
        if had.agreement >= target:
            return f"{text}; more `states` may tell"
        own = self.compare(self.policy)
        if own.share >= target:
            more = "" if own.low >= target else " (more `states` would tell)"
            return f"{text}; mode exact agrees at {own.share:.3%}{more}"
        # what cells along a surface get wrong is in proportion to their size
        cells = cell_tree(self.policy)
        levels = math.log((1 - own.share) / (1 - target), min(cells.refinement))
        return (
            f"{text}; the policy itself agrees at {own.share:.3%}: synthesize it with max_level "
            f"{cells.max_level + max(math.ceil(levels), 1)} or so, then compress"
        )


def aimed(tree: DecisionTree, target: float | None) -> DecisionTree:
    """Return a judged tree with a target, and whether it is reached, in what it guarantees."""
    reached = target is None or tree.guarantee.low >= target
    guarantee = dataclasses.replace(tree.guarantee, target=target, reached=reached)
    return dataclasses.replace(tree, guarantee=guarantee)
