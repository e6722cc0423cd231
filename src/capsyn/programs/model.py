"""The open-loop problem of a system as programs: all that solving and simulating need."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import PolicyFormatError
from capsyn.programs.builder import restricted
from capsyn.programs.program import Program
from capsyn.validation import finite_number


@dataclass(frozen=True)
class Prediction:
    """Programs of a prediction under a default law, in place of those of `Model` at a constant u.

    They are those of ``f(x, law(x))``, with its total derivative.
    """

    law: Program  # x -> u: the default control [input units]
    step: Program  # (x, dt) -> (x_next, cost)
    adjoint: Program  # (x, dt, rho_next) -> rho
    insertion: Program  # (x, rho, cost, rounding) -> (gradients, scales)

    @staticmethod
    def ports(n: int, m: int, symbols: int) -> dict[str, tuple[Any, Any]]:
        """Return the inputs and outputs of every program."""
        whole = model_ports(n, m, symbols)
        own = {
            name: (tuple(port for port in whole[name][0] if port[0] != "u"), whole[name][1])
            for name in ("step", "adjoint", "insertion")
        }
        return {"law": ((("x", n),), (("u", m),)), **own}


@dataclass(frozen=True)
class Model:
    """Programs of the problem ``P(t0, x0, T, J)``, eq. (4), for n states, m inputs, N symbols.

    Of a problem with exogenous inputs x is the reading: states, and after them the exogenous
    inputs, whose rates and adjoints are 0.

    The step is one of the classical Runge-Kutta method, with the running cost that it gathers; the
    adjoint is the exact reverse derivative of ``rho_next . x_next + cost``: the discrete form of
    eq. (7). The insertion gives the mode insertion gradient of every symbol against the control
    `u`, eq. (6) [cost / time unit], and the largest size it could have, ``|W rho| |W^-1 (f(x, u_i)
    - f(x, u))|`` with the domain widths ``W``, either factor enlarged by what rounding leaves where
    it should vanish: ``rounding |cost|`` and ``rounding |W^-1 f(x, u)|``.
    """

    dynamics: Program  # (x, u) -> xdot, eq. (1) [state unit / time unit]
    step: Program  # (x, u, dt) -> (x_next, cost)
    adjoint: Program  # (x, u, dt, rho_next) -> rho
    running_cost: Program  # x -> cost, eq. (3) [cost / time unit]
    terminal_cost: Program  # x -> (cost, gradient), eq. (3) [cost]; the end value of the adjoint
    insertion: Program  # (x, u, rho, cost, rounding) -> (gradients, scales)
    prediction: Prediction | None = None  # under a default law
    limits: Program | None = None  # x -> limits, each <= 0 where x is allowed
    sample_time: float | None = None  # of a map [time unit]; None: the dynamics are rates

    def to_json(self) -> dict[str, Any]:
        """Return the model as plain data; of what not every model has only what there is."""
        plain = _plain(self, [f.name for f in dataclasses.fields(self) if f.name not in RARE])
        if self.limits is not None:
            plain["limits"] = self.limits.to_json()
        if self.sample_time is not None:
            plain["sample_time"] = self.sample_time
        if self.prediction is not None:
            names = [f.name for f in dataclasses.fields(self.prediction)]
            plain["prediction"] = _plain(self.prediction, names)
        return plain

    def at(self, exogenous: np.ndarray) -> Model:
        """Return the model of the states alone, with the exogenous inputs (k,) fixed."""
        n = dict(self.dynamics.inputs)["x"] - len(exogenous)
        m, symbols = (
            dict(ports)[name]
            for ports, name in ((self.dynamics.inputs, "u"), (self.insertion.outputs, "gradients"))
        )

        def fixed(programs: Any, ports: dict[str, tuple[Any, Any]]) -> dict[str, Program]:
            return {
                name: restricted(getattr(programs, name), inputs, outputs, {"x": exogenous})
                for name, (inputs, outputs) in ports.items()
            }

        prediction = self.prediction
        if prediction is not None:
            prediction = Prediction(**fixed(prediction, Prediction.ports(n, m, symbols)))
        limits = self.limits
        if limits is not None:
            limits = restricted(limits, (("x", n),), limits.outputs, {"x": exogenous})
        programs: dict[str, Any] = fixed(self, model_ports(n, m, symbols))
        return dataclasses.replace(self, **programs, prediction=prediction, limits=limits)

    @staticmethod
    def from_json(data: Any, n: int, m: int, symbols: int) -> Model:
        """Return the model that `to_json` described; `PolicyFormatError` where sizes are others."""
        rare: dict[str, Any] = {}
        if isinstance(data, dict):
            rare = {name: data[name] for name in RARE if name in data}
            data = {name: value for name, value in data.items() if name not in RARE}
        if "prediction" in rare:
            own = _programs(rare["prediction"], Prediction.ports(n, m, symbols))
            rare["prediction"] = Prediction(**own)
        if "limits" in rare:
            rare["limits"] = _limits(rare["limits"], n)
        if "sample_time" in rare:
            finite_number("sample_time", rare["sample_time"], above=0.0)
        programs: dict[str, Any] = _programs(data, model_ports(n, m, symbols))
        return Model(**programs, **rare)


RARE = ("prediction", "limits", "sample_time")
"""What not every model has."""


def _limits(data: Any, n: int) -> Program:
    """Return the program of limits on n states; `PolicyFormatError` where it is another."""
    program = Program.from_json(data)
    if program.inputs != (("x", n),) or [name for name, _ in program.outputs] != ["limits"]:
        raise PolicyFormatError("the program 'limits' in the file has other sizes")
    return program


def _plain(programs: Any, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(programs, name).to_json() for name in names}


def _programs(data: Any, ports: dict[str, tuple[Any, Any]]) -> dict[str, Program]:
    """Return programs of such ports by name; `PolicyFormatError` where they are others."""
    if not isinstance(data, dict) or set(data) != set(ports):
        raise PolicyFormatError("the model in the file must hold " + ", ".join(ports))
    programs = {name: Program.from_json(value) for name, value in data.items()}
    for name, (inputs, outputs) in ports.items():
        if programs[name].inputs != inputs or programs[name].outputs != outputs:
            raise PolicyFormatError(f"the program '{name}' in the file has other sizes")
    return programs


def model_ports(n: int, m: int, symbols: int) -> dict[str, tuple[Any, Any]]:
    """Return the inputs and outputs of every program of a model."""
    x, u, dt = ("x", n), ("u", m), ("dt", 1)
    return {
        "dynamics": ((x, u), (("xdot", n),)),
        "step": ((x, u, dt), (("x_next", n), ("cost", 1))),
        "adjoint": ((x, u, dt, ("rho_next", n)), (("rho", n),)),
        "running_cost": ((x,), (("cost", 1),)),
        "terminal_cost": ((x,), (("cost", 1), ("gradient", n))),
        "insertion": (
            (x, u, ("rho", n), ("cost", 1), ("rounding", 1)),
            (("gradients", symbols), ("scales", symbols)),
        ),
    }


def gathered_cost(running: Program, terminal: Program) -> Program:
    """Return the cost per time that closed loops gather: the running cost of a problem.

    Of a problem without one, whose running cost is the constant 0, it is the terminal cost.
    """
    zeros = [np.zeros((size, 1)) for _, size in running.inputs]
    if running.used_inputs() or running.evaluate(*zeros)[0].any():
        return running
    return terminal.first
