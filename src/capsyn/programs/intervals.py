"""Interval arithmetic: programs evaluated on boxes, with bounds that hold for every state inside.

An interval is a pair (low, high) of arrays. The bounds enclose both the real value of an operation
and what double precision computes. Where the value may be undefined at some point of the box (or
lie at a pole) the interval is (NaN, NaN), and so is all that depends on it. Infinite bounds mean
that the value may be too large for a number.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from capsyn.programs.ends import (
    EPSILON,
    Interval,
    clip,
    clip_sign,
    has_zero,
    infinite,
    magnitude,
    outward,
    taint,
    undefined,
    widen,
)
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.patterns import alternatives, exhaustive, smoothed_root
from capsyn.programs.program import Program

_PI = np.nextafter(np.pi, 4.0)
_HUGE = 1e8
"""From here on arguments of sin, cos and tan are not reduced; their range is the answer."""


def evaluate_intervals(
    program: Program, *inputs: Interval, inexact: frozenset[int] = frozenset()
) -> list[Interval]:
    """Return enclosures (low, high), (size, B) each, of the outputs of a program over B boxes.

    The inputs are pairs (low, high) of (size, B), both included. The value does not leave its
    enclosure anywhere in the box, in real arithmetic as in double precision; both ends are NaN
    where it may be undefined. Values that are `inexact`, constants which had to be rounded, are
    widened by the two neighbouring numbers.
    """
    values: list[Interval] = []
    for (name, size), (low, high) in zip(program.inputs, inputs, strict=True):
        low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        if low.shape[:1] != (size,) or low.shape != high.shape:
            raise ValueError(f"`{name}` must be two arrays ({size}, B); got {low.shape}")
        values += [taint(low[k], high[k]) for k in range(size)]
    shape = np.broadcast_shapes(*(np.shape(low) for low, _ in values))
    with np.errstate(all="ignore"):
        for name, *operands in program.instructions:
            if name == "const":
                number = np.float64(operands[0])
                ends = outward if len(values) in inexact else taint
                values.append(ends(number, number))
                continue
            arguments = [values[k] for k in operands]
            chosen = alternatives(program, *operands) if name == "add" else None
            if chosen:
                values.append(_either(*(values[k] for k in chosen)))
                continue
            root = smoothed_root(program, *operands) if name == "div" else None
            if root:
                result = _smoothed(arguments[0], *root)
            elif name == "mul" and operands[0] == operands[1]:
                result = _square(arguments[0])
            else:
                result = INTERVALS[name](*arguments)
            if name == "add" and exhaustive(program, *operands):
                result = clip(result, 1.0, 2.0)
            result = taint(*result)
            if name != "select":  # the branch that is not taken may be undefined
                for low, _ in arguments:
                    result = undefined(np.isnan(low), result)
            values.append(result)
    outputs, start = [], 0
    for _, size in program.outputs:
        low, high = np.empty((size, *shape)), np.empty((size, *shape))
        for k in range(size):
            low[k], high[k] = values[program.results[start + k]]
        outputs.append((low, high))
        start += size
    return outputs


def _add(a: Interval, b: Interval) -> Interval:
    low, high = a[0] + b[0], a[1] + b[1]
    below, above = outward(low, high)
    # a sum that is 0 is exact
    sums = np.where(low == 0, 0.0, below), np.where(high == 0, 0.0, above)
    opposite = ((a[0] == -np.inf) & (b[1] == np.inf)) | ((a[1] == np.inf) & (b[0] == -np.inf))
    return undefined(opposite, sums)


def _neg(a: Interval) -> Interval:
    return -a[1], -a[0]


def _sub(a: Interval, b: Interval) -> Interval:
    return _add(a, _neg(b))


def _corners(function: Callable[..., Any], a: Interval, b: Interval) -> Interval:
    """Return the least and the largest value at the corners of a box; NaN if one is NaN."""
    one, two = function(a[0], b[0]), function(a[0], b[1])
    three, four = function(a[1], b[0]), function(a[1], b[1])
    return (
        np.minimum(np.minimum(one, two), np.minimum(three, four)),
        np.maximum(np.maximum(one, two), np.maximum(three, four)),
    )


def _clip_product(result: Interval, a: Interval, b: Interval) -> Interval:
    """Return a product or quotient with the sign that its operands decide, underflow or not."""
    a_up, a_down, b_up, b_down = a[0] >= 0, a[1] <= 0, b[0] >= 0, b[1] <= 0
    zero = (a_up & a_down) | (b_up & b_down)
    nonnegative = (a_up & b_up) | (a_down & b_down) | zero
    return clip_sign(result, nonnegative, (a_up & b_down) | (a_down & b_up) | zero)


def _mul(a: Interval, b: Interval) -> Interval:
    result = _clip_product(outward(*_corners(np.multiply, a, b)), a, b)
    return undefined((has_zero(a) & infinite(b)) | (has_zero(b) & infinite(a)), result)


def _square(a: Interval) -> Interval:
    low, high = magnitude(a)
    result = outward(low * low, high * high)
    return clip_sign(result, True, high == 0)


def _div(a: Interval, b: Interval) -> Interval:
    result = _clip_product(outward(*_corners(np.divide, a, b)), a, b)
    return undefined(has_zero(b), result)


def _smoothed(a: Interval, c: float, roots: int) -> Interval:
    """Return the bounds of a over the `roots`-fold square root of ``a a + c``, which rises."""
    ends = []
    for end in a:
        divisor = _add(_square((end, end)), (c, c))
        for _ in range(roots):
            divisor = INTERVALS["sqrt"](divisor)
        ends.append(_div((end, end), divisor))
    return ends[0][0], ends[1][1]


def _copysign(a: Interval, b: Interval) -> Interval:
    low, high = magnitude(a)
    return np.where(b[0] > 0, low, -high), np.where(b[1] < 0, -low, high)


def _fmod(a: Interval, b: Interval) -> Interval:
    size, divisor = magnitude(a), magnitude(b)
    quotient = _div(a, divisor)
    low, high = np.trunc(quotient[0]), np.trunc(quotient[1])
    bound = np.minimum(size[1], divisor[1])
    whole = np.where(a[0] < 0, -bound, 0.0), np.where(a[1] > 0, bound, 0.0)
    rest = clip(_sub(a, _mul((low, low), divisor)), *whole)
    same = low == high
    result = np.where(same, rest[0], whole[0]), np.where(same, rest[1], whole[1])
    return undefined(np.isnan(low) | infinite(a), result)


def _remainder(a: Interval, b: Interval) -> Interval:
    quotient = _div(a, b)
    low, high = np.rint(quotient[0]), np.rint(quotient[1])
    rest = _sub(a, _mul((low, low), b))
    size = magnitude(a)[1]
    # rounding of a - b k beside a k that is off by rounding near a tie
    bound = magnitude(b)[1] / 2 * (1 + 4 * EPSILON) + 4 * EPSILON * size
    same = low == high
    result = np.where(same, rest[0], -bound), np.where(same, rest[1], bound)
    overflow = ~np.isfinite(low + high) | np.isinf(1.1 * size) | infinite(b)
    return undefined(overflow, result)


def _truth(a: Interval) -> Interval:
    return np.where(has_zero(a), 0.0, 1.0), np.where((a[0] == 0) & (a[1] == 0), 0.0, 1.0)


def _not(a: Interval) -> Interval:
    low, high = _truth(a)
    return 1.0 - high, 1.0 - low


def _known(certain: Any, impossible: Any) -> Interval:
    return np.where(certain, 1.0, 0.0), np.where(impossible, 0.0, 1.0)


def _eq(a: Interval, b: Interval) -> Interval:
    return _known((a[0] == b[1]) & (a[1] == b[0]), (a[1] < b[0]) | (a[0] > b[1]))


def _fmin(a: Interval, b: Interval) -> Interval:
    return np.minimum(a[0], b[0]), np.minimum(a[1], b[1])


def _fmax(a: Interval, b: Interval) -> Interval:
    return np.maximum(a[0], b[0]), np.maximum(a[1], b[1])


def _select(condition: Interval, a: Interval) -> Interval:
    low, high = _truth(condition)
    never, always = high == 0, low == 1
    result = (
        np.where(never, 0.0, np.where(always, a[0], np.minimum(a[0], 0.0))),
        np.where(never, 0.0, np.where(always, a[1], np.maximum(a[1], 0.0))),
    )
    return undefined(np.isnan(condition[0]), result)


def _either(condition: Interval, a: Interval, b: Interval) -> Interval:
    """Return the bounds of `a` where the condition holds, else of `b`; of both where it may."""
    low, high = _truth(condition)
    never, always = high == 0, low == 1
    result = (
        np.where(never, b[0], np.where(always, a[0], np.minimum(a[0], b[0]))),
        np.where(never, b[1], np.where(always, a[1], np.maximum(a[1], b[1]))),
    )
    return taint(*undefined(np.isnan(condition[0]), result))


def _monotone(
    name: str,
    zero: float = np.nan,
    bottom: float = -np.inf,
    top: float = np.inf,
    falling: bool = False,
    pole: bool = False,
) -> Callable[..., Interval]:
    """Return the form of a monotone library function.

    `zero` is where it changes sign (if it increases), `bottom` and `top` bound its values; with a
    `pole` an infinite value at a finite argument is undefined, without one it is an overflow.
    """
    function = OPERATIONS[name].numpy

    def enclose(a: Interval) -> Interval:
        low, high = a[::-1] if falling else a
        result = function(low), function(high)
        if pole:
            low, high = (np.isinf(y) & np.isfinite(x) for x, y in zip(a, result))
            result = undefined(low | high, result)
        result = clip_sign(widen(*result), a[0] >= zero, a[1] <= zero)
        return clip(result, bottom, top)

    return enclose


def _even(increasing: Callable[..., Interval]) -> Callable[..., Interval]:
    return lambda a: increasing(magnitude(a))


def _reaches(a: Interval, period: float, phase: float) -> Any:
    """Return where the interval may hold a point ``(k + phase) period``, rounding included."""
    low, high = a[0] / period - phase, a[1] / period - phase
    low, high = low - 1e-15 * (1 + np.abs(low)), high + 1e-15 * (1 + np.abs(high))
    return (np.floor(high) >= np.ceil(low)) | (np.maximum(np.abs(a[0]), np.abs(a[1])) > _HUGE)


def _wave(name: str, peak: float) -> Callable[..., Interval]:
    """Return the form of sin or cos; `peak` is where it is 1, in turns."""
    function = OPERATIONS[name].numpy

    def enclose(a: Interval) -> Interval:
        one, two = function(a[0]), function(a[1])
        low, high = widen(np.minimum(one, two), np.maximum(one, two))
        low = np.where(_reaches(a, 2 * np.pi, peak + 0.5), -1.0, low)
        high = np.where(_reaches(a, 2 * np.pi, peak), 1.0, high)
        return undefined(infinite(a), clip((low, high), -1.0, 1.0))

    return enclose


def _odd(function: Callable[..., Interval], reach: float) -> Callable[..., Interval]:
    """Return the form with the sign of the argument up to `reach`: widening would lose it."""
    return lambda a: clip_sign(
        function(a), (a[0] >= 0) & (a[1] <= reach), (a[0] >= -reach) & (a[1] <= 0)
    )


_increasing_tan = _monotone("tan")


def _tan(a: Interval) -> Interval:
    return undefined(_reaches(a, np.pi, 0.5) | infinite(a), _increasing_tan(a))


def _atan2(y: Interval, x: Interval) -> Interval:
    result = clip_sign(widen(*_corners(np.arctan2, y, x)), y[0] >= 0, y[1] <= 0)
    branch = has_zero(y) & (x[0] <= 0)  # the jump at the negative axis, and the origin
    low, high = np.where(branch, -_PI, result[0]), np.where(branch, _PI, result[1])
    return clip((low, high), -_PI, _PI)


def _hypot(a: Interval, b: Interval) -> Interval:
    (low_a, high_a), (low_b, high_b) = magnitude(a), magnitude(b)
    result = widen(np.hypot(low_a, low_b), np.hypot(high_a, high_b))
    return clip_sign(result, True, (high_a == 0) & (high_b == 0))


def _pow(a: Interval, b: Interval) -> Interval:
    exponent = b[0]
    whole = (exponent == b[1]) & (np.rint(exponent) == exponent)
    even = whole & (np.fmod(exponent, 2) == 0)
    sizes = magnitude(a)
    base: Interval = np.where(even, sizes[0], a[0]), np.where(even, sizes[1], a[1])
    # of positive bases powers are monotone in base and exponent, of others in the base
    result = widen(*_corners(np.power, base, b))
    odd = whole & ~even
    result = clip_sign(result, base[0] >= 0, odd & (base[1] <= 0))
    at_zero = has_zero(base) & np.where(whole, exponent < 0, exponent <= 0)
    return undefined(at_zero | (~whole & (base[0] < 0)) | infinite(b), result)


INTERVALS: dict[str, Callable[..., Interval]] = {
    "add": _add,
    "sub": _sub,
    "mul": _mul,
    "div": _div,
    "neg": _neg,
    "sqrt": _monotone("sqrt", zero=0.0, bottom=0.0),
    "fabs": magnitude,
    "floor": lambda a: (np.floor(a[0]), np.floor(a[1])),
    "ceil": lambda a: (np.ceil(a[0]), np.ceil(a[1])),
    "copysign": _copysign,
    "sign": lambda a: (np.sign(a[0]), np.sign(a[1])),
    "fmin": _fmin,
    "fmax": _fmax,
    "select": _select,
    "lt": lambda a, b: _known(a[1] < b[0], a[0] >= b[1]),
    "le": lambda a, b: _known(a[1] <= b[0], a[0] > b[1]),
    "eq": _eq,
    "ne": lambda a, b: _not(_eq(a, b)),
    "not": _not,
    "and": lambda a, b: _fmin(_truth(a), _truth(b)),
    "or": lambda a, b: _fmax(_truth(a), _truth(b)),
    "exp": _monotone("exp", bottom=0.0),
    "expm1": _monotone("expm1", zero=0.0, bottom=-1.0),
    "log": _monotone("log", zero=1.0, pole=True),
    "log1p": _monotone("log1p", zero=0.0, pole=True),
    "pow": _pow,
    "sin": _odd(_wave("sin", peak=0.25), 3.0),
    "cos": _wave("cos", peak=0.0),
    "tan": _odd(_tan, 1.5),
    "asin": _monotone("asin", zero=0.0, bottom=-_PI / 2, top=_PI / 2),
    "acos": _monotone("acos", bottom=0.0, top=_PI, falling=True),
    "atan": _monotone("atan", zero=0.0, bottom=-_PI / 2, top=_PI / 2),
    "atan2": _atan2,
    "sinh": _monotone("sinh", zero=0.0),
    "cosh": _even(_monotone("cosh", bottom=1.0)),
    "tanh": _monotone("tanh", zero=0.0, bottom=-1.0, top=1.0),
    "asinh": _monotone("asinh", zero=0.0),
    "acosh": _monotone("acosh", bottom=0.0),
    "atanh": _monotone("atanh", zero=0.0, pole=True),
    "hypot": _hypot,
    "erf": _monotone("erf", zero=0.0, bottom=-1.0, top=1.0),
    "fmod": _fmod,
    "remainder": _remainder,
}
"""The form of every operation on intervals."""
