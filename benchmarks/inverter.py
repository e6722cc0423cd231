"""A three-phase inverter at 20 kHz: predictive control that pays for commutations, as a policy.

The state is the error of the current in stator coordinates and the angle of its reference. One move
is foreseen; a switch costs a price for each leg that commutates, and the two zero vectors are two
symbols. The yardstick is the same predictive control in a loop of its own, tried out online.
"""

import json

import casadi as ca
import numpy as np

import capsyn
from capsyn.sources.callables import problem_policy
from capsyn.sources.finite_control_set import finite_control_set

SUPPLY, RESISTANCE, INDUCTANCE, SPEED, FLUX, CURRENT = 540.0, 0.5, 10e-3, 100 * np.pi, 0.4, 10.0
PERIOD, SAMPLES, SETTLED = 50e-6, 8000, 200
LEGS = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1), (1, 0, 1), (1, 1, 1)]
)
ANGLES = np.arange(6) * np.pi / 3
VECTORS = np.zeros((8, 2))
VECTORS[1:7] = 2 / 3 * SUPPLY * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
COMMUTATIONS = np.abs(LEGS[:, None] - LEGS).sum(axis=2)
PRICE = 1e4
"""Of a commutation [A^2 / s]."""
rows = []


def row(what, value, unit="", wanted=""):
    rows.append({"what": what, "value": float(value), "unit": unit, "wanted": wanted})


def rates(x, u, cos, sin):
    """Return the rates of the error [A / s] and the angle [rad / s]."""
    idle = [-RESISTANCE * (x[0] - CURRENT * sin), -RESISTANCE * (x[1] + CURRENT * cos)]
    emf, turning = (
        (-SPEED * FLUX * sin, SPEED * FLUX * cos),
        (-SPEED * CURRENT * cos, -SPEED * CURRENT * sin),
    )
    return [(u[i] + idle[i] - emf[i]) / INDUCTANCE - turning[i] for i in range(2)] + [SPEED]


def inverter(price=PRICE, delay=0.0, max_level=3):
    """Return the problem with a price of a commutation [A^2 / s] and a delay [s]."""
    return capsyn.Problem(
        name="inverter",
        dynamics=lambda x, u: rates(x, u, ca.cos(x[2]), ca.sin(x[2])),
        domain=capsyn.Box([-6, -6, 0], [6, 6, 2 * np.pi], periodic=[False, False, True]),
        alphabet=capsyn.Alphabet(VECTORS, names=[f"v{k}" for k in range(8)]),
        default=[0.0, 0.0],
        horizon=PERIOD,
        terminal_cost=lambda x: x[0] ** 2 + x[1] ** 2,
        settings=capsyn.SsacSettings(rule="steepest", sample_time=PERIOD),
        outside="nearest",
        max_level=max_level,
        switching=capsyn.Switching(price=price * COMMUTATIONS),
        delay=delay,
    )


def moved(x, u):
    """Return states (B, 3) after a sample under controls (B, 2)."""

    def slope(x):
        return np.stack(
            np.broadcast_arrays(*rates(x.T, u.T, np.cos(x[:, 2]), np.sin(x[:, 2]))), axis=1
        )

    k1 = slope(x)
    k2 = slope(x + PERIOD / 2 * k1)
    k3 = slope(x + PERIOD / 2 * k2)
    return x + PERIOD / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + PERIOD * k3))


def online(price, delayed=False, foreseen=True):
    """Return rms error [A] and commutations / s of predictive control that is solved online.

    It begins with v0 in force. Its controls may be `delayed` by a sample, which may be `foreseen`.
    """
    x, now, errors, taken = np.zeros((1, 3)), 0, [], []
    for _ in range(SAMPLES):
        start = moved(x, VECTORS[[now]]) if delayed and foreseen else x
        ends = moved(np.repeat(start, 8, axis=0), VECTORS)[:, :2]
        cost = (ends**2).sum(axis=1) + price * PERIOD * COMMUTATIONS[now]
        best = now if cost[now] <= cost.min() * (1 + 1e-9) else int(cost.argmin())
        x = moved(x, VECTORS[[now if delayed else best]])
        now = best
        errors.append(x[0, :2])
        taken.append(best)
    return figures(np.array(errors), np.array(taken))


def figures(errors, symbols):
    rms = np.sqrt((errors[SETTLED:] ** 2).sum(axis=1).mean())
    return rms, COMMUTATIONS[symbols[:-1], symbols[1:]].sum() / (SAMPLES * PERIOD)


def looped(policy):
    run = capsyn.simulate(policy, [0.0, 0.0, 0.0], SAMPLES * PERIOD)
    return figures(run.states[1:, :2], run.symbols)


def along(direction):
    """Return the error that the zero vector leaves after a sample, along a direction."""

    def feature(x):
        slope = rates(x, [0.0, 0.0], ca.cos(x[2]), ca.sin(x[2]))
        error = [x[i] + PERIOD * slope[i] for i in range(2)]
        return np.cos(direction) * error[0] + np.sin(direction) * error[1]

    return feature


if __name__ == "__main__":
    curve = np.array([online(PRICE * factor) for factor in (1.4, 1.2, 1.0, 0.8, 0.6)])

    def report(name, policy, bound):
        rms, rate = looped(policy)
        alike = np.interp(rate, curve[:, 1], curve[:, 0])
        row(f"inverter, {name}: rms error", rms, "A")
        row(f"inverter, {name}: commutations a second", rate)
        row(f"inverter, {name}: rms over that of online control that commutates as much",
            rms / alike, "ratio", bound)  # fmt: skip
        return rms

    problem = inverter()
    control = finite_control_set(problem, 1, sample_time=PERIOD)
    policy = problem_policy(control, problem)
    at_once = report("cells", policy, "<= 1.02")
    directions = {f"along{30 * k}": along(k * np.pi / 6) for k in range(6)}
    tree = capsyn.compress(
        problem_policy(control, problem, max_level=1), "linear", controller=control,
        agreement=0.99, features=directions, states=20_000,
    )  # fmt: skip
    report("tree", tree, "<= 1.02")
    row("inverter, tree: nodes", tree.node_count, "", "<= 200")
    late = inverter(delay=PERIOD)
    late = problem_policy(finite_control_set(late, 1, sample_time=PERIOD), late)
    rms = report("cells, one sample of delay", late, "<= 1.02")
    row(
        "inverter, cells: rms with a sample of delay over that without",
        rms / at_once,
        "ratio",
        "<= 1.05",
    )
    row("inverter, online, no price: rms error", online(0.0)[0], "A")
    row(
        "inverter, online, no price, a delay that is not foreseen: rms error",
        online(0.0, True, False)[0],
        "A",
    )
    print(json.dumps(rows))
