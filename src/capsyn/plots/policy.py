"""Pictures of a policy's cells in the plane of two states, or of exogenous inputs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.errors import ProblemError, warn
from capsyn.modelling.switching import DEFAULT
from capsyn.plots.figure import frame, literal, outline_width, rectangles, saved_figure
from capsyn.policies.checks import labels_in_force
from capsyn.policies.colors import symbol_colors
from capsyn.policies.in_force import staying_rows, stays
from capsyn.validation import describe, finite_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.policies.policy import Policy

PIXELS = 800
"""Along each axis of a picture of oblique splits."""
MOST_NAMED = 17
"""More symbols than these are not named, for a legend must be no higher than the picture."""
HATCH, INK = "xxxxxx", "#000000"
"""What is drawn where a symbol stays only because it is in force."""
KEPT_WIDTH = 1.5
"""Of the line around the states from which limits are kept [points]."""


def plot_policy(
    policy: Policy,
    plane: Sequence[int | str] = (0, 1),
    at: Mapping[str, float] | None = None,
    ax: Axes | None = None,
    outlines: bool = True,
    legend: bool = True,
    current: int | str | None = None,
) -> Axes:
    """Draw the cells of a policy in the plane of two states, or of exogenous inputs.

    Of a policy that remembers it is what follows one symbol in force, and hatched is where a symbol
    stays only because it is in force: there the start would take another.

    Parameters
    ----------
    policy : Policy
        The policy; its cells that meet the plane are drawn, or where they are oblique the symbols
        at `PIXELS` by `PIXELS` states.
    plane : two axes
        Indices or names of the states on the horizontal and the vertical axis; exogenous inputs
        come after the states.
    at : mapping of name to float, optional
        Values of the other states and exogenous inputs [their units]. Default: the middles.
    ax : Axes, optional
        Where to draw. Default: the current axes.
    outlines, legend : bool
        Whether to outline the cells, and to name the symbols.
    current : symbol index or name, optional
        The symbol in force, -1 for the default control, of which alone it is hatched where it
        stays. Default: that of the start, the default control, and hatched where any may stay.
    """
    import matplotlib.pyplot as plt

    domain, tree = policy.space, policy.cells
    if domain.n == 1:
        raise ProblemError("`policy` must have two states or more to be drawn; got one")
    horizontal, vertical = _plane(policy, plane)
    point = domain.lower + domain.widths / 2
    others = [i for i in range(domain.n) if i not in (horizontal, vertical)]
    free = [domain.names[i] for i in others]
    for name, value in (at or {}).items():
        if name not in free:
            raise ProblemError(
                f"`at` must name {_axes_are(policy)} outside the plane "
                f"({', '.join(free) or 'there is none'}); got {describe(name)}"
            )
        i = domain.names.index(name)
        point[i] = finite_number(f"at {name}", value)
        bounds = f"[{domain.lower[i]:g}, {domain.upper[i]:g}]"
        if not domain.lower[i] <= point[i] <= domain.upper[i]:
            if not domain.periodic[i]:
                raise ProblemError(f"`at {name}` must lie in {bounds}; got {point[i]:g}")
            asked, point = point[i], domain.wrap(point[None, :])[0]
            warn(f"`at {name}` of {asked:g} is {point[i]:g} in {bounds}, some periods away")
    steps = domain.locate(point[None, :], tree.counts)[0]
    in_force = labels_in_force(current, (), policy.alphabet)
    now = None if in_force is None else int(in_force[0])
    ax = plt.gca() if ax is None else ax
    colors = np.array([*symbol_colors(len(policy.alphabet)), "#FFFFFF"], dtype=object)
    if policy.has_planes:
        shown, hatched = _draw_pixels(policy, point, (horizontal, vertical), colors, ax, now)
    else:
        shown, hatched = _draw_boxes(
            policy, steps, (horizontal, vertical), colors, ax, outlines, now
        )
    if policy.kept is not None:
        _draw_kept(policy, point, (horizontal, vertical), ax, in_force)
    frame(ax, domain, (horizontal, vertical))
    if legend:
        _draw_legend(policy, shown, hatched, colors, ax, now)
    where = ", ".join(f"{domain.names[i]} = {point[i]:g}" for i in others)
    title = policy.title + (f" at {where}" if where else "")
    if policy.remembers:
        title += f", {_name(policy, now)} in force"
    ax.set_title(literal(title), wrap=True)
    return ax


def _name(policy: Policy, label: int | None) -> str:
    """Return the name of a label, by default the default's."""
    return (*policy.alphabet.names, DEFAULT)[-1 if label is None else label]


