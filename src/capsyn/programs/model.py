"""The open-loop problem of a system as programs: all that solving and simulating need."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from capsyn.errors import PolicyFormatError
from capsyn.programs.program import Program


@dataclass(frozen=True)
class Model:
    """Programs of the problem ``P(t0, x0, T, J)``, eq. (4), for n states, m inputs, N symbols.

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

    def to_json(self) -> dict[str, Any]:
        """Return the model as plain data."""
        return {f.name: getattr(self, f.name).to_json() for f in dataclasses.fields(self)}

    @staticmethod
    def from_json(data: Any, n: int, m: int, symbols: int) -> Model:
        """Return the model that `to_json` described; `PolicyFormatError` where sizes are others."""
        ports = model_ports(n, m, symbols)
        if not isinstance(data, dict) or set(data) != set(ports):
            raise PolicyFormatError("the model in the file must hold " + ", ".join(ports))
        programs = {name: Program.from_json(value) for name, value in data.items()}
        for name, (inputs, outputs) in ports.items():
            if programs[name].inputs != inputs or programs[name].outputs != outputs:
                raise PolicyFormatError(f"the program '{name}' in the file has other sizes")
        return Model(**programs)


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
