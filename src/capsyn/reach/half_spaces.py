"""Decision trees as half-spaces of real states, which hold all states that a branch gets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.modelling.domain import Box

ROUNDING = 1e-12
"""What rounding may move the bounds of an oblique split by, relative to its terms."""


@dataclass(frozen=True, eq=False)
class HalfSpaces:
    """A tree of K nodes over n axes: a state with ``normal . x < below`` may be in the first child.

    One with ``normal . x > above`` may be in the second; the first is the next node. Between the
    bounds of an oblique split both may be: there its sum of lattice steps decides.
    """

    second: np.ndarray  # (K,) int32
    row: np.ndarray  # (K,) int32: number of a leaf's row, -1 of other nodes
    normal: np.ndarray  # (K, n)
    below: np.ndarray  # (K,)
    above: np.ndarray  # (K,)


def half_spaces(tree: SplitTree, space: Box) -> HalfSpaces:
    """Return the half-spaces of a tree on the lattice of a box.

    A state is at or beyond a face exactly where its lattice step is. Of an oblique split the real
    sum exceeds that of the steps by less than the sum of its coefficients of one sign.
    """
    leaf = tree.split == LEAF
    normal = np.zeros((tree.node_count, tree.n))
    below, above = np.zeros(tree.node_count), np.zeros(tree.node_count)
    for axis, count in enumerate(tree.counts):
        nodes = np.flatnonzero(tree.split == axis)
        normal[nodes, axis] = 1.0
        below[nodes] = above[nodes] = space.faces(axis, tree.threshold[nodes], count)
    nodes = np.flatnonzero(tree.split >= tree.n)
    planes = tree.planes[tree.split[nodes] - tree.n].astype(float)
    normal[nodes] = planes / (space.widths / np.array(tree.counts))
    moved = normal[nodes] @ space.lower + tree.threshold[nodes]
    size = np.abs(normal[nodes]) @ np.maximum(np.abs(space.lower), np.abs(space.upper))
    margin = ROUNDING * (size + np.abs(tree.threshold[nodes]) + np.abs(planes).sum(axis=1))
    below[nodes] = moved - 1 + np.maximum(planes, 0).sum(axis=1) + margin
    above[nodes] = moved - np.maximum(-planes, 0).sum(axis=1) - margin
    row = np.where(leaf, tree.threshold, -1).astype(np.int32)
    return HalfSpaces(tree.second, row, normal, below, above)
