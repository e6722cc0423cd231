"""The paper's figures, in its order; every function returns the Axes that it drew on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.plots.figure import frame, outline_width, quantity, rectangles
from capsyn.policies.colors import PALETTE, symbol_colors
from capsyn.policies.policy import Policy, cell_tree

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text

BLUE, ORANGE, GREEN, _, SKY, RED, _, _ = PALETTE
INK, GREY, LIGHT = "#222222", "#7F7F7F", "#DCE9F2"


def halves(figure: Figure, columns: bool, ratios: tuple[float, float]) -> tuple[Any, Any]:
    """Return the two parts of a figure, side by side or one above the other."""
    if columns:
        parts: Any = figure.subfigures(1, 2, width_ratios=ratios)
    else:
        parts = figure.subfigures(2, 1, height_ratios=ratios)
    return parts[0], parts[1]


def draw_layers(policy: Policy, axes: Sequence[Axes]) -> Sequence[Axes]:
    """Draw the layers of a policy of two states, Fig. 3: one Axes for each level.

    Layer `k` shows the cells that are labelled at levels up to `k`, and in white the cells of
    level `k` that are divided further, outlined in grey.

    Parameters
    ----------
    policy : Policy
        A policy of two states.
    axes : max_level + 1 Axes, or depth + 1 if that is more
        Where to draw, layer 0 first.

    Raises
    ------
    ProblemError
        Another number of states or of Axes.
    """
    from matplotlib.collections import PolyCollection

    domain, tree = policy.space, cell_tree(policy)
    if domain.n != 2:
        raise ProblemError(f"`policy` must have two states to draw its layers; got {domain.n}")
    layers = 1 + max(tree.max_level, tree.depth)
    if len(axes) != layers:
        raise ProblemError(f"`axes` must be {layers} Axes; got {len(axes)}")
    colors = np.array([*symbol_colors(len(policy.alphabet)), "#FFFFFF"], dtype=object)

    def add(ax: Axes, level: int, corners: np.ndarray, faces: Any, edges: str) -> None:
        ax.add_collection(
            PolyCollection(
                list(corners), facecolors=faces, edgecolors=edges, linewidths=outline_width(level)
            )
        )

    labelled: list[tuple[np.ndarray, np.ndarray]] = []
    levels = list(tree.levels())  # fewer than the axes where no cell of a level is split
    for k, ax in enumerate(axes):
        if k < len(levels):
            _, places, lower, sizes = levels[k]
            corners = rectangles(domain, lower, sizes, tree.counts)
            leaf = tree.entries[places] < 0
            labelled.append((corners[leaf], -1 - tree.entries[places[leaf]]))
            divided = corners[~leaf]
        for level, (cells, labels) in enumerate(labelled):
            add(ax, level, cells, colors[labels], "white")
        add(ax, k, divided, "white", GREY)
        frame(ax, domain)
        ax.set_title(f"layer {k}", fontsize="medium")
        if k:
            ax.set_ylabel("")
            ax.tick_params(labelleft=False)
    return axes


def draw_derivative_signs(
    x_axis: np.ndarray, y_axis: np.ndarray, signs: np.ndarray, domain: Box, ax: Axes
) -> Axes:
    """Draw the sign of the derivative of a Lyapunov function over a grid, Fig. 4b.

    The axes (nx,) and (ny,) are in state units; a sign (nx, ny) is -1, 0 or 1, and 2 where the
    derivative is not finite.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    # single grid points are smaller than a pixel: what is not negative is drawn as markers
    ax.set_facecolor(LIGHT)
    handles: list[Any] = [Patch(facecolor=LIGHT, edgecolor=GREY, label="dV/dt < 0")]
    for sign, color, size, marker, label in (
        (0, GREY, 1.2, "s", "dV/dt = 0"),
        (1, "black", 1.6, "s", "dV/dt > 0"),
        (2, RED, 5.0, "^", "not finite"),
    ):
        i, j = np.nonzero(signs == sign)
        if len(i):
            style: dict[str, Any] = {"ls": "", "marker": marker, "mew": 0, "color": color}
            ax.plot(x_axis[i], y_axis[j], ms=size, rasterized=True, **style)
            handles.append(Line2D([], [], ms=5, label=label, **style))
    frame(ax, domain)
    ax.legend(
        handles=handles,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=len(handles),
        frameon=False,
        handletextpad=0.4,
    )
    return ax


