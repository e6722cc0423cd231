"""Pictures of automata with many symbols: a matrix of which symbol may follow which."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.plots.figure import literal
from capsyn.plots.symbols import textured
from capsyn.policies.colors import Look, symbol_looks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsyn.automata.automaton import Automaton, Edge

GREY = "#999999"
UNDECIDED = 0.4
"""Share of its colour that is left of an edge that is not decided."""
CELL = 24
"""Pixels of an edge, of few symbols, across and up."""
MOST_PIXELS = 960
LETTERS = 20
"""Longer names are cut."""
ROOM, SPACE = 0.19, 2.6
"""Of a symbol in a saved picture, and around the matrix [inches]."""
WIDEST = 16.0


def draw_matrix(automaton: Automaton, ax: Axes) -> None:
    """Draw a row for each symbol in force, a column for each that may follow.

    An edge that is possible has the look of its target, one that is not decided faintly; one that
    is proved impossible is a cross, a star is where the loop chatters. On the diagonal it stays.
    """
    count, place = len(automaton.vertices), {k: i for i, k in enumerate(automaton.vertices)}
    edges = {(place[edge.source], place[edge.target]): edge for edge in automaton.edges}
    ax.imshow(_image(edges, automaton), extent=(-1, count, count, -1), interpolation="nearest")
    size = min(8.0, 400.0 / (count + 12))
    marks = {
        "x": [at for at, edge in edges.items() if edge.possible is False],
        "*": [at for at, edge in edges.items() if edge.sliding and edge.possible is not False],
    }
    for marker, places in marks.items():
        y, x = np.array(places).reshape(-1, 2).T + 0.5
        style: dict[str, Any] = (
            {"color": GREY} if marker == "x" else {"color": "black", "mec": "white", "mew": 0.4}
        )
        ax.plot(x, y, marker, markersize=0.6 * size, **style)
    for k in range(count + 1):
        ax.plot([0, count], [k, k], color="#cccccc", linewidth=0.3)
        ax.plot([k, k], [0, count], color="#cccccc", linewidth=0.3)
    ends, none = [-1, count], [0, 0]
    for line in ((ends, none), (none, ends)):  # apart from the looks
        ax.plot(*line, color="white", linewidth=3)
    steps = np.arange(count + 1).repeat(2)
    for x, y in ((steps[:-1], steps[1:]), (steps[1:], steps[:-1])):  # around the diagonal
        ax.plot(x, y, color="#333333", linewidth=0.8)
    names = [literal(_cut(name)) for name in automaton.names]
    ax.set(
        xlim=(-1, count), ylim=(count, -1), aspect="equal",
        xlabel="next symbol", ylabel="symbol in force",
    )  # fmt: skip
    ax.set_xticks(np.arange(count) + 0.5, names, rotation=90, fontsize=size)
    ax.set_yticks(np.arange(count) + 0.5, names, fontsize=size)
    ax.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    ax.xaxis.set_label_position("top")
    ax.spines[:].set_visible(False)
    _draw_legend(automaton, marks, ax)


def matrix_size(count: int) -> tuple[float, float]:
    """Return the width and height of the picture of so many symbols [inches]."""
    side = min(WIDEST, SPACE + ROOM * count)
    return side, side + 0.5


def _image(edges: dict[tuple[int, int], Edge], automaton: Automaton) -> np.ndarray:
    """Return the colours of a matrix with the looks of symbols before its rows and columns."""
    count = len(automaton.vertices)
    known = [*symbol_looks(automaton.symbols), Look("#dddddd", 0)]
    looks = [*(known[k] for k in automaton.vertices), Look("#ffffff", 0)]
    labels, faint = np.full((count + 1, count + 1), count), np.zeros((count + 1, count + 1), bool)
    labels[0, 1:] = labels[1:, 0] = np.arange(count)
    for (i, j), edge in edges.items():
        if edge.possible is not False:
            labels[i + 1, j + 1], faint[i + 1, j + 1] = j, edge.possible is None
    cell = max(2, min(CELL, MOST_PIXELS // (count + 1)))
    labels, faint = (v.repeat(cell, axis=0).repeat(cell, axis=1) for v in (labels, faint))
    colors = textured(labels[::-1], looks)[::-1]
    found: np.ndarray = np.where(faint[..., None], 1 - UNDECIDED * (1 - colors), colors)
    return found


def _cut(name: str) -> str:
    return name if len(name) <= LETTERS else name[: LETTERS - 1] + "…"


def _draw_legend(automaton: Automaton, marks: dict[str, list[Any]], ax: Axes) -> None:
    """Say what is faint, crossed and starred, where there is any."""
    from matplotlib.lines import Line2D

    handles = []
    if automaton.switching is None:
        text = "without a model: what is possible is unknown"
        handles.append(Line2D([], [], ls="", label=text))
    elif any(edge.possible is None for edge in automaton.edges):
        handles.append(Line2D([], [], ls="", marker="s", color="#cccccc", label="faint: undecided"))
    if marks["x"]:
        handles.append(Line2D([], [], ls="", marker="x", color=GREY, label="impossible"))
    if marks["*"]:
        handles.append(Line2D([], [], ls="", marker="*", color="black", label="chatters somewhere"))
    if handles:
        ax.legend(
            handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3, frameon=False,
            fontsize=8.5,
        )  # fmt: skip
