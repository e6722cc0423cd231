"""Cells of one level, and leaves as boxes of the lattice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Cells(NamedTuple):
    """All cells of one level, or the leaves among them.

    Parameters
    ----------
    level : int
        Level of subdivision, 0 for the root grid.
    places : (M,)
        Their places in ``CellTree.entries``.
    lower, sizes : (M, n)
        Integer coordinates of their lower corners, and their edge lengths, in finest cells.
    """

    level: int
    places: np.ndarray
    lower: np.ndarray
    sizes: np.ndarray

    def where(self, chosen: np.ndarray) -> Cells:
        """Return the chosen cells, booleans (M,)."""
        return Cells(self.level, self.places[chosen], self.lower[chosen], self.sizes[chosen])


@dataclass(frozen=True, eq=False)
class Boxes:
    """Labelled boxes of the lattice, ``lower <= z < upper``, that tile it.

    Parameters
    ----------
    places : (M,)
        What ``find`` gives for the lattice points in them.
    lower, upper : (M, n)
        Integer corners, in finest cells.
    labels : (M,)
        Leaf numbers: symbols, and N for the default.
    levels : (M,)
        Levels of subdivision.
    """

    places: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    labels: np.ndarray
    levels: np.ndarray

    def __len__(self) -> int:
        return len(self.labels)

    def volumes(self) -> np.ndarray:
        """Return the finest cells in each box, (M,) floats."""
        return np.prod(self.upper - self.lower, axis=1, dtype=float)
