"""What exogenous inputs do along closed loops: stay, step, follow a function, or are drawn."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError, warn
from capsyn.modelling.domain import Box
from capsyn.modelling.exogenous import beyond_text, exogenous_array
from capsyn.validation import called, describe, numbers


@dataclass(frozen=True)
class ExogenousSignal:
    """Exogenous inputs of trials, which a loop takes over at every sample and holds between them.

    The parts are as one: an input is constant along each trial, or one signal for all of them.
    """

    start: np.ndarray  # (B, k) at the first sample
    samples: np.ndarray | None  # (samples + 1, k), NaN where an input stays as it was; None: all


def exogenous_signal(
    value: Any, told: Box | None, shape: tuple[int, ...], period: float, samples: int
) -> ExogenousSignal:
    """Return the exogenous inputs of trials with initial states of a shape (...).

    `value` is what `capsyn.simulate` takes, `period` the time of a sample. What cannot be used is a
    `ProblemError`.
    """
    if told is None:
        if value is not None:
            raise ProblemError(
                "`exogenous` must be left out for a model that is told nothing; got "
                + describe(value)
            )
        return ExogenousSignal(np.empty((int(np.prod(shape)), 0)), None)
    if value is None:
        raise ProblemError(f"`exogenous` must be given: {', '.join(told.names)}; got None")
    if callable(value):
        rows = _sampled("exogenous", value, period, samples, told.n)
        return _of(np.tile(rows[0], (*shape, 1)), rows, told)
    if not isinstance(value, Mapping):
        return _of(_broadcast(exogenous_array(value, told), shape, told.n), None, told)
    check_names(value, told)
    signals = {}
    start = np.empty((*shape, told.n))
    for i, name in enumerate(told.names):
        one = value[name]
        signal = _signal(f"exogenous {name}", one, period, samples)
        if signal is None:
            constant = numbers(f"exogenous {name}", one)
            start[..., i] = _broadcast(constant[..., None], shape, 1)[..., 0]
        else:
            signals[i], start[..., i] = signal, signal[0]
    if not signals:
        return _of(start, None, told)
    rows = np.full((samples + 1, told.n), np.nan)
    for i, signal in signals.items():
        rows[:, i] = signal
    return _of(start, rows, told)


def check_names(value: Mapping[str, Any], told: Box) -> None:
    """Raise `ProblemError` unless a mapping has a value for each exogenous input, by name."""
    unknown = [name for name in value if name not in told.names]
    missing = [name for name in told.names if name not in value]
    if unknown or missing:
        which = f"'{unknown[0]}' is no exogenous input" if unknown else f"'{missing[0]}' is missing"
        raise ProblemError(f"`exogenous` must name {', '.join(told.names)}; {which}")


def steps_from_csv(path: str | os.PathLike[str]) -> dict[str, dict[float, float]]:
    """Return the steps ``{name: {time: value}}`` in a CSV file: columns time and inputs.

    A cell that is empty leaves the value as it was.

    Raises
    ------
    ProblemError
        A file that cannot be read, or is no such table.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(file)
            table = [(lines.line_num, row) for row in lines if any(cell.strip() for cell in row)]
    except (OSError, UnicodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else f"it is no CSV text ({error})"
        raise ProblemError(f"`exogenous` cannot be read from '{path}': {reason}") from None
    if not table:
        raise ProblemError(f"`exogenous` cannot be read from '{path}': it has no header")
    names = [name.strip() for name in table[0][1]]
    if names[0] != "time" or not 2 <= len(names) == len(set(names)) or len(table) < 2:
        raise ProblemError(
            f"`exogenous` in '{path}' must have a column 'time', then one for each input, and "
            f"rows; got the columns {names}"
        )
    steps: dict[str, dict[float, float]] = {name: {} for name in names[1:]}
    for line, row in table[1:]:
        try:
            if len(row) != len(names):
                raise ValueError
            time, *cells = [float(cell) if cell.strip() else None for cell in row]
            if time is None:
                raise ValueError
        except ValueError:
            raise ProblemError(
                f"`exogenous` in '{path}' must have {len(names)} numbers in row {line}; got {row}"
            ) from None
        for name, cell in zip(names[1:], cells):
            if cell is None:
                continue
            if time in steps[name]:
                raise ProblemError(
                    f"`exogenous` in '{path}' must have each time once; row {line} has {time:g} "
                    "again"
                )
            if time < max(steps[name], default=-np.inf):
                raise ProblemError(
                    f"`exogenous` in '{path}' must have times ascending; row {line} has {time:g}"
                )
            steps[name][time] = cell
    return steps


def pairs_of_steps(value: Any) -> list[Any] | None:
    """Return the pairs (time, value) of an input that steps; None of one that does not."""
    if isinstance(value, Mapping):
        return list(value.items())
    if not isinstance(value, Sequence) or isinstance(value, str) or not value:
        return None
    paired = all(isinstance(pair, tuple) and len(pair) == 2 for pair in value)
    return list(value) if paired else None


def _of(start: np.ndarray, rows: np.ndarray | None, told: Box) -> ExogenousSignal:
    """Return the signal of starts (..., k), which must be finite, and should be in the box."""
    start = start.reshape(-1, told.n)
    finite = np.isfinite(start).all(axis=0)
    if not finite.all():
        raise ProblemError(f"`exogenous` must be finite; '{told.names[np.argmin(finite)]}' is not")
    if beyond := _beyond(start if rows is None else np.vstack([start, rows]), told):
        warn(f"`exogenous` leaves its box, which counts as outside the domain: {beyond}")
    return ExogenousSignal(start, rows)


def _beyond(values: np.ndarray, told: Box) -> str:
    """Return which values (B, k) leave the box; NaN does not."""
    return beyond_text(told, np.nanmin(values, axis=0), np.nanmax(values, axis=0))


def _broadcast(values: np.ndarray, shape: tuple[int, ...], k: int) -> np.ndarray:
    try:
        return np.broadcast_to(values, (*shape, k))
    except ValueError:
        raise ProblemError(
            f"`exogenous` must fit initial states of shape {(*shape, 'n')}; got {values.shape}"
        ) from None


def _signal(name: str, value: Any, period: float, samples: int) -> np.ndarray | None:
    """Return what one input is at every sample (samples + 1,), of a function or steps."""
    if callable(value):
        return _sampled(name, value, period, samples, 1)[:, 0]
    pairs = pairs_of_steps(value)
    if pairs is None:
        return None
    table = numbers(name, pairs).reshape(-1, 2)
    times = table[:, 0]
    if not len(table) or not np.isfinite(table).all() or (np.diff(times) <= 0).any():
        raise ProblemError(
            f"`{name}` must be steps (time, value), finite, times ascending; got {describe(value)}"
        )
    now = np.arange(samples + 1) * period
    place = np.searchsorted(times, now * (1 + 1e-12) + 1e-12 * period, side="right") - 1
    return table[np.maximum(place, 0), 1]


def _sampled(
    name: str, function: Callable[[float], Any], period: float, samples: int, size: int
) -> np.ndarray:
    """Return what a function of time gives at every sample, (samples + 1, size), all finite."""
    rows = np.empty((samples + 1, size))
    for k in range(samples + 1):
        row = numbers(name, called(name, function, k * period)).reshape(-1)
        if row.shape != (size,) or not np.isfinite(row).all():
            raise ProblemError(
                f"`{name}` must return {size} finite number(s); got {describe(row)} at time "
                f"{k * period:g}"
            )
        rows[k] = row
    return rows
