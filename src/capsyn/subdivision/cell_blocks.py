"""What a subdivision works on: its task, blocks of sibling cells, the keys of their test points."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.subdivision.cell_points import CellPoints
from capsyn.subdivision.lattice_points import LatticePoints
from capsyn.subdivision.limits import Limits
from capsyn.subdivision.propositions import worst_case_solves

FINE = 8
"""Lattice units along the edge of a finest cell: of vertices, centres and edge midpoints, and of
points a quarter of the way from these to the centre."""
ROLES = ("vertices", "centers", "others", "quarter")
"""What a solved point was first: vertex, centre, other test point, or point of the quarter rule."""


def grid_places(split: Sequence[int] | np.ndarray) -> np.ndarray:
    """Return the integer positions (children, n) of the cells of a block in C order."""
    shape = tuple(int(k) for k in split)
    return np.stack(np.unravel_index(np.arange(math.prod(shape)), shape), axis=1)


@dataclass(frozen=True)
class CellBlocks:
    """Test points of blocks of children.

    Parameters
    ----------
    points : LatticePoints
        Where test points get their keys.
    test_points : CellPoints
        Which points of a cell are tested.
    n : int
        Number of axes.
    seed : int
        Seed of random test points.
    """

    points: LatticePoints
    test_points: CellPoints
    n: int
    seed: int

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
        """Return the keys of the test points of blocks.

        Parameters
        ----------
        parents : (M, n)
            Lower corners of the blocks [lattice units].
        split : (n,)
            Children along each axis.
        size : (n,) or (M, n)
            Their edge lengths [lattice units].
        rng : numpy.random.Generator
            Where random test points come from. Blocks that are asked for one after the other get
            the points that they get together.

        Returns
        -------
        keys : (U, M)
            Keys of the U different points of a block of children.
        table : (children, P)
            The rows of `keys` that are the test points of each child.
        roles : (U,)
            Indices into `ROLES`.
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

        Parameters
        ----------
        corners : (K, n)
            Lower corners of the cells [lattice units].
        size : (n,) or (K, n)
            Their edge lengths [lattice units].
        offsets : (K, n)
            The points, in halves of the cell.
        """
        # offset / 2 + (1 / 2 - offset / 2) / 4 = (3 offset + 1) / 8 of the cell, offset in halves
        places = corners + (3 * offsets + 1) * (size // FINE)
        return self.points.encode(np.zeros((1, self.n), dtype=np.int64), places)[0]


@dataclass(frozen=True, eq=False)
class SubdivisionTask:
    """What is to be subdivided, and how far.

    Parameters
    ----------
    partitions, refinement : (n,) ints
        Cells of the root grid, and children of a split cell, per axis.
    max_level : int
        Most times that a cell is split along an axis.
    test_points : CellPoints
        Which points of a cell are tested.
    seed : int
        Seed of random test points.
    order : list of int
        Symbols and the default, most preferred first, to break ties.
    points : LatticePoints
        Where test points are solved.
    limits : Limits
        What it may take.
    """

    partitions: tuple[int, ...]
    refinement: tuple[int, ...]
    max_level: int
    test_points: CellPoints
    seed: int
    order: list[int]
    points: LatticePoints
    limits: Limits

    @property
    def n(self) -> int:
        """Number of axes."""
        return len(self.partitions)

    @functools.cached_property
    def blocks(self) -> CellBlocks:
        """Where blocks get their test points."""
        return CellBlocks(self.points, self.test_points, self.n, self.seed)

    def statistics(self, roles: np.ndarray, stopped: str, adaptive: bool = False) -> dict[str, Any]:
        """Return the counts of what was solved as plain data.

        `roles` counts solves by `ROLES`; `stopped` names the limit that ended the work, if any;
        `adaptive`: cells were split along some axes only.
        """
        points = self.points
        return ({"stopped_by": stopped} if stopped not in ("", "max_solves") else {}) | {
            "solves": points.count,
            "solves_by_role": dict(zip(ROLES, roles.tolist())),
            "stopped_by_max_solves": stopped == "max_solves",
            "indifferent_points": points.indifferent,
            "not_finite_points": points.not_finite,
            "not_finite_example": points.example,
            "test_points": str(self.test_points),
            "seed": self.seed,
            "worst_case_solves": worst_case_solves(
                self.partitions,
                self.refinement,
                self.max_level,
                self.test_points.interior(self.n),
                adaptive,
            ),
        }
