"""What is proved of each cell of a grid, small enough for a policy's file and its page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from capsyn.cells.run_lengths import run_lengths
from capsyn.policies.evidence import MOST_MAP_CELLS, MOST_MAP_TEXT

NO_START, PROVED, OPEN, REFUTED = range(4)
"""What is known of a cell, the worse the greater: no start is in it, all of its starts are proved
to arrive, some are not, or a simulated loop fails from one."""
STAYS = 4
"""Added to it where the loop stays for ever in a set of which the cell is one."""


def cell_map(counts: Sequence[int], statuses: np.ndarray, stays: np.ndarray) -> dict[str, Any]:
    """Return what is known of cells (K,), in C order of `counts`, as plain data.

    Where that is too long the cells of the map are larger: each has the worst status of those that
    it meets, and stays where they all do.

    Returns
    -------
    dict
        ``counts``, the cells of the map along each axis, and ``runs``, see `run_lengths`: a status,
        with `STAYS` added where the loop stays.
    """
    known, kept = statuses.reshape(counts), np.asarray(stays, bool).reshape(counts)
    while True:
        if known.size <= MOST_MAP_CELLS:
            text = run_lengths((known + STAYS * kept).ravel())
            if len(text) <= MOST_MAP_TEXT:
                return {"counts": list(known.shape), "runs": text}
        known, kept = _halved(known, np.maximum), _halved(kept, np.logical_and)


def _halved(values: np.ndarray, worst: np.ufunc) -> np.ndarray:
    """Return the worst of what meets each cell of a grid with half the cells along each axis."""
    for axis, count in enumerate(values.shape):
        half = -(-count // 2)
        k = np.arange(half)
        ends = np.stack([k * count // half, -(-(k + 1) * count // half)], axis=1).ravel()
        values = worst.reduceat(values, ends[:-1], axis=axis)  # the last one to the end
        values = values.take(range(0, 2 * half, 2), axis=axis)
    return values
