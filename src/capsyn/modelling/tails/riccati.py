"""A tail from the linearisation at the goal: the cost to go of a linear-quadratic regulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.exogenous import joined
from capsyn.modelling.tails.equilibrium import System, cheapest_rest, mixture, rates
from capsyn.modelling.tails.tail import Tail
from capsyn.modelling.targets import target_axes
from capsyn.validation import (
    called,
    describe,
    finite_array,
    finite_number,
    one_line,
    read_only,
)

FIT = "fit"
"""What a tail is called that `synthesize` fits to what closed loops cost."""
NO_RUNNING_COST = "`tail` needs a `running_cost`, whose cost to go it is; there is none"
SMALL = 1e-8
"""What counts as zero, relative to what it is a part of."""
AFFINE = 1e-5
"""Largest distance of the goal from an affine function of exogenous inputs, in widths."""
SAMPLES = 16
"""Random exogenous inputs at which it is checked that the goal is affine in them."""


def riccati_tail(problem: System, effort: float = 1.0, goal: Any = None) -> Tail:
    """Return a terminal cost that stands for the cost to go near a goal, by a Riccati equation.

    The cost to go is the cost of the rest of a run. P solves ``A^T P + P A - P S P / r + Q = 0``.
    ``A`` is the mean of df/dx over the mixture of symbols that holds the goal. Q is half of the
    running cost's second derivatives. ``S`` is the mean over the symbols of ``f_i f_i^T``, with the
    rates ``f_i`` at the goal. The terminal cost is ``(x - goal)^T P (x - goal)``, the cost to go of
    a linear system whose inputs are the shares of the symbols. For inputs that are each at one of
    two values, s from their mean, these inputs have the effort ``r du_i^2 / s^2``. P does not
    depend on the units of the inputs. P depends on the unit of the cost only by its own unit. For
    a discrete-time problem, P solves the equation of discrete time, and ``f_i`` is
    ``F(x, u_i) - x``.

    Parameters
    ----------
    problem : Problem
        The system, its running cost and its alphabet.
    effort : float
        Weight of the inputs, > 0. ``r = effort trace(Q W^2) / 10``, where the diagonal W has half
        the domain's widths. For effort 1, r is a tenth of what the states cost far out. A small
        effort makes a tail that hurries.
    goal : (n,), or callable ``w -> n components``, optional
        The goal [state units]. Default: the centre of the problem's target, if the target is a ball
        or box. States without a target take the state of least running cost among the states where
        the system can rest, as an affine function of the exogenous inputs.

    Raises
    ------
    ProblemError
        There is no running cost. Or no mixture of the symbols holds the system at the goal. Or the
        second derivatives are not positive semidefinite. Or no input stabilises the linearisation.
        Or the linearisation has motion that does not decay and costs nothing.
    """
    effort = finite_number("effort", effort, above=0.0)
    if problem.running_cost is None:
        raise ProblemError(NO_RUNNING_COST)
    domain = problem.domain
    goal = goal_of(problem, goal)
    place, w, shares = rest_at(problem, goal)
    half = domain.widths / 2
    a, q = _linearised(problem, np.concatenate([place, w]), shares)
    a, q = a * half / half[:, None], q * np.outer(half, half)
    moves = rates(problem, place, w) / half
    r = effort * np.trace(q) / 10
    if problem.discrete:
        p, horizon = _solution_of_map(a + np.eye(domain.n), _inputs(moves), q, r)
    else:
        p, horizon = _solution(a, _inputs(moves), q, r)
    return Tail(
        matrix=read_only(p / np.outer(half, half)),
        goal=goal,
        control=read_only(shares @ problem.alphabet.values),
        effort=effort,
        horizon=horizon,
        periods=read_only(domain.periods),
    )


def tail_effort(text: Any) -> float | None:
    """Return the effort that ``"riccati"`` or ``"riccati:EFFORT"`` means; None of ``"fit"``.

    Something else is a `ProblemError`.
    """
    if isinstance(text, str) and text == FIT:
        return None
    kind, colon, number = text.partition(":") if isinstance(text, str) else ("", "", "")
    if kind != "riccati":
        raise ProblemError(
            f"`tail` must be 'riccati', 'riccati:EFFORT', 'fit' or a function; got {describe(text)}"
        )
    try:
        effort = float(number) if colon else 1.0
    except ValueError:
        effort = np.nan
    if not 0 < effort < np.inf:
        raise ProblemError(f"`tail` must have an effort > 0; got {describe(text)}")
    return effort


def rest_at(problem: System, goal: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a goal (n,), the exogenous inputs (k,) there, and shares (N,) of symbols that hold it.

    The inputs are those in the middle of their box. Where no mixture holds it: a `ProblemError`.
    """
    domain, told = problem.domain, problem.exogenous
    w = np.empty(0) if told is None else (told.lower + told.upper) / 2
    place = np.array([float(value) for value in goal(w)]) if callable(goal) else goal
    shares = mixture(problem, place, w)
    if shares is None:
        parts = ", ".join(f"{name} = {v:g}" for name, v in zip(domain.names, place))
        raise ProblemError(
            "`tail` must have a goal where the system can rest: no mixture of the symbols holds "
            + parts
        )
    return place, w, shares


