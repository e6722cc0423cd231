"""Bounds of programs and of their slopes over boxes, for the checker of certificates alone.

Interval arithmetic with forward differentiation, apart from `capsyn.programs.intervals`, which the
proofs use. Ends are moved outwards by more than operations and functions err.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import CertificateError
from capsyn.programs.program import Program

ROUND, LIBRARY, TINY = 2.0**-51, 2.0**-46, 1e-300
"""What operations and functions err by, relative, and what is too small for a number."""


@dataclass(frozen=True, eq=False)
class Interval:
    """Numbers between two arrays, NaN where nothing is known; results are rounded outwards."""

    low: Any
    high: Any

    def __add__(self, o: Interval) -> Interval:
        return _wide(self.low + o.low, self.high + o.high)

    def __sub__(self, o: Interval) -> Interval:
        return _wide(self.low - o.high, self.high - o.low)

    def __mul__(self, o: Interval) -> Interval:
        return _corners(np.multiply, self, o)

    def __truediv__(self, o: Interval) -> Interval:
        pole = (o.low <= 0) & (o.high >= 0)
        return _corners(np.divide, self, Interval(np.where(pole, np.nan, o.low), o.high))

    def size(self) -> Interval:
        """Return the bounds of absolute values."""
        a, b = np.abs(self.low), np.abs(self.high)
        zero = (self.low <= 0) & (self.high >= 0)
        return Interval(np.where(zero, 0.0, np.minimum(a, b)), np.maximum(a, b))

    def square(self) -> Interval:
        """Return the bounds of squares."""
        return self.size() * self.size()

    def truth(self) -> Interval:
        """Return 1 where no number is 0, 0 where all are, and both elsewhere."""
        return _known((self.low > 0) | (self.high < 0), (self.low == 0) & (self.high == 0))

    def either(self, a: Interval, b: Interval) -> Interval:
        """Return `a` where this holds, else `b`, and both where it is not known."""
        always, never = self.truth().low == 1, self.truth().high == 0
        low, high = np.minimum(a.low, b.low), np.maximum(a.high, b.high)
        return Interval(
            np.where(always, a.low, np.where(never, b.low, low)),
            np.where(always, a.high, np.where(never, b.high, high)),
        )


ZERO, HALF, ONE, MINUS = (Interval(np.float64(c), np.float64(c)) for c in (0.0, 0.5, 1.0, -1.0))


def _wide(low: Any, high: Any, share: float = ROUND) -> Interval:
    low = low - (np.abs(low) * share + TINY * (low != 0))  # 0 is exact
    return Interval(low, high + (np.abs(high) * share + TINY * (high != 0)))


def _corners(f: Any, a: Interval, b: Interval, share: float = ROUND) -> Interval:
    ends = [f(x, y) for x in (a.low, a.high) for y in (b.low, b.high)]
    low, high = (g(g(ends[0], ends[1]), g(ends[2], ends[3])) for g in (np.minimum, np.maximum))
    if np.any((low == 0) | (high == 0)):  # too small for a number
        low = low - TINY * (
            (low == 0) & (((a.low < 0) & (b.high > 0)) | ((a.high > 0) & (b.low < 0)))
        )
        high = high + TINY * (
            (high == 0) & (((a.low < 0) & (b.low < 0)) | ((a.high > 0) & (b.high > 0)))
        )
    return _wide(low, high, share)


def _known(certain: Any, never: Any) -> Interval:
    return Interval(np.where(certain, 1.0, 0.0), np.where(never, 0.0, 1.0))


def _rising(f: Any) -> Callable[[Interval], Interval]:
    def enclose(a: Interval) -> Interval:
        y, middle = _wide(f(a.low), f(a.high), LIBRARY), f(0.0)
        lost = np.where(np.isnan(y.low + y.high), np.nan, 0.0)
        low = np.where(a.low >= 0, np.maximum(y.low, middle), y.low)
        return Interval(
            low + lost, np.where(a.high <= 0, np.minimum(y.high, middle), y.high) + lost
        )

    return enclose


def _wave(f: Any, peak: float) -> Callable[[Interval], Interval]:
    def enclose(a: Interval) -> Interval:
        def meets(phase: float) -> Any:
            low, high = a.low / (2 * np.pi) - phase, a.high / (2 * np.pi) - phase
            more = 1e-14 * (1 + np.maximum(np.abs(low), np.abs(high)))
            return np.floor(high + more) >= np.ceil(low - more)

        one, two, lost = f(a.low), f(a.high), 0.0 * (a.low + a.high)
        y = _wide(np.minimum(one, two), np.maximum(one, two), LIBRARY)
        low = np.where(meets(peak + 0.5), -1.0, np.maximum(y.low, -1.0)) + lost
        return Interval(low, np.where(meets(peak), 1.0, np.minimum(y.high, 1.0)) + lost)

    return enclose


def _pow(a: Interval, b: Interval) -> Interval:
    whole = (b.low == b.high) & (np.rint(b.low) == b.low)
    even, zero = whole & (np.fmod(b.low, 2) == 0), (a.low <= 0) & (a.high >= 0)
    bad = (~whole & (a.low < 0)) | (zero & (b.low < 0)) | (zero & ~whole & (b.low <= 0))
    low = np.where(bad, np.nan, np.where(even, a.size().low, a.low))
    return _corners(np.power, Interval(low, np.where(even, a.size().high, a.high)), b, LIBRARY)


def _less(a: Interval, b: Interval) -> Interval:
    return _known(a.high < b.low, a.low > b.high)  # or equal: either will do where both are


def _equal(a: Interval, b: Interval) -> Interval:
    return _known((a.low == b.high) & (a.high == b.low), (a.high < b.low) | (a.low > b.high))


def _not(a: Interval) -> Interval:
    return Interval(1 - a.truth().high, 1 - a.truth().low)


def _both(f: Any) -> Callable[[Interval, Interval], Interval]:
    return lambda a, b: Interval(f(a.low, b.low), f(a.high, b.high))


def _remainder(a: Interval, b: Interval) -> Interval:
    turns = a / b
    low, high, most = np.rint(turns.low), np.rint(turns.high), b.size().high * 0.5000001
    one = a - Interval(low, low) * b
    return Interval(np.where(low == high, one.low, -most), np.where(low == high, one.high, most))


SIN, COS, SQRT, LOG = _wave(np.sin, 0.25), _wave(np.cos, 0.0), _rising(np.sqrt), _rising(np.log)
_least, _most, _minus = _both(np.minimum), _both(np.maximum), _both(np.subtract)
Slopes = Callable[..., tuple[Interval | None, ...]]
RULES: dict[str, tuple[Callable[..., Interval], Slopes]] = {
    "add": (lambda a, b: a + b, lambda y, a, b: (ONE, ONE)),
    "sub": (lambda a, b: a - b, lambda y, a, b: (ONE, MINUS)),
    "mul": (lambda a, b: a.square() if a is b else a * b, lambda y, a, b: (b, a)),
    "div": (lambda a, b: a / b, lambda y, a, b: (ONE / b, (ZERO - y) / b)),
    "neg": (lambda a: Interval(-a.high, -a.low), lambda y, a: (MINUS,)),
    "sqrt": (SQRT, lambda y, a: (HALF / y,)),
    "fabs": (Interval.size, lambda y, a: (_known(a.low > 0, a.high < 0) * (ONE + ONE) - ONE,)),
    "fmin": (_least, lambda y, a, b: (_less(a, b), _less(b, a))),
    "fmax": (_most, lambda y, a, b: (_less(b, a), _less(a, b))),
    "exp": (_rising(np.exp), lambda y, a: (y,)),
    "expm1": (_rising(np.expm1), lambda y, a: (y + ONE,)),
    "log": (LOG, lambda y, a: (ONE / a,)),
    "log1p": (_rising(np.log1p), lambda y, a: (ONE / (a + ONE),)),
    "sin": (SIN, lambda y, a: (COS(a),)),
    "cos": (COS, lambda y, a: (ZERO - SIN(a),)),
    "tan": (lambda a: SIN(a) / COS(a), lambda y, a: (ONE + y.square(),)),
    "asin": (_rising(np.arcsin), lambda y, a: (ONE / SQRT(ONE - a.square()),)),
    "atan": (_rising(np.arctan), lambda y, a: (ONE / (ONE + a.square()),)),
    "tanh": (_rising(np.tanh), lambda y, a: (ONE - y.square(),)),
    "sinh": (_rising(np.sinh), lambda y, a: (SQRT(ONE + y.square()),)),
    "asinh": (_rising(np.arcsinh), lambda y, a: (ONE / SQRT(ONE + a.square()),)),
    "hypot": (lambda a, b: SQRT(a.square() + b.square()), lambda y, a, b: (a / y, b / y)),
    "pow": (_pow, lambda y, a, b: (b * _pow(a, _minus(b, ONE)), y * LOG(a))),
    "remainder": (_remainder, lambda y, a, b: (ONE, (y - a) / b)),
    "floor": (lambda a: Interval(np.floor(a.low), np.floor(a.high)), lambda y, a: (None,)),
    "ceil": (lambda a: Interval(np.ceil(a.low), np.ceil(a.high)), lambda y, a: (None,)),
    "sign": (lambda a: Interval(np.sign(a.low), np.sign(a.high)), lambda y, a: (None,)),
    "lt": (lambda a, b: _known(a.high < b.low, a.low >= b.high), lambda y, a, b: (None, None)),
    "le": (lambda a, b: _known(a.high <= b.low, a.low > b.high), lambda y, a, b: (None, None)),
    "eq": (_equal, lambda y, a, b: (None, None)),
    "ne": (lambda a, b: _not(_equal(a, b)), lambda y, a, b: (None, None)),
    "not": (_not, lambda y, a: (None,)),
    "and": (lambda a, b: _least(a.truth(), b.truth()), lambda y, a, b: (None, None)),
    "or": (lambda a, b: _most(a.truth(), b.truth()), lambda y, a, b: (None, None)),
}


def bounds(
    program: Program, values: list[Interval], slopes: list[Interval | None] | None = None
) -> tuple[list[Interval], list[Interval | None]]:
    """Return bounds of the results of a program over boxes, and of their slopes.

    `slopes` are those of the inputs, (n, B) each, None where they are 0. Where a program jumps
    those of its results mean nothing.
    """
    values, d = list(values), list(slopes or [None] * len(values))
    with np.errstate(all="ignore"):
        for name, *operands in program.instructions:
            if name == "const":
                values.append(Interval(np.float64(operands[0]), np.float64(operands[0])))
                d.append(None)
                continue
            of, chosen = [values[k] for k in operands], _alternatives(program, name, operands)
            if chosen is not None:
                condition, one, other = chosen
                values.append(values[condition].either(values[one], values[other]))
                d.append(_either(values[condition], d[one], d[other]))
            elif name == "div" and (root := _smoothed(program, *operands)) is not None:
                value, slope = _root(of[0], *root)
                values.append(value)
                d.append(_chain((slope,), [d[operands[0]]]))
            elif name == "sqrt" and (square := _square_and(program, operands[0])) is not None:
                values.append(SQRT(of[0]))
                d.append(_chain((_root(values[square[0]], square[1], 1)[0],), [d[square[0]]]))
            elif name == "select":
                values.append(of[0].either(of[1], ZERO))
                d.append(_either(of[0], d[operands[1]], None))
            elif name in RULES:
                rule, partial = RULES[name]
                values.append(rule(*of))
                moved = [d[k] for k in operands]
                some = any(one is not None for one in moved)
                d.append(_chain(partial(values[-1], *of), moved) if some else None)
            else:
                raise CertificateError(f"the checker does not know the operation '{name}'")
    return [values[k] for k in program.results], [d[k] for k in program.results]


def _chain(partials: tuple[Interval | None, ...], d: list[Interval | None]) -> Interval | None:
    total = None
    for p, one in zip(partials, d):
        if p is not None and one is not None:
            term = one if p is ONE else Interval(-one.high, -one.low) if p is MINUS else p * one
            total = term if total is None else total + term
    return total


def _either(condition: Interval, a: Interval | None, b: Interval | None) -> Interval | None:
    return None if a is None and b is None else condition.either(a or ZERO, b or ZERO)


def _alternatives(program: Program, name: str, operands: list[int]) -> tuple[int, int, int] | None:
    """Return (c, a, b) of a sum of ``select(c, a)`` and ``select(not c, b)``."""
    for one, other in (operands, operands[::-1]) if name == "add" else ():
        a, b = _instruction(program, one), _instruction(program, other)
        if a[0] == b[0] == "select" and _instruction(program, b[1]) == ("not", a[1]):
            return a[1], a[2], b[2]
    return None


def _instruction(program: Program, value: int) -> Any:
    first = program.input_count
    return program.instructions[value - first] if value >= first else ("input",)


def _square_and(program: Program, value: int) -> tuple[int, float] | None:
    """Return (z, c) of a value that is ``z z + c``, c > 0."""
    name, *operands = _instruction(program, value)
    for square, rest in (operands, operands[::-1]) if name == "add" else ():
        one, constant = _instruction(program, square), _instruction(program, rest)
        if one[0] == "mul" and one[1] == one[2] and constant[0] == "const" and constant[1] > 0:
            return one[1], constant[1]
    return None


def _smoothed(program: Program, z: int, divisor: int) -> tuple[float, int] | None:
    """Return (c, k) of a divisor of z that is the k-fold square root of ``z z + c``, c > 0."""
    k, (name, *operands) = 0, _instruction(program, divisor)
    while name == "sqrt":
        k, divisor = k + 1, operands[0]
        name, *operands = _instruction(program, divisor)
    found = _square_and(program, divisor) if k else None
    return (found[1], k) if found and found[0] == z else None


def _root(z: Interval, c: float, k: int) -> tuple[Interval, Interval]:
    """Return ``z / (z z + c)^e``, e = 2^-k, which rises, and its slope.

    The slope ``(1 - 2 e + 2 e c / q) / q^e`` falls with ``q = z z + c``.
    """

    def power(q: Interval) -> Interval:
        for _ in range(k):
            q = SQRT(q)
        return q

    add, share = Interval(np.float64(c), np.float64(c)), np.float64(2.0 ** (1 - k))
    low, high = (p / power(p.square() + add) for p in (Interval(e, e) for e in (z.low, z.high)))
    q, rest = z.square() + add, Interval(1 - share, 1 - share)
    slope = (rest + Interval(share, share) * add / q) / power(q)
    return Interval(low.low, high.high), slope
