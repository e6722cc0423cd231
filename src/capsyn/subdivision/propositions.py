"""What a subdivision will take, known beforehand: Propositions 1 and 2 of the paper, memory."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.execution.memory import available_memory
from capsyn.modelling.domain import Box
from capsyn.modelling.grid import grid_settings, lattice_counts
from capsyn.subdivision.cell_points import CellPoints
from capsyn.subdivision.limits import Limits
from capsyn.validation import describe

BYTES_PER_SOLVE = 34
BYTES_PER_KEY = 80
BYTES_PER_MASK = 4
"""Peak memory of a subdivision: per solved point, per test point of a block of cells, and per
byte of the masks of a cell's test points; measured and rounded up."""
BYTES_PER_MIXED = 40
BYTES_PER_BLOCK_CELL = 48
BYTES_PER_ENTRY = 8
"""Of constant leaves in blocks: what is kept of a mixed cell beside its entry, of any cell at
worst, and of its entry, twice: while entries are joined."""
BYTES_PER_PLACE = 64
"""Of the layout of one block: per child and test point, while it is made."""
BYTES_PER_CELL = 60
BYTES_PER_CELL_AXIS = 10
BYTES_PER_SCORE = 24
ROUND_BYTES = 300_000_000
ROOM = 4
"""Of subdivision in rounds: per cell beside its rows, and for each of its axes; per score that is
kept or fitted; for one round. One in so many bytes is for a block of cells."""
TIMED_BYTES = 10**8
"""Memory of the blocks between which the clock is looked at."""


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

    Raises
    ------
    ProblemError
        An argument that cannot be used.
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
    partitions: Sequence[int],
    refinement: Sequence[int],
    max_level: int,
    interior_points: int = 1,
    adaptive: bool = False,
) -> int:
    """Return the number of solves of Proposition 2, eq. (10), counted as the paper does.

    It bounds the test points; those of the quarter rule, random ones of the levels between, and
    parents' centres where axes are refined by even and odd numbers come on top.

    Parameters
    ----------
    partitions, refinement : (n,) ints
        Cells of the root grid, and children of a split cell, per axis.
    max_level : int
        Most times that a cell is split along an axis.
    interior_points : int
        Test points of a cell beside its vertices.
    adaptive : bool
        Cells are split along some axes only: one after the other, this makes fewer than twice as
        many cells as there are finest ones.
    """
    counts = lattice_counts(tuple(partitions), tuple(refinement), max_level)
    vertices = math.prod(count + 1 for count in counts)
    cells = (1 + math.prod(refinement) ** max_level) * math.prod(partitions)
    if adaptive:
        cells = 2 * math.prod(counts)
    return vertices + cells * interior_points


