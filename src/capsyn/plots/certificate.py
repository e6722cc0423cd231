"""What is proved of a loop from each start, as a picture."""

from __future__ import annotations

import itertools
import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.certification.cell_map import OPEN, PROVED, REFUTED
from capsyn.plots.figure import frame, literal, quantity, saved_figure
from capsyn.verification.sentences import proved_share

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.certification.certificate import Certificate, ProvedCells

UNPROVED = {OPEN: "#f0c27a", REFUTED: "#d98880"}
"""Colours of cells with starts that are not proved."""
EDGE, FAILS = "#111111", "#a61c10"
"""Colours of what is around the set in which the loop stays, and of refuted starts."""


def plot_certificate(
    certificate: Certificate, ax: Axes, plane: tuple[int, int] = (0, 1), *, bar: bool = True
) -> Axes:
    """Draw what is proved in the plane of two states.

    For two states, the colour of a proved cell is the time by which its starts have arrived. For
    more states, the colour of a place is the share of the starts over this place that are proved.
    For one state, the height is the time. A line surrounds the set in which the loop stays, and a
    dashed line its ripple. Crosses are refuted starts, and the first of each kind has its name.
    `bar` adds the scale.
    """
    cells = certificate.cells
    if cells.domain.n == 1:
        _draw_line(certificate, ax)
        return ax
    planar = cells.domain.n == 2
    if planar:
        _draw_unproved(cells, ax, plane)
    values = _times(cells, plane) if planar else _shares(cells, plane)
    most = np.nanmax(values, initial=0.0) if planar else 1.0
    colors = "viridis_r" if planar else "viridis"
    drawn = _image(ax, cells, plane, values, cmap=colors, vmin=0.0, vmax=most or 1.0)
    _draw_staying(certificate, ax, plane)
    _draw_refuted(certificate, ax, certificate.refuted[:, list(plane)])
    frame(ax, cells.domain, plane)
    if bar:
        unit = certificate.conditions.get("time_unit", "s")
        label = f"arrived within [{unit}]" if planar else "share of the starts that is proved"
        ax.figure.colorbar(drawn, ax=ax).set_label(label)
    return ax


def save_certificate_plot(
    certificate: Certificate, title: str, path: str | os.PathLike[str]
) -> None:
    """Write the picture as PNG, PDF or SVG; more than two states give a panel for each pair.

    See `capsyn.plots.figure.save_figure`.
    """
    n = certificate.cells.domain.n
    pairs = list(itertools.combinations(range(n), 2)) or [(0, 0)]
    columns = math.ceil(math.sqrt(len(pairs)))
    rows = math.ceil(len(pairs) / columns)
    size = (6.0, 4.8) if len(pairs) == 1 else (3.6 * columns + 1, 3.2 * rows + 0.6)
    with saved_figure(path, *size) as figure:
        drawn = [
            plot_certificate(
                certificate, figure.add_subplot(rows, columns, k + 1), pair, bar=len(pairs) == 1
            )
            for k, pair in enumerate(pairs)
        ]
        if len(pairs) > 1:
            bar = figure.colorbar(drawn[0].images[-1], ax=drawn)
            bar.set_label("share of the starts that is proved")
        entries = {
            text: handle for ax in drawn for handle, text in zip(*ax.get_legend_handles_labels())
        }
        if entries:
            figure.legend(
                entries.values(), entries, loc="outside lower center", ncols=4, frameon=False
            )
        arrive, stay = proved_share(certificate.arrival), proved_share(certificate.staying)
        figure.suptitle(literal(f"{title}: {arrive} proved to arrive, {stay} to stay"), fontsize=11)


def _times(cells: ProvedCells, plane: tuple[int, int]) -> np.ndarray:
    """Return the times of proved cells, (across, up) [time unit], NaN elsewhere."""
    known = cells.statuses() == PROVED
    return np.where(known, cells.within, np.nan).reshape(cells.counts).transpose(plane)


def _shares(cells: ProvedCells, plane: tuple[int, int]) -> np.ndarray:
    """Return the share that is proved of the starts over each place of a plane; NaN for none."""
    starts = _over(cells.starts, cells, plane, np.sum)
    proved = _over(cells.starts * cells.arrives, cells, plane, np.sum)
    return np.divide(proved, starts, out=np.full(starts.shape, np.nan), where=starts > 0)


def _over(values: np.ndarray, cells: ProvedCells, plane: tuple[int, int], of: Any) -> np.ndarray:
    """Return a figure of cells (K,) over each place of a plane, (across, up)."""
    others = tuple(i for i in range(cells.domain.n) if i not in plane)
    found = of(values.reshape(cells.counts), axis=others)
    return found if plane[0] < plane[1] else found.T


