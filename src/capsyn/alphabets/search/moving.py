"""Symbols that move: levels of continuous inputs leave the grid of candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from capsyn.alphabets.gains import candidate_gradients, is_affine
from capsyn.alphabets.search.scores import Score, Scores
from capsyn.alphabets.spread import Pool
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Box

ROUNDS = 30
"""Most rounds of Lloyd's algorithm."""
SEEN = 20_000
"""Most states that it looks at."""
FINEST = 1 / 512
"""Smallest moves that are tried, in widths of the box."""
MOVES = 200
"""Most times that moves are tried."""


class Movable:
    """Alphabets of free values in a box, whose closed loops are scored.

    Parameters
    ----------
    scores : Scores
        Scores of the pool of candidates.
    box : Box
        Bounds of the inputs.
    pool : Pool
        The candidates, with their prices; those that are kept do not move.
    """

    def __init__(self, scores: Scores, box: Box, pool: Pool) -> None:
        self.scores, self.box, self.pool = scores, box, pool
        self.kept = pool.candidates.values[list(pool.keep)]

    @property
    def has_effort(self) -> bool:
        """Whether Lloyd's algorithm can be used: R is positive definite and f affine in u."""
        loops = self.scores.loops
        weight = np.atleast_2d(loops.formulation.settings.control_weight)
        return bool(is_affine(loops.formulation.model) and np.linalg.eigvalsh(weight).min() > 0)

    def of(self, alphabets: Sequence[np.ndarray]) -> list[Score]:
        """Return the scores of alphabets of values (N, m)."""
        values = np.unique(np.vstack(alphabets), axis=0)
        like = self.scores.loops.pool
        pool = Alphabet(values, None, like.inputs, like.units)
        prices = self.pool.price_of(values)
        places = {tuple(value): k for k, value in enumerate(values.tolist())}
        sets = [
            tuple(sorted({places[tuple(value)] for value in (own + 0.0).tolist()}))
            for own in alphabets
        ]
        return self.scores.over(pool, prices).of(sets)

    def lloyd(self, own: np.ndarray) -> np.ndarray:
        """Return levels (N, m) after Lloyd's algorithm at states that loops visit.

        ``u_i <- -1/2 R^-1 mean(h^T rho)`` over the states that take u_i, clipped to the box, with
        ``h^T rho`` the slope of the mode insertion gradient along the inputs. Levels that no state
        takes stay. The weight R of the effort must be positive definite.
        """
        loops = self.scores.loops
        m, settings = own.shape[1], loops.formulation.settings
        weight = np.asarray(settings.control_weight)
        weight = weight * np.eye(m) if weight.ndim == 0 else weight
        like = loops.pool
        again = loops.over(Alphabet(own, None, like.inputs, like.units))
        states, _ = again.visited(range(len(own)))
        states = states[:: max(1, -(-len(states) // SEEN))]
        base = loops.formulation.default
        sizes = np.where(self.box.widths > 0, self.box.widths, 1.0)
        both = np.vstack([base + np.diag(sizes), base])
        found = candidate_gradients(loops.problem, both, states, loops.backend)
        slopes = (found[:, :-1] - found[:, -1:]) / sizes
        slopes = slopes[np.isfinite(slopes).all(axis=1)]
        fixed = (own[:, None] == self.kept).all(axis=2).any(axis=1)
        for _ in range(ROUNDS):
            efforts = np.einsum("ni,ij,nj->n", own, weight, own)
            takes = (slopes @ own.T + efforts).argmin(axis=1)
            moved = own.copy()
            for k in np.setdiff1d(np.unique(takes), np.flatnonzero(fixed)):
                mean = slopes[takes == k].mean(axis=0)
                moved[k] = np.clip(
                    -np.linalg.solve(weight, mean) / 2, self.box.lower, self.box.upper
                )
            if np.array_equal(moved, own):
                break
            own = moved
        return np.unique(own, axis=0)

    def searched(
        self, score: Score, own: np.ndarray, told: Callable[[str], None]
    ) -> tuple[Score, np.ndarray]:
        """Return what no move of one level along one input improves, by a pattern search."""
        step, m = 1 / 8, own.shape[1]
        for _ in range(MOVES):
            if step < FINEST:
                break
            told(f"{len(own)} symbols, moves of {step:.2g} of the range, objective {score[1]:.4g}")
            tried = []
            for k, i, sign in np.ndindex(len(own), m, 2):
                if self.box.widths[i] == 0 or (own[k] == self.kept).all(axis=1).any():
                    continue
                moved = own.copy()
                moved[k, i] += (1 - 2 * sign) * step * self.box.widths[i]
                moved[k] = np.clip(moved[k], self.box.lower, self.box.upper)
                if len(np.unique(moved, axis=0)) == len(own):
                    tried.append(moved)
            found = self.of(tried) if tried else []
            best = min(range(len(found)), key=found.__getitem__, default=None)
            if best is None or found[best] >= score:
                step /= 2
                continue
            score, own = found[best], tried[best]
        return score, own
