"""Closed-loop trajectories of any controller with any plant, at a sample rate."""

from __future__ import annotations

import csv
import dataclasses
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from capsyn.controllers.command import ENDINGS
from capsyn.errors import ProblemError
from capsyn.execution.files import atomic_write
from capsyn.execution.memory import check_memory
from capsyn.modelling.alphabet import Outside
from capsyn.simulation.closed_loop import Noise, Record, new_record
from capsyn.simulation.exogenous import exogenous_signal
from capsyn.simulation.experiment import Experiment, described, deviation, sampling, set_up
from capsyn.simulation.figures import Gathered
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import plant_of
from capsyn.simulation.shown import plain_value, trajectory_html
from capsyn.validation import describe, finite_number, numbers


@dataclass(frozen=True)
class Trajectory:
    """What happened in closed loops, at every sample. The shapes (...) are those of `x0`.

    Parameters
    ----------
    times : (K + 1,)
        Sample times [time unit].
    states : (..., K + 1, n)
        States [state units]; NaN after a trajectory has ended.
    exogenous : (..., K + 1, k)
        The k exogenous inputs [their units]; NaN after a trajectory has ended.
    symbols : (..., K)
        Symbol that held over each sample. -1 is the default control. -2 is no symbol: after the
        end, or for a control that is no symbol.
    controls : (..., K, m)
        Control that the controller gave at the start of each sample [input units].
    costs : (..., K + 1)
        Running cost gathered until each sample time [cost].
    terminal_cost : (...)
        Terminal cost of the last state; 0 if there is no terminal cost.
    switches : (...)
        Number of changes of the control.
    outside : (...)
        Number of samples whose measured state was outside the policy's domain.
    ended : (...) strings
        Why each trajectory ended: ``"time"``, ``"target"``, ``"left the domain"`` or ``"not
        finite"``.
    last : (...)
        The sample at which each trajectory ended.
    arrived : (...)
        When each trajectory first reached the target [time unit]; NaN if it did not.
    names, units : tuples of str
        Names and units of the states, then of the inputs.
    exogenous_names, exogenous_units : tuples of str
        Names and units of the exogenous inputs.
    periods : tuple of n floats
        Widths of the axes of periodic states [state units]; 0 for other states.
    lower : tuple of n floats
        Lower bounds of the domain [state units], from which periodic states go round.
    symbol_names : tuple of str
        Names of the symbols; none where the controls are no symbols.
    time_unit : str
        Unit of time of the plant, see `Problem`.
    figures : mapping of name to (...)
        Sums over each trajectory until its end: ``effort``, the integral of ``u^T u``; ``fuel``,
        the integral of the sum of ``|u|`` [input units, time unit]; and costs by name.
    entered : (...), optional
        When each trajectory first was where it must not be [time unit]; NaN if never. None without
        such sets.
    """

    times: np.ndarray
    states: np.ndarray
    symbols: np.ndarray
    controls: np.ndarray
    costs: np.ndarray
    terminal_cost: np.ndarray
    switches: np.ndarray
    outside: np.ndarray
    ended: np.ndarray
    last: np.ndarray
    arrived: np.ndarray
    names: tuple[str, ...]
    units: tuple[str, ...]
    time_unit: str = "s"
    exogenous: np.ndarray = field(default_factory=lambda: np.empty(0))
    exogenous_names: tuple[str, ...] = ()
    exogenous_units: tuple[str, ...] = ()
    periods: tuple[float, ...] = ()
    lower: tuple[float, ...] = ()
    symbol_names: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)
    entered: Any = None

    @property
    def cost(self) -> Any:
        """Cost (...) of eq. (3) of each trajectory, until it ended."""
        last = np.asarray(self.last)[..., None]
        return np.take_along_axis(self.costs, last, axis=-1)[..., 0] + self.terminal_cost

    def __repr__(self) -> str:
        many = f"{np.size(self.last)} of " if self.states.ndim > 2 else ""
        length = f"{self.times[-1]:g} {self.time_unit}"
        return (
            f"Trajectory({many}{len(self.times) - 1} samples, {length}, ended: "
            f"{', '.join(sorted(set(np.ravel(self.ended).tolist())))})"
        )

    _repr_html_ = trajectory_html

    def to_json(self) -> dict[str, Any]:
        """Return the trajectory as plain data, with null for NaN.

        The data have a time unit only if it is not s, and exogenous inputs only if there are some.
        """
        left_out = {"time_unit", *(() if self.exogenous_names else _EXOGENOUS)}
        left_out |= {"entered"} if self.entered is None else set()
        plain = {
            name: plain_value(value) for name, value in vars(self).items() if name not in left_out
        }
        return plain | self._unit

    def summary(self) -> list[dict[str, Any]]:
        """Return how each trajectory went, as plain data, with the time unit if it is not s."""
        size, n = self.states.shape[-2:]
        states, last = self.states.reshape(-1, size, n), np.ravel(self.last)
        ends = np.arange(len(last))
        columns = {
            "initial": states[:, 0],
            "final": states[ends, last],
            "duration": self.times[last],
            "ended": np.ravel(self.ended),
            "arrived": np.ravel(self.arrived),
            "switches": np.ravel(self.switches),
            "outside": np.ravel(self.outside),
            "cost": np.ravel(self.cost),
            **{name: np.ravel(values) for name, values in self.figures.items()},
            **({} if self.entered is None else {"entered": np.ravel(self.entered)}),
        }
        plain = {name: plain_value(values) for name, values in columns.items()}
        return [{name: values[k] for name, values in plain.items()} | self._unit for k in ends]

    @property
    def _unit(self) -> dict[str, str]:
        return {} if self.time_unit == "s" else {"time_unit": self.time_unit}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a .csv or .json file, by the ending of `path`, completely or not at all.

        Each row of CSV is a sample: trial (if there are many), time, states, exogenous inputs,
        cost, symbol and controls.

        Raises
        ------
        ProblemError
            `path` has another ending, or cannot be written.
        """
        kind = check_trajectory_format(path)

        def write(temporary: Path) -> None:
            with open(temporary, "w", newline="", encoding="utf-8") as file:
                if kind == ".json":
                    json.dump(self.to_json(), file, allow_nan=False)
                else:
                    csv.writer(file).writerows(self._rows())

        atomic_write(path, write)

    def _rows(self) -> Iterator[list[Any]]:
        n, m, size = self.states.shape[-1], self.controls.shape[-1], len(self.times)
        many = self.states.ndim > 2
        told = len(self.exogenous_names)
        header = ["time", *self.names[:n], *self.exogenous_names, "cost", "symbol", *self.names[n:]]
        yield [*["trial"] * many, *header]
        exogenous = self.exogenous.reshape(-1, size, told) if told else np.empty((1, size, 0))
        exogenous = np.broadcast_to(exogenous, (np.size(self.last), size, told))
        states, costs = self.states.reshape(-1, size, n), self.costs.reshape(-1, size)
        symbols = self.symbols.reshape(-1, size - 1)
        controls = self.controls.reshape(-1, size - 1, m)
        for trial, end in enumerate(np.ravel(self.last)):
            for k in range(end + 1):
                row = [self.times[k], *states[trial, k], *exogenous[trial, k], costs[trial, k]]
                acts = [symbols[trial, k], *controls[trial, k]] if k < end else [""] * (1 + m)
                yield [*[trial] * many, *row, *acts]


_EXOGENOUS = ("exogenous", "exogenous_names", "exogenous_units")


def check_trajectory_format(path: str | os.PathLike[str]) -> str:
    """Return the ending of a trajectory's file, ".csv" or ".json"."""
    kind = Path(path).suffix.lower()
    if kind not in (".csv", ".json"):
        raise ProblemError(f"a trajectory must end in .csv or .json; got '{path}'")
    return kind


