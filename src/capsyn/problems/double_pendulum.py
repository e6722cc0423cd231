"""A double pendulum, driven at the shoulder (a pendubot) by three torques; four states."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Box
from capsyn.modelling.problem import Problem
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import Switching

GRAVITY = 9.81  # m/s^2
MASS = 1.0  # kg, a point at the end of each link
LENGTH = 1.0  # m, of each link
TORQUE = 5.0  # N m, at the shoulder
TOLERANCE = 0.05  # of the energy between hanging and standing


def dynamics(x: Any, u: Any) -> list[Any]:
    """Return the rates of (shoulder, elbow, their rates); angles from upright, elbow relative."""
    unit = MASS * LENGTH**2
    c, s = ca.cos(x[1]), ca.sin(x[1])
    m11, m12, m22 = unit * (3 + 2 * c), unit * (1 + c), unit
    fall = MASS * GRAVITY * LENGTH
    outer = fall * ca.sin(x[0] + x[1])
    first = unit * s * (2 * x[2] * x[3] + x[3] ** 2) + 2 * fall * ca.sin(x[0]) + outer + u[0]
    second = outer - unit * s * x[2] ** 2
    determinant = m11 * m22 - m12**2
    return [
        x[2],
        x[3],
        (m22 * first - m12 * second) / determinant,
        (m11 * second - m12 * first) / determinant,
    ]


def energy(x: Any) -> Any:
    """Return the energy [J], 0 standing at rest and -58.86 hanging."""
    unit, c = MASS * LENGTH**2, ca.cos(x[1])
    kinetic = (0.5 * (3 + 2 * c) * x[2] ** 2 + (1 + c) * x[2] * x[3] + 0.5 * x[3] ** 2) * unit
    height = 2 * (ca.cos(x[0]) - 1) + ca.cos(x[0] + x[1]) - 1
    return kinetic + MASS * GRAVITY * LENGTH * height


def has_upright_energy(x: Any) -> Any:
    """Return whether the energy is within 5 % of that of standing, relative to hanging."""
    return ca.fabs(energy(x)) <= TOLERANCE * 6 * MASS * GRAVITY * LENGTH


def states(shoulder_rate: float, elbow_rate: float) -> Box:
    """Return all angles, and rates up to these [rad/s]."""
    return Box(
        [0.0, 0.0, -shoulder_rate, -elbow_rate],
        [2 * math.pi, 2 * math.pi, shoulder_rate, elbow_rate],
        names=["shoulder", "elbow", "shoulder_rate", "elbow_rate"],
        units=["rad", "rad", "rad/s", "rad/s"],
        periodic=[True, True, False, False],
    )


GREEDY = {
    "domain": states(6.0, 9.0),
    "settings": SsacSettings(rule="steepest", control_weight=0.5, steps=48, sample_time=0.001),
    "partitions": 4,
    "max_level": 2,
    "leaves": "constant",
}
"""What the problem was before its domain held the rates that its links have."""


def double_pendulum() -> Problem:
    """Return the problem of pumping a double pendulum up to the energy of standing.

    It does not stand up: no torque at the shoulder is asked to balance anything, so that there is
    no equilibrium for a tail. Without a torque the energy E is conserved, and ``dJ_dlam_i =
    E omega_1 u_i``: the torque is against ``E omega_1``, and off where that is within 5 J rad/s,
    between curved surfaces on which the energy, all four states together, decides. The domain holds
    the rates that the links have at the energy of standing: with rates of 6 and 9 rad/s, cells
    beyond which the nearest decides (`capsyn.problems.plain`), the energy is lost again. From
    random states with such rates, at 500 Hz, all of 1,000 starts are within 10 % of the energy of
    standing from 15 to 20 s, after 24,216 solves; of the plain problem, after 109,894, none are.
    """
    return Problem(
        name="double-pendulum",
        dynamics=dynamics,
        domain=states(9.0, 18.0),
        alphabet=Alphabet([-TORQUE, 0.0, TORQUE], inputs=["torque"], units=["N m"]),
        default=0.0,
        horizon=0.5,
        terminal_cost=lambda x: 0.5 * energy(x) ** 2,
        target=has_upright_energy,
        outside="nearest",
        settings=SsacSettings(rule="steepest", control_weight=1.0, steps=48, sample_time=0.001),
        switching=Switching(price="1%"),
        partitions=(5, 6, 5, 6),
        max_level=1,
        leaves="affine",
        description="energy of a double pendulum by three torques at the shoulder",
    )
