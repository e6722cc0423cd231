"""Rows: which symbol follows each symbol in force, and the numbers that leaves have for them.

The paper's transition function is ``T : U x L -> U`` (Definition 2): a partition stands for one
row of it. Rows 0 to N are constant, whatever is in force, and have the number of their symbol.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capsyn.cells.masks import (
    WORD,
    holds,
    last_all,
    last_any,
    masks_of_members,
    members,
    most_voted,
    preferred,
    word_count,
)

KEPT = 4
"""In a mixed cell the symbol in force stays, where switching has a price, for more than one in so
many of the votes that another has: else a loop that slides between two such cells would chatter."""
ROOM = 2**26
"""Bytes that sets of rows may take at once beside the result, roughly."""


class RowTable:
    """Numbers of rows, given as they come.

    Sets of symbols (..., J, W) that could be best have one for each symbol in force: J is N + 1,
    the default's last, or 1 where that does not matter. Of symbols that could be best that in force
    is chosen, else the first of `order`, which names each symbol and the default once. `dear` is
    whether switching has a price.
    """

    def __init__(self, order: Sequence[int], in_force: int = 1, dear: bool = False) -> None:
        self._order, self._labels, self._in_force = order, len(order), in_force
        self._dear = dear
        self._numbers: dict[bytes, int] = {}
        self._rows: list[np.ndarray] = []

    @property
    def label_count(self) -> int:
        """Number of labels, N + 1."""
        return self._labels

    def uniform(self, common: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Return the numbers (...) of the rows that are chosen of sets (..., J, W).

        They are anything but `where` (...) no set is empty.
        """
        chosen = preferred(common, self._order)
        if self._in_force == 1:
            return chosen[..., 0]
        chosen = chosen[where]
        stay = np.broadcast_to(np.arange(self._in_force, dtype=np.int32), chosen.shape)
        numbers = np.zeros(where.shape, dtype=np.int32)
        numbers[where] = self.numbers(np.where(holds(common[where], stay), stay, chosen))
        return numbers

    def voted(self, sets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows (M,) and the labels seen (M, J, W) of mixed cells; see `most_voted`.

        `sets` (P, M, J, W) are those of their test points. Of labels with as many votes that in
        force is chosen; where switching has a price, even with fewer, see `KEPT`.
        """
        labels, votes, seen = most_voted(sets, self._order)
        if self._in_force == 1:
            return labels[..., 0], seen
        own = np.broadcast_to(np.arange(self._in_force, dtype=np.int32), labels.shape)
        kept = np.count_nonzero(holds(sets, own), axis=0) * holds(seen, own)
        stays = KEPT * kept > votes if self._dear else (kept == votes) & (votes > 0)
        labels = np.where(stays, own, labels)
        return self.numbers(labels), seen

    def numbers(self, labels: np.ndarray) -> np.ndarray:
        """Return the numbers (...) of rows, given by their labels (..., J)."""
        if self._in_force == 1:
            return labels[..., 0]
        numbers = labels[..., 0].copy()
        other = (labels != labels[..., :1]).any(axis=-1)
        rows, inverse = _distinct(labels[other].astype(np.int32), self._labels)
        known = np.empty(len(rows), dtype=np.int32)
        for k, row in enumerate(rows):
            key = row.tobytes()
            if key not in self._numbers:
                self._numbers[key] = self._labels + len(self._rows)
                self._rows.append(row)
            known[k] = self._numbers[key]
        numbers[other] = known[inverse]
        return numbers

    def settle(self, leaves: np.ndarray) -> np.ndarray:
        """Keep the rows that leaf numbers (M,) use, in order; return the new leaf numbers.

        So numbers do not depend on which cells came first. Constant rows keep theirs. Numbers that
        are negative stay.
        """
        if not self._rows:
            return leaves
        table, constant = self.labels(), self._labels
        used = np.unique(leaves[leaves >= constant])
        used = used[np.lexsort(table[used].T[::-1])]
        places = np.arange(len(table), dtype=leaves.dtype)
        places[used] = constant + np.arange(len(used))
        self._rows = list(table[used])
        self._numbers = {row.tobytes(): constant + k for k, row in enumerate(self._rows)}
        return np.where(leaves < 0, leaves, places[leaves])

    def right(self, sets: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Return whether rows (M,) are in all the sets (P, M, J, W) of points, (P, M)."""
        labels = self.labels()[numbers]
        return last_all(holds(sets, labels[..., : sets.shape[-2]]))

    def labels(self) -> np.ndarray:
        """Return the labels (R, J) of all rows so far, by number."""
        constant = np.repeat(np.arange(self._labels, dtype=np.int32)[:, None], self._in_force, 1)
        return np.concatenate([constant, *(row[None] for row in self._rows)])


def row_sets(sets: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the sets (M, W) of rows (R, N + 1) whose labels are in sets (M, J, W), as bit masks.

    Of one set for all labels in force (J is 1) these are the constant rows of its labels.
    """
    labels, words = rows.shape[1], word_count(len(rows))
    if sets.shape[1] == 1:
        return masks_of_members(members(sets[:, 0], labels), words)
    found = np.full((len(sets), words), ~np.uint64(0))
    size = max(1, ROOM // (8 * labels * words))
    for j in range(labels):  # sets of rows are small where those of labels are many, and repeat
        table = _rows_by_label(rows[:, j], labels, words)
        for start in range(0, len(sets), size):
            some = slice(start, start + size)
            kinds, kind = _kinds(sets[some, j])
            found[some] &= _united(kinds, table)[kind]
    return found


def _kinds(sets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct sets (U, V) of sets (M, V), and which each is."""
    if sets.shape[1] == 1:  # numbers sort much faster than rows
        kinds, kind = np.unique(sets[:, 0], return_inverse=True)
        return kinds[:, None], kind
    kinds, kind = np.unique(sets, axis=0, return_inverse=True)
    return kinds, kind.ravel()


def _rows_by_label(column: np.ndarray, labels: int, words: int) -> np.ndarray:
    """Return the sets (N + 2, W) of rows that have each label in a column (R,); the last: none."""
    table = np.zeros((labels + 1, words), dtype=np.uint64)
    place = np.arange(len(column))
    bits = np.uint64(1) << (place % WORD).astype(np.uint64)
    np.bitwise_or.at(table, (column, place // WORD), bits)
    return table


def _united(sets: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Return what the labels of each of U sets (U, V) have in a table, together, (U, W)."""
    held = np.ones((len(sets), len(table)), dtype=bool)  # the last entry, of nothing, always
    held[:, :-1] = members(sets, len(table) - 1)
    _, label = np.nonzero(held)
    counts = held.sum(axis=1)
    return np.asarray(np.bitwise_or.reduceat(table[label], np.cumsum(counts) - counts, axis=0))


def _distinct(rows: np.ndarray, base: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct rows (D, J) of rows (M, J) of numbers below a base, and which each is."""
    if base ** rows.shape[1] >= 2**62:
        distinct, inverse = np.unique(rows, axis=0, return_inverse=True)
        return distinct, inverse.ravel()
    keys = rows @ (base ** np.arange(rows.shape[1], dtype=np.int64)[::-1])  # sorts much faster
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return rows[first], inverse.ravel()


def whole(common: np.ndarray) -> np.ndarray:
    """Return whether some row could be best throughout each cell, of sets (..., J, W)."""
    return last_all(last_any(common != 0))
