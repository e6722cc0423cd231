"""A policy as a small picture for notebooks."""

from __future__ import annotations

import html
from typing import Any

import numpy as np

from capsyn.modelling.domain import Box
from capsyn.notebook import ticks
from capsyn.policies.colors import TILE, Look, symbol_looks, tiles
from capsyn.policies.in_force import stays

WIDE, HIGH = 72, 48
"""Pixels of the map."""
SCALE = 4
LEFT, TOP, BELOW = 64, 6, 38
"""Room for the scales [pixels]."""
MOST_NAMED = 12
"""Symbols in the legend at most: those with the largest areas."""
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
    looks = [*symbol_looks(count), Look(GREY, 0)]
    areas = {k: int((symbols == k).sum()) for k in np.unique(symbols).tolist()}
    used = sorted(areas, key=lambda k: k % (count + 1))  # what is no symbol comes last
    layers = {k: (f'fill="{_fill(looks[k])}"', _runs(symbols == k), names[k]) for k in used}
    named = sorted(sorted(used, key=lambda k: -areas[k])[:MOST_NAMED], key=used.index)
    told = [layers[k] for k in named]
    paths = [f'<path {fill} d="{runs}"/>' for fill, runs, _ in layers.values()]
    band = stays(policy, states, backend="numpy").reshape(rows, WIDE)
    if band.any():
        told.append((SHADE, _runs(band), "shaded: the one in force stays"))
        paths.append(f'<path {SHADE} d="{told[-1][1]}"/>')
    if len(named) < len(used):
        told.append(('fill="none"', "", f"and {len(used) - len(named)} more"))
    width, height = LEFT + WIDE * SCALE, TOP + rows * SCALE
    axes = " against ".join(_axis(domain, i) for i in range(min(domain.n, 2))[::-1])
    entries = [
        f'<rect transform="translate({width + 14} {16 * row + 2 + TOP}) scale({SCALE})" '
        f'width="2.5" height="2.5" {fill}/>'
        f'<text x="{width + 30}" y="{16 * row + 11 + TOP}">{html.escape(name)}</text>'
        for row, (fill, _, name) in enumerate(told)
    ]
    caption = f"{html.escape(repr(policy))}: {axes}{_others(domain)}"
    marked = {looks[k] for k in used if looks[k].marks}
    return (
        f'<div><svg xmlns="http://www.w3.org/2000/svg" width="{width + 170}" '
        f'height="{max(height + BELOW, 16 * len(told) + TOP)}" font-family="sans-serif" '
        f'font-size="12" fill="currentColor"><title>{caption}</title>'
        f"<defs>{''.join(map(_pattern, sorted(marked, key=_fill)))}</defs>"
        f'<g transform="translate({LEFT} {TOP}) scale({SCALE})" shape-rendering="crispEdges">'
        f"{''.join(paths)}</g><g>{''.join(entries)}</g><g>{_scales(domain, rows)}</g></svg>"
        f"<div>{caption}</div></div>"
    )


def _fill(look: Look) -> str:
    """Return what a look is filled with: its colour, or the pattern with its name."""
    return f"url(#capsyn-{look.color[1:]}-{look.marks})" if look.marks else look.color


def _pattern(look: Look) -> str:
    """Return the pattern of a look with marks, a dot of which is a pixel of the screen."""
    size = 1 / SCALE
    return (
        f'<pattern id="{_fill(look)[5:-1]}" width="{TILE}" height="{TILE}" '
        f'patternUnits="userSpaceOnUse" patternTransform="scale({size:g})">'
        f'<rect width="{TILE}" height="{TILE}" fill="{look.color}"/>'
        f'<path fill="{look.ink}" d="{_runs(tiles()[look.marks])}"/></pattern>'
    )


def _scales(domain: Box, rows: int) -> str:
    """Return the ticks and names of the axes of a map."""
    width, height, parts = WIDE * SCALE, rows * SCALE, []

    def write(x: float, y: float, text: str, more: str) -> None:
        parts.append(f'<text x="{x:.5g}" y="{y:.5g}" {more}>{html.escape(text)}</text>')

    def name(axis: int) -> str:
        unit = domain.units[axis]
        return f"{domain.names[axis]} [{unit}]" if unit else domain.names[axis]

    def places(axis: int, count: int) -> list[tuple[float, str]]:
        low, span = float(domain.lower[axis]), float(domain.widths[axis])
        return [((v - low) / span, f"{v:g}") for v in ticks(low, low + span, count)]

    bottom, middle = TOP + height, 'text-anchor="middle"'
    for share, text in places(0, 5):
        write(LEFT + share * width, bottom + 14, text, middle)
        parts.append(f'<path d="M{LEFT + share * width:.5g} {bottom}v3" stroke="currentColor"/>')
    write(LEFT + width / 2, bottom + 30, name(0), middle)
    if domain.n > 1:
        for share, text in places(1, 4):
            y = bottom - share * height
            write(LEFT - 6, y + 4, text, 'text-anchor="end"')
            parts.append(f'<path d="M{LEFT} {y:.5g}h-3" stroke="currentColor"/>')
        x, y = 12, TOP + height / 2
        write(x, y, name(1), f'{middle} transform="rotate(-90 {x} {y:g})"')
    return "".join(parts)


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
