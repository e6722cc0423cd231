"""The grid of cells: partitions, refinement and depth, per axis."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.validation import plain, whole_number, whole_numbers

MAX_COUNT = 2**31 - 1
"""Most finest cells along one axis."""
LEAVES = ("constant", "affine")
"""What cells may hold: one symbol each, or rows that are affine in the state."""


@dataclass(frozen=True)
class Grid:
    """A grid of cells that may be split."""

    partitions: tuple[int, ...]  # cells of the root grid per axis
    refinement: tuple[int, ...]  # children of a split cell per axis, >= 2
    max_level: int  # most times that a cell is split along an axis

    @staticmethod
    def of(partitions: Any, refinement: Any, max_level: Any, n: int) -> Grid:
        """Return the validated grid of `n` axes; one number stands for all axes.

        Not whole numbers, or 2^31 finest cells or more along an axis, are a `ProblemError`.
        """
        grid = Grid(
            whole_numbers("partitions", partitions, n, least=1, most=MAX_COUNT),
            whole_numbers("refinement", refinement, n, least=2, most=MAX_COUNT),
            0,
        )
        most = 0
        while max(grid.at(most + 1).counts) <= MAX_COUNT and most < 31:
            most += 1
        return grid.at(whole_number("max_level", max_level, least=0, most=most))

    def at(self, max_level: int) -> Grid:
        """Return the grid with another depth."""
        return dataclasses.replace(self, max_level=max_level)

    @property
    def n(self) -> int:
        """Number of axes."""
        return len(self.partitions)

    @property
    def counts(self) -> tuple[int, ...]:
        """Finest cells along each axis, ``partitions * refinement ** max_level``."""
        return tuple(q * r**self.max_level for q, r in zip(self.partitions, self.refinement))

    @property
    def roots(self) -> int:
        """Cells of the root grid."""
        return math.prod(self.partitions)

    @property
    def cells(self) -> int:
        """Finest cells."""
        return math.prod(self.counts)

    @property
    def children(self) -> int:
        """Children of a cell that is split along all axes."""
        return math.prod(self.refinement)

    def split(self, level: int) -> tuple[int, ...]:
        """Return into how many children, per axis, the parents of a level's cells are split.

        The cells of the root grid are their own parents.
        """
        return self.refinement if level else (1,) * self.n

    def sizes(self, level: int) -> np.ndarray:
        """Return the edge lengths (n,) [finest cells] of cells split so often along each axis."""
        return self.edges(np.full(self.n, level))

    def edges(self, times: np.ndarray) -> np.ndarray:
        """Return the edge lengths (..., n) of cells split so often, (..., n) [finest cells]."""
        refinement = np.array(self.refinement, dtype=np.int64)
        return refinement ** (self.max_level - times.astype(np.int64))

    def to_json(self) -> dict[str, Any]:
        """Return the grid as plain data."""
        return plain(self)


def grid_places(shape: Sequence[int] | np.ndarray) -> np.ndarray:
    """Return the integer positions (cells, n) of a block of cells in C order."""
    block = tuple(int(k) for k in shape)
    return np.stack(np.unravel_index(np.arange(math.prod(block)), block), axis=1)


def places_or_some(shape: Sequence[int], most: int) -> np.ndarray:
    """Return all integer positions (cells, n) of a block, or `most` random ones if it has more."""
    if math.prod(shape) <= most:
        return grid_places(shape)
    return np.random.default_rng(0).integers(shape, size=(most, len(shape)))
