"""Pictures of closed-loop trajectories."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.plots.figure import literal, quantity, saved_figure
from capsyn.plots.pieces import (
    Drawn,
    input_of_all,
    input_pieces,
    piece_starts,
    stacked,
    symbol_shares,
)
from capsyn.plots.symbols import handlers, patch, textured
from capsyn.policies.colors import PALETTE, Look, symbol_looks

if TYPE_CHECKING:
    from capsyn.simulation.simulate import Trajectory

SHORT = 16
"""Most characters of a label that fit beside a small picture in one line."""
TOLD = {"linestyle": "--", "color": "0.25", "linewidth": 1.0}
"""How an exogenous input is drawn that is the same for all trajectories."""
PIECES = 120
"""Pieces of time, in each of which an input that chatters is drawn as its mean and range."""
COLUMNS = 480
"""Of the pixels of strips, two for each of their pieces of time."""
MOST_STRIPS = 8
"""More trajectories than these have one strip for the symbols of all, and one line for an input."""
MOST_LEVELS = 4
"""Up to so many values of an input are its ticks."""
STRIP = 18
"""Rows of pixels in a strip."""
ROOM = 34.0
"""Between a strip and the names of its symbols [points]: for the numbers and name of the axis."""
HEIGHTS = {"few": 1.3, "state": 1.0, "input": 0.55, "strip": 0.16, "names": 0.25}
"""Of panels: of few, of more than `MOST_TALL`, of a trajectory's strip, a row of names [inches]."""
MOST_TALL = 6
"""Up to so many panels are tall."""
MOST_NAMES = 8
"""Most names in a row below the strips."""


def plot_trajectory(
    trajectory: Trajectory, axes: Any, track: Mapping[str, str | float] | None = None
) -> Any:
    """Draw states, exogenous inputs and controls of trajectories against time, an Axes for each.

    The time axis ends with the longest trajectory. Periodic states are drawn within the domain: a
    line that crosses the seam ends there, and goes on at the other side. An input that chatters is
    drawn as its mean, in a band as wide as its range. More than `MOST_STRIPS` trajectories share
    one mean and range. If there is one more Axes, it has a strip with the symbols of each
    trajectory, or of all together: the shares of the symbols in every piece of time, one above the
    other.

    Parameters
    ----------
    trajectory : Trajectory
        One trajectory, or many, which are drawn over each other.
    axes : n + k + m Axes, or one more
        The Axes to draw on: first the n states, then k exogenous inputs, the m controls, and the
        symbols.
    track : mapping of state to exogenous input or number, optional
        What states should follow, by name. A dashed line shows it in the panel of the state. An
        exogenous input that a state should follow has no Axes of its own.

    Raises
    ------
    ProblemError
        The trajectory does not have a name, or the number of Axes is wrong.
    """
    track = {} if track is None else track
    own = _panels(trajectory, track)
    n, m = trajectory.states.shape[-1], trajectory.controls.shape[-1]
    size, total = len(trajectory.times), n + len(own) + m
    if len(axes) not in (total, total + 1):
        raise ProblemError(f"`axes` must be {total} Axes, or one more; got {len(axes)}")
    states = trajectory.states.reshape(-1, size, n)
    told = trajectory.exogenous.reshape(len(states), size, -1)
    thin: dict[str, Any] = {
        "linewidth": 1.2 if len(states) == 1 else 0.5,
        "alpha": 1.0 if len(states) < 8 else 0.5,
    }
    for i, name in enumerate(trajectory.names[:n]):
        for k, values in enumerate(states[..., i]):
            line = _wrapped(trajectory, i, values)
            axes[i].plot(*line, color=PALETTE[k % len(PALETTE)], **thin)
        if name in track:
            _draw_wanted(axes[i], trajectory, told, track[name], i, thin)
        _label(axes[i], name, trajectory.units[i])
    for ax, j in zip(axes[n:], own):
        _draw_told(ax, trajectory.times, told[..., j], thin)
        _label(ax, trajectory.exogenous_names[j], trajectory.exogenous_units[j])
    for i, ax in enumerate(axes[n + len(own) : total]):
        _draw_input(ax, trajectory, i, thin)
        _label(ax, trajectory.names[n + i], trajectory.units[n + i])
    for ax in axes[total:]:
        _draw_symbols(ax, trajectory)
    for ax in axes:
        ax.set_xlim(trajectory.times[0], trajectory.times[_longest(trajectory)])
    axes[-1].set_xlabel(quantity("time", trajectory.time_unit))
    return axes


def _longest(trajectory: Trajectory) -> int:
    """Return the last sample of the longest trajectory, at least 1."""
    return max(1, int(np.max(trajectory.last)))


