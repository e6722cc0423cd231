"""Monte Carlo: how often a controller reaches the target from random initial states."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from capsyn.controllers.command import ENDINGS, TIME
from capsyn.controllers.online import OnlineController
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Outside
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.switching import DEFAULT
from capsyn.modelling.targets import describe_target, with_tolerance
from capsyn.modelling.time_unit import NAMES
from capsyn.policies.policy import Policy
from capsyn.simulation.closed_loop import Noise, new_record
from capsyn.simulation.exogenous import pairs_of_steps
from capsyn.simulation.experiment import Experiment, described, padded, sampling, set_up
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import plant_of
from capsyn.simulation.tracking import (
    Tracking,
    check_followed,
    figures,
    followed,
    joined_figures,
)
from capsyn.statistics import TOLD, clopper_pearson
from capsyn.validation import one_line
from capsyn.verification.trials import (
    Drawn,
    TrialOptions,
    Uniform,
    draw,
    drawn_exogenous,
    drawn_parameters,
)

ROUNDING, SLACK = 1e-12, 1e-6
"""What rounding may add to a time of arrival, relative, and to a time to stay [samples]."""
RECORDED = 1 << 26
"""Bytes of the trials that are recorded at a time, for what is told of tracking."""


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """What happened in T trials.

    Parameters
    ----------
    seed : int
        Seed of everything that was drawn.
    conditions : dict
        What the trials had in common, as plain data.
    confidence, low, high : float
        Clopper-Pearson interval of the success rate.
    success : (T,) booleans
        Whether each trial succeeded.
    initial, final : (T, n)
        Its first and last states [state units].
    ended : (T,)
        Why it ended, as numbers into `capsyn.controllers.command.ENDINGS`.
    times : (T,)
        How long it ran [time unit].
    arrived : (T,)
        When it first was in the target [time unit]; NaN where never.
    switches, outside : (T,)
        Changes of the control, and samples measured outside the domain.
    initial_cost, final_cost : (T,)
        Cost of the default prediction from its first and last states, eq. (3); NaN without a
        model of the cost.
    parameters : mapping of name to (T,)
        What was drawn of the plant's parameters.
    delays : (T,)
        What was drawn of the input delay [time unit].
    disturbances, noises : (T, n)
        What was drawn of the constant disturbance [state units / time unit], and of the standard
        deviation of the measurement noise [state units].
    exogenous : (T, k)
        Exogenous inputs at the start of each trial [their units].
    tracking : mapping of name to Tracking
        How closely each state of `track` followed its reference, (T,) figures each.
    """

    seed: int
    conditions: dict[str, Any]
    confidence: float
    low: float
    high: float
    success: np.ndarray
    initial: np.ndarray
    final: np.ndarray
    ended: np.ndarray
    times: np.ndarray
    arrived: np.ndarray
    switches: np.ndarray
    outside: np.ndarray
    initial_cost: np.ndarray
    final_cost: np.ndarray
    parameters: Mapping[str, np.ndarray]
    delays: np.ndarray
    disturbances: np.ndarray
    noises: np.ndarray
    exogenous: np.ndarray
    tracking: Mapping[str, Tracking] = field(default_factory=dict)

    @property
    def success_rate(self) -> float:
        """Share of the trials that succeeded."""
        return float(self.success.mean())

    @property
    def failures(self) -> np.ndarray:
        """Initial states (F, n) of the trials that failed."""
        return self.initial[~self.success]

    def trial(self, index: int) -> dict[str, Any]:
        """Return what was drawn for trial `index` as plain data; of the noise, its deviation."""
        return {
            "trial": index,
            "initial": self.initial[index].tolist(),
            "parameters": {name: float(drawn[index]) for name, drawn in self.parameters.items()},
            "delay": float(self.delays[index]),
            "disturbance": self.disturbances[index].tolist(),
            "noise": self.noises[index].tolist(),
            **self._told(index),
        }

    def _told(self, index: int) -> dict[str, Any]:
        """Return the exogenous inputs of a trial as plain data, by name; steps as they were."""
        conditions = self.conditions.get("exogenous")
        if not isinstance(conditions, dict):
            return {} if conditions is None else {"exogenous": self.exogenous[index].tolist()}
        steps = {k: v for k, v in conditions.items() if isinstance(v, dict) and "low" not in v}
        start = zip(conditions, self.exogenous[index].tolist())
        return {"exogenous": {name: steps.get(name, value) for name, value in start}}

    def __repr__(self) -> str:
        return (
            f"MonteCarlo({int(self.success.sum())} of {len(self.success)} trials succeed, "
            f"{self.low:.3%} to {self.high:.3%} with {self.confidence:.0%} confidence)"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data, with the first `TOLD` failing trials.

        Times and rates are in the time unit of the plant, which ``conditions`` name unless it is s.
        """
        unit = NAMES[self.conditions.get("time_unit", "s")]
        moved = self.times > 0
        known = np.isfinite(self.initial_cost) & np.isfinite(self.final_cost)
        fallen = self.final_cost[known] < self.initial_cost[known]
        with np.errstate(divide="ignore", invalid="ignore"):
            left = self.final_cost[known] / self.initial_cost[known]
        return {
            "trials": len(self.success),
            "successes": int(self.success.sum()),
            "success_rate": self.success_rate,
            "confidence": self.confidence,
            "low": self.low,
            "high": self.high,
            "seed": self.seed,
            "conditions": self.conditions,
            "ended": {
                name: int((self.ended == k).sum())
                for k, name in enumerate(ENDINGS)
                if (self.ended == k).any()
            },
            "time_to_target": _spread(self.arrived[self.success]),
            f"switches_per_{unit}": _spread(self.switches[moved] / self.times[moved]),
            "trials_outside_domain": int((self.outside > 0).sum()),
            "cost_decreased": float(fallen.mean()) if known.any() else None,
            "cost_left": _spread(left),
            "failing_initial_states": self.failures[:TOLD].tolist(),
            "failing_trials": [self.trial(int(k)) for k in np.flatnonzero(~self.success)[:TOLD]],
            **({"tracking": _tracked(self.tracking)} if self.tracking else {}),
        }