def goal_of(problem: System, goal: Any) -> Any:
    """Return the goal (n,), or as a function of exogenous inputs; see `riccati_tail`."""
    domain, told = problem.domain, problem.exogenous
    if callable(goal):
        if told is None:
            raise ProblemError("`goal` must be numbers where there are no exogenous inputs")
        _checked(called("goal", goal, (told.lower + told.upper) / 2), domain)
        return goal
    if goal is not None:
        return _checked(goal, domain)
    known: dict[int, float] = {}
    if isinstance(problem.target, (Ball, Box)):
        target = problem.target
        middle = target.center if isinstance(target, Ball) else (target.lower + target.upper) / 2
        axes = target_axes(target, joined(domain, told))
        known = {axis: float(v) for axis, v in zip(axes, middle) if axis < domain.n}
    if len(known) == domain.n:
        return _checked([known[axis] for axis in range(domain.n)], domain)
    if told is None:
        return read_only(cheapest_rest(problem, known, np.empty(0)))
    points = told.sample(max(SAMPLES, 2 * told.n), 0)
    first = cheapest_rest(problem, known, (told.lower + told.upper) / 2)
    places = np.array([cheapest_rest(problem, known, w, first) for w in points])
    rows = np.column_stack([np.ones(len(points)), (points - told.lower) / told.widths])
    factors = np.linalg.lstsq(rows, places, rcond=None)[0]
    off = np.abs(rows @ factors - places) / domain.widths
    if off.max() > AFFINE:
        name = domain.names[int(off.max(axis=0).argmax())]
        raise ProblemError(
            f"`tail` needs its `goal` as a function of w: the place to rest is no affine one, in "
            f"'{name}'"
        )
    factors = np.where(np.abs(factors) < AFFINE * domain.widths, 0.0, factors)
    slopes = factors[1:] / told.widths[:, None]
    return _Affine(factors[0] - told.lower @ slopes, slopes)


@dataclass(frozen=True, eq=False)
class _Affine:
    """A goal that is an affine function of the exogenous inputs."""

    start: np.ndarray
    slopes: np.ndarray

    def __call__(self, w: Any) -> list[Any]:
        """Return the components of the goal at w (k,)."""
        return [
            float(first) + sum(float(s) * w[j] for j, s in enumerate(column) if s)
            for first, column in zip(self.start, self.slopes.T)
        ]


def _checked(goal: Any, domain: Box) -> np.ndarray:
    """Return a goal (n,) in the domain."""
    values = finite_array("goal", goal, 1)
    if len(values) != domain.n or not domain.contains(values[None])[0]:
        raise ProblemError(
            f"`goal` must be a state of the domain, {domain.n} number(s); got {describe(goal)}"
        )
    return values


