"""What alphabets achieve for the number of their symbols and the size of their policies."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
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
BESIDE = ((6, 4), (-6, 4), (6, -4), (-6, -4), (6, 14), (-6, 14), (6, -14), (-6, -14))
"""Where a text may stand, from its point [points]."""
WIDE = 8.0
"""Objectives that differ by more than this factor are drawn on a logarithmic axis."""


def alphabet_figure(
    rows: Sequence[Judged], objective: Mapping[str, float], title: str, best: int | None = None
) -> Figure:
    """Return a figure of a table: `plot_alphabets`, and `plot_sizes` where policies are known.

    The chosen alphabet of the count `best` has a star. Where every objective is infinite, the
    number of loops that are lost is drawn instead.
    """
    figure = new_figure(_width(rows), HEIGHT)
    _draw(rows, objective, title, best, figure)
    return figure


def save_alphabet_plot(
    rows: Sequence[Judged],
    objective: Mapping[str, float],
    title: str,
    path: str | os.PathLike[str],
    best: int | None = None,
) -> None:
    """Write the figure as PNG, PDF or SVG; see `capsyn.plots.figure.save_figure`."""
    with saved_figure(path, _width(rows), HEIGHT) as figure:
        _draw(rows, objective, title, best, figure)


def _width(rows: Sequence[Judged]) -> float:
    return WIDTH * (1 + any(row.bytes for row in rows))


def _draw(
    rows: Sequence[Judged],
    objective: Mapping[str, float],
    title: str,
    best: int | None,
    figure: Figure,
) -> None:
    from matplotlib.ticker import MaxNLocator

    panels = 1 + any(row.bytes for row in rows)
    axes = figure.subplots(1, panels, sharey=True, squeeze=False)[0]
    name = f"objective: {weighed(objective)}"
    if not any(math.isfinite(row.objective) for row in rows):
        name = "closed loops that are lost\n(all objectives are infinite)"
        axes[0].yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        rows = [replace(row, objective=row.lost, low=row.lost, high=row.lost) for row in rows]
    plot_alphabets(rows, axes[0], best)
    axes[0].set_ylabel(literal(name))
    if panels == 2:
        plot_sizes(rows, axes[1], best)
    figure.suptitle(literal(title), fontsize=11)


def plot_alphabets(rows: Sequence[Judged], ax: Axes, best: int | None = None) -> Axes:
    """Draw the objective of alphabets, with its interval, against the number of their symbols.

    Each kind has a marker and a colour. The chosen alphabets are joined by a line, and have their
    success where it is not that of all loops. An objective that is infinite stands at the top.
    """
    from matplotlib.ticker import MaxNLocator

    places = {kind: APART * (k - (len(KINDS) - 1) / 2) for k, kind in enumerate(KINDS)}

    def place(row: Judged) -> float:
        return len(row.alphabet) + places[row.kind]

    _draw_kinds(rows, ax, place, best)
    ax.set_xlabel("symbols")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    ax.margins(y=0.1)
    if rows:
        counts = [len(row.alphabet) for row in rows]
        room = max(0.6, 0.16 * (max(counts) - min(counts)))
        ax.set_xlim(min(counts) - room, max(counts) + room)
        bars = "bars: 95 % interval" if any(row.high > row.low for row in rows) else None
        ax.legend(frameon=False, fontsize=8, title=bars, title_fontsize=7)
    _tell(rows, ax, place, _told_success)
    return ax


def plot_sizes(rows: Sequence[Judged], ax: Axes, best: int | None = None) -> Axes:
    """Draw the objective of alphabets against the bytes of their policies, on a logarithmic axis.

    Each point has the number of its symbols. Alphabets without a policy are left out.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    known = [row for row in rows if row.bytes]

    def place(row: Judged) -> float:
        return row.bytes or 0

    _draw_kinds(known, ax, place, best)
    ax.set(xscale="log", xlabel="tables of the policy in C [bytes]")
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.margins(y=0.1)
    if known:
        sizes = [place(row) for row in known]
        room = max(1.5, (max(sizes) / min(sizes)) ** 0.15)
        ax.set_xlim(min(sizes) / room, max(sizes) * room)
    _tell(known, ax, place, lambda row: str(len(row.alphabet)))
    return ax


