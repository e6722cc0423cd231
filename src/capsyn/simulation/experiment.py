"""What simulations and Monte Carlo trials share: a closed loop, its arguments checked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.controllers.command import NOT_FINITE, TIME, Command, Decide, hold
from capsyn.controllers.online import OnlineController
from capsyn.errors import ProblemError
from capsyn.execution.cluster import check_client
from capsyn.execution.memory import check_memory
from capsyn.execution.processors import processors
from capsyn.modelling.alphabet import Outside, check_outside
from capsyn.modelling.targets import Target, check_target, target_program
from capsyn.modelling.transcription import target_condition
from capsyn.policies.policy import Policy
from capsyn.programs.program import Program
from capsyn.simulation.closed_loop import SLACK, Loop, Noise, Record, new_trials, run
from capsyn.simulation.plant import MOST_SUBSTEPS, Plant, choose_substeps
from capsyn.simulation.policy_loop import run_policy
from capsyn.simulation.trial_job import run_on_workers
from capsyn.validation import (
    BACKENDS,
    describe,
    finite_number,
    numbers,
    one_line,
    one_of,
    whole_number,
)

MOST_SAMPLES = 10**9
"""Most samples of a trial."""


@dataclass(frozen=True)
class Experiment:
    """A controller, a plant, and how they are brought together.

    Parameters
    ----------
    plant : Plant
        The plant.
    loop : Loop
        How the loop runs.
    inputs, units : tuples of str
        Names and units of the inputs.
    rate : float
        Samples per second [1 / s].
    target : Ball, Box, Program or None
        What arriving means.
    run : callable ``(trials, noise, record)``
        Runs trials in place.
    """

    plant: Plant
    loop: Loop
    inputs: tuple[str, ...]
    units: tuple[str, ...]
    rate: float
    target: Target | None
    run: Callable[[np.ndarray, Noise | None, Record | None], None]

    def trials(
        self,
        states: np.ndarray,
        delays: np.ndarray,
        parameters: np.ndarray,
        push: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return new trials; see `new_trials`."""
        push = np.zeros_like(states) if push is None else push
        queue = 16 * self.plant.m * (float(delays.max(initial=0)) * self.rate + 2)
        check_memory(len(states) * min(queue, 32 * self.loop.samples), "`delay` times `rate`")
        longest = self.loop.samples * self.loop.period  # whatever comes later never arrives
        delays = np.minimum(delays, longest)
        return new_trials(states, self.plant.m, delays, parameters, push, self.loop.period)