def _linearised(
    problem: System, z: np.ndarray, shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of df/dx over a mixture, and half of the running cost's second derivatives.

    Both are (n, n), at a reading z.
    """
    functions, n = problem.system(), problem.domain.n
    change = functions["motion"].jacobian()
    used = [(s, u) for s, u in zip(shares, problem.alphabet.values) if s]
    a = sum(s * np.array(change(z, u, 0)[0])[:n, :n] for s, u in used)
    second = functions["running_cost"].jacobian().jacobian()
    q = np.array(second(z, 0, 0)[0])[:n, :n] / 2
    if not np.isfinite(a).all() or not np.isfinite(q).all():
        raise ProblemError(
            "`tail` must have a goal where dynamics and running cost are smooth; derivatives there "
            "are not finite"
        )
    return a, q


def _inputs(moves: np.ndarray) -> np.ndarray:
    """Return ``b`` whose ``b b^T`` is the mean of ``f f^T`` over motions f (N, n)."""
    _, size, axes = np.linalg.svd(moves / np.sqrt(len(moves)), full_matrices=False)
    return np.asarray(axes.T * size)


def _solution(a: np.ndarray, b: np.ndarray, q: np.ndarray, r: float) -> tuple[np.ndarray, float]:
    """Return P (n, n), in scaled states, and the proposed horizon [time unit]; checked.

    That is half of the shortest time constant of the closed loop.
    """
    from scipy.linalg import solve_continuous_are

    scale = max(np.abs(a).max(), np.abs(b).max())
    _check_modes(a, b, q, scale, lambda mode: mode.real / scale, "exp({:.3g} t)")
    p = _symmetric(lambda: solve_continuous_are(a, b, q, r * np.eye(b.shape[1])))
    loop = a - b @ b.T @ p / r
    return p, float(f"{0.5 / np.abs(np.linalg.eigvals(loop)).max():.2g}")


def _solution_of_map(
    a: np.ndarray, b: np.ndarray, q: np.ndarray, r: float
) -> tuple[np.ndarray, float]:
    """Return P (n, n) of a map ``x+ = a x + b v``, and the proposed horizon in samples, 1 or more.

    That is half of the shortest time constant of the closed loop, too.
    """
    from scipy.linalg import solve_discrete_are

    scale = max(np.abs(a).max(), np.abs(b).max(), 1.0)
    _check_modes(a, b, q, scale, lambda mode: abs(mode) - 1, "({:.3g})^k")
    weight = r * np.eye(b.shape[1])
    p = _symmetric(lambda: solve_discrete_are(a, b, q, weight))
    loop = a - b @ np.linalg.solve(weight + b.T @ p @ b, b.T @ p @ a)
    fastest = np.abs(np.linalg.eigvals(loop)).min()
    return p, float(max(1, round(-0.5 / np.log(fastest)))) if 0 < fastest < 1 else 1.0


def _check_modes(
    a: np.ndarray,
    b: np.ndarray,
    q: np.ndarray,
    scale: float,
    growth: Callable[[complex], float],
    text: str,
) -> None:
    """Raise unless there is a solution; modes of growth below 0 decay, and all move as `text`."""
    least = np.linalg.eigvalsh(q)[0]
    if not np.trace(q) > 0 or least < -SMALL * np.trace(q):
        raise ProblemError(
            "`tail` needs a running cost that has its least value at the goal: its second "
            f"derivatives there must be positive semidefinite and not 0; least eigenvalue {least:g}"
        )
    for mode in np.linalg.eigvals(a):
        shifted = a - mode * np.eye(len(a))
        if growth(mode) > -SMALL and _deficient(np.hstack([shifted, b]), scale):
            raise ProblemError(
                "`tail` needs a goal that the symbols stabilise: what moves there as "
                f"{text.format(mode)} no symbol changes"
            )
        weighed = np.vstack([shifted, q / np.trace(q) * scale])
        if abs(growth(mode)) <= SMALL and _deficient(weighed, scale):
            raise ProblemError(
                "`tail` needs a running cost of all that does not decay: what moves at the goal as "
                f"{text.format(mode)} costs nothing"
            )


def _symmetric(solve: Callable[[], np.ndarray]) -> np.ndarray:
    """Return the solution of a Riccati equation, symmetric; `ProblemError` where there is none."""
    from scipy.linalg import LinAlgError

    try:
        p = solve()
    except (LinAlgError, ValueError) as error:
        raise ProblemError(f"`tail` has no Riccati solution: {one_line(str(error))}") from error
    return np.asarray((p + p.T) / 2)


def _deficient(matrix: np.ndarray, scale: float) -> bool:
    """Return whether a matrix has not full rank."""
    return bool(np.linalg.svd(matrix, compute_uv=False)[-1] <= SMALL * scale)
