"""Uniform grids that states are on, found from their values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capsyn.errors import ProblemError

OFF_GRID = 0.1
"""Distance from the grid, in steps, from which on a state is not on it."""


def grid_of(
    path: str, names: Sequence[str], states: np.ndarray, lines: np.ndarray, missing: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return first point (n,) and distances (n,) of the grid of states (B, n), and places there.

    The distance along an axis is the usual one between neighbouring values, so that a state that
    is off the grid is told from the others.

    Raises
    ------
    ProblemError
        An axis that is not uniform, or has one value; unless `missing` is ``"outside"`` one with
        values that no state has.
    """
    first, step = np.empty((2, states.shape[1]))
    places = np.empty(states.shape, dtype=np.int64)
    for axis, name in enumerate(names):
        values, back = np.unique(states[:, axis], return_inverse=True)
        apart = np.diff(values)
        apart = apart[apart > 1e-9 * (values[-1] - values[0])]
        if not len(apart):
            raise ProblemError(f"'{path}' must have two values of '{name}' at least; got one")
        usual = np.sort(apart)[(len(apart) - 1) // 2]
        k = np.concatenate([[0], np.cumsum(np.rint(np.diff(values) / usual))])
        step[axis] = np.median((values - values[0])[k > 0] / k[k > 0])
        first[axis] = np.median(values - step[axis] * k)
        off = np.abs(values - first[axis] - step[axis] * k) > OFF_GRID * step[axis]
        uneven = (
            f"axis '{name}' is not uniform: steps {apart.min():.6g} .. {apart.max():.6g}; axes "
            "must be"
        )
        if off.any():
            row = np.flatnonzero(off[back.reshape(-1)])[0]
            raise ProblemError(
                f"'{path}': {uneven} (line {lines[row]}: expected '{name}' on the grid "
                f"{first[axis]:.6g} + {step[axis]:.6g} k; got {float(states[row, axis])!r})"
            )
        if missing == "auto" and (np.diff(k) > 1).any():
            raise ProblemError(
                f"'{path}': {uneven} (missing=\"outside\", or --missing outside, takes the points "
                "between as outside)"
            )
        places[:, axis] = k[back.reshape(-1)].astype(np.int64)
    return first, step, places
