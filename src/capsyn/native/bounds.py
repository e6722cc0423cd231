"""Bounds of a program over many boxes: compiled lanes, or by NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.native.build import load
from capsyn.native.compiled import compiled
from capsyn.native.source import LANES, declarations, hand_written, pointer
from capsyn.programs.ends import Interval
from capsyn.programs.interval_text import interval_c
from capsyn.programs.intervals import evaluate_intervals
from capsyn.programs.program import Program

LOOP = """
void capsyn_bounds(const int64_t count, const double *lower, const double *upper, double *low,
                   double *high)
{
    double ends[2][INPUTS][LANES] __attribute__((aligned(64)));
    double found[2][OUTPUTS][LANES] __attribute__((aligned(64)));
    for (int64_t first = 0; first < count; first += LANES) {
        const int64_t here = count - first < LANES ? count - first : LANES;
        for (int k = 0; k < INPUTS; ++k)
            for (int64_t lane = 0; lane < LANES; ++lane) { /* the last box fills what is left */
                const int64_t box = first + (lane < here ? lane : here - 1);
                ends[0][k][lane] = lower[k * count + box];
                ends[1][k][lane] = upper[k * count + box];
            }
        bounds((const double(*)[LANES])ends[0], (const double(*)[LANES])ends[1], found[0],
               found[1]);
        for (int k = 0; k < OUTPUTS; ++k)
            for (int64_t lane = 0; lane < here; ++lane) {
                low[k * count + first + lane] = found[0][k][lane];
                high[k * count + first + lane] = found[1][k][lane];
            }
    }
}
"""


@dataclass(frozen=True)
class BoundsKernel:
    """Enclosures of the outputs of a program over boxes, compiled."""

    program: Program
    function: Any

    @staticmethod
    def build(program: Program, inexact: frozenset[int] = frozenset()) -> BoundsKernel:
        """Return the kernel of a program; `KernelBuildError` if it fails."""
        source = "\n".join(
            [
                declarations([program], "double", LANES),
                f"#define INPUTS {program.input_count}\n#define OUTPUTS {len(program.results)}",
                hand_written("programs/intervals.c"),
                interval_c(program, "bounds", inexact),
                LOOP,
            ]
        )
        function = load(source, ("-ffp-contract=off",)).capsyn_bounds
        p = ctypes.c_void_p
        function.restype, function.argtypes = None, [ctypes.c_int64, p, p, p, p]
        return BoundsKernel(program, function)

    def __call__(self, *inputs: Interval) -> list[Interval]:
        """Return enclosures; see `capsyn.programs.intervals.evaluate_intervals`.

        They are those, or wider ones.
        """
        sizes = [size for _, size in self.program.inputs]
        for size, pair in zip(sizes, inputs, strict=True):
            if any(np.ndim(end) != 2 or len(end) != size for end in pair):
                raise ValueError(f"inputs must be pairs of arrays ({size}, B)")
        count = max(np.shape(end)[1] for pair in inputs for end in pair)
        ends = np.empty((2, self.program.input_count, count))
        places = np.split(ends, np.cumsum(sizes)[:-1], axis=1)
        for place, pair in zip(places, inputs):
            place[0], place[1] = pair
        low, high = np.empty((2, len(self.program.results), count))
        self.function(count, *(pointer(array) for array in (*ends, low, high)))
        cuts = np.cumsum([size for _, size in self.program.outputs])[:-1]
        return list(zip(np.split(low, cuts), np.split(high, cuts)))


def box_bounds(
    program: Program, backend: str = "auto", inexact: frozenset[int] = frozenset()
) -> Callable[..., list[Interval]]:
    """Return what bounds a program over boxes, as `evaluate_intervals` does or wider."""
    kernel = compiled(lambda: BoundsKernel.build(program, inexact), backend)
    if kernel is not None:
        return kernel
    return lambda *inputs: evaluate_intervals(program, *inputs, inexact=inexact)
