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


def ragged(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the row and the place in it, (sum,) each, of the items of rows of `counts` (M,)."""
    row = np.repeat(np.arange(len(counts)), counts)
    return row, np.arange(len(row)) - (np.cumsum(counts) - counts)[row]


def digits_of(numbers: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Return where cells (M,), numbered in C order, are in blocks of some shapes, both (M, n)."""
    digits = np.empty(shapes.shape, dtype=np.int64)
    for i in reversed(range(shapes.shape[1])):
        numbers, digits[:, i] = np.divmod(numbers, shapes[:, i])
    return digits


def number_of(digits: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Return the numbers (M,) of cells; the inverse of `digits_of`."""
    numbers = digits[:, 0]
    for i in range(1, shapes.shape[1]):
        numbers = numbers * shapes[:, i] + digits[:, i]
    return numbers
