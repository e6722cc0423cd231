"""The unit that a model counts time in, and how many seconds it has."""

from __future__ import annotations

from capsyn.validation import one_of

PER_SECOND = {
    "ns": (1, 10**9),
    "us": (1, 10**6),
    "ms": (1, 1000),
    "s": (1, 1),
    "min": (60, 1),
    "h": (3600, 1),
    "d": (86400, 1),
}
"""Units of time: seconds over units, as a fraction, so that conversions round once."""

NAMES = {
    "ns": "nanosecond",
    "us": "microsecond",
    "ms": "millisecond",
    "s": "second",
    "min": "minute",
    "h": "hour",
    "d": "day",
}
"""What one of each is called, as in "per minute"."""


def check_time_unit(unit: object) -> None:
    """Raise `ProblemError` unless `unit` is one of `PER_SECOND`."""
    one_of("time_unit", unit, list(PER_SECOND))


def to_seconds(time: float, unit: str) -> float:
    """Return a time in a unit of `PER_SECOND` in seconds, rounded once."""
    over, under = PER_SECOND[unit]
    return time * over if under == 1 else time / under


def from_seconds(seconds: float, unit: str) -> float:
    """Return seconds in a unit of `PER_SECOND`, rounded once."""
    over, under = PER_SECOND[unit]
    return seconds / over if under == 1 else seconds * under
