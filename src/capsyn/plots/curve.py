"""The trade-off between size and agreement as a picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from capsyn.plots.figure import literal, saved_figure
from capsyn.policies.colors import PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.compression.curve import CurvePoint

MARKERS = {"cells": "s", "exact": "o", "freedom": "^", "linear": "D"}


def plot_curve(points: Sequence[CurvePoint], ax: Axes) -> Axes:
    """Draw the volume that disagrees against the bytes of controllers, a marker for each mode.

    Those that nothing smaller beats are filled and joined by a line.
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


def save_curve_plot(points: Sequence[CurvePoint], title: str, path: str | os.PathLike[str]) -> None:
    """Write the picture as PNG, PDF or SVG; see `capsyn.plots.figure.save_figure`."""
    with saved_figure(path, 7, 4.5) as figure:
        plot_curve(points, figure.add_subplot()).set_title(literal(title))
