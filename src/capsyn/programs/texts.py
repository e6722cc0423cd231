"""Programs as source text of other languages, made of known operations and literals only."""

from __future__ import annotations

import json
import math
import re

from capsyn.errors import ProblemError
from capsyn.programs.operations import OPERATIONS, Operation
from capsyn.programs.program import Program

JAVASCRIPT = {
    "fabs": "Math.abs",
    "rint": """x => {
    const nearest = Math.round(x);
    return Math.abs(x % 1) === 0.5 && nearest % 2 !== 0 ? nearest - 1 : nearest;
  }""",
    "copysign": "(x, y) => (y < 0 || Object.is(y, -0) ? -Math.abs(x) : Math.abs(x))",
    "fmod": "(x, y) => x % y",
    "pow": "(x, y) => (x === 1 || (x === -1 && Math.abs(y) === Infinity) ? 1 : Math.pow(x, y))",
    "erf": """x => {
    const square = x * x;
    if (Math.abs(x) > 6) return Math.sign(x);
    if (Math.abs(x) < 2.5) { // Abramowitz and Stegun, 7.1.6
      let term = x, sum = x;
      for (let k = 1; Math.abs(term) > 1e-17 * Math.abs(sum); k++) {
        term *= (2 * square) / (2 * k + 1);
        sum += term;
      }
      return (2 / Math.sqrt(Math.PI)) * Math.exp(-square) * sum;
    }
    let tail = 0; // the continued fraction of erfc, 7.1.14
    for (let k = 60; k > 0; k--) tail = k / 2 / (Math.abs(x) + tail);
    const rest = Math.exp(-square) / Math.sqrt(Math.PI) / (Math.abs(x) + tail);
    return Math.sign(x) * (1 - rest);
  }""",
}
"""Functions of the C library that are not called so in JavaScript's ``Math``."""
PYTHON = {
    "div": "divided({0}, {1})",
    "fabs": "abs({0})",
    "floor": "rounded(math.floor, {0})",
    "ceil": "rounded(math.ceil, {0})",
    "sign": "(float(({0} > 0) - ({0} < 0)) if {0} == {0} else {0})",
    "fmin": "({0} if {0} < {1} or {1} != {1} else {1})",
    "fmax": "({0} if {0} > {1} or {1} != {1} else {1})",
    "select": "({1} if {0} != 0 else 0.0)",
    "not": "float({0} == 0)",
    "and": "float({0} != 0 and {1} != 0)",
    "or": "float({0} != 0 or {1} != 0)",
    "remainder": "{0} - {1} * rounded(round, divided({0}, {1}))",
}
"""Operations that Python has not as C has them."""
PYTHON_HELPERS = {
    "divided": '''
def divided(a, b):
    """Return a / b, infinite or NaN where b is 0."""
    if b:
        return a / b
    return a * math.copysign(math.inf, b) if a else math.nan
''',
    "rounded": '''
def rounded(function, x):
    """Return a rounded number, NaN and infinite ones as they are."""
    return float(function(x)) if math.isfinite(x) else x
''',
    "called": '''
def called(function, *arguments):
    """Return the value of a function as C has it: NaN or infinite where Python raises."""
    x = arguments[0]
    try:
        return float(function(*arguments))
    except ValueError:
        pole = {math.log: 0.0, getattr(math, "log1p", None): -1.0}.get(function)
        if function is math.pow and x == 0:
            odd = arguments[1] % 2 == 1
            return math.copysign(math.inf, x) if odd else math.inf
        if function is math.atanh and abs(x) == 1:
            return math.copysign(math.inf, x)
        return -math.inf if x == pole else math.nan
    except OverflowError:
        odd = function is math.sinh or (function is math.pow and arguments[1] % 2 == 1)
        return -math.inf if odd and x < 0 else math.inf
''',
}
"""Functions that the Python text calls."""


def c_lines(program: Program, inputs: list[str]) -> tuple[list[str], list[str]]:
    """Return C declarations of all values, and the names of the results.

    `inputs` are expressions of the input components, doubles. The functions of ``math.h`` are
    called by their names.
    """
    names, lines = list(inputs), []
    for operation, *operands in program.instructions:
        if operation == "const":
            names.append(_number(float(operands[0]), "INFINITY"))
            continue
        text = re.sub(r"\bm_(\w+)", r"\1", _operation(operation).c)
        text = text.replace("ONE", "1.0").replace("ZERO", "0.0")
        text = text.format(*(names[k] for k in operands))
        names.append(f"v{len(names)}")
        lines.append(f"const double {names[-1]} = {text};")
    return lines, [names[k] for k in program.results]


def calls_library(program: Program) -> bool:
    """Return whether the C text of a program calls functions of ``math.h``."""
    return any(
        name != "const" and "m_" in _operation(name).c or "inf" in map(str, operands)
        for name, *operands in program.instructions
    )


def python_lines(program: Program, inputs: list[str]) -> tuple[list[str], list[str]]:
    """Return Python assignments of all values, and the names of the results.

    `inputs` are expressions of the input components, floats. They call `PYTHON_HELPERS`.
    """
    names, lines = list(inputs), []
    for operation, *operands in program.instructions:
        if operation == "const":
            names.append(_number(float(operands[0]), "math.inf"))
            continue
        if operation in PYTHON:
            text = PYTHON[operation].format(*(names[k] for k in operands))
        elif _operation(operation).libm:
            text = f"called(math.{operation}, {', '.join(names[k] for k in operands)})"
        else:
            text = _operation(operation).c.format(*(names[k] for k in operands))
            text = f"float({text[2:].partition(')')[0]})" if "?" in text else text
        names.append(f"v{len(names)}")
        lines.append(f"{names[-1]} = {text}")
    return lines, [names[k] for k in program.results]


def javascript_lines(program: Program, inputs: list[str]) -> tuple[list[str], list[str]]:
    """Return JavaScript declarations of all values, and the names of the results.

    They call `JAVASCRIPT` by their names, ``m_rint`` and so on.

    Raises
    ------
    ProblemError
        The program has an operation that is not in `OPERATIONS`.
    """
    names, lines = list(inputs), []
    for operation, *operands in program.instructions:
        text = _javascript(operation, operands, names)
        names.append(f"v{len(names)}")
        lines.append(f"const {names[-1]} = {text};")
    return lines, [names[k] for k in program.results]


def _javascript(operation: str, operands: list[float], names: list[str]) -> str:
    """Return an operation's C expression as JavaScript: they differ in names only."""
    if operation == "const":
        return json.dumps(float(operands[0]))  # NaN and Infinity as JavaScript has them
    text = _operation(operation).c.replace("ONE", "1").replace("ZERO", "0")
    text = re.sub(r"\bm_(\w+)", lambda f: f[0] if f[1] in JAVASCRIPT else f"Math.{f[1]}", text)
    return text.format(*(names[int(k)] for k in operands))


def _operation(name: str) -> Operation:
    if name not in OPERATIONS:
        raise ProblemError(f"a program must be of known operations; got {name!r}")
    return OPERATIONS[name]


def _number(number: float, infinity: str) -> str:
    text = infinity if math.isinf(number) else repr(abs(number))
    return f"(-{text})" if number < 0 else text
