"""Programs made at random, by hypothesis."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import strategies as st

from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program

ARITHMETIC = ("add", "sub", "mul", "mul", "add", "sub", "neg", "div")
CONSTANTS = (0.0, 1.0, -1.0, 2.0, 0.1, 1 / 3, -2.5, 1e-3, 1e200, float("inf"))


@st.composite
def random_program(draw: Callable[..., object], names: tuple[str, ...] = ()) -> Program:
    """Return a program of three inputs and up to 20 operations, half of them arithmetic."""
    names = names or tuple(OPERATIONS)
    inputs = 3
    rows: list[tuple[object, ...]] = []
    for known in range(inputs, inputs + draw(st.integers(1, 20))):
        if draw(st.integers(0, 5)) == 0:
            rows.append(("const", draw(st.sampled_from(CONSTANTS))))
            continue
        name = draw(st.one_of(st.sampled_from(ARITHMETIC), st.sampled_from(names)))
        operands = [draw(st.integers(0, known - 1)) for _ in range(OPERATIONS[name].arity)]
        rows.append((name, *operands))
    size = min(len(rows), 3)
    last = tuple(range(inputs + len(rows) - size, inputs + len(rows)))
    return Program("random", (("x", inputs),), (("y", size),), tuple(rows), last)
