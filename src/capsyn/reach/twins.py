"""Layers of a cell that come to the same: labels in force after which the same follows in it."""

from __future__ import annotations

import numpy as np

from capsyn.reach.half_spaces import HalfSpaces
from capsyn.reach.kernel import Cells
from capsyn.reach.loop import SampledLoop

ROUNDING = 1e-9
"""Share of a cell by which rows beyond its faces are counted to it."""


def rows_under(tree: HalfSpaces, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return which rows boxes (B, n) may be over: boxes (P,) ascending, and rows (P,)."""
    box, node = np.arange(len(lower)), np.zeros(len(lower), dtype=np.int64)
    found = []
    while len(box):
        row = tree.row[node]
        leaf = row >= 0
        found.append(np.stack([box[leaf], row[leaf]]))
        box, node = box[~leaf], node[~leaf]
        normal = tree.normal[node]
        up, down = np.maximum(normal, 0), np.minimum(normal, 0)
        least = (up * lower[box] + down * upper[box]).sum(axis=1)
        most = (up * upper[box] + down * lower[box]).sum(axis=1)
        first = least < tree.below[node]
        second = ~first | (most > tree.above[node])
        box = np.concatenate([box[first], box[second]])
        node = np.concatenate([node[first] + 1, tree.second[node[second]]])
    pairs = np.unique(np.concatenate(found, axis=1), axis=1)
    return pairs[0], pairs[1]


def twin_layers(loop: SampledLoop, cells: Cells) -> np.ndarray:
    """Return, for each layer and cell (L, K), the first layer that comes to the same there.

    It does where the rows of the cell give the same next labels, and nothing else depends on the
    label in force: no hold, no delay.
    """
    twins = np.tile(np.arange(loop.layers)[:, None], (1, cells.total))
    if loop.layers == 1 or loop.delay > 0 or (loop.holds > 1).any():
        return twins
    lower, upper = cells.boxes(np.arange(cells.total))
    margin = ROUNDING * cells.widths + loop.noise
    box, row = rows_under(loop.tree, lower - margin, upper + margin)
    starts = np.searchsorted(box, np.arange(cells.total))
    round_ = np.array(loop.space.periodic)  # a cell at the seam may be measured beyond it
    low, high = lower - margin < loop.space.lower, upper + margin > loop.space.upper
    seam = ((low | high) & round_).any(axis=1)
    for later in range(1, loop.layers):
        for first in range(later):
            same = loop.next[row, first] == loop.next[row, later]
            equal = np.logical_and.reduceat(same, starts)
            open_ = equal & (twins[later] == later) & ~seam
            twins[later, open_] = twins[first, open_]
    return twins
