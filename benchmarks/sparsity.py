"""What a fitting alphabet saves: solves, cells and nodes at equal agreement, for 2, 4 and 6 states.

Each problem is divided level by level, in halves, from its whole domain: with the alphabets that
closed loops chose, with as many symbols that are spread evenly, and with all candidates. What a
share of agreement takes is interpolated between levels.
"""

import dataclasses
import functools
import json
import time
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

import capsyn
from capsyn import Box, problems
from capsyn.alphabets.candidates import with_alphabet
from capsyn.compression.trees import tree_of

RESULTS = Path(__file__).with_name("results.json")
STATES = 20_000
"""Random states of an agreement."""
SHARE = 85
"""Share of agreement [%] at which sizes are compared: what six states reach with most alphabets."""
COUNTED = "solves", "cells", "nodes"
MOST = 9
"""Largest number of symbols that is asked for, the same for all problems."""
KINDS = ("chosen", "uniform")
MORE = "or more"
"""Unit of sizes of the last level, where it does not reach `SHARE`."""


@dataclass(frozen=True, eq=False)
class Case:
    """A problem whose closed loops choose among candidates, and how they are run."""

    problem: capsyn.Problem
    candidates: Box
    steps: int  # levels of each input
    counts: tuple[int, ...]
    max_level: int
    effort: float  # price of effort in the objective, as in the choice of a symbol
    loops: dict[str, object]

    @property
    def named(self):
        """The problem's name, and its number of states."""
        return f"{self.problem.name}, {self.problem.domain.n} states"


def gliding(axes):
    """Return a body that glides with drag along some axes, and is pushed along all of them."""

    def dynamics(x, u):
        rates = [x[axes + k] for k in range(axes)]
        speed = ca.sqrt(sum(rate**2 for rate in rates) + 1e-6)
        return [*rates, *(u[k] - 0.5 * speed * rates[k] for k in range(axes))]

    def cost(x):
        return sum(x[k] ** 2 + 0.5 * x[axes + k] ** 2 for k in range(axes))

    reach = np.repeat([2.0, 1.5], axes)
    problem = capsyn.Problem(
        name=f"gliding along {axes}",
        dynamics=dynamics,
        domain=Box(-reach, reach),
        alphabet=np.vstack([np.eye(axes), -np.eye(axes)]),
        default=[0.0] * axes,
        horizon=2.0,
        running_cost=cost,
        settings=capsyn.SsacSettings(rule="steepest", control_weight=1.0, sample_time=0.1),
        outside="nearest",
    )
    steps, level = ((21, 7), (5, 4), (5, 3))[axes - 1]
    counts = ((3, 5, MOST), (5, MOST), (7, MOST))[axes - 1]
    box = Box([-1.0] * axes, [1.0] * axes)
    return Case(problem, box, steps, counts, level, 1.0, {"duration": 10})


def pendulum():
    """Return the swing-up of a pendulum by a cart whose acceleration has a price."""
    plain = problems.plain("cart-pendulum")
    settings = dataclasses.replace(plain.settings, rule="steepest", control_weight=20.0)
    problem = plain.replace(settings=settings, running_cost=plain.terminal_cost, target=None)
    loops = {"rate": 25, "duration": 10}
    return Case(problem, Box([-5.0], [5.0]), 21, (2, 3, MOST), 7, 20.0, loops)


def cart_pole():
    """Return the balancing of a pole by a cart whose acceleration has a low price."""
    built = problems.get("cart-pole")
    settings = dataclasses.replace(built.settings, control_weight=0.1)
    problem = built.replace(settings=settings, switching=None, outside="nearest")
    reach = 0.2 * problem.domain.upper
    loops = {"rate": 50, "duration": 8, "initial": Box(-reach, reach, names=problem.domain.names)}
    return Case(problem, Box([-5.0], [5.0]), 21, (3, MOST), 4, 0.1, loops)


def spacecraft():
    """Return the pointing of a spacecraft by torques about all axes, with a low price."""
    problem = problems.get("spacecraft")
    most = [float(problem.alphabet.values.max())] * 3
    loops = {"rate": 10, "duration": 20}
    return Case(problem, Box(np.negative(most), most), 3, (MOST,), 3, 0.1, loops)


def choice(case):
    """Return the study of a problem's alphabets."""
    return capsyn.choose_alphabet(
        case.problem,
        case.candidates,
        count=case.counts,
        steps=case.steps,
        objective={"cost": 1, "effort": case.effort},
        starts=30,
        policies=False,
        **case.loops,
    )


def divided(case, alphabet):
    """Return by level the share that agrees [%], and the solves, cells, nodes; (levels, 4)."""
    problem, found = with_alphabet(case.problem, alphabet), []
    for level in range(case.max_level + 1):
        policy = capsyn.synthesize(problem, partitions=1, max_level=level, leaves="constant")
        share = 100 * capsyn.agreement(policy, STATES).share
        counts = policy.statistics["solves"], policy.cells.leaf_count, tree_of(policy).node_count
        found.append((share, *counts))
    return np.array(found, dtype=float)


def at_share(points):
    """Return solves, cells and nodes where `SHARE` is first reached, and whether it is.

    Between two levels their logarithms are linear in that of the share which disagrees. Where it is
    not reached, they are those of the last level.
    """
    wrong, sizes = np.log(100 - points[:, 0]), np.log(points[:, 1:])
    reached = np.flatnonzero(points[:, 0] >= SHARE)
    if not reached.size:
        return points[-1, 1:], False
    k = max(reached[0], 1)
    part = (wrong[k - 1] - np.log(100 - SHARE)) / (wrong[k - 1] - wrong[k])
    return np.exp(sizes[k - 1] + part * (sizes[k] - sizes[k - 1])), True


