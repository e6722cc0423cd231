"""Switches against cost, for prices and least times, as a picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from capsyn.modelling.time_unit import NAMES
from capsyn.plots.figure import literal, saved_figure
from capsyn.policies.colors import PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.verification.switching_curve import SwitchingPoint


def plot_switching(points: Sequence[SwitchingPoint], time_unit: str, ax: Axes) -> Axes:
    """Draw the mean cost against switches per time unit, a line for each least time.

    Each point has its price, and its success where it is not that of all trials; the recommended
    one is filled.
    """
    for k, hold in enumerate(dict.fromkeys(point.hold for point in points)):
        some = sorted((p for p in points if p.hold == hold), key=lambda p: p.switches)
        color = PALETTE[k % len(PALETTE)]
        ax.plot(
            [p.switches for p in some],
            [p.cost for p in some],
            color=color,
            marker="o",
            markersize=6,
            markerfacecolor="white",
            linewidth=1,
            label=f"held {hold:g} {time_unit}",
        )
        for p in some:
            lost = "" if p.success is None or p.success == 1 else f" ({p.success:.1%})"
            ax.annotate(
                f"{p.price}{lost}",
                (p.switches, p.cost),
                xytext=(4, 5),
                textcoords="offset points",
                fontsize=7,
            )
            if p.recommended:
                ax.plot(p.switches, p.cost, "o", markersize=8, color=color, zorder=3)
    ax.set(
        xlabel=f"switches per {NAMES[time_unit]}",
        ylabel="mean cost of a closed loop",
    )
    if all(p.switches > 0 for p in points):
        ax.set(xscale="log")
        ax.xaxis.set_major_formatter("{x:g}")
    ax.margins(0.12, 0.12)  # room for the prices
    ax.grid(True, which="both", linewidth=0.3)
    ax.legend(frameon=False, title="filled: recommended; label: price", title_fontsize=7)
    return ax


def save_switching_plot(
    points: Sequence[SwitchingPoint], title: str, time_unit: str, path: str | os.PathLike[str]
) -> None:
    """Write the picture as PNG, PDF or SVG; see `capsyn.plots.figure.save_figure`."""
    with saved_figure(path, 7, 4.5) as figure:
        plot_switching(points, time_unit, figure.add_subplot()).set_title(literal(title))
