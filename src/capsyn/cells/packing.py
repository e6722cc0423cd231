"""How many bytes the arrays of a policy need."""

from __future__ import annotations

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree

TYPES = (np.int8, np.uint8, np.int16, np.uint16, np.int32)


def smallest_type(values: np.ndarray) -> np.dtype:
    """Return the smallest type of integers that holds all values (of 32 bits); of equals signed."""
    low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
    fitting = (t for t in TYPES if np.iinfo(t).min <= low and high <= np.iinfo(t).max)
    return np.dtype(next(fitting, np.int64))


def lookup_arrays(cells: CellTree | SplitTree) -> list[np.ndarray]:
    """Return the arrays that a lookup needs: all but those of mixed cells."""
    return [array for name, array in cells.arrays().items() if not name.startswith("mixed_")]


def packed_bytes(cells: CellTree | SplitTree) -> int:
    """Return the bytes of what a lookup needs, each array in the smallest integers that hold it."""
    return sum(array.size * smallest_type(array).itemsize for array in lookup_arrays(cells))