def _draw_legend(
    policy: Policy, shown: set[int], hatched: bool, colors: np.ndarray, ax: Axes, now: int | None
) -> None:
    """Name the labels that are shown, and say what is hatched."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    named = sorted(shown)
    if len(named) > MOST_NAMED - hatched:
        named = named[: MOST_NAMED - hatched - 1]
    handles: list[Any] = [
        Patch(facecolor=colors[k], edgecolor="#666666", label=literal(_name(policy, k)))
        for k in named
    ]
    if len(named) < len(shown):
        handles.append(Patch(alpha=0.0, label=f"and {len(shown) - len(named)} more"))
    if hatched:
        what = "the one in force" if now is None else literal(_name(policy, now))
        handles.append(
            Patch(facecolor="none", edgecolor=INK, hatch=HATCH, lw=0, label=f"{what} stays")
        )
    if policy.kept is not None:
        handles.append(Line2D([], [], color=INK, lw=KEPT_WIDTH, label="limits are kept inside"))
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


def _draw_boxes(
    policy: Policy,
    steps: np.ndarray,
    plane: tuple[int, int],
    colors: np.ndarray,
    ax: Axes,
    outlines: bool,
    now: int | None,
) -> tuple[set[int], bool]:
    """Draw the cells that meet the plane through a finest cell (n,).

    Return what follows the label in force there, and whether some are hatched.
    """
    from matplotlib.collections import PolyCollection

    following = policy.transitions[:, -1 if now is None else now]
    staying = staying_rows(policy, now)
    boxes, counts = policy.cells.boxes(), policy.cells.counts
    met = (boxes.lower <= steps) & (steps < boxes.upper)
    met[:, plane] = True
    shown: set[int] = set()
    bands = []
    for level in range(int(boxes.levels.max()) + 1):
        here = met.all(axis=1) & (boxes.levels == level)
        rows = boxes.labels[here]
        labels = following[rows]
        shown.update(labels.tolist())
        size = boxes.upper[here] - boxes.lower[here]
        corners = rectangles(policy.space, boxes.lower[here], size, counts, plane)
        bands.extend(corners[staying[rows]])
        ax.add_collection(
            PolyCollection(
                list(corners),
                facecolors=colors[labels],
                edgecolors="white" if outlines else "face",
                linewidths=outline_width(level) if outlines else 0.1,
            )
        )
    if bands:
        band = PolyCollection(bands, facecolors="none", edgecolors=INK, linewidths=0, hatch=HATCH)
        ax.add_collection(band)
    return shown, bool(bands)


def _draw_pixels(
    policy: Policy,
    point: np.ndarray,
    plane: tuple[int, int],
    colors: np.ndarray,
    ax: Axes,
    now: int | None,
) -> tuple[set[int], bool]:
    """Draw what follows a label in force at a grid of states in the plane through a state (n,).

    Return these labels, and whether some states are hatched.
    """
    from matplotlib.colors import to_rgb

    low, high = policy.space.lower[list(plane)], policy.space.upper[list(plane)]
    x, y, states = _pixels(policy, point, plane)
    in_force = None if now is None else np.full(len(states), now, dtype=np.int32)
    labels = policy.leaves(states, True, in_force=in_force)
    labels[labels < 0] = len(colors) - 1  # in gaps, which have the colour of the default
    table = np.array([to_rgb(color) for color in colors])
    ax.imshow(
        table[labels].reshape(PIXELS, PIXELS, 3),
        extent=(low[0], high[0], low[1], high[1]),
        origin="lower",
        aspect="auto",
        interpolation="nearest",
    )
    band = stays(policy, states, now).reshape(PIXELS, PIXELS)
    if band.any():
        ax.contourf(x, y, band, levels=[0.5, 1.5], colors="none", hatches=[HATCH])
    return set(np.unique(labels).tolist()), bool(band.any())


def _pixels(
    policy: Policy, point: np.ndarray, plane: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return coordinates (P,) along both axes of a plane through a state (n,), and states."""
    low, high = policy.space.lower[list(plane)], policy.space.upper[list(plane)]
    x, y = (np.linspace(a, b, 2 * PIXELS + 1)[1::2] for a, b in zip(low, high))
    states = np.tile(point, (PIXELS * PIXELS, 1))
    for i, values in zip(plane, np.meshgrid(x, y)):
        states[:, i] = values.ravel()
    return x, y, states


def _draw_kept(
    policy: Policy,
    point: np.ndarray,
    plane: tuple[int, int],
    ax: Axes,
    in_force: np.ndarray | None,
) -> None:
    """Draw the edge of the states from which limits are kept."""
    x, y, states = _pixels(policy, point, plane)
    kept = policy.keeps_limits(states, current=None if in_force is None else in_force[0])
    kept = np.pad(kept.reshape(PIXELS, PIXELS).astype(float), 1)  # closed at the domain's edge
    x, y = (np.concatenate([[v[0]], v, [v[-1]]]) for v in (x, y))
    if kept.any():
        ax.contour(x, y, kept, levels=[0.5], colors=INK, linewidths=KEPT_WIDTH)


def _plane(policy: Policy, plane: Sequence[int | str]) -> tuple[int, int]:
    names = policy.space.names
    axes = []
    for axis in plane:
        place: Any = axis
        if isinstance(axis, str):
            place = names.index(axis) if axis in names else int(axis) if axis.isdecimal() else -1
        if not isinstance(place, (int, np.integer)) or not 0 <= place < len(names):
            raise ProblemError(
                f"`plane` must name two of the {_axes_are(policy)} {', '.join(names)}; got "
                + describe(plane)
            )
        axes.append(int(place))
    if len(axes) != 2 or axes[0] == axes[1]:
        raise ProblemError(
            f"`plane` must name two different {_axes_are(policy)}; got {describe(plane)}"
        )
    return axes[0], axes[1]


def _axes_are(policy: Policy) -> str:
    """Return what the axes of a policy's space are."""
    return "states" if policy.exogenous is None else "states and exogenous inputs"


def save_policy_plot(
    policy: Policy,
    path: str | os.PathLike[str],
    plane: Sequence[int | str] = (0, 1),
    at: Mapping[str, float] | None = None,
    outlines: bool = True,
    current: int | str | None = None,
) -> None:
    """Write a picture of a policy as PNG, PDF or SVG; see `plot_policy` and `save_figure`."""
    with saved_figure(path, 7, 4.5) as figure:
        plot_policy(policy, plane, at, figure.add_subplot(), outlines, current=current)
