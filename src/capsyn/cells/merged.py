"""Cells of a grid in which equal neighbours are one: what stands on every finest cell, merged."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from capsyn.modelling.grid import MAX_COUNT, Grid, grid_places


def grids_of(counts: Sequence[int], padded: Sequence[bool] | None = None) -> Iterator[Grid]:
    """Yield what cells of `counts` finest ones an axis may be like: no levels, or some that fit.

    Axes that may be `padded` are refined by two, and have more finest cells where need be.
    """
    padded = [False] * len(counts) if padded is None else padded
    yield Grid(tuple(counts), (2,) * len(counts), 0)
    for level in range(1, max(counts).bit_length()):
        partitions, refinement = [], []
        for count, free in zip(counts, padded):
            r = 2 if free else _root(count, level)
            if r is None:
                break
            partitions.append(-(-count // r**level))
            refinement.append(r)
        else:
            grid = Grid(tuple(partitions), tuple(refinement), level)
            sizes = grid.counts
            if math.prod(sizes) <= 2 * math.prod(counts) and max(sizes) <= MAX_COUNT:
                yield grid


def _root(count: int, level: int) -> int | None:
    """Return the least factor >= 2 whose power divides a count, if there is one."""
    factors = range(2, int(count ** (1 / level) + 1.5))
    return next((r for r in factors if count % r**level == 0), None)


def _pyramid(kinds: np.ndarray, grid: Grid) -> list[np.ndarray]:
    """Return the kind of every cell, coarsest level first; 0 where those below it differ."""
    levels = [kinds]
    for _ in range(grid.max_level):
        below = levels[-1]
        shape = [part for k, r in zip(below.shape, grid.refinement) for part in (k // r, r)]
        inner = tuple(range(1, 2 * below.ndim, 2))
        blocks = below.reshape(shape)
        first = blocks[(slice(None), 0) * below.ndim]
        same = (blocks == np.expand_dims(first, inner)).all(axis=inner)
        levels.append(np.where(same, first, kinds.dtype.type(0)))
    return levels[::-1]


def entry_count(kinds: np.ndarray, grid: Grid) -> int:
    """Return how many entries the merged cells of a grid have."""
    blocks = sum(int(np.count_nonzero(cells == 0)) for cells in _pyramid(kinds, grid))
    return grid.roots + blocks * grid.children


def merged(kinds: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Return the entries of a `CellTree` (M,) int64, -1 of leaves, and the kind of each (M,).

    `kinds` (k1, .., kn) are those of the finest cells of a grid, above 0; 0 is that of blocks.
    """
    children, cells = grid_places(grid.split(grid.max_level)), grid_places(grid.partitions)
    entries, every = [], []
    start = 0
    for layer in _pyramid(kinds, grid):
        own = layer[tuple(cells.T)]
        split = own == 0
        end = start + len(own)
        entries.append(np.where(split, end + len(children) * (np.cumsum(split) - 1), -1))
        every.append(own)
        start = end
        cells = (cells[split][:, None, :] * grid.refinement + children).reshape(-1, grid.n)
    return np.concatenate(entries), np.concatenate(every)
