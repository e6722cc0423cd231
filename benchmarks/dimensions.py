"""What affine leaves save where there are many states, and how solves grow with agreement."""

import dataclasses
import itertools
import json
import resource
import subprocess
import sys
import time

import numpy as np

from capsyn import Box, agreement, monte_carlo, problems, subdivide, synthesize
from tails import loops, near, pumped, starts, upright

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
    problem, found = problems.plain("cart-pole"), []
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
    problem, found = problems.plain("planar-quadrotor"), []
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
    problem, found = problems.plain("spacecraft"), []
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
    problem, found, curves = problems.plain("double-pendulum"), [], {}
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


def adaptive():
    """Return the rows of splits along some axes: agreements, and solves saved at one of them."""
    free = dataclasses.replace(problems.plain("spacecraft").settings, control_weight=0.0)
    found = []
    for name, share, budgets, wanted, changes in (
        ("cart-pole", 99.95, (5_000, 15_000, 60_000), ">= 25", {}),
        ("planar-quadrotor", 99.6, (6_000, 20_000, 50_000, 140_000), ">= 25", {}),
        ("spacecraft", 98.5, (6_000, 100_000, 170_000), "", {"settings": free}),
        ("double-pendulum", 95, (5_000, 20_000, 100_000), "", {}),
    ):
        problem, needed = problems.plain(name).replace(**changes), {}
        called = f"{name}, R = 0" if changes else name
        for refine in ("isotropic", "adaptive"):
            curve = []
            for budget in budgets:
                options = {"leaves": "affine", "max_level": 4, "max_solves": budget}
                policy, _, agreeing = made(problem, refine=refine, **options)
                solves = policy.statistics["solves"]
                curve.append((solves, agreeing))
                what = f"{called}, affine, {refine}, {solves:,} solves: agreement"
                found.append({"what": what, "value": agreeing, "unit": "%"})
            needed[refine] = solves_for(curve, share)
        saved = 100 * (1 - needed["adaptive"] / needed["isotropic"])
        what = f"{called}, {share} %: solves that adaptive splits save"
        found.append(
            {"what": what, "value": saved, "unit": "%"} | ({"wanted": wanted} if wanted else {})
        )
    for name, level in (("cart-pole", 3), ("double-pendulum", 3)):
        solves = []
        for refine in ("isotropic", "adaptive"):
            policy, _, agreeing = made(problems.plain(name), max_level=level, refine=refine)
            solves.append(policy.statistics["solves"])
            what = f"{name}, constant, {refine}, {solves[-1]:,} solves: agreement"
            found.append({"what": what, "value": agreeing, "unit": "%"})
        saved = 100 * (1 - solves[1] / solves[0])
        what = f"{name}, constant, level {level}: solves that adaptive splits save"
        found.append({"what": what, "value": saved, "unit": "%"})
    return found


def constant_leaves():
    """Return the rows of the cart-pole at level 4, whose cells are one symbol each."""
    problem = problems.plain("cart-pole")
    synthesize(problem, max_level=0)
    policy, seconds, share = made(problem, max_level=4)
    what = "cart-pole level 4, constant"
    return [
        {"what": f"{what}: solves", "value": policy.statistics["solves"], "unit": ""},
        {"what": f"{what}: agreement", "value": share, "unit": "%"},
        {"what": f"{what}: seconds", "value": seconds, "unit": "s", "wanted": "<= 15"},
        {"what": f"{what}: peak memory", "value": peak(), "unit": "MB", "wanted": "<= 1536"},
    ]


def bounded_memory():
    """Return the rows of the same in blocks, beside whole levels."""
    problem, found = problems.plain("cart-pole"), []
    synthesize(problem, max_level=0)
    start = peak()
    what = "cart-pole level 4, constant"
    policies = []
    for limit in ("100MB", "500MB", "20GB"):  # a process's peak does not fall
        started = time.perf_counter()
        policies.append(synthesize(problem, max_level=4, max_memory=limit))
        seconds = time.perf_counter() - started
        row = f"{what}, max_memory {limit}"
        found.append({"what": f"{row}: memory taken", "value": peak() - start, "unit": "MB"})
        found.append({"what": f"{row}: seconds", "value": seconds, "unit": "s"})
    same = all(
        policy.statistics == policies[0].statistics
        and np.array_equal(policy.cells.entries, policies[0].cells.entries)
        for policy in policies
    )
    return [
        *found,
        {"what": f"{what}: the same cells", "value": float(same), "unit": "", "wanted": ">= 1"},
    ]


