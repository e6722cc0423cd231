"""Pictures of policies; every function returns the Axes that it drew on."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.files import atomic_write
from capsyn.policy import Policy
from capsyn.validation import describe, finite_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#999999")
"""Colours that stay apart under colour blindness (Okabe and Ito)."""
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
        The policy; its cells that meet the plane are drawn.
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
    from matplotlib.collections import PolyCollection
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
    corners: list[np.ndarray] = []
    labels: list[np.ndarray] = []
    for leaves in tree.leaves():
        size = tree.sizes(leaves.level)
        met = np.ones(len(leaves.lower), dtype=bool)
        for i in others:
            met &= (leaves.lower[:, i] <= steps[i]) & (steps[i] < leaves.lower[:, i] + size[i])
        low = leaves.lower[met]
        sides = [
            domain.faces(i, low[:, i] + more * size[i], tree.counts[i])
            for i in (horizontal, vertical)
            for more in (0, 1)
        ]
        left, right, bottom, top = sides
        x = np.stack([left, right, right, left], axis=1)
        y = np.stack([bottom, bottom, top, top], axis=1)
        corners.append(np.stack([x, y], axis=2))
        labels.append(leaves.labels[met])
    ax = plt.gca() if ax is None else ax
    colors = np.array([*symbol_colors(len(policy.alphabet)), "#FFFFFF"], dtype=object)
    label = np.concatenate(labels)
    ax.add_collection(
        PolyCollection(
            list(np.concatenate(corners)),
            facecolors=colors[label],
            edgecolors="white" if outlines else "face",
            linewidths=0.3 if outlines else 0.1,
        )
    )
    for axis, i in (("x", horizontal), ("y", vertical)):
        unit = f" [{domain.units[i]}]" if domain.units[i] else ""
        ax.set(
            **{
                f"{axis}lim": (domain.lower[i], domain.upper[i]),
                f"{axis}label": f"{domain.names[i]}{unit}",
            }
        )
    if legend:
        names = [*policy.alphabet.names, "default"]
        handles = [
            Patch(facecolor=colors[k], edgecolor="#666666", label=names[k])
            for k in np.unique(label)
        ]
        title = ", ".join(policy.alphabet.inputs)
        if policy.alphabet.m == 1 and policy.alphabet.units[0]:
            title += f" [{policy.alphabet.units[0]}]"
        ax.legend(
            handles=handles, title=title, loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False
        )
    where = ", ".join(f"{domain.names[i]} = {point[i]:g}" for i in others)
    ax.set_title(policy.name + (f" at {where}" if where else ""))
    return ax


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
    """Write a picture of a policy as PNG, PDF or SVG, by the ending of `path`.

    The same policy gives the same bytes; what was at `path` is replaced only by a whole picture.
    """
    kind = check_format(path)
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": "capsyn"}):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 4.5), layout="constrained")
        plot_policy(policy, plane, at, figure.add_subplot(), outlines)
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
