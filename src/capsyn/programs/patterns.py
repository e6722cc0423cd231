"""Sums in programs of which intervals can say more than their terms show."""

from __future__ import annotations

from capsyn.programs.program import Instruction, Program


def exhaustive(program: Program, *values: int) -> bool:
    """Return whether two values are ``a <= b`` and ``b <= a``; gradients of fmax divide by both."""
    one, two = (instruction(program, k) for k in values)
    return one[0] == two[0] == "le" and one[1:] == two[:0:-1]


def alternatives(program: Program, *values: int) -> tuple[int, int, int] | None:
    """Return (c, a, b) where two values are ``select(c, a)`` and ``select(not c, b)``, else None.

    Their sum is what CasADi makes of ``if_else(c, a, b)``: one of the two.
    """
    for first, second in (values, values[::-1]):
        one, two = instruction(program, first), instruction(program, second)
        if one[0] == two[0] == "select" and instruction(program, two[1]) == ("not", one[1]):
            return one[1], one[2], two[2]
    return None


def smoothed_root(program: Program, z: int, divisor: int) -> tuple[float, int] | None:
    """Return (c, k) where z is divided by the k-fold square root of ``z z + c``, c > 0, else None.

    The quotient then rises with z: so do smoothed signs and square roots. Its derivative,
    ``((1 - p) z^2 + c) / (z^2 + c)^(1 + p / 2)`` with ``p = 2^(1 - k)``, is positive.
    """
    roots = 0
    name, *operands = instruction(program, divisor)
    while name == "sqrt":
        roots += 1
        name, *operands = instruction(program, operands[0])
    if not roots or name != "add":
        return None
    for square, rest in (operands, operands[::-1]):
        constant = instruction(program, rest)
        if instruction(program, square) == ("mul", z, z) and constant[0] == "const":
            return (constant[1], roots) if constant[1] > 0 else None
    return None


def instruction(program: Program, value: int) -> Instruction:
    """Return the instruction that gives a value; ``("input",)`` of an input."""
    first = program.input_count
    return program.instructions[value - first] if value >= first else ("input",)
