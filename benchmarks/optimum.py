"""What the best controllers cost, how far policies are from it, and how exact that is."""

import json

import numpy as np
import scipy.linalg

from capsyn import Ball, Box, Problem, optimum, problems, synthesize

CASES = (("double-tank-a", 6.0, 50.0), ("double-tank-b", 6.0, 50.0), ("cart-pendulum", 8.0, 100.0),
         ("boost-converter", 0.01, 1e5))  # fmt: skip
"""Problem, time of a loop and samples per time unit."""


def integrator(**fields):
    """Return a mass that forces accelerate."""
    given = {
        "name": "integrator",
        "dynamics": lambda x, u: [x[1], u[0]],
        "domain": Box([-1, -1], [1, 1]),
        "alphabet": [-1.0, 1.0],
        "default": 0.0,
        "horizon": 1.0,
        "running_cost": lambda x: 1.0,
        "target": Ball([0, 0], 0.01),
    }
    return Problem(**given | fields)


def policies():
    """Yield the rows of built-in problems."""
    for name, duration, rate in CASES:
        problem = problems.plain(name)
        best = optimum(problem, duration, rate=rate)
        far = best.compare(synthesize(problem))
        what = f"{name}, {len(best.starts)} loops of {duration:g} s at {rate:g} Hz"
        yield {"what": f"{what}: least mean cost", "value": best.mean, "unit": ""}
        yield {"what": f"{what}: the policy's over it", "value": far.ratio, "unit": "ratio"}
        yield {"what": f"{what}: low end of the 95 % interval", "value": far.low, "unit": "ratio"}
        yield {"what": f"{what}: high end", "value": far.high, "unit": "ratio"}
        yield {
            "what": f"{what}: loops of the optimum that leave its grid",
            "value": best.left,
            "unit": "",
            "wanted": "<= 0",
        }
        sizes = " x ".join(map(str, best.counts))
        yield {
            "what": f"{name}: optimum, {sizes} intervals, {len(problem.alphabet)} symbols, "
            f"{best.sweeps} sweeps, loops of its policy with it",
            "value": best.seconds,
            "unit": "s",
            "wanted": "<= 8" if name == "double-tank-a" else "",
        }


def exact():
    """Yield the rows of problems whose answers are known."""
    best = optimum(integrator(), 6.0, rate=100, counts=200, stop_at_target=True)
    x = Box([-1, -1], [1, 1]).sample(100_000, 1)
    wrong = best.symbols(x) != (x[:, 0] < -x[:, 1] * np.abs(x[:, 1]) / 2)
    speeds = np.linspace(-1.5, 1.5, 3001)
    curve = np.stack([-speeds * np.abs(speeds) / 2, speeds], axis=1)
    cells = best.box.widths / best.counts
    off = [np.abs((curve - one) / cells).max(axis=1).min() for one in x[wrong]]
    what = "double integrator in least time: of 100,000 states those with another symbol than exact"
    yield {"what": what, "value": 100 * float(wrong.mean()), "unit": "%"}
    for name, value in (("median", np.median(off)), ("most", max(off))):
        yield {
            "what": f"{what}: distance from the switching curve, {name}",
            "value": float(value),
            "unit": "cells",
            "wanted": "<= 1",
        }
    problem = integrator(
        domain=Box([-1.5, -2], [1.5, 2]), alphabet=np.linspace(-3, 3, 49), target=None,
        running_cost=lambda x: x[0] ** 2 + x[1] ** 2,
    )  # fmt: skip
    best = optimum(
        problem, 8.0, rate=20, counts=200, control_weight=1.0, initial=Box([-1, -1], [1, 1])
    )
    a, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    p = scipy.linalg.solve_continuous_are(a, b, np.eye(2), np.eye(1))
    least = np.einsum("bi,ij,bj->b", best.starts, p, best.starts).mean()
    yield {
        "what": "double integrator, quadratic costs, 49 symbols: cost over Riccati's",
        "value": float(best.mean / least),
        "unit": "ratio",
        "wanted": "<= 1.01",
    }


if __name__ == "__main__":
    print(json.dumps([*policies(), *exact()]))
