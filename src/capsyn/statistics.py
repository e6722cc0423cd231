"""Confidence intervals of counted outcomes."""

from __future__ import annotations

import math

import numpy as np

from capsyn.errors import ProblemError
from capsyn.validation import finite_number, whole_number

TOLD = 100
"""Most states or cells that the ``to_json`` of evidence lists."""


def clopper_pearson(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the exact (Clopper-Pearson) interval (low, high) of a share, from counts.

    It holds the true share with at least the given confidence, whatever the share is.

    Raises
    ------
    ProblemError
        No trials, more successes than trials, or a confidence outside (0, 1).
    """
    trials = whole_number("trials", trials, least=1)
    successes = whole_number("successes", successes, least=0, most=trials)
    tail = (1 - check_confidence(confidence)) / 2
    from scipy.special import betaincinv  # scipy.stats has the same, but takes long to import

    low = betaincinv(successes, trials - successes + 1, tail) if successes else 0.0
    high = betaincinv(successes + 1, trials - successes, 1 - tail) if successes < trials else 1.0
    return float(low), float(high)


def mean_interval(values: np.ndarray, confidence: float) -> tuple[float, float] | None:
    """Return Student's interval (low, high) of the mean that values (T,) are drawn around.

    Of less than two values there is none.
    """
    count = len(values)
    if count < 2:
        return None
    from scipy.special import stdtrit

    half = stdtrit(count - 1, (1 + confidence) / 2) * values.std(ddof=1) / math.sqrt(count)
    return float(values.mean() - half), float(values.mean() + half)


def check_confidence(confidence: float) -> float:
    """Return a confidence as a float in (0, 1)."""
    value = finite_number("confidence", confidence, above=0.0)
    if value >= 1:
        raise ProblemError(f"`confidence` must be a number between 0 and 1; got {value:g}")
    return value
