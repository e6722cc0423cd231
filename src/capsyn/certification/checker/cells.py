"""The loop and the cells that a proof of arrival is about, as the checker knows them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.certification.checker.bounds import Interval, bounds
from capsyn.certification.checker.flows import Flows
from capsyn.certification.checker.sets import SLACK, Tree, around, clip
from capsyn.errors import CertificateError
from capsyn.modelling.domain import Box
from capsyn.programs.program import Program

CHUNK, MOST_UNDER = 1 << 13, 1 << 24
CELL = 1e-10
"""Share of a cell by which states near a face are counted to both cells."""


@dataclass(frozen=True, eq=False)
class Claims:
    """The loop that a proof is about."""

    space: Box
    moving: int
    tree: Tree
    next: np.ndarray  # (R, L): label of each row after each in force, -1 none
    kinds: np.ndarray  # (L,)
    holds: np.ndarray  # (L,)
    layered: bool
    flow: Flows
    target: Program
    avoid: Program
    controls: np.ndarray  # (L, m)
    noise: np.ndarray  # (n,)
    period: float
    delay: float
    nearest: bool
    drifts: np.ndarray  # (L, L): labels of one control that come to different things

    def reach(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return how far from where they are states in boxes (B, n) may be measured, (B, n).

        Where periodic states turn, their turning is rounded, too.
        """
        space = self.space
        turns = ((low < space.lower) | (high >= space.upper)) & space.periodic
        size = np.maximum(np.abs(low), np.abs(high))
        size += np.where(turns, np.abs(space.lower) + np.abs(space.upper), 0.0)
        return self.noise + SLACK * size


def need(holds: Any, what: str, which: Any = None) -> None:
    """Raise where something does not hold, with the first number of what it does not hold of.

    Raises
    ------
    CertificateError
        Some of it does not hold.
    """
    bad = np.flatnonzero(~np.asarray(holds))
    if len(bad):
        raise CertificateError(what.format(bad[0] if which is None else which[bad[0]]))


def chunks(rows: np.ndarray, size: int = CHUNK) -> Iterator[np.ndarray]:
    """Yield rows, some at a time."""
    return (rows[k : k + size] for k in range(0, len(rows), size))