def draw_tanks(ax: Axes) -> Axes:
    """Draw the two-tank system, Fig. 5.

    Tank T1 stands `h` above tank T2; liquid flows in through valve V1, between the tanks through
    V2, and out through V3. The levels are ``x1`` and ``x2``.
    """
    from matplotlib.patches import Polygon

    height, lift, width, pipe = 1.15, 0.5, 0.8, 0.06
    left, right = 0.0, 1.55
    levels = {left: (lift, 0.65), right: (0.0, 0.8)}

    def box(x: float, y: float, w: float, h: float, color: str) -> None:
        corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
        ax.add_patch(Polygon(corners, facecolor=color, edgecolor="none"))

    def line(*points: tuple[float, float], lw: float = 1.6) -> None:
        ax.plot(*np.array(points).T, color=INK, lw=lw, solid_joinstyle="miter")

    def valve(x: float, y: float, name: str, upright: bool, dx: float, dy: float) -> None:
        bow = np.array([(-0.1, -0.075), (-0.1, 0.075), (0.1, -0.075), (0.1, 0.075)])
        bow = bow[:, ::-1] if upright else bow
        ax.add_patch(Polygon(bow + (x, y), facecolor="white", edgecolor=INK, lw=1.4, zorder=4))
        _write(ax, (x + dx, y + dy), name, 12)

    def measure(x: float, low: float, high: float, name: str, side: int) -> None:
        style = {"arrowstyle": "<|-|>", "color": INK, "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", (x, low), (x, high), arrowprops=style)
        _write(ax, (x + 0.12 * side, (low + high) / 2), name, 12)

    # liquid, then walls with gaps where the pipes are, then pipes and valves
    for x, (base, level) in levels.items():
        box(x, base, width, level, SKY)
    join = lift + pipe  # centre of the pipe between the tanks: T1's floor, h above T2's
    box(left + width, lift, right - left - width, 2 * pipe, SKY)
    box(right + width, 0.0, 0.62, 2 * pipe, SKY)
    box(left + 0.34, lift + 0.65, 2 * pipe, 0.9, SKY)
    top = lift + height
    line((left, top), (left, lift), (right, lift), (right, 0.0), (right + width + 0.62, 0.0))
    line((left + width, top), (left + width, lift + 2 * pipe), (right, lift + 2 * pipe))
    line((right, lift + 2 * pipe), (right, height))
    line((right + width, height), (right + width, 2 * pipe), (right + width + 0.62, 2 * pipe))
    for x in (left + 0.34, left + 0.34 + 2 * pipe):
        line((x, top + 0.02), (x, top + 0.4))
    valve(left + 0.34 + pipe, top + 0.21, "$V_1$", True, 0.22, 0.0)
    valve((left + width + right) / 2, join, "$V_2$", False, 0.0, 0.18)
    valve(right + width + 0.33, pipe, "$V_3$", False, 0.0, 0.18)

    for x, name in ((left, "$T_1$"), (right, "$T_2$")):
        base, level = levels[x]
        _write(ax, (x + 0.62, base + level - 0.2), name, 12)
    measure(left - 0.12, lift, lift + levels[left][1], "$x_1$", -1)
    measure(right + 0.15, 0.0, levels[right][1], "$x_2$", 1)
    measure(left + width / 2, 0.0, lift, "$h$", 1)
    ax.plot([left, right], [0, 0], color=GREY, lw=0.9, ls="--")
    ax.set(xlim=(-0.4, 3.1), ylim=(-0.12, top + 0.45), aspect="equal")
    ax.axis("off")
    return ax


def draw_end_states(
    initial: np.ndarray,
    final: np.ndarray,
    center: Sequence[float],
    radius: float,
    names_units: Sequence[tuple[str, str]],
    ax: Axes,
) -> Axes:
    """Draw initial and final states (trials, 2) and the target, Fig. 6, top right [state units]."""
    turn = np.linspace(0, 2 * np.pi, 181)
    circle = np.asarray(center)[:, None] + radius * np.stack([np.cos(turn), np.sin(turn)])
    ax.plot(*initial.T, "o", ms=3.5, mew=0, color=GREEN, label="initial")
    ax.plot(*final.T, "x", ms=4, mew=0.9, color=RED, label="final")
    ax.plot(*circle, color=INK, lw=1.4, label="target")
    (x_name, x_unit), (y_name, y_unit) = names_units
    ax.set(xlabel=quantity(x_name, x_unit), ylabel=quantity(y_name, y_unit), aspect="equal")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    return ax


def draw_costs(times: np.ndarray, costs: np.ndarray, ax: Axes, log: bool = False) -> Axes:
    """Draw the open-loop cost J (trials, K) of eq. (3) at times (K,) [s], Fig. 6, bottom right.

    It is NaN after the end of a trial; its axis may be logarithmic.
    """
    ax.plot(times, np.transpose(costs), color=BLUE, lw=0.6, alpha=0.6)
    ax.set(xlabel="time [s]", ylabel="cost J of eq. (3)", xlim=(times[0], times[-1]))
    ax.set_yscale("log" if log else "linear")
    if not log:
        ax.set_ylim(bottom=min(0.0, float(np.nanmin(costs))))
    return ax


def draw_dwell_tradeoff(
    dwell_times: np.ndarray,
    shares: np.ndarray,
    lows: np.ndarray,
    highs: np.ndarray,
    switch_rates: np.ndarray,
    ax: Axes,
) -> tuple[Axes, Axes]:
    """Draw what a minimum dwell time costs and saves; return also the Axes of the switches.

    Dwell times (K,) [s] ascend; each has a share of successful trials, with its confidence
    interval, and a rate of switches [1 / s].
    """
    positive = dwell_times[dwell_times > 0]
    if positive.size and positive[-1] > 10 * positive[0]:
        # as logarithmic, but 0 has a place
        ax.set_xscale("symlog", linthresh=positive[0], linscale=0.4)
        ax.set_xticks(dwell_times, [f"{time:g}" for time in dwell_times])
        ax.minorticks_off()
    errors = np.abs(np.stack([lows, highs]) - shares)
    ax.errorbar(dwell_times, shares, errors, color=BLUE, marker="o", ms=5, lw=1.4, capsize=3)
    ax.set_xlabel("minimum dwell time [s]")
    ax.set_ylabel("share of successful trials", color=BLUE)
    ax.set_ylim(0.0, 1.03)
    second = ax.twinx()
    second.plot(dwell_times, switch_rates, color=RED, marker="s", ms=5, lw=1.4, ls="--")
    second.set_ylabel("switches [1/s]", color=RED)
    if (np.asarray(switch_rates) > 0).all():
        second.set_yscale("log")
    else:
        second.set_ylim(bottom=0.0)
    return ax, second


def _write(ax: Axes, place: Any, text: str, size: float) -> Text:
    x, y = place
    return ax.text(x, y, text, ha="center", va="center", fontsize=size, color=INK)
