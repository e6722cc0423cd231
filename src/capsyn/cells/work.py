"""What a lookup in cells takes: levels on the way to a leaf, and rows that are evaluated there."""

from __future__ import annotations

from dataclasses import dataclass

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


def work_of(cells: CellTree) -> Work:
    """Return what lookups in cells take."""
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
    volumes = np.prod(sizes, axis=1, dtype=float)
    heaviest = np.lexsort((levels, rows))[-1]
    return Work(
        int(levels.max()),
        float(np.average(levels, weights=volumes)),
        int(rows.max()),
        float(np.average(rows, weights=volumes)),
        lower[heaviest] + sizes[heaviest] // 2,
    )
