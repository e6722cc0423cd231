"""Draw the pictures at the heads of guides that are about closed loops and choices."""

import dataclasses
import io
import itertools
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import capsyn
from capsyn import problems
from capsyn.plots.optimum import plot_optimum
from capsyn.plots.policy import plot_policy
from capsyn.sources.finite_control_set import finite_control_set

ROOT = Path(__file__).parents[2]
INK, GOAL, FIRST, SECOND = "#333333", "#888888", "#0072B2", "#D55E00"


def in_few_colors(drawn, path):
    """Write a picture, a file, in 64 colours, which is a third of the bytes."""
    with Image.open(drawn) as image:
        few = image.convert("RGB").quantize(64, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


def save(figure, path):
    """Write a figure without the frame above and on the right, and close it."""
    for ax in figure.axes:
        ax.spines[["top", "right"]].set_visible(False)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=110)
    plt.close(figure)
    in_few_colors(drawn, path)


def actuators(path, problem_of):
    """Draw a loop of each kind of actuator: the state above, the symbol below."""
    cases = {
        "tank": ("a valve", [0.1], 120, 0.5, 1),
        "fridge": ("a relay", [11], 120, 5, 1),
        "puck": ("thrusters", [1.5, 0.2], 30, 0, 1),
        "buck": ("a switched converter", [0, 0], 2e-3, 12, 1e3),
    }
    figure, axes = plt.subplots(
        2, 4, figsize=(12, 4), height_ratios=[2, 1], sharex="col", layout="constrained"
    )
    for (name, (title, start, duration, goal, scale)), (above, below) in zip(cases.items(), axes.T):
        policy = capsyn.synthesize(problem_of(name))
        run = capsyn.simulate(policy, start, duration)
        k = len(start) - 1 if name == "buck" else 0
        above.plot(run.times * scale, run.states[:, k], color=FIRST)
        above.axhline(goal, color=GOAL, ls="--", lw=1)
        above.set(title=title, ylabel=f"{run.names[k]} [{run.units[k]}]")
        below.step(run.times[:-1] * scale, run.symbols, where="post", color=INK, lw=0.8)
        below.set(yticks=range(len(policy.alphabet)), ylim=(-0.3, len(policy.alphabet) - 0.7))
        below.set_yticklabels(policy.alphabet.names)
        below.set_xlabel("time [ms]" if scale > 1 else f"time [{policy.time_unit}]")
    save(figure, path)


def alphabets(path):
    """Draw what numbers of valve settings achieve for two tanks, as the guide finds them."""
    settings = list(itertools.product([0, 0.5, 1], repeat=3))
    loops = {"rate": 20, "duration": 6, "starts": 20, "fresh": 200}
    tanks = problems.get("double-tank-a")
    save(capsyn.choose_alphabet(tanks, settings, [2, 3, 4, 5], **loops).plot(), path)


def choosing(path):
    """Draw where a heater settles, by default and horizon."""
    thermostat = runpy.run_path(str(ROOT / "examples" / "thermostat.py"))["thermostat"]
    figure, ax = plt.subplots(figsize=(8, 3.2), layout="constrained")
    for color, (default, horizon) in zip(
        (SECOND, "#E69F00", FIRST), ((0.0, 5.0), (0.0, 0.5), (0.6, 5.0))
    ):
        policy = capsyn.synthesize(thermostat(default, horizon))
        run = capsyn.simulate(policy, [18.0], 60.0, rate=100.0)
        label = f"default {default:g}, horizon {horizon:g} s"
        ax.plot(run.times, run.states[:, 0], color=color, label=label)
    ax.axhline(21, color=GOAL, ls="--", lw=1)
    ax.annotate("wanted", (60, 21), ha="right", va="top", color=INK)
    ax.set(xlabel="time [s]", ylabel="temperature [degC]", xlim=(0, 60))
    ax.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 0.1))
    save(figure, path)


