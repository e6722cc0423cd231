"""Arrival: cells from which every loop gets into the target, proved one after the other."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.native.bounds import box_bounds
from capsyn.programs.program import Program
from capsyn.reach.kernel import PROVED, Cells, Followed, Follower
from capsyn.reach.loop import SampledLoop
from capsyn.reach.twins import twin_layers

EASY, EFFORT = 300, 20_000
"""Most pieces that flow for a start. What is behind a start that is not proved is hard, too: so the
first of a sweep get all of the effort, until more of it was in vain than was not, by `VAIN`."""
VAIN = 200_000
WAVES = 100
LEAST_WAVE = 32
"""Parts of a sweep, and the least starts of one: those of a wave may end in cells of the waves
before it, whatever the threads do."""
MOST_BISECTIONS = 4
"""Of a start that is not proved as a whole."""
LITTLE = 0.9
"""Share of a sweep's starts that are left where the next is not worth its work."""
CLOSED = 1e-12
"""Share of a cell's width by which one that has its upper face is wider."""
NOT_TRIED = -1


@dataclass(frozen=True, eq=False)
class Wave:
    """Starts that were proved together: boxes (B, n), their labels in force, cells and effort."""

    lower: np.ndarray
    upper: np.ndarray
    held: np.ndarray
    cells: np.ndarray
    bound: np.ndarray  # (B,) [time unit]
    work: int  # pieces that flowed
    effort: int  # most for a start


@dataclass(frozen=True, eq=False)
class Arrival:
    """What is proved to arrive."""

    bound: np.ndarray  # (layers, K): time by which a cell has [time unit], infinite where unproved
    share: np.ndarray  # (K,): of the starts in each cell, the default in force
    within: np.ndarray  # (K,): time by which they have, infinite where not all of a cell have
    latest: float  # time by which all that are proved have [time unit]
    status: np.ndarray  # (K,): why the rest is not, into `STATUS`, or `NOT_TRIED`
    waves: list[Wave]  # in the order of the proof
    twins: np.ndarray  # (layers, K): the first layer of a cell that comes to the same
    stopped: bool


