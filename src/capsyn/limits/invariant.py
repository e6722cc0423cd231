"""The largest set of cells from which a sampled loop can keep its limits, by enclosures.

A label may be taken in a cell where limits are kept all along the tube of the cell under it, from
the sample to the next at which another may be taken, and every cell that the end touches is in the
set. The set is what is left when cells without such a label have been struck out, round by round.
Cells are closed here, so that a state on a face, which belongs to the upper cell, is in both.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.execution.memory import check_memory
from capsyn.limits.tubes import Flow
from capsyn.modelling.domain import Box
from capsyn.programs.ends import Interval

PARTS = 64
"""Most parts that a least time is followed in."""
Part = tuple[int, float, int]
"""A label, how long it acts [time unit], and the steps in which that is followed."""


@dataclass(frozen=True)
class LimitedLoop:
    """A sampled loop whose limits are to be kept, and the cells in which that is asked for."""

    flow: Flow
    limits: Callable[..., list[Interval]]  # bounds of the limits over boxes of readings
    space: Box  # of states, and of exogenous inputs, which stay, after them
    told: int  # number of these
    counts: tuple[int, ...]  # cells along each axis
    controls: np.ndarray  # (L, m): of the symbols, and of the default last [input units]
    candidates: int  # labels that may be taken: the first so many
    period: float  # sample time [time unit]
    samples: np.ndarray  # (L,) ints >= 1: for how many each is held once entered
    delay: float = 0.0  # of the input, at most the sample time [time unit]
    forbidden: np.ndarray | None = None  # (L, L) from each to each; None: nothing is in force
    parameters: Interval | None = None

    @property
    def layers(self) -> int:
        """Labels in force that sets are told apart by: 1 where that does not matter."""
        return 1 if self.forbidden is None else len(self.controls)

    @property
    def cells(self) -> int:
        """Number of cells."""
        return math.prod(self.counts)

    def boxes(self, cells: np.ndarray) -> Interval:
        """Return the cells (A,), in C order, as boxes (n, A)."""
        axes = list(enumerate(np.unravel_index(cells, self.counts)))
        lower = [self.space.faces(i, steps, self.counts[i]) for i, steps in axes]
        upper = [self.space.faces(i, steps + 1, self.counts[i]) for i, steps in axes]
        return np.stack(lower), np.stack(upper)

    def period_of(self, before: int, label: int) -> list[Part]:
        """Return what acts from a sample at which a label is taken to the next."""
        late = self.delay if before != label else 0.0
        parts = [(before, late, 1), (label, self.period - late, 1)]
        return [part for part in parts if part[1] > 0]

    def followed(
        self, box: Interval, parts: Sequence[Part], inside: bool = False
    ) -> tuple[np.ndarray, Interval]:
        """Return the largest limit (A,) on the way from boxes (n, A) under labels, and the ends.

        It is infinite where nothing is known, and where loops that are to stay `inside` the domain
        may leave it, or go round farther than a period.
        """
        count = box[0].shape[1]
        worst = np.full(count, -np.inf)
        for label, duration, steps in parts:
            control = np.repeat(self.controls[label][:, None], count, axis=1)
            tubes = self.flow.tubes(*box, control, duration, self.parameters, steps)
            worst = np.maximum(worst, self.bound(tubes.lower, tubes.upper))
            worst[self._beyond(tubes.lower, tubes.upper, inside)] = np.inf
            box = tubes.end_lower, tubes.end_upper
        return worst, box

    def _beyond(self, lower: np.ndarray, upper: np.ndarray, inside: bool) -> np.ndarray:
        """Return which boxes (n, B) leave the domain, or go a whole period beyond it."""
        own = slice(self.space.n - self.told)
        reach = np.where(self.space.periodic, self.space.widths, 0.0 if inside else np.inf)
        low, high = (self.space.lower - reach)[own, None], (self.space.upper + reach)[own, None]
        return np.asarray(((lower[own] < low) | (upper[own] > high)).any(axis=0))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Return the largest limit (B,) in boxes (n, B); infinite where it is not known.

        What leaves the domain along a periodic axis counts as it is, and brought back into it, too:
        limits may not have its period.
        """
        space, worst = self.space, self._largest(lower, upper)
        around = np.flatnonzero(space.periodic)
        low, high = (end[around, None] for end in (space.lower, space.upper))
        leaves = (lower[around] < low) | (upper[around] > high)
        some = np.flatnonzero(leaves.any(axis=0) & np.isfinite(worst))
        if not len(some):
            return worst
        turn, most = high - low, worst[some]
        for shifts in itertools.product((-1, 0, 1), repeat=len(around)):
            shift = np.array(shifts)[:, None] * turn
            box = lower[:, some].copy(), upper[:, some].copy()
            box[0][around] = np.maximum(np.nextafter(box[0][around] + shift, -np.inf), low)
            box[1][around] = np.minimum(np.nextafter(box[1][around] + shift, np.inf), high)
            full = upper[around][:, some] - lower[around][:, some] >= turn
            for end, whole in zip(box, (low, high)):
                end[around] = np.where(full, whole, end[around])
            there = (box[0] <= box[1]).all(axis=0)
            most[there] = np.maximum(most[there], self._largest(*(end[:, there] for end in box)))
        worst[some] = most
        return worst

    def _largest(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Return `bound` of boxes as they are."""
        ((_, most),) = self.limits((lower, upper))
        return np.asarray(np.where(np.isnan(most).any(axis=0), np.inf, most.max(axis=0)))


@dataclass(frozen=True)
class Viable:
    """What can be kept; C cells in C order, J layers, S labels that may be taken."""

    within: np.ndarray  # (C,) bool: where limits hold throughout the cell
    kept: np.ndarray  # (J, C) bool: from where they can be kept for ever
    allowed: np.ndarray  # (J, S, C) bool: which labels may be taken for that
    rounds: int


@dataclass(frozen=True)
class _Ends:
    """Where a label leads: the cells of a layer that must all be in the set."""

    layer: int
    corners: np.ndarray  # (2^n, A) int32: places in the table of sums
    volumes: np.ndarray  # (A,) int32 [cells]

    def where(self, some: np.ndarray) -> _Ends:
        return _Ends(self.layer, self.corners[:, some], self.volumes[some])


@dataclass(frozen=True)
class _Move:
    """A label, and cells from which it keeps limits, and stays in the domain, whatever follows."""

    label: int
    layers: tuple[int, ...]  # labels in force from which it may be taken
    cells: np.ndarray  # (A,) int64
    ends: tuple[_Ends, ...]

    def where(self, some: np.ndarray) -> _Move:
        ends = tuple(end.where(some) for end in self.ends)
        return _Move(self.label, self.layers, self.cells[some], ends)


def viable(loop: LimitedLoop) -> Viable:
    """Return the largest set of cells from which the limits of a loop can be kept for ever."""
    n, count, layers = loop.space.n, loop.cells, loop.layers
    pairs = layers * loop.candidates if loop.delay else layers + loop.candidates
    check_memory(float(count) * pairs * (12 * 2**n + 48 * n), "the set of cells that keep limits")
    within = loop.bound(*loop.boxes(np.arange(count))) <= 0
    moves = _moves(loop, np.flatnonzero(within))
    kept, rounds = _reached(moves, layers, count), 0
    while True:
        rounds += 1
        sums = [_sums(loop, layer) for layer in kept]
        stay = [_inside(move, sums) for move in moves]
        if all(some.all() for some in stay):
            break
        moves = [move.where(some) for move, some in zip(moves, stay)]
        kept = _reached(moves, layers, count)
    allowed = np.zeros((layers, loop.candidates, count), dtype=bool)
    for move in moves:
        for layer in move.layers:
            allowed[layer, move.label, move.cells] = True
    return Viable(within, kept, allowed, rounds)


def _moves(loop: LimitedLoop, cells: np.ndarray) -> list[_Move]:
    """Return all moves from cells (A,), whatever follows."""
    labels = range(len(loop.controls))
    moves: list[_Move] = []
    for label in range(loop.candidates):
        if loop.forbidden is None:
            moves.append(_move(loop, cells, label, label, (0,), 0))
            continue
        moves.append(_move(loop, cells, label, label, (label,), label))
        others = [j for j in labels if j != label and not loop.forbidden[j, label]]
        groups = [(j,) for j in others] if loop.delay else [tuple(others)]
        moves += [_move(loop, cells, j[0], label, j, label) for j in groups if j]
    return moves


def _move(
    loop: LimitedLoop,
    cells: np.ndarray,
    before: int,
    label: int,
    layers: tuple[int, ...],
    into: int,
) -> _Move:
    """Return the move to a label while another, or itself, is in force.

    A label that is in force is free to change at the next sample; one that is entered when it has
    been held. Where nothing is in force, or another has the same control, either may be so.
    """
    worst, box = loop.followed(loop.boxes(cells), loop.period_of(before, label))
    some, first = _ends(loop, cells, box, into)
    some &= worst <= 0
    entered, more = loop.forbidden is None or before != label, int(loop.samples[label]) - 1
    if not entered or not more:
        return _Move(label, layers, cells[some], (first.where(some),))
    rest = [(label, more * loop.period, min(more, PARTS))]
    worst, box = loop.followed(box, rest, inside=True)  # a loop is asked meanwhile, too
    there, last = _ends(loop, cells, box, into)
    some &= there & (worst <= 0)
    alike = (loop.controls == loop.controls[label]).all(axis=1).sum() > 1
    ends = (first, last) if loop.forbidden is None or alike else (last,)
    return _Move(label, layers, cells[some], tuple(end.where(some) for end in ends))


def _table_shape(loop: LimitedLoop) -> tuple[int, ...]:
    """Return the shape of a table of sums: a periodic axis is there twice."""
    turns = np.where(loop.space.periodic, 2, 1)
    return tuple(int(k) for k in turns * loop.counts + 1)


def _ends(
    loop: LimitedLoop, cells: np.ndarray, box: Interval, layer: int
) -> tuple[np.ndarray, _Ends]:
    """Return which end boxes (n, A) are in the domain, (A,), and the cells that they touch."""
    space, counts, told = loop.space, loop.counts, loop.told
    lower, upper = box
    some = np.asarray(np.isfinite(box).all(axis=(0, 1)))
    states = np.arange(space.n - told)
    for i in states:
        if not space.periodic[i]:
            some &= (lower[i] >= space.lower[i]) & (upper[i] <= space.upper[i])
    safe = [np.where(some, end, space.lower[:, None]) for end in (lower, upper)]
    first, last = (space.locate(end.T, counts).T for end in safe)
    if told:  # exogenous inputs stay in their cell
        own = np.stack(np.unravel_index(cells, counts))[-told:]
        first[-told:], last[-told:] = own, own
    for i in states[list(space.periodic[: len(states)])]:
        around = safe[1][i] - safe[0][i] > 0.5 * space.widths[i]
        last[i] += np.where(last[i] < first[i], counts[i], 0)
        first[i, around], last[i, around] = 0, counts[i] - 1
    volumes = np.prod(last - first + 1, axis=0).astype(np.int32)
    shape = _table_shape(loop)
    ways = zip(first, last + 1)
    corners = [np.ravel_multi_index(corner, shape) for corner in itertools.product(*ways)]
    return some, _Ends(layer, np.array(corners, dtype=np.int32), volumes)


def _sums(loop: LimitedLoop, kept: np.ndarray) -> np.ndarray:
    """Return how many cells of a set (C,) lie below every corner, flat."""
    table = np.zeros(_table_shape(loop), dtype=np.int32)
    inner = kept.reshape(loop.counts)
    for i in np.flatnonzero(loop.space.periodic):
        inner = np.concatenate([inner, inner], axis=i)
    table[(slice(1, None),) * inner.ndim] = inner
    for axis in range(inner.ndim):
        np.cumsum(table, axis=axis, out=table)
    return table.ravel()


def _inside(move: _Move, sums: Sequence[np.ndarray]) -> np.ndarray:
    """Return whether all cells that the ends of a move touch are in the sets, (A,)."""
    inside = np.ones(len(move.cells), dtype=bool)
    for end in move.ends:
        table, total = sums[end.layer], np.zeros(len(move.cells), dtype=np.int32)
        for k, corner in enumerate(end.corners):  # in the order of itertools.product
            added = (len(end.corners) - 1 - k).bit_count() % 2 == 0
            total += table[corner] if added else -table[corner]
        inside &= total == end.volumes
    return inside


def _reached(moves: Sequence[_Move], layers: int, count: int) -> np.ndarray:
    """Return in which cells (J, C) some move is left."""
    kept = np.zeros((layers, count), dtype=bool)
    for move in moves:
        for layer in move.layers:
            kept[layer, move.cells] = True
    return kept
