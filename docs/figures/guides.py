"""Draw the pictures at the heads of guides: real policies, and how parts connect."""

import dataclasses
import re
import runpy
import sys
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from capsyn import Box, compress, problems, simulate, subdivide, synthesize
from capsyn.controllers.ssac import policy_controller
from capsyn.plots.policy import plot_policy
from capsyn.policies.colors import PALETTE
from capsyn.sources.grid_files import read_table
from capsyn.sources.table import Table

HERE = Path(__file__).parent
INK, PALE = "#333333", "#EEF3F8"
LABELS = np.array(["#FFFFFF", *PALETTE])
"""Colours of labels from -1 on."""


def save(figure, path):
    """Write a picture that is small."""
    figure.savefig(path, dpi=110, bbox_inches="tight", pil_kwargs={"optimize": True})


def box(ax, x, y, text, width=1.0, height=0.5, face=PALE, ink=INK, **style):
    """Draw a box around (x, y) with a text."""
    corner = (x - width / 2, y - height / 2)
    ax.add_patch(Rectangle(corner, width, height, facecolor=face, edgecolor=INK, lw=1))
    ax.text(x, y, text, ha="center", va="center", color=ink, **{"fontsize": 9, **style})


def arrow(ax, start, end, text="", above=0.06, **style):
    """Draw an arrow with a text over its middle."""
    shape = {"arrowstyle": "-|>", "color": INK, "lw": 1.2, **style}
    ax.annotate("", xy=end, xytext=start, arrowprops=shape)
    if text:
        middle = np.add(start, end) / 2
        ax.text(*(middle + [0, above]), text, ha="center", va="bottom", fontsize=8, color=INK)


def sheet(width, height, right, top):
    """Return an empty figure and its axes, whose units are those of a drawing."""
    figure = Figure(figsize=(width, height))
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, right), ylim=(0, top))
    ax.axis("off")
    return figure, ax


def table():
    """Return a table of points with gaps, and the cells of its policy."""
    x, y = np.meshgrid(np.linspace(-8, 8, 17), np.linspace(-8, 8, 17), indexing="ij")
    symbols = np.where(x + 0.06 * y * np.abs(y) + y < 0, 0, 1)
    symbols[x**2 + y**2 > 100] = -1
    made = Table.of([-8, -8], [1, 1], symbols, alphabet=[1, -1], names=["position", "speed"])
    figure = Figure(figsize=(8, 3.7))
    left, right = figure.subplots(1, 2)
    left.scatter(x, y, c=LABELS[symbols + 1].ravel(), edgecolors=INK, linewidths=0.4, s=34)
    left.set(title="the table", xlabel="position", ylabel="speed")
    plot_policy(made.policy("its policy"), ax=right, legend=False)
    left.set(xlim=right.get_xlim(), ylim=right.get_ylim())
    figure.tight_layout()
    return figure


def trees():
    """Return a policy and three trees of it."""
    policy = synthesize(problems.plain("cart-pendulum"))
    features = {
        "energy": lambda x: 2 * x[1] ** 2 + 19.62 * (ca.cos(x[0]) - 1),
        "cos(theta) * omega": lambda x: ca.cos(x[0]) * x[1],
    }
    exact = compress(policy, "exact")
    linear = compress(policy, "linear", agreement=0.99)
    law = compress(policy, features=features)
    figure = Figure(figsize=(9, 2.9))
    shown = [
        (policy, f"the policy: {policy.statistics['cells']:,} cells"),
        (exact, f"exact tree: {exact.node_count} nodes"),
        (linear, f"oblique splits: {linear.node_count} nodes"),
        (law, f"features: {law.node_count} nodes"),
    ]
    for ax, (one, title) in zip(figure.subplots(1, 4, sharey=True), shown):
        bare = dataclasses.replace(one, target=None)  # whose line would hide the surfaces
        plot_policy(bare, ax=ax, legend=False, outlines=one is policy)
        ax.set_title(title, fontsize=9)
        if one is not policy:
            ax.set_ylabel("")
    figure.tight_layout()
    return figure


