"""How good alphabets are: the objective of their closed loops, found once for each."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.alphabets.loops.alphabet_loops import AlphabetLoops
from capsyn.alphabets.search.objective import Objective
from capsyn.alphabets.search.storage import Storage
from capsyn.modelling.alphabet import Alphabet

Members = tuple[int, ...]
"""An alphabet: places in a pool, ascending."""
Score = tuple[int, float]
"""Loops that are lost, and the mean objective of the others, with prices; least is best."""
WORST: Score = (1 << 62, float("inf"))
RACED = 128
"""From more alphabets than this a quarter of the starts takes the better ones first."""
FEWEST = 16
"""Fewest starts of a quick look."""
KEPT = 4
"""They keep one in so many, and have as many starts fewer."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of alphabets of a pool, kept by what their symbols are."""

    loops: AlphabetLoops
    objective: Objective
    prices: np.ndarray  # (K,) of the pool's symbols [objective]
    storage: Storage
    starts: int  # the first of the loops' starts that count
    part: str = ""  # tells starts of different purposes apart in the storage

    @property
    def few(self) -> Scores:
        """The scores from a quarter of the starts: a quick look."""
        return dataclasses.replace(self, starts=min(self.starts, max(FEWEST, self.starts // KEPT)))

    def over(self, pool: Alphabet, prices: np.ndarray) -> Scores:
        """Return the scores of alphabets of another pool."""
        return dataclasses.replace(self, loops=self.loops.over(pool), prices=prices)

    def of(self, sets: Sequence[Members]) -> list[Score]:
        """Return the scores of alphabets."""
        count = self.starts
        keys = [self._key(own) for own in sets]
        new = {
            key: own for key, own in zip(keys, sets) if key not in self.storage
        }  # each of them once
        if new:
            found = self.loops.run(list(new.values()), slice(0, count))
            values = self.objective.values(found)
            lost = found.lost.sum(axis=1)
            with np.errstate(invalid="ignore"):
                means = np.nansum(values, axis=1) / np.maximum(count - lost, 1)
            self.storage.add(
                {
                    key: [
                        int(gone),
                        float(mean) if gone < count else None,
                        used[self._order(own)].tolist(),
                    ]
                    for (key, own), gone, mean, used in zip(new.items(), lost, means, found.used)
                }
            )
        return [self._score(key, own) for key, own in zip(keys, sets)]

    def known(self, own: Members) -> Score | None:
        """Return the score of an alphabet if it was found, else None."""
        key = self._key(own)
        return self._score(key, own) if key in self.storage else None

    def used(self, own: Members) -> np.ndarray:
        """Return the samples that each symbol of an alphabet was in force."""
        key = self._key(own)
        if key not in self.storage:
            self.of([own])
        found = np.empty(len(own), dtype=np.int64)
        found[self._order(own)] = self.storage[key][2]
        return found

    def best(self, sets: Sequence[Members]) -> tuple[Score, Members]:
        """Return the best of alphabets, of equal ones that of fewest symbols, the first.

        Many are raced: the first starts leave out those that are far behind.
        """
        each = list(dict.fromkeys(sets))
        if not each:
            return WORST, ()
        if len(each) > RACED:
            few = self.few.of(each)
            order = sorted(range(len(each)), key=lambda k: (few[k], len(each[k]), each[k]))
            each = [each[k] for k in order[: max(RACED // KEPT, len(each) // KEPT)]]
        return min(zip(self.of(each), each), key=lambda pair: (pair[0], len(pair[1]), pair[1]))

    def _score(self, key: str, own: Members) -> Score:
        lost, mean, _ = self.storage[key]
        return lost, (np.inf if mean is None else mean) + float(self.prices[list(own)].sum())

    def _order(self, own: Members) -> np.ndarray:
        """Return the order of an alphabet's symbols by their values, whatever the pool."""
        return np.lexsort(self.loops.pool.values[list(own)].T[::-1])

    def _key(self, own: Members) -> str:
        """Return what an alphabet is kept by."""
        values = self.loops.pool.values[list(own)][self._order(own)] + 0.0
        digest = hashlib.blake2b(values.tobytes(), digest_size=12).hexdigest()
        return f"{self.part}{self.starts} {digest}"
