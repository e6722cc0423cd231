"""Small tables, curves and scales as HTML, for notebooks; all texts are escaped."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

CELL = "padding:1px 10px 1px 0;text-align:left"
WIDE, HIGH, LEFT = 420, 44, 90
"""Width and height of a curve, and the room for its name [pixels]."""
POINTS = 300
"""Most points of a curve."""


def table(title: str, rows: Iterable[Sequence[Any]], head: Sequence[str] = ()) -> str:
    """Return a table with a title."""
    lines = [f"<tr>{''.join(_cell('th', text) for text in head)}</tr>"] if head else []
    lines += [f"<tr>{''.join(_cell('td', text) for text in row)}</tr>" for row in rows]
    return f"<div><div>{html.escape(title)}</div><table>{''.join(lines)}</table></div>"


def _cell(tag: str, text: Any) -> str:
    return f'<{tag} style="{CELL}">{html.escape(str(text))}</{tag}>'


def ticks(low: float, high: float, count: int) -> list[float]:
    """Return round values in [low, high], about so many of them."""
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(k * power for k in (1, 2, 5, 10) if k * power >= 0.999 * raw)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(f"{k * step:.12g}") for k in range(first, last + 1)]


def curves(
    title: str,
    times: np.ndarray,
    unit: str,
    panels: Sequence[tuple[str, Sequence[np.ndarray], str]],
    strip: Sequence[tuple[float, float, str, str]] = (),
) -> str:
    """Return curves over times (K,), a panel each: its name, values (K,) of lines, their colour.

    Below them is a strip: starts, ends, colours and names of what was in force.
    """
    end = float(times[-1]) or 1.0
    kept = np.unique(np.linspace(0, len(times) - 1, POINTS).astype(int))
    x = LEFT + WIDE * times[kept] / end
    parts = [
        _panel(row * (HIGH + 8) + 4, name, x, [line[kept] for line in lines], color)
        for row, (name, lines, color) in enumerate(panels)
    ]
    top = len(panels) * (HIGH + 8) + 4
    for start, stop, color, name in strip:
        left, width = LEFT + WIDE * start / end, WIDE * (stop - start) / end
        parts.append(
            f'<rect x="{left:.1f}" y="{top}" width="{width:.1f}" height="12" fill="{color}">'
            f"<title>{html.escape(name)}</title></rect>"
        )
    low = top + (16 if strip else 0)
    for value in ticks(0.0, end, 5):
        parts.append(_text(LEFT + WIDE * value / end, low + 12, f"{value:g}", "middle"))
    parts.append(_text(LEFT - 8, low + 12, unit, "end"))
    return svg(title, LEFT + WIDE + 70, low + 18, "".join(parts))


def svg(title: str, width: float, height: float, body: str) -> str:
    """Return a picture with its title below it; `body` is SVG, whose texts are escaped."""
    title = html.escape(title)
    return (
        f'<div><svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'font-family="sans-serif" font-size="11" fill="currentColor"><title>{title}</title>'
        f"{body}</svg><div>{title}</div></div>"
    )


def _panel(top: float, name: str, x: np.ndarray, lines: Sequence[np.ndarray], color: str) -> str:
    """Return a panel with lines (K,) at places (K,) across, NaN where there are none."""
    values = np.array(lines)
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    places = top + HIGH - 3 - (HIGH - 6) / ((high - low) or 1.0) * (values - low)
    right = LEFT + WIDE + 6
    parts = [
        _text(LEFT - 8, top + HIGH / 2, name, "end"),
        _text(right, top + 9, f"{high:.4g}"),
        _text(right, top + HIGH, f"{low:.4g}"),
        f'<rect x="{LEFT}" y="{top}" width="{WIDE}" height="{HIGH}" fill="none" '
        'stroke="#999999" stroke-width="0.5"/>',
    ]
    for y in places:
        d, before = "", False
        for across, up, here in zip(x.tolist(), y.tolist(), np.isfinite(y).tolist()):
            d += f"{'L' if before else 'M'}{across:.1f} {up:.1f}" if here else ""
            before = here
        parts.append(f'<path d="{d}" fill="none" stroke="{color}"/>')
    return "".join(parts)


def _text(x: float, y: float, text: str, anchor: str = "start") -> str:
    return f'<text x="{x:.4g}" y="{y:.4g}" text-anchor="{anchor}">{html.escape(text)}</text>'
