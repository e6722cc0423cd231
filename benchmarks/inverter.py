"""A three-phase inverter at 20 kHz: predictive control that pays for commutations, as a policy.

The state is the error of the current in stator coordinates and the angle of its reference, whose
speed and size are told: one policy is for all of them. One move is foreseen; a switch costs a price
for each leg that commutates, and the two zero vectors are two symbols. The yardstick is the same
predictive control in a loop of its own, tried out online, where it commutates as much. At a speed
and size that are fixed a policy can also answer a delay of one sample.
"""

import json
import tempfile
import time
from pathlib import Path

import numpy as np

import capsyn
from capsyn.problems import inverter as model
from capsyn.sources.callables import problem_policy
from capsyn.sources.finite_control_set import finite_control_set

SAMPLES, SETTLED = 8000, 200
FULL = 100 * np.pi  # rad / s
TOLD = {
    "5 A": (FULL, 5.0),
    "10 A": (FULL, 10.0),
    "-12 A": (FULL, -12.0),
    "10 A at half speed": (FULL / 2, 10.0),
}
FACTORS = (1.4, 1.2, 1.0, 0.8, 0.6)
VECTORS = np.zeros((8, 2))
ANGLES = np.arange(6) * np.pi / 3
VECTORS[1:7] = 2 / 3 * model.SUPPLY * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
AFFINE = {"leaves": "affine", "partitions": (1, 1, 12, 2, 2), "max_level": 0}
rows = []


def row(what, value, unit="", wanted=""):
    rows.append({"what": what, "value": float(value), "unit": unit, "wanted": wanted})


def moved(x, u, w):
    """Return states (B, 3) after a sample under controls (B, 2), told (B, 2)."""
    speed, current = w.T

    def slope(x):
        phase = np.exp(1j * (x[:, 2] + np.pi / 2))
        error, reference = x[:, 0] + 1j * x[:, 1], current * phase
        drop = model.RESISTANCE * (error + reference) + model.FLUX * speed * phase
        rate = (u[:, 0] + 1j * u[:, 1] - drop) / model.INDUCTANCE - 1j * speed * reference
        return np.stack([rate.real, rate.imag, speed], axis=1)

    k1 = slope(x)
    k2 = slope(x + model.PERIOD / 2 * k1)
    k3 = slope(x + model.PERIOD / 2 * k2)
    return x + model.PERIOD / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + model.PERIOD * k3))


def online(prices, w, delayed=False, foreseen=True):
    """Return rms error [A] and commutations / s (B, 2) of predictive control solved online.

    Prices are (B,), what is told (B, 2). It begins with v0 in force. Its controls may be `delayed`
    by a sample, which may be `foreseen`.
    """
    prices, w = np.asarray(prices), np.asarray(w, dtype=float)
    count = len(prices)
    x, now, errors, taken = np.zeros((count, 3)), np.zeros(count, dtype=int), [], []
    for _ in range(SAMPLES):
        start = moved(x, VECTORS[now], w) if delayed and foreseen else x
        ends = moved(start.repeat(8, 0), np.tile(VECTORS, (count, 1)), w.repeat(8, 0))[:, :2]
        cost = (ends**2).sum(axis=1).reshape(count, 8)
        cost += prices[:, None] * model.PERIOD * model.COMMUTATIONS[now]
        stays = cost[np.arange(count), now] <= cost.min(axis=1) * (1 + 1e-9)
        best = np.where(stays, now, cost.argmin(axis=1))
        x = moved(x, VECTORS[now if delayed else best], w)
        now = best
        errors.append(x[:, :2])
        taken.append(best)
    return np.array(
        [figures(*pair) for pair in zip(np.moveaxis(errors, 1, 0), np.transpose(taken))]
    )


def figures(errors, symbols):
    rms = np.sqrt((errors[SETTLED:] ** 2).sum(axis=1).mean())
    commutations = model.COMMUTATIONS[symbols[:-1], symbols[1:]].sum()
    return rms, commutations / (SAMPLES * model.PERIOD)


def looped(policy, w=None):
    run = capsyn.simulate(policy, [0.0, 0.0, 0.0], SAMPLES * model.PERIOD, exogenous=w)
    return figures(run.states[1:, :2], run.symbols)


def fixed(problem, w, delay=0.0):
    """Return a problem whose exogenous inputs are constants."""
    return problem.replace(
        exogenous=None,
        dynamics=lambda x, u: problem.dynamics(x, u, w),
        terminal_cost=lambda x: problem.terminal_cost(x, w),
        delay=delay,
        partitions=9,
        max_level=3,
    )


