"""Decision diagrams: trees in which equal subtrees are written once and referred to."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from capsyn.cells.split_tree import LEAF, SplitTree, depth_first
from capsyn.modelling.grid import grid_places

MOST_CELLS = 1 << 21
"""Largest grid of thresholds of which a diagram is made."""


@dataclass(frozen=True, eq=False)
class Diagram:
    """A tree in depth-first order, some leaves of which are references to inner nodes.

    `target` (K,) is the node that a reference stands for, -1 of all other nodes. The label of a
    reference means nothing.
    """

    tree: SplitTree
    target: np.ndarray

    @staticmethod
    def of(tree: SplitTree) -> Diagram:
        """Return a tree as a diagram without references."""
        return Diagram(tree, np.full(tree.node_count, -1, dtype=np.int32))

    @property
    def references(self) -> int:
        """Number of references."""
        return int(np.count_nonzero(self.target >= 0))

    @functools.cached_property
    def comparisons(self) -> int:
        """Most comparisons that a lookup takes."""
        return self._longest(np.ones(self.tree.node_count, dtype=np.int64), 0)

    def nodes_read(self, skips: int) -> int:
        """Return the nodes that a lookup reads at most where nodes above a depth carry skips."""
        tree = self.tree
        over = np.where(tree.depths < skips, 0, tree.second - tree.first)
        return self._longest(1 + over, 1)

    def unfolded(self, most: int) -> SplitTree | None:
        """Return the tree that the diagram stands for, with a leaf for each path through it.

        None where there are more than `most`.
        """
        tree, target = self.tree, self.target

        def look(node: int) -> tuple[int, int, list[int]]:
            node = node if target[node] < 0 else int(target[node])
            children = [] if tree.split[node] == LEAF else [node + 1, int(tree.second[node])]
            return int(tree.split[node]), int(tree.threshold[node]), children

        leaves, todo = 0, [0]
        while todo:
            children = look(todo.pop())[2]
            leaves += not children
            todo += children
            if leaves + len(todo) > most:
                return None
        return depth_first(tree.counts, 0, look)

    def _longest(self, second: np.ndarray, last: int) -> int:
        """Return the greatest sum along a path to a leaf, which counts `last`.

        On the way each inner node counts 1, or `second` (K,) where its second child comes next;
        a reference counts as much as a leaf.
        """
        tree, total = self.tree, np.full(self.tree.node_count, -1, dtype=np.int64)
        nodes, total[0] = np.zeros(1, dtype=np.int64), 0
        while nodes.size:  # nodes that a longer path has been found to
            refers, inner = nodes[self.target[nodes] >= 0], nodes[tree.split[nodes] != LEAF]
            children = np.concatenate([tree.first[inner], tree.second[inner], self.target[refers]])
            sums = np.concatenate([total[inner] + 1, total[inner] + second[inner], total[refers]])
            sums[len(sums) - len(refers) :] += last
            before = total[children]
            np.maximum.at(total, children, sums)
            nodes = np.unique(children[sums > before])
        return int(total.max()) + last


@dataclass(frozen=True, eq=False)
class Ordered:
    """An ordered diagram: along a path, all comparisons of an axis follow each other.

    Nodes have numbers: the labels, then `rows` of axis, threshold and numbers of both children.
    """

    counts: tuple[int, ...]
    labels: int
    root: int
    rows: list[tuple[int, int, int, int]]

    def written(self, skips: int) -> Diagram:
        """Return the diagram as a tree with references, none to nodes above a depth."""
        place: dict[int, int] = {}
        target: list[int] = []

        def look(node: tuple[int, int]) -> tuple[int, int, list[tuple[int, int]]]:
            number, depth = node
            here = len(target)
            target.append(place.get(number, -1))
            if number < self.labels:
                return LEAF, number, []
            if number in place:
                return LEAF, 0, []
            if depth >= skips:
                place[number] = here
            axis, threshold, first, second = self.rows[number - self.labels]
            return axis, threshold, [(first, depth + 1), (second, depth + 1)]

        tree = depth_first(self.counts, (self.root, 0), look)
        return Diagram(tree, np.array(target, dtype=np.int32))


def ordered(tree: SplitTree) -> Ordered | None:
    """Return a small ordered diagram of a tree; none where its grid of thresholds is too large."""
    cuts = [np.unique(tree.threshold[tree.split == a]) for a in range(tree.n)]
    shape = [len(cut) + 1 for cut in cuts]
    if tree.has_planes or math.prod(shape) > MOST_CELLS:
        return None
    steps = [np.append(0, cut)[place] for cut, place in zip(cuts, grid_places(shape).T)]
    labels = tree.labels(np.column_stack(steps)).reshape(shape).astype(np.int32)
    # any axis last, then from there back the axis that adds least
    levels = min((_levels(labels, last) for last in range(tree.n)), key=_size)
    count = int(labels.max()) + 1
    rows: list[tuple[int, int, int, int]] = []
    known: dict[tuple[int, int, int, int], int] = {}

    def node(axis: int, thresholds: list[int], children: list[int]) -> int:
        """Return the number of a node that compares thresholds, halving them, between children."""
        if not thresholds:
            return children[0]
        k = len(thresholds) // 2
        first = node(axis, thresholds[:k], children[: k + 1])
        second = node(axis, thresholds[k + 1 :], children[k + 1 :])
        row = (axis, thresholds[k], first, second)
        if row not in known:
            known[row] = count + len(rows)
            rows.append(row)
        return known[row]

    numbers = np.arange(count)
    for level in levels:
        new = []
        for line, change in zip(level.lines, level.changes):
            at = np.flatnonzero(change)
            children = numbers[line[np.append(0, at + 1)]].tolist()
            new.append(node(level.axis, cuts[level.axis][at].tolist(), children))
        numbers = np.array(new)
    return Ordered(tree.counts, count, int(numbers[0]), rows)


@dataclass(frozen=True, eq=False)
class _Level:
    """The unlike `lines` (M, k) along an axis, of places in the lines of the level before.

    At first these are labels. `grid` has the place of each line, by the axes that are left.
    """

    axis: int
    lines: np.ndarray
    grid: np.ndarray

    @staticmethod
    def of(grid: np.ndarray, axes: list[int], axis: int) -> _Level:
        """Return the level of one of the axes of a grid."""
        turned = np.moveaxis(grid, axes.index(axis), -1)
        flat = turned.reshape(-1, turned.shape[-1])
        lines, place = _unlike(flat)
        return _Level(axis, lines, place.reshape(turned.shape[:-1]))

    @property
    def changes(self) -> np.ndarray:
        """Where lines change, (M, k - 1)."""
        return self.lines[:, 1:] != self.lines[:, :-1]

    @property
    def size(self) -> int:
        """About how many nodes the level takes: comparisons, and references to its lines."""
        return len(self.lines) + int(np.count_nonzero(self.changes))


def _unlike(lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lines (M, k) that differ, and the place (B,) of each of lines (B, k) in them."""
    keys = lines.astype(np.uint64) @ _factors(lines.shape[1])
    _, first, place = np.unique(keys, return_index=True, return_inverse=True)
    if not np.array_equal(lines[first[place]], lines):  # unlike lines have the same key
        unlike, place = np.unique(lines, axis=0, return_inverse=True)
        return unlike, place.reshape(-1)
    return lines[first], place


def _factors(count: int) -> np.ndarray:
    """Return random factors of sums modulo ``2 ** 64`` by which lines are told apart."""
    return np.random.default_rng(0).integers(1 << 64, size=count, dtype=np.uint64)


def _levels(labels: np.ndarray, last: int) -> list[_Level]:
    """Return the levels of a diagram from an axis that comes last on."""
    axes = list(range(labels.ndim))
    levels = [_Level.of(labels, axes, last)]
    while len(axes) > 1:
        axes.remove(levels[-1].axis)
        level = min((_Level.of(levels[-1].grid, axes, a) for a in axes), key=lambda x: x.size)
        levels.append(level)
    return levels


def _size(levels: list[_Level]) -> int:
    return sum(level.size for level in levels)
