"""Pictures of policies; every function returns the Axes that it drew on."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from capsyn.errors import ProblemError
from capsyn.execution.files import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from capsyn.modelling.domain import Box

FORMATS = ("png", "pdf", "svg")


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
    """Return the width of a level's outlines [points], thinner for smaller cells."""
    return 0.3 * 0.7**level


def quantity(name: str, unit: str) -> str:
    """Return the label of an axis: its name and unit."""
    return literal(f"{name} [{unit}]" if unit else name)


def literal(text: str) -> str:
    """Return a text that matplotlib draws as it is, so that a dollar begins no formula."""
    return text.replace("$", r"\$")


def frame(ax: Axes, domain: Box, plane: tuple[int, int] = (0, 1)) -> None:
    """Give the axes names, units and bounds of two states of a domain."""
    for axis, i in zip("xy", plane):
        limits = (domain.lower[i], domain.upper[i])
        label = quantity(domain.names[i], domain.units[i])
        ax.set(**{f"{axis}lim": limits, f"{axis}label": label})


def reproducible() -> contextlib.AbstractContextManager[None]:
    """Return a context in which the same drawing makes the same bytes."""
    import matplotlib

    return matplotlib.rc_context({"svg.hashsalt": "capsyn"})


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure [inches] that no window shows."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


@contextlib.contextmanager
def saved_figure(path: str | os.PathLike[str], width: float, height: float) -> Iterator[Figure]:
    """Yield an empty figure [inches] to draw on, and write it; see `save_figure`."""
    check_format(path)
    with reproducible():
        figure = new_figure(width, height)
        yield figure
        save_figure(figure, path)


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG, PDF or SVG, by the ending of `path`.

    The same figure, made within `reproducible`, gives the same bytes. A file at `path` is replaced
    only by a complete picture.
    """
    kind = check_format(path)
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}

    def write(temporary: Path) -> None:
        figure.savefig(temporary, format=kind, dpi=200, metadata=metadata[kind])

    atomic_write(path, write)


def check_format(
    path: str | os.PathLike[str], kinds: Sequence[str] = FORMATS, what: str = "a picture"
) -> str:
    """Return the format that a path ends with, for a picture or another file."""
    kind = Path(path).suffix.lstrip(".").lower()
    if kind not in kinds:
        endings = ", ".join(f".{ending}" for ending in kinds)
        raise ProblemError(f"{what} must end in {endings}; got '{path}'")
    return kind
