"""The search for the best alphabets of several sizes."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.alphabets.gains import greedy
from capsyn.alphabets.pace import Pace
from capsyn.alphabets.search.exchange import Exchange
from capsyn.alphabets.search.moving import Movable
from capsyn.alphabets.search.scores import Members, Scores
from capsyn.alphabets.search.starts import Starts

IMPROVED = 3
"""Starts that are improved for each number of symbols; all but the best first from few starts."""
EVERY = 2000
"""Alphabets of so many symbols that are all tried, if there are no more of them."""
MOVED = 2
"""Alphabets whose symbols move in full."""
PARTS = 2 * IMPROVED + 1
"""Parts of the search for a number of symbols: starts, those that are improved, the choice."""
POOL = 128
"""Most candidates that are exchanged; of more, those of the starts and of a first look."""


@dataclass(frozen=True, eq=False)
class Search:
    """A search among alphabets of candidates, in closed loops."""

    scores: Scores
    fresh: Scores  # of the same candidates, from other starts: they choose among what was found
    starts: Starts
    movable: tuple[Movable, Movable] | None  # likewise, where symbols may leave the candidates
    seed: int
    say: Callable[[str], None]

    def best(self, counts: Sequence[int]) -> dict[int, np.ndarray]:
        """Return the best values (N, m) that were found for each number of symbols, at most."""
        found: dict[int, list[Members]] = {}
        chosen: dict[int, np.ndarray] = {}
        pace = Pace(self.say, "", PARTS * len(counts))
        for k, count in enumerate(sorted(counts)):
            smaller = [own for some in found.values() for own in some[:1]]
            pace.done = PARTS * k
            found[count] = self.members(count, smaller, pace)
            pace.done = PARTS * (k + 1) - 1
            chosen[count] = self._chosen(found[count], count, [*chosen.values()], pace.tell)
        return chosen

    def members(self, count: int, smaller: Sequence[Members], pace: Pace) -> list[Members]:
        """Return alphabets that were found for a number of symbols, the best first."""
        keep = frozenset(self.starts.pool.keep)
        pace.tell(f"{count} symbols, starts")
        given = [*self.starts.always, *self.starts.looked(count)]
        pool = self._pool([*given, *smaller])
        exchange = Exchange(self.scores, pool, keep, count, told=pace.tell)
        fitted = list(dict.fromkeys([*map(exchange.fitted, given), *smaller]))
        for several in (self.starts.unions(count), _every(pool, keep, count)):
            if several:
                fitted.append(self.scores.best(several)[1])
        first = self.scores.best([own for own in fitted if own])[1]
        fitted += self.starts.by_rollouts(self.scores, first, pool, count, self.seed)
        fitted = list(dict.fromkeys(own for own in fitted if own))
        order = sorted(zip(self.scores.of(fitted), fitted))
        quick = dataclasses.replace(exchange, scores=self.scores.few)
        ends, improved = dict.fromkeys([order[0][1]]), []
        for _, own in order[1:IMPROVED]:
            pace.done += 1
            ends[quick.improved(own)[1]] = None
        for own in ends:
            pace.done += 1
            improved.append(exchange.improved(own))
        each = dict.fromkeys(own for _, own in sorted([*improved, *order]))
        return list(each)

    def _pool(self, known: Sequence[Members]) -> Members:
        """Return the candidates that are exchanged."""
        count = len(self.scores.loops.pool)
        if count <= POOL:
            return tuple(range(count))
        some = dict.fromkeys(k for own in known for k in own)
        return tuple(sorted(some | dict.fromkeys(self._look)))

    @functools.cached_property
    def _look(self) -> Members:
        """Candidates of a first look: those that gain by gradients, and evenly spread ones."""
        gain = greedy(self.starts.gains, POOL // 2).tolist()
        return (*gain, *self.starts.even(POOL // 2))

    def _chosen(
        self,
        found: Sequence[Members],
        count: int,
        smaller: Sequence[np.ndarray],
        told: Callable[[str], None],
    ) -> np.ndarray:
        """Return the best alphabet of those found and of smaller ones, on starts of its own."""
        values = self.scores.loops.pool.values
        if self.movable is None:
            places = [
                tuple(np.flatnonzero((values[:, None] == own).all(axis=2).any(axis=1)).tolist())
                for own in smaller
            ]
            told(f"{count} symbols, choice among those found")
            each = list(dict.fromkeys([*found, *places]))
            return values[list(self.fresh.best(each)[1])]
        moves, fresh = self.movable
        tried = [values[list(own)] for own in found]
        told(f"{count} symbols, moves")
        best = self._moved(moves, tried[:IMPROVED], told)
        those = [*best, *tried, *smaller]
        scores = fresh.of(those)
        return those[min(range(len(those)), key=lambda k: (scores[k], len(those[k]), k))]

    def _moved(
        self, moves: Movable, starts: Sequence[np.ndarray], told: Callable[[str], None]
    ) -> list[np.ndarray]:
        """Return what alphabets become when their symbols move, the best starts in full."""
        each = list(starts)
        if moves.has_effort:
            each += [moves.lloyd(own) for own in starts]
        scores = moves.of(each)
        best = sorted(range(len(each)), key=lambda k: (scores[k], k))[:MOVED]
        return [*(moves.searched(scores[k], each[k], told)[1] for k in best), *each]


def _every(pool: Members, keep: frozenset[int], count: int) -> list[Members]:
    """Return all alphabets of `count` symbols of a pool with what is kept; none if too many."""
    free = [k for k in pool if k not in keep]
    more = min(count - len(keep), len(free))
    if math.comb(len(free), more) > EVERY:
        return []
    return [tuple(sorted([*keep, *some])) for some in itertools.combinations(free, more)]
