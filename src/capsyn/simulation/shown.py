"""Trajectories as others see them: plain values, and small pictures for notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from capsyn.notebook import curves
from capsyn.policies.colors import PALETTE, symbol_colors

MOST = 8
"""Most trajectories that are drawn."""
MOST_RUNS = 400
"""A strip with more runs of symbols than these is of equal pieces, with the most frequent each."""


def plain_value(value: Any) -> Any:
    """Return arrays as lists, and mappings of them; what is not a finite number is None."""
    if isinstance(value, Mapping):
        return {name: plain_value(one) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            finite = np.isfinite(value)
            value = np.array(value, dtype=object)
            value[~finite] = None
        return value.tolist()
    return value


def trajectory_html(trajectory: Any) -> str:
    """Return the states of trajectories over time, and the symbols of one alone."""
    n, size = trajectory.states.shape[-1], len(trajectory.times)
    last = max(1, int(np.max(trajectory.last)))
    states = trajectory.states.reshape(-1, size, n)[:MOST, : last + 1]
    panels = [
        (f"{name} [{unit}]" if unit else name, list(states[..., i]), PALETTE[0])
        for i, (name, unit) in enumerate(zip(trajectory.names[:n], trajectory.units))
    ]
    title = repr(trajectory)
    if np.size(trajectory.last) > MOST:
        title += f", the first {MOST} are drawn"
    strip = _runs(trajectory, last) if trajectory.states.ndim == 2 else []
    times = trajectory.times[: last + 1]
    return curves(title, times, f"time [{trajectory.time_unit}]", panels, strip)


def _runs(trajectory: Any, last: int) -> list[tuple[float, float, str, str]]:
    """Return starts, ends, colours and names of the symbols of a trajectory."""
    symbols = trajectory.symbols[:last]
    edges = np.flatnonzero(np.concatenate([[True], symbols[1:] != symbols[:-1]]))
    if len(edges) > MOST_RUNS:
        edges = np.arange(MOST_RUNS) * last // MOST_RUNS
    ends = np.append(edges[1:], last)
    count = max(len(trajectory.symbol_names), int(symbols.max(initial=0)) + 1)
    colors, names = symbol_colors(count), trajectory.symbol_names or [*map(str, range(count))]
    found = []
    for start, end in zip(edges.tolist(), ends.tolist()):
        values, times = np.unique(symbols[start:end], return_counts=True)
        label = int(values[times.argmax()])
        if label > -2:
            name, color = ("default", "#ffffff") if label < 0 else (names[label], colors[label])
            found.append((*trajectory.times[[start, end]].tolist(), color, name))
    return found
