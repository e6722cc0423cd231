"""The trade-off between the size of a controller and its agreement."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from capsyn.compression.coarsening import cut_off
from capsyn.compression.compress import MAX_STATES
from capsyn.compression.judge import Judge
from capsyn.compression.rows import policy_bytes
from capsyn.compression.trees import exact_tree, free_trees, linear_tree
from capsyn.errors import ProblemError
from capsyn.policies.policy import DecisionTree, Policy, cell_tree
from capsyn.validation import BACKENDS, one_of, whole_number

NODE_PRICES = (2.0, 0.5, 0.1)
"""Of mode freedom: what saving a node is worth, in finest cells of disagreement."""
TARGETS = (0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
"""Of mode linear; those beyond the first that is missed are not tried."""


@dataclass(frozen=True)
class CurvePoint:
    """A controller, its size and its agreement."""

    mode: str  # exact, freedom, linear, or cells: the policy, or what is left of it at a level
    level: int | None  # below which cells were merged
    options: str  # of ``capsyn compress`` that make it; "" for cells
    nodes: int  # of the tree, or entries of the table of cells
    depth: int  # most comparisons of a lookup, or most levels that it goes down
    bytes: int  # of its arrays, rows among them, each in the smallest integers that hold it
    agreement: float  # share of the volume where it agrees with sSAC, or else the policy
    low: float  # Clopper-Pearson interval of that share
    high: float
    smallest: bool = False  # whether no other point agrees as much with fewer bytes

    def to_json(self) -> dict[str, Any]:
        """Return the point as plain data."""
        return dataclasses.asdict(self)


def size_curve(
    policy: Policy,
    *,
    states: int = 100_000,
    seed: int = 0,
    backend: str = "auto",
    progress: Callable[[str], None] | None = None,
) -> tuple[CurvePoint, ...]:
    """Return the sizes and agreements of a policy of cells and its trees, by mode and level.

    `states`, `seed` and `backend` are as in `compress`; `progress` is told in words what is next.
    """
    cell_tree(policy)
    if policy.gaps:
        raise ProblemError("`policy` must have no gaps: modes exact and freedom keep those")
    states = whole_number("states", states, least=1, most=MAX_STATES)
    seed = whole_number("seed", seed, least=0)
    one_of("backend", backend, BACKENDS)
    judge = Judge.of(policy, states, seed, backend)
    say = progress or (lambda text: None)
    points = [*_cell_points(judge, say), *_tree_points(judge, say), *_linear_points(judge, say)]
    return tuple(
        dataclasses.replace(point, smallest=not any(_beats(other, point) for other in points))
        for point in points
    )


def _beats(one: CurvePoint, other: CurvePoint) -> bool:
    """Return whether one point is as good in bytes and agreement, and better in one of them."""
    size, share = one.bytes - other.bytes, one.agreement - other.agreement
    return size <= 0 <= share and (size, share) != (0, 0.0)


def _cell_points(judge: Judge, say: Callable[[str], None]) -> Iterator[CurvePoint]:
    for level in range(cell_tree(judge.policy).depth + 1):
        say(f"cells at level {level}")
        base = cut_off(judge.policy, level)
        comparison = judge.compare(base)
        size = base.cells.node_count, 1 + level, policy_bytes(base)
        share = comparison.share, comparison.low, comparison.high
        yield CurvePoint("cells", level, "", *size, *share)


def _tree_points(judge: Judge, say: Callable[[str], None]) -> Iterator[CurvePoint]:
    policy, last = judge.policy, cell_tree(judge.policy).depth
    for level in range(last + 1):
        say(f"trees at level {level}")
        cut = None if level == last else level
        option = "" if cut is None else f" --level {level}"
        tree = judge.judged(exact_tree(policy, cut), None)
        yield _point(tree, level, f"--mode exact{option}")
        for price, tree in zip(NODE_PRICES, free_trees(judge, cut, NODE_PRICES)):
            yield _point(tree, level, f"--mode freedom{option} --node-price {price:g}")


def _linear_points(judge: Judge, say: Callable[[str], None]) -> Iterator[CurvePoint]:
    for target in TARGETS:
        say(f"linear trees for {target:.1%}")
        tree = linear_tree(judge, target)
        yield _point(tree, None, f"--mode linear --agreement {target:g}")
        if not tree.guarantee.reached:
            break


def _point(tree: DecisionTree, level: int | None, options: str) -> CurvePoint:
    had = tree.guarantee
    size = tree.node_count, tree.depth, policy_bytes(tree)
    return CurvePoint(had.mode, level, options, *size, had.agreement, had.low, had.high)
