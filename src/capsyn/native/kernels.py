"""Compiled kernels as Python callables on NumPy arrays."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.affine_leaves import ROW_ARRAYS
from capsyn.cells import CellTree
from capsyn.domain import Box
from capsyn.model import Model
from capsyn.native.build import load
from capsyn.native.source import declarations, hand_written
from capsyn.program import Program
from capsyn.split_tree import SplitTree

LANES = 64
SIMULATION_LANES = 8
ACTION_LANES = 8
OUTSIDE, NOT_FINITE = -2, -3
"""What `LookupKernel` writes for states outside the domain, or not finite."""


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


@dataclass(frozen=True)
class SsacKernel:
    """Steps 1 and 2 of sSAC at t0 for batches of states, compiled.

    Calling it with states (B, n), a horizon [s] and a number of steps returns the cost (B,), the
    mode insertion gradients (B, N) and their scales (B, N). It is safe to call from threads.
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
                f"#define STATES {n}\n#define SYMBOLS {symbols}",
                *(
                    program.to_c(name, uniform=["dt", "rounding"])
                    for name, program in programs.items()
                ),
                hand_written("ssac.c"),
            ]
        )
        function = load(source, ("-ffp-contract=fast",)).capsyn_ssac
        function.restype = ctypes.c_int
        p = ctypes.c_void_p
        function.argtypes = [
            ctypes.c_int64,
            p,
            ctypes.c_double,
            ctypes.c_int,
            ctypes.c_double,
            p,
            p,
            p,
        ]
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
        outputs = [_pointer(a) for a in (cost, gradients, scales)]
        if self.function(count, _pointer(states), horizon, steps, self.rounding, *outputs):
            raise MemoryError(f"no memory for {steps} integration steps")
        return cost, gradients.T, scales.T


class TreeArguments(ctypes.Structure):
    """The ``tree`` of lookup.c: where the arrays of a domain and its tree lie."""

    _fields_ = [
        *(
            (name, ctypes.c_void_p)
            for name in "lower upper periodic counts partitions refinement entries splits nodes "
            "planes starts".split()
        ),
        ("oblique", ctypes.c_int64),
        ("shift", ctypes.c_int64),
        ("affine", ctypes.c_int64),
        *(
            (name, ctypes.c_void_p)
            for name in "row_starts row_symbols row_constants row_slopes".split()
        ),
    ]

    @staticmethod
    def of(domain: Box, cells: CellTree | SplitTree) -> TreeArguments:
        """Return the arguments, which keep the arrays alive."""
        arrays = {
            "lower": np.ascontiguousarray(domain.lower),
            "upper": np.ascontiguousarray(domain.upper),
            "periodic": np.array(domain.periodic, dtype=np.uint8),
            "counts": np.array(cells.counts, dtype=np.int64),
        }
        made = TreeArguments(affine=2**63 - 1)
        if isinstance(cells, CellTree):
            arrays["partitions"] = np.array(cells.partitions, dtype=np.int64)
            arrays["refinement"] = np.array(cells.refinement, dtype=np.int64)
            arrays["entries"] = np.ascontiguousarray(cells.entries, dtype=np.int32)
            if cells.splits is not None:
                arrays["splits"] = np.ascontiguousarray(cells.splits, dtype=np.uint16)
            if cells.affine is not None:
                made.affine = cells.affine.first
                for name, values in cells.affine.arrays().items():
                    arrays[name] = np.ascontiguousarray(values, dtype=ROW_ARRAYS[name])
        else:
            arrays["nodes"], arrays["planes"] = (
                cells.rows,
                np.ascontiguousarray(cells.planes, dtype=np.int32),
            )
            made.shift, arrays["starts"] = cells.starts
            made.oblique = bool(len(cells.planes))
        for name, array in arrays.items():
            setattr(made, name, array.ctypes.data)
        made.arrays = arrays
        return made


@dataclass(frozen=True)
class LookupKernel:
    """Labels of states from a tree, compiled for `n` states."""

    function: Any
    n: int

    @staticmethod
    def build(n: int) -> LookupKernel:
        """Return the kernel for `n` states; `KernelBuildError` if it fails."""
        source = f"#define STATES {n}\n" + hand_written("lookup.c")
        function = load(source, ("-ffp-contract=off",)).capsyn_lookup
        function.restype = None
        p = ctypes.c_void_p
        function.argtypes = [ctypes.c_int64, p, p, ctypes.c_int, p]
        return LookupKernel(function, n)

    def __call__(
        self, states: np.ndarray, domain: Box, cells: CellTree | SplitTree, nearest: bool
    ) -> np.ndarray:
        """Return leaf numbers (B,) int32, `OUTSIDE` or `NOT_FINITE`, of states (B, n)."""
        states = np.ascontiguousarray(states, dtype=np.float64)
        labels = np.empty(len(states), dtype=np.int32)
        tree = TreeArguments.of(domain, cells)
        self.function(
            len(states), _pointer(states), ctypes.addressof(tree), nearest, _pointer(labels)
        )
        return labels


class LoopArguments(ctypes.Structure):
    """The ``loop`` of simulate.c."""

    _fields_ = [
        ("period", ctypes.c_double),
        *(
            (name, ctypes.c_int64)
            for name in "substeps dwell last outside_error outside_symbol stop symbols".split()
        ),
        ("controls", ctypes.c_void_p),
        ("gap", ctypes.c_int64),
        ("cells", TreeArguments),
    ]


def trial_type(n: int, m: int, parameters: int, queue: int) -> np.dtype:
    """Return the record of a trial, the ``trial`` of simulate.c."""
    real, whole = np.float64, np.int64
    fields: list[Any] = [
        ("state", real, (n,)),
        ("push", real, (n,)),
        ("cost", real),
        ("rest", real),
        ("parameters", real, (parameters,)),
        ("control", real, (m,)),
        ("queue", real, (queue, m)),
    ]
    names = "delay symbol held switches outside ended end arrived away".split()
    return np.dtype(fields + [(name, whole) for name in names])