def inside(program: Program, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which boxes (B, n) are surely, and which may be, where a program is not 0."""
    ends = tuple(np.ascontiguousarray(end.T) for end in (lower, upper))
    ((low, high),) = box_bounds(program)(ends)
    surely = (low[0] > 0) | (high[0] < 0)
    never = (low[0] == 0) & (high[0] == 0)
    return surely, ~never


def in_target(loop: SampledLoop, cells: Cells) -> np.ndarray:
    """Return which cells (K,) are wholly in the target, and not in what is to be avoided."""
    lower, upper = cells.boxes(np.arange(cells.total))
    surely, _ = inside(loop.target, lower, upper)
    _, avoided = inside(loop.avoid, lower, upper)
    return surely & ~avoided


def arrive(
    follower: Follower, when: np.ndarray, starts: np.ndarray, box: tuple[np.ndarray, np.ndarray],
    deadline: float, patient: bool = True,
) -> Arrival | None:  # fmt: skip
    """Return which cells are proved to arrive.

    Without patience, None where much was in vain: smaller cells may do better.

    Parameters
    ----------
    follower : Follower
        Of the loop and the grid.
    when : (K,)
        When a simulated loop arrives from the middle of each cell [time unit], infinite where not:
        the order of the proof.
    starts : (K,)
        Share of each cell in the initial set.
    box : (n,), (n,)
        Box around that set.
    deadline : float
        When to stop, as `time.monotonic` counts [s].
    """
    proof = _Proof(follower, starts, box[1], deadline)
    try:
        proof.sweep_all(when, patient)
        if proof.stuck:
            return None
        proof.bisect_open(when, box)
        stopped = proof.late
    except KeyboardInterrupt:
        stopped = True
    latest = proof.within[(proof.share > 0) & (starts > 0)].max(initial=-np.inf)
    proof.within[proof.share < 1] = np.inf
    return Arrival(
        follower.bound.copy(),
        proof.share,
        proof.within,
        latest,
        proof.status,
        proof.waves,
        proof.twins,
        stopped,
    )


class _Proof:
    def __init__(
        self, follower: Follower, starts: np.ndarray, end: np.ndarray, deadline: float
    ) -> None:
        self.follower, self.starts, self.deadline = follower, starts, deadline
        self.loop, self.cells = follower.loop, follower.cells
        self.twins = twin_layers(self.loop, self.cells)
        self.waves: list[Wave] = []
        self.stuck = False
        self.lower, self.upper = self.cells.boxes(np.arange(self.cells.total))
        self.status = np.full(self.cells.total, NOT_TRIED)
        self.share, self.within = np.zeros(self.cells.total), np.full(self.cells.total, np.inf)
        # cells are half-open; one where the starts end has its upper face, too
        space, reach = self.loop.space, CLOSED * self.cells.widths
        last = (np.abs(self.upper - end) <= reach) & (self.upper < space.upper)
        self.upper = np.where(last, self.upper + reach, self.upper)
        self.end = np.where(end < space.upper, end + reach, end)
        surely = in_target(self.loop, self.cells)
        follower.bound[:, surely] = 0.0
        self._count(np.flatnonzero(surely))

    @property
    def late(self) -> bool:
        return time.monotonic() > self.deadline

    def _count(self, cells: np.ndarray) -> None:
        """Count whole cells that are proved, the default in force."""
        bound = self.follower.bound[self.loop.first, cells]
        won = np.isfinite(bound)
        self.share[cells[won]] = 1.0
        self.within[cells[won]] = bound[won]
        self.status[cells[won]] = PROVED

    def sweep_all(self, when: np.ndarray, patient: bool) -> None:
        """Prove whole cells, all layers of each, in the order of their simulated arrival."""
        layer, cell = np.nonzero(self.twins == np.arange(self.loop.layers)[:, None])
        hopeless = ~np.isfinite(when[cell])
        order = np.lexsort((layer, cell, when[cell]))
        order = order[~hopeless[order]]
        layer, cell = layer[order], cell[order]
        while not self.late:
            todo = ~np.isfinite(self.follower.bound[layer, cell])
            self._sweep(cell[todo], layer[todo], patient)
            if self.stuck:
                return
            left = todo & ~np.isfinite(self.follower.bound[layer, cell])
            if left.sum() >= LITTLE * todo.sum():  # few were won: another sweep would win fewer
                return

    def _sweep(self, cell: np.ndarray, layer: np.ndarray, patient: bool) -> None:
        gain = VAIN
        for part in _parts(len(cell)):
            self.stuck = gain < 0 and not patient
            if self.late or self.stuck:
                return
            some, held = cell[part], self._held(layer[part])
            effort = np.where((gain > 0) & (self.starts[some] > 0), EFFORT, EASY)
            found = self.follow(self.lower[some], self.upper[some], held, some, effort)
            first = layer[part] == self.twins[self.loop.first, some]
            self.status[some[first]] = found.status[first]
            won = found.status == PROVED
            gain += int(np.where(won, found.work, -found.work).sum())
            bound = self.follower.bound
            for own in range(self.loop.layers):  # and the layers that come to the same
                same = won & (self.twins[own, some] == layer[part])
                bound[own, some[same]] = found.bound[same]
            self._count(some)

    def _held(self, layer: np.ndarray) -> np.ndarray:
        return layer if self.loop.layered else np.full_like(layer, self.loop.labels - 1)

    def follow(
        self, lower: np.ndarray, upper: np.ndarray, held: np.ndarray, cells: np.ndarray, effort: Any
    ) -> Followed:
        """Follow a wave, and keep what of it is proved."""
        found = self.follower.follow(lower, upper, held, effort)
        won = found.status == PROVED
        if won.any():
            kept = (lower[won], upper[won], held[won], cells[won], found.bound[won])
            self.waves.append(Wave(*kept, int(found.work[won].sum()), int(np.max(effort))))
        return found

    def bisect_open(self, when: np.ndarray, box: tuple[np.ndarray, np.ndarray]) -> None:
        """Prove parts of what is open of the initial set, the default in force."""
        cell = np.flatnonzero((self.starts > 0) & (self.share < 1) & np.isfinite(when))
        cell = cell[np.argsort(when[cell], kind="stable")]
        lower = np.maximum(self.lower[cell], box[0])
        upper = np.minimum(self.upper[cell], self.end)
        whole = (lower == self.lower[cell]).all(axis=1) & (upper == self.upper[cell]).all(axis=1)
        self.within[cell] = 0.0
        part = np.ones(len(cell))
        for depth in range(MOST_BISECTIONS + 1):
            if depth:  # both halves, across the longest side
                cell, part = np.repeat(cell, 2), np.repeat(part / 2, 2)
                lower, upper = _halves(lower, upper, self.cells.widths)
            tried = np.ones(len(cell), bool) if depth else ~whole
            left = ~tried
            for some in _parts(len(cell)):
                if self.late:
                    break
                left[some] |= ~self._prove_parts(
                    lower[some], upper[some], cell[some], part[some], tried[some]
                )
            if self.late or not left.any():
                break
            cell, part, lower, upper = (x[left] for x in (cell, part, lower, upper))

    def _prove_parts(
        self, lower: np.ndarray, upper: np.ndarray, cell: np.ndarray, part: np.ndarray,
        tried: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Return which of parts of cells are proved, and count them."""
        held = np.full(int(tried.sum()), self.loop.labels - 1)
        won = np.zeros(len(cell), bool)
        if len(held):
            some = cell[tried]
            found = self.follow(lower[tried], upper[tried], held, some, EFFORT // 4)
            won[tried] = ok = found.status == PROVED
            np.add.at(self.share, some[ok], part[won])
            np.maximum.at(self.within, some[ok], found.bound[ok])
            self.status[some[~ok]] = found.status[~ok]
        return won


def _parts(count: int) -> Iterator[slice]:
    size = max(LEAST_WAVE, -(-count // WAVES))
    return (slice(k, k + size) for k in range(0, count, size))


def _halves(
    lower: np.ndarray, upper: np.ndarray, widths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return both halves of boxes (B, n), one after the other, cut across their longest side."""
    axis = ((upper - lower) / widths).argmax(axis=1)
    every = np.arange(len(lower))
    middle = (lower[every, axis] + upper[every, axis]) / 2
    lows, highs = np.repeat(lower, 2, axis=0), np.repeat(upper, 2, axis=0)
    highs[2 * every, axis] = middle
    lows[2 * every + 1, axis] = middle
    return lows, highs
