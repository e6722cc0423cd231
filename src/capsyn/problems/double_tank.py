"""Two tanks, one above the other, with on/off valves (Section VI of the paper)."""

from __future__ import annotations

import itertools
from typing import Any

import casadi as ca

from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.problem import Problem
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import Switching

HEIGHT = 0.5  # of the upper tank above the lower
SMOOTHING = 1e-6  # of the square root at 0


def signed_root(z: Any) -> Any:
    """Return ``z / (z^2 + e^2)^(1/4)``: the square root, odd in `z`, smooth at 0, e = 1e-6.

    The printed square roots have negative arguments for ``x1 < x2 - h`` and infinite slopes at 0;
    here liquid flows back where the level beyond the valve is higher.
    """
    return z / ca.sqrt(ca.sqrt(z * z + SMOOTHING**2))


def dynamics(x: Any, u: Any) -> list[Any]:
    """Return the rates of the two levels, eq. (13), for inputs (V1, V2, V3)."""
    head = ca.if_else(x[1] > HEIGHT, x[0] - x[1] + HEIGHT, x[0])
    between = u[1] * signed_root(head)
    return [u[0] - between, between - u[2] * signed_root(x[1])]


def _tank(
    name: str,
    alphabet: Alphabet,
    goal: tuple[float, float],
    tolerance: float,
    settings: SsacSettings,
    price: str,
    description: str,
) -> Problem:
    def distance(x: Any) -> Any:
        return (x[0] - goal[0]) ** 2 + (x[1] - goal[1]) ** 2

    return Problem(
        name=name,
        dynamics=dynamics,
        domain=Box([0.0, 0.0], [1.0, 1.0], names=["x1", "x2"], units=["m", "m"]),
        alphabet=alphabet,
        default=[0.0, 0.0, 0.0],
        horizon=0.5,
        running_cost=distance,
        terminal_cost=lambda x: 100 * distance(x),
        target=Ball(goal, tolerance),
        settings=settings,
        switching=Switching(price=price),
        description=description,
    )


def double_tank_a() -> Problem:
    """Return case A: all three valves controlled, goal (0.8, 0.2).

    Closing all valves freezes the levels, and wins where no symbol comes nearer to the wanted
    sensitivity: with the paper's gamma = -5 up to 0.12 from the goal, outside the target, where 6
    of 10,000 trials end. With gamma = -10 that radius is 0.05.
    """
    return _tank(
        "double-tank-a",
        Alphabet(list(itertools.product((0.0, 1.0), repeat=3)), inputs=["V1", "V2", "V3"]),
        goal=(0.8, 0.2),
        tolerance=0.1,
        settings=SsacSettings(gamma=-10.0, sample_time=0.001),
        price="0.3%",
        description="levels of two tanks by three on/off valves",
    )


def double_tank_b() -> Problem:
    """Return case B: the middle valve stays at 0.2, goal (0.4, 0.6)."""
    values = [(v1, 0.2, v3) for v1, v3 in itertools.product((0.0, 1.0), repeat=2)]
    return _tank(
        "double-tank-b",
        Alphabet(values, inputs=["V1", "V2", "V3"]),
        goal=(0.4, 0.6),
        tolerance=0.05,
        settings=SsacSettings(rule="steepest", sample_time=0.001),
        price="4%",
        description="levels of two tanks by two on/off valves, the one between them ajar",
    )
