"""Arrivals proved: what share of a set of starts, by when, and how long it takes to prove it."""

import json
import time

import casadi as ca
import numpy as np

import capsyn
from capsyn import Box, problems
from capsyn.native.bounds import box_bounds
from capsyn.problems import boost_converter, cart_pendulum

rows = []


def row(what, value, unit="", wanted=""):
    value = value if isinstance(value, int) else float(value)
    rows.append({"what": what, "value": value, "unit": unit, "wanted": wanted})


def proved(what, policy, wanted=(), **asked):
    """Print the figures of a certificate; `wanted` are least arrival [%], time and seconds."""
    certificate = capsyn.certify(policy, **asked)
    least, within, seconds = (*wanted, "", "", "")[:3]
    row(f"{what}: proved to arrive", 100 * certificate.arrival, "%", least)
    row(f"{what}: time bound", certificate.within, policy.time_unit, within)
    row(f"{what}: took", certificate.seconds, "s", seconds)
    row(f"{what}: cells proved", (certificate.cells.arrives >= 1).sum() / certificate.seconds, "/s")
    if certificate.staying > 0:
        row(f"{what}: proved to stay", 100 * certificate.staying, "%")
        row(f"{what}: most switches", certificate.switch_rate, f"/{policy.time_unit}")
        for name, (low, high) in zip(policy.domain.names, certificate.ripple):
            row(f"{what}: ripple of {name}", high - low)
    return certificate


def named(certificate):
    """Return what refuted states do."""
    told = zip(certificate.refuted.round(4).tolist(), certificate.failures)
    return "; ".join(f"{state} {failure}" for state, failure in told if failure == "stands still")


def upright(x):
    return ca.fabs(cart_pendulum.energy(x)) <= 2.94


def load(x, u, p):
    return [
        (boost_converter.SUPPLY - (1 - u[0]) * x[1]) / boost_converter.INDUCTANCE,
        ((1 - u[0]) * x[0] - x[1] / p[0]) / boost_converter.CAPACITANCE,
    ]


def simulated_ripple(policy):
    states = policy.target.sample(500, 0)
    run = capsyn.simulate(policy, states, 0.06, 200_000).states[:, -4000:]
    return run.max(axis=(0, 1)) - run.min(axis=(0, 1))


def bounds_per_second(policy, count=1 << 20):
    """Return how many boxes the dynamics are bounded over in a second, by one thread."""
    bound, random = box_bounds(policy.model.dynamics), np.random.default_rng(0)
    lower = policy.domain.sample(count, 0).T.copy()
    upper = lower + 0.01 * random.random(lower.shape)
    controls = np.repeat(policy.controls[:1].T, count, axis=1)
    bound((lower, upper), (controls, controls))
    began = time.perf_counter()
    bound((lower, upper), (controls, controls))
    return count / (time.perf_counter() - began)


if __name__ == "__main__":
    inner = Box([0.1, 0.1], [0.9, 0.9])
    a, b, pendulum, boost = (
        capsyn.synthesize(problems.get(name))
        for name in ("double-tank-a", "double-tank-b", "cart-pendulum", "boost-converter")
    )
    for policy in (b, pendulum):
        row(f"{policy.name}: boxes bounded", bounds_per_second(policy), "/s")
    for policy in (a, b, boost):  # kernels are built before the clock runs
        capsyn.certify(policy, seconds=1)
    wanted = (">= 100", "<= 10", "<= 3")
    found = proved("double-tank-b, [0.1, 0.9]^2, 1 kHz", b, wanted, initial=inner, seconds=3)
    far = np.abs(found.ripple - np.array([[0.4], [0.6]])).max(axis=1)
    row("double-tank-b: distance from the goal once there", np.hypot(*far), "m", "<= 0.1")
    proved("double-tank-a, [0.1, 0.9]^2, 1 kHz", a, (">= 100", "<= 2.2", "<= 3"), initial=inner)
    proved(
        "double-tank-a, sensor error 0.002", a, (">= 99",), initial=inner, noise=0.002, seconds=120
    )
    found = proved(
        "cart-pendulum, |E| <= 2.94 J, 1 kHz", pendulum, (">= 99",), target=upright, counts=144
    )
    row("cart-pendulum: open", 100 * found.open, "%")
    row(f"cart-pendulum: states of rest found: {named(found)}", len(found.refuted))
    found = proved("boost-converter, 200 kHz, hold 10 us", boost, (">= 100", "<= 0.03", "<= 3"))
    ratio = np.diff(found.ripple, axis=1)[:, 0] / simulated_ripple(boost)
    for name, value in zip(boost.domain.names, ratio):
        row(f"boost-converter: ripple of {name} over the simulated one", value, "", "<= 1.5")
    proved(
        "boost-converter, load known to +-20 %", boost, model=load, parameters={"load": (16, 24)}
    )
    tree = capsyn.compress(capsyn.synthesize(problems.plain("cart-pendulum")), "linear")
    proved(
        f"cart-pendulum, linear tree of {tree.node_count} nodes", tree, target=upright, counts=144
    )
    print(json.dumps(rows))
