"""Cells in the order of their making, and the tree that they become."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from capsyn.cells.affine_leaves import LARGEST_SUM, AffineLeaves
from capsyn.cells.boxes import ragged
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.masks import masks_of_members, several
from capsyn.errors import ProblemError
from capsyn.modelling.grid import Grid
from capsyn.subdivision.affine_fit import Fits

LATTICE, FEW, MANY = 2**14, 2**12, 2**18
"""Steps along an axis that the lattice of rows has at most, unless the cells need more, or another
axis has few: then many."""
LEAST_STEPS = 8
"""Least steps along the edge of a finest cell."""
MOST_STEPS = LARGEST_SUM // 16
"""Most steps of the lattice, all axes together: slopes are whole numbers, and need some size."""


def row_grid(grid: Grid) -> Grid:
    """Return the grid, at the level whose cells are the lattice steps of rows.

    Where rows of whole numbers could not follow so many steps this is a `ProblemError`.
    """
    finer = 0
    while min(grid.refinement) ** finer < LEAST_STEPS:
        finer += 1
    rows = grid.at(grid.max_level + finer)
    if sum(rows.counts) > MOST_STEPS:
        levels = range(grid.max_level)
        fits = [k for k in levels if sum(grid.at(k + finer).counts) <= MOST_STEPS]
        advice = f"max_level <= {fits[-1]} fits" if fits else "use fewer partitions"
        raise ProblemError(f"`max_level` {grid.max_level} is too high for affine leaves: {advice}")
    while True:
        next_finer = rows.at(rows.max_level + 1)
        if max(next_finer.counts) > (MANY if min(rows.counts) < FEW else LATTICE):
            return rows
        rows = next_finer


@dataclass(eq=False)
class GrowingCells:
    """Cells in the order of their making, those of a block together."""

    corner: np.ndarray  # (K, n): lower corners [lattice units of the test points]
    times: np.ndarray  # (K, n): how often they have been split along each axis
    level: np.ndarray  # (K,): levels in the tree
    child: np.ndarray  # (K,): the first child or -1
    axes: np.ndarray  # (K, n) bool: along which they are split if they are; none where they cannot
    label: np.ndarray  # (K,): symbols, or -1 where rows decide
    accepted: np.ndarray  # (K,) bool: whether no test point disagrees with the leaf
    error: np.ndarray  # (K,): estimated share of the cell where its symbol is wrong
    seen: np.ndarray  # (K, J, W) uint64: where test points disagree, their labels and the leaf's
    row: np.ndarray  # (K,): first row in `Rows`
    rows: np.ndarray  # (K,): how many rows
    price: np.ndarray  # (K,): what a ratio of prices takes off these

    @staticmethod
    def uniform(
        corner: np.ndarray,
        times: np.ndarray,
        level: np.ndarray,
        axes: np.ndarray,
        label: np.ndarray,
        sets: tuple[int, int],
    ) -> GrowingCells:
        """Return cells whose test points agree on labels (K,), with sets of a shape (J, W)."""
        count = len(corner)
        none, seen = np.zeros(count, dtype=np.int64), np.zeros((count, *sets), dtype=np.uint64)
        good, error = np.ones(count, dtype=bool), np.zeros(count)
        return GrowingCells(
            corner, times, level, none - 1, axes, label, good, error, seen, none, none.copy(),
            none.copy(),
        )  # fmt: skip

    @staticmethod
    def joined(parts: list[GrowingCells]) -> GrowingCells:
        """Return all cells of the parts, one after the other."""
        names = [f.name for f in fields(GrowingCells)]
        return GrowingCells(*(np.concatenate([getattr(p, k) for p in parts]) for k in names))

    def fit(
        self, cells: np.ndarray, fits: Fits, masks: np.ndarray, first_row: int, most_error: float
    ) -> Rows:
        """Give some cells (M,) their rows; `masks` (P, M, J, W) are those of their test points.

        Returns the rows; `first_row` have been made before.
        """
        one = fits.used.sum(axis=1) == 1
        self.label[cells] = np.where(one, fits.used.argmax(axis=1), -1)
        self.accepted[cells] = (fits.wrong == 0) & (fits.error <= most_error)
        self.error[cells] = fits.error
        self.axes[cells] &= fits.axes
        single = np.where(several(masks)[..., None], masks.dtype.type(0), masks)
        seen = np.bitwise_or.reduce(single, axis=0).astype(np.uint64)
        seen |= masks_of_members(fits.used, seen.shape[-1])[:, None]
        right = (fits.wrong == 0)[:, None, None]
        self.seen[cells] = np.where(right, np.uint64(0), seen)
        self.price[cells] = fits.price
        kept = fits.used & ~one[:, None]
        self.rows[cells] = kept.sum(axis=1)
        self.row[cells] = first_row + np.cumsum(self.rows[cells]) - self.rows[cells]
        cell, symbol = np.nonzero(kept)
        return Rows(
            symbol.astype(np.int32),
            fits.constants[cell, symbol].astype(np.int32),
            fits.slopes[cell, symbol].astype(np.int16),
        )

    def children(self, cells: np.ndarray, refinement: tuple[int, ...]) -> np.ndarray:
        """Return into how many children each of some cells (M,) is split, if it is."""
        return np.prod(np.where(self.axes[cells], refinement, 1), axis=1)

    def groups(self, chosen: np.ndarray, refinement: tuple[int, ...]) -> list[SplitCells]:
        """Return some cells (M,), those together that are split along the same axes."""
        kinds, kind = np.unique(self.axes[chosen], axis=0, return_inverse=True)
        groups = []
        for k, axes in enumerate(kinds):
            here = chosen[kind.ravel() == k]
            times = (self.times[here] + axes).astype(np.int8)
            factors = np.where(axes, refinement, 1)
            groups.append(SplitCells(here, factors, self.corner[here], times, self.level[here] + 1))
        return groups

    def by_level(self, grid: Grid) -> Iterator[np.ndarray]:
        """Yield the cells (M,) of each level in the order of a `CellTree`."""
        here = np.arange(grid.roots)
        while here.size:
            yield here
            split = here[self.child[here] >= 0]
            parent, number = ragged(self.children(split, grid.refinement))
            here = self.child[split][parent] + number

    def tree(
        self,
        grid: Grid,
        first: int,
        rows: list[Rows],
        adaptive: bool,
        ratios: np.ndarray | None = None,
    ) -> CellTree:
        """Return the cells as a tree on the lattice of a grid.

        Affine leaves have numbers from `first` on, and prices where there are `ratios` of these.
        Where `adaptive`, cells may be split along some axes only.
        """
        order = np.concatenate(list(self.by_level(grid)))
        split = self.child[order] >= 0
        entries = -1 - self.label[order].astype(np.int64)
        counts = self.children(order[split], grid.refinement)
        entries[split] = grid.roots + np.cumsum(counts) - counts
        affine = np.flatnonzero(~split & (self.label[order] < 0))
        entries[affine] = -1 - (first + np.arange(len(affine)))
        mixed = np.flatnonzero(~split & (self.seen[order] != 0).any(axis=(1, 2)))
        bits = np.uint16(1) << np.arange(self.axes.shape[1], dtype=np.uint16)
        splits = (self.axes[order] @ bits).astype(np.uint16) * split if adaptive else None
        return CellTree(
            grid,
            entries.astype(np.int32),
            mixed.astype(np.int32),
            self.seen[order[mixed]],
            self._affine(order[affine], first, rows, ratios) if affine.size else None,
            splits,
        )

    def _affine(
        self, cells: np.ndarray, first: int, rows: list[Rows], ratios: np.ndarray | None
    ) -> AffineLeaves:
        """Return the affine leaves of cells (A,)."""
        count = self.rows[cells]
        cell, number = ragged(count)
        picked = self.row[cells][cell] + number
        symbols, constants, slopes = (np.concatenate(table)[picked] for table in zip(*rows))
        prices = None if ratios is None else self.price[cells].astype(np.int32)
        return AffineLeaves.of(first, count, symbols, constants, slopes, prices, ratios)


@dataclass(frozen=True, eq=False)
class SplitCells:
    """Cells that are split alike."""

    cells: np.ndarray  # (M,): their numbers
    factors: np.ndarray  # (n,): into how many children along each axis
    corners: np.ndarray  # (M, n): lower corners [lattice units]
    times: np.ndarray  # (M, n): how often their children have been split
    level: np.ndarray  # (M,): of their children

    def part(self, some: slice) -> SplitCells:
        """Return some of them."""
        return SplitCells(
            self.cells[some], self.factors, self.corners[some], self.times[some], self.level[some]
        )

    @staticmethod
    def roots(corners: np.ndarray) -> SplitCells:
        """Return the cells of the root grid, which are their own parents."""
        count, n = corners.shape
        none = np.zeros((count, n), dtype=np.int8)
        level = np.zeros(count, dtype=np.int16)
        return SplitCells(np.arange(count), np.ones(n, dtype=np.int64), corners, none, level)


class Rows(NamedTuple):
    """Rows as `AffineLeaves` has them: symbols (R,), constants (R,) and slopes (R, n)."""

    symbols: np.ndarray
    constants: np.ndarray
    slopes: np.ndarray
