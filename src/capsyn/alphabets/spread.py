"""Alphabets to compare with: evenly spread ones, and random ones, of a given size."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.modelling.alphabet import Alphabet
from capsyn.random_streams import stream

RANDOM = 32
"""Purpose of the random numbers."""
DIGITS = 12
"""Distances that differ beyond so many digits are equal: the first candidate is taken."""


@dataclass(frozen=True, eq=False)
class Pool:
    """Candidates, of which alphabets are made.

    Parameters
    ----------
    candidates : Alphabet
        The candidates (K, m).
    keep : tuple of int
        Those that every alphabet has.
    continuous : bool
        Whether values between the candidates are possible too, as those of a box are.
    prices : (K,), optional
        Prices of the candidates [objective]. Default: 0.
    """

    candidates: Alphabet
    keep: tuple[int, ...] = ()
    continuous: bool = False
    prices: Any = None

    def price_of(self, values: np.ndarray) -> np.ndarray:
        """Return the prices (N,) of values (N, m): those of the nearest candidates."""
        if self.prices is None or not np.any(self.prices):
            return np.zeros(len(values))
        known = self.candidates.values
        return np.asarray(self.prices)[[_nearest(known, value) for value in values]]

    def subset(self, indices: Iterable[int]) -> Alphabet:
        """Return the alphabet of some candidates, in their order."""
        some, all_ = sorted({int(k) for k in indices}), self.candidates
        return Alphabet(all_.values[some], [all_.names[k] for k in some], all_.inputs, all_.units)


def uniform_set(pool: Pool, count: int, rest: np.ndarray) -> Alphabet:
    """Return an alphabet of `count` symbols that are evenly spread over the candidates.

    For one input they are levels from the least candidate to the largest. Kept candidates, and all
    where nothing between is possible, stand in the place of the nearest level. For more inputs each
    symbol is the candidate farthest from those before it, in shares of the range of each input; the
    first are those that are kept, and the one nearest to `rest` (m,).
    """
    values = pool.candidates.values
    count = min(count, len(values))
    if values.shape[1] > 1 or count == 1:
        return pool.subset(_farthest(values, [*pool.keep, _nearest(values, rest)], count))
    levels = np.linspace(values.min(), values.max(), count)
    kept: dict[int, int] = {}  # by the level in whose place it stands
    for k in pool.keep:
        distances = np.abs(levels - values[k, 0])
        distances[list(kept)] = np.inf
        kept[int(distances.argmin())] = k
    if not pool.continuous:
        near = [kept.get(j, _nearest(values, level)) for j, level in enumerate(levels)]
        return pool.subset(_farthest(values, [*pool.keep, *near], count))
    levels[list(kept)] = values[list(kept.values()), 0]
    levels = np.unique(levels)
    known = {float(value): name for value, name in zip(values[:, 0], pool.candidates.names)}
    names = [known.get(level, f"{level:.4g}") for level in levels.tolist()]
    distinct = len(set(names)) == len(names)
    like = pool.candidates
    return Alphabet(levels[:, None], names if distinct else None, like.inputs, like.units)


def random_sets(pool: Pool, count: int, number: int, seed: int) -> list[Alphabet]:
    """Return at most `number` different alphabets of `count` random candidates."""
    rng, size = stream(seed, RANDOM, count), len(pool.candidates)
    rest = np.setdiff1d(np.arange(size), pool.keep)
    more = min(max(count - len(pool.keep), 0), len(rest))
    drawn = (rng.choice(rest, more, replace=False).tolist() for _ in range(number))
    sets = dict.fromkeys(tuple(sorted([*pool.keep, *some])) for some in drawn)
    return [pool.subset(some) for some in sets]


def _nearest(values: np.ndarray, point: np.ndarray | float) -> int:
    """Return which of values (K, m) is nearest to a point (m,), in shares of their range."""
    distances = np.linalg.norm((values - point) / _ranges(values), axis=1)
    return int(distances.round(DIGITS).argmin())


def _ranges(values: np.ndarray) -> np.ndarray:
    ranges = np.ptp(values, axis=0)
    return np.where(ranges > 0, ranges, 1.0)


def _farthest(values: np.ndarray, first: Iterable[int], count: int) -> list[int]:
    """Return `count` of values (K, m): the `first`, then each the farthest from those before."""
    points = values / _ranges(values)
    taken = list(dict.fromkeys(first))[:count]
    distances = np.full(len(points), np.inf)
    for k in range(count):
        if k == len(taken):
            taken.append(int(distances.round(DIGITS).argmax()))
        distances = np.minimum(distances, np.linalg.norm(points - points[taken[k]], axis=1))
    return taken
