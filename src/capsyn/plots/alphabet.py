"""What alphabets achieve for the number of their symbols and the size of their policies."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from capsyn.alphabets.judged import weighed
from capsyn.plots.figure import literal, new_figure, saved_figure
from capsyn.policies.checks import KINDS
from capsyn.policies.colors import PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from capsyn.alphabets.judged import Judged

MARKERS = dict(zip(KINDS, "oDs^"))
COLORS = dict(zip(KINDS, (PALETTE[0], PALETTE[3], PALETTE[1], PALETTE[7])))
APART = 0.09
"""Symbols that kinds of the same number stand apart, so that their intervals can be seen."""
WIDTH, HEIGHT = 4.6, 4.0
"""Of a panel [inches]."""
WIDE = 8.0
"""Objectives that differ by more than this factor are drawn on a logarithmic axis."""


def alphabet_figure(rows: Sequence[Judged], objective: Mapping[str, float], title: str) -> Figure:
    """Return a figure with `plot_alphabets` of a table."""
    figure = new_figure(_width(rows), HEIGHT)
    _draw(rows, objective, title, figure)
    return figure


def save_alphabet_plot(
    rows: Sequence[Judged],
    objective: Mapping[str, float],
    title: str,
    path: str | os.PathLike[str],
) -> None:
    """Write the figure as PNG, PDF or SVG; see `capsyn.plots.figure.save_figure`."""
    with saved_figure(path, _width(rows), HEIGHT) as figure:
        _draw(rows, objective, title, figure)


def _width(rows: Sequence[Judged]) -> float:
    return WIDTH * (1 + any(row.bytes for row in rows))


def _draw(
    rows: Sequence[Judged], objective: Mapping[str, float], title: str, figure: Figure
) -> None:
    panels = 1 + any(row.bytes for row in rows)
    axes = figure.subplots(1, panels, sharey=True, squeeze=False)[0]
    plot_alphabets(rows, axes[0])
    axes[0].set_ylabel(literal(f"objective: {weighed(objective)}"))
    if panels == 2:
        plot_sizes(rows, axes[1])
    figure.suptitle(literal(title), fontsize=11)


def plot_alphabets(rows: Sequence[Judged], ax: Axes) -> Axes:
    """Draw the objective of alphabets, with its interval, against the number of their symbols.

    Each kind has a marker and a colour. The chosen alphabets are joined by a line, and have their
    success where it is not that of all loops. An objective that is infinite stands at the top.
    """
    from matplotlib.ticker import MaxNLocator

    places = {kind: APART * (k - (len(KINDS) - 1) / 2) for k, kind in enumerate(KINDS)}
    _draw_kinds(rows, ax, lambda row: len(row.alphabet) + places[row.kind], _told_success, (-5, -9))
    ax.set_xlabel("symbols")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.margins(0.16, 0.1)
    ax.legend(frameon=False, fontsize=8, title="bars: 95 % interval", title_fontsize=7)
    return ax


def plot_sizes(rows: Sequence[Judged], ax: Axes) -> Axes:
    """Draw the objective of alphabets against the bytes of their policies, on a logarithmic axis.

    Each point has the number of its symbols. Alphabets without a policy are left out.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    known = [row for row in rows if row.bytes]
    _draw_kinds(known, ax, lambda row: row.bytes or 0, lambda row: str(len(row.alphabet)), (5, 4))
    ax.set(xscale="log", xlabel="tables of the policy in C [bytes]")
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.margins(0.15, 0.1)
    return ax


def _told_success(row: Judged) -> str:
    if row.kind != KINDS[0] or row.success in (None, 1.0):
        return ""
    return f"{row.success:.1%}"


def _draw_kinds(
    rows: Sequence[Judged],
    ax: Axes,
    place: Callable[[Judged], float],
    told: Callable[[Judged], str],
    away: tuple[int, int],
) -> None:
    """Draw rows at their places across, and what is told of each so many points away."""
    finite = [row.objective for row in rows if math.isfinite(row.objective)]
    if finite and min(finite) > 0 and max(finite) > WIDE * min(finite):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
    for kind in KINDS:
        some = sorted((row for row in rows if row.kind == kind), key=place)
        style: dict[str, Any] = {"marker": MARKERS[kind], "color": COLORS[kind], "markersize": 6.0}
        drawn = [row for row in some if math.isfinite(row.objective)]
        lost = [row for row in some if not math.isfinite(row.objective)]
        if drawn:
            ax.errorbar(
                [place(row) for row in drawn],
                [row.objective for row in drawn],
                yerr=[[max(row.objective - row.low, 0.0) for row in drawn],
                      [max(row.high - row.objective, 0.0) for row in drawn]],
                linestyle="-" if kind == KINDS[0] else "",
                linewidth=1,
                elinewidth=1,
                capsize=2,
                label=kind,
                zorder=3 if kind == KINDS[0] else 2,
                **style,
            )  # fmt: skip
        for row in lost:
            at = (place(row), 0.97)
            ax.plot(*at, linestyle="", markerfacecolor="white", clip_on=False,
                    transform=ax.get_xaxis_transform(), **style)  # fmt: skip
            ax.annotate("infinite", at, xycoords=ax.get_xaxis_transform(), xytext=(6, -3),
                        textcoords="offset points", fontsize=7)  # fmt: skip
        for row in drawn:
            if text := told(row):
                ax.annotate(text, (place(row), row.objective), xytext=away,
                            textcoords="offset points", fontsize=7,
                            ha="right" if away[0] < 0 else "left")  # fmt: skip
    ax.grid(True, linewidth=0.3)
