"""Monte Carlo: how often a controller reaches the target from random initial states."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.controllers.command import TARGET, TIME
from capsyn.controllers.online import OnlineController
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Outside
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.targets import with_tolerance
from capsyn.policies.policy import Policy
from capsyn.programs.program import Program
from capsyn.simulation.closed_loop import Noise, new_record
from capsyn.simulation.experiment import Experiment, described, padded, sampling, set_up
from capsyn.simulation.figures import Gathered
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import plant_of
from capsyn.simulation.tracking import (
    Tracking,
    check_followed,
    figures,
    followed,
    joined_figures,
)
from capsyn.statistics import clopper_pearson
from capsyn.verification.conditions import conditions
from capsyn.verification.outcome import MonteCarlo
from capsyn.verification.trials import (
    Drawn,
    TrialOptions,
    draw,
    drawn_exogenous,
    drawn_parameters,
)

ROUNDING, SLACK = 1e-12, 1e-6
"""What rounding may add to a time of arrival, relative, and to a time to stay [samples]."""
RECORDED = 1 << 26
"""Bytes of the trials that are recorded at a time, for what is told of tracking."""


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
    avoid: Any = None,
    stay_in: Any = None,
    costs: Mapping[str, Any] | None = None,
) -> MonteCarlo:
    """Return how often a controller reaches the target from random initial states.

    Without `hold`, a trial succeeds when it is in the target at some sample, and ends there. With
    `hold`, a trial succeeds if it reaches the target within the time `within`, and is in the target
    at every sample of the last time `hold`.

    Parameters
    ----------
    controller, model, min_dwell, outside, outside_at_once, substeps, backend, threads
        The arguments of the same names of `capsyn.simulate`.
    trials : int
        Number of trials T.
    duration, rate : float
        Time limit of a trial [time unit of the plant, as all times here], and samples per time
        unit.
    initial : Ball or Box, optional
        The set from which initial states are drawn. States that the set does not name are drawn
        from the domain. Default: the domain.
    target : Ball, Box or callable ``x -> true or false``, optional
        The states that count as arrived. Default: the policy's own target.
    tolerance : float, optional
        Another radius for a target that is a ball [state units].
    within, hold : float, optional
        Time within which a trial must arrive, and time at the end for which it must stay [time
        unit].
    parameters : mapping of name to float or Uniform, optional
        The components of the model's `p`, in order.
    disturbance : float, (n,) or Uniform, or callable ``time -> (n,)``, optional
        A term added to the rates of the states [state units / time unit].
    noise : float, (n,), (n + k,) or Uniform, optional
        Standard deviation of Gaussian noise on the measured states [state units]. With n + k
        numbers, also on the k exogenous inputs [their units].
    delay : float or Uniform, optional
        Time from a sample until its control acts [time unit]. Default: the delay of the plant,
        which the policy compensates.
    seed : int
        Seed of all random numbers. The first trials do not depend on the number of trials.
    confidence : float
        Confidence of the interval of the success rate.
    executor : dask.distributed.Client, optional
        A cluster whose workers run the trials of a policy, with the same results.
    exogenous : as in `capsyn.simulate`, a value by name also a Uniform, optional
        Exogenous inputs of a model that has them. An input that is not given by name is drawn anew
        from its box for each trial, and is constant along the trial.
    track : mapping of state to name of an exogenous input, or number, optional
        What states should follow. `MonteCarlo.tracking` then says how closely they follow it (see
        `capsyn.tracking`), until the trial ends. Without `hold`, a trial ends when it arrives.
        `track` cannot be used with an `executor`.
    avoid, stay_in : Ball, Box or callable ``x -> true or false``, or ``(x, w)``, optional
        Sets that a trial must not enter, or must not leave. A trial fails if it does so at some
        sample.
    costs : mapping of name to callable ``x -> scalar``, or ``(x, w)``, optional
        Further running costs by name [cost / time unit], whose sums `MonteCarlo.figures` reports.
        Each of them takes as long as the trials once more.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or no target.
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
        avoid=avoid,
        stay_in=stay_in,
        costs=costs,
    )
    own = (trials, initial, tolerance, within, hold, confidence, track)
    return try_out(controller, TrialOptions(loop, *own))


@dataclass(frozen=True, eq=False)
class Prepared:
    """Trials of a controller that are drawn, and not yet run."""

    controller: Any
    options: TrialOptions
    experiment: Experiment
    drawn: Drawn
    trials: np.ndarray  # (T,) as `capsyn.simulation.closed_loop.new_trials` makes them
    noise: Noise | None

    def charging(self, cost: Program, paid: np.ndarray | None = None) -> Experiment:
        """Return the experiment whose trials gather a cost x -> rate, and pay for labels.

        What is `paid` (N + 1, N + 1) is that of a sample, see `capsyn.simulation.closed_loop.Loop`.
        """
        experiment = self.experiment
        plant = dataclasses.replace(experiment.plant, running_cost=cost)
        loop = dataclasses.replace(experiment.loop, paid=paid)
        return dataclasses.replace(experiment, plant=plant, loop=loop)


def try_out(controller: Any, options: TrialOptions) -> MonteCarlo:
    """Return what `monte_carlo` does."""
    test = prepared(controller, options)
    if test.experiment.target is None:
        raise ProblemError(
            "`target` must be given: neither policy nor problem has one; to try whether loops stay "
            "in a set, give it as the target, and as `hold` how long"
        )
    gathered = Gathered.of(options.loop, test.experiment.plant)
    before = test.trials.copy()
    tracked = _run(test)
    more = (test.experiment, test.trials, before, test.noise)
    return _result(test, tracked, gathered.figures(*more), gathered.entered(*more))


