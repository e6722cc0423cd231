"""A policy as a small picture for notebooks."""

from __future__ import annotations

import html
from collections.abc import Callable

import numpy as np

from capsyn.modelling.domain import Box
from capsyn.policies.colors import symbol_colors

WIDE, HIGH = 72, 48
"""Pixels of the map."""
SCALE = 4
MOST_NAMED = 12
"""Symbols in the legend at most."""
GREY = "#999999"


def map_html(
    title: str, domain: Box, leaves: Callable[[np.ndarray], np.ndarray], symbol_names: list[str]
) -> str:
    """Return a map of symbols as HTML with an SVG: the plane of the first two states.

    The others have the middle of the domain. `leaves` gives the leaf numbers (B,) of states (B, n):
    symbols, N for the default, negative for none. The names are those of N symbols and of the
    default or none last; they are escaped. The same symbols give the same text.
    """
    rows = HIGH if domain.n > 1 else 8
    symbols = _symbols(domain, leaves, len(symbol_names) - 1, rows)
    colors = [_hex(color) for color in symbol_colors(len(symbol_names) - 1)] + [GREY]
    used = [k for k in np.unique(symbols).tolist() if k >= 0] + [-1] * bool((symbols < 0).any())
    paths = [f'<path fill="{colors[symbol]}" d="{_runs(symbols == symbol)}"/>' for symbol in used]
    width, height = WIDE * SCALE, rows * SCALE
    axes = " against ".join(_axis(domain, i) for i in range(min(domain.n, 2))[::-1])
    named = [(symbol, symbol_names[symbol]) for symbol in used[:MOST_NAMED]]
    entries = [
        f'<rect x="{width + 14}" y="{16 * row + 2}" width="10" height="10" '
        f'fill="{colors[symbol]}"/>'
        f'<text x="{width + 30}" y="{16 * row + 11}">{html.escape(name)}</text>'
        for row, (symbol, name) in enumerate(named)
    ]
    caption = f"{html.escape(title)}: {axes}"
    return (
        f'<div><svg xmlns="http://www.w3.org/2000/svg" width="{width + 170}" '
        f'height="{max(height, 16 * len(named))}" font-family="sans-serif" font-size="12" '
        f'fill="currentColor"><title>{caption}</title>'
        f'<g transform="scale({SCALE})" shape-rendering="crispEdges">{"".join(paths)}</g>'
        f"{''.join(entries)}</svg><div>{caption}</div></div>"
    )


def _axis(domain: Box, axis: int) -> str:
    """Return the name of a state with its bounds and unit, escaped."""
    unit = f" {domain.units[axis]}" if domain.units[axis] else ""
    bounds = f"{domain.lower[axis]:.4g} to {domain.upper[axis]:.4g}{unit}"
    return html.escape(f"{domain.names[axis]} ({bounds})")


def _symbols(
    domain: Box, leaves: Callable[[np.ndarray], np.ndarray], count: int, rows: int
) -> np.ndarray:
    """Return the symbols (rows, WIDE) of the pixels' centres, the last row the lowest states."""
    shares = np.full((rows, WIDE, domain.n), 0.5)
    shares[..., 0] = (np.arange(WIDE) + 0.5) / WIDE
    if domain.n > 1:
        shares[..., 1] = 1 - (np.arange(rows)[:, None] + 0.5) / rows
    states = (domain.lower + shares * domain.widths).reshape(-1, domain.n)
    labels = leaves(states).reshape(rows, WIDE)
    return np.where((labels < 0) | (labels == count), -1, labels)


def _runs(mask: np.ndarray) -> str:
    """Return a path around the runs of each row of a mask."""
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, starts = np.nonzero(edges > 0)
    ends = np.nonzero(edges < 0)[1]
    return "".join(
        f"M{start} {row}h{end - start}v1h{start - end}z"
        for row, start, end in zip(rows.tolist(), starts.tolist(), ends.tolist())
    )


def _hex(color: object) -> str:
    if isinstance(color, str):
        return color
    channels = np.round(255 * np.asarray(color, dtype=float)[:3]).astype(int)
    return "#" + "".join(f"{channel:02x}" for channel in channels.tolist())
