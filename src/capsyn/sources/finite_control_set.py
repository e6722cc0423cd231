"""Finite-control-set model predictive control: the best of all short sequences of symbols [1]_.

References
----------
.. [1] S. Kouro, P. Cortes, R. Vargas, U. Ammann and J. Rodriguez, Model predictive control - a
   simple and powerful method to control power converters, IEEE Transactions on Industrial
   Electronics 56(6), 2009.
"""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.masks import empty, masks_of_members, preferred
from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.modelling.problem import Problem
from capsyn.modelling.transcription import transcribe
from capsyn.native.build import load
from capsyn.native.compiled import compiled
from capsyn.native.source import LANES, declarations, hand_written
from capsyn.programs.program import Program
from capsyn.validation import BACKENDS, describe, finite_number, one_of, whole_number, whole_numbers

COST_TIE = 1e-9
"""Share of the least cost by which another symbol's may be larger and still tie with it."""
MOST_SEQUENCES = 1_000_000
"""Most sequences of symbols that are tried at a state."""
MOST_DEPTH = 200
"""Most moves of a sequence, which only a single symbol comes near."""
BATCH = 4096
"""States that NumPy handles at once, and least that a thread gets."""

Costs = Callable[[np.ndarray], np.ndarray]
"""``states (B, n) -> costs (B, N)``, safe to call from threads."""


