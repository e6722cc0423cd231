"""Pictures of a policy's cells in the plane of two states, or of exogenous inputs."""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.errors import ProblemError, warn
from capsyn.modelling.switching import DEFAULT
from capsyn.modelling.targets import target_program
from capsyn.plots.figure import frame, literal, outline_width, rectangles, saved_figure
from capsyn.plots.symbols import draw_marks, draw_names, handlers, patch, written
from capsyn.policies.checks import labels_in_force
from capsyn.policies.colors import PALETTE, Look, symbol_looks
from capsyn.policies.in_force import staying_rows, stays
from capsyn.validation import describe, finite_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.policies.policy import Policy

PIXELS = 800
"""Along each axis of a picture of oblique splits."""
MOST_NAMED = 17
"""Most rows of a legend, which must be no higher than the picture."""
MOST_COLUMNS = 4
"""More symbols than fit into so many columns are not named in the legend."""
HATCH, INK = "xxxxxx", "#000000"
"""What is drawn where a symbol stays only because it is in force."""
LINE_WIDTH = 1.5
"""Of the lines around the target, and the states from which limits are kept [points]."""
LEGEND_ROOM = 1.8
"""Width of the legends that a saved picture has room for without being wider [inches]."""


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

    More than eight symbols have marks over their colours, and names in the regions that have room.
    Long names are replaced by numbers there, with u1 for the first symbol. The legend lists the
    symbols that are drawn, or those with the largest areas if there are very many. A dashed line
    surrounds the target.

    For a policy that remembers, the picture shows what follows one symbol in force. States are
    hatched where a symbol stays only because it is in force: the start would take another symbol
    there.

    Parameters
    ----------
    policy : Policy
        The policy. The picture shows its cells that meet the plane, or the symbols of `PIXELS` by
        `PIXELS` states if cells are oblique.
    plane : two axes
        Indices or names of the states on the horizontal and the vertical axis; exogenous inputs
        come after the states.
    at : mapping of name to float, optional
        Values of the other states and exogenous inputs [their units]. Default: the middles.
    ax : Axes, optional
        The Axes to draw on. Default: the current axes.
    outlines, legend : bool
        Whether to outline the cells, and to name the symbols.
    current : symbol index or name, optional
        The symbol in force, -1 for the default control. States where this symbol stays are hatched.
        Default: the default control, as at the start, with hatches where any symbol may stay.
    """
    import matplotlib.pyplot as plt

    domain = policy.space
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
    in_force = labels_in_force(current, (), policy.alphabet)
    now = None if in_force is None else int(in_force[0])
    ax = plt.gca() if ax is None else ax
    section = _Slice(policy, point, (horizontal, vertical), now)
    frame(ax, domain, (horizontal, vertical))
    draw = _draw_pixels if policy.has_planes else _draw_boxes
    shown, hatched = draw(section, ax, outlines)
    named = sorted(shown)
    if len(policy.alphabet) > len(PALETTE):
        draw_marks(ax, section.labels, section.looks)
        draw_names(ax, section.labels, section.looks, section.written)
        named = section.largest(named, MOST_NAMED * MOST_COLUMNS - hatched - 2)
    lines = _draw_lines(section, ax)
    if legend:
        _draw_legend(section, named, len(shown) - len(named), hatched, lines, ax)
    where = ", ".join(f"{domain.names[i]} = {point[i]:g}" for i in others)
    title = policy.title + (f" at {where}" if where else "")
    if policy.remembers:
        title += f", {section.names[-1 if now is None else now]} in force"
    ax.set_title(literal(title), wrap=True)
    return ax


@dataclass(frozen=True, eq=False)
class _Slice:
    """What is drawn: the plane of two axes of a policy through a state (n,), after a label."""

    policy: Policy
    point: np.ndarray
    plane: tuple[int, int]
    now: int | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all labels, the default last."""
        return (*self.policy.alphabet.names, DEFAULT)

    @property
    def written(self) -> list[str]:
        """Return what stands for them in their regions."""
        return [*written(self.policy.alphabet.names), DEFAULT]

    @property
    def looks(self) -> list[Look]:
        """Looks of all labels, the default last."""
        return [*symbol_looks(len(self.policy.alphabet)), Look("#FFFFFF", 0)]

    @property
    def colors(self) -> np.ndarray:
        """Their colours."""
        return np.array([look.color for look in self.looks], dtype=object)

    @functools.cached_property
    def pixels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates (P,) along both axes of the plane, and states (P * P, n)."""
        domain, axes = self.policy.space, list(self.plane)
        low, high = domain.lower[axes], domain.upper[axes]
        x, y = (np.linspace(a, b, 2 * PIXELS + 1)[1::2] for a, b in zip(low, high))
        states = np.tile(self.point, (PIXELS * PIXELS, 1))
        for i, values in zip(axes, np.meshgrid(x, y)):
            states[:, i] = values.ravel()
        return x, y, states

    @functools.cached_property
    def labels(self) -> np.ndarray:
        """Labels (P, P) that follow at the pixels, the lowest row first; N in gaps."""
        states, now = self.pixels[2], self.now
        in_force = None if now is None else np.full(len(states), now, dtype=np.int32)
        labels = self.policy.leaves(states, True, in_force=in_force)
        labels = np.where(labels < 0, len(self.policy.alphabet), labels)
        return labels.reshape(PIXELS, PIXELS)

    def largest(self, labels: Sequence[int], most: int) -> list[int]:
        """Return labels, ascending: of more than `most` those with the largest areas."""
        areas = np.bincount(self.labels.ravel(), minlength=len(self.names))
        return sorted(sorted(labels, key=lambda label: -areas[label])[:most])


def _draw_legend(
    section: _Slice, named: Sequence[int], more: int, hatched: bool, lines: list[Any], ax: Axes
) -> None:
    """Name labels, and say what is hatched and what lines are around."""
    from matplotlib.patches import Patch

    alphabet, names, now = section.policy.alphabet, section.names, section.now
    texts = {k: names[k] for k in named}
    if len(alphabet) > len(PALETTE):
        short = section.written
        texts = {
            k: text if short[k] == text else f"{short[k]}: {text}" for k, text in texts.items()
        }
    handles = [patch(section.looks[k], text) for k, text in texts.items()]
    if more:
        handles.append(Patch(alpha=0.0, label=f"and {more} more"))
    if hatched:
        what = "the one in force" if now is None else literal(names[now])
        handles.append(
            Patch(facecolor="none", edgecolor=INK, hatch=HATCH, lw=0, label=f"{what} stays")
        )
    title = ", ".join(alphabet.inputs)
    if alphabet.m == 1 and alphabet.units[0]:
        title += f" [{alphabet.units[0]}]"
    rows = MOST_NAMED - max(0, len(lines) - 1)
    ax.legend(
        handles=[*handles, *lines],
        handler_map=handlers(),
        title=literal(title),
        ncols=-(-(len(handles) + len(lines)) // (rows + len(lines))),
        alignment="left",
        loc="upper left",
        bbox_to_anchor=(1.01, 1),
        frameon=False,
        fontsize="small" if len(handles) > MOST_NAMED else None,
    )


def _draw_boxes(section: _Slice, ax: Axes, outlines: bool) -> tuple[set[int], bool]:
    """Draw the cells that meet the plane.

    Return what follows the label in force there, and whether some are hatched.
    """
    from matplotlib.collections import PathCollection, PolyCollection
    from matplotlib.path import Path

    policy, plane, now = section.policy, section.plane, section.now
    following = policy.transitions[:, -1 if now is None else now]
    staying = staying_rows(policy, now)
    boxes, counts = policy.cells.boxes(), policy.cells.counts
    steps = policy.space.locate(section.point[None, :], counts)[0]
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
                facecolors=section.colors[labels],
                edgecolors="white" if outlines else "face",
                linewidths=outline_width(level) if outlines else 0.1,
            )
        )
    if bands:
        whole = Path.make_compound_path_from_polys(np.array(bands))  # hatches are slow for each
        band = PathCollection([whole], facecolors="none", edgecolors=INK, linewidths=0, hatch=HATCH)
        ax.add_collection(band)
    return shown, bool(bands)


def _draw_pixels(section: _Slice, ax: Axes, outlines: bool) -> tuple[set[int], bool]:
    """Draw what follows the label in force at the pixels; there are no outlines.

    Return these labels, and whether some states are hatched.
    """
    from matplotlib.colors import to_rgb

    x, y, states = section.pixels
    table = np.array([to_rgb(color) for color in section.colors])
    ax.imshow(
        table[section.labels],
        extent=(*ax.get_xlim(), *ax.get_ylim()),
        origin="lower",
        aspect="auto",
        interpolation="nearest",
    )
    band = stays(section.policy, states, section.now).reshape(PIXELS, PIXELS)
    if band.any():
        ax.contourf(x, y, band, levels=[0.5, 1.5], colors="none", hatches=[HATCH])
    return set(np.unique(section.labels).tolist()), bool(band.any())


def _draw_lines(section: _Slice, ax: Axes) -> list[Any]:
    """Draw lines around the states from which limits are kept, and around the target.

    Return their handles in a legend.
    """
    from matplotlib.lines import Line2D

    policy, sets = section.policy, []
    if policy.kept is not None:
        kept = policy.keeps_limits(section.pixels[2], current=section.now)
        sets.append(("limits are kept inside", "-", kept))
    if policy.target is not None:
        inside = target_program(policy.target, policy.space).evaluate(section.pixels[2].T)[0][0]
        sets.append(("target", "--", inside))
    handles = []
    for text, style, inside in sets:
        padded = np.pad(inside.reshape(PIXELS, PIXELS).astype(float), 1)  # closed at the edge
        x, y = (np.concatenate([[v[0]], v, [v[-1]]]) for v in section.pixels[:2])
        if padded.any():
            line: dict[str, Any] = {"linewidths": LINE_WIDTH, "linestyles": style, "zorder": 3.5}
            ax.contour(x, y, padded, levels=[0.5], colors=INK, **line)
        if padded.any() or style == "-":
            handles.append(Line2D([], [], color=INK, lw=LINE_WIDTH, ls=style, label=text))
    return handles


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
        ax = plot_policy(policy, plane, at, figure.add_subplot(), outlines, current=current)
        legend: Any = ax.get_legend()
        wide = legend.get_window_extent().width / figure.dpi
        figure.set_figwidth(7 + max(0.0, wide - LEGEND_ROOM))