def _wrapped(trajectory: Trajectory, i: int, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values of a state (K + 1,) to draw: of a periodic one within the domain.

    Where it goes over the seam there are three points more: at one bound, none, at the other.
    """
    times = trajectory.times
    period = trajectory.periods[i] if trajectory.periods else 0.0
    if not period:
        return times, values
    low = trajectory.lower[i] if trajectory.lower else -period / 2
    steps = np.diff(values)
    around = np.round(steps / period)  # of values that have been wrapped before
    around[~np.isfinite(around)] = 0
    smooth = values - period * np.append(0, np.cumsum(around))
    turns = np.floor((smooth - low) / period)
    inside = np.where(turns == 0, smooth, smooth - turns * period)
    over = np.flatnonzero(np.abs(np.diff(turns)) == 1)
    rises = turns[over + 1] > turns[over]
    seams = low + period * np.maximum(turns[over], turns[over + 1])
    share = (seams - smooth[over]) / (smooth[over + 1] - smooth[over])
    when = times[over] + share * (times[over + 1] - times[over])
    ends = np.where(rises, low + period, low), np.full(len(over), np.nan)
    more = np.stack([*ends, np.where(rises, low, low + period)], axis=1)
    at = np.repeat(over + 1, 3)
    return np.insert(times, at, np.repeat(when, 3)), np.insert(inside, at, more.ravel())


def _draw_input(ax: Any, trajectory: Trajectory, i: int, thin: dict[str, Any]) -> None:
    """Draw an input of all trajectories as steps, or as mean and range where it chatters."""
    times, longest = trajectory.times, _longest(trajectory)
    last = np.ravel(trajectory.last)
    values = trajectory.controls.reshape(len(last), len(times) - 1, -1)[..., i]
    values = np.where(np.arange(len(times) - 1) < last[:, None], values, np.nan)[:, :longest]
    if len(last) > MOST_STRIPS:
        shown, text = [(input_of_all(values, PIECES), longest)], "mean and range of all"
    else:
        pieces = [max(1, PIECES * end // longest) for end in last.tolist()]
        shown = [
            (input_pieces(row[:end], most), end)
            for row, end, most in zip(values, last.tolist(), pieces)
            if end
        ]
        text = "chatters: mean and range"
    for k, (drawn, end) in enumerate(shown):
        color = PALETTE[k % len(PALETTE)] if len(shown) == len(last) else TOLD["color"]
        _draw_bands(ax, times, drawn, color)
        line = np.append(drawn.values, drawn.values[-1])
        ax.step(times[: end + 1], line, where="post", color=color, **thin | {"alpha": 1.0})
    if any(len(drawn.starts) for drawn, _ in shown):
        ax.text(
            0.995, 1.01, text, transform=ax.transAxes, ha="right", va="bottom", color="0.35",
            fontsize="x-small",
        )  # fmt: skip
    levels = np.unique(values[np.isfinite(values)])
    if len(levels) <= MOST_LEVELS:
        ax.set_yticks(levels)
    ax.margins(y=0.12)


def _draw_bands(ax: Any, times: np.ndarray, drawn: Drawn, color: Any) -> None:
    """Draw the range of an input where it chatters."""
    from matplotlib.collections import PolyCollection

    left, right = times[drawn.starts], times[drawn.ends]
    x = np.stack([left, right, right, left], axis=1)
    y = np.stack([drawn.low, drawn.low, drawn.high, drawn.high], axis=1)
    bands = list(np.stack([x, y], axis=2))
    ax.add_collection(PolyCollection(bands, facecolors=color, alpha=0.2, linewidths=0))


def _strips(trajectory: Trajectory) -> list[np.ndarray]:
    """Return the strips of labels (`STRIP`, P) in pieces of time to the end of the longest."""
    longest, symbols = (
        _longest(trajectory),
        trajectory.symbols.reshape(-1, len(trajectory.times) - 1),
    )
    symbols = symbols[:, :longest]
    starts = piece_starts(longest, 2 * PIECES)
    shares = [symbol_shares(row, starts) for row in symbols]
    if len(shares) > MOST_STRIPS:
        labels = np.unique(symbols).tolist()
        none = np.zeros(len(starts))
        shares = [{k: np.mean([one.get(k, none) for one in shares], axis=0) for k in labels}]
    return [stacked(one, STRIP) for one in shares]


def _draw_symbols(ax: Any, trajectory: Trajectory) -> None:
    """Draw the strips of trajectories from the top, and name their symbols below."""
    from matplotlib.transforms import ScaledTranslation

    strips = _strips(trajectory)
    seen = sorted({*np.unique(strips).tolist()} - {-2})
    count = max([len(trajectory.symbol_names), *(label + 1 for label in seen)])
    looks = [*symbol_looks(count), Look("#FFFFFF", 0), Look("#FFFFFF", 0)]  # none, the default
    names = [*(trajectory.symbol_names or map(str, range(count))), "", "default"]
    times = trajectory.times
    for row, labels in enumerate(reversed(strips)):
        columns = np.arange(COLUMNS) * labels.shape[1] // COLUMNS
        ax.imshow(
            textured(labels[:, columns], looks),
            extent=(times[0], times[_longest(trajectory)], row + 0.06, row + 0.94),
            origin="lower",
            aspect="auto",
            interpolation="nearest",
        )
    ax.set(ylim=(0, len(strips)), yticks=[], ylabel="symbol" if len(strips) < 3 else "symbols")
    ax.yaxis.label.set(rotation=0, ha="right", va="center")
    if seen:
        ax.legend(
            handles=[patch(looks[k], names[k]) for k in seen],
            handler_map=handlers(),
            loc="upper center",
            bbox_to_anchor=(0.5, 0.0),
            bbox_transform=ax.transAxes
            + ScaledTranslation(0, -ROOM / 72, ax.figure.dpi_scale_trans),
            ncols=min(len(seen), MOST_NAMES),
            frameon=False,
            fontsize="small",
        )


def _panels(trajectory: Trajectory, track: Mapping[str, str | float]) -> list[int]:
    """Return the exogenous inputs with a panel of their own: those that no state should follow."""
    from capsyn.simulation.tracking import check_followed

    names = trajectory.exogenous_names
    check_followed(track, trajectory.names[: trajectory.states.shape[-1]], names)
    return [j for j, name in enumerate(names) if name not in track.values()]


def _draw_wanted(
    ax: Any,
    trajectory: Trajectory,
    told: np.ndarray,
    wanted: str | float,
    i: int,
    thin: dict[str, Any],
) -> None:
    """Draw what state i should follow: an exogenous input of told (B, K + 1, k), or a number."""
    period = trajectory.periods[i] if trajectory.periods else 0.0
    low = trajectory.lower[i] if trajectory.lower else -period / 2

    def inside(values: Any) -> Any:
        return values - period * np.floor((values - low) / period) if period else values

    if isinstance(wanted, str):
        j = trajectory.exogenous_names.index(wanted)
        line = _draw_told(ax, trajectory.times, inside(told[..., j]), thin)
        text = wanted
    else:
        line, text = ax.axhline(inside(wanted), **TOLD), f"{wanted:g}"
    ax.legend([line], [literal(text)], loc="best", fontsize="small", frameon=False)


def _draw_told(ax: Any, times: np.ndarray, values: np.ndarray, thin: dict[str, Any]) -> Any:
    """Draw an exogenous input (B, K + 1), once where it is the same for all; return a line."""
    same = np.array_equal(values, np.broadcast_to(values[:1], values.shape), equal_nan=True)
    if same:
        return ax.step(times, values[0], where="post", **TOLD)[0]
    for k, own in enumerate(values):
        colour = PALETTE[k % len(PALETTE)]
        (line,) = ax.step(times, own, "--", where="post", color=colour, **thin)
    return line


def _label(ax: Any, name: str, unit: str) -> None:
    label = quantity(name, unit)
    ax.set_ylabel(label if len(label) <= SHORT else label.replace(" [", "\n["))


def save_trajectory_plot(
    trajectory: Trajectory,
    path: str | os.PathLike[str],
    track: Mapping[str, str | float] | None = None,
) -> None:
    """Write a picture of trajectories; see `plot_trajectory` and `save_figure`.

    The last panel is the strip of symbols, if controls are symbols.
    """
    curves = trajectory.states.shape[-1] + len(_panels(trajectory, track or {}))
    inputs = trajectory.controls.shape[-1]
    tall = curves + inputs <= MOST_TALL
    heights = [HEIGHTS["few" if tall else "state"]] * curves
    heights += [HEIGHTS["few" if tall else "input"]] * inputs
    names = 0
    if (trajectory.symbols > -2).any():
        strips = np.size(trajectory.last)
        heights.append(HEIGHTS["strip"] * (strips if strips <= MOST_STRIPS else 2))
        heights[-1] += HEIGHTS["strip"]
        names = -(-len(np.unique(trajectory.symbols)) // MOST_NAMES)
    with saved_figure(path, 7, 1 + sum(heights) + HEIGHTS["names"] * names) as figure:
        axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
        plot_trajectory(trajectory, axes[:, 0], track)
        figure.align_ylabels()