def exports():
    """Return the targets of an export, and what is beside each."""
    figure, ax = sheet(8, 3.2, 8, 3.2)
    box(ax, 1, 1.9, "policy\nor tree", 1.3, 0.9, "#D8E6F3", fontsize=11)
    targets = [
        ("C", "microcontroller"),
        ("Structured Text", "PLC"),
        ("Verilog", "FPGA"),
        ("FMU", "Simulink, Modelica"),
        ("Python, JavaScript", "computer, browser"),
        ("JSON", "programs of your own"),
    ]
    for k, (language, machine) in enumerate(targets):
        y = 2.95 - 0.42 * k
        arrow(ax, (1.65, 1.9), (2.95, y))
        box(ax, 3.75, y, language, 1.6, 0.34)
        ax.text(4.7, y, machine, va="center", fontsize=9, color=INK)
    ax.plot([6.35, 6.5, 6.5, 6.35], [3.1, 3.1, 0.7, 0.7], color=INK, lw=1)
    beside = (
        "golden.csv: states,\nand the symbol for each\n\ncertificate.json:\nsizes and comparisons"
    )
    ax.text(6.62, 1.9, beside, va="center", fontsize=9, color=INK)
    ax.text(4, 0.2, "every export gives the same symbol, bit for bit", ha="center", color=INK)
    return figure


def loop():
    """Return the parts of a control loop on a machine."""
    figure, ax = sheet(8, 2.6, 8, 2.6)
    box(ax, 1.1, 1.7, "machine", 1.5, 0.8, "#F6E7CE", fontsize=11)
    box(ax, 3.1, 1.7, "sensors:\nreadings", 1.4, 0.8)
    box(ax, 5.1, 1.7, "exported code:\none symbol", 1.5, 0.8, "#D8E6F3")
    box(ax, 7.1, 1.7, "control\nof the symbol", 1.4, 0.8)
    for left, right in ((1.85, 2.4), (3.8, 4.35), (5.85, 6.4)):
        arrow(ax, (left, 1.7), (right, 1.7))
    ax.plot([7.1, 7.1, 1.1], [1.3, 0.55, 0.55], color=INK, lw=1.2)
    arrow(ax, (1.1, 0.55), (1.1, 1.3))
    ax.text(4.1, 0.62, "valves, relays, thrusters", ha="center", va="bottom", fontsize=8, color=INK)
    ax.text(5.1, 2.2, "called once in every sample", ha="center", fontsize=8, color=INK)
    ax.text(4, 0.15, "the same loop on every machine", ha="center", fontsize=9, color=INK)
    return figure


def entries():
    """Return the cells of a small policy, and the array that its file has for them."""
    square = Box([0, 0], [1, 1], names=["x1", "x2"])
    small = subdivide(lambda x: 1 * (x.sum(axis=1) > 0.45), square, 2, partitions=2, max_level=1)
    figure = Figure(figsize=(8.5, 3))
    cells, row = figure.subplots(1, 2, width_ratios=(1, 2.3))
    plot_policy(small, ax=cells, legend=False)
    cells.set_title("cells", fontsize=10)
    places = [
        (0.75, 0.25),
        (0.25, 0.75),
        (0.75, 0.75),
    ]  # of the root grid in C order, then children
    places = [
        (0.4, 0.46),
        places[1],
        places[0],
        places[2],
        *np.array(list(np.ndindex(2, 2))) / 4 + 0.125,
    ]
    for place, (x, y) in enumerate(places):
        if place:
            cells.text(x, y, str(place), ha="center", va="center", color="white", fontsize=10)
    row.axis("off")
    row.set(xlim=(-0.7, 7.7), ylim=(-1.7, 2.2))
    for place, entry in enumerate(small.cells.entries):
        face = "#D8E6F3" if entry >= 0 else LABELS[-entry]
        box(row, place, 0.3, str(entry), 1, 0.7, face, INK if entry >= 0 else "white")
        row.text(place, 0.72, str(place), ha="center", va="bottom", fontsize=8, color=INK)
    arrow(row, (0, -0.08), (4, -0.08), connectionstyle="arc3,rad=0.25")
    row.text(1.5, 1.25, "places 0 to 3: the root grid", ha="center", fontsize=9, color=INK)
    row.text(5.5, 1.25, "places 4 to 7: children of cell 0", ha="center", fontsize=9, color=INK)
    said = "4: the children are at place 4 and after      -1: symbol 0      -2: symbol 1"
    row.text(3.5, -1.4, said, ha="center", fontsize=9, color=INK)
    row.set_title("the array entries", fontsize=10)
    figure.tight_layout()
    return figure


