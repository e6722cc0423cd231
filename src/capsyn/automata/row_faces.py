"""Which symbols may be in force on the two sides of a face, and which switches crossing it makes.

In a cell with row ``T(j)`` a loop that comes with j in force takes T(j), then T(T(j)), and so on,
at once: time is continuous, and no least time is waited for. What it comes to at last is resident
there. Of a constant row that is its one symbol.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from capsyn.cells.boxes import ragged
from capsyn.policies.in_force import reachable
from capsyn.policies.policy import Policy


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of a policy, R of M labels, and what they come to."""

    next: np.ndarray  # (R, M): the label that follows each label in force
    last: np.ndarray  # (R, M): what it comes to, of labels that take turns for ever one of them
    resident: np.ndarray  # (R, M): labels that it may come to, of those that may be in force

    @staticmethod
    def of(policy: Policy) -> Rows:
        """Return those of a policy without oblique splits or affine leaves."""
        rows = policy.transitions
        last, steps = rows, 1
        while steps < rows.shape[1]:
            last, steps = np.take_along_axis(last, last, axis=1), 2 * steps
        resident = np.zeros(rows.shape, dtype=bool)
        labels = np.append(reachable(policy), rows.shape[1] - 1)
        np.put_along_axis(resident, last[:, labels], True, axis=1)
        while True:  # labels that take turns for ever are resident, each of them
            row, label = np.nonzero(resident)
            after = rows[row, label]
            if resident[row, after].all():
                break
            resident[row, after] = True
        return Rows(rows, last, resident)

    @property
    def weights(self) -> np.ndarray:
        """Share (R,) of each resident label, were all equally likely."""
        return 1 / np.maximum(self.resident.sum(axis=1), 1)

    def residents(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the resident labels of rows (K,): places (L,) in these, and labels (L,)."""
        row, label = np.nonzero(self.resident)
        counts = np.bincount(row, minlength=len(self.next))
        place, within = ragged(counts[numbers])
        return place, label[(np.cumsum(counts) - counts)[numbers][place] + within]

    def hops(self, numbers: np.ndarray, labels: np.ndarray) -> Iterator[tuple[np.ndarray, ...]]:
        """Yield the switches that labels (K,) make in cells of rows (K,), one after the other.

        They are places (L,) in these, and the labels (L,) from and to.
        """
        places, last = np.arange(len(labels)), self.last[numbers, labels]
        for _ in range(self.next.shape[1]):
            after = self.next[numbers, labels]
            moves = after != labels
            places, numbers, labels, after = (x[moves] for x in (places, numbers, labels, after))
            if not len(places):
                return
            yield places, labels, after
            on = after != last[places]
            places, numbers, labels = places[on], numbers[on], after[on]


@dataclass(frozen=True, eq=False)
class Sides:
    """Faces between cells of two rows, once for each pair of labels that may meet there, E in all.

    Upwards the label below is in force, and crossing the face comes to that above; downwards it is
    the other way round. Where a face can only be crossed one way with a pair, the label beyond may
    flow back, but then it stays in force: the loop does not slide.
    """

    face: np.ndarray  # (E,): which face
    rows: np.ndarray  # (E, 2): below and above
    labels: np.ndarray  # (E, 2): below and above
    up: np.ndarray  # (E,): whether the label below switches where it crosses upwards
    down: np.ndarray  # (E,)

    @staticmethod
    def of(rows: Rows, sides: np.ndarray) -> Sides:
        """Return those of faces with rows (F, 2) below and above."""
        number, count = rows.next.shape
        pairs, kind = np.unique(sides[:, 0].astype(np.int64) * number + sides[:, 1],
                                return_inverse=True)  # fmt: skip
        parts = []
        for inward in (False, True):
            own, other = np.divmod(pairs, number)[:: -1 if inward else 1]
            place, label = rows.residents(own)
            switches = rows.next[other[place], label] != label
            place, label = place[switches], label[switches]
            beyond = rows.last[other[place], label]
            below, above = (beyond, label) if inward else (label, beyond)
            parts.append((place * count + below) * count + above)
        keys = np.union1d(*parts)
        up, down = (np.isin(keys, part) for part in parts)
        place, labels = keys // count**2, np.stack([keys // count % count, keys % count], axis=1)
        counts = np.bincount(place, minlength=len(pairs))
        face, within = ragged(counts[kind.ravel()])
        entry = (np.cumsum(counts) - counts)[kind.ravel()][face] + within
        return Sides(face, sides[face], labels[entry], up[entry], down[entry])
