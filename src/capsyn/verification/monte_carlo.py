"""Monte Carlo: how often a controller reaches the target from random initial states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.controllers.command import ENDINGS, TIME
from capsyn.controllers.online import OnlineController
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Outside, check_outside
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.targets import check_target, describe_target, target_axes, with_tolerance
from capsyn.policies.policy import Policy
from capsyn.simulation.closed_loop import Noise
from capsyn.simulation.experiment import per_state, set_up
from capsyn.simulation.plant import plant_of
from capsyn.statistics import TOLD, check_confidence, clopper_pearson
from capsyn.validation import describe, finite_number, one_line, whole_number

MOST_TRIALS = 10**8
ROUNDING, SLACK = 1e-12, 1e-6
"""What rounding may add to a time of arrival, relative, and to a time to stay [samples]."""


@dataclass(frozen=True)
class Uniform:
    """A quantity that every trial draws anew, evenly between two bounds.

    Parameters
    ----------
    low, high : float or (n,)
        Bounds, ``low <= high``.
    """

    low: Any
    high: Any


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
        How long it ran [s].
    arrived : (T,)
        When it first was in the target [s]; NaN where never.
    switches, outside : (T,)
        Changes of the control, and samples measured outside the domain.
    initial_cost, final_cost : (T,)
        Cost of the default prediction from its first and last states, eq. (3); NaN without a
        model of the cost.
    parameters : mapping of name to (T,)
        What was drawn of the plant's parameters.
    delays : (T,)
        What was drawn of the input delay [s].
    disturbances, noises : (T, n)
        What was drawn of the constant disturbance [state units / s], and of the standard deviation
        of the measurement noise [state units].
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
        }

    def __repr__(self) -> str:
        return (
            f"MonteCarlo({int(self.success.sum())} of {len(self.success)} trials succeed, "
            f"{self.low:.3%} to {self.high:.3%} with {self.confidence:.0%} confidence)"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data, with the first `TOLD` failing trials."""
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
            "switches_per_second": _spread(self.switches[moved] / self.times[moved]),
            "trials_outside_domain": int((self.outside > 0).sum()),
            "cost_decreased": float(fallen.mean()) if known.any() else None,
            "cost_left": _spread(left),
            "failing_initial_states": self.failures[:TOLD].tolist(),
            "failing_trials": [self.trial(int(k)) for k in np.flatnonzero(~self.success)[:TOLD]],
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
    delay: Any = 0.0,
    min_dwell: float | None = None,
    outside: Outside | None = None,
    substeps: int | None = None,
    seed: int = 0,
    confidence: float = 0.95,
    backend: str = "auto",
    threads: int | None = None,
    executor: Any = None,
) -> MonteCarlo:
    """Return how often a controller reaches the target from random initial states.

    A trial succeeds when it is in the target at some sample, where it ends; with `hold`, when it
    gets there within the time `within`, and is there at every sample of the last `hold` seconds.

    Parameters
    ----------
    controller, model, min_dwell, outside, substeps, backend, threads
        As in `capsyn.simulate`.
    trials : int
        Number of trials T.
    duration, rate : float
        Time limit [s], and samples per second [1 / s].
    initial : Ball or Box, optional
        Where initial states are drawn from; of states that it does not name, from the domain.
        Default: the domain.
    target : Ball, Box or callable ``x -> true or false``, optional
        The target. Default: the policy's own.
    tolerance : float, optional
        Another radius for a target that is a ball [state units].
    within, hold : float, optional
        Time in which to arrive [s], and time at the end to stay [s].
    parameters : mapping of name to float or Uniform, optional
        The components of `p` of the model, in order.
    disturbance : float, (n,) or Uniform, or callable ``time -> (n,)``, optional
        Added to the rates of the states [state units / s].
    noise : float, (n,) or Uniform, optional
        Standard deviation of Gaussian noise on the measured states [state units].
    delay : float or Uniform
        Time from a sample until its control acts [s].
    seed : int
        Of everything that is drawn. The first trials do not depend on how many there are.
    confidence : float
        Of the interval of the success rate.
    executor : dask.distributed.Client, optional
        A cluster whose workers run the trials of a policy, with the same results.

    Raises
    ------
    ProblemError
        An argument that cannot be used, such as no target.
    """
    trials = whole_number("trials", trials, least=1, most=MOST_TRIALS)
    seed = whole_number("seed", seed, least=0)
    confidence = check_confidence(confidence)
    duration = finite_number("duration", duration, above=0.0)
    within = duration if within is None else finite_number("within", within, above=0.0)
    hold = finite_number("hold", hold, least=0.0)
    if hold > duration:
        raise ProblemError(f"`hold` must be at most the duration {duration:g}; got {hold:g}")
    if within > duration:
        raise ProblemError(f"`within` must be at most the duration {duration:g}; got {within:g}")
    if parameters is not None and not isinstance(parameters, Mapping):
        raise ProblemError(f"`parameters` must be a mapping of names; got {describe(parameters)}")
    drawn = {
        name: _draw(f"parameters {name}", value, trials, 1, [seed, 1, k + 1])[:, 0]
        for k, (name, value) in enumerate((parameters or {}).items())
    }
    values = np.array(list(drawn.values())).reshape(len(drawn), trials)
    plant = plant_of(controller, model, tuple(drawn))
    domain, n = plant.domain, plant.n
    if target is None:
        own = isinstance(controller, (Policy, OnlineController))
        target = controller.target if own else plant.target
    if target is None:
        raise ProblemError("`target` must be given: neither policy nor problem has one")
    target = with_tolerance(target, tolerance)
    states = _initial_states(initial, domain, trials, seed)
    push = np.zeros((trials, n))
    if disturbance is not None and not callable(disturbance):
        push = _draw("disturbance", disturbance, trials, n, [seed, 2])
    delays = _draw("delay", delay, trials, 1, [seed, 3], least=0.0)[:, 0]
    noisy, deviations = None, np.zeros((trials, n))
    if noise is not None:
        deviations = _draw("noise", noise, trials, n, [seed, 4], least=0.0)
        noisy = Noise(deviations, [(seed, 5, k + 1) for k in range(trials)])
    experiment = set_up(
        controller,
        plant,
        duration,
        rate,
        typical=values,
        disturbance=disturbance if callable(disturbance) else None,
        min_dwell=min_dwell,
        outside=outside,
        target=target,
        stop_at_target=hold == 0,
        substeps=substeps,
        backend=backend,
        threads=threads,
        executor=executor,
    )
    target = experiment.target
    assert target is not None
    done = experiment.trials(states, delays, values.T, push)
    experiment.run(done, noisy, None)

    rate, samples = experiment.rate, experiment.loop.samples
    arrived = np.where(done["arrived"] < 0, np.nan, done["arrived"] / rate)
    with np.errstate(invalid="ignore"):
        success = arrived <= within * (1 + ROUNDING)
    if hold:
        success &= (done["ended"] == TIME) & (done["away"] < samples - hold * rate - SLACK)
    costs = default_costs(controller, np.vstack([states, done["state"]]), backend)
    successes = int(success.sum())
    low, high = clopper_pearson(successes, trials, confidence)
    return MonteCarlo(
        seed,
        {
            "duration": duration,
            "rate": rate,
            "within": within,
            "hold": hold,
            "target": describe_target(target, domain),
            "initial": describe_target(initial or domain, domain),
            "min_dwell": experiment.loop.dwell / rate,
            "substeps": experiment.loop.substeps,
            "controller": _controller_name(controller),
            "model": "its own" if model is None else _name(model),
            "outside": _outside_name(controller, outside),
            "noise": _told(noise),
            "delay": _told(delay),
            "disturbance": _told(disturbance),
            "parameters": {name: _told(value) for name, value in (parameters or {}).items()},
        },
        confidence,
        low,
        high,
        success,
        states,
        done["state"].copy(),
        done["ended"].copy(),
        done["end"] / rate,
        arrived,
        done["switches"].copy(),
        done["outside"].copy(),
        costs[:trials],
        costs[trials:],
        drawn,
        delays,
        push,
        deviations,
    )