def worst_case_memory(
    partitions: Sequence[int],
    refinement: Sequence[int],
    max_level: int,
    test_points: CellPoints,
    n_symbols: int,
    max_solves: int | None = None,
    room: int | None = None,
) -> int:
    """Return a bound of the bytes that a subdivision takes, from measurements.

    Parameters
    ----------
    partitions, refinement : (n,) ints
        Cells of the root grid, and children of a split cell, per axis.
    max_level : int
        Most times that a cell is split along an axis.
    test_points : CellPoints
        Test points of a cell.
    n_symbols : int
        Number of symbols N.
    max_solves : int, optional
        Bound of the solves.
    room : int, optional
        What a block of cells may take [bytes], where levels are labelled block by block.
    """
    n, root = len(partitions), math.prod(partitions)
    split = tuple(refinement) if max_level else (1,) * n
    children = math.prod(split)
    cells = math.prod(lattice_counts(tuple(partitions), tuple(refinement), max_level))
    solves = worst_case_solves(partitions, refinement, max_level, test_points.interior(n))
    if max_solves is not None:
        solves = min(solves, max_solves)
        cells = min(cells, max(root, max_solves * _cells_per_solve(test_points, children)))
    need = block_bytes(test_points, split, mask_bytes(n_symbols))
    step = -(-cells // children) * need
    layout = layout_bytes(test_points, split)
    whole = BYTES_PER_SOLVE * solves + step + layout
    if room is None:
        return whole
    lattice = math.prod(8 * k for k in lattice_counts(tuple(partitions), tuple(refinement), 0))
    words = 1 + (lattice * children**max_level).bit_length() // 56
    kept = (8 * words + mask_bytes(n_symbols)) * solves + BYTES_PER_BLOCK_CELL * cells
    return min(whole, kept + max(need, min(step, room)) + layout)


def _cells_per_solve(test_points: CellPoints, children: int) -> int:
    """Return a bound of the cells that one solve makes.

    Every block has a point of its own. So has every cell with a centre, but for the middle one of
    a block whose axes are all cut into odd numbers.
    """
    return 2 if test_points.center else children


def mask_bytes(n_symbols: int) -> int:
    """Return the bytes of a mask of N + 1 bits."""
    return int(2 ** (n_symbols // 8).bit_length())


def block_bytes(test_points: CellPoints, split: Sequence[int], mask: int) -> int:
    """Return what labelling the children of one cell takes, whose masks take `mask` bytes each."""
    masks = block_tests(test_points, split) * mask
    return BYTES_PER_KEY * test_points.in_block(split) + BYTES_PER_MASK * masks


def block_tests(test_points: CellPoints, split: Sequence[int]) -> int:
    """Return the test points of all children of one cell, shared ones as often as they are."""
    n = len(split)
    return math.prod(split) * (2**n * test_points.vertices + test_points.interior(n))


def layout_bytes(test_points: CellPoints, split: Sequence[int]) -> int:
    """Return what it takes to find out which test points the children of a cell share."""
    return BYTES_PER_PLACE * block_tests(test_points, split)


def block_room(limits: Limits) -> int:
    """Return what a block of cells may take [bytes]; a lot where memory is unknown."""
    room = max(memory_bound(limits) // ROOM, 1)
    if limits.max_memory is None and limits.memory_limit is None:
        room = 1 << room.bit_length() - 1  # blocks must not follow some free megabytes
    return room if limits.max_seconds is None else min(room, TIMED_BYTES)


def block_parents(limits: Limits, parents: int, need: int, left: int, taken: int) -> int:
    """Return how many of the parents of a level make a block.

    As many as before, where a run goes on; unless memory has become too little for that.

    Parameters
    ----------
    limits : Limits
        What the run may take.
    parents : int
        Cells whose children are to be labelled.
    need, left : int
        What labelling the children of one takes, and what it leaves at worst [bytes].
    taken : int
        What is taken now [bytes].
    """
    own = max(1, block_room(limits) // need)
    if limits.room is None:
        return own
    before = max(1, limits.room // need)
    fits = taken + parents * left + min(before, parents) * need <= memory_bound(limits)
    return before if before <= own or fits else own


def memory_bound(limits: Limits) -> int:
    """Return what a run may take [bytes]: as given, else what is available."""
    for bound in (limits.max_memory, limits.memory_limit):
        if bound is not None:
            return bound
    return available_memory()


def worst_case_rounds_memory(
    partitions: Sequence[int],
    refinement: Sequence[int],
    max_level: int,
    test_points: CellPoints,
    labels: int,
    max_solves: int | None = None,
    adaptive: bool = False,
) -> int:
    """Return a bound of the bytes that a subdivision in rounds takes; see above.

    Solved points keep the scores of so many labels, cells their rows; test points are those of a
    round, the root grid being one. Where `adaptive`, splits along one axis after the other make
    more cells, and more of their inner points.
    """
    n, children, root = len(partitions), math.prod(refinement), math.prod(partitions)
    cells = math.prod(lattice_counts(tuple(partitions), tuple(refinement), max_level))
    interior = test_points.interior(n)
    solves = worst_case_solves(partitions, refinement, max_level, interior, adaptive)
    if adaptive:
        cells *= 2
    if max_solves is not None:
        solves = min(solves, max_solves)
        cells = min(cells, max(root, max_solves * _cells_per_solve(test_points, children)))
    first = root * test_points.in_block((1,) * n) * (BYTES_PER_KEY + BYTES_PER_SCORE * labels)
    split = tuple(refinement) if max_level else (1,) * n
    own = max(first, round_bytes(test_points, split, labels))
    return rounds_memory(solves, min(cells, 4 * solves), labels, n) + own


def round_bytes(test_points: CellPoints, split: Sequence[int], labels: int) -> int:
    """Return what a round takes: of one block at least, with the scores of so many labels."""
    scores = block_tests(test_points, split) * BYTES_PER_SCORE * labels
    return max(ROUND_BYTES, layout_bytes(test_points, split) + scores)


def rounds_memory(solves: int, cells: int, labels: int, n: int) -> int:
    """Return the bytes that solved points and cells take, with scores and rows of so many labels.

    Labels are 0 where leaves are constant.
    """
    solved = solves * (BYTES_PER_SOLVE + BYTES_PER_SCORE * labels)
    cell = BYTES_PER_CELL + BYTES_PER_CELL_AXIS * n + labels * (8 + 2 * n)
    return solved + 2 * cells * cell  # of all levels, twice: while they are put in order


def too_few_solves(
    needed: int, allowed: int | None, partitions: Sequence[int], test_points: CellPoints
) -> ProblemError:
    """Return the error of a budget of solves that does not do for the root grid."""
    return ProblemError(
        f"`max_solves` must be at least the {needed} solves of level 0; got {allowed}: "
        + _fewer_partitions(partitions, allowed or 0, test_points.in_block)
    )


def _fewer_partitions(
    partitions: Sequence[int], bound: int, need: Callable[[Sequence[int]], int]
) -> str:
    """Return the advice of the largest root grid whose `need` is within a bound."""
    k = bisect.bisect_right(
        range(1, max(partitions)), bound, key=lambda k: need([min(q, k) for q in partitions])
    )
    return f"use fewer partitions: {k} per axis fit at level 0" if k else "no root grid fits"


def check_memory(
    partitions: tuple[int, ...],
    refinement: tuple[int, ...],
    max_level: int,
    test_points: CellPoints,
    n_symbols: int,
    limits: Limits,
    affine: bool = False,
    adaptive: bool = False,
) -> None:
    """Raise `ProblemError` where the worst case exceeds `memory_limit`, or what is available.

    A budget of solves or of memory bounds the worst case; that of memory must do for the root grid.
    """
    limit = available_memory() if limits.memory_limit is None else limits.memory_limit
    room = block_room(limits)

    def need(level: int, q: Sequence[int] = partitions, most: int | None = None) -> int:
        solves = limits.max_solves if most is None else most
        if affine or adaptive:
            labels = n_symbols + 1 if affine else 0
            return worst_case_rounds_memory(
                q, refinement, level, test_points, labels, solves, adaptive
            )
        return worst_case_memory(q, refinement, level, test_points, n_symbols, solves, room)

    def fewer(bound: int) -> str:
        return _fewer_partitions(partitions, bound, lambda q: need(0, q))

    budget = limits.max_memory
    if budget is not None and need(0) > budget:
        raise ProblemError(
            f"`max_memory` must be at least the {need(0):,} bytes that level 0 may take; "
            f"got {budget:,}: {fewer(budget)}"
        )
    worst = need(max_level) if budget is None else min(need(max_level), budget)
    if worst <= limit:
        return
    fits = max((k for k in range(max_level) if need(k) <= limit), default=None)
    advice = fewer(limit) if fits is None else f"max_level <= {fits} fits"
    solves = worst_case_solves(
        partitions, refinement, max_level, test_points.interior(len(partitions)), adaptive
    )
    choices = range(1, min(solves, 2**40))
    most = bisect.bisect_right(choices, limit, key=lambda k: need(max_level, most=k))
    most -= most % 10 ** (len(str(most)) - 1)  # its first digit
    enough = most >= test_points.in_block(partitions)  # for level 0
    bound = f"`max_solves` (at most {most:,}) or " if enough else ""
    allowed = "available" if limits.memory_limit is None else "allowed by `memory_limit`"
    raise ProblemError(
        f"`max_level` {max_level} may take {worst / 1e9:.3g} GB at worst ({solves:.3g} solves); "
        f"{limit / 1e9:.3g} GB is {allowed}: {advice}, or bound it with {bound}`max_memory`"
    )