def simulate(
    controller: Any,
    x0: Any,
    duration: float,
    rate: float | None = None,
    *,
    model: Any = None,
    parameters: Mapping[str, float] | None = None,
    disturbance: Any = None,
    noise: Any = None,
    delay: float | None = None,
    min_dwell: float | None = None,
    outside: Outside | None = None,
    outside_at_once: bool | None = None,
    target: Any = None,
    stop_at_target: bool = False,
    substeps: int | None = None,
    seed: int = 0,
    backend: str = "auto",
    threads: int | None = None,
    exogenous: Any = None,
    avoid: Any = None,
    stay_in: Any = None,
    costs: Mapping[str, Any] | None = None,
) -> Trajectory:
    """Return closed-loop trajectories from one initial state, or from many at once.

    Parameters
    ----------
    controller : Policy, OnlineController or callable ``(time, states (B, n)) -> controls (B, m)``
        The controller, which acts at every sample on the measured states [time unit, state units].
        If the plant has exogenous inputs, a function takes them (B, k) after the states.
    x0 : (..., n)
        Initial states [state units].
    duration : float
        Time to simulate, rounded to whole samples [time unit of the plant, as all times here].
    rate : float, optional
        Samples per time unit. The control is held between samples. Default: 1 over the
        ``sample_time`` of the controller's settings. A discrete-time model takes no other rate than
        that of its map.
    model : Problem, Policy or callable ``(x, u) -> xdot`` or ``(x, u, p) -> xdot``, optional
        A plant that differs from the controller's own model. With exogenous inputs, it is a
        function of ``(x, u, w)`` or ``(x, u, w, p)``. If the controller comes from a discrete-time
        problem, a function is a map, too.
    parameters : mapping of name to float, optional
        The components of `p`, in order. The plant has these parameters, and the controller is not
        told them.
    disturbance : (n,) or callable ``time -> (n,)``, optional
        A term added to the rates of the states [state units / time unit], or to the next state of a
        map [state units]. The value of a callable is held over each sample.
    noise : float or (n,) or (n + k,), optional
        Standard deviation of Gaussian noise on the measured states [state units]. With n + k
        numbers, also on the exogenous inputs that the controller is told.
    delay : float, optional
        Time from a sample until its control acts [time unit]. Default: the delay of the plant,
        which the policy compensates.
    min_dwell : float, optional
        One least time for all symbols [time unit]. Default: the least times of the policy.
    outside : "error", "nearest" or symbol, optional
        What a state outside the domain gets. Default: the policy's own rule.
    outside_at_once : bool, optional
        Whether the symbol of a state outside is taken at once, without waiting for `min_dwell`.
        Default: as the policy says.
    target : Ball, Box or callable ``x -> true or false``, optional
        The states that count as arrived. Default: the policy's own target.
    stop_at_target : bool
        Whether a trajectory ends when it reaches the target.
    substeps : int, optional
        Runge-Kutta steps per sample. Default: as many as a step-doubling check asks for. A map
        takes none.
    seed : int
        Seed of the noise. Each trajectory has a random stream of its own.
    backend : "auto", "c" or "numpy"
        How policies are simulated. Other controllers always take NumPy.
    threads : int, optional
        Number of threads. Default: one per processor. The result does not depend on it.
    exogenous : (..., k), callable ``time -> (k,)``, or mapping of name to value
        Exogenous inputs of a model that has them, held over each sample. A value by name is a
        number, numbers (...) shaped as `x0`, a function of time, or steps. Steps are ``{0: 20, 60:
        22}`` or pairs (time, value); each value holds from its time until the next.
    avoid, stay_in : Ball, Box or callable ``x -> true or false``, or ``(x, w)``, optional
        Sets that states must not enter, or must not leave. ``entered`` says when they first do.
    costs : mapping of name to callable ``x -> scalar``, or ``(x, w)``, optional
        Further running costs by name [cost / time unit], whose sums ``figures`` reports.

    Raises
    ------
    ProblemError
        An argument that cannot be used.
    """
    options = LoopOptions(
        duration=duration,
        rate=rate,
        model=model,
        parameters=parameters,
        disturbance=disturbance,
        noise=noise,
        delay=delay,
        min_dwell=min_dwell,
        outside=outside,
        outside_at_once=outside_at_once,
        target=target,
        stop_at_target=stop_at_target,
        substeps=substeps,
        seed=seed,
        backend=backend,
        threads=threads,
        exogenous=exogenous,
        avoid=avoid,
        stay_in=stay_in,
        costs=costs,
    )
    return trajectories(controller, x0, options)


