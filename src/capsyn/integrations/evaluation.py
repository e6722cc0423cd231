"""Results of the episodes that a policy has played."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

CONFIDENCE = 0.95
"""Of the interval of the mean return."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Results of the episodes that a policy has played.

    Parameters
    ----------
    returns : (E,)
        Sum of the rewards of each episode.
    lengths : (E,)
        Steps of each episode.
    terminated : (E,) booleans
        Whether each episode ended by itself, and not by a limit of its length.
    """

    returns: np.ndarray
    lengths: np.ndarray
    terminated: np.ndarray

    @property
    def mean(self) -> float:
        """Mean return of the episodes."""
        return float(self.returns.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """Student's interval (`CONFIDENCE`) of the mean return; infinite for one episode."""
        from scipy.stats import t

        count = len(self.returns)
        if count < 2:
            return -np.inf, np.inf
        reach = t.ppf((1 + CONFIDENCE) / 2, count - 1) * self.returns.std(ddof=1) / np.sqrt(count)
        return self.mean - float(reach), self.mean + float(reach)

    def __repr__(self) -> str:
        low, high = self.interval
        return (
            f"Evaluation({len(self.returns)} episodes, mean return {self.mean:.6g}, {low:.6g} to "
            f"{high:.6g} with {CONFIDENCE:.0%} confidence, {int(self.terminated.sum())} terminated)"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the evaluation as plain data."""
        low, high = (v if np.isfinite(v) else None for v in self.interval)
        figures = {"mean": self.mean, "low": low, "high": high, "confidence": CONFIDENCE}
        return figures | {name: values.tolist() for name, values in vars(self).items()}
