"""Programs made at random, by hypothesis, and intervals, many with ends that are special."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
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


SPECIAL = [0.0, 5e-324, 1e-310, 1e-8, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 7.0, 710.0, 1e6, 1e15 + 0.5]
SPECIAL += [1e300, 1.7976931348623157e308, math.inf]
SPECIAL += [k * math.pi / 4 for k in (1, 2, 3, 4, 6, 8, 1e4, 1e6 + 2)]
SPECIAL = sorted({*SPECIAL, *(-v for v in SPECIAL)})


def random_intervals(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return bounds (2, count): special ones, and random ones of all sizes and places."""
    pairs = np.array(list(itertools.combinations_with_replacement(SPECIAL, 2))).T
    special = pairs[:, rng.integers(0, pairs.shape[1], count // 2)]
    size = 10.0 ** rng.uniform(-3, 2, (1, count - count // 2))
    middle = rng.normal(size=size.shape) * size
    width = rng.random(size.shape) * 10.0 ** rng.uniform(-6, 1, size.shape)
    integer = rng.random(size.shape) < 0.3
    low, high = middle - width, middle + width
    low, high = (np.where(integer, np.rint(v), v) for v in (low, high))
    return np.concatenate([special, np.concatenate([low, high])], axis=1)
