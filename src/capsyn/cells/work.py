"""What a lookup in cells takes: levels on the way to a leaf, and rows that are evaluated there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from capsyn.cells.cell_tree import CellTree


@dataclass(frozen=True, eq=False)
class Work:
    """Levels passed and rows evaluated, most and mean over the volume; where they are most.

    `steps` (n,) are lattice steps of a leaf with the most rows, of these the deepest.
    """

    levels: int
    mean_levels: float
    rows: int
    mean_rows: float
    steps: np.ndarray


class Leaves(NamedTuple):
    """All leaf cells, those with most rows first, of these the deepest."""

    places: np.ndarray  # (M,): their entries
    lower: np.ndarray  # (M, n): lower corners [lattice steps]
    sizes: np.ndarray  # (M, n): edge lengths [lattice steps]
    levels: np.ndarray  # (M,): that are passed on the way
    rows: np.ndarray  # (M,): that are evaluated


def heaviest_leaves(cells: CellTree) -> Leaves:
    """Return all leaves of cells in the order of the work that they take."""
    leaves = list(cells.leaves())
    levels = np.repeat([some.level for some in leaves], [len(some.places) for some in leaves])
    places, lower, sizes = (
        np.concatenate([getattr(some, name) for some in leaves])
        for name in ("places", "lower", "sizes")
    )
    rows = np.zeros(len(places), dtype=np.int64)
    if cells.affine is not None:
        leaf = cells.labels_at(places) - cells.affine.first
        rows[leaf >= 0] = np.diff(cells.affine.starts)[leaf[leaf >= 0]]
    order = np.lexsort((-levels, -rows))
    return Leaves(*(array[order] for array in (places, lower, sizes, levels, rows)))


def work_of(cells: CellTree) -> Work:
    """Return what lookups in cells take."""
    leaves = heaviest_leaves(cells)
    volumes = np.prod(leaves.sizes, axis=1, dtype=float)
    return Work(
        int(leaves.levels.max()),
        float(np.average(leaves.levels, weights=volumes)),
        int(leaves.rows[0]),
        float(np.average(leaves.rows, weights=volumes)),
        leaves.lower[0] + leaves.sizes[0] // 2,
    )