def _tracked(tracking: Mapping[str, Tracking]) -> dict[str, Any]:
    """Return the figures of each tracked state over the trials, biases by their size."""
    return {
        name: {
            "rms": _spread(figures.rms),
            "bias": _spread(np.abs(figures.bias)),
            "overshoot": _spread(figures.overshoot),
            "settling": _spread(figures.settling),
            "unsettled": int(np.isnan(figures.settling).sum()),
        }
        for name, figures in tracking.items()
    }


def _spread(values: np.ndarray) -> dict[str, float] | None:
    """Return least, median, mean, 95th percentile and greatest of the finite values."""
    values = values[np.isfinite(values)]
    if not values.size:
        return None
    return {
        "min": float(values.min()),
        "median": float(np.median(values)),
        "mean": float(values.mean()),
        "95%": float(np.percentile(values, 95)),
        "max": float(values.max()),
    }


def monte_carlo(
    controller: Any,
    trials: int = 1000,
    *,
    duration: float = 20.0,
    rate: float | None = None,
    initial: Ball | Box | None = None,
    target: Any = None,
    tolerance: float | None = None,
    within: float | None = None,
    hold: float = 0.0,
    model: Any = None,
    parameters: Mapping[str, Any] | None = None,
    disturbance: Any = None,
    noise: Any = None,
    delay: Any = None,
    min_dwell: float | None = None,
    outside: Outside | None = None,
    outside_at_once: bool | None = None,
    substeps: int | None = None,
    seed: int = 0,
    confidence: float = 0.95,
    backend: str = "auto",
    threads: int | None = None,
    executor: Any = None,
    exogenous: Any = None,
    track: Mapping[str, str | float] | None = None,
) -> MonteCarlo:
    """Return how often a controller reaches the target from random initial states.

    A trial succeeds when it is in the target at some sample, where it ends; with `hold`, when it
    gets there within the time `within`, and is there at every sample of the last time `hold`.

    Parameters
    ----------
    controller, model, min_dwell, outside, outside_at_once, substeps, backend, threads
        As in `capsyn.simulate`.
    trials : int
        Number of trials T.
    duration, rate : float
        Time limit [time unit of the plant, as all times here], and samples per time unit.
    initial : Ball or Box, optional
        Where initial states are drawn from; of states that it does not name, from the domain.
        Default: the domain.
    target : Ball, Box or callable ``x -> true or false``, optional
        The target. Default: the policy's own.
    tolerance : float, optional
        Another radius for a target that is a ball [state units].
    within, hold : float, optional
        Time in which to arrive, and time at the end to stay [time unit].
    parameters : mapping of name to float or Uniform, optional
        The components of `p` of the model, in order.
    disturbance : float, (n,) or Uniform, or callable ``time -> (n,)``, optional
        Added to the rates of the states [state units / time unit].
    noise : float, (n,) or Uniform, optional
        Standard deviation of Gaussian noise on the measured states [state units].
    delay : float or Uniform, optional
        Time from a sample until its control acts [time unit]. Default: that of the plant, which the
        policy compensates.
    seed : int
        Of everything that is drawn. The first trials do not depend on how many there are.
    confidence : float
        Of the interval of the success rate.
    executor : dask.distributed.Client, optional
        A cluster whose workers run the trials of a policy, with the same results.
    exogenous : as in `capsyn.simulate`, a value by name also a Uniform, optional
        Exogenous inputs of a model that has them. What is not given by name is drawn anew from its
        box for each trial, and constant along it.
    track : mapping of state to name of an exogenous input, or number, optional
        What states should follow: `MonteCarlo.tracking` says how closely they do, see
        `capsyn.tracking`. Not with an `executor`.

    Raises
    ------
    ProblemError
        An argument that cannot be used, such as no target.
    """
    loop = LoopOptions(
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
        substeps=substeps,
        seed=seed,
        backend=backend,
        threads=threads,
        executor=executor,
        exogenous=exogenous,
    )
    own = (trials, initial, tolerance, within, hold, confidence, track)
    return try_out(controller, TrialOptions(loop, *own))


