"""How many steps an integration needs: doubled until the error meets a tolerance."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

FALLING, STALLS = 0.7, 3
"""An error falls where it is below this share of the least so far; so many in a row that do not
end a search for steps, once as many steps were tried as `fewest_steps` is told."""
KINKED = 1e-3
"""What an error counts that a kink of the model may cause. A kink costs the method its order: steps
that leave it as small as errors elsewhere are hundreds of times as many, and decide nothing."""
UNRESOLVED = 0.1
"""Errors of step doubling, in gradients or costs, that are too large to tell if they will fall."""


def fewest_steps(
    ladder: Sequence[int], error_of: Callable[[int], float], tolerance: float, tried: int = 1
) -> tuple[int, float]:
    """Return the first steps of a ladder whose error meets a tolerance, and the error.

    Where it stops falling first, they are the best so far; a NaN counts as infinite. That it does
    not fall counts from `tried` steps on: fewer may just be too few for what is fast.
    """
    best, least, stalled = ladder[0], np.inf, 0
    for steps in ladder:
        error = error_of(steps)
        error = np.inf if np.isnan(error) else error
        if error <= tolerance:
            return steps, error
        falls = error < FALLING * least or error > UNRESOLVED or steps < tried
        stalled = 0 if falls else stalled + 1
        if error <= least or least > UNRESOLVED:  # unstable steps may agree on garbage
            best, least = steps, error
        if stalled == STALLS:
            break
    return best, least
