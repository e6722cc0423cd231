"""Pictures of closed-loop trajectories."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.plots.figure import literal, quantity, saved_figure
from capsyn.policies.colors import PALETTE

if TYPE_CHECKING:
    from capsyn.simulation.simulate import Trajectory

SHORT = 16
"""Most characters of a label that fit beside a small picture in one line."""
TOLD = {"linestyle": "--", "color": "0.25", "linewidth": 1.0}
"""How an exogenous input is drawn that is the same for all trajectories."""


def plot_trajectory(
    trajectory: Trajectory, axes: Any, track: Mapping[str, str | float] | None = None
) -> Any:
    """Draw states, exogenous inputs and controls of trajectories against time, an Axes for each.

    Parameters
    ----------
    trajectory : Trajectory
        One trajectory, or many: these are drawn over each other.
    axes : n + k + m Axes
        Where to draw: the n states first, then k exogenous inputs, then the m controls.
    track : mapping of state to exogenous input or number, optional
        What states should follow, by name: it is drawn dashed in the panel of the state. An
        exogenous input that a state should follow has no Axes of its own.

    Raises
    ------
    ProblemError
        Names that the trajectory does not have, or another number of Axes.
    """
    track = {} if track is None else track
    own = _panels(trajectory, track)
    n, m = trajectory.states.shape[-1], trajectory.controls.shape[-1]
    size, total = len(trajectory.times), n + len(own) + m
    if len(axes) != total:
        raise ProblemError(f"`axes` must be {total} Axes; got {len(axes)}")
    states = trajectory.states.reshape(-1, size, n)
    told = trajectory.exogenous.reshape(len(states), size, -1)
    controls = trajectory.controls.reshape(len(states), size - 1, m)
    thin: dict[str, Any] = {
        "linewidth": 1.2 if len(states) == 1 else 0.5,
        "alpha": 1.0 if len(states) < 8 else 0.5,
    }
    for i, name in enumerate(trajectory.names[:n]):
        for k, values in enumerate(states[..., i]):
            axes[i].plot(trajectory.times, values, color=PALETTE[k % len(PALETTE)], **thin)
        if name in track:
            _draw_wanted(axes[i], trajectory, told, track[name], thin)
        _label(axes[i], name, trajectory.units[i])
    for ax, j in zip(axes[n:], own):
        _draw_told(ax, trajectory.times, told[..., j], thin)
        _label(ax, trajectory.exogenous_names[j], trajectory.exogenous_units[j])
    for i, ax in enumerate(axes[n + len(own) :]):
        for k, values in enumerate(controls[..., i]):
            held = np.append(values, np.nan)
            colour = PALETTE[k % len(PALETTE)]
            ax.step(trajectory.times, held, where="post", color=colour, **thin)
        _label(ax, trajectory.names[n + i], trajectory.units[n + i])
    for ax in axes:
        ax.set_xlim(trajectory.times[0], trajectory.times[-1])
    axes[-1].set_xlabel(quantity("time", trajectory.time_unit))
    return axes


def _panels(trajectory: Trajectory, track: Mapping[str, str | float]) -> list[int]:
    """Return the exogenous inputs with a panel of their own: those that no state should follow."""
    from capsyn.simulation.tracking import check_followed

    names = trajectory.exogenous_names
    check_followed(track, trajectory.names[: trajectory.states.shape[-1]], names)
    return [j for j, name in enumerate(names) if name not in track.values()]


def _draw_wanted(
    ax: Any, trajectory: Trajectory, told: np.ndarray, wanted: str | float, thin: dict[str, Any]
) -> None:
    """Draw what a state should follow: an exogenous input of told (B, K + 1, k), or a number."""
    if isinstance(wanted, str):
        j = trajectory.exogenous_names.index(wanted)
        line = _draw_told(ax, trajectory.times, told[..., j], thin)
        text = wanted
    else:
        line, text = ax.axhline(wanted, **TOLD), f"{wanted:g}"
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
    """Write a picture of trajectories; see `plot_trajectory` and `save_figure`."""
    count = len(trajectory.names) + len(_panels(trajectory, track or {}))
    with saved_figure(path, 7, 1 + 1.3 * count) as figure:
        axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
        plot_trajectory(trajectory, axes, track)
        figure.align_ylabels()
