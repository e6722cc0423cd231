"""A grid of nodes over a box of states, and the memory that dynamic programming takes there."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.native.source import LANES

MOST_AXES = 4
"""Most states of a grid."""
USUAL = {1: 2000, 2: 400, 3: 100, 4: 40}
"""Intervals along each axis unless told, by the number of states."""
LARGEST = 2**31 - 2**20
"""Most entries of a row of values: they are counted by 32 bits."""


@dataclass(frozen=True)
class StateGrid:
    """Nodes at the ends of equal intervals along each axis of a box.

    On a periodic axis the last node is the first one again.

    Parameters
    ----------
    box : Box
        States from the first to the last node.
    counts : n ints
        Intervals along each axis.
    """

    box: Box
    counts: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Nodes along each axis."""
        return tuple(count + 1 for count in self.counts)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return int(np.prod(self.shape, dtype=float))

    @property
    def blocks(self) -> int:
        """Blocks of `LANES` nodes, the last of which is filled up."""
        return -(-self.nodes // LANES)

    @functools.cached_property
    def corners(self) -> np.ndarray:
        """Entries (2^n,) of the corners of an interval, first axis first, from its lower one."""
        strides = np.cumprod([1, *self.shape[:0:-1]])[::-1]
        bits = np.indices((2,) * len(strides)).reshape(len(strides), -1)
        return np.ascontiguousarray(strides @ bits, dtype=np.int32)

    @functools.cached_property
    def inner(self) -> np.ndarray:
        """Whether intervals (n, nodes) have another on either side along each axis, as 0 and 1."""
        places = np.indices(self.shape, dtype=np.int32).reshape(len(self.counts), -1)
        most = np.array(self.counts)[:, None] - 2
        return np.ascontiguousarray((places >= 1) & (places <= most), dtype=np.uint8)

    @property
    def nothing(self) -> int:
        """First of the entries of a row of values that stay 0, for states in the target."""
        return self.blocks * LANES

    @property
    def size(self) -> int:
        """Entries of a row of values."""
        return self.nothing + int(self.corners[-1]) + 1

    def states(self, first: int, last: int) -> np.ndarray:
        """Return the states (last - first, n) of nodes by number [state units]."""
        places = np.unravel_index(np.arange(first, min(last, self.nodes)), self.shape)
        return self.box.points(np.stack(places, axis=1), self.counts)

    def bytes(self, symbols: int, rows: int) -> int:
        """Return what dynamic programming takes, of so many symbols and rows of values."""
        n = len(self.counts)
        each = symbols * (8 + 4 * n) + (16 + 4 * n) * rows + 5 * n
        return int(each * (self.size if self.nodes < LARGEST else self.nodes))

    def text(self) -> str:
        """Return it in words."""
        return " x ".join(map(str, self.counts))

    def fitted(self, symbols: int, rows: int, limit: int) -> StateGrid | None:
        """Return the grid with the same proportions that fits a limit [bytes], None: none does."""
        shrink = 1.0
        while shrink > 1e-4:
            counts = tuple(max(2, int(count * shrink)) for count in self.counts)
            smaller = dataclasses.replace(self, counts=counts)
            if smaller.nodes < LARGEST and smaller.bytes(symbols, rows) <= limit:
                return smaller
            shrink *= 0.98
        return None

    def check(self, symbols: int, rows: int, limit: int) -> None:
        """Raise `ProblemError` where it does not fit a limit [bytes], naming one that does."""
        best = self.fitted(symbols, rows, limit)
        if best == self:
            return
        fits = "none would" if best is None else f"{best.text()} would"
        raise ProblemError(
            f"`counts` {self.text()} would take {self.bytes(symbols, rows) / 1e9:.3g} GB for "
            f"{symbols} symbols; of {limit / 1e9:.3g} GB, {fits} fit"
        )

    def widened(self, out: np.ndarray) -> StateGrid:
        """Return the grid with intervals added where loops left it.

        `out` (2, n) is how far beyond lower and upper faces [state units], 0 where not at all; they
        move out by half as much again, between a tenth and the whole of the box's width.
        """
        spacing = self.box.widths / self.counts
        wanted = np.clip(1.5 * out, 0.1 * self.box.widths, self.box.widths) * (out > 0)
        added = np.ceil(wanted / spacing - 1e-9).astype(int)
        lower, upper = self.box.lower - added[0] * spacing, self.box.upper + added[1] * spacing
        box = dataclasses.replace(self.box, lower=lower, upper=upper)
        return StateGrid(box, tuple((np.array(self.counts) + added.sum(axis=0)).tolist()))
