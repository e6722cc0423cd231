"""Trees and policies for tests, made at random instead of by a subdivision."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from capsyn import Alphabet, Box, Policy
from capsyn.cells.affine_leaves import AffineLeaves
from capsyn.cells.cell_tree import CellTree
from capsyn.modelling.grid import Grid

GRIDS = [
    ((1,), (2,), 0),
    ((5,), (3,), 3),
    ((9,), (2,), 4),
    ((3, 4), (2, 2), 3),
    ((2, 1), (3, 2), 3),
    ((1, 1), (2, 5), 2),
    ((2, 3, 1), (2, 3, 2), 2),
    ((1, 2, 1, 2), (2, 2, 3, 2), 2),
]
"""(partitions, refinement, max_level) for 1 to 4 axes, none of them the usual one."""


def random_tree(
    partitions: tuple[int, ...],
    refinement: tuple[int, ...],
    max_level: int,
    leaf_count: int = 3,
    split: float = 0.5,
    seed: int = 0,
    some_axes: bool = False,
) -> CellTree:
    """Return a well-formed tree with random splits, labels and mixed cells.

    With `some_axes` cells are split along some of the axes each.
    """
    rng = np.random.default_rng(seed)
    n = len(partitions)
    entries = -1 - rng.integers(0, leaf_count, math.prod(partitions))
    times, splits = np.zeros((len(entries), n), dtype=int), np.zeros(len(entries), dtype=np.uint16)
    start = 0
    while True:
        axes = times[start:] < max_level
        if some_axes:
            axes &= rng.random(axes.shape) < 0.6
        here = np.flatnonzero((rng.random(len(axes)) < split) & axes.any(axis=1))
        if not here.size:
            break
        axes = axes[here]
        children = np.prod(np.where(axes, refinement, 1), axis=1)
        fresh = np.repeat(times[start + here] + axes, children, axis=0)
        entries[start + here] = len(entries) + np.cumsum(children) - children
        splits[start + here] = axes @ (1 << np.arange(n))
        start = len(entries)
        entries = np.append(entries, -1 - rng.integers(0, leaf_count, len(fresh)))
        times, splits = (
            np.vstack([times, fresh]),
            np.append(splits, np.zeros(len(fresh), np.uint16)),
        )
    leaves = np.flatnonzero(entries < 0)
    mixed = leaves[rng.random(len(leaves)) < 0.3]
    seen = rng.integers(0, 2**leaf_count, len(mixed), dtype=np.uint64)
    seen |= np.uint64(1) << (-1 - entries[mixed]).astype(np.uint64)
    return CellTree(
        Grid(partitions, refinement, max_level),
        entries.astype(np.int32),
        mixed.astype(np.int32),
        seen,
        splits=splits if some_axes else None,
    )


def random_policy(
    grid: int, periodic: bool = False, seed: int = 0, some_axes: bool = False
) -> Policy:
    """Return a policy of two symbols over one of the `GRIDS`, with bounds that do not divide.

    Where `periodic`, every second axis is, the last one too; see `random_tree`.
    """
    partitions, refinement, max_level = GRIDS[grid]
    n = len(partitions)
    rng = np.random.default_rng(seed)
    lower = rng.normal(size=n)
    turning = [periodic and (n - 1 - i) % 2 == 0 for i in range(n)]
    domain = Box(lower, lower + rng.uniform(0.1, 7, n), periodic=turning)
    tree = random_tree(partitions, refinement, max_level, seed=seed, some_axes=some_axes)
    return Policy("random", domain, Alphabet([-1, 1]), np.zeros(1), tree)


def states_at_faces(domain: Box, counts: tuple[int, ...], size: int, seed: int = 0) -> np.ndarray:
    """Return states (3 size, n) on faces, edges, corners, seams and one rounding beside them."""
    rng = np.random.default_rng(seed)
    coordinates = np.stack([rng.integers(0, count + 1, size) for count in counts], axis=1)
    states = domain.points(coordinates, counts)
    inner = domain.sample(size, seed)
    states = np.where(rng.random(states.shape) < 0.3, inner, states)
    return np.vstack([states, np.nextafter(states, -np.inf), np.nextafter(states, np.inf)])


def random_affine_tree(
    partitions: tuple[int, ...],
    refinement: tuple[int, ...],
    max_level: int,
    labels: int = 3,
    seed: int = 0,
    some_axes: bool = False,
) -> CellTree:
    """Return a random tree with about half its leaves affine, on a lattice one level finer."""
    rng = np.random.default_rng([7, seed])
    tree = random_tree(partitions, refinement, max_level, labels, seed=seed, some_axes=some_axes)
    grid = Grid(partitions, refinement, max_level + 1)
    counts = grid.counts
    entries = tree.entries.copy()
    chosen = rng.random(len(entries)) < 0.5
    chosen[-1] = True  # the last cell is a leaf
    places = np.flatnonzero((entries < 0) & chosen)
    entries[places] = -1 - labels - np.arange(len(places))
    sets = [np.sort(rng.permutation(labels)[: rng.integers(2, labels + 1)]) for _ in places]
    symbols = np.concatenate(sets)
    slopes = rng.integers(-9, 10, (len(symbols), len(counts)))
    constants = -(slopes @ (rng.random(len(counts)) * counts)).astype(int)
    affine = AffineLeaves.of(
        labels,
        np.array([len(s) for s in sets]),
        symbols.astype(np.int32),
        constants.astype(np.int32),
        slopes.astype(np.int16),
    )
    seen = tree.mixed_labels | np.uint64(2**labels - 1)
    return CellTree(
        grid,
        entries,
        tree.mixed_cells,
        seen,
        affine,
        tree.splits,
    )


def random_affine_policy(
    grid: int, periodic: bool = False, seed: int = 0, some_axes: bool = False
) -> Policy:
    """Return a `random_policy` of affine leaves."""
    policy = random_policy(grid, periodic, seed)
    cells = random_affine_tree(*GRIDS[grid], seed=seed, some_axes=some_axes)
    return dataclasses.replace(policy, cells=cells)


def policy_of_rows(
    rows: list[tuple[int, int, list[int]]],
    counts: tuple[int, ...],
    copies: int = 1,
    labels: int = 3,
) -> Policy:
    """Return a policy of cells with the same rows (symbol, constant, slopes) each, along an axis.

    `counts` are steps of the lattice, powers of two beside the `copies` of the first axis.
    """
    n, level = len(counts), counts[-1].bit_length() - 1
    partitions = (counts[0] >> level, *(count >> level for count in counts[1:]))
    cells = math.prod(partitions)
    assert cells == copies and all(q << level == c for q, c in zip(partitions, counts))
    symbols, constants, slopes = (np.array(column) for column in zip(*rows))
    affine = AffineLeaves.of(
        labels,
        np.full(cells, len(rows)),
        np.tile(symbols, cells).astype(np.int32),
        np.tile(constants, cells).astype(np.int32),
        np.tile(slopes, (cells, 1)).astype(np.int16),
    )
    none = np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.uint64)
    entries = -1 - labels - np.arange(cells, dtype=np.int32)
    tree = CellTree(Grid(partitions, (2,) * n, level), entries, *none, affine)
    alphabet = Alphabet(np.arange(1.0, labels))
    return Policy("rows", Box([0] * n, [1] * n), alphabet, np.zeros(1), tree)
