"""The trade-off between size and agreement as a picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

from capsyn.plots.figure import literal, saved_figure
from capsyn.policies.colors import PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.compression.curve import CurvePoint, LoopPoint

MARKERS = {"cells": "s", "exact": "o", "freedom": "^", "linear": "D"}
PANELS = {
    "agreement": ("disagrees [% of the volume]", lambda point: 100 * (1 - point.agreement)),
    "visited": ("disagrees [% of visited states]", lambda point: 100 * (1 - point.visited)),
    "cost": ("cost over the policy's", lambda point: min(point.cost_ratio, MOST_RATIO)),
    "success": ("success [% of loops]", lambda point: 100 * point.success),
    "switches": ("switches per time unit", lambda point: point.switches),
}
"""What is drawn of points whose loops are known, and how it is called."""
MOST_RATIO = 3.0
"""Larger costs over that of the policy are drawn as this one."""


def plot_curve(points: Sequence[CurvePoint], ax: Axes) -> Axes:
    """Draw the volume that disagrees against the bytes of controllers, a marker for each mode.

    Controllers that no smaller one beats are filled, and joined by a line.
    """
    for color, (mode, marker) in zip(PALETTE, MARKERS.items()):
        some = [point for point in points if point.mode == mode]
        for smallest in (False, True):
            here = [point for point in some if point.smallest is smallest]
            ax.plot(
                [point.bytes for point in here],
                [100 * (1 - point.agreement) for point in here],
                linestyle="",
                marker=marker,
                markersize=6,
                color=color,
                markerfacecolor=color if smallest else "white",
                zorder=3,
            )
        ax.plot([], [], linestyle="", marker=marker, color=color, label=mode)
    best = sorted((point for point in points if point.smallest), key=lambda point: point.bytes)
    ax.plot(
        [point.bytes for point in best],
        [100 * (1 - point.agreement) for point in best],
        color="#999999",
        linewidth=1,
        zorder=1,
    )
    places = {(point.bytes, point.agreement): point for point in reversed(best)}
    for point in places.values():  # once at a place
        level = "" if point.level is None else f", level {point.level}"
        ax.annotate(
            f"{point.nodes}{level}",
            (point.bytes, 100 * (1 - point.agreement)),
            xytext=(-4, -4),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=6,
        )
    ax.set(xscale="log", xlabel="size [bytes]", ylabel="disagrees [% of the volume]")
    if all(point.agreement < 1 for point in points):
        ax.set(yscale="log")
        ax.yaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_major_formatter("{x:g}")
    ax.margins(0.12, 0.05)  # room for the numbers
    ax.grid(True, which="both", linewidth=0.3)
    ax.legend(frameon=False, title="filled: none smaller; number: nodes", title_fontsize=7)
    return ax


def plot_loop_curve(points: Sequence[LoopPoint], axes: Sequence[Axes]) -> None:
    """Draw what loops of controllers do against their nodes, a panel for each of `PANELS`.

    Those that nothing smaller beats, in cost and success, are filled and joined by a line. After
    the panels comes one for the names of the modes.
    """
    markers = MARKERS | {"loop": "P"}
    best = sorted((point for point in points if point.smallest), key=lambda point: point.nodes)
    for ax, (label, value) in zip(axes, PANELS.values()):
        for color, (mode, marker) in zip(PALETTE, markers.items()):
            for smallest in (False, True):
                here = [p for p in points if p.mode == mode and p.smallest is smallest]
                ax.plot(
                    [point.nodes for point in here],
                    [value(point) for point in here],
                    linestyle="",
                    marker=marker,
                    markersize=6,
                    color=color,
                    markerfacecolor=color if smallest else "white",
                    zorder=3 + smallest,
                )
        sizes, values = [point.nodes for point in best], [value(point) for point in best]
        ax.plot(sizes, values, color="#999999", linewidth=1, zorder=1)
        ax.set(xscale="log", xlabel="nodes", ylabel=label)
        ax.xaxis.set_major_formatter("{x:g}")
        ax.grid(True, which="major", linewidth=0.3)
    axes[2].axhline(1.0, color="black", linewidth=0.6, linestyle="--", zorder=0)
    names = axes[len(PANELS)]
    names.axis("off")
    for color, (mode, marker) in zip(PALETTE, markers.items()):
        told = "chosen by loops" if mode == "loop" else mode
        names.plot([], [], linestyle="", marker=marker, color=color, label=told)
    title = f"filled: none smaller costs less\ncosts above {MOST_RATIO:g} are drawn there"
    names.legend(frameon=False, title=title, title_fontsize=7, loc="center")


def save_curve_plot(points: Sequence[CurvePoint], title: str, path: str | os.PathLike[str]) -> None:
    """Write the picture as PNG, PDF or SVG; see `capsyn.plots.figure.save_figure`.

    If the loops of the points are known, the picture has panels against nodes.
    """
    if all(hasattr(point, "cost_ratio") for point in points):
        with saved_figure(path, 9, 5.5) as figure:
            figure.suptitle(literal(title))
            plot_loop_curve(cast("Any", points), figure.subplots(2, 3).ravel())
        return
    with saved_figure(path, 7, 4.5) as figure:
        plot_curve(points, figure.add_subplot()).set_title(literal(title))
