"""A boost converter, switched between two affine modes."""

from __future__ import annotations

from typing import Any

from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Box
from capsyn.modelling.problem import Problem
from capsyn.modelling.settings import SsacSettings

SUPPLY = 20.0  # V
OUTPUT = 40.0  # V, wanted
INDUCTANCE = 1e-3  # H
CAPACITANCE = 100e-6  # F
LOAD = 20.0  # ohm
CURRENT = OUTPUT**2 / (LOAD * SUPPLY)  # A, in the averaged steady state
DUTY = 1 - SUPPLY / OUTPUT


def dynamics(x: Any, u: Any) -> list[Any]:
    """Return the rates of inductor current and output voltage; `u` is 1 where the switch is on."""
    return [
        (SUPPLY - (1 - u[0]) * x[1]) / INDUCTANCE,
        ((1 - u[0]) * x[0] - x[1] / LOAD) / CAPACITANCE,
    ]


def distance(x: Any) -> Any:
    """Return the energy of the distance from the averaged steady state [mJ]."""
    return 500 * (INDUCTANCE * (x[0] - CURRENT) ** 2 + CAPACITANCE * (x[1] - OUTPUT) ** 2)


def boost_converter() -> Problem:
    """Return the problem of holding 40 V from 20 V by a switch.

    The prediction averages: its default is the duty cycle of the steady state, which is no symbol.
    At 100 kHz all of 500 random starts are within 0.5 A and 1 V from 25 to 30 ms; from rest the
    voltage ends 0.1 V off, by the cell that the steady state lies in.
    """
    return Problem(
        name="boost-converter",
        dynamics=dynamics,
        domain=Box([0.0, 0.0], [12.0, 60.0], names=["current", "voltage"], units=["A", "V"]),
        alphabet=Alphabet([0.0, 1.0], names=["off", "on"], inputs=["switch"], units=["1"]),
        default=DUTY,
        horizon=1e-3,
        running_cost=lambda x: 1000 * distance(x),
        terminal_cost=distance,
        target=Box(
            [CURRENT - 0.5, OUTPUT - 1.0],
            [CURRENT + 0.5, OUTPUT + 1.0],
            names=["current", "voltage"],
        ),
        outside="nearest",
        min_dwell=10e-6,
        settings=SsacSettings(rule="steepest", steps=16, sample_time=5e-6, initial_duration=1e-4),
        max_level=4,
        description="40 V from 20 V by one switch; two affine modes",
    )
