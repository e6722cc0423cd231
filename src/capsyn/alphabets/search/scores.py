"""How good alphabets are: the objective of their closed loops, found once for each."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field

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
    met: set[str] = field(default_factory=set)  # alphabets that were asked for
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
        self.met.update(key.rpartition(" ")[2] for key in keys)
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
        scores = [self._score(key, own) for key, own in zip(keys, sets)]
        if self._forbidden is None:
            return scores
        return [score if self._ways(own) else WORST for score, own in zip(scores, sets)]

    @functools.cached_property
    def _forbidden(self) -> np.ndarray | None:
        """Forbidden transitions in the pool (K + 1, K + 1), the default last; None if none are."""
        forbidden = self.loops.test.experiment.loop.holds.forbidden
        return forbidden if forbidden.any() else None

    def _ways(self, own: Members) -> bool:
        """Return whether each symbol of an alphabet has an exit, and the start a symbol."""
        assert self._forbidden is not None
        places = [*own, -1]
        free = ~self._forbidden[np.ix_(places, list(own))]
        free[:-1] &= ~np.eye(len(own), dtype=bool)
        return bool(free[-1].any() and (len(own) == 1 or free[:-1].any(axis=1).all()))

    def used(self, own: Members) -> np.ndarray:
        """Return the samples that each symbol of an alphabet was in force."""
        key = self._key(own)
        if key not in self.storage:
            self.of([own])
        found = np.empty(len(own), dtype=np.int64)
        found[self._order(own)] = self.storage[key][2]
        return found

    def best(self, sets: Sequence[Members]) -> tuple[Score, Members]:
        """Return the first of the `ranked` alphabets; `WORST` and none where there are none."""
        return next(iter(self.ranked(sets)), (WORST, ()))

    def ranked(self, sets: Sequence[Members]) -> list[tuple[Score, Members]]:
        """Return the best of alphabets in order, of equal ones those of fewest symbols first.

        Many are raced: the first starts leave out those that are far behind.
        """
        each = list(dict.fromkeys(sets))
        if len(each) > RACED:
            few = self.few.of(each)
            order = sorted(range(len(each)), key=lambda k: (few[k], len(each[k]), each[k]))
            each = [each[k] for k in order[: max(RACED // KEPT, len(each) // KEPT)]]
        return sorted(zip(self.of(each), each), key=lambda pair: (pair[0], len(pair[1]), pair[1]))

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
