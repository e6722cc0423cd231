"""Comparison of a controller with the optimum, in closed loops from the same starts."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.policies.policy import Policy
from capsyn.simulation.simulate import simulate
from capsyn.statistics import check_confidence


@dataclass(frozen=True, eq=False)
class OptimumComparison:
    """Costs of a controller's closed loops, beside the costs of the optimum's loops.

    Parameters
    ----------
    starts : (B, n)
        Initial states [state units].
    costs, optimal : (B,)
        Costs of the controller's loops, and of loops of the optimum's own policy. A cost is
        infinite if the loop ended early, outside the domain or with a state that is not finite.
    ratio, low, high : float
        Mean cost divided by the least mean cost, over the starts that did not end early, with its
        interval.
    confidence : float
        Confidence of the interval.
    lost : int
        Number of loops that ended early.
    worst : int
        Index of the start that costs most beyond the least. If loops are lost, it is one of their
        starts.
    bound : bool
        Whether the optimum is a bound; see `Optimum`. The optimum is no bound if `beaten` is true.
    names : n strings
        Names of the states.
    """

    starts: np.ndarray
    costs: np.ndarray
    optimal: np.ndarray
    ratio: float
    low: float
    high: float
    confidence: float
    lost: int
    worst: int
    bound: bool
    names: tuple[str, ...]

    @property
    def beaten(self) -> bool:
        """Whether loops surely cost less than the optimum's: its grid is then too coarse."""
        return bool(self.high < 1)

    @property
    def optimality(self) -> float:
        """Least mean cost divided by the mean cost, at most 1; 0 if all loops are lost."""
        return min(1.0, 1 / self.ratio) if self.ratio > 0 else 1.0

    @property
    def excess(self) -> np.ndarray:
        """Costs (B,) beyond the least costs, divided by the mean of the least costs."""
        mean = self.optimal[np.isfinite(self.optimal)].mean()
        return (self.costs - self.optimal) / mean

    def to_json(self) -> dict[str, Any]:
        """Return the figures and the worst start as plain data."""
        k = self.worst
        whole = np.isfinite(self.costs)

        def number(value: float) -> float | None:
            return float(value) if np.isfinite(value) else None

        return {
            "ratio": number(self.ratio),
            "ratio_low": number(self.low),
            "ratio_high": number(self.high),
            "confidence": self.confidence,
            "optimality": self.optimality,
            "starts": len(self.starts),
            "lost": self.lost,
            "cost": number(self.costs[whole].mean()) if whole.any() else None,
            "optimal_cost": number(self.optimal[whole].mean()) if whole.any() else None,
            "worst": {
                "start": dict(zip(self.names, self.starts[k].tolist())),
                "cost": number(self.costs[k]),
                "optimal_cost": number(self.optimal[k]),
            },
            "bound": self.bound,
            "beaten": self.beaten,
        }


def compared(
    optimum: Any,
    controller: Any,
    *,
    outside: Any = None,
    backend: str = "auto",
    threads: int | None = None,
    confidence: float = 0.95,
) -> OptimumComparison:
    """Return what `Optimum.compare` does."""
    task, starts, best = optimum.lookahead.task, optimum.starts, optimum.costs
    check_confidence(confidence)
    if isinstance(controller, Policy):
        if controller.exogenous is not None:
            if task.told is None:
                raise ProblemError("`controller` must be told nothing, as the optimum is")
            controller = controller.at(task.told)
        if controller.alphabet.values.shape[1] != task.alphabet.m:
            raise ProblemError(
                f"`controller` must have {task.alphabet.m} input(s) like the optimum; got "
                f"{controller.alphabet.m}"
            )
    substeps = None if task.plant.sample_time is not None else task.substeps
    trajectory = simulate(
        controller, starts, optimum.duration, 1 / task.period, model=task, outside=outside,
        target=task.target, stop_at_target=task.stop, substeps=substeps, backend=backend,
        threads=threads,
    )  # fmt: skip
    costs = np.take_along_axis(trajectory.costs, trajectory.last[:, None], axis=1)[:, 0]
    costs = costs + _of_symbols(task, trajectory.controls)
    ended = np.isin(trajectory.ended, ("time", "target"))
    costs = np.where(ended & np.isfinite(costs), costs, np.inf)
    ratio, half = _ratio(costs, best, confidence)
    with np.errstate(invalid="ignore"):
        worse = np.nan_to_num(costs - best, nan=0.0, posinf=np.inf)
    return OptimumComparison(
        starts, costs, best, ratio, max(ratio - half, 0.0), ratio + half, confidence,
        int((~ended).sum()), int(worse.argmax()), optimum.bound and not ratio + half < 1,
        task.domain.names,
    )  # fmt: skip


def _of_symbols(task: Any, controls: np.ndarray) -> np.ndarray:
    """Return what efforts and changes along loops (B, K, m) cost, (B,), NaN after their ends."""
    if not task.efforts.any() and not task.switches.any():
        return np.zeros(len(controls))
    symbols = np.full(controls.shape[:2], -2)
    for k, value in reversed(list(enumerate(task.alphabet.values))):
        symbols[(controls == value).all(axis=2)] = k
    known = symbols >= 0
    efforts = np.where(known, task.efforts[symbols], 0.0).sum(axis=1) * task.period
    changed = known[:, 1:] & known[:, :-1] & (symbols[:, 1:] != symbols[:, :-1])
    prices = np.where(changed, task.switches[symbols[:, :-1], symbols[:, 1:]], 0.0)
    return efforts + np.where(np.isfinite(prices), prices, 0.0).sum(axis=1)


def _ratio(costs: np.ndarray, best: np.ndarray, confidence: float) -> tuple[float, float]:
    """Return mean cost over least mean cost, of finite ones, and half the width of its interval."""
    good = np.isfinite(costs) & np.isfinite(best)
    if not good.any() or not best[good].mean():
        return float("inf"), float("inf")
    costs, best = costs[good], best[good]
    ratio = float(costs.mean() / best.mean())
    if len(costs) < 2:
        return ratio, float("inf")
    deviation = float(np.std(costs - ratio * best, ddof=1)) / best.mean() / len(costs) ** 0.5
    return ratio, statistics.NormalDist().inv_cdf((1 + confidence) / 2) * deviation
