"""Faces that neighbouring cells share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree


@dataclass(frozen=True, eq=False)
class Faces:
    """Faces between two cells each, which do not overlap; a seam of a periodic axis is at 0."""

    axis: np.ndarray  # (F,): that a face is perpendicular to
    lower: np.ndarray  # (F, n): corner in finest cells
    upper: np.ndarray  # (F, n): the other corner, equal on its axis
    below: np.ndarray  # (F,): the cells on its two sides, as places that ``find`` gives
    above: np.ndarray  # (F,)

    def __len__(self) -> int:
        return len(self.axis)


Keep = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Places (F,) of two cells each to booleans (F,): whether their face matters."""


def shared_faces(
    cells: CellTree | SplitTree, keep: Keep, periodic: Sequence[bool] | None = None
) -> Faces:
    """Return the faces that two cells share, or leaves of a tree without oblique splits.

    Faces between cells that `keep` does not name are dropped early, to save memory. The ends of
    `periodic` axes meet; by default there are none.
    """
    boxes, counts = cells.boxes(), cells.counts
    faces = []
    level = np.zeros(cells.node_count, dtype=np.int16)
    level[boxes.places] = boxes.levels
    for axis in range(cells.n):
        wraps = periodic is not None and periodic[axis]
        for side in (-1, 1) if cells.nested else (1,):
            at = (boxes.lower if side < 0 else boxes.upper)[:, axis]
            inside = (at > 0) & (at < counts[axis])
            some = np.flatnonzero(inside | wraps)
            beyond = (at[some] + min(side, 0)) % counts[axis]
            lower, upper = boxes.lower[some], boxes.upper[some]
            lower[:, axis] = beyond
            upper[:, axis] = beyond + 1
            if cells.nested:  # of two cells one is the smaller
                # a face is told once: by the smaller cell, of equals by the upper one
                other = cells.find(lower)
                tells = boxes.levels[some] + (side < 0) > level[other]
                some, other, lower, upper = (x[tells] for x in (some, other, lower, upper))
            else:
                other, part, lower, upper = cells.parts(lower, upper)
                some = some[part]
            own = boxes.places[some]
            below, above = (other, own) if side < 0 else (own, other)
            kept = keep(below, above) & (own != other)
            some, below, above, lower, upper = (x[kept] for x in (some, below, above, lower, upper))
            lower[:, axis] = upper[:, axis] = at[some] % counts[axis]
            faces.append((np.full(len(some), axis), lower, upper, below, above))
    return Faces(*(np.concatenate(parts) for parts in zip(*faces)))