def _image(
    ax: Axes, cells: ProvedCells, plane: tuple[int, int], values: np.ndarray, **style: Any
) -> Any:
    """Draw values of the cells of a plane, (across, up) or with channels behind."""
    lower, upper = cells.domain.lower, cells.domain.upper
    i, j = plane
    extent = (lower[i], upper[i], lower[j], upper[j])
    return ax.imshow(
        values.swapaxes(0, 1), origin="lower", extent=extent, aspect="auto",
        interpolation="nearest", **style,
    )  # fmt: skip


def _draw_unproved(cells: ProvedCells, ax: Axes, plane: tuple[int, int]) -> None:
    from matplotlib.colors import to_rgba

    statuses = cells.statuses().reshape(cells.counts).transpose(plane)
    image = np.zeros((*statuses.shape, 4))
    for status, color in UNPROVED.items():
        image[statuses == status] = to_rgba(color)
    _image(ax, cells, plane, image)
    if (statuses == OPEN).any():
        ax.fill([], [], color=UNPROVED[OPEN], label="open")


def _draw_staying(certificate: Certificate, ax: Axes, plane: tuple[int, int]) -> None:
    """Outline the cells in which the loop stays, and its ripple."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle

    cells = certificate.cells
    stays = _over(cells.stays, cells, plane, np.any)
    if stays.any():
        edges = list(_edges(stays, cells, plane))
        ax.add_collection(LineCollection(edges, colors=EDGE, linewidths=1.2, label="stays in"))
    if not np.isnan(certificate.ripple).any():
        (x0, x1), (y0, y1) = certificate.ripple[list(plane)]
        box = Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, linestyle="--", label="ripple")
        box.set(edgecolor=EDGE, linewidth=0.9)
        ax.add_patch(box)


def _edges(inside: np.ndarray, cells: ProvedCells, plane: tuple[int, int]) -> np.ndarray:
    """Return the lines (M, 2, 2) around cells of a plane; periodic axes go round."""
    found = []
    for side, axis in enumerate(plane):
        along = plane[1 - side]
        values = inside.swapaxes(0, side)
        outer = values[[-1]] if cells.domain.periodic[axis] else np.zeros_like(values[:1])
        last = values[[0]] if cells.domain.periodic[axis] else outer
        k, m = np.nonzero(np.diff(np.concatenate([outer, values, last]).astype(np.int8), axis=0))
        place = cells.domain.faces(axis, k, cells.counts[axis])
        ends = [cells.domain.faces(along, m + j, cells.counts[along]) for j in (0, 1)]
        lines = np.stack([np.stack([place, end], axis=1) for end in ends], axis=1)
        found.append(lines if side == 0 else lines[:, :, ::-1])
    return np.concatenate(found)


def _draw_refuted(certificate: Certificate, ax: Axes, places: np.ndarray) -> None:
    """Mark refuted starts at places (R, 2) of the axes; the first of each kind has its name."""
    if not len(places):
        return
    ax.plot(*places.T, "x", color=FAILS, markersize=7, markeredgewidth=1.6, label="refuted")
    for failure in dict.fromkeys(certificate.failures):
        x, y = places[certificate.failures.index(failure)]
        left = x > np.mean(ax.get_xlim())
        ax.annotate(
            literal(failure), (x, y), xytext=(-7 if left else 7, 5), textcoords="offset points",
            ha="right" if left else "left", fontsize=8, color=FAILS,
            bbox={"facecolor": "white", "alpha": 0.75, "pad": 1, "linewidth": 0},
        )  # fmt: skip


def _draw_line(certificate: Certificate, ax: Axes) -> None:
    """Draw the times of the cells of one state as heights, and what is open behind them."""
    cells = certificate.cells
    domain, unit = cells.domain, certificate.conditions.get("time_unit", "s")
    faces = domain.faces(0, np.arange(cells.counts[0] + 1), cells.counts[0])
    statuses, low, width = cells.statuses(), faces[:-1], np.diff(faces)
    top = 1.1 * np.max(cells.within, initial=0.0, where=statuses == PROVED) or 1.0
    for status, color in UNPROVED.items():
        some = statuses == status
        ax.bar(low[some], top, width[some], align="edge", color=color)
    if (statuses == OPEN).any():
        ax.fill([], [], color=UNPROVED[OPEN], label="open")
    some = statuses == PROVED
    ax.bar(low[some], cells.within[some], width[some], align="edge", color="#3b6ea5")
    some = np.asarray(cells.stays, bool)
    if some.any():
        ax.bar(low[some], 0.02 * top, width[some], align="edge", color=EDGE, label="stays in")
    heights = np.full(len(certificate.refuted), 0.5 * top)
    ax.set(
        xlim=(domain.lower[0], domain.upper[0]),
        ylim=(0, top),
        xlabel=quantity(domain.names[0], domain.units[0]),
        ylabel=f"arrived within [{unit}]",
    )
    _draw_refuted(certificate, ax, np.column_stack([certificate.refuted[:, 0], heights]))
