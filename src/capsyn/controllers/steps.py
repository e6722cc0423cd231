"""How many Runge-Kutta steps over the horizon sSAC takes: as many as its decisions need."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from capsyn.cells.masks import last_any, several
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import Solver
from capsyn.errors import ProblemError, warn
from capsyn.programs.builder import bind
from capsyn.programs.continuity import kink_conditions
from capsyn.programs.model import Model
from capsyn.programs.step_doubling import KINKED, UNRESOLVED, fewest_steps

STEP_LADDER = tuple(steps << k for k in range(10) for steps in (4, 6)) + (4096,)
"""Steps that `choose_steps` tries."""
TRIED = 256
"""Steps from which on an error that does not fall ends the search."""
STEP_SAMPLES = 512
"""Random states whose gradients are compared, and the fewest whose symbols are."""
DECIDED, WORK = 4096, 1 << 19
"""Most random states whose symbols are compared, and most steps of all of them together."""
FINER = 2
"""Symbols are compared with those of so many times the steps, and one more: a wave that looks alike
at both is rare."""
CHANGED = 1.0
"""States off ties that may get another symbol there: 0.03 % of `DECIDED`."""
NODES = 16
"""Steps of the predictions in which kinks are looked for."""
STABLE = 2.78
"""Longest stable Runge-Kutta step, in times that a state takes to decay by a factor of e."""
STIFF = 64
"""A model is called stiff where stability alone takes so many steps."""

Results = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Costs (B,), mode insertion gradients (B, N) and scales (B, N) of B states."""
Decided = Callable[[Results], np.ndarray]
"""Results to the masks (B, W) of the symbols that could be best."""


def choose_steps(
    solver: Solver, decided: Decided, formulation: Formulation, bound: Model, seed: int
) -> int:
    """Return the steps of a formulation at random states of its domain; see `resolving_steps`.

    `bound` is its model with the default control. Where no steps are enough (jumps of the dynamics,
    single precision), the best are returned with a warning, which names stiffness where that is
    why.

    Raises
    ------
    ProblemError
        A model so stiff that no steps of the ladder give a finite result.
    """
    horizon, tolerance = formulation.horizon, formulation.settings.tolerance
    states = formulation.domain.sample(DECIDED, seed)
    samples = states[:STEP_SAMPLES]
    smooth = _smooth(bound, samples, horizon)
    best, least = resolving_steps(solver, decided, states, horizon, tolerance, smooth)
    if least == np.inf and (stiff := _stiffness(formulation, samples)):
        raise ProblemError(f"`horizon` must be shorter, or `steps` given: {stiff}")
    if least > tolerance:
        warn(
            f"the step-doubling check reached {least:.2g} with {best} steps, not the tolerance "
            f"{tolerance:.2g}: " + _advice(best, formulation, samples)
        )
    return best


