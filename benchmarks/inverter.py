"""A three-phase inverter at 20 kHz: predictive control that pays for commutations, as a policy.

The policy is told the speed and the size of the current's reference, which rotates. The yardstick
is the same control solved online by trying out all symbols, in the same loop, where it commutates
as much, which its price decides. With speed and size fixed a tree is made, and a policy that
compensates a delay of one sample, as those with affine cells cannot.
"""

import json
import tempfile
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
"""Speed [rad / s] and size [A] of references."""
W = np.array(list(TOLD.values()))
PRICES = model.PRICE * np.array([1.4, 1.2, 1.0, 0.8, 0.6])
VECTORS = np.zeros((8, 2))
ANGLES = np.arange(6) * np.pi / 3
VECTORS[1:7] = 2 / 3 * model.SUPPLY * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
COUNTS = [6 / 8192, 6 / 8192, 2 * np.pi / 8192, 400 / 4096, 30 / 4096]
"""What a count of a 16-bit reading stands for, by state and exogenous input."""
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


def online(prices):
    """Return predictive control that tries out all symbols, at prices (B,)."""

    def choose(x, w, now):
        ends = moved(x.repeat(8, 0), np.tile(VECTORS, (len(x), 1)), w.repeat(8, 0))[:, :2]
        cost = (ends**2).sum(axis=1).reshape(-1, 8)
        cost += prices[:, None] * model.PERIOD * model.COMMUTATIONS[now]
        stays = cost[np.arange(len(x)), now] <= cost.min(axis=1) * (1 + 1e-9)
        return np.where(stays, now, cost.argmin(axis=1))

    return choose


def lookup(policy):
    """Return the choice of a policy, which may be told nothing."""
    told = policy.exogenous is not None
    return lambda x, w, now: policy(x, w if told else None, current=now)


def loop(choose, w, delayed=False):
    """Return rms errors [A] and commutations / s (B,) of loops told (B, 2), from v0 and no error.

    ``choose(x, w, now)`` gives symbols (B,) at states (B, 3) with symbols (B,) in force. They act a
    sample later where they are `delayed`.
    """
    x, now, squares, commutations = np.zeros((len(w), 3)), np.zeros(len(w), dtype=int), 0, 0
    for k in range(SAMPLES):
        symbols = choose(x, w, now)
        x = moved(x, VECTORS[now if delayed else symbols], w)
        commutations = commutations + model.COMMUTATIONS[now, symbols]
        squares = squares + (k >= SETTLED) * (x[:, :2] ** 2).sum(axis=1)
        now = symbols
    return np.sqrt(squares / (SAMPLES - SETTLED)), commutations / (SAMPLES * model.PERIOD)


def online_curves():
    """Return commutations / s and rms errors [A] by price, (P,) each, of each of what is told."""
    rms, rate = loop(online(np.tile(PRICES, len(W))), W.repeat(len(PRICES), 0))
    return list(zip(rate.reshape(len(W), -1), rms.reshape(len(W), -1)))


def directions(w):
    """Return features: the error that the zero vector leaves after a sample, along directions."""

    def along(direction):
        def feature(x):
            rates = model.dynamics(x, [0.0, 0.0], w)
            error = [x[i] + model.PERIOD * rates[i] for i in range(2)]
            return np.cos(direction) * error[0] + np.sin(direction) * error[1]

        return feature

    return {f"along{30 * k}": along(k * np.pi / 6) for k in range(6)}


def exported(policy):
    """Add rows of what C of a policy takes, where compilers and emulators are installed."""
    what = "inverter told, C of 16-bit readings"
    with tempfile.TemporaryDirectory() as folder:
        capsyn.export(policy, "c", folder, readings="int16", scale=COUNTS, cycles=True)
        measured = json.loads(Path(folder, "measured.json").read_text())
    if "cortex-m4" in measured:
        row(f"{what}, cortex-m4", measured["cortex-m4"]["with_library"], "bytes", "<= 10000")
    for processor, unit in (("cortex-m3", "instructions"), ("avr", "cycles")):
        worst = measured.get("worst", {}).get(processor, {})
        if "next" in worst:  # a sample is 3,600 cycles of a Cortex-M3 at 72 MHz
            wanted = "<= 1200" if processor == "cortex-m3" else ""
            row(f"{what}, {processor}, longest decision seen", worst["next"]["most"], unit, wanted)


def compensating(problem, w):
    """Return predictive control that compensates a sample of delay, as a policy told nothing."""
    fixed = problem.replace(
        exogenous=None,
        dynamics=lambda x, u: problem.dynamics(x, u, w),
        terminal_cost=lambda x: problem.terminal_cost(x, w),
        delay=model.PERIOD,
        leaves="constant",
        partitions=9,
        refinement=2,
        max_level=3,
    )
    control = finite_control_set(fixed, 1, sample_time=model.PERIOD, control_weight=0.0)
    return problem_policy(control, fixed)


if __name__ == "__main__":
    problem, curves = capsyn.problems.get("inverter"), online_curves()

    def ratios(found, curves):
        """Return the rms errors (B,) over those of online control that commutates as much."""
        return [rms / np.interp(rate, *curve) for rms, rate, curve in zip(*found, curves)]

    policy = capsyn.synthesize(problem)
    found = loop(lookup(policy), W)
    for name, rms, rate, ratio in zip(TOLD, *found, ratios(found, curves)):
        row(f"inverter told {name}: rms error", rms, "A")
        row(f"inverter told {name}: commutations a second", rate)
        row(f"inverter told {name}: rms error over that of online control", ratio, "", "<= 1.03")
    row("inverter told: cells", policy.cells.leaf_count, "", "<= 100")
    exported(policy)
    free = loop(lookup(capsyn.synthesize(problem.replace(switching=None))), W)[0]
    row("inverter told, without prices: rms error over that of online control, at most",
        (free / loop(online(np.zeros(len(W))), W)[0]).max(), "", "<= 1.03")  # fmt: skip

    ten = W[1:2]
    one = policy.at(ten[0])
    tree = capsyn.compress(one, "linear", agreement=0.97, features=directions(ten[0]), states=5000)
    row("inverter of 10 A, tree: nodes", tree.node_count, "", "<= 200")
    row("inverter of 10 A, tree: rms error over that of online control",
        ratios(loop(lookup(tree), ten), curves[1:2])[0], "", "<= 1.02")  # fmt: skip
    late = compensating(problem, ten[0])
    for what, policy, wanted in (("", late, "<= 1.05"), (" that is not foreseen", one, "")):
        ratio = loop(lookup(policy), ten, delayed=True)[0][0] / found[0][1]
        row(f"inverter of 10 A, a sample of delay{what}: rms error over that without", ratio, "",
            wanted)  # fmt: skip
    print(json.dumps(rows))