def stairs():
    """Return constant and affine leaves of the same curved surface."""

    def scores(states):
        gain = states[:, 1] - 0.9 * np.sin(2.2 * states[:, 0]) * states[:, 0]
        return np.stack([gain, -gain], axis=1)

    def label(states):
        return np.argmax(scores(states), axis=1)

    figure = Figure(figsize=(8, 3.6))
    domain = Box([-1, -1], [1, 1], names=["x1", "x2"])
    constant = subdivide(label, domain, 2, partitions=4, max_level=3)
    affine = subdivide(
        scores, domain, 2, partitions=4, max_level=3, returns="scores", leaves="affine"
    )
    for ax, (policy, what) in zip(
        figure.subplots(1, 2),
        ((constant, "cells of one symbol"), (affine, "cells with affine rows")),
    ):
        plot_policy(policy, ax=ax, legend=False)
        solves = policy.statistics["solves"]
        ax.set_title(f"{what}: {policy.statistics['cells']} cells, {solves} solves", fontsize=10)
    figure.tight_layout()
    return figure


def cluster():
    """Return how a synthesis shares its solves with workers and keeps their answers."""
    figure, ax = sheet(8, 2.9, 8, 2.9)
    box(ax, 1.2, 1.6, "capsyn synth\n(Algorithm 1)", 1.7, 0.8, "#D8E6F3", fontsize=10)
    box(ax, 4.1, 1.6, "scheduler", 1.2, 0.6)
    for k in range(3):
        y = 2.45 - 0.85 * k
        box(ax, 6.8, y, f"worker {k + 1}: kernel", 1.7, 0.5)
        arrow(ax, (4.7, 1.6), (5.95, y), arrowstyle="<|-|>")
    arrow(ax, (2.05, 1.72), (3.5, 1.72), "states")
    arrow(ax, (3.5, 1.5), (2.05, 1.5), "masks of symbols", above=-0.24)
    box(ax, 1.2, 0.4, "checkpoint directory:\nfinished answers", 2.0, 0.55, "#F6E7CE")
    arrow(ax, (1.2, 1.2), (1.2, 0.68), arrowstyle="<|-|>")
    return figure


def insertion():
    """Return how one state gets its label: the prediction, and what each symbol is worth."""
    problem = problems.plain("cart-pendulum-4")
    controller = policy_controller(synthesize(problem, max_level=0))
    start = np.array([2.4, 3.9])
    solution = controller.solve(start[None])
    steps = np.linspace(0, problem.horizon, 121)
    path = [start]
    for h in np.diff(steps):  # Euler's method is enough for a drawing
        path.append(path[-1] + h * np.array([path[-1][1], 9.81 / 2 * np.sin(path[-1][0])]))
    figure = Figure(figsize=(8.5, 3))
    left, right = figure.subplots(1, 2)
    left.plot(steps, np.array(path)[:, 0], color=INK, lw=1.6)
    left.plot(0, start[0], "o", color=PALETTE[5])
    left.set(xlabel="time over the horizon [s]", ylabel="theta [rad]")
    left.set_title("1. predict with the default control", fontsize=10)
    names, scores = problem.alphabet.names, controller.scores(solution)[0]
    best = int(np.argmin(scores))
    colors = [PALETTE[0] if k == best else "#BBBBBB" for k in range(len(names))]
    right.bar(names, solution.gradients[0], color=colors)
    wanted = -5 * solution.cost[0]
    right.axhline(wanted, color=PALETTE[5], ls="--", lw=1.2)
    right.axhline(0, color=INK, lw=0.8)
    right.text(2.5, wanted, "wanted: gamma J0", va="bottom", ha="center", fontsize=8, color=INK)
    right.set(xlabel="symbol: acceleration [m/s^2]", ylabel="gradient d")
    right.set_title("2. label: the symbol with the least score", fontsize=10)
    figure.tight_layout()
    return figure


def sizes():
    """Return the sizes of trees of one law, made by two tools."""
    rows = [
        ("dtControl, axis-aligned", 927, 0),
        ("dtControl, linear SVM", 787, 0),
        ("dtControl, logistic regression", 339, 0),
        ("capsyn, exact tree", 799, 1),
        ("capsyn, freedom", 339, 1),
        ("capsyn, linear at 99 %", 31, 1),
    ]
    figure = Figure(figsize=(7, 2.5))
    ax = figure.subplots()
    names, nodes, tools = zip(*rows)
    bars = ax.barh(names, nodes, color=np.array(["#999999", PALETTE[0]])[list(tools)])
    ax.bar_label(bars, padding=3, fontsize=9)
    ax.invert_yaxis()
    ax.set(xlabel="nodes", xlim=(0, 1050))
    ax.spines[["top", "right"]].set_visible(False)
    return figure


