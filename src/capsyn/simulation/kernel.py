"""The closed loop of a policy and a plant, compiled."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.native.build import load
from capsyn.native.source import declarations, hand_written, pointer
from capsyn.policies.lookup import TreeArguments
from capsyn.programs.program import Program

SIMULATION_LANES = 8
UNIFORM = ("dt", "rounding")
"""Inputs of a chooser's programs that are the same in all lanes."""


class LoopArguments(ctypes.Structure):
    """The ``loop`` of simulate.c."""

    _fields_ = [
        ("period", ctypes.c_double),
        *(
            (name, ctypes.c_int64)
            for name in (
                "substeps last outside_error outside_symbol stop symbols outside_at_once"
            ).split()
        ),
        *(
            (name, ctypes.c_void_p)
            for name in "controls holds inputs kinds forbidden transitions".split()
        ),
        ("gap", ctypes.c_int64),
        ("exogenous", ctypes.c_int64),
        ("told", ctypes.c_void_p),
        ("paid", ctypes.c_void_p),
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
        ("effort", real),
        ("fuel", real),
        ("parameters", real, (parameters,)),
        ("control", real, (m,)),
        ("queue", real, (queue, m)),
    ]
    names = "delay symbol held switches outside ended end arrived away alphabet".split()
    return np.dtype([*fields, *((name, whole) for name in names), ("held_inputs", whole, (m,))])


@dataclass(frozen=True)
class SimulationKernel:
    """The closed loop of a policy and a plant, compiled. Safe to call from threads."""

    function: Any

    @staticmethod
    def build(
        dynamics: Program,
        running_cost: Program,
        inside: Program,
        queue: int,
        discrete: bool,
        chooser: tuple[str, Mapping[str, Program]] | None = None,
    ) -> SimulationKernel:
        """Return the kernel of a plant and a target; `KernelBuildError` if it fails.

        A trial remembers `queue` controls: one more than samples of delay, at least 2. Of a
        `discrete` plant the dynamics are a map. A `chooser` gives symbols in place of the cells: C
        source, as simulate.c needs it, and its programs.
        """
        sizes = dict(dynamics.inputs)
        programs = {"dynamics": dynamics, "running_cost": running_cost, "inside": inside}
        text, more = chooser or ("", {})
        source = "\n".join(
            [
                declarations([*programs.values(), *more.values()], "double", SIMULATION_LANES),
                f"#define STATES {sizes['x']}\n#define INPUTS {sizes['u']}",
                f"#define PARAMETERS {sizes.get('p', 0)}\n#define QUEUE {queue}",
                f"#define DISCRETE {int(discrete)}\n#define CHOOSES {int(bool(chooser))}",
                *(program.to_c(name) for name, program in programs.items()),
                *(program.to_c(name, uniform=UNIFORM) for name, program in more.items()),
                hand_written("policies/lookup.c"),
                text,
                hand_written("simulation/simulate.c"),
            ]
        )
        function = load(source, ("-ffp-contract=off",)).capsyn_simulate
        function.restype = None
        p, whole = ctypes.c_void_p, ctypes.c_int64
        function.argtypes = [whole, p, whole, whole, p, p, p, p, p, p, p]
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
        choices: Any = None,
    ) -> None:
        """Run `samples` samples of the trials; `record` is (states, symbols, costs).

        `choices` are the arguments of a chooser, a structure of ctypes.
        """
        arrays = (noise, pushes, *record)
        self.function(
            len(trials),
            pointer(trials),
            first,
            samples,
            ctypes.addressof(loop),
            *(None if a is None else pointer(a) for a in arrays),
            None if choices is None else ctypes.addressof(choices),
        )
