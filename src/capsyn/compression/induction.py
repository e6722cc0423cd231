"""Small axis-aligned trees that give every cell a label it may take: numbers of rows.

Top down, a box is cut where a plane separates most unlike cells and cuts least through like ones.
Once a box is small enough, the tree of least cost of it is found by dynamic programming. Only
faces between unlike cells are looked at, so that work and memory grow with the switching surface
and not with the volume, and no fine grid is ever formed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from capsyn.cells.cell_tree import CellTree, ragged
from capsyn.cells.faces import Faces, shared_faces
from capsyn.cells.masks import empty, holds, members
from capsyn.cells.split_tree import LEAF, SplitTree, depth_first
from capsyn.compression.optimal import FORBIDDEN, optimal_splits, sub_box_count

CUT_PENALTY = 0.1
"""What a unit of area cut between like cells counts against one between unlike cells."""
OFF_MIDDLE = 1e-3
"""What a cut costs that is a length of the box away from its middle: it decides among equals."""
TOUCHING = 0.25
"""What a face counts between cells that may take a common label; 1 where they may not."""
GREEDY_DEPTH = 40
"""Cuts above a box from which on it is cut in half."""
BUDGETS = {1: 1_000_000, 2: 1_000_000, 3: 100_000}
"""Most sub-boxes of a box whose tree of least cost is searched, by number of axes."""
BUDGET = 10_000
"""The same for more axes."""
MAX_VOLUME = 2**20
"""Finest cells that a larger cell counts as: dearer than any node, and sums do not overflow."""
MEMORY = 200_000_000
"""Bytes that the dynamic programme may take at once, roughly."""


@dataclass(frozen=True, eq=False)
class Prices:
    """What each of L labels costs in the cells of a policy."""

    masks: np.ndarray  # (M, W) uint64: labels that each entry of the cells may take
    priced: np.ndarray  # (K,): entries, ascending, where the labels differ in price
    prices: np.ndarray  # (K, L) ints: price of each label there, per finest cell, 0 or more
    leaf_price: int  # price of a leaf, 1 or more

    @property
    def label_count(self) -> int:
        """Number of labels L."""
        return self.prices.shape[1]

    def of(
        self, entries: np.ndarray, volumes: np.ndarray, labels: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the penalties (B, C) of entries (B,) of some volumes (B,) [finest cells].

        They are those of `labels` (B, C), where -1 is none, by default of all L. Volumes count up
        to `MAX_VOLUME`.
        """
        if labels is None:
            labels = np.tile(np.arange(self.label_count), (len(entries), 1))
        penalties = np.zeros(labels.shape, dtype=np.int64)
        if len(self.priced):
            place = np.searchsorted(self.priced, entries) % len(self.priced)
            known = self.priced[place] == entries
            whole = np.minimum(volumes[known], MAX_VOLUME).astype(np.int64)
            prices = self.prices[place[known, None], labels[known]]
            penalties[known] = prices * whole[:, None]
        sets = np.broadcast_to(self.masks[entries, None], (*labels.shape, self.masks.shape[1]))
        penalties[(labels < 0) | ~holds(sets, np.maximum(labels, 0))] = FORBIDDEN
        return penalties

    def candidates(self, sets: np.ndarray) -> np.ndarray:
        """Return the labels (B, C) that sets (B, W) hold, ascending, then -1."""
        held = members(sets, self.label_count)
        set_of, label = np.nonzero(held)
        counts = held.sum(axis=1)
        labels = np.full((len(sets), int(counts.max(initial=1))), -1)
        labels[set_of, ragged(counts)[1]] = label
        return labels