def resolving_steps(
    solver: Solver,
    decided: Decided,
    states: np.ndarray,
    horizon: float,
    tolerance: float,
    smooth: np.ndarray,
) -> tuple[int, float]:
    """Return the fewest steps of `STEP_LADDER` that resolve gradients and decide the symbols.

    Gradients: the 99th percentile, over as many of the states (B, n) as `smooth` has, of the
    difference that twice the steps make to the mode insertion gradients, relative to their scales,
    is at most `tolerance`. It is infinite for states that only more steps make finite, and for
    those whose cost changes by more than a tenth: steps that are too long for a stiff model may
    agree on garbage. Of states that are not `smooth`, whose prediction meets a kink, it counts
    `KINKED`.

    Symbols: `FINER` times the steps change those of next to no state off ties. This sees what
    decides beside the gradients, such as J0 in eq. (8), and what kinks do.

    The second result is the error that remains, `tolerance` where `CHANGED` states change.
    """
    samples = states[: len(smooth)]
    solve = functools.cache(lambda steps: solver(samples, horizon, steps))

    def error_of(steps: int) -> float:
        (coarse_cost, coarse, _), (cost, fine, scale) = solve(steps), solve(2 * steps)
        with np.errstate(all="ignore"):
            errors = np.abs(coarse - fine) / scale
            errors[~np.isfinite(errors)] = np.nan
            usual = np.median(np.abs(cost[np.isfinite(cost)])) if np.isfinite(cost).any() else 0
            errors[np.abs(coarse_cost - cost) > UNRESOLVED * (np.abs(cost) + usual)] = np.inf
            failed = ~(np.isfinite(coarse) & np.isfinite(fine) & np.isfinite(scale))
            if failed.all():
                return np.inf
            if failed.any():
                failed &= np.isfinite(solve(2 * STEP_LADDER[-1])[1])
                errors[failed] = np.inf
            errors[~smooth] *= KINKED
        error = _percentile(errors)
        return error if error > tolerance else max(error, tolerance * changed(steps))

    def changed(steps: int) -> float:
        """Return the states whose symbol finer steps change, as a share of those allowed."""
        some = states[: max(len(samples), min(len(states), WORK // steps))]
        own, finer = (decided(solver(some, horizon, k)) for k in (steps, FINER * steps + 1))
        other = ~last_any((own & finer) != 0) & last_any(finer != 0) & ~several(finer)
        return float(other.sum() / CHANGED)

    return fewest_steps(STEP_LADDER, error_of, tolerance, TRIED)


def _percentile(errors: np.ndarray) -> float:
    """Return the 99th percentile of errors that are not NaN."""
    errors = errors[~np.isnan(errors)]
    if not errors.size:
        return 0.0
    with np.errstate(invalid="ignore"):  # infinite ones
        return float(np.percentile(errors, 99))


def _smooth(bound: Model, states: np.ndarray, horizon: float) -> np.ndarray:
    """Return which states (B, n) have a prediction that meets no kink of dynamics or cost."""
    conditions, dt = kink_conditions(bound.step), [horizon / NODES]
    if not conditions.used_inputs():
        return np.ones(len(states), dtype=bool)
    path = [np.ascontiguousarray(states.T)]
    with np.errstate(all="ignore"):
        for _ in range(NODES - 1):
            path.append(bound.step.evaluate(path[-1], dt)[0])
        (sides,) = conditions.evaluate(np.concatenate(path, axis=1), dt)
    sides = sides.reshape(len(sides), NODES, len(states))
    return np.asarray((sides == sides[:, :1]).all(axis=(0, 1)))


def _advice(steps: int, formulation: Formulation, states: np.ndarray) -> str:
    """Return what a user can do where so many steps are not enough."""
    if stiff := _stiffness(formulation, states):
        return stiff
    if steps == STEP_LADDER[-1]:
        return (
            "shorten the horizon, or give `steps` (--steps) where the model has switches such as "
            "fmax or if_else"
        )
    return "give `steps` or a larger `tolerance`"


def _stiffness(formulation: Formulation, states: np.ndarray) -> str:
    """Return why a model needs many steps and what to do, if it is stiff; else an empty text.

    How fast states decay tell eigenvalues of the Jacobian under the default control, in the
    fastest tenth of states (B, n).
    """
    rates = bind(formulation.model.dynamics, u=formulation.default)
    widths = formulation.domain.widths
    with np.errstate(all="ignore"):
        columns = []
        for axis, width in enumerate(widths):
            move = np.zeros((len(widths), 1))
            move[axis] = 1e-6 * width
            ends = (rates.evaluate(states.T + side)[0] for side in (move, -move))
            columns.append((next(ends) - next(ends)) / (2 * move[axis]))
    jacobians = np.moveaxis(np.stack(columns, axis=1), 2, 0)  # (B, n, n)
    jacobians = jacobians[np.isfinite(jacobians).all(axis=(1, 2))]
    if not len(jacobians):
        return ""
    fastest = float(np.percentile(-np.linalg.eigvals(jacobians).real.min(axis=1), 90))
    stable = fastest * formulation.horizon / STABLE
    if stable < STIFF:
        return ""
    return (
        f"the model is stiff: a state decays at {fastest:.3g} per unit of time, so that "
        f"{stable:,.0f} steps or more are stable; shorten the horizon, or replace fast states by "
        "the values at which they settle"
    )
