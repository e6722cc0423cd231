"""Cells of one level, and leaves as boxes of the lattice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Cells(NamedTuple):
    """All cells of one level, or the leaves among them."""

    level: int  # of subdivision, 0 for the root grid
    places: np.ndarray  # (M,): in ``CellTree.entries``
    lower: np.ndarray  # (M, n): lower corners, in finest cells
    sizes: np.ndarray  # (M, n): edge lengths, likewise

    def where(self, chosen: np.ndarray) -> Cells:
        """Return the chosen cells, booleans (M,)."""
        return Cells(self.level, self.places[chosen], self.lower[chosen], self.sizes[chosen])


@dataclass(frozen=True, eq=False)
class Boxes:
    """Labelled boxes of the lattice, ``lower <= z < upper``, that tile it."""

    places: np.ndarray  # (M,): what ``find`` gives for the lattice points in them
    lower: np.ndarray  # (M, n): corners, in finest cells
    upper: np.ndarray  # (M, n)
    labels: np.ndarray  # (M,): leaf numbers: symbols, and N for the default
    levels: np.ndarray  # (M,): of subdivision

    def __len__(self) -> int:
        return len(self.labels)

    def volumes(self) -> np.ndarray:
        """Return the finest cells in each box, (M,) floats."""
        return np.prod(self.upper - self.lower, axis=1, dtype=float)
