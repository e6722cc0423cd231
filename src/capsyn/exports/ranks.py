"""The faces that a tree compares with, for targets that look steps up in tables."""

from __future__ import annotations

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree


def ranked_tree(
    tree: CellTree | SplitTree,
) -> tuple[CellTree | SplitTree, list[np.ndarray]]:
    """Return a tree over the faces that it compares with, and the numbers of these on each axis.

    Cells and a tree with oblique splits are the same, with all faces but the first and the last.
    """
    numbers = [np.arange(1, count) for count in tree.counts]
    if isinstance(tree, CellTree) or tree.has_planes:
        return tree, numbers
    threshold = tree.threshold.copy()
    for i in range(tree.n):
        at = tree.split == i
        numbers[i], rank = np.unique(tree.threshold[at], return_inverse=True)
        threshold[at] = rank.ravel() + 1
    counts = tuple(len(k) + 1 for k in numbers)
    return SplitTree(counts, tree.split, threshold, tree.second, tree.planes), numbers
