"""Cart-pendulum inversion by energy (Section V of the paper)."""

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
MASS = 1.0  # kg
TOLERANCE = 0.05 * 2 * MASS * GRAVITY * LENGTH  # J; of the energy between hanging and upright


def dynamics(x: Any, u: Any) -> list[Any]:
    """Return ``(omega, (g sin theta + u cos theta) / h)``, eq. (11); `u` accelerates the cart."""
    return [x[1], (GRAVITY * ca.sin(x[0]) + u[0] * ca.cos(x[0])) / LENGTH]


def energy(x: Any) -> Any:
    """Return the pendulum's energy [J], 0 at rest upright."""
    kinetic = 0.5 * MASS * LENGTH**2 * x[1] ** 2
    return kinetic + MASS * GRAVITY * LENGTH * (ca.cos(x[0]) - 1)


def energy_error(x: Any) -> Any:
    """Return the paper's Lyapunov function ``V = |E|`` [J]."""
    return ca.fabs(energy(x))


def has_upright_energy(x: Any) -> Any:
    """Return whether the energy is that of the upright pendulum, to 5 % of what swing-up takes."""
    return energy_error(x) <= TOLERANCE


def cart_pendulum(
    values: tuple[float, ...] = (5.0, -5.0), name: str = "cart-pendulum", price: str = "1%"
) -> Problem:
    """Return the problem of Fig. 3: two accelerations, tracking the upright energy, eq. (12).

    Switching has a `price`, which the paper has not: a cart does not jerk 458 times a second.
    """
    return Problem(
        name=name,
        dynamics=dynamics,
        domain=Box(
            [0.0, -5.0],
            [2 * ca.pi, 5.0],
            names=["theta", "omega"],
            units=["rad", "rad/s"],
            periodic=[True, False],
        ),
        alphabet=Alphabet(values, inputs=["acceleration"], units=["m/s^2"]),
        default=0.0,
        horizon=1.2,
        terminal_cost=lambda x: 0.5 * energy(x) ** 2,
        target=has_upright_energy,
        outside="nearest",
        settings=SsacSettings(gamma=-5.0, control_weight=0.3, sample_time=0.001),
        switching=Switching(price=price),
        description=f"swing-up of a pendulum by {len(values)} accelerations of its cart",
    )


def cart_pendulum_4() -> Problem:
    """Return the problem of Fig. 4a: four accelerations."""
    return cart_pendulum((-5.0, -2.0, 2.0, 5.0), "cart-pendulum-4", "0.3%")
