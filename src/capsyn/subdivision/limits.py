"""What a subdivision may take, solves, seconds and memory, and what it takes at worst."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from capsyn.cells.masks import word_count, word_type
from capsyn.errors import ProblemError
from capsyn.execution.memory import available_memory, memory
from capsyn.modelling.grid import Grid
from capsyn.subdivision.cell_points import FINE, CellPoints
from capsyn.subdivision.propositions import worst_case_solves
from capsyn.validation import finite_number, whole_number

BYTES_PER_SOLVE = 34
BYTES_PER_KEY = 80
BYTES_PER_MASK = 4
"""Peak memory of a subdivision: per solved point, per test point of a block of cells, and per
byte of the masks of a cell's test points; measured and rounded up."""
BYTES_PER_WIDE = 3
"""Of a solved point: per byte of its sets beyond the first eight."""
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


@dataclass(frozen=True)
class Limits:
    """What a subdivision may take; see `subdivide`.

    `room` is what a block of cells took before [bytes], where a run goes on: blocks stay as they
    were unless there is no longer memory for them.
    """

    max_solves: int | None = None
    max_seconds: float | None = None  # [s]
    max_memory: int | None = None  # [bytes]
    memory_limit: int | None = None  # what a run may need at worst [bytes]
    room: int | None = None

    @staticmethod
    def of(max_solves: Any, max_seconds: Any, max_memory: Any, memory_limit: Any) -> Limits:
        """Return validated limits; None where there is none."""
        return Limits(
            None if max_solves is None else whole_number("max_solves", max_solves, least=1),
            None if max_seconds is None else finite_number("max_seconds", max_seconds, above=0.0),
            None if max_memory is None else memory("max_memory", max_memory),
            None if memory_limit is None else memory("memory_limit", memory_limit),
        )


