"""What simulations and Monte Carlo trials share: a closed loop, its arguments checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.controllers.command import NOT_FINITE, TIME, Command, Decide, hold
from capsyn.controllers.online import OnlineController
from capsyn.errors import ProblemError, warn
from capsyn.execution.cluster import check_client
from capsyn.execution.memory import check_memory
from capsyn.execution.processors import processors
from capsyn.modelling.alphabet import Outside, check_outside
from capsyn.modelling.discrete import check_period, whole_samples
from capsyn.modelling.exogenous import of_states
from capsyn.modelling.switching import SwitchRules
from capsyn.modelling.targets import Target, check_target, target_program
from capsyn.modelling.transcription import target_condition
from capsyn.policies.policy import Policy
from capsyn.programs.program import Program
from capsyn.simulation.closed_loop import SLACK, Holds, Loop, Noise, Record, new_trials, run
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import Plant, choose_substeps
from capsyn.simulation.policy_loop import run_policy
from capsyn.simulation.trial_job import run_on_workers
from capsyn.validation import called, describe, numbers

MOST_SAMPLES = 10**9
"""Most samples of a trial."""


@dataclass(frozen=True)
class Experiment:
    """A controller, a plant, and how they are brought together.

    The controller is a policy, an online controller or a function ``(time, states (B, n)) ->
    controls (B, m)``, with exogenous inputs (B, k) after the states if any; `outside` is the rule
    of a policy outside its domain, None for others.
    """

    controller: Any
    outside: Outside | None
    plant: Plant
    loop: Loop
    rate: float  # samples per time unit
    target: Target | None
    options: LoopOptions  # what it was made of

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
        if self.plant.sample_time is not None:
            for delay in np.unique(delays):
                whole_samples("delay", float(delay), self.plant.sample_time)
        longest = self.loop.samples * self.loop.period  # whatever comes later never arrives
        delays = np.minimum(delays, longest)
        return new_trials(states, self.plant.m, delays, parameters, push, self.loop.period)

    def run(self, trials: np.ndarray, noise: Noise | None, record: Record | None) -> None:
        """Run trials in place; on a cluster without a record."""
        controller, plant, loop, options = self.controller, self.plant, self.loop, self.options
        if not isinstance(controller, Policy):
            online = isinstance(controller, OnlineController)
            decide = controller.decide if online else _function_decide(controller, plant)
            run(decide, plant, loop, trials, noise, record)
            return
        assert self.outside is not None
        loops = (controller, self.outside, plant, loop, trials, noise)
        if options.executor is not None:
            assert record is None
            run_on_workers(options.executor, *loops, options.backend)
        else:
            run_policy(*loops, record, options.backend, processors(options.threads))


def set_up(
    controller: Any,
    plant: Plant,
    options: LoopOptions,
    typical: np.ndarray | None = None,
    told: np.ndarray | None = None,
) -> Experiment:
    """Return the experiment with a controller on a plant; `typical` (P, K) are parameters of it.

    `told` (samples + 1, k) are its exogenous inputs where they change, see `Loop`.

    Raises
    ------
    ProblemError
        Options that do not fit the controller or the plant.
    """
    rate, samples = sampling(controller, options, plant)
    plant.check_loop("rate", 1 / rate, options.substeps)
    if plant.sample_time is not None and isinstance(controller, OnlineController):
        raise ProblemError(
            "`controller` must give symbols or controls at samples where the model is a map; an "
            "online controller acts between them"
        )
    if options.executor is not None:
        if not isinstance(controller, Policy):
            raise ProblemError(
                "`executor` needs a Policy as controller: functions and online controllers are "
                f"not sent; got {describe(controller)}"
            )
        check_client(options.executor)
    own = described(controller)
    target = _target(own or plant, plant, options)
    outside = _rule(controller, options.outside)
    idle = plant.default if own is None else own.default_control
    alphabet, period = (own or plant).alphabet, 1 / rate
    pushes = _pushes(options.disturbance, plant, period, samples)
    substeps = options.substeps
    if substeps is None:
        controls = np.vstack([alphabet.values, idle])
        values = np.zeros((0, 1)) if typical is None else typical
        substeps = choose_substeps(plant, controls, values, period)
    loop = Loop(
        period,
        samples,
        substeps,
        _holds(controller, options.min_dwell, rate, samples),
        _at_once(controller, options.outside_at_once),
        target_program(target, plant.space),
        options.stop_at_target,
        idle,
        pushes,
        told,
    )
    return Experiment(controller, outside, plant, loop, rate, target, options)


def _holds(controller: Any, dwell: float | None, rate: float, samples: int) -> Holds:
    """Return what changes wait for; a given least time holds for all symbols, and no input."""
    own = described(controller)
    if own is None or own.rules is None:
        time = (own.min_dwell if own else 0.0) if dwell is None else dwell
        none = np.zeros((1, 1))
        rules = SwitchRules(none, none, np.array([time]), none[0], none[0].astype(int))
        return Holds.of(rules, 1 / rate)
    rules = own.rules
    if dwell is not None:
        holds, inputs = np.full_like(rules.holds, dwell), np.zeros_like(rules.input_holds)
        rules = dataclasses.replace(rules, holds=holds, input_holds=inputs)
    longest = max(rules.holds.max(), rules.input_holds.max(initial=0.0))
    if longest * rate > samples + SLACK:
        warn(
            f"the hold of {longest:g} {own.time_unit} is longer than the run of "
            f"{samples / rate:g} {own.time_unit}: what is entered stays"
        )
    return Holds.of(rules, 1 / rate)


def described(controller: Any) -> Policy | OnlineController | None:
    """Return a controller that has default, alphabet, target and dwell time; None for functions."""
    return controller if isinstance(controller, (Policy, OnlineController)) else None


def sampling(controller: Any, options: LoopOptions, plant: Plant) -> tuple[float, int]:
    """Return the samples per time unit, and how many there are. Those of a map are its own."""
    rate = options.rate
    if plant.sample_time is not None:
        if rate is not None:
            check_period(plant.sample_time, plant.time_unit, "rate", 1 / rate)
        rate = 1 / plant.sample_time
    if rate is None:
        own = described(controller)
        if own is None or own.settings is None:
            raise ProblemError("`rate` must be given for a controller without settings")
        rate = 1 / own.settings.period
    samples = sample_count(options.duration, rate)
    horizon = getattr(controller, "horizon", None)
    rates = not getattr(controller, "discrete", False)  # horizons of maps are samples
    if horizon is not None and rates and rate * horizon < 1 - SLACK:
        warn(
            f"a sample of {1 / rate:g} {controller.time_unit} is longer than the horizon of "
            f"{horizon:g} {controller.time_unit}: predictions end before the next decision"
        )
    kept = getattr(controller, "kept", None)
    if kept is not None:
        own_dwell = options.min_dwell in (None, controller.min_dwell)
        if abs(rate * kept.sample_time - 1) > SLACK or not own_dwell:
            warn(
                f"limits are kept by a loop that is sampled every {kept.sample_time:g} "
                f"{controller.time_unit}, with the policy's least times; this one has others"
            )
    return rate, samples


def sample_count(duration: float, rate: float) -> int:
    """Return how many samples there are in a time, at so many per time unit."""
    samples = duration * rate
    if not 0.5 < samples <= MOST_SAMPLES:
        raise ProblemError(
            f"`duration` times `rate` must be 1 to {MOST_SAMPLES:g} samples; got {samples:g}"
        )
    return round(samples)


def _target(
    source: Policy | OnlineController | Plant, plant: Plant, options: LoopOptions
) -> Target | None:
    """Return the target that holds; that of `source` where none is given."""
    target = options.target
    if target is None:
        target = source.target
    elif callable(target) and not isinstance(target, Program):
        target = target_condition(target, plant.states, plant.told)
    target = of_states(target, plant.domain, plant.exogenous)
    check_target(target, plant.space)
    if options.stop_at_target and target is None:
        raise ProblemError("`target` must be given to stop at it; the policy has none")
    return target


def _rule(controller: Any, outside: Outside | None) -> Outside | None:
    """Return the rule outside the domain that holds; None for what is no policy."""
    if isinstance(controller, Policy):
        rule = controller.outside if outside is None else outside
        rule = check_outside(rule, controller.alphabet)
        if controller.switching is not None:
            controller.switching.check(controller.alphabet, rule)
        return rule
    if outside is not None:
        raise ProblemError("`outside` must be given for policies only")
    return None


def _at_once(controller: Any, said: bool | None) -> bool:
    """Return whether the symbol of a state outside the domain does not wait."""
    if isinstance(controller, Policy):
        return controller.outside_at_once if said is None else said
    if said is not None:
        raise ProblemError("`outside_at_once` must be given for policies only")
    return False


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


def deviation(name: str, value: Any, plant: Plant) -> np.ndarray:
    """Return deviations (n + k,) of readings: for all of them, or the states alone, or one."""
    if plant.told and np.shape(value) == (plant.n,):
        return per_state(name, value, plant.n, least=0.0)
    return padded(plant, per_state(name, value, plant.states, least=0.0))


def padded(plant: Plant, values: np.ndarray) -> np.ndarray:
    """Return numbers (..., n) of the states of a plant with 0 for its exogenous inputs."""
    return np.concatenate([values, np.zeros((*values.shape[:-1], plant.told))], axis=-1)


def _pushes(disturbance: Any, plant: Plant, period: float, samples: int) -> np.ndarray | None:
    if disturbance is None:
        return None
    n = plant.states
    if not callable(disturbance):
        return np.tile(padded(plant, per_state("disturbance", disturbance, n)), (samples, 1))
    values = (called("disturbance", disturbance, k * period) for k in range(samples))
    return padded(plant, np.array([per_state("disturbance", value, n) for value in values]))


def _function_decide(function: Callable[..., Any], plant: Plant) -> Decide:
    """Return the decision of a function ``(time, states (B, n)) -> controls (B, m)``.

    It takes exogenous inputs (B, k) after the states where the plant has some.
    """
    n = plant.states

    def decide(time: float, measured: np.ndarray, _: np.ndarray) -> Command:
        told = (measured[:, n:],) if plant.told else ()
        given = called("controller", function, time, measured[:, :n], *told)
        controls = numbers("controller", given)
        wanted = (len(measured), plant.m)
        if controls.shape != wanted:
            raise ProblemError(
                f"`controller` must return controls of shape {wanted}; got shape {controls.shape}"
            )
        command = hold(controls)
        finite = np.isfinite(controls).all(axis=1)
        return dataclasses.replace(command, ended=np.where(finite, TIME, NOT_FINITE))

    return decide
