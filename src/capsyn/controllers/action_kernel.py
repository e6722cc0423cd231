"""Whole actions of sSAC and SAC, compiled."""

from __future__ import annotations

import ctypes
import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.native.build import load
from capsyn.native.source import declarations, hand_written, pointer
from capsyn.policies.lookup import TreeArguments
from capsyn.programs.model import Model
from capsyn.programs.program import Program

ACTION_LANES = 8


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
        *(
            (name, ctypes.c_void_p)
            for name in "values efforts preference feed table transitions".split()
        ),
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
        """Return the kernel of a model whose control is an input; `KernelBuildError` if it fails.

        `sac` is the schedule ``(x, u, rho, alpha) -> (control, gradient)`` of SAC, in place of
        ``model.insertion``.
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
                hand_written("policies/lookup.c"),
                hand_written("controllers/action.c"),
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
        where = None if schedules is None else pointer(schedules)
        pointers = (pointer(states), ctypes.addressof(options), pointer(actions), where)
        if self.function(len(states), *pointers):
            raise MemoryError(f"no memory for {options.steps} integration steps")
        return actions
