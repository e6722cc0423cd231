"""The kernel of finite-control-set predictive control as a Python callable."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.native.build import load
from capsyn.native.kernels import LANES
from capsyn.native.source import declarations, hand_written
from capsyn.program import Program


class PredictionArguments(ctypes.Structure):
    """The ``prediction`` of finite_control_set.c."""

    _fields_ = [(name, ctypes.c_void_p) for name in "controls efforts dt steps".split()]


@dataclass(frozen=True)
class FiniteControlSetKernel:
    """Least costs of sequences by their first symbol, compiled. Safe to call from threads."""

    function: Any
    symbols: int

    @staticmethod
    def build(
        step: Program, terminal_cost: Program, symbols: int, depth: int
    ) -> FiniteControlSetKernel:
        """Return the kernel of two programs of a model; `KernelBuildError` if it fails.

        ``terminal_cost`` has one output, the cost.
        """
        sizes = dict(step.inputs)
        source = "\n".join(
            [
                declarations([step, terminal_cost], "double", LANES),
                f"#define STATES {sizes['x']}\n#define INPUTS {sizes['u']}",
                f"#define SYMBOLS {symbols}\n#define DEPTH {depth}",
                step.to_c("step", uniform=["u", "dt"]),
                terminal_cost.to_c("terminal_cost"),
                hand_written("finite_control_set.c"),
            ]
        )
        function = load(source, ("-ffp-contract=fast",)).capsyn_finite_control_set
        function.restype = None
        p = ctypes.c_void_p
        function.argtypes = [ctypes.c_int64, p, p, p]
        return FiniteControlSetKernel(function, symbols)

    def __call__(
        self,
        states: np.ndarray,
        controls: np.ndarray,
        efforts: np.ndarray,
        dt: np.ndarray,
        steps: np.ndarray,
    ) -> np.ndarray:
        """Return costs (B, N) of states (B, n); controls (N, m), efforts (N,), dt, steps (D,)."""
        states = np.ascontiguousarray(states, dtype=np.float64)
        costs = np.empty((len(states), self.symbols))
        arrays = [
            np.ascontiguousarray(controls, dtype=np.float64),
            np.ascontiguousarray(efforts, dtype=np.float64),
            np.ascontiguousarray(dt, dtype=np.float64),
            np.ascontiguousarray(steps, dtype=np.int64),
        ]
        plan = PredictionArguments(*(array.ctypes.data for array in arrays))
        self.function(len(states), states.ctypes.data, ctypes.addressof(plan), costs.ctypes.data)
        return costs
