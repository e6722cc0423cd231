"""What affine leaves save where there are many states, and how solves grow with agreement."""

import dataclasses
import json
import resource
import subprocess
import sys
import time

import numpy as np

from capsyn import Box, agreement, monte_carlo, problems, subdivide, synthesize

STATES = 200_000
"""Random states of an agreement."""


def peak():
    """Return the peak memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def made(problem, **options):
    """Return a policy, the seconds that it took, and its share of agreement with sSAC [%]."""
    started = time.perf_counter()
    policy = synthesize(problem, **options)
    seconds = time.perf_counter() - started
    return policy, seconds, 100 * agreement(policy, states=STATES).share


def rows_of(what, problem, bounds, **options):
    """Return rows for one policy with affine leaves, whose figures have `bounds` by name."""
    synthesize(problem, max_level=0)  # builds the kernel
    before = peak()
    policy, seconds, share = made(problem, leaves="affine", **options)
    figures = {
        "agreement": (share, "%"),
        "solves": (policy.statistics["solves"], ""),
        "leaves": (policy.cells.leaf_count, ""),
        "seconds": (seconds, "s"),
        "peak memory": (max(peak(), before), "MB"),
    }
    return [
        {"what": f"{what}: {name}", "value": figures[name][0], "unit": figures[name][1]}
        | ({"wanted": wanted} if wanted else {})
        for name, wanted in bounds.items()
    ]


def cart_pole():
    """Return the rows of the 4-D cart-pole."""
    problem, found = problems.get("cart-pole"), []
    for options, share, solves, leaves in (
        ({"max_level": 0}, 99.4, 1200, 300),
        ({"max_level": 3, "max_solves": 15_000}, 99.9, 15_000, None),
        ({"max_level": 3, "max_solves": 60_000}, 99.97, 60_000, None),
    ):
        bounds = {
            "agreement": f">= {share}",
            "solves": f"<= {solves}",
            "leaves": f"<= {leaves}" if leaves else "",
            "seconds": "",
        }
        found += rows_of(
            f"cart-pole, affine, at most {solves:,} solves", problem, bounds, **options
        )
    return found


def planar_quadrotor():
    """Return the rows of the 6-D quadrotor."""
    problem, found = problems.get("planar-quadrotor"), []
    for solves, share, seconds in ((6000, 98.7, 3), (140_000, 99.7, 20)):
        bounds = {
            "agreement": f">= {share}",
            "solves": f"<= {solves}",
            "leaves": "",
            "seconds": f"<= {seconds}",
            "peak memory": "<= 1024",
        }
        what = f"planar-quadrotor, affine, at most {solves:,} solves"
        found += rows_of(what, problem, bounds, max_level=3, max_solves=solves)
    return found


def spacecraft():
    """Return the rows of the 6-D spacecraft, without and with its control weight."""
    problem, found = problems.get("spacecraft"), []
    free = problem.replace(settings=dataclasses.replace(problem.settings, control_weight=0.0))
    for solves, share in ((6000, 94.9), (170_000, 98.9)):
        bounds = {"agreement": f">= {share}", "solves": f"<= {solves}", "seconds": ""}
        what = f"spacecraft, R = 0, affine, at most {solves:,} solves"
        found += rows_of(what, free, bounds, max_level=3, max_solves=solves)
    policy, _, share = made(problem, leaves="affine", max_level=3, max_solves=170_000)
    found.append({"what": "spacecraft, built-in, affine: agreement", "value": share, "unit": "%"})
    trials = monte_carlo(policy, 1000, duration=40.0, rate=100.0)
    what = "spacecraft, built-in: within 0.05 of rest in 40 s, of 1,000 starts"
    ends = {"low end of the 95 % interval": trials.low, "high end": trials.high}
    found.append({"what": what, "value": 100 * float(trials.success.mean()), "unit": "%"})
    found += [{"what": f"{what}: {k}", "value": 100 * v, "unit": "%"} for k, v in ends.items()]
    return found


def solves_for(points, share):
    """Return the solves at which a share [%] is reached, between measured (solves, share).

    Beyond the last of them, its solves.
    """
    solves, shares = np.array(points, dtype=float).T
    errors = np.log(100 - shares)[::-1]
    return float(np.exp(np.interp(np.log(100 - share), errors, np.log(solves)[::-1])))


def double_pendulum():
    """Return the rows of agreement against solves on curved surfaces."""
    problem, found, curves = problems.get("double-pendulum"), [], {}
    choices = {
        "constant": [{"max_level": k} for k in (1, 2, 3, 4)],
        "affine": [
            {"leaves": "affine", "max_level": 4, "max_solves": k}
            for k in (10_000, 30_000, 100_000, 300_000)
        ],
    }
    for kind, options in choices.items():
        curves[kind] = []
        for option in options:
            policy, _, share = made(problem, **option)
            solves = policy.statistics["solves"]
            curves[kind].append((solves, share))
            what = f"double-pendulum, {kind}, {solves:,} solves: agreement"
            found.append({"what": what, "value": share, "unit": "%"})
    saved = solves_for(curves["constant"], 98) / solves_for(curves["affine"], 98)
    most = curves["constant"][-1][1]
    bound = f" (at least: they end at {most:.1f} %)" if most < 98 else ""
    what = f"double-pendulum, 98 %: solves of constant leaves{bound} over those of affine ones"
    return [*found, {"what": what, "value": saved, "unit": "ratio", "wanted": ">= 10"}]


def constant_leaves():
    """Return the rows of the cart-pole at level 4, whose cells are one symbol each."""
    problem = problems.get("cart-pole")
    synthesize(problem, max_level=0)
    policy, seconds, share = made(problem, max_level=4)
    what = "cart-pole level 4, constant"
    return [
        {"what": f"{what}: solves", "value": policy.statistics["solves"], "unit": ""},
        {"what": f"{what}: agreement", "value": share, "unit": "%"},
        {"what": f"{what}: seconds", "value": seconds, "unit": "s", "wanted": "<= 15"},
        {"what": f"{what}: peak memory", "value": peak(), "unit": "MB", "wanted": "<= 1536"},
    ]


def growth():
    """Return the slopes of solves and leaves against disagreement, on a ball in the unit cube.

    The ball's radius is 0.4: its surface has the same curvature whatever the number of axes. Slopes
    are those of ``log(solves)`` over ``-log(share that disagrees)``, fitted to the levels.
    """
    found = []
    levels = {2: (1, 2, 3, 4, 5), 3: (0, 1, 2, 3), 4: (0, 1, 2, 3), 5: (0, 1, 2), 6: (0, 1)}

    def scores(states):
        inside = 0.16 - ((states - 0.5) ** 2).sum(axis=1)
        return np.stack([inside, np.zeros(len(states))], axis=1)

    for n in levels:
        box = Box([0.0] * n, [1.0] * n)
        states = box.sample(STATES, 1)
        right = scores(states).argmax(axis=1)
        for leaves in ("constant", "affine"):
            points = []
            for level in levels[n]:
                policy = subdivide(
                    scores,
                    box,
                    2,
                    partitions=4,
                    max_level=level,
                    returns="scores",
                    leaves=leaves,
                    leaf_error=0.0,
                )
                wrong = 100 * float((policy(states) != right).mean())
                solves, cells = policy.statistics["solves"], policy.cells.leaf_count
                points.append((max(wrong, 100 / STATES), solves, cells))
                what = f"ball, n = {n}, {leaves}, {solves:,} solves, {cells:,} leaves: agreement"
                found.append({"what": what, "value": 100 - wrong, "unit": "%"})
            wrong, *counts = np.log(np.array(points)).T
            for name, count in zip(("solves", "leaves"), counts):
                slope = -float(np.polyfit(wrong, count, 1)[0])
                what = f"ball, n = {n}, {leaves}: {name}, growth exponent"
                found.append({"what": what, "value": slope, "unit": ""})
    return found


PARTS = (cart_pole, planar_quadrotor, spacecraft, double_pendulum, constant_leaves, growth)


def measure():
    """Return the rows of all parts, each measured in a process of its own."""
    rows = []
    for part in PARTS:
        command = [sys.executable, __file__, part.__name__]
        run = subprocess.run(command, capture_output=True, text=True, check=True)
        rows += json.loads(run.stdout.splitlines()[-1])
    return rows


if __name__ == "__main__":
    named = {part.__name__: part for part in PARTS}
    print(json.dumps(named[sys.argv[1]]() if sys.argv[1:] else measure()))
