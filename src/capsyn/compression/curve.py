"""The trade-off between the size of a controller and its agreement, or what its loops do."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from capsyn.compression.coarsening import cut_off
from capsyn.compression.compress import MAX_STATES
from capsyn.compression.judge import Judge
from capsyn.compression.looped.by_loop import loop_choice, trial_options
from capsyn.compression.looped.choice import FAILED, Budget, LoopChoice, agreeing
from capsyn.compression.rows import policy_bytes
from capsyn.compression.trees import exact_tree, free_trees, linear_tree
from capsyn.errors import ProblemError
from capsyn.improvement.judged import Comparison
from capsyn.policies.guarantee import cost_ratio
from capsyn.policies.policy import DecisionTree, Policy, cell_tree
from capsyn.validation import BACKENDS, one_of, whole_number

NODE_PRICES = (2.0, 0.5, 0.1)
"""Of mode freedom: what saving a node is worth, in finest cells of disagreement."""
LOOP_NODES = (5, 9, 15, 21, 31, 47, 63, 95, 127)
"""Most nodes of trees that loops choose."""
TARGETS = (0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
"""Of mode linear; those beyond the first that is missed are not tried."""


@dataclass(frozen=True)
class CurvePoint:
    """A controller, its size and its agreement."""

    mode: str  # exact, freedom, linear, or cells: the policy, or what is left of it at a level
    level: int | None  # below which cells were merged
    options: str  # of ``capsyn compress`` that make it; "" for cells, and for trees by loops
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


@dataclass(frozen=True)
class LoopPoint(CurvePoint):
    """A controller, its size, and what its closed loops do, beside those of the policy.

    It is the `smallest` where no other with fewer nodes does as well in cost and success.
    """

    visited: float = math.nan  # share of the states its loops visit where it agrees with sSAC
    success: float = math.nan  # share of the loops
    cost_ratio: float = math.nan  # mean cost over that of the policy
    switches: float = math.nan  # per time unit


def size_curve(
    policy: Policy,
    *,
    states: int = 100_000,
    seed: int = 0,
    backend: str = "auto",
    judge: str = "volume",
    progress: Callable[[str], None] | None = None,
    **loop: Any,
) -> tuple[CurvePoint, ...]:
    """Return the sizes and agreements of a policy of cells and its trees, by mode and level.

    `states`, `seed` and `backend` are as in `compress`; `progress` is told in words what is next.
    With `judge` "loop" points are `LoopPoint`, trees chosen by loops are among them, mode ``loop``,
    and `loop` are arguments of `capsyn.monte_carlo`, as there.
    """
    cell_tree(policy)
    if policy.gaps:
        raise ProblemError("`policy` must have no gaps: modes exact and freedom keep those")
    if policy.kept is not None:
        raise ProblemError("`policy` must not be made to keep limits: most trees would not")
    states = whole_number("states", states, least=1, most=MAX_STATES)
    seed = whole_number("seed", seed, least=0)
    one_of("backend", backend, BACKENDS)
    by_loop = one_of("judge", judge, ("volume", "loop")) == "loop"
    if loop and not by_loop:
        raise ProblemError(f"`{next(iter(loop))}` is for judge 'loop' only")
    known = Judge.of(policy, states, seed, backend)
    say = progress or (lambda text: None)
    if not by_loop:
        return marked([point for point, _ in _volume_points(known, say)])
    choice = loop_choice(known, trial_options(policy, seed, backend, loop), LOOP_NODES[-1], say)
    points = [_in_loop(choice, *one) for one in _volume_points(known, say)]
    return marked([*points, *_loop_points(choice, say)])


def marked(points: list[Any]) -> tuple[Any, ...]:
    """Return points with a mark on those that none beats."""
    return tuple(
        dataclasses.replace(point, smallest=not any(_beats(other, point) for other in points))
        for point in points
    )


def _beats(one: CurvePoint, other: CurvePoint) -> bool:
    """Return whether one point is as good in size and worth, and better in one of them."""
    size, worth = _size(one) - _size(other), _worth(one) - _worth(other)
    return size <= 0 <= worth and (size, worth) != (0, 0.0)


def _size(point: CurvePoint) -> int:
    """Return the bytes of a point, or the nodes where its loops are known."""
    return point.nodes if isinstance(point, LoopPoint) else point.bytes


def _worth(point: CurvePoint) -> float:
    """Return the agreement of a point, or what its loops do for their cost."""
    return score_of(point) if isinstance(point, LoopPoint) else point.agreement


def score_of(point: LoopPoint) -> float:
    """Return what trees that loops judge are chosen by, the larger the better; at least -1e9."""
    return max(-point.cost_ratio - FAILED * (1 - point.success), -1e9)


_Point = tuple[CurvePoint, Policy]


def _volume_points(judge: Judge, say: Callable[[str], None]) -> Iterator[_Point]:
    """Yield the points of a policy and its trees, each with what it is of."""
    yield from _cell_points(judge, say)
    yield from _tree_points(judge, say)
    yield from _linear_points(judge, say)


def _in_loop(choice: LoopChoice, point: CurvePoint, policy: Policy) -> LoopPoint:
    """Return a point with what the loops of its policy do, by trials that no choice saw."""
    own, outcome, seen = choice.outcomes(policy)
    compared = Comparison.of(own.costs, outcome.costs, choice.loops.options.confidence)
    return LoopPoint(
        **vars(point),
        visited=float(agreeing(choice.judge, policy, seen).mean())
        if len(seen.states)
        else math.nan,
        success=float(outcome.success.mean()),
        cost_ratio=cost_ratio(compared.before, compared.after),
        switches=outcome.switches,
    )


def _loop_points(choice: LoopChoice, say: Callable[[str], None]) -> Iterator[LoopPoint]:
    """Yield the trees that loops choose, for several numbers of nodes."""
    found: set[int] = set()
    for nodes in LOOP_NODES:
        one, size = dataclasses.replace(choice, budget=Budget(nodes)).best()
        if size in found or size > nodes:
            continue
        found.add(size)
        say(f"tree of {size} nodes")
        tree = choice.judge.judged(one.tree, None)
        point = _point(tree, None, "")  # another is grown where a budget is known
        yield _in_loop(choice, dataclasses.replace(point, mode="loop"), tree)


def _cell_points(judge: Judge, say: Callable[[str], None]) -> Iterator[_Point]:
    for level in range(cell_tree(judge.policy).depth + 1):
        say(f"cells at level {level}")
        base = cut_off(judge.policy, level)
        comparison = judge.compare(base)
        size = base.cells.node_count, 1 + level, policy_bytes(base)
        share = comparison.share, comparison.low, comparison.high
        yield CurvePoint("cells", level, "", *size, *share), base


def _tree_points(judge: Judge, say: Callable[[str], None]) -> Iterator[_Point]:
    policy, last = judge.policy, cell_tree(judge.policy).depth
    for level in range(last + 1):
        say(f"trees at level {level}")
        cut = None if level == last else level
        option = "" if cut is None else f" --level {level}"
        tree = judge.judged(exact_tree(policy, cut), None)
        yield _point(tree, level, f"--mode exact{option}"), tree
        for price, tree in zip(NODE_PRICES, free_trees(judge, cut, NODE_PRICES)):
            yield _point(tree, level, f"--mode freedom{option} --node-price {price:g}"), tree


def _linear_points(judge: Judge, say: Callable[[str], None]) -> Iterator[_Point]:
    for target in TARGETS:
        say(f"linear trees for {target:.1%}")
        tree = linear_tree(judge, target)
        yield _point(tree, None, f"--mode linear --agreement {target:g}"), tree
        if not tree.guarantee.reached:
            break


def _point(tree: DecisionTree, level: int | None, options: str) -> CurvePoint:
    had = tree.guarantee
    size = tree.node_count, tree.depth, policy_bytes(tree)
    return CurvePoint(had.mode, level, options, *size, had.agreement, had.low, had.high)
