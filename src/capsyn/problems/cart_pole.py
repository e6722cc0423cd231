"""A pole on a cart whose motor knows two accelerations; four states."""

from __future__ import annotations

from typing import Any

import casadi as ca

from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Box
from capsyn.modelling.problem import Problem
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import Switching

GRAVITY = 9.81  # m/s^2
LENGTH = 2.0  # m


def dynamics(x: Any, u: Any) -> list[Any]:
    """Return the rates of (x, v, theta, omega) under the cart's acceleration."""
    return [x[1], u[0], x[3], (GRAVITY * ca.sin(x[2]) + u[0] * ca.cos(x[2])) / LENGTH]


def cart_pole() -> Problem:
    """Return the problem of balancing a pole on a cart that stays where it is.

    Its switching surface is nearly flat, a case for affine leaves: 5,461 solves. With the tail all
    of 1,000 starts within 5 % of the domain keep ``|theta| <= 0.6`` for 10 s at 1 kHz, and the cart
    ends within 0.2 m of its place; from 30 % of the domain 64 % do. Without a tail, of constant
    leaves and a horizon of 0.6 s (`capsyn.problems.plain`), the pole falls in 92 % of the former.
    """
    return Problem(
        name="cart-pole",
        dynamics=dynamics,
        domain=Box(
            [-2.0, -3.0, -0.6, -3.0],
            [2.0, 3.0, 0.6, 3.0],
            names=["x", "v", "theta", "omega"],
            units=["m", "m/s", "rad", "rad/s"],
        ),
        alphabet=Alphabet([-5.0, 5.0], inputs=["acceleration"], units=["m/s^2"]),
        default=0.0,
        horizon=0.1,
        running_cost=lambda x: x[0] ** 2 + 0.5 * x[1] ** 2 + 10 * x[2] ** 2 + x[3] ** 2,
        tail="riccati",
        settings=SsacSettings(rule="steepest", steps=20, sample_time=0.001),
        switching=Switching(price="1%"),
        partitions=4,
        max_level=1,
        leaves="affine",
        description="balancing a pole on a cart, and holding its place, by two accelerations",
    )
