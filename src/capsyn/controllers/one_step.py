"""What one sample under each symbol changes of a cost, exactly: compiled, and by NumPy.

That is the cost of a discrete-time prediction whose first step is under a symbol, and all others
under the default control, minus that of one under the default control alone. No derivative enters.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import TIE, Solver, relative_rounding
from capsyn.native.build import load
from capsyn.native.compiled import compiled
from capsyn.native.source import LANES, declarations, hand_written, pointer
from capsyn.programs.builder import bind
from capsyn.programs.program import Program

SAME = 1e-9
"""Costs of symbols within this share of their sizes tie: iterations have no error but rounding."""


@dataclass(frozen=True, eq=False)
class OneStep:
    """The programs of a prediction with one free step."""

    move: Program  # (x, u, dt) -> (x_next, cost)
    step: Program  # (x, dt) -> (x_next, cost), the same under the default control
    terminal_cost: Program  # x -> cost
    controls: np.ndarray  # (N, m) of the symbols [input units]
    tolerance: float  # scales are the sizes of symbols' costs times this,
    rounding: float  # and that of the default's cost times this, which is less

    @staticmethod
    def of(formulation: Formulation, dtype: Any) -> OneStep:
        """Return those of a formulation, in an arithmetic."""
        model, own = formulation.model, formulation.model.prediction
        step = bind(model.step, u=formulation.default) if own is None else own.step
        rounding = relative_rounding(dtype)
        tolerance, end = max(SAME / TIE, rounding), model.terminal_cost.first
        return OneStep(model.step, step, end, formulation.values, tolerance, rounding)


@dataclass(frozen=True, eq=False)
class OneStepKernel:
    """Costs and what symbols change of them, compiled; see `NumpyOneStep`."""

    function: Any
    plan: OneStep

    @staticmethod
    def build(plan: OneStep, precision: str) -> OneStepKernel:
        """Return the kernel of a prediction; `KernelBuildError` if it fails."""
        sizes, symbols = dict(plan.move.inputs), len(plan.controls)
        programs = {name: getattr(plan, name) for name in ("move", "step", "terminal_cost")}
        source = "\n".join(
            [
                declarations(programs.values(), precision, LANES),
                f"#define STATES {sizes['x']}\n#define INPUTS {sizes['u']}",
                f"#define SYMBOLS {symbols}",
                *(program.to_c(name, uniform=["u", "dt"]) for name, program in programs.items()),
                hand_written("controllers/one_step.c"),
            ]
        )
        function = load(source, ("-ffp-contract=off",)).capsyn_one_step
        function.restype = None
        p, real = ctypes.c_void_p, ctypes.c_double
        function.argtypes = [ctypes.c_int64, p, ctypes.c_int, p, real, real, p, p, p]
        return OneStepKernel(function, plan)

    def __call__(
        self, states: np.ndarray, horizon: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (costs (B,), changes (B, N), scales (B, N)) of the states (B, n)."""
        plan = self.plan
        states = np.ascontiguousarray(states, dtype=np.float64)
        cost, symbols = np.empty(len(states)), len(plan.controls)
        changes, scales = np.empty((2, symbols, len(states)))
        controls = np.ascontiguousarray(plan.controls, dtype=np.float64)
        outputs = [pointer(a) for a in (cost, changes, scales)]
        sizes = (plan.tolerance, plan.rounding)
        self.function(len(states), pointer(states), steps, pointer(controls), *sizes, *outputs)
        return cost, changes.T, scales.T


@dataclass(frozen=True, eq=False)
class NumpyOneStep:
    """The same computation by NumPy."""

    plan: OneStep
    dtype: type[np.floating]

    def __call__(
        self, states: np.ndarray, horizon: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (costs (B,), changes (B, N), scales (B, N)) of the states (B, n)."""
        plan, x = self.plan, np.ascontiguousarray(np.asarray(states).T, self.dtype)
        with np.errstate(all="ignore"):
            idle = self._cost(plan.step.evaluate(x, [0.0], dtype=self.dtype), steps)
            each = [
                self._cost(plan.move.evaluate(x, u, [0.0], dtype=self.dtype), steps)
                for u in plan.controls
            ]
            costs = np.stack(each, axis=1)
            scales = plan.tolerance * np.abs(costs) + plan.rounding * np.abs(idle)[:, None]
            return idle, costs - idle[:, None], scales

    def _cost(self, first: list[np.ndarray], steps: int) -> np.ndarray:
        """Return costs (B,) of what one step leads to, and what it costs, and the default after."""
        x, part = first
        total = part[0]
        for _ in range(1, steps):
            x, part = self.plan.step.evaluate(x, [0.0], dtype=self.dtype)
            total = total + part[0]
        cost = self.plan.terminal_cost.evaluate(x, dtype=self.dtype)[0][0]
        return np.asarray(total + cost, dtype=float)


def one_step_solver(formulation: Formulation, backend: str) -> tuple[Solver, str]:
    """Return what finds costs, changes and scales in a formulation of a map, and its backend."""
    precision = formulation.settings.precision
    dtype = np.float32 if precision == "single" else np.float64
    plan = OneStep.of(formulation, dtype)
    kernel = compiled(lambda: OneStepKernel.build(plan, precision), backend, "solving")
    return (kernel, "c") if kernel else (NumpyOneStep(plan, dtype), "numpy")
