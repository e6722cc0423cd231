"""A first look at candidates: gradients of 1,000 of them on 20,000 states of six dimensions.

Once where the model is affine in its inputs, once where it is not; the first call builds its
kernel, in a cache that is empty.
"""

import json
import os
import tempfile
import time

import casadi as ca

import capsyn
from capsyn import problems
from capsyn.alphabets.candidates import candidates_of
from capsyn.alphabets.gains import candidate_gains, candidate_gradients, greedy
from capsyn.alphabets.symmetries import orbits

STATES, LEVELS, CHOSEN = 20_000, 10, 9
MOON = 1.62  # m/s^2
rows = []


def row(what, value, unit, wanted=None):
    """Note a figure."""
    rows.append({"what": what, "value": value, "unit": unit, "wanted": wanted})


def timed(function, *arguments):
    """Return what a function returns, and the seconds that it takes."""
    began = time.perf_counter()
    return function(*arguments), time.perf_counter() - began


def lander():
    """Return a lander of 2 kg: thrust u[0] of a nozzle at the angle u[1], and a wheel u[2]."""

    def dynamics(x, u):
        along = x[2] + u[1]
        return [
            *(x[3], x[4], x[5]),
            -u[0] / 2 * ca.sin(along),
            u[0] / 2 * ca.cos(along) - MOON,
            -0.8 * u[0] * ca.sin(u[1]) + u[2] * ca.fabs(u[2]),
        ]

    return capsyn.Problem(
        name="lander",
        dynamics=dynamics,
        domain=capsyn.Box([-5, 0, -1, -2, -2, -1], [5, 10, 1, 2, 2, 1]),
        alphabet=[[0, 0, 0], [6, 0, 0]],
        default=[2 * MOON, 0, 0],
        horizon=1.5,
        running_cost=lambda x: sum(x[i] ** 2 for i in range(6)),
        settings=capsyn.SsacSettings(rule="steepest", steps=16),
    )


CASES = [
    ("affine", problems.get("spacecraft"), capsyn.Box([-0.4] * 3, [0.4] * 3), "<= 2"),
    ("not affine", lander(), capsyn.Box([0, -0.3, -1], [6, 0.3, 1]), "<= 20"),
]
"""What a model is in its inputs, an example, a box of its inputs, and the seconds wanted."""

with tempfile.TemporaryDirectory() as cache:
    os.environ["CAPSYN_CACHE_DIR"] = cache
    for kind, problem, box, wanted in CASES:
        found = candidates_of(problem, box, LEVELS)
        states = problem.space.sample(STATES)
        what = f"{problem.name} ({kind}): gradients of {len(found)} candidates, {STATES:,} states"
        arguments = problem, found.values, states
        _, first = timed(candidate_gradients, *arguments)
        _, again = timed(candidate_gradients, *arguments)
        _, alone = timed(candidate_gradients, *arguments, "numpy")
        row(f"{what}: first call", first, "s", wanted)
        row(f"{what}: next calls", again, "s")
        row(f"{what}: without a compiler", alone, "s", wanted)
        gains = candidate_gains(*arguments)
        _, seconds = timed(greedy, gains, CHOSEN)
        row(f"{problem.name}: greedy choice of {CHOSEN} of {len(found)}", seconds, "s")
        groups, seconds = timed(orbits, problem, found.values)
        row(f"{problem.name}: orbits of {len(found)} candidates", seconds, "s", "<= 1")
        row(f"{problem.name}: orbits of {len(found)} candidates: number", len(groups), "")
print(json.dumps(rows))