def _told_success(row: Judged) -> str:
    if row.kind != KINDS[0] or row.success in (None, 1.0):
        return ""
    return f"{row.success:.1%}"


def _draw_kinds(
    rows: Sequence[Judged], ax: Axes, place: Callable[[Judged], float], best: int | None
) -> None:
    """Draw rows at their places across."""
    finite = [row.objective for row in rows if math.isfinite(row.objective)]
    if finite and min(finite) > 0 and max(finite) > WIDE * min(finite):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
    top = ax.get_xaxis_transform()
    for kind in KINDS:
        some = sorted((row for row in rows if row.kind == kind), key=place)
        style: dict[str, Any] = {"marker": MARKERS[kind], "color": COLORS[kind], "markersize": 6.0}
        drawn = [row for row in some if math.isfinite(row.objective)]
        lost = [place(row) for row in some if not math.isfinite(row.objective)]
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
        if lost:
            ax.plot(lost, [0.97] * len(lost), linestyle="", markerfacecolor="white", clip_on=False,
                    transform=top, label="" if drawn else kind, **style)  # fmt: skip
    if len(finite) < len(rows):
        ax.text(0.01, 0.97, "infinite", transform=ax.transAxes, fontsize=7, va="center")
    for row in rows:
        if (row.kind, row.count) == (KINDS[0], best):
            known = math.isfinite(row.objective)
            at = (place(row), row.objective if known else 0.97)
            ax.plot(
                *at,
                "*",
                transform=ax.transData if known else top,
                markersize=13,
                zorder=4,
                color=COLORS[row.kind],
                markeredgecolor="white",
                label="the choice",
            )
    ax.grid(True, linewidth=0.3)


def _tell(
    rows: Sequence[Judged],
    ax: Axes,
    place: Callable[[Judged], float],
    told: Callable[[Judged], str],
) -> None:
    """Write what is told of each row beside its point, where nothing else stands if possible.

    Texts of the same words at the same point are written once; a text for which there is no room
    is left out.
    """
    across, up = 72 * WIDTH * 0.85, 72 * HEIGHT * 0.8  # of a panel, about [points]
    drawn = [row for row in rows if math.isfinite(row.objective)]
    bottom, _ = ax.get_ylim()  # scales the axes, which are then known
    to_axes = ax.transData + ax.transAxes.inverted()
    spots = [to_axes.transform((place(row), row.objective)) * (across, up) for row in drawn]
    taken = [(x - 5, y - 5, x + 5, y + 5) for x, y in spots]
    for row, (x, _) in zip(drawn, spots):
        ends = [(place(row), max(end, bottom)) for end in (row.low, row.high)]
        low, high = to_axes.transform(ends)[:, 1] * up
        taken.append((x - 2, low, x + 2, high))
    written = set[tuple[float, float, str]]()
    for row, (x, y) in zip(drawn, spots):
        text, at = told(row), (place(row), row.objective)
        if not text or (*at, text) in written:
            continue
        written.add((*at, text))
        wide, high = 4.5 * len(text), 7.0
        for right, above in BESIDE:
            left, low = x + right - (wide if right < 0 else 0), y + above - high / 2
            box = (left, low, left + wide, low + high)
            if not any(_overlap(box, other) for other in taken):
                taken.append(box)
                side = "left" if right > 0 else "right"
                ax.annotate(text, at, xytext=(right, above), textcoords="offset points",
                            fontsize=7, ha=side, va="center")  # fmt: skip
                break


def _overlap(one: Sequence[float], other: Sequence[float]) -> bool:
    """Return whether two boxes, each left, low, right and high, overlap."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
