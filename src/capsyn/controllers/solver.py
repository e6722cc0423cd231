"""Steps 1 and 2 of sSAC at t0 for batches of states: compiled, and by NumPy."""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.native.build import load
from capsyn.native.compiled import compiled
from capsyn.native.source import LANES, declarations, hand_written, pointer
from capsyn.programs.builder import bind
from capsyn.programs.model import Model

TIE = 1e-5
"""Perturbation of mode insertion gradients, relative to their scales, that makes symbols tie."""
BLOCK = 2048
"""States that the NumPy backend handles at once, so that its buffers stay in the CPU's cache."""
ROUNDING = 64
"""Units of the last place by which quantities that should vanish may differ from 0."""

Solver = Callable[[np.ndarray, float, int], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class SsacKernel:
    """Steps 1 and 2 of sSAC at t0 for batches of states, compiled.

    Calling it with states (B, n), a horizon [time unit] and a number of steps returns the cost
    (B,), the mode insertion gradients (B, N) and their scales (B, N). It is safe to call from
    threads.
    """

    function: Any
    n: int
    symbols: int
    rounding: float

    @staticmethod
    def build(model: Model, precision: str, rounding: float, lanes: int = LANES) -> SsacKernel:
        """Return the kernel of a model whose control is bound; `KernelBuildError` if it fails.

        `rounding` is the input of that name of ``Model.insertion``.
        """
        names = ("step", "adjoint", "terminal_cost", "insertion")
        programs = {name: getattr(model, name) for name in names}
        n, symbols = dict(model.step.inputs)["x"], dict(model.insertion.outputs)["gradients"]
        source = "\n".join(
            [
                declarations(programs.values(), precision, lanes),
                f"#define STATES {n}\n#define SYMBOLS {symbols}\n#define FIRST {first_step(model)}",
                *(
                    program.to_c(name, uniform=["dt", "rounding"])
                    for name, program in programs.items()
                ),
                hand_written("controllers/ssac.c"),
            ]
        )
        function = load(source, ("-ffp-contract=fast",)).capsyn_ssac
        function.restype = ctypes.c_int
        p, real = ctypes.c_void_p, ctypes.c_double
        function.argtypes = [ctypes.c_int64, p, real, ctypes.c_int, real, p, p, p]
        return SsacKernel(function, n, symbols, rounding)

    def __call__(
        self, states: np.ndarray, horizon: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (cost, gradients, scales) of the states (B, n)."""
        states = np.ascontiguousarray(states, dtype=np.float64)
        if states.ndim != 2 or states.shape[1] != self.n:
            raise ValueError(f"`states` must have shape (B, {self.n}); got {states.shape}")
        count = len(states)
        cost = np.empty(count)
        gradients, scales = np.empty((2, self.symbols, count))
        outputs = [pointer(a) for a in (cost, gradients, scales)]
        if self.function(count, pointer(states), horizon, steps, self.rounding, *outputs):
            raise MemoryError(f"no memory for {steps} integration steps")
        return cost, gradients.T, scales.T


def first_step(model: Model) -> int:
    """Return after how many steps the adjoint is taken: 0, or 1 of a map, whose first is free."""
    return 0 if model.sample_time is None else 1


def bind_default(model: Model, default: np.ndarray) -> Model:
    """Return the model with its control fixed where the prediction uses it, or its law followed."""
    if (own := model.prediction) is not None:
        return dataclasses.replace(
            model, step=own.step, adjoint=own.adjoint, insertion=own.insertion
        )
    return dataclasses.replace(
        model,
        step=bind(model.step, u=default),
        adjoint=bind(model.adjoint, u=default),
        insertion=bind(model.insertion, u=default),
    )


def make_solver(model: Model, precision: str, backend: str) -> tuple[Solver, str]:
    """Return a solver of a model whose control is bound, and its backend, "c" or "numpy"."""
    dtype = np.float32 if precision == "single" else np.float64
    rounding = relative_rounding(dtype)
    kernel = compiled(lambda: SsacKernel.build(model, precision, rounding), backend, "solving")
    return (kernel, "c") if kernel else (NumpySolver(model, dtype, rounding), "numpy")


def relative_rounding(dtype: Any) -> float:
    """Return the input `rounding` of ``Model.insertion`` for an arithmetic."""
    return float(ROUNDING * np.finfo(dtype).eps / TIE)


@dataclass(frozen=True)
class NumpySolver:
    """The same computation as the compiled kernel, by NumPy on blocks of states."""

    model: Model
    dtype: type[np.floating]
    rounding: float

    def __call__(
        self, states: np.ndarray, horizon: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (cost (B,), gradients (B, N), scales (B, N)) of states (B, n)."""
        parts = [
            self._block(states[k : k + BLOCK], horizon, steps)
            for k in range(0, max(len(states), 1), BLOCK)
        ]
        cost, gradients, scales = zip(*parts)
        return np.concatenate(cost), np.concatenate(gradients), np.concatenate(scales)

    def _block(
        self, states: np.ndarray, horizon: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        model, dtype = self.model, self.dtype
        dt = [horizon / steps]
        total = np.zeros(len(states), dtype)
        with np.errstate(all="ignore"):
            path = [np.ascontiguousarray(states.T, dtype)]
            for _ in range(steps):
                state, cost = model.step.evaluate(path[-1], dt, dtype=dtype)
                path.append(state)
                total += cost[0]
            cost, rho = model.terminal_cost.evaluate(path[-1], dtype=dtype)
            total += cost[0]
            for state in reversed(path[first_step(model) : -1]):
                (rho,) = model.adjoint.evaluate(state, dt, rho, dtype=dtype)
            gradients, scales = model.insertion.evaluate(
                path[0], rho, total[None, :], [self.rounding], dtype=dtype
            )
        return total.astype(float), gradients.T.astype(float), scales.T.astype(float)