def _draw(
    name: str, value: Any, trials: int, size: int, seed: list[int], least: float | None = None
) -> np.ndarray:
    """Return (trials, size) values, the same for all trials or drawn for each."""
    if not isinstance(value, Uniform):
        return np.tile(per_state(name, value, size, least), (trials, 1))
    low = per_state(f"{name} low", value.low, size, least)
    high = per_state(f"{name} high", value.high, size)
    if (high < low).any():
        raise ProblemError(f"`{name}` must have low <= high; got {describe(value)}")
    return low + (high - low) * np.random.default_rng(seed).random((trials, size))


def _name(value: Any) -> str:
    """Return the name of a problem, a policy or a function."""
    return one_line(str(getattr(value, "name", getattr(value, "__name__", "a function"))))


def _controller_name(controller: Any) -> str:
    if isinstance(controller, Policy):
        return f"policy {controller.name}"
    return repr(controller) if isinstance(controller, OnlineController) else _name(controller)


def _outside_name(controller: Any, outside: Outside | None) -> str | None:
    """Return the out-of-domain rule that held."""
    if not isinstance(controller, Policy):
        return None
    rule = controller.outside if outside is None else check_outside(outside, controller.alphabet)
    return rule if isinstance(rule, str) else controller.symbol_name(rule)


def _told(value: Any) -> Any:
    """Return a quantity of the trials as plain data."""
    if isinstance(value, Uniform):
        return {"low": _told(value.low), "high": _told(value.high)}
    return "a function of time" if callable(value) else np.asarray(value).tolist()


def _initial_states(initial: Any, domain: Box, trials: int, seed: int) -> np.ndarray:
    states = domain.sample(trials, [seed, 6])
    if initial is None:
        return states
    if not isinstance(initial, (Ball, Box)):
        raise ProblemError(f"`initial` must be a Ball or a Box; got {describe(initial)}")
    check_target(initial, domain, "initial")
    states[:, target_axes(initial, domain)] = initial.sample(trials, [seed, 7])
    return states


def default_costs(controller: Any, states: np.ndarray, backend: str = "auto") -> np.ndarray:
    """Return the costs (B,) of the default predictions from states (B, n), eq. (3).

    They are those of the controller's own model; NaN where it has none.
    """
    solver = controller.numpy.chooser if isinstance(controller, OnlineController) else None
    if isinstance(controller, Policy):
        solver = policy_controller(controller, backend)
    return np.full(len(states), np.nan) if solver is None else solver.solve(states).cost
