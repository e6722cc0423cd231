"""A three-phase inverter at 20 kHz: predictive control that pays for commutations, as a policy.

The policy is told the speed and the size of the current's reference, which rotates. The yardstick
is the same control solved online by trying out all symbols, in the same loop, where it commutates
as much, which its price decides. A tree, and a policy that compensates a delay of one sample, as
those with affine cells cannot, are made of the same problem in errors of the current, told nothing.
"""

import json
import tempfile
from pathlib import Path

import numpy as np

import capsyn
from capsyn.problems import inverter as model
from capsyn.sources.callables import problem_policy
from capsyn.sources.finite_control_set import finite_control_set

SAMPLES, SETTLED = 4000, 200
STARTS = np.arange(6) * np.pi / 18  # rad, of the angle; a turn has six equal parts
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
COUNTS = [0.005, 0.005, 2 * np.pi / 8192, 0.1, 0.01]
"""What a count of a 16-bit reading stands for, by state and exogenous input."""
rows = []


def row(what, value, unit="", wanted=""):
    rows.append({"what": what, "value": float(value), "unit": unit, "wanted": wanted})


def wanted(x, w):
    """Return the reference (B, 2) [A] at states (B, 3), told (B, 2)."""
    return w[:, 1:] * np.stack([-np.sin(x[:, 2]), np.cos(x[:, 2])], axis=1)


def moved(x, u, w):
    """Return states (B, 3) after a sample under controls (B, 2), told (B, 2)."""

    def slope(x):
        phase = np.stack([-np.sin(x[:, 2]), np.cos(x[:, 2])], axis=1)
        drop = model.RESISTANCE * x[:, :2] + model.FLUX * w[:, :1] * phase
        return np.hstack([(u - drop) / model.INDUCTANCE, w[:, :1]])

    k1 = slope(x)
    k2 = slope(x + model.PERIOD / 2 * k1)
    k3 = slope(x + model.PERIOD / 2 * k2)
    return x + model.PERIOD / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + model.PERIOD * k3))


def online(prices):
    """Return predictive control that tries out all symbols, at prices (P,) of as many loops."""
    prices = np.repeat(prices, len(STARTS))[:, None]

    def choose(x, w, now):
        told = w.repeat(8, 0)
        ends = moved(x.repeat(8, 0), np.tile(VECTORS, (len(x), 1)), told)
        cost = ((ends[:, :2] - wanted(ends, told)) ** 2).sum(axis=1).reshape(-1, 8)
        cost += prices * model.PERIOD * model.COMMUTATIONS[now]
        stays = cost[np.arange(len(x)), now] <= cost.min(axis=1) * (1 + 1e-9)
        return np.where(stays, now, cost.argmin(axis=1))

    return choose


def lookup(policy):
    """Return the choice of a policy, or of one of errors of the current."""

    def choose(x, w, now):
        if policy.exogenous is not None:
            return policy(x, w, current=now)
        return policy(np.hstack([x[:, :2] - wanted(x, w), x[:, 2:]]), current=now)

    return choose


def loop(choose, w, delayed=False):
    """Return rms errors [A] and commutations / s (P,) of loops told (P, 2), over all `STARTS`.

    ``choose(x, w, now)`` gives symbols (B,) at states (B, 3) with symbols (B,) in force, at first
    v0 without a current. They act a sample later where they are `delayed`.
    """
    w = w.repeat(len(STARTS), 0)
    x, now, squares, commutations = np.zeros((len(w), 3)), np.zeros(len(w), dtype=int), 0, 0
    x[:, 2] = np.resize(STARTS, len(w))
    for k in range(SAMPLES):
        symbols = choose(x, w, now)
        x = moved(x, VECTORS[now if delayed else symbols], w)
        if k >= SETTLED:
            squares = squares + ((x[:, :2] - wanted(x, w)) ** 2).sum(axis=1)
            commutations = commutations + model.COMMUTATIONS[now, symbols]
        now = symbols
    squares, commutations = (
        total.reshape(-1, len(STARTS)).mean(axis=1) / (SAMPLES - SETTLED)
        for total in (squares, commutations)
    )
    return np.sqrt(squares), commutations / model.PERIOD


def online_curves():
    """Return commutations / s and rms errors [A] by price, (P,) each, of each of what is told."""
    rms, rate = loop(online(np.tile(PRICES, len(W))), W.repeat(len(PRICES), 0))
    return list(zip(rate.reshape(len(W), -1), rms.reshape(len(W), -1)))


