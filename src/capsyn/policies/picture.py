"""A policy as a small picture for notebooks."""

from __future__ import annotations

import html
from typing import Any

import numpy as np

from capsyn.modelling.domain import Box
from capsyn.policies.colors import symbol_colors
from capsyn.policies.in_force import stays

WIDE, HIGH = 72, 48
"""Pixels of the map."""
SCALE = 4
MOST_NAMED = 12
"""Symbols in the legend at most."""
GREY = "#999999"
SHADE = 'fill="#000000" fill-opacity="0.4"'


def map_html(policy: Any) -> str:
    """Return a map of symbols as HTML with an SVG: the plane of the first two states.

    The others, and exogenous inputs, have the middle of their bounds, as the caption says. Of a
    policy that remembers it is what follows the default control, and shaded where a symbol in force
    stays instead. The same policy gives the same text.
    """
    domain, count = policy.space, len(policy.alphabet)
    names = [*policy.alphabet.names, "outside" if policy.gaps else "default"]
    rows = HIGH if domain.n > 1 else 8
    states = _states(domain, rows)
    labels = policy.leaves(states, True, "numpy").reshape(rows, WIDE)
    symbols = np.where((labels < 0) | (labels == count), -1, labels)
    colors = [_hex(color) for color in symbol_colors(count)] + [GREY]
    used = [k for k in np.unique(symbols).tolist() if k >= 0] + [-1] * bool((symbols < 0).any())
    layers = [(f'fill="{colors[k]}"', _runs(symbols == k), names[k]) for k in used]
    band = stays(policy, states, backend="numpy").reshape(rows, WIDE)
    told = layers[:MOST_NAMED]
    if band.any():
        layers.append((SHADE, _runs(band), "shaded: the one in force stays"))
        told.append(layers[-1])
    paths = [f'<path {fill} d="{runs}"/>' for fill, runs, _ in layers]
    width, height = WIDE * SCALE, rows * SCALE
    axes = " against ".join(_axis(domain, i) for i in range(min(domain.n, 2))[::-1])
    entries = [
        f'<rect x="{width + 14}" y="{16 * row + 2}" width="10" height="10" {fill}/>'
        f'<text x="{width + 30}" y="{16 * row + 11}">{html.escape(name)}</text>'
        for row, (fill, _, name) in enumerate(told)
    ]
    caption = f"{html.escape(repr(policy))}: {axes}{_others(domain)}"
    return (
        f'<div><svg xmlns="http://www.w3.org/2000/svg" width="{width + 170}" '
        f'height="{max(height, 16 * len(told))}" font-family="sans-serif" font-size="12" '
        f'fill="currentColor"><title>{caption}</title>'
        f'<g transform="scale({SCALE})" shape-rendering="crispEdges">{"".join(paths)}</g>'
        f"{''.join(entries)}</svg><div>{caption}</div></div>"
    )


def _axis(domain: Box, axis: int) -> str:
    """Return the name of a state with its bounds and unit, escaped."""
    unit = f" {domain.units[axis]}" if domain.units[axis] else ""
    bounds = f"{domain.lower[axis]:.4g} to {domain.upper[axis]:.4g}{unit}"
    return html.escape(f"{domain.names[axis]} ({bounds})")


def _others(domain: Box) -> str:
    """Return the values of the states that are on no axis, escaped."""
    middles = zip(domain.names, domain.lower + domain.widths / 2, domain.units)
    values = [f"{name} = {value:.4g} {unit}".rstrip() for name, value, unit in middles][2:]
    return html.escape(f" at {', '.join(values)}") if values else ""


def _states(domain: Box, rows: int) -> np.ndarray:
    """Return the states (rows * WIDE, n) of the pixels' centres, the last row the lowest."""
    shares = np.full((rows, WIDE, domain.n), 0.5)
    shares[..., 0] = (np.arange(WIDE) + 0.5) / WIDE
    if domain.n > 1:
        shares[..., 1] = 1 - (np.arange(rows)[:, None] + 0.5) / rows
    states: np.ndarray = (domain.lower + shares * domain.widths).reshape(-1, domain.n)
    return states


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