def trajectories(controller: Any, x0: Any, options: LoopOptions) -> Trajectory:
    """Return what `simulate` does from initial states (..., n)."""
    if options.delay is not None:
        finite_number("delay", options.delay, least=0.0)
    x0 = numbers("x0", x0)
    values = np.array(
        [finite_number(f"parameters {name}", p) for name, p in options.parameters.items()]
    )
    plant = plant_of(controller, options.model, tuple(options.parameters))
    delay = plant.delay if options.delay is None else options.delay
    n, m = plant.states, plant.m
    if x0.ndim == 0 or x0.shape[-1] != n or not np.isfinite(x0).all():
        raise ProblemError(f"`x0` must be finite numbers of shape (..., {n}); got {describe(x0)}")
    rate, samples = sampling(controller, options, plant)
    told = exogenous_signal(options.exogenous, plant.exogenous, x0.shape[:-1], 1 / rate, samples)
    states = np.hstack([x0.reshape(-1, n), told.start])
    count = len(states)
    noise = None
    if options.noise is not None:
        deviations = np.tile(deviation("noise", options.noise, plant), (count, 1))
        noise = Noise(deviations, [(options.seed, k + 1) for k in range(count)])
    experiment = set_up(controller, plant, options, values[:, None], told.samples)
    trials = experiment.trials(states, np.full(count, delay), np.tile(values, (count, 1)))
    check_memory(8.0 * count * samples * (plant.n + m + 2), "`duration` times `rate`")
    record = new_record(count, samples, plant.n, m)
    gathered, before = Gathered.of(options, plant), trials.copy()
    experiment.run(trials, noise, record)
    more = (experiment, trials, before, noise)
    figures, entered = gathered.figures(*more), gathered.entered(*more)
    found = _trajectory(experiment, trials, record, x0.shape[:-1])
    shaped = {name: v.reshape(x0.shape[:-1])[()] for name, v in figures.items()}
    when = entered.reshape(x0.shape[:-1])[()] if gathered.forbidden is not None else None
    return dataclasses.replace(found, figures=shaped, entered=when)