def exported(policy):
    """Add rows of what C of a policy takes, where compilers and emulators are installed."""
    what = "inverter told, C of 16-bit readings"
    with tempfile.TemporaryDirectory() as folder:
        capsyn.export(policy, "c", folder, readings="int16", scale=COUNTS, cycles=True)
        measured = json.loads(Path(folder, "measured.json").read_text())
    if "cortex-m4" in measured:
        row(f"{what}, cortex-m4", measured["cortex-m4"]["with_library"], "bytes", "<= 40000")
    for processor, unit in (("cortex-m3", "instructions"), ("avr", "cycles")):
        worst = measured.get("worst", {}).get(processor, {})
        if "next" in worst:  # a sample is 3,600 cycles of a Cortex-M3 at 72 MHz
            wanted = "<= 1200" if processor == "cortex-m3" else ""
            row(f"{what}, {processor}, longest decision seen", worst["next"]["most"], unit, wanted)


def of_errors(problem, w, **changes):
    """Return the problem told nothing, with errors of the current (alpha, beta) as states."""

    def rates(x, u):
        current = [e + i for e, i in zip((x[0], x[1]), model.reference(x, w))]
        alpha, beta, speed = model.dynamics([*current, x[2]], u, w)
        turned = model.reference([0, 0, x[2] + np.pi / 2], w)  # d reference / d angle
        return [alpha - speed * turned[0], beta - speed * turned[1], speed]

    return problem.replace(
        exogenous=None,
        dynamics=rates,
        terminal_cost=lambda x: x[0] ** 2 + x[1] ** 2,
        domain=capsyn.Box([-3, -3, 0], [3, 3, 2 * np.pi], periodic=[False, False, True]),
        refinement=2,
        **changes,
    )


def compressed(problem):
    """Return a tree of a problem in errors.

    Its features are errors that the zero vector leaves after a sample, along directions.
    """

    def along(direction):
        def feature(x):
            rates = problem.dynamics(x, [0.0, 0.0])
            error = [x[i] + model.PERIOD * rates[i] for i in range(2)]
            return np.cos(direction) * error[0] + np.sin(direction) * error[1]

        return feature

    directions = {f"along{30 * k}": along(k * np.pi / 6) for k in range(6)}
    policy = capsyn.synthesize(problem)
    return capsyn.compress(policy, "linear", agreement=0.97, features=directions, states=5000)


if __name__ == "__main__":
    problem, curves = capsyn.problems.get("inverter"), online_curves()

    def ratios(found, curves):
        """Return the rms errors (B,) over those of online control that commutates as much."""
        return [rms / np.interp(rate, *curve) for rms, rate, curve in zip(*found, curves)]

    policy = capsyn.synthesize(problem)
    found = loop(lookup(policy), W)
    still = loop(lambda x, w, now: policy(x, w * [0, 1], current=now), W)[0]
    for name, rms, rate, ratio, slow in zip(TOLD, *found, ratios(found, curves), still):
        row(f"inverter told {name}: rms error", rms, "A")
        row(f"inverter told {name}: commutations a second", rate)
        row(f"inverter told {name}: rms error over online control's", ratio, "", "<= 1.03")
        row(f"inverter told {name} but a speed of 0: rms error", slow, "A")
    row("inverter told: cells", policy.cells.leaf_count, "", "<= 300")
    exported(policy)
    free = loop(lookup(capsyn.synthesize(problem.replace(switching=None))), W)[0]
    most = (free / loop(online(np.zeros(len(W))), W)[0]).max()
    row("inverter told, no prices: rms error over online control's, at most", most, "",
        "<= 1.03")  # fmt: skip
    any_w = problem.exogenous.sample(40, 0)
    ours, theirs = loop(lookup(policy), any_w), loop(online(np.full(40, model.PRICE)), any_w)
    for what, own, other in zip(("rms error", "commutations"), ours, theirs):
        row(f"inverter told 40 random references: {what} over online control's, at most",
            (own / other).max(), "", "<= 1.03")  # fmt: skip

    ten = W[1:2]
    errors = of_errors(problem, ten[0], partitions=(1, 1, 12))
    tree = compressed(errors)
    row("inverter of 10 A, tree: nodes", tree.node_count, "", "<= 200")
    row("inverter of 10 A, tree: rms error over online control's",
        ratios(loop(lookup(tree), ten), curves[1:2])[0], "", "<= 1.02")  # fmt: skip
    late = errors.replace(delay=model.PERIOD, leaves="constant", partitions=9, max_level=3)
    control = finite_control_set(late, 1, sample_time=model.PERIOD, control_weight=0.0)
    late = problem_policy(control, late)
    for what, made, bound in (("", late, "<= 1.05"), (" that is not foreseen", policy, "")):
        ratio = loop(lookup(made), ten, delayed=True)[0][0] / found[0][1]
        row(f"inverter of 10 A, a sample of delay{what}: rms error over that without", ratio, "",
            bound)  # fmt: skip
    print(json.dumps(rows))
