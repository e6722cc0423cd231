"""What happened in trials: figures of each, and over all of them as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from capsyn.controllers.command import ENDINGS
from capsyn.modelling.time_unit import NAMES
from capsyn.notebook import table
from capsyn.simulation.tracking import Tracking
from capsyn.statistics import TOLD, mean_interval


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
        First and last states of each trial [state units].
    ended : (T,)
        Why each trial ended, as numbers into `capsyn.controllers.command.ENDINGS`.
    times : (T,)
        How long each trial ran [time unit].
    arrived : (T,)
        When each trial first was in the target [time unit]; NaN if it never was.
    switches, outside : (T,)
        Numbers of changes of the control, and of samples measured outside the domain.
    initial_cost, final_cost : (T,)
        Cost of the default prediction from the first and last states of each trial, eq. (3); NaN if
        the cost has no model.
    parameters : mapping of name to (T,)
        Values of the plant's parameters that each trial drew.
    delays : (T,)
        Input delay that each trial drew [time unit].
    disturbances, noises : (T, n)
        Constant disturbance [state units / time unit] and standard deviation of the measurement
        noise [state units] that each trial drew. Noises are (T, n + k) if exogenous inputs have
        noise.
    exogenous : (T, k)
        Exogenous inputs at the start of each trial [their units].
    tracking : mapping of name to Tracking
        How closely each state of `track` followed its reference, (T,) figures each.
    figures : mapping of name to (T,)
        Sums over each trial until its end: ``effort``, the integral of ``u^T u``; ``fuel``, the
        integral of the sum of ``|u|`` [input units, time unit]; and costs by name.
    entered : (T,)
        When each trial first was where it must not be [time unit]; NaN if never.
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
    figures: Mapping[str, np.ndarray] = field(default_factory=dict)
    entered: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def success_rate(self) -> float:
        """Share of the trials that succeeded."""
        return float(self.success.mean())

    @property
    def failures(self) -> np.ndarray:
        """Initial states (F, n) of the trials that failed."""
        return self.initial[~self.success]

    def trial(self, index: int) -> dict[str, Any]:
        """Return what trial `index` drew, as plain data; of the noise, the standard deviation."""
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

    def _entered(self) -> dict[str, int]:
        """Return how many trials were where they must not be, if there is such a set."""
        if not {"avoid", "stay_in"} & set(self.conditions):
            return {}
        return {"trials_entered": int(np.isfinite(self.entered).sum())}

    def __repr__(self) -> str:
        return (
            f"MonteCarlo({int(self.success.sum())} of {len(self.success)} trials succeed, "
            f"{self.low:.3%} to {self.high:.3%} with {self.confidence:.0%} confidence)"
        )

    def _repr_html_(self) -> str:
        """Return the main figures as a table for notebooks."""
        unit = self.conditions.get("time_unit", "s")
        moved = self.times > 0
        figures = {
            f"time to the target [{unit}]": _spread(self.arrived[self.success]),
            f"switches per {NAMES[unit]}": _spread(self.switches[moved] / self.times[moved]),
        }
        ends = {name: int((self.ended == k).sum()) for k, name in enumerate(ENDINGS)}
        rows = [
            ("success", f"{self.success_rate:.2%}", f"{self.low:.2%} to {self.high:.2%}"),
            *((f"ended: {name}", f"{count:,}", "") for name, count in ends.items() if count),
            *(
                (name, f"{told['median']:.4g}", f"{told['min']:.4g} to {told['max']:.4g}")
                for name, told in figures.items()
                if told
            ),
        ]
        return table(repr(self), rows, ["", "rate, count or median", "interval or range"])

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data, with the first `TOLD` trials that failed.

        Times and rates are in the plant's time unit. ``conditions`` name it if it is not s.
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
            "figures": {k: _figure(v, self.confidence) for k, v in self.figures.items()},
            **self._entered(),
            **({"tracking": _tracked(self.tracking, self.confidence)} if self.tracking else {}),
        }


def _figure(values: np.ndarray, confidence: float) -> dict[str, float] | None:
    """Return the spread of the finite values (T,), with the interval of their mean."""
    known = values[np.isfinite(values)]
    spread, interval = _spread(known), mean_interval(known, confidence)
    if spread is None or interval is None:
        return spread
    return spread | {"low": interval[0], "high": interval[1]}


def _tracked(tracking: Mapping[str, Tracking], confidence: float) -> dict[str, Any]:
    """Return the figures of each tracked state over the trials, biases by their size."""
    return {
        name: {
            "rms": _figure(figures.rms, confidence),
            "bias": _spread(np.abs(figures.bias)),
            "overshoot": _spread(figures.overshoot),
            "settling": _spread(figures.settling),
            "unsettled": int(np.isnan(figures.settling).sum()),
            "not_finite": int(np.isnan(figures.rms).sum()),
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