def try_out(controller: Any, options: TrialOptions) -> MonteCarlo:
    """Return what `monte_carlo` does."""
    parameters = drawn_parameters(options)
    plant = plant_of(controller, options.loop.model, tuple(parameters))
    if options.loop.delay is None:
        known = dataclasses.replace(options.loop, delay=plant.delay)
        options = dataclasses.replace(options, loop=known)
    target = options.loop.target
    if target is None:
        target = (described(controller) or plant).target
    if target is None:
        raise ProblemError("`target` must be given: neither policy nor problem has one")
    target = with_tolerance(target, options.tolerance)
    if options.track is not None:
        names = plant.space.names
        check_followed(options.track, names[: plant.states], names[plant.states :])
    rate, samples = sampling(controller, options.loop)
    told = drawn_exogenous(options, plant.exogenous, 1 / rate, samples)
    drawn = draw(options, plant, parameters, told.start)
    disturbance = options.loop.disturbance
    loop = dataclasses.replace(
        options.loop,
        target=target,
        stop_at_target=options.hold == 0,
        disturbance=disturbance if callable(disturbance) else None,
    )
    values = np.array(list(parameters.values())).reshape(len(parameters), options.trials)
    experiment = set_up(controller, plant, loop, values, told.samples)
    states = np.hstack([drawn.initial, drawn.exogenous])
    pushes = padded(plant, drawn.disturbances)
    trials = experiment.trials(states, drawn.delays, values.T, pushes)
    noise = None
    if loop.noise is not None:
        seeds = [(loop.seed, 5, k + 1) for k in range(options.trials)]
        noise = Noise(padded(plant, drawn.noises), seeds)
    tracked = _run(experiment, trials, noise, options.track)
    return _result(controller, options, experiment, drawn, trials, tracked)


