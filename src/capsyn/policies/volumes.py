"""How much of the domain each symbol has."""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.modelling.grid import places_or_some

SAMPLES = 100_000
"""States at which the volumes of symbols are estimated where planes bound them."""


def volume_shares(policy: Any) -> np.ndarray:
    """Return the share of the domain's volume of each symbol, and of the default last, (N + 1,).

    Of a policy that remembers they are the mean over all symbols in force.
    """
    cells, table = policy.cells, policy.transitions
    count = table.shape[1]
    if policy.has_planes:
        steps = places_or_some(cells.counts, SAMPLES)
        volumes = None
    else:
        boxes = cells.boxes()
        volumes = boxes.volumes() / np.prod(cells.counts, dtype=float)

    def shares(now: int) -> np.ndarray:
        if volumes is not None:
            return np.bincount(table[boxes.labels, now], volumes, count)
        rows = cells.labels(steps, np.full(len(steps), now, dtype=np.int32))
        return np.bincount(table[rows, now], minlength=count) / len(steps)

    in_force = range(count - 1) if policy.remembers else [count - 1]
    return np.asarray(np.mean([shares(now) for now in in_force], axis=0))


def mixed_share(cells: CellTree) -> float:
    """Return the share of the volume of cells whose test points did not agree."""
    places, volumes = cells.volumes()
    mixed = volumes[np.isin(places, cells.mixed_cells)]
    return float(mixed.sum() / np.prod(cells.counts, dtype=float))
