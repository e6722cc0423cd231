"""How pictures show many symbols: marks over their colours, and names in their regions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.plots.figure import literal
from capsyn.policies.colors import TILE, Look, tiles

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DOT = 2
"""Pixels of a dot of marks, across and up."""
COARSE = 4
"""Names are placed in steps of so many pixels."""
LONGEST = 6
"""Names with more letters than this are not written into regions: numbers stand for them."""
SIZE = 7.0
"""Of the letters in regions [points]."""


def written(names: Sequence[str]) -> list[str]:
    """Return what stands for the symbols of an alphabet: names if all are short, else u1, u2 .."""
    if max(map(len, names)) <= LONGEST:
        return [*names]
    return [f"u{k + 1}" for k in range(len(names))]


def texture(look: Look, rows: int, columns: int) -> np.ndarray:
    """Return a rectangle of a look as colours (rows, columns, 3)."""
    return textured(np.zeros((rows, columns), dtype=int), [look])


def textured(labels: np.ndarray, looks: Sequence[Look]) -> np.ndarray:
    """Return colours (rows, columns, 3) of labels, the lowest first, with marks of a pixel each."""
    from matplotlib.colors import to_rgb

    rows, columns = map(np.arange, labels.shape)
    marks, inks, colors = (
        np.array(v) for v in zip(*((k.marks, to_rgb(k.ink), to_rgb(k.color)) for k in looks))
    )
    dots = _dots(marks[labels], rows[::-1], columns, 1)
    found: np.ndarray = np.where(dots[..., None], inks[labels], colors[labels])
    return found


def _dots(marks: Any, rows: np.ndarray, columns: np.ndarray, dot: int) -> np.ndarray:
    """Return whether there is a dot of marks at pixels, of which there are rows and columns."""
    found: np.ndarray = tiles()[marks, rows[:, None] // dot % TILE, columns[None, :] // dot % TILE]
    return found


def draw_marks(ax: Axes, labels: np.ndarray, looks: Sequence[Look]) -> None:
    """Draw the marks of labels (rows, columns), the lowest first, over the colours of an Axes."""
    from matplotlib.colors import to_rgb

    rows, columns = labels.shape
    marks = np.array([look.marks for look in looks])[labels]
    inks = np.array([to_rgb(look.ink) for look in looks])[labels]
    dots = _dots(marks, np.arange(rows)[::-1], np.arange(columns), DOT)
    ax.imshow(
        np.concatenate([inks, dots[..., None]], axis=2),
        extent=(*ax.get_xlim(), *ax.get_ylim()),
        origin="lower",
        aspect="auto",
        interpolation="nearest",
        zorder=1.5,
    )


def draw_names(ax: Axes, labels: np.ndarray, looks: Sequence[Look], names: Sequence[str]) -> None:
    """Write names into the regions of labels (rows, columns) that have room for them."""
    box = ax.get_window_extent()
    points = np.array([box.height, box.width]) * 72 / ax.figure.dpi
    coarse = labels[COARSE // 2 :: COARSE, COARSE // 2 :: COARSE]
    left, right = ax.get_xlim()
    low, high = ax.get_ylim()
    for label in np.unique(coarse).tolist():
        look, name = looks[label], names[label]
        text = np.array([1.3 * SIZE, (0.65 * len(name) + 0.4) * SIZE])
        need = np.ceil(text / points * coarse.shape).astype(int)
        for row, column in _places(coarse == label, need):
            ax.text(
                left + (column + 0.5) / coarse.shape[1] * (right - left),
                low + (row + 0.5) / coarse.shape[0] * (high - low),
                literal(name),
                color=look.ink,
                fontsize=SIZE,
                ha="center",
                va="center",
                clip_on=True,
                zorder=3,
                bbox={"facecolor": look.color, "linewidth": 0, "pad": 0.8},
            )


def _places(mask: np.ndarray, need: np.ndarray) -> list[tuple[int, int]]:
    """Return where in each part of a mask a rectangle of pixels fits that stays in it, if any."""
    from scipy import ndimage

    sums = np.pad(mask.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    high, wide = need.tolist()
    rows, columns = mask.shape[0] - high + 1, mask.shape[1] - wide + 1
    if rows < 1 or columns < 1:
        return []
    inside = (
        sums[high:, wide:] - sums[:-high, wide:] - sums[high:, :-wide] + sums[:-high, :-wide]
    ) == high * wide
    if not inside.any():
        return []
    fits = np.zeros_like(mask)
    fits[high // 2 : high // 2 + rows, wide // 2 : wide // 2 + columns] = inside
    parts, _ = ndimage.label(mask)
    depth = np.where(fits, ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1], 0)
    found = ndimage.maximum_position(depth, parts, np.unique(parts[fits]))
    return [(int(row), int(column)) for row, column in found]


def patch(look: Look, text: str) -> Any:
    """Return the handle of a look in a legend; see `handlers`."""
    from matplotlib.patches import Patch

    handle = Patch(facecolor=look.color, edgecolor="#666666", label=literal(text))
    handle.look = look  # type: ignore[attr-defined]
    return handle


def handlers() -> dict[Any, Any]:
    """Return what draws the patches of looks in a legend, its ``handler_map``."""
    from matplotlib.image import BboxImage
    from matplotlib.legend_handler import HandlerPatch
    from matplotlib.patches import Patch
    from matplotlib.transforms import Bbox, TransformedBbox

    class Marked(HandlerPatch):
        def create_artists(self, legend: Any, handle: Any, *box: Any) -> Any:
            (shape,) = super().create_artists(legend, handle, *box)
            look = getattr(handle, "look", None)
            if look is None or not look.marks:
                return [shape]
            left, low, width, height, _, transform = box
            area = TransformedBbox(Bbox.from_bounds(-left, -low, width, height), transform)
            image = BboxImage(area, interpolation="nearest", zorder=1.5)
            scale = 2.0  # dots in a point
            image.set_data(texture(look, round(scale * height), round(scale * width)))
            shape.set(facecolor="none", zorder=2)
            return [image, shape]

    return {Patch: Marked()}