def _run(
    experiment: Experiment,
    trials: np.ndarray,
    noise: Noise | None,
    track: Mapping[str, str | float] | None,
) -> dict[str, Tracking]:
    """Run trials, and return how closely states followed what they should, by name.

    For this they are recorded, as many at a time as `RECORDED` bytes hold.
    """
    if track is None:
        experiment.run(trials, noise, None)
        return {}
    plant, samples = experiment.plant, experiment.loop.samples
    size = max(1, RECORDED // (8 * (samples + 1) * (plant.n + plant.m + 2)))
    times = np.arange(samples + 1) / experiment.rate
    names = plant.space.names
    parts: dict[str, list[Tracking]] = {
        f"{state} - {wanted}": [] for state, wanted in track.items()
    }
    for start in range(0, len(trials), size):
        part = slice(start, start + size)
        some = trials[part].copy()
        own = None if noise is None else Noise(noise.deviations[part], noise.seeds[part])
        record = new_record(len(some), samples, plant.n, plant.m)
        experiment.run(some, own, record)
        trials[part] = some
        x, w = record.states[..., : plant.states], record.states[..., plant.states :]
        for key, (state, wanted) in zip(parts, track.items()):
            pair = followed(x, w, names[: plant.states], names[plant.states :], state, wanted)
            parts[key].append(figures(times, *pair, some["end"]))
    return {key: joined_figures(some) for key, some in parts.items()}


def _result(
    controller: Any,
    options: TrialOptions,
    experiment: Experiment,
    drawn: Drawn,
    trials: np.ndarray,
    tracked: dict[str, Tracking],
) -> MonteCarlo:
    """Return how the trials of an experiment went."""
    rate, samples, count = experiment.rate, experiment.loop.samples, options.trials
    arrived = np.where(trials["arrived"] < 0, np.nan, trials["arrived"] / rate)
    with np.errstate(invalid="ignore"):
        success = arrived <= options.within * (1 + ROUNDING)
    if options.hold:
        stayed = trials["away"] < samples - options.hold * rate - SLACK
        success &= (trials["ended"] == TIME) & stayed
    n = experiment.plant.states
    states = np.vstack([np.hstack([drawn.initial, drawn.exogenous]), trials["state"]])
    costs = default_costs(controller, states, options.loop.backend)
    low, high = clopper_pearson(int(success.sum()), count, options.confidence)
    return MonteCarlo(
        seed=options.loop.seed,
        conditions=_conditions(controller, options, experiment),
        confidence=options.confidence,
        low=low,
        high=high,
        success=success,
        final=trials["state"][:, :n].copy(),
        ended=trials["ended"].copy(),
        times=trials["end"] / rate,
        arrived=arrived,
        switches=trials["switches"].copy(),
        outside=trials["outside"].copy(),
        initial_cost=costs[:count],
        final_cost=costs[count:],
        tracking=tracked,
        **vars(drawn),
    )


def _conditions(controller: Any, options: TrialOptions, experiment: Experiment) -> dict[str, Any]:
    """Return what trials have in common, as plain data."""
    loop, rule = options.loop, experiment.outside
    domain, space = experiment.plant.domain, experiment.plant.space
    assert experiment.target is not None
    unit = experiment.plant.time_unit
    return {
        **({} if unit == "s" else {"time_unit": unit}),
        "duration": loop.duration,
        "rate": experiment.rate,
        "within": options.within,
        "hold": options.hold,
        "target": describe_target(experiment.target, space),
        "initial": describe_target(options.initial or domain, domain),
        **_holds(experiment),
        "substeps": experiment.loop.substeps,
        "controller": _controller_name(controller),
        "model": "its own" if loop.model is None else _name(loop.model),
        "outside": rule if rule is None or isinstance(rule, str) else controller.symbol_name(rule),
        **({"outside_at_once": True} if experiment.loop.outside_at_once else {}),
        "noise": _plain(loop.noise),
        "delay": _plain(loop.delay),
        "disturbance": _plain(loop.disturbance),
        "parameters": {name: _plain(value) for name, value in loop.parameters.items()},
        **_told(loop.exogenous, experiment.plant.exogenous),
    }


def _told(given: Any, told: Box | None) -> dict[str, Any]:
    """Return what was told exogenous inputs along trials, by name."""
    if told is None:
        return {}
    if given is None or isinstance(given, Mapping):
        drawn = dict(zip(told.names, map(Uniform, told.lower, told.upper))) | dict(given or {})
        return {"exogenous": {name: _plain(value) for name, value in drawn.items()}}
    return {"exogenous": _plain(given)}


def _holds(experiment: Experiment) -> dict[str, Any]:
    """Return the least times of symbols and inputs, of all symbols where they have the same."""
    holds, rate = experiment.loop.holds, experiment.rate
    each = (holds.symbols / rate).tolist()
    if len(set(each)) == 1 and not holds.inputs.any():
        return {"min_dwell": each[0]}
    alphabet = experiment.controller.alphabet
    names = (*alphabet.names, DEFAULT, *alphabet.inputs)
    times = zip(names, [*each, *(holds.inputs / rate).tolist()])
    return {"min_dwell": 0.0, "holds": {name: time for name, time in times if time}}


def _name(value: Any) -> str:
    """Return the name of a problem, a policy or a function."""
    return one_line(str(getattr(value, "name", getattr(value, "__name__", "a function"))))


def _controller_name(controller: Any) -> str:
    if isinstance(controller, Policy):
        return f"policy {controller.name}"
    return repr(controller) if isinstance(controller, OnlineController) else _name(controller)


def _plain(value: Any) -> Any:
    """Return a quantity of the trials as plain data."""
    if isinstance(value, Uniform):
        return {"low": _plain(value.low), "high": _plain(value.high)}
    if callable(value):
        return "a function of time"
    if (pairs := pairs_of_steps(value)) is not None:  # no other quantity has pairs
        return {repr(float(time)).removesuffix(".0"): _plain(step) for time, step in pairs}
    return np.asarray(value).tolist()


def default_costs(controller: Any, states: np.ndarray, backend: str = "auto") -> np.ndarray:
    """Return the costs (B,) of the default predictions from states (B, n), eq. (3).

    They are those of the controller's own model; NaN where it has none.
    """
    solver = controller.numpy.chooser if isinstance(controller, OnlineController) else None
    if isinstance(controller, Policy):
        solver = policy_controller(controller, backend)
    return np.full(len(states), np.nan) if solver is None else solver.solve(states).cost
