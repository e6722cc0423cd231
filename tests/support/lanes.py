"""One compiled function from any programs, for tests: the lanes without the hand-written loops."""

from __future__ import annotations

import ctypes

import numpy as np

from capsyn.native.build import load
from capsyn.native.source import declarations
from capsyn.programs.program import Program

LANES = 64


def lanes_source(program: Program, precision: str = "double") -> str:
    """Return the C source of ``lanes(in, out)``, one row of 64 lanes per component."""
    rows = [f"in + {sum(size for _, size in program.inputs[:k])}" for k in range(99)]
    into = rows[: len(program.inputs)]
    out = [
        f"out + {sum(size for _, size in program.outputs[:k])}" for k in range(len(program.outputs))
    ]
    return (
        declarations([program], precision, LANES)
        + program.to_c("run")
        + "void lanes(const real (*restrict in)[LANES], real (*restrict out)[LANES])\n"
        + f"{{ run({', '.join(into + out)}); }}\n"
    )


def run_lanes(program: Program, *inputs: np.ndarray, precision: str = "double") -> list[np.ndarray]:
    """Return the outputs of the compiled program for inputs (size, B)."""
    function = load(lanes_source(program, precision), ("-ffp-contract=fast",)).lanes
    dtype = np.float32 if precision == "single" else np.float64
    data = np.concatenate([np.asarray(a, dtype) for a in inputs])
    count = data.shape[1]
    padded = np.pad(data, ((0, 0), (0, -count % LANES)), mode="edge")
    results = np.empty((len(program.results), padded.shape[1]), dtype)
    for start in range(0, padded.shape[1], LANES):
        block = np.ascontiguousarray(padded[:, start : start + LANES])
        out = np.empty((len(results), LANES), dtype)
        function(*(ctypes.c_void_p(a.ctypes.data) for a in (block, out)))
        results[:, start : start + LANES] = out
    sizes = np.cumsum([size for _, size in program.outputs])
    return np.split(results[:, :count], sizes[:-1])
