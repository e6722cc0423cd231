"""How decision trees of a policy compare with the controller that the policy came from."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from capsyn.cells.masks import Label, masks_of_symbols
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError
from capsyn.policies.guarantee import CONFIDENCE
from capsyn.policies.policy import DecisionTree, Policy, cell_tree
from capsyn.random_streams import derived_seed
from capsyn.validation import describe
from capsyn.verification.agreement import Agreement, Controller, agreement

MOST_CELLS = 10**7
"""A policy with more cells is not advised."""
JUDGING = 6
"""Purpose of the random states at which trees are judged."""


@dataclass(frozen=True, eq=False)
class Judge:
    """What trees of a policy are compared with: a controller, or where there is none the policy."""

    policy: Policy
    name: str  # of the controller: ssac, function or policy
    source: Label | None  # masks of the symbols that are right; None for the policy
    controller: Controller | None  # as `capsyn.agreement` takes it; None for sSAC
    states: int  # how many random states a tree is judged at
    seed: int
    backend: str  # how sSAC is solved

    @staticmethod
    def of(
        policy: Policy, states: int, seed: int, backend: str, controller: Controller | None = None
    ) -> Judge:
        """Return the judge of a policy."""
        if controller is not None:
            if not callable(controller):
                raise ProblemError(f"`controller` must be a function; got {describe(controller)}")
            source = masks_of_symbols(controller, len(policy.alphabet), "controller")
            return Judge(policy, "function", source, controller, states, seed, backend)
        ssac = policy_controller(policy, backend)
        if ssac is None:
            return Judge(policy, "policy", None, policy, states, seed, backend)
        return Judge(policy, "ssac", ssac.masks, None, states, seed, backend)

    @property
    def masks(self) -> Label:
        """States (B, n) to masks (B,) of the symbols that are right there."""
        return self.source or masks_of_symbols(self.policy, len(self.policy.alphabet))

    def compare(self, policy: Policy, look: int = 0, with_policy: bool = False) -> Agreement:
        """Return how a policy compares with the controller, or with the judge's own policy.

        Each `look` is at states of its own.
        """
        return agreement(
            policy,
            self.states,
            controller=self.policy if with_policy else self.controller,
            seed=derived_seed(self.seed, JUDGING, look),
            backend=self.backend,
        )

    def judged(self, tree: DecisionTree, target: float | None, look: int = 0) -> DecisionTree:
        """Return a tree with a target, and its agreement among what it guarantees."""
        comparison = self.compare(tree, look)
        return self.with_counts(tree, target, comparison.states, comparison.agreeing)

    def with_counts(
        self, tree: DecisionTree, target: float | None, states: int, agreeing: int, **known: Any
    ) -> DecisionTree:
        """Return a tree with a target and counts of judging states in what it guarantees."""
        guarantee = dataclasses.replace(
            tree.guarantee,
            controller=self.name,
            states=states,
            agreeing=agreeing,
            target=target,
            **known,
        )
        return dataclasses.replace(tree, guarantee=guarantee)

    def advice(self, tree: DecisionTree) -> str:
        """Return that a tree has missed its target, and what would reach it."""
        had = tree.guarantee
        target = 1.0 if had.target is None else had.target
        text = (
            f"an agreement of {target:.6g} was not reached: the best tree of mode {had.mode} has "
            f"{tree.node_count} nodes and agrees at {had.agreement:.3%} of {had.states} states (at "
            f"least {had.low:.3%} with {CONFIDENCE:.0%} confidence)"
        )
        own = self.compare(self.policy)
        if own.share >= target:
            more = "" if own.low >= target else " (more `states` would tell)"
            return f"{text}; mode exact agrees at {own.share:.3%}{more}"
        if had.agreement >= target:
            return f"{text}; more `states`, or another `seed`, may tell"
        if had.mode == "linear" and self.source is not None:  # not bound to the cells
            return (
                f"{text}; finer cells do not help, for the tree is not bound to them: ask for "
                f"less, such as {_rounded_down(had.low)}, or try another `seed`"
            )
        if self.source is not None:
            text += "; mode linear is not bound to the cells"
        # what cells along a surface get wrong is in proportion to their size; their number grows
        # with the area of the surface in such cells
        cells = cell_tree(self.policy)
        refinement = min(cells.refinement)
        levels = max(math.ceil(math.log((1 - own.share) / (1 - target), refinement)), 1)
        if cells.leaf_count * refinement ** ((cells.n - 1) * levels) > MOST_CELLS:
            return f"{text}; the policy itself agrees at {own.share:.3%}: ask for less"
        return (
            f"{text}; the policy itself agrees at {own.share:.3%}: synthesize it with max_level "
            f"{cells.max_level + levels} or so, then compress"
        )


def _rounded_down(share: float) -> str:
    """Return a share below 1 with two digits of what is missing, rounded down."""
    digits = 1 - math.floor(math.log10(max(1 - share, 1e-12)))
    return f"{math.floor(share * 10**digits) / 10**digits:.{digits}f}"
