"""Programs as expressions for people to read: sums, products and fractions, put in order.

An expression is a tuple, its kind first:

- ``("number", value)``, ``("name", mathml)``;
- ``("sum", ((sign, expression), ..))``, ``("product", (expression, ..))``, the number first;
- ``("fraction", numerator, denominator)``, ``("power", base, exponent)``, ``("root", e, degree)``;
- ``("call", operation, (expression, ..))``, ``("relation", operation, left, right)``;
- ``("cases", value, condition, otherwise)``, and ``("select", condition, value)`` on the way there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from capsyn.programs.program import Program

Expression = tuple[Any, ...]
LARGE = 8
"""Leaves from which an expression gets a name where it is used more than once."""
DEEP = 30
"""Levels from which an expression gets a name in any case."""
EXPONENTS = 2**31
"""Whole exponents below this are added where powers are multiplied."""
RELATIONS = ("lt", "le", "eq", "ne")
FLIPPED = {"lt": "gt", "le": "ge", "eq": "eq", "ne": "ne"}


def number(value: float) -> Expression:
    """Return a number as an expression."""
    return ("number", value)


def expressions(
    program: Program,
    inputs: Sequence[Expression],
    results: Sequence[int],
    names: Iterator[Expression],
) -> tuple[list[Expression], list[tuple[Expression, Expression]]]:
    """Return some results of a program as expressions, and the abbreviations in them.

    `inputs` are its input components. Abbreviations, pairs of the next of `names` and an
    expression, are large parts that are used more than once, and cases within others.
    """
    uses, values = _uses(program, results), list(inputs)
    named: dict[Expression, Expression] = {}

    def name_of(value: Expression) -> Expression:
        value = _whole(value)
        if value not in named:
            named[value] = next(names)
        return named[value]

    def settled(value: Expression) -> Expression:
        """Return a value, by its name where it is a part of cases."""
        return name_of(value) if value[0] == "select" else value

    for k, (operation, *operands) in enumerate(program.instructions, len(values)):
        if not uses[k]:
            values.append(number(math.nan))
        elif operation == "const":
            values.append(number(float(operands[0])))
        else:
            value = _apply(operation, [values[j] for j in operands], settled)
            inner = uses[k] - list(results).count(k)
            large = uses[k] > 1 and _size(value) >= LARGE
            if inner and (value[0] == "cases" or large or _depth(value) >= DEEP):
                value = name_of(value)
            values.append(value)
    return [_whole(values[k]) for k in results], [(name, value) for value, name in named.items()]


def _uses(program: Program, results: Sequence[int]) -> list[int]:
    """Return how many instructions and results need each value."""
    first = program.input_count
    uses = [0] * (first + len(program.instructions))
    for k in results:
        uses[k] += 1
    for k in range(len(uses) - 1, first - 1, -1):
        operation, *operands = program.instructions[k - first]
        if uses[k] and operation != "const":
            for operand in operands:
                uses[operand] += 1
    return uses


def _apply(
    operation: str,
    parts: Sequence[Expression],
    settled: Callable[[Expression], Expression],
) -> Expression:
    if operation == "select":
        return ("select", settled(parts[0]), settled(parts[1]))
    if operation == "add" and parts[0][0] == parts[1][0] == "select":
        for one, other in (parts, parts[::-1]):
            if other[1] == ("call", "not", (one[1],)):
                return ("cases", one[2], one[1], other[2])
    parts = [settled(part) for part in parts]
    if operation in FORMS:
        return FORMS[operation](*parts)
    if operation in RELATIONS:
        left, right = parts
        if left[0] == "number" and right[0] != "number":
            return ("relation", FLIPPED[operation], right, left)
        return ("relation", operation, left, right)
    return ("call", operation, tuple(parts))


def _whole(expression: Expression) -> Expression:
    """Return a part of cases as cases of its own."""
    if expression[0] == "select":
        return ("cases", expression[2], expression[1], number(0.0))
    return expression


def _size(expression: Any) -> int:
    """Return the numbers and names in an expression."""
    if not isinstance(expression, tuple):
        return 0
    return 1 if expression[0] in ("number", "name") else sum(map(_size, expression))


def _depth(expression: Any) -> int:
    """Return how far tuples are nested."""
    if not isinstance(expression, tuple):
        return 0
    return 1 + max(map(_depth, expression), default=0)


def signed(expression: Expression) -> tuple[int, Expression]:
    """Return the sign of an expression that begins with one, and what follows."""
    if expression[0] == "number" and expression[1] < 0:
        return -1, number(-expression[1])
    if expression[0] == "sum" and len(expression[1]) == 1:
        return expression[1][0]
    return 1, expression


def _negative(expression: Expression, sign: int = -1) -> Expression:
    if sign > 0 or expression == number(0.0):
        return expression
    if expression[0] == "sum":
        terms = tuple((-own, term) for own, term in expression[1])
        return terms[0][1] if len(terms) == 1 and terms[0][0] > 0 else ("sum", terms)
    if expression[0] == "number":
        return number(-expression[1])
    return ("sum", ((-1, expression),))


def _sum(left: Expression, right: Expression, sign: int = 1) -> Expression:
    """Return ``left + sign right``: numbers last, equal terms together."""
    terms: list[tuple[int, Expression]] = []
    constant = 0.0
    for own, part in ((1, left), (sign, right)):
        for inner, term in part[1] if part[0] == "sum" else ((1, part),):
            if term[0] == "number":
                constant += own * inner * term[1]
            elif (-own * inner, term) in terms:
                terms.remove((-own * inner, term))
            elif (own * inner, term) in terms:
                where = terms.index((own * inner, term))
                terms[where] = (own * inner, product(number(2.0), term))
            else:
                terms.append((own * inner, term))
    if constant or not terms:
        rest = number(abs(constant))
        terms.append((1 if constant >= 0 or math.isnan(constant) else -1, rest))
    if len(terms) == 1:
        return _negative(terms[0][1], terms[0][0])
    return ("sum", tuple(terms))


def _factors(expression: Expression) -> tuple[list[Expression], list[Expression]]:
    """Return the factors of an expression, and of its denominator."""
    if expression[0] == "fraction":
        return _factors(expression[1])[0], _factors(expression[2])[0]
    return (list(expression[1]) if expression[0] == "product" else [expression]), []


def _gathered(factors: Sequence[Expression]) -> Expression:
    """Return a product: its number first, equal factors as powers."""
    coefficient, powers = 1.0, dict[Expression, int]()
    for factor in factors:
        if factor[0] == "number":
            coefficient *= factor[1]
            continue
        base, exponent = factor, 1
        if factor[0] == "power" and factor[2][0] == "number":
            raised = factor[2][1]
            if raised.is_integer() and abs(raised) < EXPONENTS:
                base, exponent = factor[1], int(raised)
        powers[base] = powers.get(base, 0) + exponent
    parts = [
        base if exponent == 1 else ("power", base, number(float(exponent)))
        for base, exponent in powers.items()
        if exponent
    ]
    if coefficient != 1 or not parts:
        parts.insert(0, number(coefficient))
    return parts[0] if len(parts) == 1 else ("product", tuple(parts))


def product(left: Expression, right: Expression) -> Expression:
    """Return the product of two expressions."""
    (one, left), (other, right) = signed(left), signed(right)
    above, below = (a + b for a, b in zip(_factors(left), _factors(right)))
    if number(0.0) in above:
        return number(0.0)
    top = _gathered(above)
    return _negative(("fraction", top, _gathered(below)) if below else top, one * other)


def _fraction(left: Expression, right: Expression) -> Expression:
    (one, left), (other, right) = signed(left), signed(right)
    (above, below), (under, over) = _factors(left), _factors(right)
    if right == number(1.0) or number(0.0) in above:
        return _negative(left, one * other)
    parts = _gathered(above + over), _gathered(below + under)
    return _negative(("fraction", *parts), one * other)


def _root(inner: Expression) -> Expression:
    if inner[0] == "root":
        return ("root", inner[1], 2 * inner[2])
    return ("root", inner, 2)


def _power(base: Expression, exponent: Expression) -> Expression:
    if exponent == number(0.5):
        return _root(base)
    return base if exponent == number(1.0) else ("power", base, exponent)


FORMS: dict[str, Callable[..., Expression]] = {
    "add": _sum,
    "sub": lambda x, y: _sum(x, y, -1),
    "neg": _negative,
    "mul": product,
    "div": _fraction,
    "sqrt": _root,
    "pow": _power,
    "exp": lambda x: ("power", ("name", "<mi>e</mi>"), x),
    "expm1": lambda x: _sum(("power", ("name", "<mi>e</mi>"), x), number(1.0), -1),
    "log1p": lambda x: ("call", "log", (_sum(number(1.0), x),)),
    "hypot": lambda x, y: _root(_sum(product(x, x), product(y, y))),
}
"""Operations that become other kinds of expressions than calls."""
