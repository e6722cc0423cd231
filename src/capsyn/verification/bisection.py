"""Bisects boxes until bounds tell the sign of a function in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Bounds = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[Any, Any]]
"""Corners (n, B) twice and cells (B,) to bounds (B,) of the function, NaN where it is undefined."""

SLENDER = 4
"""A box may be this much thinner on one axis than on another, in widths of its cell."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """Closed boxes that are parts of cells, with bounds of a function."""

    lower: np.ndarray  # (n, B) corners
    upper: np.ndarray
    cells: np.ndarray  # (B,) ints: which cell each is a part of
    shares: np.ndarray  # (B,) of the whole volume
    low: np.ndarray  # (B,) bounds of the function; both NaN where it may be undefined
    high: np.ndarray

    @property
    def proved(self) -> np.ndarray:
        """Where the function is nowhere positive, (B,)."""
        return self.high <= 0

    @property
    def negative(self) -> np.ndarray:
        """Where it is negative everywhere, (B,)."""
        return self.high < 0

    @property
    def violated(self) -> np.ndarray:
        """Where it is positive everywhere, (B,)."""
        return self.low > 0

    @property
    def undecided(self) -> np.ndarray:
        """Where neither is known, (B,)."""
        return ~(self.proved | self.violated)

    @property
    def unsettled(self) -> np.ndarray:
        """Undecided, or proved with parts that may yet turn out negative, (B,)."""
        zero = (self.low == 0) & (self.high == 0)
        return ~(self.negative | self.violated | zero)

    @property
    def middle(self) -> np.ndarray:
        """Their middles, (n, B)."""
        return self.lower + (self.upper - self.lower) / 2

    @property
    def divisible(self) -> np.ndarray:
        """Axes on which halves are halves in spite of rounding, (n, B)."""
        size = np.maximum(np.abs(self.lower), np.abs(self.upper))
        return self.upper - self.lower > 64 * np.spacing(size)

    def take(self, where: np.ndarray) -> Boxes:
        """Return some of the boxes."""
        return Boxes(*(values[..., where] for values in self._arrays()))

    def _arrays(self) -> list[np.ndarray]:
        return [getattr(self, f.name) for f in dataclasses.fields(self)]

    @staticmethod
    def joined(parts: Sequence[Boxes]) -> Boxes:
        """Return the boxes of several in one."""
        arrays = zip(*(part._arrays() for part in parts))
        return Boxes(*(np.concatenate(values, axis=-1) for values in arrays))


def bisect(
    bounds: Bounds,
    lower: np.ndarray,
    upper: np.ndarray,
    shares: np.ndarray,
    depth: int,
    max_boxes: int,
) -> Boxes:
    """Return parts that make up the cells, as few as it takes to know the function's sign.

    The cells have corners (n, K) and shares (K,) of the whole volume. A cell is bisected `depth`
    times at most, and `max_boxes` parts at most are made in one round; where that is too few,
    undecided boxes are bisected before proved ones, and large ones before small ones.
    """
    cells = np.arange(len(shares))
    boxes = Boxes(lower, upper, cells, shares, *bounds(lower, upper, cells))
    widths, done = upper - lower, []
    for _ in range(depth):
        busy = np.flatnonzero(boxes.unsettled & boxes.divisible.any(axis=0))
        if 2 * len(busy) > max_boxes:
            rank = np.lexsort((-boxes.shares[busy], ~boxes.undecided[busy]))
            busy = np.sort(busy[rank[: max_boxes // 2]])
        idle = np.ones(len(boxes.cells), dtype=bool)
        idle[busy] = False
        done.append(boxes.take(idle))
        boxes = boxes.take(busy)
        boxes = _halves(bounds, boxes, (boxes.upper - boxes.lower) / widths[:, boxes.cells])
        if not len(busy):
            break
    return Boxes.joined([*done, boxes])


def _halves(bounds: Bounds, boxes: Boxes, sizes: np.ndarray) -> Boxes:
    """Return the halves (2 B) of boxes with sizes (n, B), each cut on the axis that decides most.

    That is the axis with the fewest undecided halves, then with the fewest unsettled ones, then one
    that has not been cut much more often than others, then with the tightest upper bounds. Bounds
    alone would cut one axis for ever where the function is even in another.
    """
    n, count = boxes.lower.shape
    middle, divisible = boxes.middle, boxes.divisible
    cells, shares = np.tile(boxes.cells, 2), np.tile(boxes.shares / 2, 2)
    tries, keys = [], []
    for axis in range(n):
        lower, upper = np.tile(boxes.lower, 2), np.tile(boxes.upper, 2)
        lower[axis, count:] = upper[axis, :count] = middle[axis]
        halves = Boxes(lower, upper, cells, shares, *bounds(lower, upper, cells))
        tries.append(halves)
        bound, unsettled, undecided = (  # a bound that is NaN comes last
            values.reshape(2, count).sum(axis=0, dtype=float)
            for values in (halves.high, halves.unsettled, halves.undecided)
        )
        slender = sizes[axis] * SLENDER < sizes.max(axis=0)
        keys.append([bound, slender, unsettled, np.where(divisible[axis], undecided, np.inf)])
    chosen = np.lexsort(np.stack(keys, axis=1), axis=0)[0]
    result = tries[0]
    for axis in range(1, n):
        better = np.tile(chosen == axis, 2)
        pairs = zip(tries[axis]._arrays(), result._arrays())
        result = Boxes(*(np.where(better, one, two) for one, two in pairs))
    return result
