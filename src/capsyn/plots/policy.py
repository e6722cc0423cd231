"""Pictures of a policy's cells in the plane of two states."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.plots.figure import frame, literal, outline_width, rectangles, saved_figure
from capsyn.policies.colors import symbol_colors
from capsyn.validation import describe, finite_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.policies.policy import Policy

PIXELS = 800
"""Along each axis of a picture of oblique splits."""


def plot_policy(
    policy: Policy,
    plane: Sequence[int | str] = (0, 1),
    at: Mapping[str, float] | None = None,
    ax: Axes | None = None,
    outlines: bool = True,
    legend: bool = True,
) -> Axes:
    """Draw the cells of a policy in the plane of two states.

    Parameters
    ----------
    policy : Policy
        The policy; its cells that meet the plane are drawn, or where they are oblique the symbols
        at `PIXELS` by `PIXELS` states.
    plane : two axes
        Indices or names of the states on the horizontal and the vertical axis.
    at : mapping of name to float, optional
        Values of the other states [state units]. Default: the middle of the domain.
    ax : Axes, optional
        Where to draw. Default: the current axes.
    outlines, legend : bool
        Whether to outline the cells, and to name the symbols.
    """
    import matplotlib.pyplot as plt
    from matplotlib.patches import Patch

    domain, tree = policy.domain, policy.cells
    if domain.n == 1:
        raise ProblemError("`policy` must have two states or more to be drawn; got one")
    horizontal, vertical = _plane(policy, plane)
    point = domain.lower + domain.widths / 2
    others = [i for i in range(domain.n) if i not in (horizontal, vertical)]
    free = [domain.names[i] for i in others]
    for name, value in (at or {}).items():
        if name not in free:
            raise ProblemError(
                f"`at` must name states outside the plane ({', '.join(free) or 'there is none'}); "
                f"got {describe(name)}"
            )
        i = domain.names.index(name)
        point[i] = finite_number(f"at {name}", value)
        if not domain.periodic[i] and not domain.lower[i] <= point[i] <= domain.upper[i]:
            raise ProblemError(
                f"`at {name}` must lie in [{domain.lower[i]:g}, {domain.upper[i]:g}]; "
                f"got {point[i]:g}"
            )
    steps = domain.locate(point[None, :], tree.counts)[0]
    ax = plt.gca() if ax is None else ax
    colors = np.array([*symbol_colors(len(policy.alphabet)), "#FFFFFF"], dtype=object)
    if policy.has_planes:
        shown = _draw_pixels(policy, point, (horizontal, vertical), colors, ax)
    else:
        shown = _draw_boxes(policy, steps, (horizontal, vertical), colors, ax, outlines)
    frame(ax, domain, (horizontal, vertical))
    if legend:
        names = [literal(name) for name in (*policy.alphabet.names, "default")]
        handles = [
            Patch(facecolor=colors[k], edgecolor="#666666", label=names[k]) for k in sorted(shown)
        ]
        title = ", ".join(policy.alphabet.inputs)
        if policy.alphabet.m == 1 and policy.alphabet.units[0]:
            title += f" [{policy.alphabet.units[0]}]"
        ax.legend(
            handles=handles,
            title=literal(title),
            alignment="left",
            loc="upper left",
            bbox_to_anchor=(1.01, 1),
            frameon=False,
        )
    where = ", ".join(f"{domain.names[i]} = {point[i]:g}" for i in others)
    ax.set_title(literal(policy.title + (f" at {where}" if where else "")))
    return ax


def _draw_boxes(
    policy: Policy,
    steps: np.ndarray,
    plane: tuple[int, int],
    colors: np.ndarray,
    ax: Axes,
    outlines: bool,
) -> set[int]:
    """Draw the cells that meet the plane through a finest cell (n,); return their labels."""
    from matplotlib.collections import PolyCollection

    boxes, counts = policy.cells.boxes(), policy.cells.counts
    met = (boxes.lower <= steps) & (steps < boxes.upper)
    met[:, plane] = True
    shown: set[int] = set()
    for level in range(int(boxes.levels.max()) + 1):
        here = met.all(axis=1) & (boxes.levels == level)
        labels = boxes.labels[here]
        shown.update(labels.tolist())
        size = boxes.upper[here] - boxes.lower[here]
        ax.add_collection(
            PolyCollection(
                list(rectangles(policy.domain, boxes.lower[here], size, counts, plane)),
                facecolors=colors[labels],
                edgecolors="white" if outlines else "face",
                linewidths=outline_width(level) if outlines else 0.1,
            )
        )
    return shown


def _draw_pixels(
    policy: Policy, point: np.ndarray, plane: tuple[int, int], colors: np.ndarray, ax: Axes
) -> set[int]:
    """Draw the symbols at a grid of states in the plane through a state (n,); return them."""
    from matplotlib.colors import to_rgb

    low, high = policy.domain.lower[list(plane)], policy.domain.upper[list(plane)]
    x, y = (np.linspace(a, b, 2 * PIXELS + 1)[1::2] for a, b in zip(low, high))
    states = np.tile(point, (PIXELS * PIXELS, 1))
    grid = np.meshgrid(x, y)
    for i, values in zip(plane, grid):
        states[:, i] = values.ravel()
    labels = policy.leaves(states, True)
    labels[labels < 0] = len(colors) - 1  # in gaps, which have the colour of the default
    table = np.array([to_rgb(color) for color in colors])
    ax.imshow(
        table[labels].reshape(PIXELS, PIXELS, 3),
        extent=(low[0], high[0], low[1], high[1]),
        origin="lower",
        aspect="auto",
        interpolation="nearest",
    )
    return set(np.unique(labels).tolist())


def _plane(policy: Policy, plane: Sequence[int | str]) -> tuple[int, int]:
    names = policy.domain.names
    axes = []
    for axis in plane:
        place: Any = axis
        if isinstance(axis, str):
            place = names.index(axis) if axis in names else int(axis) if axis.isdecimal() else -1
        if not isinstance(place, (int, np.integer)) or not 0 <= place < len(names):
            raise ProblemError(
                f"`plane` must name two of the states {', '.join(names)}; got {describe(plane)}"
            )
        axes.append(int(place))
    if len(axes) != 2 or axes[0] == axes[1]:
        raise ProblemError(f"`plane` must name two different states; got {describe(plane)}")
    return axes[0], axes[1]


def save_policy_plot(
    policy: Policy,
    path: str | os.PathLike[str],
    plane: Sequence[int | str] = (0, 1),
    at: Mapping[str, float] | None = None,
    outlines: bool = True,
) -> None:
    """Write a picture of a policy as PNG, PDF or SVG; see `plot_policy` and `save_figure`."""
    with saved_figure(path, 7, 4.5) as figure:
        plot_policy(policy, plane, at, figure.add_subplot(), outlines)
