"""Pictures of policies; every function returns the Axes that it drew on."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.decision_tree import DecisionTree
from capsyn.domain import Box
from capsyn.errors import ProblemError
from capsyn.files import atomic_write
from capsyn.policy import Policy
from capsyn.simulation import Trajectory
from capsyn.validation import describe, finite_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#999999")
"""Colours that stay apart under colour blindness (Okabe and Ito)."""
PIXELS = 800
"""Along each axis of a picture of oblique splits."""
FORMATS = ("png", "pdf", "svg")


def symbol_colors(count: int) -> list[Any]:
    """Return `count` colours that stay apart under colour blindness."""
    if count <= len(PALETTE):
        return list(PALETTE[:count])
    from matplotlib import colormaps

    return list(colormaps["cividis"](np.linspace(0, 1, count)))


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
    kind = f", {policy.guarantee.mode} tree" if isinstance(policy, DecisionTree) else ""
    ax.set_title(literal(policy.name + kind + (f" at {where}" if where else "")))
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


def rectangles(
    domain: Box,
    lower: np.ndarray,
    size: np.ndarray,
    counts: Sequence[int],
    plane: tuple[int, int] = (0, 1),
) -> np.ndarray:
    """Return the corners (M, 4, 2) [state units] of cells in the plane of two states.

    Parameters
    ----------
    domain : Box
        The domain.
    lower, size : (M, n), (n,) or (M, n)
        Lower corners and edge lengths of the cells, in finest cells.
    counts : n ints
        Finest cells along each axis.
    plane : two ints
        The states.
    """
    low, high = domain.points(lower, counts), domain.points(lower + size, counts)
    i, j = plane
    x = np.stack([low[:, i], high[:, i], high[:, i], low[:, i]], axis=1)
    y = np.stack([low[:, j], low[:, j], high[:, j], high[:, j]], axis=1)
    return np.stack([x, y], axis=2)


def outline_width(level: int) -> float:
    """Return the width of a level's outlines [points]; were they equal, they would hide cells."""
    return 0.3 * 0.7**level


def quantity(name: str, unit: str) -> str:
    """Return the label of an axis."""
    return literal(f"{name} [{unit}]" if unit else name)


def literal(text: str) -> str:
    """Return a text that matplotlib draws as it is: a dollar begins no formula."""
    return text.replace("$", r"\$")


def frame(ax: Axes, domain: Box, plane: tuple[int, int] = (0, 1)) -> None:
    """Give the axes names, units and bounds of two states of a domain."""
    for axis, i in zip("xy", plane):
        limits = (domain.lower[i], domain.upper[i])
        label = quantity(domain.names[i], domain.units[i])
        ax.set(**{f"{axis}lim": limits, f"{axis}label": label})


def plot_trajectory(trajectory: Trajectory, axes: Any) -> Any:
    """Draw the states and the controls of trajectories against time, one Axes for each.

    Parameters
    ----------
    trajectory : Trajectory
        One trajectory, or many: these are drawn over each other.
    axes : n + m Axes
        Where to draw: the states first, then the controls.
    """
    states, controls = trajectory.states, trajectory.controls
    n, m = states.shape[-1], controls.shape[-1]
    if len(axes) != n + m:
        raise ProblemError(f"`axes` must be {n + m} Axes; got {len(axes)}")
    states = states.reshape(-1, len(trajectory.times), n)
    controls = controls.reshape(-1, len(trajectory.times) - 1, m)
    thin: dict[str, Any] = {
        "linewidth": 1.2 if len(states) == 1 else 0.5,
        "alpha": 1.0 if len(states) < 8 else 0.5,
    }
    for i, ax in enumerate(axes):
        for k, (states_of, controls_of) in enumerate(zip(states, controls)):
            thin["color"] = PALETTE[k % len(PALETTE)]
            if i < n:
                ax.plot(trajectory.times, states_of[:, i], **thin)
            else:
                held = np.append(controls_of[:, i - n], np.nan)
                ax.step(trajectory.times, held, where="post", **thin)
        ax.set_ylabel(quantity(trajectory.names[i], trajectory.units[i]))
        ax.set_xlim(trajectory.times[0], trajectory.times[-1])
    axes[-1].set_xlabel("time [s]")
    return axes


def _plane(policy: Policy, plane: Sequence[int | str]) -> tuple[int, int]:
    names = policy.domain.names
    axes = []
    for axis in plane:
        if isinstance(axis, str) and axis in names:
            axes.append(names.index(axis))
        elif isinstance(axis, str) and axis.isdecimal() and int(axis) < len(names):
            axes.append(int(axis))
        elif isinstance(axis, (int, np.integer)) and 0 <= axis < len(names):
            axes.append(int(axis))
        else:
            raise ProblemError(
                f"`plane` must name two of the states {', '.join(names)}; got {describe(plane)}"
            )
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
    check_format(path)
    with reproducible():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 4.5), layout="constrained")
        plot_policy(policy, plane, at, figure.add_subplot(), outlines)
        save_figure(figure, path)


def save_trajectory_plot(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a picture of trajectories; see `plot_trajectory` and `save_figure`."""
    check_format(path)
    with reproducible():
        from matplotlib.figure import Figure

        count = len(trajectory.names)
        figure = Figure(figsize=(7, 1 + 1.3 * count), layout="constrained")
        plot_trajectory(trajectory, figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
        figure.align_ylabels()
        save_figure(figure, path)


def reproducible() -> contextlib.AbstractContextManager[None]:
    """Return a context in which the same drawing makes the same bytes."""
    import matplotlib

    return matplotlib.rc_context({"svg.hashsalt": "capsyn"})


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG, PDF or SVG, by the ending of `path`.

    The same figure, made within `reproducible`, gives the same bytes; what was at `path` is
    replaced only by a whole picture.
    """
    kind = check_format(path)
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}

    def write(temporary: Path) -> None:
        figure.savefig(temporary, format=kind, dpi=200, metadata=metadata[kind])

    atomic_write(path, write)


def check_format(path: str | os.PathLike[str]) -> str:
    """Return the picture format that a path ends with."""
    kind = Path(path).suffix.lstrip(".").lower()
    if kind not in FORMATS:
        raise ProblemError(
            f"a picture must end in {', '.join('.' + f for f in FORMATS)}; got '{path}'"
        )
    return kind
