"""Trees with features whose label is allowed in every finest cell of a policy."""

from __future__ import annotations

import math

import numpy as np

from capsyn.cells.feature_tree import FeatureTree, lattice_chunks
from capsyn.cells.masks import members
from capsyn.compression.features.growing import Pairs, across, best_split
from capsyn.compression.features.space import Space
from capsyn.compression.fitted.plane_tree import Node
from capsyn.compression.freedom import allowed_masks
from capsyn.compression.induction import apart
from capsyn.policies.policy import Policy, cell_tree
from capsyn.random_streams import stream

MOST_CELLS = 2**22
"""Most finest cells of a policy that a tree is fitted to."""
MOST_PAIRS = 2**19
"""Pairs of neighbours, unlike or like, that splits are chosen by."""
CUT_PENALTIES = (0.1, 0.02, 0.5)
"""What a like pair that is parted counts against an unlike one; each gives a tree."""
AT_ONCE = 2**18
"""Cells whose sets are looked at together."""
SAME = 1e-12
"""Coordinates so close are one."""
FAR = 1000
"""Pairs of cells that are no neighbours, where no neighbours are unlike."""


def fit_cells(policy: Policy, space: Space, freedom: bool, most_nodes: int) -> FeatureTree | None:
    """Return a tree with features, smaller than `most_nodes` nodes; None if none was found.

    Its label, a number of the policy's rows, is allowed in every cell, see `allowed_masks`; `space`
    has the policy's lattice.
    """
    grid = _Grid(policy, space, freedom)
    best: Node | None = None
    for penalty in CUT_PENALTIES:
        root = grid.grow(penalty, most_nodes)
        if root is not None and root.node_count < most_nodes:
            best, most_nodes = root, root.node_count
    return None if best is None else space.tree(best, moved=False)


class _Grid:
    """The finest cells of a policy in C order, with the labels, rows, that they may take."""

    def __init__(self, policy: Policy, space: Space, freedom: bool) -> None:
        cells = cell_tree(policy)
        parts, entries = [], []
        for steps in lattice_chunks(cells.counts):
            parts.append(space.coordinates(steps))
            entries.append(cells.find(steps))
        self.x, self.entries = np.concatenate(parts), np.concatenate(entries)
        self.own, self.labels = cells.labels_at(self.entries), len(policy.transitions)
        self.allowed = allowed_masks(policy, freedom)
        self.rng = stream(0)
        self.pairs = self._neighbours(cells.counts)

    def _neighbours(self, counts: tuple[int, ...]) -> Pairs:
        place = np.arange(math.prod(counts)).reshape(counts)
        ends = [
            (np.delete(place, -1, axis).ravel(), np.delete(place, 0, axis).ravel())
            for axis in range(len(counts))
        ]
        one, other = (np.concatenate(x) for x in zip(*ends))
        unlike = apart(self.allowed, self.entries[one], self.entries[other])
        rows = np.concatenate([self._some(np.flatnonzero(x)) for x in (unlike, ~unlike)])
        return Pairs(self.x[one[rows]], self.x[other[rows]], unlike[rows])

    def _some(self, rows: np.ndarray) -> np.ndarray:
        return rows if len(rows) <= MOST_PAIRS else self.rng.choice(rows, MOST_PAIRS, replace=False)

    def grow(self, penalty: float, most_nodes: int) -> Node | None:
        """Return a tree, or None as soon as it has `most_nodes` nodes."""
        root, nodes = Node(0), 1
        stack = [(root, np.arange(len(self.x)), self.pairs)]
        while stack:
            node, rows, pairs = stack.pop()
            common = members(self._common(rows), self.labels)
            own = np.bincount(self.own[rows], minlength=self.labels)
            if common.any():
                node.label = int(np.where(common, own, -1).argmax())
                continue
            nodes += 2
            if nodes >= most_nodes:
                return None
            if not pairs.unlike.any():
                pairs = self._far(rows, own)
            split = best_split(pairs, penalty)
            assert split is not None, "unlike cells differ along an axis"
            split = split[0], _beside(split[1], self.x[rows, split[0]])
            node.plane = across(*split, self.x.shape[1])
            beyond = self.x[rows, split[0]] >= split[1]
            for part, beside in zip((rows[~beyond], rows[beyond]), pairs.beside(*split)):
                node.children.append(Node(0))
                stack.append((node.children[-1], part, beside))
        return root

    def _common(self, rows: np.ndarray) -> np.ndarray:
        """Return the set (W,) of labels that cells (B,) all allow."""
        common = np.full(self.allowed.shape[1], ~np.uint64(0))
        for start in range(0, len(rows), AT_ONCE):
            sets = self.allowed[self.entries[rows[start : start + AT_ONCE]]]
            common &= np.bitwise_and.reduce(sets, axis=0)
        return common

    def _far(self, rows: np.ndarray, own: np.ndarray) -> Pairs:
        """Return pairs of cells with different labels of their own."""
        most = self.own[rows] == own.argmax()
        one, other = (self.rng.choice(rows[x], FAR) for x in (most, ~most))
        return Pairs(self.x[one], self.x[other], np.ones(FAR, dtype=bool))


def _beside(threshold: float, values: np.ndarray) -> float:
    """Return a threshold a little off the values, where it is at one; it parts them alike.

    Pairs do not show all values of their cells, and rounded to the lattice one may change sides.
    """
    near = values[np.abs(values - threshold) < SAME]
    if not near.size:
        return threshold
    return threshold - SAME if (near >= threshold).any() else threshold + SAME
