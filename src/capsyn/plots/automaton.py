"""Pictures of automata: symbols as circles, transitions as arrows with their regions."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.execution.files import write_text
from capsyn.plots.figure import FORMATS, check_format, literal, reproducible, save_figure
from capsyn.plots.transition_matrix import draw_matrix, matrix_size
from capsyn.policies.colors import ink_on, symbol_colors

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.automata.automaton import Automaton, Edge

GREY = "#999999"
LINE = "#333333"
BOW = 0.08
"""Height of arcs over their chords, in chords."""
MOST_BOW = 0.5
"""Most height of arcs, in radii of the vertices."""
LOOP = 0.85
"""Size of the loops at vertices, in radii of these."""
FEW = 4
"""Up to so many vertices are drawn with large letters, and labels halfway on their arrows."""
MOST_LABELLED = 8
"""More vertices than these are drawn as a matrix."""
LONGEST_NAME = 12
"""Longer names are not written into the circles, but beside them."""
CLOSE = 0.42
"""How far from their targets the labels of more than a few vertices are."""


def plot_automaton(automaton: Automaton, ax: Axes | None = None) -> Axes:
    """Draw an automaton as a graph: the finite state machine of the paper's figures 3 and 4.

    Arrows that are proved impossible are dashed and grey. Undecided arrows are dotted. A star marks
    arrows on which the loop chatters somewhere. More than `MOST_LABELLED` vertices are drawn as a
    matrix: a row for each symbol in force, and a column for each that may follow.

    Parameters
    ----------
    automaton : Automaton
        The automaton to draw.
    ax : Axes, optional
        The Axes to draw on. Default: the current axes.
    """
    import matplotlib.pyplot as plt
    from matplotlib.patches import Circle

    ax = plt.gca() if ax is None else ax
    count = len(automaton.vertices)
    if count > MOST_LABELLED:
        draw_matrix(automaton, ax)
        ax.set_title(literal(automaton.name))
        return ax
    centers, radius = _layout(count)
    size = 11.0 if count <= FEW else 8.0
    reach = radius * (1 + 2.4 * LOOP)
    ax.set_aspect("equal")
    ax.axis("off")
    ax.set_xlim(centers[:, 0].min() - reach, centers[:, 0].max() + reach)
    ax.set_ylim(centers[:, 1].min() - reach, centers[:, 1].max() + reach)
    arrows = [*automaton.edges]
    curves = {edge: _curve(automaton, edge, centers, radius) for edge in arrows}
    for edge, curve in curves.items():
        _draw_arrow(ax, automaton, edge, curve)
    wide = 0.015 if automaton.remembers else 0.0125  # names of two symbols, or of one
    box = np.array([wide, 0.0105]) * size
    places = _label_places(curves, centers, radius, box)
    for edge, place in places.items():
        ax.text(
            float(place[0]),
            float(place[1]),
            automaton.edge_text(edge),
            color=_arrow_color(automaton, edge),
            fontsize=size,
            ha="center",
            va="center",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
            zorder=3,
        )
    short = max(map(len, automaton.names)) <= LONGEST_NAME
    colors = vertex_colors(automaton)
    for (x, y), label, name in zip(centers, automaton.vertices, automaton.names):
        color = colors[label]
        ax.add_patch(Circle((x, y), radius, facecolor=color, edgecolor=LINE, zorder=4))
        text = name if short else f"u{automaton.symbol_number(label)}"
        fit = (330 if count <= 2 else 400) * radius / len(text)
        ax.text(
            x,
            y,
            literal(text),
            color=ink_on(color),
            fontsize=min(13.0, fit),
            ha="center",
            va="center",
            zorder=5,
        )
    ax.set_title(literal(automaton.name))
    _draw_legend(ax, automaton, arrows, short)
    return ax


def vertex_colors(automaton: Automaton) -> dict[int, str]:
    """Return the colours ``#rrggbb`` of the vertices by symbol, those of `plot_policy`."""
    from matplotlib.colors import to_hex

    colors = [to_hex(color) for color in symbol_colors(automaton.symbols)] + ["#ffffff"]
    return {label: colors[label] for label in automaton.vertices}


