"""Splits across one coordinate each that part unlike states and leave like ones together.

What is looked at are pairs of neighbouring states. Unlike an entropy this sees laws like XOR, whose
splits gain nothing by volume; and a length means the same for any feature, whatever its gradient.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsyn.compression.fitted.surface import Plane


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of neighbouring states, by the coordinates of both ends, (P, D) each."""

    one: np.ndarray
    other: np.ndarray
    unlike: np.ndarray  # (P,) bool: whether no label is right at both ends

    def __len__(self) -> int:
        return len(self.unlike)

    def part(self, rows: np.ndarray) -> Pairs:
        """Return some of the pairs."""
        return Pairs(self.one[rows], self.other[rows], self.unlike[rows])

    def beside(self, coordinate: int, threshold: float) -> tuple[Pairs, Pairs]:
        """Return the pairs that lie before a threshold and beyond it as a whole."""
        ends = [x[:, coordinate] >= threshold for x in (self.one, self.other)]
        return self.part(~ends[0] & ~ends[1]), self.part(ends[0] & ends[1])


def best_split(pairs: Pairs, cut_penalty: float) -> tuple[int, float] | None:
    """Return the coordinate and the threshold that part most unlike pairs and fewest like ones.

    A like pair that is parted counts `cut_penalty` against an unlike one. None: no coordinate
    parts any unlike pair.
    """
    low, high = np.minimum(pairs.one, pairs.other), np.maximum(pairs.one, pairs.other)
    best: tuple[float, int, float] | None = None
    for k in range(low.shape[1]):
        a, b = low[:, k], high[:, k]
        places = np.unique(a[pairs.unlike & (a < b)])
        if not len(places):
            continue
        parted = []
        for chosen in (pairs.unlike, ~pairs.unlike):
            begun = np.searchsorted(np.sort(a[chosen]), places, side="right")
            parted.append(begun - np.searchsorted(np.sort(b[chosen]), places, side="right"))
        gain = parted[0] - cut_penalty * parted[1]
        i = int(np.argmax(gain))
        if best is None or gain[i] > best[0]:
            ends = np.unique(np.concatenate([a, b]))
            after = ends[np.searchsorted(ends, places[i], side="right")]
            best = float(gain[i]), k, float((places[i] + after) / 2)
    return best[1:] if best else None


def across(coordinate: int, threshold: float, count: int = 0) -> Plane:
    """Return the plane across one of `count` coordinates, at least those before, at a threshold."""
    return np.eye(max(count, coordinate + 1))[coordinate], threshold