def along(direction):
    """Return the error that the zero vector leaves after a sample, along a direction."""

    def feature(x, w):
        rates = model.dynamics(x, [0.0, 0.0], w)
        error = [x[i] + model.PERIOD * rates[i] for i in range(2)]
        return np.cos(direction) * error[0] + np.sin(direction) * error[1]

    return feature


def exported(name, policy, **options):
    """Write the C of a policy, and rows of what it takes where compilers and emulators are."""
    with tempfile.TemporaryDirectory() as folder:
        capsyn.export(policy, "c", folder, safe="v0", **options)
        measured = json.loads(Path(folder, "measured.json").read_text())
    if "cortex-m4" in measured:
        row(f"{name}, C for a Cortex-M4", measured["cortex-m4"]["with_library"], "B")
    if "cortex-m3" in measured.get("worst", {}):
        most = measured["worst"]["cortex-m3"]["next"]["most"]
        row(
            f"{name}, C: from 16-bit readings to a symbol, Cortex-M3",
            most,
            "instructions",
            "<= 4200",
        )


if __name__ == "__main__":
    problem = capsyn.problems.get("inverter")
    told = np.array(list(TOLD.values()))
    repeated = told.repeat(len(FACTORS), axis=0)
    curves = online(np.tile(np.array(FACTORS) * model.PRICE, len(told)), repeated)
    curves = dict(zip(TOLD, curves.reshape(len(told), len(FACTORS), 2)))
    unpriced = dict(zip(TOLD, online(np.zeros(len(told)), told)))

    def report(name, policy, where, bound, w=None):
        rms, rate = looped(policy, w)
        alike = np.interp(rate, curves[where][:, 1], curves[where][:, 0])
        row(f"{name}: rms error", rms, "A")
        row(f"{name}: commutations a second", rate)
        row(f"{name}: rms over that of online control that commutates as much", rms / alike,
            "ratio", bound)  # fmt: skip
        return rms

    control = finite_control_set(problem, 1, sample_time=model.PERIOD)
    policy = capsyn.synthesize(problem, **AFFINE)
    control = finite_control_set(problem, 1, sample_time=model.PERIOD)
    found = capsyn.agreement(policy, 50_000, controller=control)
    share = found.agreeing / found.states
    row("inverter told, affine cells: agreement with one-step control", share, "share")
    row("inverter told, affine cells: cells", policy.cells.leaf_count, "", "<= 100")
    free = capsyn.synthesize(problem.replace(switching=None), **AFFINE)
    for name, w in TOLD.items():
        report(f"inverter told {name}, affine cells", policy, name, "<= 1.03", w)
        row(f"inverter told {name}, affine cells, no price: rms over that of online control",
            looped(free, w)[0] / unpriced[name][0], "ratio", "<= 1.03")  # fmt: skip
    counts = [6 / 8192, 6 / 8192, 2 * np.pi / 8192, 400 / 4096, 30 / 4096]
    exported("inverter told, affine cells", policy, readings="int16", scale=counts, cycles=True)

    begin = time.perf_counter()
    policy = capsyn.synthesize(problem)
    row("inverter told, as built in: synthesis", time.perf_counter() - begin, "s", "<= 30")
    for name, w in TOLD.items():
        report(f"inverter told {name}, as built in", policy, name, "<= 1.1", w)

    directions = {f"along{30 * k}": along(k * np.pi / 6) for k in range(6)}
    tree = capsyn.compress(
        capsyn.synthesize(problem, **AFFINE), "linear", agreement=0.985, features=directions,
        states=20_000,
    )  # fmt: skip
    for name, w in TOLD.items():
        report(f"inverter told {name}, tree", tree, name, "<= 1.03", w)
    row("inverter told, tree: nodes", tree.node_count, "", "<= 200")
    exported("inverter told, tree", tree)

    at_once = {}
    for name, delay in (("cells", 0.0), ("cells, one sample of delay", model.PERIOD)):
        one = fixed(problem, TOLD["10 A"], delay)
        one = problem_policy(finite_control_set(one, 1, sample_time=model.PERIOD), one)
        at_once[name] = report(f"inverter fixed 10 A, {name}", one, "10 A", "<= 1.02")
    soon, late = at_once.values()
    row("inverter fixed 10 A, cells: rms with a sample of delay over that without", late / soon,
        "ratio", "<= 1.05")  # fmt: skip
    row("inverter, online, no price: rms error", unpriced["10 A"][0], "A")
    unforeseen = online([0.0], [TOLD["10 A"]], True, False)[0, 0]
    row("inverter, online, no price, a delay that is not foreseen: rms error", unforeseen, "A")
    print(json.dumps(rows))
