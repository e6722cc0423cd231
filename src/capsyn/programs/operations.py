"""The elementary operations of programs: what NumPy and C do for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Operation:
    """One elementary operation: its NumPy form ``f(*operands, out=)`` and its C expression.

    `libm` is True where the C expression calls a function of the C library, `boolean` where the
    value is always 0 or 1.
    """

    arity: int
    numpy: Callable[..., Any]
    c: str
    libm: bool = False
    boolean: bool = False


def _select(condition: Any, value: Any, out: np.ndarray | None = None) -> Any:
    result = np.where(np.not_equal(condition, 0), value, 0.0)
    if out is None:
        return result
    out[...] = result
    return out


def _erf(value: Any, out: np.ndarray | None = None) -> Any:
    from scipy.special import erf  # heavy, and few models use it

    return erf(value, out=out)


def _remainder(a: Any, b: Any, out: np.ndarray | None = None) -> Any:
    return np.subtract(a, b * np.rint(a / b), out=out)


def _function(name: str, numpy: Callable[..., Any], arity: int = 1) -> Operation:
    operands = ", ".join(f"{{{i}}}" for i in range(arity))
    return Operation(arity, numpy, f"m_{name}({operands})", libm=True)


def _comparison(numpy: Callable[..., Any], c: str) -> Operation:
    return Operation(len(c.split("{")) - 1, numpy, f"(({c}) ? ONE : ZERO)", boolean=True)


OPERATIONS: dict[str, Operation] = {
    "add": Operation(2, np.add, "{0} + {1}"),
    "sub": Operation(2, np.subtract, "{0} - {1}"),
    "mul": Operation(2, np.multiply, "{0} * {1}"),
    "div": Operation(2, np.divide, "{0} / {1}"),
    "neg": Operation(1, np.negative, "-{0}"),
    "sqrt": _function("sqrt", np.sqrt),
    "fabs": _function("fabs", np.fabs),
    "floor": _function("floor", np.floor),
    "ceil": _function("ceil", np.ceil),
    "copysign": _function("copysign", np.copysign, 2),
    "sign": Operation(1, np.sign, "({0} > ZERO ? ONE : ({0} < ZERO ? -ONE : {0} + ZERO))"),
    "fmin": Operation(2, np.fmin, "({0} < {1} ? {0} : ({1} == {1} ? {1} : {0}))"),
    "fmax": Operation(2, np.fmax, "({0} > {1} ? {0} : ({1} == {1} ? {1} : {0}))"),
    "select": Operation(2, _select, "({0} != ZERO ? {1} : ZERO)"),
    "lt": _comparison(np.less, "{0} < {1}"),
    "le": _comparison(np.less_equal, "{0} <= {1}"),
    "eq": _comparison(np.equal, "{0} == {1}"),
    "ne": _comparison(np.not_equal, "{0} != {1}"),
    "not": _comparison(np.logical_not, "{0} == ZERO"),
    "and": _comparison(np.logical_and, "({0} != ZERO) & ({1} != ZERO)"),
    "or": _comparison(np.logical_or, "({0} != ZERO) | ({1} != ZERO)"),
    "exp": _function("exp", np.exp),
    "expm1": _function("expm1", np.expm1),
    "log": _function("log", np.log),
    "log1p": _function("log1p", np.log1p),
    "pow": _function("pow", np.power, 2),
    "sin": _function("sin", np.sin),
    "cos": _function("cos", np.cos),
    "tan": _function("tan", np.tan),
    "asin": _function("asin", np.arcsin),
    "acos": _function("acos", np.arccos),
    "atan": _function("atan", np.arctan),
    "atan2": _function("atan2", np.arctan2, 2),
    "sinh": _function("sinh", np.sinh),
    "cosh": _function("cosh", np.cosh),
    "tanh": _function("tanh", np.tanh),
    "asinh": _function("asinh", np.arcsinh),
    "acosh": _function("acosh", np.arccosh),
    "atanh": _function("atanh", np.arctanh),
    "hypot": _function("hypot", np.hypot, 2),
    "erf": _function("erf", _erf),
    "fmod": _function("fmod", np.fmod, 2),
    "remainder": Operation(2, _remainder, "{0} - {1} * m_rint({0} / {1})"),
}
"""Every operation of a program, beside ``const``. ``select(c, y)`` is ``y`` where ``c != 0``, else
0, whatever `y` is there; ``remainder(a, b)`` is ``a - b round(a / b)``, ties to even."""
