"""Two policies compared in closed loop, from the same starts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from capsyn.statistics import check_confidence

WORST = 2.0
"""Times the worst cost before that the worst cost after may be at most."""


@dataclass(frozen=True)
class Comparison:
    """Costs of the same starts under two policies, of starts whose loops end regularly under both.

    Parameters
    ----------
    before, after : float
        Mean costs; infinite if no start ends regularly under both policies.
    low, high : float
        Interval of the mean difference, cost after less cost before.
    worst_before, worst : float
        Cost of the worst start, before and after.
    lost_before, lost : int
        Number of lost starts: their loops left the domain and ended, or became not finite.
    fewer_lost : bool
        Whether surely fewer starts are lost after than before.
    more_lost : bool
        Whether more starts are lost after than before, surely or not.
    """

    before: float
    after: float
    low: float
    high: float
    worst_before: float
    worst: float
    lost_before: int
    lost: int
    fewer_lost: bool
    more_lost: bool

    @staticmethod
    def of(before: np.ndarray, after: np.ndarray, confidence: float) -> Comparison:
        """Return the comparison of the costs `before` (B,) and `after` (B,) of the same starts.

        Lost starts have an infinite cost. `confidence` is that of the interval.
        """
        from scipy.special import stdtrit  # scipy.stats has the same, but takes long to import

        ends, ended = np.isfinite(after), np.isfinite(before)
        both = ends & ended
        count = int(both.sum())
        own, other = before[both], after[both]
        change = other - own
        mean = change.mean() if count else math.nan
        error = change.std(ddof=1) / math.sqrt(count) if count > 1 else math.inf
        reach = stdtrit(max(1, count - 1), (1 + check_confidence(confidence)) / 2) * error
        won, gone = int((ends & ~ended).sum()), int((ended & ~ends).sum())
        return Comparison(
            float(own.mean()) if count else math.inf,
            float(other.mean()) if count else math.inf,
            float(mean - reach),
            float(mean + reach),
            float(own.max(initial=-math.inf)),
            float(other.max(initial=-math.inf)),
            int((~ended).sum()),
            int((~ends).sum()),
            won - gone > 2 * math.sqrt(won + gone),
            gone > won,
        )

    @property
    def better(self) -> bool:
        """Whether surely fewer starts are lost after, or the starts surely cost less.

        If they surely cost less, no more starts may be lost, and the worst start may cost at most
        `WORST` times as much. A lost start counts more than any cost.
        """
        spared = not self.more_lost and self.worst <= WORST * self.worst_before
        return self.fewer_lost or (spared and self.high < 0)
