"""What a decision tree gives in every cell of a policy, found without sampling."""

from __future__ import annotations

import numpy as np

from capsyn.cells import CellTree
from capsyn.split_tree import SplitTree


def changed_cells(tree: SplitTree, cells: CellTree, masks: np.ndarray | None = None) -> np.ndarray:
    """Return how much of each cell has another label in a tree than in the cells.

    Each cell is cut along the splits of the tree; nothing of how the tree was made is used.

    Parameters
    ----------
    tree : SplitTree
        A tree without oblique splits, on the lattice of the cells.
    cells : CellTree
        The cells.
    masks : (M,) uint64, optional
        Labels that each entry of the cells may take, as bit masks.

    Returns
    -------
    (K,)
        Volume [finest cells], in the order of ``cells.boxes()``.

    Raises
    ------
    AssertionError
        The tree gives some cell a label that its mask does not hold.
    """
    boxes = cells.boxes()
    leaf, box, lower, upper = tree.parts(boxes.lower, boxes.upper)
    volume = np.prod(upper - lower, axis=1, dtype=float)
    covered = np.bincount(box, volume, minlength=len(boxes))
    if not np.allclose(
        covered, boxes.volumes(), rtol=1e-12, atol=0
    ):  # beyond 2^53 sums are rounded
        raise AssertionError("the leaves of the tree do not tile the cells")
    label = tree.labels_at(leaf)
    if masks is not None:
        allowed = masks[boxes.places[box]] >> label.astype(np.uint64)
        if not (allowed & np.uint64(1)).all():
            raise AssertionError("the tree gives a cell a label that it may not take")
    changed = np.where(label != boxes.labels[box], volume, 0.0)
    return np.bincount(box, changed, minlength=len(boxes))
