"""The same machine in several coordinate systems; in some what a symbol does is constant.

The controllers choose alike in all of them. What differs is the share of the volume on which the
cells have the controller's symbol.
"""

import json

import casadi as ca
import numpy as np

import capsyn
from capsyn import problems
from capsyn.controllers.ssac import policy_controller
from capsyn.problems import building, docking

rows = []


def row(what, value, unit="", wanted=""):
    value = value if isinstance(value, int) else float(value)
    rows.append({"what": what, "value": value, "unit": unit, "wanted": wanted})


def of_room():
    """Return the docking with place and speed along the axes of the port, which do not turn."""

    def dynamics(x, u, w):
        ahead, left, turn = docking.wrench(u)
        c, s, push = ca.cos(x[2]), ca.sin(x[2]), docking.THRUST / docking.MASS
        forces = [push * (c * ahead - s * left), push * (s * ahead + c * left)]
        moment = docking.THRUST * docking.ARM / docking.INERTIA
        return [*(x[k] for k in (3, 4, 5)), *forces, turn * moment]

    def seen(x):  # along the satellite's axes
        c, s = ca.cos(x[2]), ca.sin(x[2])
        place, speed = ([c * a + s * b, c * b - s * a] for a, b in ((x[0], x[1]), (x[3], x[4])))
        return [*place, x[2], *speed, x[5]]

    return problems.get("docking").replace(
        dynamics=dynamics,
        running_cost=lambda x, w: docking.running_cost(seen(x), w),
        target=lambda x, w: docking.has_arrived(seen(x), w),
    )


def of_difference(width, scale):
    """Return the building with the first room's temperature above its setpoint as a state.

    It is counted in `scale` [K], a function of the exogenous inputs, and is at most `width`.
    """
    problem = problems.plain("building")

    def known(x, w):
        return [w[0] + x[0] * scale(w), x[1]]

    def dynamics(x, u, w):
        first, second = building.dynamics(known(x, w), u, w)
        return [first / scale(w), second]

    return problem.replace(
        dynamics=dynamics,
        default=lambda x, w: building.holding(known(x, w), w),
        running_cost=lambda x, w: problem.running_cost(known(x, w), w),
        target=lambda x, w: building.is_comfortable(known(x, w), w),
        domain=capsyn.Box([-width, 21], [width, 27], names=["above", "T2"]),
    )


def near_setpoint(policy, scale, count=20_000):
    """Return the share of states, within 1 K of the setpoint, with another symbol than sSAC's."""
    rng, box = np.random.default_rng(0), problems.get("building").exogenous
    w = rng.uniform(box.lower, box.upper, (count, 2))
    above, second = rng.uniform(-1, 1, count), rng.uniform(21, 27, count)
    first = above / scale(w.T) if scale else above + w[:, 0]
    x = np.stack([first, second], axis=1)
    return np.mean(policy(x, w) != policy_controller(policy).symbols(np.hstack([x, w])))


def building_rows():
    def one(w):
        return 1.0

    def span(w):
        return w[1] - w[0]

    cases = {
        "degC": (problems.plain("building"), None),
        "K above the setpoint": (of_difference(3.0, one), one),
        "shares of outdoor - setpoint": (of_difference(1.0, span), span),
    }
    grids = {
        "640 affine cells": {},
        "constant cells": {"leaves": "constant", "partitions": (16, 6, 5, 3), "max_level": 2},
    }
    for grid, changes in grids.items():
        for name, (problem, scale) in cases.items():
            policy = capsyn.synthesize(problem.replace(**changes))
            what = f"building in {name}, {grid}"
            row(f"{what}: off within 1 K", 100 * near_setpoint(policy, scale), "%")
            row(f"{what}: solves", policy.statistics["solves"])


if __name__ == "__main__":
    building_rows()
    for name, problem in (("the satellite", problems.get("docking")), ("the port", of_room())):
        for parts in ((1, 1, 24, 1, 1, 12, 4), (1, 1, 12, 1, 1, 6, 2)):
            policy = capsyn.synthesize(problem.replace(partitions=parts))
            found = capsyn.monte_carlo(policy, 1000, duration=120, rate=20, seed=1)
            what = f"docking in axes of {name}, {policy.cells.leaf_count:,} cells"
            row(f"{what}: off", 100 * (1 - capsyn.agreement(policy).share), "%")
            row(f"{what}: success of 1,000 loops", 100 * found.success_rate, "%")
    print(json.dumps(rows))
