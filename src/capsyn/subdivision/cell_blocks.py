"""What a subdivision works on: its task, blocks of sibling cells, the keys of their test points."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from capsyn.cells.affine_leaves import PriceRatios
from capsyn.cells.row_table import RowTable
from capsyn.modelling.grid import grid_places
from capsyn.subdivision.cell_points import FINE, CellPoints
from capsyn.subdivision.lattice_points import LatticePoints
from capsyn.subdivision.plan import SubdivisionPlan

ROLES = ("vertices", "centers", "others", "quarter")
"""What a solved point was first: vertex, centre, other test point, or point of the quarter rule."""


@dataclass(frozen=True)
class CellBlocks:
    """Test points of blocks of children."""

    points: LatticePoints  # where test points get their keys
    test_points: CellPoints  # which points of a cell are tested
    n: int  # number of axes
    seed: int  # of random test points

    def stream(self, number: int) -> np.random.Generator:
        """Return a stream of random test points."""
        return np.random.default_rng([self.seed, number])

    def keys(
        self,
        parents: np.ndarray,
        split: np.ndarray,
        size: np.ndarray,
        rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the keys of the test points of blocks, the points of each child, and their roles.

        The parents (M, n) are lower corners of blocks with `split` (n,) children along each axis,
        whose edge lengths are `size` (n,) or (M, n) [lattice units]. Blocks that are asked for one
        after the other get the random test points that they get together.

        The keys (U, M) are those of the U different points of a block, the table (children, P) has
        the rows of them that are the test points of each child, and roles (U,) are indices into
        `ROLES`.
        """
        grid, offsets = grid_places(split), self.test_points.offsets(self.n)
        extents = tuple(2 * split + 1)
        places = (np.ravel_multi_index(tuple(points.T), extents) for points in (2 * grid, offsets))
        numbers = np.add.outer(*places)
        distinct, table = np.unique(numbers, return_inverse=True)
        table = table.reshape(numbers.shape)
        halves = np.stack(np.unravel_index(distinct, extents), axis=1)
        odd = (halves % 2).sum(axis=1)
        roles = np.where(odd == 0, 0, np.where(odd == self.n, 1, 2))
        if size.ndim == 1:
            keys = self.points.encode(halves * (size // 2), parents)
        else:
            keys = self.points.encode(halves, parents, size // 2)
        count = self.test_points.random
        if count:
            shape = (len(parents), len(grid), count, self.n)
            edges = np.atleast_2d(size)[:, None, None, :]
            inner = grid[:, None, :] * edges + rng.integers(1, edges, size=shape)
            inner = np.moveaxis(inner, 0, 2).reshape(-1, len(parents), self.n)
            keys = np.vstack([keys, self.points.encode(inner, parents)])
            rows = len(distinct) + np.arange(len(grid) * count).reshape(len(grid), count)
            table = np.hstack([table, rows])
            roles = np.append(roles, np.full(len(grid) * count, 2))
        return keys, table, roles

    def quarter_keys(
        self, corners: np.ndarray, size: np.ndarray, offsets: np.ndarray
    ) -> np.ndarray:
        """Return the keys (K,) of fixed points moved a quarter of the way to the cell's centre.

        Cells are lower corners (K, n) and edge lengths, (n,) or (K, n) [lattice units]; the points
        are offsets (K, n) in halves of the cell.
        """
        # offset / 2 + (1 / 2 - offset / 2) / 4 = (3 offset + 1) / 8 of the cell, offset in halves
        places = corners + (3 * offsets + 1) * (size // FINE)
        return self.points.encode(np.zeros((1, self.n), dtype=np.int64), places)[0]


@dataclass(frozen=True, eq=False)
class SubdivisionTask:
    """What is to be subdivided, and how far."""

    plan: SubdivisionPlan  # what is asked for
    rows: RowTable  # of the leaves
    points: LatticePoints  # where test points are solved
    plain: bool  # whether scores are mere indicators of labels
    prices: PriceRatios | None = None  # on switching, that rows of affine leaves pay

    @functools.cached_property
    def offsets(self) -> np.ndarray:
        """The fixed test points (P, n) of a cell, in its halves."""
        return self.plan.points.offsets(self.plan.grid.n)

    @functools.cached_property
    def blocks(self) -> CellBlocks:
        """Where blocks get their test points."""
        plan = self.plan
        return CellBlocks(self.points, plan.points, plan.grid.n, plan.seed)
