"""How decision trees of a policy compare with the controller that the policy came from."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from capsyn.cells.masks import (
    Label,
    empty,
    holds,
    last_all,
    masks_of_members,
    masks_of_symbols,
    members,
    or_else,
    singles,
    word_count,
)
from capsyn.cells.row_table import ROOM, RowTable, row_sets
from capsyn.compression.rows import rows_at
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError
from capsyn.policies.guarantee import CONFIDENCE
from capsyn.policies.policy import DecisionTree, Policy, cell_tree
from capsyn.random_streams import derived_seed
from capsyn.sources.finite_control_set import source_of
from capsyn.statistics import clopper_pearson
from capsyn.validation import describe
from capsyn.verification.agreement import Controller, agreement, masks_in_force

MOST_CELLS = 10**7
"""A policy with more cells is not advised."""
JUDGING = 6
"""Purpose of the random states at which trees are judged."""
ROWS, PILOT = 7, 100_000
"""Purpose and number of those at which the rows of a controller are looked for."""
MOST_ROWS = 256
"""Most rows, beside the constant ones, that trees are fitted with."""


class Comparison(NamedTuple):
    """At how many random states a policy agrees with a controller."""

    states: int
    agreeing: int

    @property
    def share(self) -> float:
        """Share of the states, an estimate of that of the volume."""
        return self.agreeing / self.states

    @property
    def low(self) -> float:
        """Lower end of its Clopper-Pearson interval."""
        return clopper_pearson(self.agreeing, self.states, CONFIDENCE)[0]

    @property
    def high(self) -> float:
        """Upper end of that."""
        return clopper_pearson(self.agreeing, self.states, CONFIDENCE)[1]


@dataclass(frozen=True, eq=False)
class Judge:
    """What trees of a policy are compared with: a controller, or where there is none the policy.

    A tree agrees at a state where its label could be best for every label in force, that is, where
    its whole row is right.
    """

    policy: Policy
    name: str  # of the controller: ssac, function or policy
    source: Label | None  # (B, W) or (B, J, W) masks of the symbols that are right, or the policy
    controller: Controller | None  # as `capsyn.agreement` takes it; None for sSAC
    states: int  # how many random states a tree is judged at
    seed: int
    backend: str  # how sSAC is solved
    remembers: bool  # whether the policy or the controller does
    preference: tuple[int, ...]  # of labels that tie, that in force comes first

    @staticmethod
    def of(
        policy: Policy, states: int, seed: int, backend: str, controller: Controller | None = None
    ) -> Judge:
        """Return the judge of a policy."""
        count = len(policy.alphabet)
        known: dict[str, Any] = {"states": states, "seed": seed, "backend": backend}
        known |= {"remembers": policy.remembers, "preference": tuple(range(count + 1))}
        controller = source_of(policy, backend) if controller is None else controller
        if controller is not None:
            if not callable(controller):
                raise ProblemError(f"`controller` must be a function; got {describe(controller)}")
            source = masks_of_symbols(controller, count, "controller")
            if isinstance(controller, Policy) and controller.remembers:
                if len(controller.alphabet) != count:
                    raise ProblemError(
                        f"`controller` must have {count} symbols like the policy; got {controller}"
                    )
                source, known["remembers"] = _sets_of(controller), True
            own = masks_in_force(controller, count)
            if own is not None:
                source, known["remembers"] = own, True
            return Judge(policy, "function", source, controller, **known)
        ssac = policy_controller(policy, backend)
        if ssac is None:
            return Judge(policy, "policy", None, policy, **known)
        known["remembers"] = policy.remembers or ssac.in_force > 1
        return Judge(policy, "ssac", ssac.masks, None, **known | {"preference": ssac.preference})

    def sets(self, states: np.ndarray) -> np.ndarray:
        """Return the labels that are right at states (B, n), as bit masks (B, J, W); none is empty.

        J is 1 where nothing remembers. Where the controller has no finite answer the default is
        right, and where what is right may not follow the label in force, that label. A controller
        that does not remember has the same answer for all.
        """
        labels = len(self.policy.alphabet) + 1
        sets = (self.source or _sets_of(self.policy))(states).astype(np.uint64, copy=False)
        sets = or_else(sets.reshape(len(states), -1, sets.shape[-1]), labels - 1)
        if not self.remembers:
            return sets[:, -1:]
        forbidden = self.policy.rules.forbidden
        if forbidden.any():
            sets = sets & masks_of_members(~forbidden)
            stay = singles(np.arange(labels), labels)
            return np.where(empty(sets)[..., None], stay, sets)
        return np.broadcast_to(sets, (len(sets), labels, sets.shape[-1]))

    def rows(self) -> tuple[np.ndarray, float]:
        """Return the rows (R, N + 1) that trees are fitted with, and the share where one is right.

        They are the constant ones and, of the others that the controller has at random states, the
        `MOST_ROWS` most frequent, in order.
        """
        policy = self.policy
        constant = policy.transitions[: len(policy.alphabet) + 1]
        if not self.remembers:
            return constant, 1.0
        table = RowTable(self.preference, len(constant))
        numbers = [np.empty(0, dtype=np.int32)]
        for states in self._drawn(PILOT, derived_seed(self.seed, ROWS)):
            sets = self.sets(states)
            numbers.append(table.uniform(sets, np.ones(len(sets), dtype=bool)))
        counts = np.bincount(np.concatenate(numbers), minlength=len(constant))
        often = len(constant) + np.argsort(-counts[len(constant) :], kind="stable")[:MOST_ROWS]
        kept = np.unique(table.labels()[often], axis=0)
        share = (counts[: len(constant)].sum() + counts[often].sum()) / PILOT
        return np.concatenate([constant, kept]), float(share)

    def right(self, states: np.ndarray, in_force: np.ndarray) -> np.ndarray:
        """Return which labels may follow those in force (B,) at states (B, n), (B, N + 1)."""
        labels = len(self.policy.alphabet) + 1
        found = np.empty((len(states), labels), dtype=bool)
        for some in self._parts(len(states)):
            sets = self.sets(states[some])
            now = in_force[some] if sets.shape[1] > 1 else 0
            found[some] = members(sets[np.arange(len(sets)), now], labels)
        return found

    def masks(self, rows: np.ndarray) -> Label:
        """Return a function of states (B, n) to masks (B, W) of the rows (R, N + 1) right there.

        Where none is, a mask is 0.
        """

        def masks(states: np.ndarray) -> np.ndarray:
            found = np.empty((len(states), word_count(len(rows))), dtype=np.uint64)
            for some in self._parts(len(states)):
                found[some] = row_sets(self.sets(states[some]), rows)
            return found

        return masks

    def _parts(self, count: int) -> Iterator[slice]:
        """Yield slices of so many states of which sets do not take much memory."""
        labels = len(self.policy.alphabet) + 1
        size = max(1, ROOM // (8 * (labels if self.remembers else 1) * word_count(labels)))
        yield from (slice(start, min(start + size, count)) for start in range(0, count, size))

    def _drawn(self, count: int, seed: int) -> Iterator[np.ndarray]:
        """Yield ``domain.sample(count, seed)``, some states at a time."""
        domain, random = self.policy.space, np.random.default_rng(seed)
        for some in self._parts(count):
            cube = random.random((some.stop - some.start, domain.n))
            yield domain.lower + cube * domain.widths

    def compare(self, policy: Policy, look: int = 0, with_policy: bool = False) -> Comparison:
        """Return how a policy compares with the controller, or with the judge's own policy.

        Each `look` is at states of its own.
        """
        seed = derived_seed(self.seed, JUDGING, look)
        if self.remembers:
            sets = _sets_of(self.policy) if with_policy else self.sets
            agreeing = sum(
                int(last_all(holds(sets(states), rows_at(policy, states))).sum())
                for states in self._drawn(self.states, seed)
            )
            return Comparison(self.states, agreeing)
        found = agreement(
            policy,
            self.states,
            controller=self.policy if with_policy else self.controller,
            seed=seed,
            backend=self.backend,
        )
        return Comparison(found.states, found.agreeing)

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


def _sets_of(policy: Policy) -> Label:
    """Return a function of states (B, n) to what follows each label in force, masks (B, J, W)."""
    labels = len(policy.alphabet) + 1
    return lambda states: singles(rows_at(policy, states), labels)


def _rounded_down(share: float) -> str:
    """Return a share below 1 with two digits of what is missing, rounded down."""
    digits = 1 - math.floor(math.log10(max(1 - share, 1e-12)))
    return f"{math.floor(share * 10**digits) / 10**digits:.{digits}f}"
