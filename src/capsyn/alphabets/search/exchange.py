"""The search among alphabets: symbols are dropped, added and swapped while closed loops gain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from capsyn.alphabets.search.scores import WORST, Members, Score, Scores

SWEEPS = 12
"""Most sweeps over all swaps from one start."""
GAIN = 1e-3
"""A sweep that gains less than this share of the objective is the last."""
SWAPS = 1500
"""Most swaps of a sweep; of more, those that bring in the symbols that would gain most."""
FOLLOWED = 12
"""Swaps of a sweep that are tried on top of each other."""


@dataclass(frozen=True, eq=False)
class Exchange:
    """A search among alphabets of a pool, of at most `count` symbols, that have those to `keep`."""

    scores: Scores
    pool: Members  # what may be in an alphabet
    keep: frozenset[int]
    count: int
    sweeps: int = SWEEPS
    told: Callable[[str], None] = lambda _: None

    def fitted(self, start: Sequence[int]) -> Members:
        """Return a start with what is kept, and without more symbols than there may be.

        Of those that are too many the ones go that loops miss least, some at a time.
        """
        own = tuple(sorted(set(start) & set(self.pool) | self.keep))
        while len(own) > self.count:
            loose = [k for k in own if k not in self.keep]
            scores = self.scores.few.of([_without(own, k) for k in loose])
            order = [k for _, k in sorted(zip(scores, loose))]
            some = max(1, (len(own) - self.count) // 2)
            own = tuple(k for k in own if k not in order[:some])
        return own

    def improved(self, start: Members) -> tuple[Score, Members]:
        """Return what no drop, added symbol or swap improves by much, from a start that fits."""
        own, (score,) = start, self.scores.of([start]) if start else [WORST]
        for sweep in range(self.sweeps):
            self.told(f"{self.count} symbols, sweep {sweep + 1}, objective {score[1]:.4g}")
            score, own = self._grown(*self._shrunk(score, own))
            better = self._swapped(score, own)
            if better is None:
                break
            gained = score[1] - better[0][1] if better[0][0] == score[0] else float("inf")
            score, own = better
            if gained < GAIN * abs(score[1]):
                break
        return self._shrunk(score, own)

    def _shrunk(self, score: Score, own: Members) -> tuple[Score, Members]:
        """Drop symbols, one after the other, that loops do without at no loss."""
        while len(own) > 1:
            used = self.scores.used(own)
            idle = [k for k, n in zip(own, used) if not n and k not in self.keep]
            if idle:
                fewer = tuple(k for k in own if k not in idle) or own[:1]
                (found,) = self.scores.of([fewer])
                if found <= score and fewer != own:
                    score, own = found, fewer
                    continue
            loose = [k for k in own if k not in self.keep]
            found, fewer = self.scores.best([_without(own, k) for k in loose])
            if not loose or found > score:
                break
            score, own = found, fewer
        return score, own

    def _grown(self, score: Score, own: Members) -> tuple[Score, Members]:
        """Add symbols, one after the other, that gain."""
        while len(own) < self.count:
            found, more = self.scores.best([_with(own, k) for k in self._others(own)])
            if not more or found >= score:
                break
            score, own = found, more
        return score, own

    def _swapped(self, score: Score, own: Members) -> tuple[Score, Members] | None:
        """Return the best of all swaps, with others on top that gain, too; None if none does."""
        loose = [k for k in own if k not in self.keep]
        others = self._others(own)
        if len(loose) * len(others) > SWAPS:
            gains = self.scores.few.of([_with(own, k) for k in others])
            most = max(1, SWAPS // max(1, len(loose)))
            others = sorted(k for _, k in sorted(zip(gains, others))[:most])
        swaps = {_with(_without(own, out), new): (out, new) for out in loose for new in others}
        ranked = self.scores.ranked(list(swaps))
        if not ranked or ranked[0][0] >= score:
            return None
        score, best = ranked[0]
        for _, other in ranked[1:FOLLOWED]:
            out, new = swaps[other]
            if out in best and new not in best:
                again = _with(_without(best, out), new)
                (found,) = self.scores.of([again])
                if found < score:
                    score, best = found, again
        return score, best

    def _others(self, own: Members) -> list[int]:
        return [k for k in self.pool if k not in own]


def _with(own: Members, symbol: int) -> Members:
    return tuple(sorted({*own, symbol}))


def _without(own: Members, symbol: int) -> Members:
    return tuple(k for k in own if k != symbol)