def prepared(controller: Any, options: TrialOptions) -> Prepared:
    """Return the trials of a controller, all that is random in them drawn.

    They need no target: without one they end with their time. With one, and no time to hold, they
    end there.
    """
    parameters = drawn_parameters(options)
    plant = plant_of(controller, options.loop.model, tuple(parameters))
    if options.loop.delay is None:
        known = dataclasses.replace(options.loop, delay=plant.delay)
        options = dataclasses.replace(options, loop=known)
    target = options.loop.target
    if target is None:
        target = (described(controller) or plant).target
    if target is None and (options.tolerance is not None or options.hold):
        raise ProblemError("`target` must be given: neither policy nor problem has one")
    target = with_tolerance(target, options.tolerance)
    if options.track is not None:
        names = plant.space.names
        check_followed(options.track, names[: plant.states], names[plant.states :])
    rate, samples = sampling(controller, options.loop, plant)
    told = drawn_exogenous(options, plant.exogenous, 1 / rate, samples)
    drawn = draw(options, plant, parameters, told.start)
    disturbance = options.loop.disturbance
    loop = dataclasses.replace(
        options.loop,
        target=target,
        stop_at_target=options.hold == 0 and target is not None,
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
        whole = drawn.noises.shape[1] == plant.n
        noise = Noise(drawn.noises if whole else padded(plant, drawn.noises), seeds)
    return Prepared(controller, options, experiment, drawn, trials, noise)


def _run(test: Prepared) -> dict[str, Tracking]:
    """Run trials, and return how closely states followed what they should, by name.

    For this they are recorded, as many at a time as `RECORDED` bytes hold.
    """
    track, experiment, trials, noise = test.options.track, test.experiment, test.trials, test.noise
    if track is None:
        experiment.run(trials, noise, None)
        return {}
    plant, samples = experiment.plant, experiment.loop.samples
    size = max(1, RECORDED // (8 * (samples + 1) * (plant.n + plant.m + 2)))
    times = np.arange(samples + 1) / experiment.rate
    names, n = plant.space.names, plant.states
    named = names[:n], names[n:], tuple(plant.domain.periods.tolist())
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
        x, w = record.states[..., :n], record.states[..., n:]
        for key, (state, wanted) in zip(parts, track.items()):
            pair = followed(x, w, *named, state, wanted)
            parts[key].append(figures(times, *pair, some["end"]))
    return {key: joined_figures(some) for key, some in parts.items()}


def succeeded(options: TrialOptions, experiment: Experiment, trials: np.ndarray) -> np.ndarray:
    """Return which of trials (T,) that have run succeeded."""
    arrived = _arrived(experiment, trials)
    with np.errstate(invalid="ignore"):
        success = arrived <= options.within * (1 + ROUNDING)
    if options.hold:
        samples = experiment.loop.samples
        stayed = trials["away"] < samples - options.hold * experiment.rate - SLACK
        success &= (trials["ended"] == TIME) & stayed
    return np.asarray(success)


def went_on(trials: np.ndarray) -> np.ndarray:
    """Return which of trials (T,) that have run went on to their end, at a finite cost."""
    return np.isin(trials["ended"], (TIME, TARGET)) & np.isfinite(trials["cost"])


def switch_rate(experiment: Experiment, trials: np.ndarray) -> float:
    """Return the switches of trials (T,) that have run [1 / time unit]; 0 where they took none."""
    time = trials["end"].sum() / experiment.rate
    return float(trials["switches"].sum() / time) if time else 0.0


def _arrived(experiment: Experiment, trials: np.ndarray) -> np.ndarray:
    """Return when trials (T,) first were in the target [time unit]; NaN where never."""
    return np.where(trials["arrived"] < 0, np.nan, trials["arrived"] / experiment.rate)


def _result(
    test: Prepared,
    tracked: dict[str, Tracking],
    figures: dict[str, np.ndarray],
    entered: np.ndarray,
) -> MonteCarlo:
    """Return how trials went that have run."""
    controller, options, experiment = test.controller, test.options, test.experiment
    drawn, trials, count = test.drawn, test.trials, options.trials
    success = succeeded(options, experiment, trials) & np.isnan(entered)
    n = experiment.plant.states
    states = np.vstack([np.hstack([drawn.initial, drawn.exogenous]), trials["state"]])
    costs = default_costs(controller, states, options.loop.backend)
    low, high = clopper_pearson(int(success.sum()), count, options.confidence)
    return MonteCarlo(
        seed=options.loop.seed,
        conditions=conditions(controller, options, experiment),
        confidence=options.confidence,
        low=low,
        high=high,
        success=success,
        final=trials["state"][:, :n].copy(),
        ended=trials["ended"].copy(),
        times=trials["end"] / experiment.rate,
        arrived=_arrived(experiment, trials),
        switches=trials["switches"].copy(),
        outside=trials["outside"].copy(),
        initial_cost=costs[:count],
        final_cost=costs[count:],
        tracking=tracked,
        figures=figures,
        entered=entered,
        **vars(drawn),
    )


def default_costs(controller: Any, states: np.ndarray, backend: str = "auto") -> np.ndarray:
    """Return the costs (B,) of the default predictions from states (B, n), eq. (3).

    They are those of the controller's own model; NaN where it has none.
    """
    solver = controller.numpy.chooser if isinstance(controller, OnlineController) else None
    if isinstance(controller, Policy):
        solver = policy_controller(controller, backend)
    return np.full(len(states), np.nan) if solver is None else solver.solve(states).cost
