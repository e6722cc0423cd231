"""How many steps an integration needs: doubled until the error meets a tolerance."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

FALLING, STALLS = 0.7, 3
"""An error falls where it is below this share of the least so far; so many in a row that do not
end a search for steps."""
UNRESOLVED = 0.1
"""Errors of step doubling, in gradients or costs, that are too large to tell if they will fall."""


def fewest_steps(
    ladder: Sequence[int], error_of: Callable[[int], float], tolerance: float
) -> tuple[int, float]:
    """Return the first steps of a ladder whose error meets a tolerance, and the error.

    Where it stops falling first, they are the best so far; a NaN counts as infinite.
    """
    best, least, stalled = ladder[0], np.inf, 0
    for steps in ladder:
        error = error_of(steps)
        error = np.inf if np.isnan(error) else error
        if error <= tolerance:
            return steps, error
        stalled = 0 if error < FALLING * least or error > UNRESOLVED else stalled + 1
        if error <= least or least > UNRESOLVED:  # unstable steps may agree on garbage
            best, least = steps, error
        if stalled == STALLS:
            break
    return best, least
