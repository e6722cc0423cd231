"""Figures of a policy's closed loops: successes, cost, effort and switches, and its size."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.compression.trees import tree_of
from capsyn.errors import ProblemError
from capsyn.modelling.problem import Problem
from capsyn.modelling.tails.riccati import FIT
from capsyn.modelling.transcription import transcribe, user_program
from capsyn.policies.policy import Policy
from capsyn.programs.model import Model, gathered_cost
from capsyn.programs.program import Program
from capsyn.statistics import clopper_pearson
from capsyn.validation import called, numbers
from capsyn.verification.monte_carlo import prepared, succeeded, switch_rate, went_on
from capsyn.verification.trials import TrialOptions


@dataclass(frozen=True)
class Figures:
    """Figures of a policy's closed loops, and of its size.

    Parameters
    ----------
    starts : int
        Number of loops, each from its own random state.
    success, low, high : float, optional
        Share of the loops that succeed (see `capsyn.monte_carlo`), and its interval; None without a
        target.
    cost, effort : float, optional
        Mean cost, and mean effort [its unit times the time unit], of the loops that run to their
        end; None if all loops are lost.
    switches : float
        Switches per time unit, over all loops.
    lost : int
        Number of loops that end early: outside the domain, or in a state that is not finite.
    cells : int
        Leaves of the policy.
    nodes : int, optional
        Nodes of the policy's exact tree; None if the tree was not asked for, or is too large.
    """

    starts: int
    success: float | None
    low: float | None
    high: float | None
    cost: float | None
    effort: float | None
    switches: float
    lost: int
    cells: int
    nodes: int | None = None

    @staticmethod
    def from_json(data: Any) -> Figures:
        """Return figures from the `data` of `to_json`; other data raise `ProblemError`."""
        known = {field.name: field for field in dataclasses.fields(Figures)}
        if not isinstance(data, dict) or set(data) != set(known):
            raise ProblemError("the figures of a trial must be what capsyn tune writes")
        for name, value in data.items():
            whole = name in ("starts", "lost", "cells")
            fits = type(value) is int if whole else type(value) in (int, float, type(None))
            if not fits or (name == "switches" and value is None) or (whole and value < 0):
                raise ProblemError(f"the figures of a trial must have a {name}; got {value!r}")
        return Figures(**data)

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class Tried:
    """Settings that were tried, and the figures of their closed loops.

    Parameters
    ----------
    number : int
        Number of the trial in the study.
    settings : dict
        The settings by name.
    figures : Figures, optional
        The figures that were found; None if the settings cannot be used.
    full : bool
        Whether the trial was judged in full, and did not end after the quick stage.
    error : str, optional
        Why the settings cannot be used.
    """

    number: int
    settings: dict[str, Any]
    figures: Any
    full: bool
    error: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the trial as plain data."""
        figures = None if self.figures is None else self.figures.to_json()
        return vars(self) | {"figures": figures}


@dataclass(frozen=True, eq=False)
class Charges:
    """What loops are charged, the same for all policies that are compared."""

    cost: Program  # x -> cost that a loop gathers [cost / time unit]
    nothing: Program  # the same, of no cost
    effort: Callable[..., Any] | None  # u -> effort of a time unit; None: u^T u
    nodes: bool  # whether the nodes of exact trees are counted

    @staticmethod
    def of(problem: Problem, cost: Any, effort: Any, nodes: bool) -> Charges:
        """Return those of a problem's own cost, or of a function ``x -> cost`` or ``(x, w)``."""
        model = model_of(problem)
        own = gathered_cost(model.running_cost, model.terminal_cost)
        if cost is not None:
            own = cost_program(problem, cost)
        if effort is not None and not callable(effort):
            raise ProblemError("`effort` must be a function of the control u; got no function")
        return Charges(own, cost_program(problem, lambda *_: 0.0), effort, nodes)

    def efforts(self, controls: np.ndarray) -> np.ndarray:
        """Return the efforts (N,) of controls (N, m)."""
        if self.effort is None:
            return np.asarray((controls**2).sum(axis=1))
        each = [called("effort", self.effort, u) for u in controls]
        values = numbers("effort", [np.asarray(one, dtype=object).item() for one in each])
        if not np.isfinite(values).all():
            raise ProblemError("`effort` must be a finite number for every symbol")
        return values


def cost_program(problem: Problem, cost: Callable[..., Any]) -> Program:
    """Return the program of a cost ``x -> scalar``, or ``(x, w)``, that loops gather."""
    n = problem.space.n
    ports: tuple[Any, ...] = (("x", n),), (("cost", 1),)
    return user_program("cost", cost, *ports, told=n - problem.domain.n)


def model_of(problem: Problem) -> Model:
    """Return the model of a problem, without a tail that is yet to be fitted."""
    return transcribe(problem.replace(tail=None) if problem.tail == FIT else problem)


def figures_of(policy: Policy, options: TrialOptions, charges: Charges) -> Figures:
    """Return what closed loops of a policy do.

    They run twice, for the cost and for the effort, with the same draws.
    """
    test = prepared(policy, options)
    efforts = charges.efforts(policy.controls)
    charged = test.experiment.plant.charged_time(test.experiment.loop.period)
    paid = np.tile(efforts * charged, (len(efforts), 1))
    trials, other = test.trials.copy(), test.trials.copy()
    test.charging(charges.cost).run(trials, test.noise, None)
    test.charging(charges.nothing, paid).run(other, test.noise, None)
    regular = went_on(trials)
    success: dict[str, Any] = {"success": None, "low": None, "high": None}
    if test.experiment.target is not None:
        count = int(succeeded(test.options, test.experiment, trials).sum())
        low, high = clopper_pearson(count, options.trials, options.confidence)
        success = {"success": count / options.trials, "low": low, "high": high}
    return Figures(
        starts=options.trials,
        **success,
        cost=_mean(trials["cost"][regular]),
        effort=_mean(other["cost"][regular]),
        switches=switch_rate(test.experiment, trials),
        lost=int((~regular).sum()),
        cells=policy.cells.leaf_count,
        nodes=_nodes(policy) if charges.nodes else None,
    )


def _mean(values: np.ndarray) -> float | None:
    mean = float(values.mean()) if values.size else math.inf
    return mean if math.isfinite(mean) else None


def _nodes(policy: Policy) -> int | None:
    """Return the nodes of a policy's exact tree; None where there is none, or it has too many."""
    try:
        return tree_of(policy).node_count
    except ProblemError:
        return None