def apart(masks: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return whether no label is in the masks (M, W) of both of two entries (B,) each."""
    return _compared(masks, one, other, lambda a, b: empty(a & b))


def unlike(masks: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return whether the masks (M, W) of two entries (B,) each differ."""
    return _compared(masks, one, other, lambda a, b: (a != b).any(axis=1))


def _compared(
    masks: np.ndarray,
    one: np.ndarray,
    other: np.ndarray,
    tell: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return what is told (B,) of the masks of two entries each, some at a time."""
    told = np.empty(len(one), dtype=bool)
    size = max(1, MEMORY // (32 * masks.shape[1]))
    for start in range(0, len(one), size):
        some = slice(start, start + size)
        told[some] = tell(masks[one[some]], masks[other[some]])
    return told


def induce(cells: CellTree, prices: Prices, budget: int | None = None) -> SplitTree:
    """Return a small tree whose label is allowed in every cell.

    Trees of least cost are searched of boxes with at most `budget` sub-boxes, by default `BUDGETS`.
    """
    budget = BUDGETS.get(cells.n, BUDGET) if budget is None else budget
    faces = shared_faces(cells, lambda below, above: unlike(prices.masks, below, above))
    weight = np.where(apart(prices.masks, faces.below, faces.above), 1.0, TOUCHING)
    nodes, blocks = _cut(cells, faces, weight, budget)
    _solve(cells, prices, blocks, nodes)
    return _merged(_labelled(_depth_first(nodes, cells.counts), cells, prices))


@dataclass(frozen=True, eq=False)
class _Block:
    """A box that is small enough for the dynamic programme.

    ``cuts`` holds, for each axis, the lower bound of the box and the planes inside it on which
    unlike cells meet: its grid of cells, whatever their size.
    """

    node: int
    cuts: list[np.ndarray]
    upper: np.ndarray

    @property
    def order(self) -> np.ndarray:
        """The axes, those with most cells first."""
        return np.argsort([-len(c) for c in self.cuts], kind="stable")

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each axis, in that order and rounded up, so that few shapes occur."""
        sizes = (len(self.cuts[a]) for a in self.order)
        return tuple(k + k % 2 if 4 < k <= 12 else k for k in sizes)

    def corners(self) -> np.ndarray:
        """Return the lower corners (prod(shape), n) of the cells; the last ones are repeated."""
        axes = self.order
        points = [
            self.cuts[a][np.minimum(np.arange(k), len(self.cuts[a]) - 1)]
            for a, k in zip(axes, self.shape)
        ]
        grid = np.stack(np.meshgrid(*points, indexing="ij"), axis=-1).reshape(-1, len(axes))
        return grid[:, np.argsort(axes)]

    def volumes(self) -> np.ndarray:
        """Return the finest cells in each cell, (prod(shape),) floats; 0 in repeated ones."""
        total = np.ones(1)
        for a, k in zip(self.order, self.shape):
            width = np.zeros(k)
            width[: len(self.cuts[a])] = np.diff(np.append(self.cuts[a], self.upper[a]))
            total = np.outer(total, width).ravel()
        return total


Rows = list[list[int]]
"""Nodes as (split, threshold, first, second)."""
_Inside = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Faces in a box: axis (F,), lower and upper corners (F, n), weight (F,)."""


def _new(nodes: Rows) -> int:
    nodes.append([LEAF, 0, -1, -1])
    return len(nodes) - 1


def _cut(
    cells: CellTree, faces: Faces, weight: np.ndarray, budget: int
) -> tuple[Rows, list[_Block]]:
    """Return nodes from the root on, and the boxes that are left to the dynamic programme."""
    nodes: Rows = []
    blocks = []
    lower, upper = np.zeros(cells.n, dtype=np.int64), np.array(cells.counts, dtype=np.int64)
    start = (faces.axis, faces.lower.astype(np.int32), faces.upper.astype(np.int32), weight)
    stack: list[tuple[int, int, np.ndarray, np.ndarray, _Inside]] = [
        (_new(nodes), 0, lower, upper, start)
    ]
    while stack:
        node, depth, lower, upper, inside = stack.pop()
        axis, low = inside[:2]
        if not len(axis):
            continue
        cuts = [np.append(lower[a], np.unique(low[axis == a, a])) for a in range(cells.n)]
        if sub_box_count(tuple(len(c) for c in cuts)) <= budget:
            blocks.append(_Block(node, cuts, upper))
            continue
        if depth < GREEDY_DEPTH:
            a, cut = _best_plane(inside, lower, upper)
        else:  # in half, so that neither depth nor work grow with every plane
            a = max(range(cells.n), key=lambda a: len(cuts[a]))
            cut = int(cuts[a][len(cuts[a]) // 2])
        children = _new(nodes), _new(nodes)
        nodes[node] = [a, cut, *children]
        for child, bounds in zip(children, ((lower[a], cut), (cut, upper[a]))):
            below, above = lower.copy(), upper.copy()
            below[a], above[a] = bounds
            stack.append((child, depth + 1, below, above, _clip(inside, a, bounds)))
    return nodes, blocks


def _best_plane(inside: _Inside, lower: np.ndarray, upper: np.ndarray) -> tuple[int, int]:
    """Return (axis, threshold) of the plane that separates most and cuts least in a box.

    Of equals, that nearest to the middle is taken.
    """
    axis, low, high, weight = inside
    area = np.prod(np.maximum(high - low, 1), axis=1, dtype=float) * weight
    size = upper - lower
    best = (-np.inf, 0, 0)
    for a in range(len(lower)):
        planes, place = np.unique(low[axis == a, a], return_inverse=True)
        if not len(planes):
            continue
        apart = np.bincount(place, area[axis == a])
        section = np.prod(np.delete(size, a), dtype=float)
        gain = apart - CUT_PENALTY * (section - apart)
        gain -= OFF_MIDDLE * np.abs((planes - lower[a]) / size[a] - 0.5)
        i = int(np.argmax(gain))
        best = max(best, (float(gain[i]), a, int(planes[i])))
    return best[1], best[2]


def _clip(inside: _Inside, a: int, bounds: tuple[int, int]) -> _Inside:
    """Return the parts of faces strictly between bounds on an axis."""
    (axis, low, high, weight), (lower, upper) = inside, bounds
    keep = (high[:, a] > lower) & (low[:, a] < upper)
    low, high = low[keep], high[keep]
    np.maximum(low[:, a], lower, out=low[:, a])
    np.minimum(high[:, a], upper, out=high[:, a])
    return axis[keep], low, high, weight[keep]


def _solve(cells: CellTree, prices: Prices, blocks: list[_Block], nodes: Rows) -> None:
    """Give the nodes of the blocks their trees of least cost, many of one shape at a time."""
    groups: dict[tuple[int, ...], list[_Block]] = {}
    for block in blocks:
        groups.setdefault(block.shape, []).append(block)
    for shape, group in groups.items():
        each = math.prod(shape)
        most = max(4 * sub_box_count(shape), 32 * each * prices.label_count)
        batch = max(1, MEMORY // most)
        for start in range(0, len(group), batch):
            some = group[start : start + batch]
            entries = cells.find(np.concatenate([block.corners() for block in some]))
            volumes = np.concatenate([block.volumes() for block in some])
            masks = prices.masks[entries].reshape(len(some), each, -1)
            labels = prices.candidates(np.bitwise_or.reduce(masks, axis=1))
            price = prices.of(entries, volumes, np.repeat(labels, each, axis=0))
            price = np.moveaxis(price.reshape(len(some), *shape, -1), -1, 1)
            _attach(nodes, some, optimal_splits(price, prices.leaf_price))


def _attach(nodes: Rows, blocks: list[_Block], cuts: tuple[np.ndarray, ...]) -> None:
    axis, cut, first, second = (x.tolist() for x in cuts)
    number = [block.node for block in blocks] + [_new(nodes) for _ in axis[len(blocks) :]]
    orders = [block.order.tolist() for block in blocks]
    stack = [(i, i) for i in range(len(blocks))]
    while stack:
        i, owner = stack.pop()
        if axis[i] < 0:
            continue
        a = orders[owner][axis[i]]
        threshold = int(blocks[owner].cuts[a][cut[i]])
        nodes[number[i]] = [a, threshold, number[first[i]], number[second[i]]]
        stack += [(first[i], owner), (second[i], owner)]


def _depth_first(nodes: Rows, counts: tuple[int, ...]) -> SplitTree:
    def look(node: int) -> tuple[int, int, list[int]]:
        split, threshold, *children = nodes[node]
        return split, threshold, [] if split == LEAF else children

    return depth_first(counts, 0, look)


def _labelled(tree: SplitTree, cells: CellTree, prices: Prices) -> SplitTree:
    """Return the tree with leaves of least penalty; of equals, the label with most volume."""
    boxes = cells.boxes()
    leaf, box, lower, upper = tree.parts(boxes.lower, boxes.upper)
    order = np.argsort(leaf, kind="stable")
    box, volume = box[order], np.prod(upper - lower, axis=1, dtype=float)[order]
    leaves, counts = np.unique(leaf, return_counts=True)
    ends = np.concatenate([[0], np.cumsum(counts)])
    threshold = tree.threshold.copy()
    size = max(1, MEMORY // (32 * prices.label_count))
    for first in range(0, len(leaves), size):
        some = slice(first, first + size)
        last = min(first + size, len(leaves))
        part = slice(ends[first], ends[last])
        chosen = boxes.places[box[part]], boxes.labels[box[part]], volume[part]
        threshold[leaves[some]] = _cheapest(prices, ends[first : last + 1] - ends[first], *chosen)
    return dataclasses.replace(tree, threshold=threshold.astype(np.int32))


def _cheapest(
    prices: Prices, ends: np.ndarray, entries: np.ndarray, own: np.ndarray, volumes: np.ndarray
) -> np.ndarray:
    """Return the label (K,) of least penalty of leaves; of equals, that with most volume.

    Parts ``ends[k] .. ends[k + 1] - 1`` of leaf k lie in some `entries` (P,), of labels of their
    `own`, with `volumes` [finest cells].
    """
    common = np.bitwise_and.reduceat(prices.masks[entries], ends[:-1], axis=0)
    if empty(common).any():
        raise AssertionError("a leaf has no label that all its cells allow")
    labels = prices.candidates(common)
    leaf = np.repeat(np.arange(len(labels)), np.diff(ends))
    penalty, held = np.zeros(labels.shape, dtype=np.int64), np.zeros(labels.shape)
    each = np.minimum(prices.of(entries, volumes, labels[leaf]), FORBIDDEN // 2**20)
    np.add.at(penalty, leaf, each)
    np.add.at(held, leaf, np.where(labels[leaf] == own[:, None], volumes[:, None], 0.0))
    least = np.where(labels < 0, np.iinfo(np.int64).max, penalty)
    cheapest = least == least.min(axis=1, keepdims=True)
    best = np.argmax(np.where(cheapest, held, -1.0), axis=1)
    return np.asarray(labels[np.arange(len(labels)), best])


def _merged(tree: SplitTree) -> SplitTree:
    """Return the tree with pairs of leaves of one label merged, bottom-up."""
    nodes = np.column_stack([tree.split, tree.threshold, tree.first, tree.second]).tolist()
    for node in reversed(nodes):  # children come after their parents
        if node[0] != LEAF:
            first, second = nodes[node[2]], nodes[node[3]]
            if first[0] == second[0] == LEAF and first[1] == second[1]:
                node[:2] = [LEAF, first[1]]
    return _depth_first(nodes, tree.counts)
