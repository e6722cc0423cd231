"""The ends of intervals: where they are undefined, and outward rounding."""

from __future__ import annotations

from typing import Any

import numpy as np

Interval = tuple[Any, Any]

LARGEST = np.finfo(float).max
SMALLEST = np.finfo(float).tiny
EPSILON = np.finfo(float).eps
ULPS = 16 * EPSILON
"""Relative error allowed to library functions; NumPy's SIMD forms err by up to 4 units."""


def undefined(where: Any, a: Interval) -> Interval:
    """Return the interval, undefined in some boxes."""
    if not np.any(where):
        return a
    return np.where(where, np.nan, a[0]), np.where(where, np.nan, a[1])


def taint(low: Any, high: Any) -> Interval:
    """Return the interval, undefined where either end is."""
    return undefined(np.isnan(low) | np.isnan(high), (low, high))


def outward(low: Any, high: Any) -> Interval:
    """Return the interval widened by one number each way: for correctly rounded operations."""
    return np.nextafter(low, -np.inf), np.nextafter(high, np.inf)


def widen(low: Any, high: Any) -> Interval:
    """Return the interval widened by what library functions may err."""
    error_low = np.minimum(np.abs(low), LARGEST) * ULPS + SMALLEST
    error_high = np.minimum(np.abs(high), LARGEST) * ULPS + SMALLEST
    # the value itself is a number, also where its bound overflows
    return np.minimum(low - error_low, LARGEST), np.maximum(high + error_high, -LARGEST)


def clip(a: Interval, bottom: Any, top: Any) -> Interval:
    """Return the interval within known bounds."""
    return np.maximum(a[0], bottom), np.minimum(a[1], top)


def clip_sign(a: Interval, nonnegative: Any, nonpositive: Any) -> Interval:
    """Return the interval with the sign that is certain in some boxes."""
    low, high = a
    return (
        np.where(nonnegative, np.maximum(low, 0.0), low),
        np.where(nonpositive, np.minimum(high, 0.0), high),
    )


def has_zero(a: Interval) -> Any:
    """Return where 0 is in the interval."""
    return (a[0] <= 0) & (a[1] >= 0)


def infinite(a: Interval) -> Any:
    """Return where an end is infinite."""
    return np.isinf(a[0]) | np.isinf(a[1])


def magnitude(a: Interval) -> Interval:
    """Return the interval of the absolute values."""
    low, high = np.abs(a[0]), np.abs(a[1])
    return np.where(has_zero(a), 0.0, np.minimum(low, high)), np.maximum(low, high)
