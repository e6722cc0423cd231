"""Alphabets from which the search among alphabets starts."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.alphabets.gains import candidate_gains, greedy
from capsyn.alphabets.search.rollout_gains import rollout_gains
from capsyn.alphabets.search.scores import Members, Scores
from capsyn.alphabets.spread import Pool, uniform_set
from capsyn.alphabets.symmetries import orbits
from capsyn.modelling.problem import Problem
from capsyn.random_streams import derived_seed

SEEN = 4096
"""Random states of the first look by gradients."""
LOOKED = 35
"""Purpose of the seed of these states."""
UNIONS = 256
"""Most unions of orbits that are tried."""
LARGEST = 64
"""Most symbols of a start; larger ones take long to make smaller."""


@dataclass(frozen=True, eq=False)
class Starts:
    """What the starts of a search are made of, for any number of symbols."""

    always: tuple[Members, ...]  # singles, pairs and the user's own
    gains: np.ndarray  # (B, K) of the candidates, by gradients
    orbits: tuple[Members, ...]  # of the candidates under symmetries; none without symmetries
    pool: Pool
    rest: np.ndarray  # (m,) the default control

    @staticmethod
    def of(problem: Problem, pool: Pool, own: Sequence[Members], backend: str, seed: int) -> Starts:
        """Return those of a problem, whose default control is the rest of the inputs."""
        values, rest = pool.candidates.values, problem.default_control
        moved = (values != rest).sum(axis=1)
        by_hand = [tuple(np.flatnonzero(moved <= most).tolist()) for most in (1, 2)]
        always = [some for some in by_hand if 1 < len(some) <= LARGEST]
        states = problem.space.sample(SEEN, derived_seed(seed, LOOKED))
        found = orbits(problem, values)
        several = tuple(found) if max(map(len, found), default=1) > 1 else ()
        gains = candidate_gains(problem, values, states, backend)
        return Starts((*own, *always), gains, several, pool, rest)

    def looked(self, count: int) -> list[Members]:
        """Return alphabets of so many symbols by a first look: by gradients, and evenly spread."""
        found = [tuple(sorted(greedy(self.gains, count, self.pool.keep).tolist()))]
        found.append(self.even(count))
        return [some for some in found if some]

    def even(self, count: int) -> Members:
        """Return candidates that are evenly spread."""
        listed = dataclasses.replace(self.pool, continuous=False)
        names = self.pool.candidates.names
        return tuple(sorted(map(names.index, uniform_set(listed, count, self.rest).names)))

    def unions(self, count: int) -> list[Members]:
        """Return unions of orbits of at most `count` symbols that hold what is kept.

        Where there are more than can be tried, they are those of few orbits.
        """
        found: dict[Members, None] = {}
        fit = [orbit for orbit in self.orbits if len(orbit) <= count]
        for some in range(1, min(len(fit), count) + 1):
            for chosen in itertools.islice(itertools.combinations(fit, some), 50 * UNIONS):
                own = tuple(sorted({*itertools.chain(*chosen), *self.pool.keep}))
                if 1 < len(own) <= count:
                    found[own] = None
                if len(found) >= UNIONS:
                    return list(found)
        return list(found)

    def by_rollouts(
        self, scores: Scores, base: Members, members: Members, count: int, seed: int
    ) -> list[Members]:
        """Return the alphabet that rollouts with a base would choose among members of the pool."""
        gains = rollout_gains(scores, base, members, seed)
        if not len(gains):
            return []
        keep = [members.index(k) for k in self.pool.keep]
        return [tuple(sorted(members[k] for k in greedy(gains, count, keep)))]