def coordinates(path, page):
    """Draw the inverter's symbols at two angles, in axes that are fixed and in axes that turn."""
    figure, axes = plt.subplots(2, 2, figsize=(8, 6.4), layout="constrained", sharex=True)
    for row, (name, grid) in zip(axes, (("fixed", 36), ("turning", 240))):
        policy = capsyn.synthesize(page["problem"](page[name], grid))
        for ax, angle in zip(row, (0.5, 1.0)):
            plot_policy(policy, at={"angle": angle}, ax=ax, outlines=False, legend=False)
            ax.set(title=f"{name} axes, angle {angle:g} rad", aspect="equal")
    save(figure, path)


def models(path, page):
    """Draw a measured table, and the policy of the model that uses it."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    places = page["places"]
    left.plot(places, [float(page["force"](x)) for x in places], "o-", color=FIRST, ms=4)
    left.set(xlabel="place [m]", ylabel="force")
    plot_policy(capsyn.synthesize(page["problem"]), ax=right)
    save(figure, path)


def good(path):
    """Draw what loops cost beyond the least, before and after two rounds of improvement."""
    policy = capsyn.synthesize(problems.plain("double-tank-a"))
    near = capsyn.Box([0.1, 0.1], [0.9, 0.9], names=["x1", "x2"])
    better = capsyn.improve(policy, rounds=2, rate=50, duration=6, initial=near).policy
    best = capsyn.optimum(policy, duration=6, rate=50, counts=200, initial=near)
    found = [best.compare(each) for each in (policy, better)]
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    top = max(each.excess.max() for each in found)
    for ax, each, title in zip(axes, found, ("before", "after two rounds")):
        plot_optimum(each, policy.domain, ax)
        ax.collections[0].set_clim(0, top)
        ax.set_title(f"{title}: {each.ratio:.3g} times the least cost")
    save(figure, path)


def references(path):
    """Draw a day of the building, whose setpoint people change."""
    policy = capsyn.synthesize(problems.get("building"))
    day = {"setpoint": {0: 24.0, 480: 21.5, 1080: 24.0}, "outdoor": 34.0}
    run = capsyn.simulate(policy, [24.0, 24.0], duration=1440, exogenous=day)
    figure, ax = plt.subplots(figsize=(8, 3.2), layout="constrained")
    hours = run.times / 60
    ax.plot(hours, run.states[:, 0], color=FIRST, label="room")
    ax.step(hours, run.exogenous[:, 0], where="post", color=SECOND, ls="--", label="setpoint")
    ax.set(xlabel="time [h]", ylabel="temperature [degC]", xlim=(0, 24))
    ax.legend(frameon=False)
    save(figure, path)


def switching(path):
    """Draw what the pendulum's cart is told, without and with a price on switching."""
    figure, axes = plt.subplots(2, 1, figsize=(8, 3.2), layout="constrained", sharex=True)
    for ax, make, title in zip(
        axes, (problems.plain, problems.get), ("without a price", "with a price of 1 %")
    ):
        policy = capsyn.synthesize(make("cart-pendulum"))
        run = capsyn.simulate(policy, [3.1, 0.0], 10.0, rate=1000)
        ax.step(run.times[:-1], run.controls[:, 0], where="post", color=INK, lw=0.7)
        ax.set(title=f"{title}: {run.switches} switches", ylabel="m/s^2", yticks=[-5, 5])
    axes[1].set(xlabel="time [s]", xlim=(0, 10))
    save(figure, path)