def _trajectory(
    experiment: Experiment, trials: np.ndarray, record: Record, shape: tuple[int, ...]
) -> Trajectory:
    """Return what was recorded of trials, in the shape (...) of their initial states."""
    plant, n = experiment.plant, experiment.plant.states
    alphabet = (described(experiment.controller) or plant).alphabet

    def shaped(values: np.ndarray) -> Any:
        return values.reshape((*shape, *values.shape[1:]))[()]

    terminal = plant.terminal_cost.evaluate(trials["state"].T)[0][0]
    arrived = trials["arrived"]
    return Trajectory(
        times=np.arange(experiment.loop.samples + 1) / experiment.rate,
        states=shaped(record.states[..., :n]),
        symbols=shaped(record.symbols),
        controls=shaped(record.controls),
        costs=shaped(record.costs),
        terminal_cost=shaped(terminal),
        switches=shaped(trials["switches"].copy()),
        outside=shaped(trials["outside"].copy()),
        ended=shaped(np.array(ENDINGS)[trials["ended"]]),
        last=shaped(trials["end"].copy()),
        arrived=shaped(np.where(arrived < 0, np.nan, arrived / experiment.rate)),
        names=(*plant.domain.names, *alphabet.inputs),
        units=(*plant.domain.units, *alphabet.units),
        time_unit=plant.time_unit,
        exogenous=shaped(record.states[..., n:]),
        exogenous_names=plant.space.names[n:],
        exogenous_units=plant.space.units[n:],
        periods=tuple(plant.domain.periods.tolist()),
        lower=tuple(plant.domain.lower.tolist()),
        symbol_names=tuple(alphabet.names),
    )
