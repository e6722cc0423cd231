"""Decision trees of least cost for small labelled grids, by dynamic programming over sub-boxes."""

from __future__ import annotations

import itertools
import math

import numpy as np

FORBIDDEN = 2**40
"""A penalty that no tree of least cost takes; all others together must stay below it."""

Shape = tuple[int, ...]


def sub_box_count(shape: Shape) -> int:
    """Return how many boxes of whole cells a grid has."""
    return math.prod(k * (k + 1) // 2 for k in shape)


def optimal_splits(
    penalty: np.ndarray, leaf_price: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the trees of least cost of B grids, as one list of inner nodes and leaves.

    The cost of a tree is `leaf_price`, at least 1, for each leaf and, for each cell, the penalty of
    the label of its leaf: `penalty` (B, L, k1, .., kn) int64, `FORBIDDEN` where a label is not
    allowed. The least cost of a box is that of one leaf, or the least sum over all ways to cut it
    in two. Of equally good cuts, that with the most even halves is taken.

    Returns axis, cut, first and second (K,): splits ``z[axis] >= cut`` in cells of the grid, axis
    -1 for leaves, and children, -1 for leaves. The first B nodes are the roots.
    """
    sums = _box_sums(penalty)
    costs = _least_costs(penalty, sums, leaf_price)
    grid = penalty.shape[2:]
    batch, size = len(penalty), len(penalty)
    roots = np.column_stack([np.arange(batch), np.zeros((batch, len(grid)), dtype=int)])
    waiting = {grid: [(np.arange(batch), roots)]}
    nodes: list[tuple[np.ndarray, ...]] = []
    for shape in reversed(list(costs)):  # a box comes before its parts
        if shape not in waiting:
            continue
        number, place = (np.concatenate(x) for x in zip(*waiting.pop(shape)))
        axis, cut, cost = _best_cuts(costs, shape, place)
        inner = cost < _leaf_costs(sums, place, shape, leaf_price)
        number, place, axis, cut = number[inner], place[inner], axis[inner], cut[inner]
        if not number.size:
            continue
        children = size + np.arange(2 * len(number)).reshape(2, -1)
        size += children.size
        start = place[np.arange(len(place)), 1 + axis]
        nodes.append((number, axis, start + cut, children[0], children[1]))
        for a, k in set(zip(axis.tolist(), cut.tolist())):
            chosen = (axis == a) & (cut == k)
            low, high = _halves(shape, a, k)
            beside = place[chosen]
            waiting.setdefault(low, []).append((children[0, chosen], beside.copy()))
            beside[:, 1 + a] += k
            waiting.setdefault(high, []).append((children[1, chosen], beside))
    result = np.full((4, size), -1)
    for number, *columns in nodes:
        result[:, number] = columns
    return result[0], result[1], result[2], result[3]


def _least_costs(penalty: np.ndarray, sums: np.ndarray, leaf_price: int) -> dict[Shape, np.ndarray]:
    """Return for each shape of sub-box the least costs (B, k1 - shape1 + 1, ..) by lower corner.

    `sums` is that of `_box_sums`.
    """
    grid = penalty.shape[2:]
    n = len(grid)
    # a tree with a leaf per cell bounds all others
    worst = int((leaf_price + penalty.min(axis=1)).reshape(len(penalty), -1).sum(axis=1).max())
    dtype = np.uint16 if worst < 2**15 else np.int64 if worst >= 2**30 else np.int32
    most = np.iinfo(dtype).max // 2  # two of them do not overflow
    over = [sums] * (n + 1)  # over[i]: sums over boxes of the present shape along the first i axes
    costs: dict[Shape, np.ndarray] = {}
    lines: dict[tuple[int, Shape], list[np.ndarray]] = {}  # costs along one axis, from length 1
    last: Shape = (0,) * n
    for shape in itertools.product(*(range(1, k + 1) for k in grid)):
        changed = next(i for i in range(n) if shape[i] != last[i])
        for axis in range(changed, n):
            sums, size = np.moveaxis(over[axis], 2 + axis, 0), shape[axis]
            over[axis + 1] = np.moveaxis(sums[size:] - sums[:-size], 0, 2 + axis)
        last = shape
        best = np.minimum(over[n].min(axis=1) + leaf_price, most).astype(dtype)
        total = np.empty_like(best)
        for axis, size in enumerate(shape):
            line = lines.setdefault((axis, shape[:axis] + shape[axis + 1 :]), [best])
            end, before = best.shape[1 + axis], (slice(None),) * (1 + axis)
            for k in range(1, size):
                low = line[k][before + (slice(end),)]
                np.add(low, line[size - k][before + (slice(k, k + end),)], out=total)
                np.minimum(best, total, out=best)
            line.append(best)
        costs[shape] = best
    return costs


def _best_cuts(
    costs: dict[Shape, np.ndarray], shape: Shape, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (axis, cut, cost), (P,) each, of the best way to cut each box of a shape in two."""
    most = np.iinfo(np.int64).max
    axis, cut, best, uneven = (np.full(len(place), x) for x in (-1, 0, most, most))
    for a, k in ((a, k) for a, size in enumerate(shape) for k in range(1, size)):
        low, high = _halves(shape, a, k)
        beside = place.copy()
        beside[:, 1 + a] += k
        first = costs[low][tuple(place.T)].astype(np.int64)
        second = costs[high][tuple(beside.T)].astype(np.int64)
        cost, larger = first + second, np.maximum(first, second)
        better = (cost < best) | ((cost == best) & (larger < uneven))
        axis[better], cut[better] = a, k
        best[better], uneven[better] = cost[better], larger[better]
    return axis, cut, best


def _box_sums(penalty: np.ndarray) -> np.ndarray:
    """Return the sums of penalties (B, L, k1 + 1, ..) over boxes from the grids' lower corners."""
    sums = penalty
    for axis in range(2, penalty.ndim):
        sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums.cumsum(axis)], axis)
    return sums


def _leaf_costs(sums: np.ndarray, place: np.ndarray, shape: Shape, leaf_price: int) -> np.ndarray:
    """Return the costs (P,) of boxes of a shape as leaves; `place` (P, 1 + n): grid and corner."""
    total = np.zeros((len(place), sums.shape[1]), dtype=np.int64)
    for corner in itertools.product((0, 1), repeat=len(shape)):
        at = place[:, 1:] + np.array(corner) * shape
        sign = (-1) ** (len(shape) - sum(corner))
        total += sign * np.moveaxis(sums, 1, -1)[tuple(np.column_stack([place[:, 0], at]).T)]
    return total.min(axis=1) + leaf_price


def _halves(shape: Shape, axis: int, k: int) -> tuple[Shape, Shape]:
    low, high = list(shape), list(shape)
    low[axis], high[axis] = k, shape[axis] - k
    return tuple(low), tuple(high)