def boat():
    """Return the map of the example boat's policy with three closed loops, and one over time."""
    policy = synthesize(runpy.run_path(str(HERE.parents[1] / "examples" / "boat.py"))["problem"])
    starts = [[8.0, 0.0], [-5.0, 2.0], [9.0, -3.0]]
    runs = simulate(policy, starts, duration=20.0, rate=100.0)
    figure = Figure(figsize=(8.5, 3.4))
    left, right = figure.subplots(1, 2)
    plot_policy(policy, ax=left, legend=False, outlines=False)
    left.plot(runs.states[..., 0].T, runs.states[..., 1].T, color="white", lw=2.4)
    left.plot(runs.states[..., 0].T, runs.states[..., 1].T, color=INK, lw=1.2)
    left.plot(*np.transpose(starts), "o", color=INK, ms=4)
    marks = [Rectangle((0, 0), 1, 1, facecolor=color) for color in PALETTE[:3]]
    left.legend(marks, policy.alphabet.names, fontsize=8, loc="lower left")
    left.set_title("one symbol for every state", fontsize=10)
    right.plot(runs.times, runs.states[..., 0].T, lw=1.4)
    right.set(xlabel="time [s]", ylabel="position [m]")
    right.set_title("three closed loops", fontsize=10)
    figure.tight_layout()
    return figure


def interface():
    """Return which function makes what of a problem."""
    figure, ax = sheet(8.5, 2.9, 8.5, 2.9)
    box(ax, 0.9, 1.5, "Problem", 1.3, 0.6, "#F6E7CE", fontsize=11)
    box(ax, 3.6, 1.5, "Policy", 1.3, 0.6, "#D8E6F3", fontsize=11)
    arrow(ax, (1.55, 1.5), (2.95, 1.5), "synthesize")
    made = [
        "simulate: Trajectory",
        "monte_carlo: MonteCarlo",
        "certify: Certificate",
        "compress: DecisionTree",
        "export: files (C, FMU, ...)",
    ]
    for k, what in enumerate(made):
        y = 2.6 - 0.55 * k
        arrow(ax, (4.25, 1.5), (5.95, y))
        box(ax, 7.2, y, what, 2.4, 0.42)
    return figure


def strategy():
    """Draw the learned strategy of the page on tables: a plane for each state of the window."""
    page = (HERE.parent / "tables.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(# heater.py\n.*?)^```$", page, re.DOTALL | re.MULTILINE)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "heater.json")
        exec(compile(code.replace('"heater.json"', repr(str(path))), "heater.py", "exec"), {})
        heater = read_table(path, domain={"room": (10, 25), "outdoor": (-15, 20)})
    policy = heater.policy("heater")
    figure = Figure(figsize=(8.5, 3.2), layout="constrained")
    for k, ax in enumerate(figure.subplots(1, 2, sharey=True)):
        room, outdoor = np.meshgrid(np.linspace(10, 25, 400), np.linspace(-15, 20, 400))
        states = np.column_stack([np.full(room.size, k), room.ravel(), outdoor.ravel()])
        image = LABELS[policy(states).reshape(room.shape) + 1]
        colors = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in image.ravel()])
        ax.imshow(
            colors.reshape(*room.shape, 3).astype(np.uint8),
            origin="lower",
            extent=(10, 25, -15, 20),
            aspect="auto",
        )
        ax.set_xlabel("room [°C]")
        ax.set_title(f"window {'open' if k else 'closed'}", fontsize=10)
    figure.axes[0].set_ylabel("outdoor [°C]")
    patches = [Rectangle((0, 0), 1, 1, facecolor=LABELS[k + 1]) for k in range(2)]
    figure.legend(patches, ["off", "on"], loc="outside right center", frameon=False)
    return figure


DRAWN = (
    interface,
    boat,
    table,
    strategy,
    trees,
    exports,
    loop,
    entries,
    stairs,
    cluster,
    insertion,
    sizes,
)


def draw(names=()):
    """Write the pictures of some names, or all, beside this file."""
    for picture in DRAWN:
        if not names or picture.__name__ in names:
            save(picture(), HERE / f"{picture.__name__}.png")


if __name__ == "__main__":
    draw(sys.argv[1:])
