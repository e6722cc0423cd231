"""Pictures of closed-loop trajectories."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.plots.figure import quantity, saved_figure
from capsyn.policies.colors import PALETTE

if TYPE_CHECKING:
    from capsyn.simulation.simulate import Trajectory

SHORT = 16
"""Most characters of a label that fit beside a small picture in one line."""


def plot_trajectory(trajectory: Trajectory, axes: Any) -> Any:
    """Draw the states and the controls of trajectories against time, one Axes for each.

    Parameters
    ----------
    trajectory : Trajectory
        One trajectory, or many: these are drawn over each other.
    axes : n + m Axes
        Where to draw: the states first, then the controls.
    """
    states, controls = trajectory.states, trajectory.controls
    n, m = states.shape[-1], controls.shape[-1]
    if len(axes) != n + m:
        raise ProblemError(f"`axes` must be {n + m} Axes; got {len(axes)}")
    states = states.reshape(-1, len(trajectory.times), n)
    controls = controls.reshape(-1, len(trajectory.times) - 1, m)
    thin: dict[str, Any] = {
        "linewidth": 1.2 if len(states) == 1 else 0.5,
        "alpha": 1.0 if len(states) < 8 else 0.5,
    }
    for i, ax in enumerate(axes):
        for k, (states_of, controls_of) in enumerate(zip(states, controls)):
            thin["color"] = PALETTE[k % len(PALETTE)]
            if i < n:
                ax.plot(trajectory.times, states_of[:, i], **thin)
            else:
                held = np.append(controls_of[:, i - n], np.nan)
                ax.step(trajectory.times, held, where="post", **thin)
        label = quantity(trajectory.names[i], trajectory.units[i])
        ax.set_ylabel(label if len(label) <= SHORT else label.replace(" [", "\n["))
        ax.set_xlim(trajectory.times[0], trajectory.times[-1])
    axes[-1].set_xlabel(quantity("time", trajectory.time_unit))
    return axes


def save_trajectory_plot(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a picture of trajectories; see `plot_trajectory` and `save_figure`."""
    count = len(trajectory.names)
    with saved_figure(path, 7, 1 + 1.3 * count) as figure:
        plot_trajectory(trajectory, figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
        figure.align_ylabels()
