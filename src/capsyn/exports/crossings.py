"""Readings and the faces of the lattice: which are told apart, crossed, and compared with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.validation import describe, finite_array, numbers


def reading_factors(
    domain: Box, counts: tuple[int, ...], scale: object, offset: object
) -> tuple[np.ndarray, np.ndarray]:
    """Return scale and offset (n,) of readings; None stands for 1 and 0.

    Raises
    ------
    ProblemError
        They are no numbers, or do not keep apart the lattice steps, so many along each axis.
    """
    n = domain.n
    factor = np.ones(n) if scale is None else _per_state("scale", scale, n)
    start = np.zeros(n) if offset is None else _per_state("offset", offset, n)
    if (factor == 0).any():
        raise ProblemError(f"`scale` must not be 0; got {describe(scale)}")
    _check_readings(domain, counts, factor, start)
    return factor, start


def least_reaching(
    states: Callable[[np.ndarray], np.ndarray], bounds: np.ndarray, low: int, high: int
) -> np.ndarray:
    """Return the least whole numbers in [low, high] whose states reach bounds, else high + 1.

    Parameters
    ----------
    states : callable
        Whole numbers (K,), held as floats, to states (K,) that never fall from one to the next.
    bounds : (K,)
        States to be reached.
    """
    before = np.full(len(bounds), low - 1, dtype=np.int64)
    behind = np.full(len(bounds), high + 1, dtype=np.int64)
    while (behind - before > 1).any():
        middle = (before + behind) // 2
        reached = states(middle.astype(np.float64)) >= bounds
        apart = behind - before > 1
        behind = np.where(apart & reached, middle, behind)
        before = np.where(apart & ~reached, middle, before)
    return behind


def ranked_tree(
    tree: CellTree | SplitTree,
) -> tuple[CellTree | SplitTree, list[np.ndarray]]:
    """Return a tree over the faces that it compares with, and the numbers of these on each axis.

    Cells and a tree with oblique splits are the same, with all faces but the first and the last.
    """
    numbers = [np.arange(1, count) for count in tree.counts]
    if isinstance(tree, CellTree) or tree.has_planes:
        return tree, numbers
    threshold = tree.threshold.copy()
    for i in range(tree.n):
        at = tree.split == i
        numbers[i], rank = np.unique(tree.threshold[at], return_inverse=True)
        threshold[at] = rank.ravel() + 1
    counts = tuple(len(k) + 1 for k in numbers)
    return SplitTree(counts, tree.split, threshold, tree.second, tree.planes), numbers


def _check_readings(
    domain: Box, counts: tuple[int, ...], scale: np.ndarray, offset: np.ndarray
) -> None:
    """Raise where the steps of an axis fall together in the readings, or in ``+ offset``."""
    with np.errstate(over="ignore", invalid="ignore"):
        ends = np.stack([(domain.lower - offset) / scale, (domain.upper - offset) / scale])
        at = np.maximum(np.maximum(abs(domain.lower), abs(domain.upper)), abs(offset))
        step = np.abs(ends[1] - ends[0]) / counts
        lost = ~(step >= 2 * np.spacing(np.abs(ends).max(axis=0)))
        lost |= ~(domain.widths / counts >= 2 * np.spacing(at)) | ~np.isfinite(ends).all(axis=0)
    if ((scale != 1) | (offset != 0))[lost].any():
        i = int(np.flatnonzero(lost)[0])
        raise ProblemError(
            f"`scale` and `offset` must keep the {counts[i]:,} lattice steps of axis "
            f"'{domain.names[i]}' apart in double precision; got {scale[i]:g} and {offset[i]:g}"
        )


def _per_state(name: str, value: object, n: int) -> np.ndarray:
    values = finite_array(name, value, 1 if numbers(name, value).ndim else 0).reshape(-1)
    if len(values) not in (1, n):
        raise ProblemError(f"`{name}` must be one number or {n}; got {describe(value)}")
    return np.array(np.broadcast_to(values, n))