def save_automaton(automaton: Automaton, path: str | os.PathLike[str]) -> None:
    """Write an automaton as DOT text, or as a picture in PNG, PDF or SVG, by the ending of `path`.

    The same automaton gives the same bytes. A file at `path` is replaced only by a complete file.
    """
    if check_drawing(path) == "dot":
        write_text(path, automaton.to_dot(vertex_colors(automaton)))
        return
    with reproducible():
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine

        count = len(automaton.vertices)
        size = (5.4, 2.8) if count <= 2 else (6.6, 7.2)
        size = matrix_size(count) if count > MOST_LABELLED else size
        layout = ConstrainedLayoutEngine(h_pad=0.1, w_pad=0.05)
        figure = Figure(figsize=size, layout=layout)
        plot_automaton(automaton, figure.add_subplot())
        save_figure(figure, path)


def check_drawing(path: str | os.PathLike[str]) -> str:
    """Return the kind of drawing that a path ends with."""
    return check_format(path, ("dot", *FORMATS), "`path`")


def _layout(count: int) -> tuple[np.ndarray, float]:
    """Return the centres (V, 2) of vertices, clockwise from the left of the top, and their radius.

    All of them lie on a ring, so that no straight arrow passes over a vertex; lengths are relative
    to its radius.
    """
    turns = math.pi / 2 + math.pi / count - 2 * math.pi * np.arange(count) / count
    centers = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    if count == 1:
        centers = np.zeros((1, 2))
    gap = 2 * math.sin(math.pi / count) if count > 1 else 2.0
    return centers, min(0.2, 0.21 * gap)


def _curve(automaton: Automaton, edge: Edge, centers: np.ndarray, radius: float) -> np.ndarray:
    """Return the control points of an arrow: (3, 2) of an arc, (4, 2) of a loop."""
    start, end = (centers[automaton.vertices.index(k)] for k in (edge.source, edge.target))
    if edge.source != edge.target:
        chord = end - start
        length = float(np.linalg.norm(chord))
        height = min(BOW * length, MOST_BOW * radius if len(centers) > FEW else math.inf)
        return np.array([start, (start + end) / 2 + 2 * height / length * _left(chord), end])
    distance = float(np.linalg.norm(start))
    outward = start / distance if distance else np.array([0.0, 1.0])
    across, out = _left(outward) * radius * LOOP, outward * radius
    far = start + out * (1 + 2.4 * LOOP)
    foot = start + 0.85 * out
    return np.array(
        [foot - 0.6 * across, far - 1.5 * across, far + 1.5 * across, foot + 0.6 * across]
    )


def _left(vector: np.ndarray) -> np.ndarray:
    """Return a vector turned to the left."""
    return np.array([-vector[1], vector[0]])