def set_up(
    controller: Any,
    plant: Plant,
    duration: float,
    rate: float | None,
    *,
    typical: Any = None,
    disturbance: Any = None,
    min_dwell: float | None = None,
    outside: Outside | None = None,
    target: Any = None,
    stop_at_target: bool = False,
    substeps: int | None = None,
    backend: str = "auto",
    threads: int | None = None,
    executor: Any = None,
) -> Experiment:
    """Return the experiment on a plant that the arguments of `simulate` describe.

    Parameters
    ----------
    typical : (P, K), optional
        Parameters for choosing the steps of the integration.
    executor : dask.distributed.Client, optional
        A cluster whose workers run the trials of a policy, without a record.
    """
    duration = finite_number("duration", duration, above=0.0)
    own = controller if isinstance(controller, (Policy, OnlineController)) else None
    if rate is None:
        settings = own.settings if own else None
        if settings is None:
            raise ProblemError("`rate` must be given for a controller without settings")
        rate = 1 / settings.sample_time
    rate = finite_number("rate", rate, above=0.0)
    samples = duration * rate
    if not 0.5 < samples <= MOST_SAMPLES:
        raise ProblemError(
            f"`duration` times `rate` must be 1 to {MOST_SAMPLES:g} samples; got {samples:g}"
        )
    one_of("backend", backend, BACKENDS)
    threads = processors(threads)
    if executor is not None:
        if not isinstance(controller, Policy):
            raise ProblemError(
                "`executor` needs a Policy as controller: functions and online controllers are "
                f"not sent; got {describe(controller)}"
            )
        check_client(executor)
    n, m = plant.n, plant.m
    if min_dwell is None:
        min_dwell = own.min_dwell if own else 0.0
    dwell = finite_number("min_dwell", min_dwell, least=0.0) * rate
    if target is None:
        target = own.target if own else plant.target
    elif callable(target) and not isinstance(target, Program):
        target = target_condition(target, n)
    check_target(target, plant.domain)
    if stop_at_target and target is None:
        raise ProblemError("`target` must be given to stop at it; the policy has none")
    idle = own.default if own else plant.default
    alphabet = own.alphabet if own else plant.alphabet
    period, samples = 1 / rate, round(samples)
    if isinstance(controller, Policy):
        outside = check_outside(
            controller.outside if outside is None else outside, controller.alphabet
        )
    elif outside is not None:
        raise ProblemError("`outside` must be given for policies only")
    pushes = _pushes(disturbance, n, period, samples)
    if substeps is not None:
        substeps = whole_number("substeps", substeps, least=1, most=MOST_SUBSTEPS)
    else:
        controls = np.vstack([alphabet.values, idle])
        values = np.zeros((0, 1)) if typical is None else typical
        substeps = choose_substeps(plant, controls, values, period)
    loop = Loop(
        period,
        samples,
        substeps,
        math.ceil(min(dwell - SLACK, samples)),
        target_program(target, plant.domain),
        stop_at_target,
        idle,
        pushes,
    )

    def start(trials: np.ndarray, noise: Noise | None, record: Record | None) -> None:
        if executor is not None:
            assert isinstance(controller, Policy) and outside is not None and record is None
            run_on_workers(executor, controller, outside, plant, loop, trials, noise, backend)
        elif isinstance(controller, Policy):
            assert outside is not None
            run_policy(controller, outside, plant, loop, trials, noise, record, backend, threads)
        else:
            online = isinstance(controller, OnlineController)
            decide = controller.decide if online else _function_decide(controller, m)
            run(decide, plant, loop, trials, noise, record)

    return Experiment(plant, loop, alphabet.inputs, alphabet.units, rate, target, start)


def per_state(name: str, value: Any, n: int, least: float | None = None) -> np.ndarray:
    """Return (n,) finite numbers from as many, or from one for all."""
    array = numbers(name, value)
    array = np.full(n, array) if array.ndim == 0 else array
    if array.shape != (n,) or not np.isfinite(array).all():
        many = f" or {n} of them, one per state" if n > 1 else ""
        raise ProblemError(f"`{name}` must be a finite number{many}; got {describe(value)}")
    if least is not None and (array < least).any():
        raise ProblemError(f"`{name}` must be >= {least:g}; got {describe(value)}")
    return array


def _pushes(disturbance: Any, n: int, period: float, samples: int) -> np.ndarray | None:
    if disturbance is None:
        return None
    if not callable(disturbance):
        return np.tile(per_state("disturbance", disturbance, n), (samples, 1))
    values = [
        per_state("disturbance", called("disturbance", disturbance, k * period), n)
        for k in range(samples)
    ]
    return np.array(values)


def called(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a user's function gives; what it raises becomes one line that names it."""
    try:
        return function(*arguments)
    except Exception as error:  # a user's function may raise anything
        reason = one_line(f"{type(error).__name__}: {error}")
        raise ProblemError(f"`{name}` failed: {reason}") from error


def _function_decide(function: Callable[..., Any], m: int) -> Decide:
    """Return the decision of a function ``(time, states (B, n)) -> controls (B, m)``."""

    def decide(time: float, measured: np.ndarray) -> Command:
        controls = numbers("controller", called("controller", function, time, measured))
        wanted = (len(measured), m)
        if controls.shape != wanted:
            raise ProblemError(
                f"`controller` must return controls of shape {wanted}; got shape {controls.shape}"
            )
        command = hold(controls)
        finite = np.isfinite(controls).all(axis=1)
        return dataclasses.replace(command, ended=np.where(finite, TIME, NOT_FINITE))

    return decide