def dwell(path, room):
    """Draw a heater that goes off outside the domain at once, and one that waits."""
    policy = capsyn.synthesize(room)
    figure, ax = plt.subplots(figsize=(8, 3.2), layout="constrained")
    for once, color in ((False, SECOND), (True, FIRST)):
        run = capsyn.simulate(policy, [21.9], 10, disturbance=[1.0], outside_at_once=once)
        label = "goes off at once" if once else "waits for the least time"
        ax.plot(run.times, run.states[:, 0], color=color, label=label)
        k = run.symbols.argmin()
        ax.plot(run.times[k], run.states[k, 0], "o", color=color)
    ax.axhline(policy.domain.upper[0], color=GOAL, ls="--", lw=1)
    ax.annotate("end of the domain", (10, 26), ha="right", va="bottom", color=INK)
    ax.set(xlabel="time [min]", ylabel="temperature [degC]", xlim=(0, 10))
    ax.legend(frameon=False, loc="upper left")
    save(figure, path)


def discrete_time(path, problem):
    """Draw loops of a harvested stock, and the harvests that three rules choose."""
    policy = capsyn.synthesize(problem)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.2), layout="constrained")
    for start, color in ((0.1, FIRST), (1.3, SECOND)):
        run = capsyn.simulate(policy, [start], 6)
        left.plot(run.times, run.states[:, 0], "o-", ms=4, lw=0.8, color=color)
    left.axhline(0.7, color=GOAL, ls="--", lw=1)
    left.set(xlabel="time [d]", ylabel="stock")
    x = problem.domain.sample(4000, 0)[:, 0]
    x.sort()
    first = dataclasses.replace(problem.settings, sensitivity="first order")
    rules = {
        "brute force": finite_control_set(problem, 4),
        "exact": policy,
        "first order": capsyn.synthesize(problem, settings=first),
    }
    for k, chosen in enumerate(rules.values()):
        symbols = chosen(x[:, None])
        for symbol, color in enumerate((INK, FIRST, SECOND)):
            there = np.where(symbols == symbol, 1.0, np.nan)
            right.plot(x, -k * there, lw=14, color=color, solid_capstyle="butt")
    for name, color in zip(problem.alphabet.names, (INK, FIRST, SECOND)):
        right.plot([], [], lw=6, color=color, label=name)
    right.set(xlabel="stock", yticks=[0, -1, -2], ylim=(-2.7, 1.1))
    right.set_yticklabels(rules)
    right.legend(frameon=False, ncols=3, loc="upper center", title="harvest")
    save(figure, path)


def limits(path):
    """Draw loops of the boost converter, plain and with a limit on its current."""
    boost = problems.get("boost-converter")
    settings = dataclasses.replace(boost.settings, sample_time=1e-5)
    problem = boost.replace(limits=lambda x: [x[0] - 4.5], settings=settings)
    kept, plain = capsyn.synthesize(problem, keep_limits=True), capsyn.synthesize(problem)
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", sharey=True)
    starts = np.array([[0.5, 30.0], [2.0, 25.0], [3.0, 22.0], [4.2, 40.0], [1.0, 50.0]])
    for ax, policy, title in zip(axes, (plain, kept), ("plain", "limits kept")):
        plot_policy(policy, ax=ax, outlines=False, legend=policy is kept)
        ax.plot(*capsyn.simulate(policy, starts, 2e-3, rate=1e5).states.T, color="k", lw=0.8)
        ax.plot(*starts.T, "ko", ms=4)
        ax.axvline(4.5, color="#c0392b", lw=2)
        ax.set_title(f"{title}; red: the limit")
    save(figure, path)


def evidence(path):
    """Draw loops with noise from many starts, over the symbols of the policy."""
    policy = capsyn.synthesize(problems.plain("double-tank-a"))
    rng = np.random.default_rng(1)
    starts = rng.uniform(0.1, 0.9, (60, 2))
    run = capsyn.simulate(policy, starts, 5.0, rate=100, noise=[0.005, 0.005])
    figure, ax = plt.subplots(figsize=(7, 4.5), layout="constrained")
    plot_policy(policy, ax=ax, outlines=False)
    ax.plot(*run.states.T, color="k", lw=0.5, alpha=0.6)
    ax.plot(*starts.T, "k.", ms=4)
    ax.set_title("60 loops with noise")
    save(figure, path)