def _points(curve: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return points (T, 2) of a Bezier curve."""
    degree = len(curve) - 1
    weights = [math.comb(degree, k) * t**k * (1 - t) ** (degree - k) for k in range(degree + 1)]
    return np.stack(weights, axis=1) @ curve


def _label_places(
    curves: dict[Edge, np.ndarray],
    centers: np.ndarray,
    radius: float,
    box: np.ndarray,
) -> dict[Edge, np.ndarray]:
    """Return where the labels of arrows go, so that they keep clear of each other.

    Of the places on its arc, from the best one on, a label gets the first that is clear of labels,
    vertices and other arrows, else of labels and vertices, else the one farthest from them. The
    best one is the middle, or near the target where there are many arrows. The arrows are curves
    (3 or 4, 2), the vertices circles with centers (V, 2); a label has the width and height `box`.
    """
    lines = {edge: _points(curve, np.linspace(0, 1, 60)) for edge, curve in curves.items()}
    loops = [edge for edge in curves if edge.source == edge.target]
    placed = {edge: _points(curves[edge], np.array([0.5]))[0] for edge in loops}
    for edge, curve in curves.items():
        if edge in placed:
            continue
        t = np.linspace(0.2, 0.8, 61)
        spots = _points(curve, t)
        away = np.abs(np.linalg.norm(spots - curve[-1], axis=1) - CLOSE)
        order = np.argsort(np.abs(t - 0.5) if len(centers) <= FEW else away, kind="stable")
        spots = spots[order]
        others = np.concatenate([line for e, line in lines.items() if e != edge] or [spots + 9])
        taken = np.array(list(placed.values())).reshape(-1, 2)
        labels = _clearance(spots, taken, 2 * box)
        vertices = (np.linalg.norm(spots[:, None] - centers, axis=2) - radius).min(axis=1)
        apart = np.minimum(labels, vertices / box.max())
        arrows = _clearance(spots, others, box)
        clear = np.flatnonzero((apart > 1) & (arrows > 1))
        if not len(clear):
            clear = np.flatnonzero(apart > 1)
        placed[edge] = spots[clear[0] if len(clear) else int(apart.argmax())]
    return placed


def _clearance(spots: np.ndarray, others: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return how far spots (S, 2) are from the nearest of points (K, 2), in half boxes."""
    if not len(others):
        return np.full(len(spots), np.inf)
    return (np.abs(spots[:, None] - others) / (box / 2)).max(axis=2).min(axis=1)


def _draw_arrow(ax: Axes, automaton: Automaton, edge: Edge, curve: np.ndarray) -> None:
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path as Curve

    centers, radius = _layout(len(automaton.vertices))
    points = curve
    if edge.source != edge.target:  # from rim to rim
        t = np.linspace(0, 1, 401)
        line = _points(curve, t)
        outside = [np.linalg.norm(line - end, axis=1) > radius * 1.03 for end in curve[[0, 2]]]
        inner = t[outside[0] & outside[1]]
        points = _part(curve, inner[0], inner[-1])
    code = Curve.CURVE3 if len(points) == 3 else Curve.CURVE4
    codes = [Curve.MOVETO] + [code] * (len(points) - 1)
    impossible = edge.possible is False
    ax.add_patch(
        FancyArrowPatch(
            path=Curve(points, codes),
            arrowstyle="-|>",
            mutation_scale=10 if len(automaton.vertices) <= FEW else 7,
            color=_arrow_color(automaton, edge),
            linestyle=_line_style(automaton, edge),
            linewidth=0.7 if impossible else 1.0,
            shrinkA=0,
            shrinkB=0,
            zorder=1 if impossible else 2,
        )
    )


def _part(curve: np.ndarray, start: float, end: float) -> np.ndarray:
    """Return the control points of a part of a quadratic Bezier curve."""
    first, last = _points(curve, np.array([start, end]))
    slope = 2 * ((1 - start) * (curve[1] - curve[0]) + start * (curve[2] - curve[1]))
    return np.array([first, first + slope * (end - start) / 2, last])


def _line_style(automaton: Automaton, edge: Edge) -> Any:
    if edge.possible is False:
        return (0, (4, 3))
    return (0, (1, 2)) if edge.possible is None and automaton.switching else "solid"


def _arrow_color(automaton: Automaton, edge: Edge) -> str:
    """Return the colour of an arrow; many arrows have those of their targets, darkened."""
    if edge.possible is False:
        return GREY
    if len(automaton.vertices) <= FEW:
        return LINE
    color = vertex_colors(automaton)[edge.target]
    parts = (int(color[k : k + 2], 16) * 2 // 3 for k in (1, 3, 5))
    return "#" + "".join(f"{part:02x}" for part in parts)


def _draw_legend(ax: Axes, automaton: Automaton, arrows: list[Edge], short: bool) -> None:
    """Say what dashes, dots and stars mean, where there are any, and the names that are long."""
    from matplotlib.lines import Line2D

    handles = []
    if any(edge.possible is False for edge in arrows):
        handles.append(Line2D([], [], color=GREY, lw=0.7, ls=(0, (4, 3)), label="impossible"))
    if automaton.switching is None:
        handles.append(Line2D([], [], ls="", label="without a model: what is possible is unknown"))
    elif any(edge.possible is None for edge in arrows):
        handles.append(Line2D([], [], color=LINE, lw=1.0, ls=(0, (1, 2)), label="undecided"))
    if any(edge.sliding for edge in arrows):
        handles.append(Line2D([], [], ls="", marker="$*$", color=LINE, label="chatters somewhere"))
    if automaton.remembers:
        handles.append(Line2D([], [], ls="", label=literal(automaton.guards_are)))
    if not short:
        for label, name in zip(automaton.vertices, automaton.names):
            text = literal(f"u{automaton.symbol_number(label)} = {name}")
            handles.append(Line2D([], [], ls="", label=text))
    if handles:
        ax.legend(
            handles=handles,
            loc="upper center",
            bbox_to_anchor=(0.5, 0.0),
            ncols=min(len(handles), 3),
            frameon=False,
            fontsize=8.5,
        )