@dataclass(frozen=True)
class SimulationKernel:
    """The closed loop of a policy and a plant, compiled. Safe to call from threads."""

    function: Any

    @staticmethod
    def build(
        dynamics: Program, running_cost: Program, inside: Program, queue: int
    ) -> SimulationKernel:
        """Return the kernel of a plant; `KernelBuildError` if it fails.

        Parameters
        ----------
        dynamics : Program ``(x, u) -> xdot`` or ``(x, u, p) -> xdot``
            The plant.
        running_cost, inside : Program of ``x``
            Cost [cost / s], and whether a state is in the target (not 0).
        queue : int
            Controls that a trial remembers: one more than samples of delay, at least 2.
        """
        sizes = dict(dynamics.inputs)
        programs = {"dynamics": dynamics, "running_cost": running_cost, "inside": inside}
        source = "\n".join(
            [
                declarations(programs.values(), "double", SIMULATION_LANES),
                f"#define STATES {sizes['x']}\n#define INPUTS {sizes['u']}",
                f"#define PARAMETERS {sizes.get('p', 0)}\n#define QUEUE {queue}",
                *(program.to_c(name) for name, program in programs.items()),
                hand_written("lookup.c"),
                hand_written("simulate.c"),
            ]
        )
        function = load(source, ("-ffp-contract=off",)).capsyn_simulate
        function.restype = None
        p, whole = ctypes.c_void_p, ctypes.c_int64
        function.argtypes = [whole, p, whole, whole, p, p, p, p, p, p]
        return SimulationKernel(function)

    def __call__(
        self,
        trials: np.ndarray,
        first: int,
        samples: int,
        loop: LoopArguments,
        noise: np.ndarray | None,
        pushes: np.ndarray | None,
        record: Sequence[np.ndarray | None],
    ) -> None:
        """Run `samples` samples of the trials; `record` is (states, symbols, costs)."""
        arrays = (noise, pushes, *record)
        self.function(
            len(trials),
            _pointer(trials),
            first,
            samples,
            ctypes.addressof(loop),
            *(None if a is None else _pointer(a) for a in arrays),
        )


class ActionOptions(ctypes.Structure):
    """The ``options`` of action.c."""

    _fields_ = [
        *(
            (name, ctypes.c_double)
            for name in "horizon gamma alpha_d initial shrink descent exponent tie rounding".split()
        ),
        *(
            (name, ctypes.c_int64)
            for name in "steps search steepest to_default backtracks outside lost gap".split()
        ),
        *((name, ctypes.c_void_p) for name in "values efforts preference feed table".split()),
        ("cells", TreeArguments),
    ]


@functools.lru_cache(maxsize=16)
def action_type(m: int) -> np.dtype:
    """Return the record of an action, the ``action`` of action.c."""
    reals = "cost decrease gradient time start duration".split()
    fields: list[Any] = [(name, np.float64) for name in reals]
    fields += [("control", np.float64, (m,)), ("base", np.float64, (m,))]
    return np.dtype([*fields, ("symbol", np.int64), ("base_symbol", np.int64)])


@dataclass(frozen=True)
class ActionKernel:
    """Whole actions of sSAC, or of SAC where its schedule is given, compiled."""

    function: Any
    n: int
    m: int

    @staticmethod
    def build(model: Model, sac: Program | None) -> ActionKernel:
        """Return the kernel of a model; `KernelBuildError` if it fails.

        Parameters
        ----------
        model : Model
            Its control is an input.
        sac : Program ``(x, u, rho, alpha) -> (control, gradient)``, optional
            The schedule of SAC, in place of ``model.insertion``.
        """
        one = {name: getattr(model, name) for name in ("step", "adjoint", "terminal_cost")}
        many = {
            "step": model.step,
            "terminal_cost": model.terminal_cost,
            **({"insertion": model.insertion} if sac is None else {"sac": sac}),
        }
        sizes = dict(model.dynamics.inputs)
        source = "\n".join(
            [
                declarations([*one.values(), *many.values()], "double", ACTION_LANES),
                f"#define STATES {sizes['x']}\n#define INPUTS {sizes['u']}",
                f"#define SYMBOLS {dict(model.insertion.outputs)['gradients']}",
                f"#define SAC {int(sac is not None)}",
                *(p.to_c(name, uniform=["rounding", "alpha"]) for name, p in many.items()),
                "#undef LANES\n#define LANES 1",
                *(p.to_c(f"{name}_one", uniform=["dt"]) for name, p in one.items()),
                f"#undef LANES\n#define LANES {ACTION_LANES}",
                hand_written("lookup.c"),
                hand_written("action.c"),
            ]
        )
        function = load(source, ("-ffp-contract=off",)).capsyn_action
        function.restype = ctypes.c_int
        p = ctypes.c_void_p
        function.argtypes = [ctypes.c_int64, p, p, p, p]
        return ActionKernel(function, sizes["x"], sizes["u"])

    def __call__(
        self, states: np.ndarray, options: ActionOptions, schedules: np.ndarray | None
    ) -> np.ndarray:
        """Return actions (B,), records of `action_type`, of states (B, n)."""
        states = np.ascontiguousarray(states, dtype=np.float64)
        actions = np.empty(len(states), action_type(self.m))
        where = None if schedules is None else _pointer(schedules)
        pointers = (_pointer(states), ctypes.addressof(options), _pointer(actions), where)
        if self.function(len(states), *pointers):
            raise MemoryError(f"no memory for {options.steps} integration steps")
        return actions
