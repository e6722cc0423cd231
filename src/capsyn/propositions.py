"""What a subdivision will take, known beforehand: Propositions 1 and 2 of the paper, memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from capsyn.cell_points import CellPoints
from capsyn.cells import grid_settings, lattice_counts
from capsyn.domain import Box
from capsyn.errors import ProblemError
from capsyn.validation import describe

BYTES_PER_SOLVE = 30
BYTES_PER_KEY = 70
BYTES_PER_MASK = 4
"""Peak memory of a subdivision: per solved point, per test point of a block of cells, and per
byte of the masks of a cell's test points; measured and rounded up."""
BYTES_PER_CELL = 120
ROUND_BYTES = 300_000_000
"""The same of affine leaves: per cell beside its rows, and for one round."""


def level_for_precision(
    domain: Box, precision: Sequence[float], partitions: Any, refinement: Any = 2
) -> int:
    """Return the least maximum level whose finest cells are no larger than wanted, eq. (9).

    Parameters
    ----------
    domain : Box
        The domain.
    precision : (n,)
        Wanted edge lengths of the finest cells [state units].
    partitions, refinement : int or (n,)
        Cells of the root grid, and children of a split cell, per axis.
    """
    wanted = np.asarray(precision, dtype=float)
    if wanted.shape != (domain.n,) or not (np.isfinite(wanted) & (wanted > 0)).all():
        raise ProblemError(
            f"`precision` must be {domain.n} positive number(s); got {describe(precision)}"
        )
    q, r, _ = grid_settings(partitions, refinement, 0, domain.n)
    level = 0
    while any(
        width / (cells * factor**level) > delta
        for width, delta, cells, factor in zip(domain.widths.tolist(), wanted.tolist(), q, r)
    ):
        level += 1
    return level


def worst_case_solves(
    partitions: Sequence[int], refinement: Sequence[int], max_level: int, interior_points: int = 1
) -> int:
    """Return the number of solves of Proposition 2, eq. (10), counted as the paper does.

    It bounds the test points; those of the quarter rule, random ones of the levels between, and
    parents' centres where axes are refined by even and odd numbers come on top.

    Parameters
    ----------
    partitions, refinement : (n,) ints
        Cells of the root grid, and children of a split cell, per axis.
    max_level : int
        Most times that a cell is split.
    interior_points : int
        Test points of a cell beside its vertices.
    """
    counts = lattice_counts(tuple(partitions), tuple(refinement), max_level)
    vertices = math.prod(count + 1 for count in counts)
    cells = (1 + math.prod(refinement) ** max_level) * math.prod(partitions)
    return vertices + cells * interior_points


def worst_case_memory(
    partitions: Sequence[int],
    refinement: Sequence[int],
    max_level: int,
    test_points: CellPoints,
    n_symbols: int,
    max_solves: int | None = None,
) -> int:
    """Return a bound of the bytes that a subdivision takes, from measurements.

    Parameters
    ----------
    partitions, refinement : (n,) ints
        Cells of the root grid, and children of a split cell, per axis.
    max_level : int
        Most times that a cell is split.
    test_points : CellPoints
        Test points of a cell.
    n_symbols : int
        Number of symbols N.
    max_solves : int, optional
        Bound of the solves.
    """
    n, root = len(partitions), math.prod(partitions)
    split = tuple(refinement) if max_level else (1,) * n
    children = math.prod(split)
    cells = math.prod(lattice_counts(tuple(partitions), tuple(refinement), max_level))
    solves = worst_case_solves(partitions, refinement, max_level, test_points.interior(n))
    if max_solves is not None:  # every block of cells has at least one point of its own
        solves = min(solves, max_solves)
        cells = min(cells, max(root, max_solves * children))
    keys = -(-cells // children) * test_points.in_block(split)
    mask_bytes = 2 ** (n_symbols // 8).bit_length()  # of N + 1 bits
    tests = 2**n * test_points.vertices + test_points.interior(n)
    masks = cells * tests * mask_bytes
    return BYTES_PER_SOLVE * solves + BYTES_PER_KEY * keys + BYTES_PER_MASK * masks


def worst_case_affine_memory(
    partitions: Sequence[int],
    refinement: Sequence[int],
    max_level: int,
    test_points: CellPoints,
    n_symbols: int,
    max_solves: int | None = None,
) -> int:
    """Return a bound of the bytes that a subdivision with affine leaves takes; see above.

    Solved points keep their scores, cells their rows; test points are those of a round, the root
    grid being one.
    """
    n, children = len(partitions), math.prod(refinement)
    cells = math.prod(lattice_counts(tuple(partitions), tuple(refinement), max_level))
    solves = worst_case_solves(partitions, refinement, max_level, test_points.interior(n))
    if max_solves is not None:  # every block of cells has at least one point of its own
        solves = min(solves, max_solves)
        cells = min(cells, max(math.prod(partitions), max_solves * children))
    labels = n_symbols + 1
    solved = solves * (BYTES_PER_SOLVE + 24 * labels)
    # of the cells of all levels, twice: while they are put in order
    rows = 2 * min(cells, 4 * solves) * (BYTES_PER_CELL + labels * (8 + 2 * n))
    root = math.prod(partitions) * test_points.in_block((1,) * n)
    return solved + rows + max(ROUND_BYTES, root * (BYTES_PER_KEY + 24 * labels))


def available_memory() -> int | None:
    """Return the bytes of memory that are free for use; None where the system does not say."""
    try:
        with open("/proc/meminfo") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass  # not Linux: nothing is known, and nothing is refused
    return None


def check_memory(
    partitions: tuple[int, ...],
    refinement: tuple[int, ...],
    max_level: int,
    test_points: CellPoints,
    n_symbols: int,
    max_solves: int | None,
    affine: bool = False,
) -> None:
    """Raise `ProblemError` where the worst case exceeds the memory that is available."""
    available = available_memory()
    estimate = worst_case_affine_memory if affine else worst_case_memory

    def need(level: int, solves: int | None = max_solves) -> int:
        return estimate(partitions, refinement, level, test_points, n_symbols, solves)

    if available is None or need(max_level) <= available:
        return
    fits = max((k for k in range(max_level) if need(k) <= available), default=None)
    advice = "use fewer partitions" if fits is None else f"max_level <= {fits} fits"
    most = available * 10**6 // need(max_level, 10**6)
    most -= most % 10 ** (len(str(most)) - 1)  # its first digit
    interior = test_points.interior(len(partitions))
    solves = worst_case_solves(partitions, refinement, max_level, interior)
    raise ProblemError(
        f"`max_level` {max_level} may take {need(max_level) / 1e9:.3g} GB at worst "
        f"({solves:.3g} solves); {available / 1e9:.3g} GB is available: {advice}, or bound it "
        f"with `max_solves` (at most {most:,})"
    )
