"""The faces that a tree compares with, for targets that look steps up in tables."""

from __future__ import annotations

import numpy as np

from capsyn.cells.split_tree import SplitTree


def ranked_tree(tree: SplitTree) -> tuple[SplitTree, list[np.ndarray]]:
    """Return a tree over the faces that it compares with, and the numbers of these on each axis.

    A tree with oblique splits is the same, with all faces but the first and the last.
    """
    numbers = [np.arange(1, count) for count in tree.counts]
    threshold = tree.threshold.copy()
    if not len(tree.planes):
        for i in range(tree.n):
            at = tree.split == i
            numbers[i], rank = np.unique(tree.threshold[at], return_inverse=True)
            threshold[at] = rank.ravel() + 1
    counts = tuple(len(k) + 1 for k in numbers)
    return SplitTree(counts, tree.split, threshold, tree.second, tree.planes), numbers
