"""What all sequences of symbols cost, by their first symbol: compiled, and by NumPy."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.native.build import load
from capsyn.native.source import LANES, declarations, hand_written
from capsyn.programs.program import Program

BATCH = 4096
"""States that NumPy handles at once, and least that a thread gets."""


@dataclass(frozen=True, eq=False)
class Moves:
    """What the moves of all sequences are made of."""

    controls: np.ndarray  # (N, m) of each symbol [input units]
    efforts: np.ndarray  # (N,) what it costs [cost / time unit]
    dt: np.ndarray  # (D,) integration step of each move [time unit]
    steps: np.ndarray  # (D,) ints: integration steps of each move
    prices: np.ndarray  # (N, N) what going from each to each costs [cost], infinite: forbidden


@dataclass(frozen=True, eq=False)
class NumpyCosts:
    """The same computation as the compiled kernel, by NumPy on blocks of states."""

    step: Program
    end: Program
    moves: Moves

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Return costs (B, N) of states (B, n)."""
        count = len(self.moves.controls)
        costs = np.empty((len(states), count))
        with np.errstate(all="ignore"):
            for k in range(0, len(states), BATCH):
                x = np.ascontiguousarray(states[k : k + BATCH].T)
                for symbol in range(count):
                    costs[k : k + BATCH, symbol] = self._least(x, np.zeros(x.shape[1]), [symbol])
        return costs

    def _least(
        self, x: np.ndarray, total: np.ndarray, symbols: Any, depth: int = 0, before: Any = None
    ) -> np.ndarray:
        """Return the least cost (B,) of going on from states (n, B) with one of some symbols.

        The one `before` was in force until then, where prices on switching count.
        """
        moves = self.moves
        if depth == len(moves.dt):
            cost = total + self.end.evaluate(x)[0][0]
            return np.where(np.isnan(cost), np.inf, cost)
        dt, steps = moves.dt[depth], int(moves.steps[depth])
        best = np.full(x.shape[1], np.inf)
        for symbol in symbols:
            price = 0.0 if before is None else moves.prices[before, symbol]
            if np.isinf(price):
                continue
            effort, y, cost = moves.efforts[symbol] * (dt * steps), x, total
            for k in range(steps):
                y, part = self.step.evaluate(y, moves.controls[symbol], [dt])
                cost = cost + effort + part[0] if k == 0 else cost + part[0]
            every = range(len(moves.controls))
            least = self._least(y, cost + price, every, depth + 1, symbol)
            best = np.minimum(best, least)
        return best


@dataclass(frozen=True, eq=False)
class FiniteControlSetKernel:
    """Least costs of sequences by their first symbol, compiled. Safe to call from threads."""

    function: Any
    moves: Moves

    @staticmethod
    def build(step: Program, terminal_cost: Program, moves: Moves) -> FiniteControlSetKernel:
        """Return the kernel of two programs of a model; `KernelBuildError` if it fails.

        ``terminal_cost`` has one output, the cost.
        """
        sizes = dict(step.inputs)
        source = "\n".join(
            [
                declarations([step, terminal_cost], "double", LANES),
                f"#define STATES {sizes['x']}\n#define INPUTS {sizes['u']}",
                f"#define SYMBOLS {len(moves.controls)}\n#define DEPTH {len(moves.dt)}",
                step.to_c("step", uniform=["u", "dt"]),
                terminal_cost.to_c("terminal_cost"),
                hand_written("sources/finite_control_set.c"),
            ]
        )
        function = load(source, ("-ffp-contract=fast",)).capsyn_finite_control_set
        function.restype = None
        p = ctypes.c_void_p
        function.argtypes = [ctypes.c_int64, p, p, p]
        return FiniteControlSetKernel(function, moves)

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Return costs (B, N) of states (B, n)."""
        states = np.ascontiguousarray(states, dtype=np.float64)
        costs = np.empty((len(states), len(self.moves.controls)))
        moves = vars(self.moves).values()
        types = (*(np.float64,) * 3, np.int64, np.float64)
        arrays = [np.ascontiguousarray(array, kind) for array, kind in zip(moves, types)]
        # the `prediction` of the C file is a pointer to each
        plan = (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))
        self.function(len(states), states.ctypes.data, ctypes.addressof(plan), costs.ctypes.data)
        return costs