def worst_case_memory(
    grid: Grid,
    test_points: CellPoints,
    n_symbols: int,
    max_solves: int | None = None,
    room: int | None = None,
    in_force: int = 1,
) -> int:
    """Return a bound of the bytes that a subdivision takes, from measurements.

    Where levels are labelled block by block, a block may take `room` [bytes]. Points have sets for
    so many symbols in force.
    """
    split, cells = grid.split(grid.max_level), grid.cells
    children = math.prod(split)
    solves = worst_case_solves(grid, test_points.interior(grid.n))
    if max_solves is not None:
        solves = min(solves, max_solves)
        cells = min(cells, max(grid.roots, max_solves * _cells_per_solve(test_points, children)))
    mask = mask_bytes(n_symbols, in_force)
    need = block_bytes(test_points, split, mask)
    step = -(-cells // children) * need
    layout = layout_bytes(test_points, split)
    whole = (BYTES_PER_SOLVE + BYTES_PER_WIDE * max(0, mask - 8)) * solves + step + layout
    if room is None:
        return whole
    words = 1 + (FINE**grid.n * grid.cells).bit_length() // 56
    kept = (8 * words + mask) * solves + (BYTES_PER_BLOCK_CELL + mask) * cells
    return min(whole, kept + max(need, min(step, room)) + layout)


def _cells_per_solve(test_points: CellPoints, children: int) -> int:
    """Return a bound of the cells that one solve makes.

    Every block has a point of its own. So has every cell with a centre, but for the middle one of
    a block whose axes are all cut into odd numbers.
    """
    return 2 if test_points.center else children


def mask_bytes(n_symbols: int, in_force: int = 1) -> int:
    """Return the bytes of the sets of a point: of N + 1 bits, for so many symbols in force."""
    labels = n_symbols + 1
    return in_force * word_count(labels) * word_type(labels).itemsize


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
    """Return what a block of cells may take [bytes]."""
    room = max(memory_bound(limits) // ROOM, 1)
    if limits.max_memory is None and limits.memory_limit is None:
        room = 1 << room.bit_length() - 1  # blocks must not follow some free megabytes
    return room if limits.max_seconds is None else min(room, TIMED_BYTES)


def block_parents(limits: Limits, parents: int, need: int, left: int, taken: int) -> int:
    """Return how many of the parents of a level make a block.

    As many as before, where a run goes on; unless memory has become too little for that. Labelling
    the children of one parent needs `need` [bytes] and leaves `left` at worst; `taken` are taken
    now.
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
    grid: Grid,
    test_points: CellPoints,
    labels: int,
    max_solves: int | None = None,
    adaptive: bool = False,
    wide: int = 0,
) -> int:
    """Return a bound of the bytes that a subdivision in rounds takes; see above.

    Solved points keep the scores of so many labels, cells their rows; test points are those of a
    round, the root grid being one. Where `adaptive`, splits along one axis after the other make
    more cells, and more of their inner points. `wide` are the bytes of a point's sets beyond eight.
    """
    cells = 2 * grid.cells if adaptive else grid.cells
    solves = worst_case_solves(grid, test_points.interior(grid.n), adaptive)
    if max_solves is not None:
        solves = min(solves, max_solves)
        most_cells = max_solves * _cells_per_solve(test_points, grid.children)
        cells = min(cells, max(grid.roots, most_cells))
    first = grid.roots * test_points.in_block(grid.split(0))
    first *= BYTES_PER_KEY + BYTES_PER_SCORE * labels
    own = max(first, round_bytes(test_points, grid.split(grid.max_level), labels))
    kept = rounds_memory(solves, min(cells, 4 * solves), labels, grid.n)
    return kept + (BYTES_PER_WIDE * solves + min(cells, 4 * solves)) * wide + own


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
    needed: int, allowed: int | None, grid: Grid, test_points: CellPoints
) -> ProblemError:
    """Return the error of a budget of solves that does not do for the root grid."""
    return ProblemError(
        f"`max_solves` must be at least the {needed} solves of level 0; got {allowed}: "
        + _fewer_partitions(
            grid, allowed or 0, lambda fewer: test_points.in_block(fewer.partitions)
        )
    )


def _fewer_partitions(grid: Grid, bound: int, need: Callable[[Grid], int]) -> str:
    """Return the advice of the largest root grid whose `need` is within a bound."""

    def fewer(most: int) -> Grid:
        return Grid(tuple(min(q, most) for q in grid.partitions), grid.refinement, 0)

    choices = range(1, max(grid.partitions))
    k = bisect.bisect_right(choices, bound, key=lambda most: need(fewer(most)))
    return f"use fewer partitions: {k} per axis fit at level 0" if k else "no root grid fits"


def check_memory(
    grid: Grid,
    test_points: CellPoints,
    n_symbols: int,
    limits: Limits,
    affine: bool = False,
    adaptive: bool = False,
    in_force: int = 1,
) -> None:
    """Raise `ProblemError` where the worst case exceeds `memory_limit`, or what is available.

    A budget of solves or of memory bounds the worst case; that of memory must do for the root grid.
    """
    limit = available_memory() if limits.memory_limit is None else limits.memory_limit
    room = block_room(limits)

    def need(grid: Grid, solves: int | None = limits.max_solves) -> int:
        if affine or adaptive:
            labels = n_symbols + 1 if affine else 0
            sets = max(0, mask_bytes(n_symbols, in_force) - 8)
            return worst_case_rounds_memory(grid, test_points, labels, solves, adaptive, sets)
        return worst_case_memory(grid, test_points, n_symbols, solves, room, in_force)

    budget, least, worst = limits.max_memory, need(grid.at(0)), need(grid)
    if budget is not None and least > budget:
        raise ProblemError(
            f"`max_memory` must be at least the {least:,} bytes that level 0 may take; "
            f"got {budget:,}: {_fewer_partitions(grid, budget, need)}"
        )
    worst = worst if budget is None else min(worst, budget)
    if worst <= limit:
        return
    fits = max((k for k in range(grid.max_level) if need(grid.at(k)) <= limit), default=None)
    fewer = _fewer_partitions(grid, limit, need)
    advice = fewer if fits is None else f"max_level <= {fits} fits, or fewer `partitions`"
    if not (affine or adaptive) and least <= limit:
        advice += ', or leaves="affine"'
    solves = worst_case_solves(grid, test_points.interior(grid.n), adaptive)
    choices = range(1, min(solves, 2**40))
    most = bisect.bisect_right(choices, limit, key=lambda allowed: need(grid, allowed))
    most -= most % 10 ** (len(str(most)) - 1)  # its first digit
    enough = most >= test_points.in_block(grid.partitions)  # for level 0
    bound = f"`max_solves` (at most {most:,}) or " if enough else ""
    allowed = "available" if limits.memory_limit is None else "allowed by `memory_limit`"
    raise ProblemError(
        f"`max_level` {grid.max_level} may take {worst / 1e9:.3g} GB at worst "
        f"({solves:.3g} solves); {limit / 1e9:.3g} GB is {allowed}: {advice}, "
        f"or bound it with {bound}`max_memory`"
    )
