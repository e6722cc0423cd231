"""Where closed loops cost more than the best ones do, as a picture."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from capsyn.plots.figure import frame, literal, quantity, saved_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.modelling.domain import Box
    from capsyn.optima.comparison import OptimumComparison


MARGIN = 0.04
"""Share of the starts' extent that is left free around them."""


def plot_optimum(
    comparison: OptimumComparison, domain: Box, ax: Axes, plane: tuple[int, int] = (0, 1)
) -> Axes:
    """Draw the starts in the plane of two states, coloured by what loops from there cost more.

    That is in means of the least cost. The worst start has a ring, those whose loops ended early
    are crosses. Of one state it is the height.
    """
    starts, lost = comparison.starts, ~np.isfinite(comparison.excess)
    x = starts[:, plane[0]]
    alone = domain.n == 1
    y = np.where(lost, 0.0, comparison.excess) if alone else starts[:, plane[1]]
    more = comparison.excess[~lost]
    top = float(max(more.max(initial=0.0), 1e-9))
    drawn = ax.scatter(
        x[~lost], y[~lost], c=more, cmap="viridis_r", vmin=0.0, vmax=top, s=16, linewidths=0
    )
    ax.plot(x[lost], y[lost], "kx", markersize=5)
    k = comparison.worst
    ax.plot(x[k], y[k], "o", markersize=11, markerfacecolor="none", color="#c0392b")
    if alone:
        ax.set(xlabel=quantity(domain.names[0], domain.units[0]), ylabel="cost beyond the least")
    else:
        frame(ax, domain, plane)
        for axis, i in zip("xy", plane):  # where the starts are
            margin = MARGIN * (np.ptp(starts[:, i]) or domain.widths[i])
            ax.set(**{f"{axis}lim": (starts[:, i].min() - margin, starts[:, i].max() + margin)})
        bar = ax.figure.colorbar(drawn, ax=ax)
        bar.set_label("(cost - least) / mean of the least")
    return ax


def save_optimum_plot(
    comparison: OptimumComparison, domain: Box, title: str, path: str | os.PathLike[str]
) -> None:
    """Write the picture as PNG, PDF or SVG; see `capsyn.plots.figure.save_figure`."""
    with saved_figure(path, 6, 4.5) as figure:
        ax = plot_optimum(comparison, domain, figure.add_subplot())
        bound = "" if comparison.bound else " (no bound)"
        ax.set_title(literal(f"{title}: {comparison.ratio:.4g} times the least cost{bound}"))
