"""Where readings that are whole numbers cross the faces of the lattice."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def least_reaching(
    states: Callable[[np.ndarray], np.ndarray], bounds: np.ndarray, low: int, high: int
) -> np.ndarray:
    """Return the least whole numbers in [low, high] whose states reach bounds, else high + 1.

    Parameters
    ----------
    states : callable
        Whole numbers (K,), held as floats, to states (K,) that never fall from one to the next.
    bounds : (K,)
        States to be reached.
    """
    before = np.full(len(bounds), low - 1, dtype=np.int64)
    behind = np.full(len(bounds), high + 1, dtype=np.int64)
    while (behind - before > 1).any():
        middle = (before + behind) // 2
        reached = states(middle.astype(np.float64)) >= bounds
        apart = behind - before > 1
        behind = np.where(apart & reached, middle, behind)
        before = np.where(apart & ~reached, middle, before)
    return behind