def size_row(named, kind, count, counted):
    """Return what the row of a size at equal agreement is called."""
    return f"{named}, {count} symbols, {kind}: {counted} at {SHARE} %"


def as_good_row(count):
    """Return what the row of the fewest chosen symbols is called, after the problem's name."""
    return f"fewest chosen symbols that do as well as {count} uniform ones"


def growth_exponent(points):
    """Return the slope of log(solves) over -log(share that disagrees), of the finest levels."""
    points = points[-3:]
    return -float(np.polyfit(np.log(100 - points[:, 0]), np.log(points[:, 1]), 1)[0])


def measure(case):
    """Return the rows of a problem."""
    found = []

    def row(what, value, unit=""):
        found.append({"what": f"{case.named}, {what}", "value": value, "unit": unit})

    began = time.perf_counter()
    study = choice(case)
    row("the search: alphabets tried", study.searched)
    row("the search: time", time.perf_counter() - began, "s")
    judged = {(one.kind, one.count): one for one in study.table if one.kind in KINDS}
    for (kind, count), one in judged.items():
        row(
            f"{count} symbols, {kind}: objective",
            one.objective,
            f"({one.low:.4g} to {one.high:.4g})",
        )
    alphabets = {key: one.alphabet for key, one in judged.items()}
    alphabets["all", len(study.candidates)] = study.candidates
    sizes, known = {}, {}
    for (kind, count), alphabet in alphabets.items():
        points = known.get(alphabet.values.tobytes())
        if points is None:  # the chosen alphabet may be the uniform one
            points = known[alphabet.values.tobytes()] = divided(case, alphabet)
        if count >= MOST:
            for level, (share, *counts) in enumerate(points):
                told = ", ".join(f"{value:,.0f} {what}" for value, what in zip(counts, COUNTED))
                row(f"{count} symbols, {kind}, level {level}, {told}: agreement", share, "%")
            row(f"{count} symbols, {kind}: solves, growth exponent", growth_exponent(points))
        values, reached = at_share(points)
        sizes[kind, count] = np.where(reached, values, np.nan)
        for counted, value in zip(COUNTED, values):
            what = size_row(case.named, kind, count, counted)
            found.append({"what": what, "value": round(value), "unit": "" if reached else MORE})
    for count in case.counts:
        few = fewest(judged, count)
        if few is not None:
            row(as_good_row(count), few)
        for other in sorted({count, few or count}):
            for counted, ratio in zip(COUNTED, sizes["uniform", count] / sizes["chosen", other]):
                if np.isfinite(ratio):
                    what = f"{count} uniform symbols over {other} chosen: {counted} at {SHARE} %"
                    row(what, ratio, "ratio")
    return found


def fewest(judged, count):
    """Return the least number of chosen symbols that do as well as uniform ones; None if none."""
    bound = judged["uniform", count].objective
    good = [n for (kind, n), one in judged.items() if kind == "chosen" and one.objective <= bound]
    return min(good, default=None)


def save_plot(path):
    """Write the picture of the sizes of the gliding body at equal agreement, from RESULTS."""
    from matplotlib.figure import Figure

    from capsyn.plots.figure import reproducible, save_figure
    from capsyn.policies.colors import PALETTE

    rows = {row["what"]: row for row in json.loads(RESULTS.read_text())["rows"]}
    cases = [case() for case in FAMILY]
    few = [rows[f"{case.named}, {as_good_row(MOST)}"]["value"] for case in cases]
    lines = {
        "all candidates": ("all", [case.steps ** len(case.candidates.lower) for case in cases]),
        f"{MOST} uniform": ("uniform", [MOST] * len(cases)),
        f"{MOST} chosen": ("chosen", [MOST] * len(cases)),
        f"the fewest chosen that do as well as {MOST} uniform": ("chosen", few),
    }
    states = [case.problem.domain.n for case in cases]
    with reproducible():
        figure = Figure(figsize=(9, 3.2), layout="constrained")
        for ax, counted in zip(figure.subplots(1, len(COUNTED)), COUNTED):
            for (label, (kind, counts)), color in zip(lines.items(), PALETTE):
                found = [
                    rows[size_row(case.named, kind, count, counted)]
                    for case, count in zip(cases, counts)
                ]
                values = [row["value"] for row in found]
                ax.plot(states, values, color=color, label=label)
                for n, row in zip(states, found):
                    face = "white" if row["unit"] == MORE else color
                    ax.plot(n, row["value"], "o", color=color, markerfacecolor=face, markersize=5)
            ax.set(yscale="log", xlabel="states", ylabel=counted, xticks=states)
            ax.grid(True, which="major", linewidth=0.3)
        handles, labels = ax.get_legend_handles_labels()
        figure.legend(handles, labels, frameon=False, ncols=4, loc="outside lower center")
        save_figure(figure, path)


FAMILY = tuple(functools.partial(gliding, axes) for axes in (1, 2, 3))
CASES = (*FAMILY, pendulum, cart_pole, spacecraft)

if __name__ == "__main__":
    print(json.dumps([row for case in CASES for row in measure(case())]))
