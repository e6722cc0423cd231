"""Discrete-time problems whose maps are written twice: in CasADi, and in NumPy."""

import itertools

import casadi as ca
import numpy as np

from capsyn import Alphabet, Ball, Box, Problem

HARVESTS, WANTED = (0.0, 0.5, 1.0), 0.7


def stock(**changes):
    """Return a stock that grows and is harvested, known from one half day to the next."""
    fields = {
        "name": "stock",
        "dynamics": lambda x, u: [x[0] + 0.5 * (2.2 * x[0] * (1 - x[0]) - u[0] * x[0])],
        "discrete": True,
        "sample_time": 0.5,
        "domain": Box([0.05], [1.4], ["stock"]),
        "alphabet": Alphabet(HARVESTS, inputs=["harvest"]),
        "default": 0.5,
        "horizon": 4,
        "running_cost": lambda x: (x[0] - WANTED) ** 2,
        "terminal_cost": lambda x: (x[0] - WANTED) ** 2,
        "target": Ball([WANTED], 0.1),
        "outside": "nearest",
        "time_unit": "d",
    }
    return Problem(**fields | changes)


def grown(x, u):
    """Return the stock (B,) half a day later."""
    return x + 0.5 * (2.2 * x * (1 - x) - u * x)


def turning(**changes):
    """Return an angle in turns of 2, and its speed, of a motor that is switched, with a load w."""
    fields = {
        "name": "turning",
        "dynamics": lambda x, u, w: [
            x[0] + 0.1 * x[1],
            0.9 * x[1] + 0.3 * u[0] + 0.1 * ca.sin(np.pi * x[0]) + w[0],
        ],
        "discrete": True,
        "sample_time": 0.1,
        "domain": Box([-1, -2], [1, 2], ["angle", "speed"], periodic=[True, False]),
        "exogenous": Box([-0.1], [0.1], ["load"]),
        "alphabet": [-1.0, 0.0, 1.0],
        "default": 0.0,
        "horizon": 6,
        "running_cost": lambda x, w: 1 - ca.cos(np.pi * x[0]) + 0.1 * x[1] ** 2,
        "outside": "nearest",
        "partitions": (4, 4, 2),
        "max_level": 1,
    }
    return Problem(**fields | changes)


def turned(z, u):
    """Return readings (n + k, B) one sample later."""
    angle, speed, load = z
    speed_next = 0.9 * speed + 0.3 * u + 0.1 * np.sin(np.pi * angle) + load
    return np.stack([angle + 0.1 * speed, speed_next, load])


def turning_cost(z):
    """Return the running cost (B,) of readings."""
    return 1 - np.cos(np.pi * z[0]) + 0.1 * z[1] ** 2


def iterated(step, running, end, x, controls):
    """Return what controls in turn cost from states x: running costs, summed, and the end's."""
    total = 0.0
    for u in controls:
        total = total + running(x)
        x = step(x, u)
    return total + end(x)


def stock_costs(x, depth=4):
    """Return the least cost (B, 3) of all sequences of harvests from stocks (B,), by the first."""

    def away(x):
        return (x - WANTED) ** 2

    best = np.full((len(x), len(HARVESTS)), np.inf)
    for sequence in itertools.product(range(len(HARVESTS)), repeat=depth):
        cost = iterated(grown, away, away, x, [HARVESTS[k] for k in sequence])
        best[:, sequence[0]] = np.minimum(best[:, sequence[0]], cost)
    return best