def spread(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers from first to last (B,), in turn, and which of B each is of."""
    count = np.maximum(last - first + 1, 0)
    of = np.repeat(np.arange(len(first)), count)
    return np.arange(len(of)) - np.repeat(np.cumsum(count) - count - first, count), of


def points_of(records: np.ndarray, n: int) -> np.ndarray:
    """Return the points (B, K, n) of records; those beyond their number are the last again."""
    points = records["v"].reshape(len(records), records["v"].shape[1] // n, n)
    if n != 2:
        return points
    last = np.minimum(np.arange(points.shape[1]), records["count"][:, None] - 1)
    return np.take_along_axis(points, last[:, :, None], axis=1)


def truth(program: Program, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where a program is surely not 0 over boxes (B, n), and where it may be."""
    ((value,), _) = bounds(program, [Interval(*ends) for ends in zip(low.T, high.T)])
    shape = len(low)
    surely, never = (value.low > 0) | (value.high < 0), (value.low == 0) & (value.high == 0)
    return np.broadcast_to(surely, shape), np.broadcast_to(~never, shape)


@dataclass(frozen=True, eq=False)
class Cells:
    """A grid of cells, in C order, and when each has arrived in each layer, by which wave."""

    lower: np.ndarray
    upper: np.ndarray
    counts: np.ndarray
    bound: np.ndarray  # (layers, K)
    wave: np.ndarray  # (layers, K): of the proof; -1 in the target

    def boxes(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends (B, n) of cells (B,) by number."""
        places = np.stack(np.unravel_index(cells, tuple(self.counts)), axis=1)
        width = (self.upper - self.lower) / self.counts
        high = np.where(places + 1 == self.counts, self.upper, self.lower + width * (places + 1))
        return self.lower + width * places, high

    def later(
        self, claims: Claims, points: np.ndarray, error: np.ndarray, layer: np.ndarray,
        wave: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Return when sets have arrived (B,), infinite where cells below were not proved before."""
        count, n = len(points), claims.space.n
        latest, width = np.zeros(count), (self.upper - self.lower) / self.counts
        low, high = around(points, error)
        if n == 2:  # slices of it, a column of cells each
            first, last = self._range(claims, 0, low[:, 0], high[:, 0], latest)
            column, of = spread(first, last)
            out = error[of] + SLACK * np.maximum(np.abs(low), np.abs(high))[of]
            face, parts = self.lower[0] + width[0] * column, points[of]
            alive = np.ones(len(of), bool)
            for sign, at in ((1.0, face + width[0] * (1 + CELL)), (-1.0, width[0] * CELL - face)):
                a = np.zeros((len(of), 2))
                a[:, 0] = sign
                parts, some = clip(parts, a, at + out[:, 0])
                alive &= some
            low, high = (x[alive] for x in around(parts, out))
            of, pairs = of[alive], [column[alive]]
        else:
            of, pairs = np.arange(count), []
        for axis in range(len(pairs), n):
            missed = np.zeros(len(of))
            first, last = self._range(claims, axis, low[:, axis], high[:, axis], missed)
            np.maximum.at(latest, of, missed)
            first, last = np.where(missed > 0, 0, first), np.where(missed > 0, -1, last)
            place, more = spread(first, last)
            of, low, high = of[more], low[more], high[more]
            pairs = [*(x[more] for x in pairs), place]
            need([len(of) <= MOST_UNDER], "a piece has too many cells under it")
        cell = np.zeros(len(of), dtype=np.int64)
        for axis, place in enumerate(pairs):
            cell = cell * self.counts[axis] + place % self.counts[axis]
        time = self.bound[layer[of], cell]
        time = np.where(self.wave[layer[of], cell] < wave[of], time, np.inf)
        np.maximum.at(latest, of, time)
        return latest

    def _range(
        self, claims: Claims, axis: int, low: np.ndarray, high: np.ndarray, latest: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the first and last cell (B,) along an axis; `latest` is infinite beyond the grid.

        States beyond the domain are none, unless the rule there is that of the nearest cell.
        """
        space, count = claims.space, self.counts[axis]
        width = (self.upper[axis] - self.lower[axis]) / count
        first = np.floor((low - self.lower[axis]) / width - CELL)
        last = np.floor((high - self.lower[axis]) / width + CELL)
        periodic, lost = space.periodic[axis], ~(np.maximum(np.abs(first), np.abs(last)) < 1e9)
        first, last = (np.where(lost, 0, x).astype(np.int64) for x in (first, last))
        if periodic and self.upper[axis] - self.lower[axis] >= space.widths[axis]:
            lost |= last - first >= MOST_UNDER
        else:
            if not periodic and not claims.nearest:
                if self.lower[axis] <= space.lower[axis]:
                    first = np.maximum(first, 0)
                if self.upper[axis] >= space.upper[axis]:
                    last = np.minimum(last, count - 1)
            lost |= (first < 0) | (last >= count) | (first > last)
        latest[lost] = np.inf
        return np.where(lost, 0, first), np.where(lost, -1, last)


def check_twins(claims: Claims, cells: Cells, twins: np.ndarray) -> None:
    """Refuse layers of cells that are said to come to the same as others, and may not."""
    layer, cell = np.nonzero(twins != np.arange(len(twins))[:, None])
    if not len(layer):
        return
    need([claims.delay == 0 and not (claims.holds > 1).any()], "layers differ by holds or delay")
    same = cells.bound[layer, cell] == cells.bound[twins[layer, cell], cell]
    need(same, "layers of cell {} have two bounds", cell)
    some = np.unique(cell)
    low, high = cells.boxes(some)
    if claims.noise.any():
        low, high = low - claims.reach(low, high), high + claims.reach(low, high)
    else:  # half-open
        high = np.nextafter(high, -np.inf)
    box, leaf, _ = claims.tree.under(low, high)
    order = np.argsort(box, kind="stable")
    row, first = claims.tree.row[leaf[order]], np.searchsorted(box[order], np.arange(len(some) + 1))
    at = np.searchsorted(some, cell)
    pair, of = spread(first[at], first[at + 1] - 1)
    same = claims.next[row[pair], layer[of]] == claims.next[row[pair], twins[layer, cell][of]]
    need(same, "layers of cell {} do not come to the same", cell[of])