def ball_curves():
    """Return by (n, leaves, refine) the share that disagrees [%], solves and leaves, (levels, 3).

    Of a ball of radius 0.4 in the unit cube: its surface has the same curvature whatever the number
    of axes. A share is at least that of one state.
    """
    levels = {2: (1, 2, 3, 4, 5), 3: (0, 1, 2, 3), 4: (0, 1, 2, 3), 5: (0, 1, 2), 6: (0, 1)}

    def scores(states):
        inside = 0.16 - ((states - 0.5) ** 2).sum(axis=1)
        return np.stack([inside, np.zeros(len(states))], axis=1)

    options = {"partitions": 4, "returns": "scores", "leaf_error": 0.0}
    curves = {}
    kinds = ("constant", "affine"), ("isotropic", "adaptive")
    for n, leaves, refine in itertools.product(levels, *kinds):
        box = Box([0.0] * n, [1.0] * n)
        states = box.sample(STATES, 1)
        right = scores(states).argmax(axis=1)
        points = []
        for level in levels[n]:
            policy = subdivide(
                scores, box, 2, max_level=level, leaves=leaves, refine=refine, **options
            )
            wrong = max(float((policy(states) != right).mean()), 1 / STATES)
            points.append((100 * wrong, policy.statistics["solves"], policy.cells.leaf_count))
        curves[n, leaves, refine] = np.array(points)
    return curves


def exponents(points):
    """Return the slopes of log(solves) and log(leaves) over -log(share that disagrees)."""
    wrong, *counts = np.log(points).T
    return [-float(np.polyfit(wrong, count, 1)[0]) for count in counts]


def growth():
    """Return the rows of solves and leaves against agreement on a ball, and their exponents."""
    found = []
    for (n, *kind), points in ball_curves().items():
        what = f"ball, n = {n}, {', '.join(kind)}"
        for wrong, solves, cells in points.tolist():
            row = f"{what}, {solves:,.0f} solves, {cells:,.0f} leaves: agreement"
            found.append({"what": row, "value": 100 - wrong, "unit": "%"})
        for name, slope in zip(("solves", "leaves"), exponents(points)):
            found.append({"what": f"{what}: {name}, growth exponent", "value": slope, "unit": ""})
    return found


def save_growth_plot(path):
    """Write the picture of solves and leaves against disagreement on a ball."""
    from matplotlib.figure import Figure

    from capsyn.plots.figure import reproducible, save_figure
    from capsyn.policies.colors import PALETTE

    styles = {"constant": ("--", "s", "white"), "affine": ("-", "o", None)}
    with reproducible():
        figure = Figure(figsize=(8.5, 8), layout="constrained")
        grid = figure.subplots(2, 2, sharex=True, sharey="col")
        for (n, leaves, refine), points in ball_curves().items():
            line, marker, face = styles[leaves]
            color = PALETTE[n - 2]
            for k, ax in enumerate(grid[("isotropic", "adaptive").index(refine)]):
                ax.plot(
                    points[:, 0],
                    points[:, 1 + k],
                    line,
                    marker=marker,
                    markersize=4,
                    color=color,
                    markerfacecolor=face or color,
                    label=f"{n}, {leaves}",
                )
        for row, name in zip(grid, ("all axes split", "split along some axes")):
            for ax, counted in zip(row, ("solves", "leaves")):
                ax.set(xscale="log", yscale="log", ylabel=counted, title=name)
                ax.xaxis.set_major_formatter("{x:g}")
                ax.tick_params(labelbottom=True)
                ax.grid(True, which="major", linewidth=0.3)
        for ax in grid[1]:
            ax.set_xlabel("disagrees [% of the volume]")
        grid[0, 0].invert_xaxis()
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(
            handles, labels, title="states, leaves", frameon=False, ncols=5,
            loc="outside lower center",
        )  # fmt: skip
        save_figure(figure, path)


def in_the_loop():
    """Return the rows of closed loops of policies without tails, and of the built-in ones."""
    found = []
    for name, level, solves, share, duration, rate, judge in (
        ("cart-pole", 3, 15_000, 0.05, 10, 1000, upright),
        ("planar-quadrotor", 3, 6_000, 1.0, 20, 1000, near(6, 0.2, 10_000)),
        ("spacecraft", 3, 170_000, 1.0, 40, 100, near(6, 0.05, 3000)),
        ("double-pendulum", 4, 100_000, 1.0, 20, 500, pumped),
    ):
        plain = {"leaves": "affine", "max_level": level, "max_solves": solves}
        for how, problem, options in (
            (f"affine, at most {solves:,} solves", problems.plain(name), plain),
            ("built-in", problems.get(name), {}),
        ):
            policy, _, agreeing = made(problem, **options)

            def figures(run, judge=judge):
                return judge(run)[0], run.costs[:, -1], run.switches

            good, costs, switches = loops(policy, starts(policy, share), duration, rate, figures)
            values = {
                "agreement": (agreeing, "%"),
                "success in closed loop": (100 * good.mean(), "%"),
                "mean cost of a loop": (costs.mean(), ""),
                "switches": (switches.mean() / duration, "/ s"),
            }
            found += [
                {"what": f"{name}, {how}: {what}", "value": float(value), "unit": unit}
                for what, (value, unit) in values.items()
                if np.isfinite(value) and (value or unit)  # no cost gathers without a running one
            ]
    return found


PARTS = (
    in_the_loop,
    cart_pole,
    planar_quadrotor,
    spacecraft,
    double_pendulum,
    adaptive,
    constant_leaves,
    bounded_memory,
    growth,
)


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
