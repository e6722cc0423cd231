"""What a controller says at a sample, and why a closed loop ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

ENDINGS = ("time", "target", "left the domain", "not finite")
"""Why a trial ended, by its number."""
TIME, TARGET, LEFT_DOMAIN, NOT_FINITE = range(4)

NONE = -2
"""The symbol of a controller that gives controls, not symbols; or of a trial before its first."""


@dataclass(frozen=True)
class Command:
    """What a controller wants over the sample that begins, for B trials, in P pieces."""

    controls: np.ndarray  # (B, P, m): control of each piece [input units]
    ends: (
        np.ndarray
    )  # (B, P): when it ends [time unit from the sample], ascending; the last at infinity
    symbols: np.ndarray  # (B,): symbol of the first piece; -1 for the default, `NONE` for none
    ended: np.ndarray  # (B,): `TIME` (0) or why the trial ends
    outside: np.ndarray  # (B,): whether the measured state was outside the domain


def hold(controls: np.ndarray, symbols: np.ndarray | None = None) -> Command:
    """Return the command that holds controls (B, m), with their symbols (B,) if there are any."""
    count = len(controls)
    return Command(
        controls[:, None, :],
        np.full((count, 1), np.inf),
        np.full(count, NONE) if symbols is None else symbols,
        np.full(count, TIME),
        np.zeros(count, dtype=bool),
    )


Decide = Callable[[float, np.ndarray, np.ndarray], Command]
"""``(time, measured states (B, n), symbols in force (B,)) -> command``; those are -1 for the
default, `NONE` before the first and where they are no symbols."""
