"""Sums in programs of which intervals can say more than their terms show."""

from __future__ import annotations

from capsyn.programs.program import Instruction, Program


def exhaustive(program: Program, *values: int) -> bool:
    """Return whether two values are ``a <= b`` and ``b <= a``; gradients of fmax divide by both."""
    one, two = (_instruction(program, k) for k in values)
    return one[0] == two[0] == "le" and one[1:] == two[:0:-1]


def alternatives(program: Program, *values: int) -> tuple[int, int, int] | None:
    """Return (c, a, b) where two values are ``select(c, a)`` and ``select(not c, b)``, else None.

    Their sum is what CasADi makes of ``if_else(c, a, b)``: one of the two.
    """
    for first, second in (values, values[::-1]):
        one, two = _instruction(program, first), _instruction(program, second)
        if one[0] == two[0] == "select" and _instruction(program, two[1]) == ("not", one[1]):
            return one[1], one[2], two[2]
    return None


def _instruction(program: Program, value: int) -> Instruction:
    first = program.input_count
    return program.instructions[value - first] if value >= first else ("input",)