@dataclass(frozen=True, eq=False)
class FiniteControlSet:
    """Finite-control-set predictive control for batches of states.

    Calling it with states (B, n) gives symbols (B,), as `capsyn.subdivide` and others take it.
    Build it with `finite_control_set`.

    Parameters
    ----------
    solver : callable
        What gives the costs.
    backend : "c" or "numpy"
        What the solver is.
    states, symbols : int
        Numbers of states n and of symbols N.
    threads : int
        Threads that solve; the result does not depend on it.
    """

    solver: Costs
    backend: str
    states: int
    symbols: int
    threads: int

    def costs(self, states: np.ndarray) -> np.ndarray:
        """Return the least costs (B, N) of the sequences from states (B, n), by first symbol.

        They are infinite where no sequence has a finite cost.

        Raises
        ------
        ProblemError
            States of another shape.
        """
        states = np.ascontiguousarray(states, dtype=float)
        if states.ndim != 2 or states.shape[1] != self.states:
            raise ProblemError(f"`states` must be of shape (B, {self.states}); got {states.shape}")
        size = max(BATCH, -(-len(states) // self.threads))
        parts = [states[k : k + size] for k in range(0, len(states), size)]
        if len(parts) < 2:
            return self.solver(states)
        with ThreadPoolExecutor(self.threads) as pool:
            return np.concatenate(list(pool.map(self.solver, parts)))

    def masks(self, states: np.ndarray) -> np.ndarray:
        """Return the symbols whose cost ties with the least, as bit masks (B, W), of states.

        A mask is 0 where no sequence has a finite cost. Costs within `COST_TIE` of the least,
        relative to its size, tie.
        """
        costs = self.costs(states)
        least = costs.min(axis=1, keepdims=True)
        with np.errstate(invalid="ignore"):
            good = (costs <= least + COST_TIE * np.abs(least)) & np.isfinite(costs)
        return masks_of_members(good)

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Return the first symbol (B,) of the best sequence from states (B, n).

        Of ties it is the lowest, and -1 where no sequence has a finite cost.
        """
        masks = self.masks(states)
        return np.where(empty(masks), -1, preferred(masks, range(self.symbols)))


def finite_control_set(
    problem: Problem,
    depth: int,
    *,
    sample_time: float,
    blocks: Any = 1,
    steps: int = 1,
    control_weight: Any = None,
    backend: str = "auto",
    threads: int | None = None,
) -> FiniteControlSet:
    """Return finite-control-set predictive control of a problem.

    At a state, all sequences of `depth` symbols are tried; each symbol is held for its block of
    samples. What a sequence costs is the problem's running cost along it, the effort ``u^T R u``
    times the time that each symbol is held, and the problem's terminal cost where it ends. The
    problem's own horizon is not used.

    Parameters
    ----------
    problem : Problem
        System, costs and alphabet.
    depth : int
        Moves of a sequence, 1 to `MOST_DEPTH`.
    sample_time : float
        Time of a sample [time unit of the problem].
    blocks : int or (depth,) ints
        Samples that each move is held (move blocking).
    steps : int
        Runge-Kutta steps per sample.
    control_weight : float or (m, m), optional
        R [cost / (input unit^2 time unit)]. Default: that of the problem's settings.
    backend : "auto", "c" or "numpy"
        Compiled where there is a compiler, or as told.
    threads : int, optional
        Default: one per processor.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or more than `MOST_SEQUENCES` sequences.
    KernelBuildError
        ``backend="c"`` without a working compiler.
    """
    if not isinstance(problem, Problem):
        raise ProblemError(f"`problem` must be a capsyn.Problem; got {describe(problem)}")
    values = problem.alphabet.values
    count = len(values)
    depth = whole_number("depth", depth, least=1, most=MOST_DEPTH)
    if count**depth > MOST_SEQUENCES:
        raise ProblemError(
            f"`depth` must give at most {MOST_SEQUENCES:,} sequences; got {depth}, {count}^{depth} "
            "of them: hold moves longer with `blocks`"
        )
    period = finite_number("sample_time", sample_time, above=0.0)
    held = np.array(whole_numbers("blocks", blocks, depth, least=1, most=1_000_000))
    steps = whole_number("steps", steps, least=1, most=1_000_000)
    settings = problem.settings
    if control_weight is not None:
        settings = dataclasses.replace(settings, control_weight=control_weight)
    efforts = settings.efforts(values)
    one_of("backend", backend, BACKENDS)
    model = transcribe(problem)
    end = model.terminal_cost
    end = Program(end.name, end.inputs, end.outputs[:1], end.instructions, end.results[:1])
    moves = _Moves(values, efforts, np.full(depth, period / steps), held * steps)
    kernel = compiled(
        lambda: FiniteControlSetKernel.build(model.step, end, moves), backend, "predicting"
    )
    solver: Costs = kernel or _NumpyCosts(model.step, end, moves)
    used = "c" if kernel else "numpy"
    return FiniteControlSet(solver, used, problem.domain.n, count, processors(threads))


@dataclass(frozen=True, eq=False)
class _Moves:
    """What the moves of all sequences are made of."""

    controls: np.ndarray  # (N, m) of each symbol [input units]
    efforts: np.ndarray  # (N,) what it costs [cost / time unit]
    dt: np.ndarray  # (D,) integration step of each move [time unit]
    steps: np.ndarray  # (D,) ints: integration steps of each move


@dataclass(frozen=True, eq=False)
class _NumpyCosts:
    """The same computation as the compiled kernel, by NumPy on blocks of states."""

    step: Program
    end: Program
    moves: _Moves

    def __call__(self, states: np.ndarray) -> np.ndarray:
        count = len(self.moves.controls)
        costs = np.empty((len(states), count))
        with np.errstate(all="ignore"):
            for k in range(0, len(states), BATCH):
                x = np.ascontiguousarray(states[k : k + BATCH].T)
                for symbol in range(count):
                    costs[k : k + BATCH, symbol] = self._least(x, np.zeros(x.shape[1]), 0, [symbol])
        return costs

    def _least(self, x: np.ndarray, total: np.ndarray, depth: int, symbols: Any) -> np.ndarray:
        """Return the least cost (B,) of going on from states (n, B) with one of some symbols."""
        moves = self.moves
        if depth == len(moves.dt):
            cost = total + self.end.evaluate(x)[0][0]
            return np.where(np.isnan(cost), np.inf, cost)
        dt, steps = moves.dt[depth], int(moves.steps[depth])
        best = np.full(x.shape[1], np.inf)
        for symbol in symbols:
            effort, y, cost = moves.efforts[symbol] * (dt * steps), x, total
            for k in range(steps):
                y, part = self.step.evaluate(y, moves.controls[symbol], [dt])
                cost = cost + effort + part[0] if k == 0 else cost + part[0]
            least = self._least(y, cost, depth + 1, range(len(moves.controls)))
            best = np.minimum(best, least)
        return best


@dataclass(frozen=True, eq=False)
class FiniteControlSetKernel:
    """Least costs of sequences by their first symbol, compiled. Safe to call from threads."""

    function: Any
    moves: _Moves

    @staticmethod
    def build(step: Program, terminal_cost: Program, moves: _Moves) -> FiniteControlSetKernel:
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
        moves, types = vars(self.moves).values(), (np.float64,) * 3 + (np.int64,)
        arrays = [np.ascontiguousarray(array, kind) for array, kind in zip(moves, types)]
        # the `prediction` of the C file is a pointer to each
        plan = (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))
        self.function(len(states), states.ctypes.data, ctypes.addressof(plan), costs.ctypes.data)
        return costs
