"""A first look at candidates: mode insertion gradients of all of them, and a greedy choice."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import bind_default, make_solver
from capsyn.controllers.ssac import batch_controller
from capsyn.modelling.problem import Problem
from capsyn.modelling.transcription import candidate_insertion, transcribe
from capsyn.programs import program
from capsyn.programs.builder import bind, selected
from capsyn.programs.model import Model
from capsyn.programs.program import Program

BLOCK = 1 << 14
"""Pairs of states and candidates that are worked on at once, so that they stay in the cache."""


def is_affine(model: Model) -> bool:
    """Return whether the dynamics are affine in the inputs, as far as their operations show."""
    return program.is_affine(model.dynamics, "u")


def candidate_gradients(
    problem: Problem, values: np.ndarray, states: np.ndarray, backend: str = "auto"
) -> np.ndarray:
    """Return the mode insertion gradients (B, K) of candidates (K, m) at readings (B, n), eq. (6).

    Each is ``rho . (f(x, v) - f(x, u))`` with the adjoint at t0 of the prediction under the default
    control u [cost / time unit]; of a map that of first order, with the adjoint after one sample
    [cost]. All candidates share one forward and one adjoint pass. Where f is affine in its inputs
    the gradients of m + 1 controls give those of all.
    """
    model = transcribe(problem)
    rho = _adjoints(problem, model, states, backend)
    insertion = selected(candidate_insertion(problem).first, [0])
    if not problem.has_law:
        insertion = bind(insertion, u=problem.default_control)
    if not is_affine(model):
        return _inserted(insertion, states, rho, values)
    base = problem.default_control
    sizes = np.abs(values - base).max(axis=0)
    sizes[sizes == 0] = 1.0
    some = _inserted(insertion, states, rho, np.vstack([base, base + np.diag(sizes)]))
    slopes = some[:, 1:] - some[:, :1]
    with np.errstate(all="ignore"):
        gradients = slopes @ ((values - base) / sizes).T
        gradients += some[:, :1]
    return np.asarray(gradients)


def candidate_gains(
    problem: Problem, values: np.ndarray, states: np.ndarray, backend: str = "auto"
) -> np.ndarray:
    """Return what candidates gain (B, K): ``max(0, -(dJ_dlam + |v|_R^2))`` [cost / time unit].

    It is 0 where the gradient is not finite. See `candidate_gradients`.
    """
    gains = candidate_gradients(problem, values, states, backend)
    gains += problem.settings.efforts(values)
    np.negative(gains, out=gains)
    gains[~(gains > 0) | np.isinf(gains)] = 0.0
    return gains


def greedy(gains: np.ndarray, count: int, keep: Sequence[int] = ()) -> np.ndarray:
    """Return at most `count` candidates, those to `keep` first, each the one that then adds most.

    What a set gains is the mean over states of its best gain, ``gains`` (B, K) >= 0. As that is
    submodular, it is at least ``1 - 1/e`` of the most that any set as large gains [1]_. Ties go to
    the lowest index; what adds nothing is left out. It is a first look, and no alphabet for a
    loop: it takes the strongest candidates, between which loops chatter.

    References
    ----------
    .. [1] Nemhauser, Wolsey, Fisher, "An analysis of approximations for maximizing submodular set
       functions", Mathematical Programming 14, 1978.
    """
    chosen = list(dict.fromkeys(keep))
    columns = np.ascontiguousarray(gains.T)
    best = columns[chosen].max(axis=0, initial=0.0)
    bounds = np.full(len(columns), np.inf)  # of what each adds, which falls as the set grows
    bounds[chosen] = -1.0
    while len(chosen) < min(count, len(columns)):
        added, at = 0.0, -1
        for k in np.argsort(-bounds, kind="stable"):
            if bounds[k] < added or bounds[k] <= 0:
                break
            bounds[k] = np.maximum(columns[k] - best, 0.0).sum()
            if bounds[k] > added or (bounds[k] == added > 0 and k < at):
                added, at = float(bounds[k]), int(k)
        if at < 0:
            break
        chosen.append(at)
        best = np.maximum(best, columns[at])
        bounds[at] = -1.0
    return np.array(chosen, dtype=np.int64)


def _adjoints(problem: Problem, model: Model, states: np.ndarray, backend: str) -> np.ndarray:
    """Return the adjoints (B, n) at t0 of predictions under the default control.

    They are those that `Model.insertion` gets, from the solver of symbols.
    """
    n = problem.space.n
    bound = bind_default(model, problem.default_control)
    ports = (("x", n), ("rho", n), ("cost", 1), ("rounding", 1))
    own = tuple(range(n, 2 * n))
    handed = Program("insertion", ports, (("gradients", n), ("scales", n)), (), own + own)
    bound = dataclasses.replace(bound, insertion=handed)
    settings, steps = problem.settings, problem.settings.steps
    if problem.discrete:
        steps = round(problem.horizon)
    elif steps is None:
        steps = batch_controller(Formulation.of(problem, model), backend).settings.steps
    assert steps is not None
    solve, _ = make_solver(bound, settings.precision, backend)
    return solve(states, problem.horizon, steps)[1]


def _inserted(
    insertion: Program, states: np.ndarray, rho: np.ndarray, values: np.ndarray
) -> np.ndarray:
    """Return the gradients (B, K) of candidates (K, m) at readings and adjoints (B, n)."""
    gradients = np.empty((len(states), len(values)))
    controls = values.T[:, None]
    rows = max(1, BLOCK // len(values))
    for k in range(0, len(states), rows):
        some = slice(k, k + rows)
        ((gradients[some],),) = insertion.evaluate(
            states[some].T[:, :, None], rho[some].T[:, :, None], [0.0], [0.0], controls
        )
    return gradients
