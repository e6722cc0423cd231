"""Cells with affine leaves as a decision tree: comparisons of rows are oblique splits."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from capsyn.cells.affine_leaves import AffineLeaves
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import LEAF, SplitTree, depth_first

MAX_NODES = 5_000_000
"""Most nodes of a tree."""


def affine_tree(cells: CellTree, most: int = MAX_NODES) -> SplitTree | None:
    """Return the decision tree of cells with affine leaves, equal to them at every lattice step.

    Blocks of children are halved along one axis after the other, and equal leaves merged. In an
    affine leaf the largest row so far meets the next: the next one, of a higher symbol, wins where
    the difference of the two, a plane with whole coefficients, is at least 1. Comparisons that are
    decided throughout the cell are left out. None where it has more than `most` nodes, or where
    leaves have prices: which row is largest then depends on the symbol in force.
    """
    if cells.priced:
        return None
    try:
        return _tree(cells, _Nodes(most))
    except _TooManyError:
        return None


class _TooManyError(Exception):
    """A tree has more nodes than it may have."""


def _tree(cells: CellTree, nodes: _Nodes) -> SplitTree:
    """Return the tree of the nodes that cells become."""
    assert cells.affine is not None
    node_of = np.empty(len(cells.entries), dtype=np.int64)  # the node of each cell
    for _, places, lower, sizes in reversed(list(cells.levels())):
        entries = cells.entries[places]
        leaf = -1 - entries.astype(np.int64)
        constant = (entries < 0) & (leaf < cells.affine.first)
        node_of[places[constant]] = leaf[constant] - cells.affine.first  # labels are below 0
        for k in np.flatnonzero(leaf >= cells.affine.first):
            node_of[places[k]] = nodes.of_rows(cells.affine, int(leaf[k]), lower[k], sizes[k])
        split = np.flatnonzero(entries >= 0)
        for k, factors in zip(split, cells.factors(places[split])):
            children = node_of[entries[k] : entries[k] + np.prod(factors)].reshape(factors)
            node_of[places[k]] = nodes.of_grid(children, lower[k], sizes[k] // factors)
    roots = node_of[: np.prod(cells.partitions)].reshape(cells.partitions)
    top = nodes.of_grid(roots, np.zeros(cells.n, dtype=np.int64), cells.sizes(0))
    return nodes.tree(top, cells.counts, cells.affine.first)


@dataclass
class _Nodes:
    """Inner nodes in the order of their making: children first.

    A node number below 0 is a label, less the number of labels. ``split`` is an axis, or LEAF where
    the node has a plane.
    """

    most: int
    split: list[int] = field(default_factory=list)
    threshold: list[int] = field(default_factory=list)
    children: list[tuple[int, int]] = field(default_factory=list)
    planes: dict[int, np.ndarray] = field(default_factory=dict)

    def join(self, split: int, threshold: int, first: int, second: int) -> int:
        """Return a node with two children, or the label that they share."""
        if first == second and first < 0:
            return first
        if len(self.split) >= self.most // 2:
            raise _TooManyError
        self.split.append(split)
        self.threshold.append(threshold)
        self.children.append((first, second))
        return len(self.split) - 1

    def of_grid(self, grid: np.ndarray, lower: np.ndarray, size: np.ndarray) -> int:
        """Return the node of a box whose equal parts are a grid of nodes."""
        axis = int(np.argmax(grid.shape))
        count = grid.shape[axis]
        if count == 1:
            return int(grid.ravel()[0])
        half = count // 2
        middle = int(lower[axis] + half * size[axis])
        above = lower.copy()
        above[axis] = middle
        parts = np.split(grid, [half], axis=axis)
        first, second = self.of_grid(parts[0], lower, size), self.of_grid(parts[1], above, size)
        return self.join(axis, middle, first, second)

    def of_rows(self, leaves: AffineLeaves, leaf: int, lower: np.ndarray, size: np.ndarray) -> int:
        """Return the node of an affine leaf in a box."""
        place = leaf - leaves.first
        rows = slice(leaves.starts[place], leaves.starts[place + 1])
        symbols = leaves.symbols[rows].tolist()
        slopes, constants = leaves.slopes[rows].astype(np.int64), leaves.constants[rows].tolist()
        planes = slopes[None, :, :] - slopes[:, None, :]  # of the pair: second less first
        corner = planes @ lower
        low = (corner + np.minimum(planes, 0) @ (size - 1)).tolist()
        high = (corner + np.maximum(planes, 0) @ (size - 1)).tolist()

        def meet(best: int, other: int) -> int:
            """Return the node where the rows from `other` on are yet to be met."""
            while other < len(symbols):
                threshold = constants[best] - constants[other] + 1
                if low[best][other] >= threshold:
                    best = other
                elif high[best][other] >= threshold:
                    first, second = meet(best, other + 1), meet(other, other + 1)
                    node = self.join(LEAF, threshold, first, second)
                    if node >= 0:
                        self.planes[node] = planes[best, other]
                    return node
                other += 1
            return symbols[best] - leaves.first

        return meet(0, 1)

    def tree(self, top: int, counts: tuple[int, ...], labels: int) -> SplitTree:
        """Return the nodes below one as a tree."""

        def look(node: int) -> tuple[int | np.ndarray, int, tuple[int, ...]]:
            if node < 0:
                return LEAF, node + labels, ()
            split = self.planes.get(node, self.split[node])
            return split, self.threshold[node], self.children[node]

        return depth_first(counts, top, look)
