"""How closely a closed loop follows a reference: offset, overshoot, settling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.simulation.simulate import Trajectory
from capsyn.validation import describe, finite_number, one_of

BAND = 0.02
"""Share of the largest step within which a state has settled, unless told."""
MOVING = 0.5
"""Share of the samples at which a reference changes from which on it moves, and does not step."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """How closely a state follows its reference. The shapes (...) are those of the trajectories.

    The error is state minus reference, and for a periodic state the shorter way round. Each step of
    the reference begins a segment of the trajectory. The first segment begins with the trajectory
    and its initial state. Changes at successive samples are one move. A change at the last sample
    is left out, because nothing answers it. All figures are NaN if the error is not finite.

    Parameters
    ----------
    rms : (...)
        Root mean square of the error over all samples [state unit].
    bias : (...)
        Mean error over the second half of a segment, with its sign [state unit]. The segment is the
        one with the largest such mean.
    overshoot : (...)
        Largest excursion beyond the reference, on the side opposite to the beginning of a segment
        [state unit]; 0 if there is none.
    settling : (...)
        Longest time from the beginning of a segment until the error stays within the band [time
        unit]; NaN if the error does not settle in some segment.
    """

    rms: np.ndarray
    bias: np.ndarray
    overshoot: np.ndarray
    settling: np.ndarray

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data, with null for numbers that are not finite."""
        return {
            f.name: [float(v) if np.isfinite(v) else None for v in np.ravel(getattr(self, f.name))]
            for f in fields(self)
        }


def check_tracked(track: Any) -> None:
    """Raise `ProblemError` unless it names what each of some states should follow."""
    if not isinstance(track, Mapping) or not track:
        raise ProblemError(
            "`track` must be a mapping of states to exogenous inputs or numbers; got "
            + describe(track)
        )


def check_followed(track: Mapping[str, Any], states: Sequence[str], told: Sequence[str]) -> None:
    """Raise `ProblemError` where a name of `track` is none of the states or exogenous inputs."""
    for state, reference in track.items():
        one_of("state", state, states)
        if not isinstance(reference, str):
            finite_number("reference", reference)
        elif not told:
            raise ProblemError(
                f"`reference` must be a number, since nothing is told; got {describe(reference)}"
            )
        else:
            one_of("reference", reference, told)


def tracking(
    trajectory: Trajectory, state: str, reference: str | float, band: float | None = None
) -> Tracking:
    """Return how closely a state of trajectories follows an exogenous input or a constant.

    Parameters
    ----------
    trajectory : Trajectory
        One or many trajectories, as `capsyn.simulate` returns them.
    state : str
        Name of the state.
    reference : str or float
        Name of the exogenous input that the state should follow, or a constant [state unit].
    band : float, optional
        Largest error of a state that has settled [state unit]. Default: 2 % of the largest error at
        the beginning of a segment.

    Raises
    ------
    ProblemError
        Names that the trajectory does not have, or a band that is not positive.
    """
    if not isinstance(trajectory, Trajectory):
        raise ProblemError(f"`trajectory` must be a Trajectory; got {describe(trajectory)}")
    if band is not None:
        band = finite_number("band", band, above=0.0)
    n = trajectory.states.shape[-1]
    periods = trajectory.periods or (0.0,) * n
    own = (trajectory.names[:n], trajectory.exogenous_names, periods)
    pair = followed(trajectory.states, trajectory.exogenous, *own, state, reference)
    return figures(trajectory.times, *pair, trajectory.last, band)


def followed(
    states: np.ndarray,
    exogenous: np.ndarray,
    names: Sequence[str],
    told: Sequence[str],
    periods: Sequence[float],
    state: str,
    reference: str | float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the error of a state of states (..., n), and what it should follow.

    Both are named by `names` and `told`; `periods` (n,) are those of the states, 0 of others.
    """
    check_followed({state: reference}, names, told)
    i = names.index(state)
    values = states[..., i]
    wanted = np.full_like(values, reference if not isinstance(reference, str) else 0.0)
    if isinstance(reference, str):
        wanted = exogenous[..., told.index(reference)]
    error = values - wanted
    if periods[i]:
        with np.errstate(invalid="ignore"):
            error = error - periods[i] * np.round(error / periods[i])
    return error, wanted


def figures(
    times: np.ndarray, error: np.ndarray, wanted: np.ndarray, last: Any, band: float | None = None
) -> Tracking:
    """Return `tracking` of errors (..., K + 1) from what is wanted, up to samples `last`."""
    shape, size = error.shape[:-1], len(times)
    rows = [
        _figures(times, one[: end + 1], want[: end + 1], band)
        for one, want, end in zip(error.reshape(-1, size), wanted.reshape(-1, size), np.ravel(last))
    ]
    columns = np.array(rows).reshape(-1, len(fields(Tracking))).T
    return Tracking(*(column.reshape(shape)[()] for column in columns))


def joined_figures(parts: Sequence[Tracking]) -> Tracking:
    """Return the figures of all trials, of those of some after those of others."""
    rows = [[getattr(part, f.name) for f in fields(part)] for part in parts]
    return Tracking(*(np.concatenate(column) for column in zip(*rows)))


def _figures(
    times: np.ndarray, error: np.ndarray, wanted: np.ndarray, band: float | None
) -> tuple[float, float, float, float]:
    """Return rms, bias, overshoot and settling time of one trajectory."""
    if len(wanted) > 1 and wanted[-1] != wanted[-2]:
        error, wanted = error[:-1], wanted[:-1]
    if not np.isfinite(error).all():
        return (np.nan,) * 4
    changes = np.flatnonzero(np.diff(wanted)) + 1
    if len(changes) > MOVING * len(wanted):
        changes = changes[:0]
    begins = changes[np.diff(changes, prepend=-1) > 1]
    starts, stops = np.append(0, begins), np.append(begins, len(wanted))
    allowed = BAND * np.abs(error[starts]).max() if band is None else band
    bias, overshoot, settling = 0.0, 0.0, 0.0
    for start, stop in zip(starts, stops):
        part = error[start:stop]
        mean = float(part[len(part) // 2 :].mean())
        bias = mean if abs(mean) > abs(bias) else bias
        beyond = -np.sign(part[0]) * part
        overshoot = max(overshoot, float(beyond.max()))
        away = np.flatnonzero(np.abs(part) > allowed)
        settled = start if not len(away) else start + away[-1] + 1
        time = times[settled] - times[start] if settled < stop else np.nan
        settling = time if np.isnan(time) else max(settling, time)
    with np.errstate(over="ignore"):
        return float(np.sqrt((error**2).mean())), bias, overshoot, settling
