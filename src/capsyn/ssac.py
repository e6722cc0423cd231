"""Switched sequential action control (Section III of the paper), for batches of states."""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.domain import Box
from capsyn.errors import CapsynWarning, KernelBuildError
from capsyn.masks import preferred
from capsyn.model import Model
from capsyn.policy import Policy
from capsyn.program_builder import bind
from capsyn.settings import SsacSettings
from capsyn.validation import BACKENDS, one_of

TIE = 1e-5
"""Perturbation of mode insertion gradients, relative to their scales, that makes symbols tie."""
BLOCK = 2048
"""States that the NumPy backend handles at once, so that its buffers stay in the CPU's cache."""
ROUNDING = 64
"""Units of the last place by which quantities that should vanish may differ from 0."""
STEP_LADDER = tuple(steps << k for k in range(10) for steps in (4, 6)) + (4096,)
"""Steps that `choose_steps` tries."""
STEP_SAMPLES = 512
"""Random states at which it tries them."""
FALLING, STALLS = 0.7, 3
"""An error falls where it is below this share of the least so far; so many in a row that do not
end a search for steps."""
UNRESOLVED = 0.1
"""Errors of step doubling, in gradients or costs, that are too large to tell if they will fall."""

Solver = Callable[[np.ndarray, float, int], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Solution:
    """Steps 1 and 2 of sSAC at t0 for B states and N symbols.

    Parameters
    ----------
    cost : (B,)
        Cost ``J0`` of the default prediction, eq. (3).
    gradients : (B, N)
        Mode insertion gradients ``dJ/dlambda+`` at t0, eq. (6) [cost / s].
    scales : (B, N)
        Largest size each gradient could have given the adjoint and the change of dynamics.
    """

    cost: np.ndarray
    gradients: np.ndarray
    scales: np.ndarray


@dataclass(frozen=True, eq=False)
class BatchController:
    """sSAC for batches of states: one forward and one adjoint pass each.

    Build it with `batch_controller`.

    Parameters
    ----------
    solver : callable
        ``(states, horizon, steps) -> (cost, gradients, scales)``, safe to call from threads.
    backend : "c" or "numpy"
        What the solver is.
    horizon : float
        Prediction horizon T [s].
    efforts : (N,)
        Control efforts ``u^T R u`` of the symbols.
    settings : SsacSettings
        Options, with `steps` given.
    preference : N + 1 ints
        Symbols (N for the default) by least control effort, then by lowest index.
    """

    solver: Solver
    backend: str
    horizon: float
    efforts: np.ndarray
    settings: SsacSettings
    preference: tuple[int, ...]

    def solve(self, states: np.ndarray) -> Solution:
        """Return costs and mode insertion gradients of states (B, n)."""
        assert self.settings.steps is not None
        return Solution(*self.solver(states, self.horizon, self.settings.steps))

    def scores(self, solution: Solution) -> np.ndarray:
        """Return what each symbol scores (B, N), eq. (8) or the steepest rule; least is best."""
        distance = solution.gradients
        if self.settings.rule == "schedule":
            with np.errstate(invalid="ignore", over="ignore"):
                distance = (distance - self._wanted(solution)) ** 2
        return distance + self.efforts

    def symbols(self, states: np.ndarray) -> np.ndarray:
        """Return the symbols (B,) that sSAC applies at t0; see `masks` and `chosen`."""
        return self.chosen(self.masks(states))

    def chosen(self, masks: np.ndarray) -> np.ndarray:
        """Return the symbols (B,) of masks (B,); -1 is the default control.

        Ties go as in a policy, by `preference`. States without a finite result get the default.
        """
        best = preferred(masks, self.preference)
        best[(masks == 0) | (best == len(self.efforts))] = -1
        return best

    def masks(self, states: np.ndarray) -> np.ndarray:
        """Return the symbols that could be best as bit masks (B,), 0 without a finite result.

        A symbol could be best when it is for some perturbation of each mode insertion gradient
        by at most `TIE` of its scale. Bit N stands for the default control.
        """
        return self.possible(self.solve(states))

    def scored(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `masks` (B,) and, of the same solves, `smooth_scores` of states (B, n)."""
        solution = self.solve(states)
        return self.possible(solution), self.smooth_scores(solution)

    def smooth_scores(self, solution: Solution) -> np.ndarray:
        """Return scores (B, V, N) as affine in the state as can be, in V variants.

        The largest of the first variant is best. Steepest rule: ``-dJ_dlam - |u|_R^2``. Eq. (8)
        grows with the fourth power of the state where costs are quadratic; without ``alpha_d^2``,
        which all symbols share, it is ``dJ_dlam (dJ_dlam - 2 alpha_d) + |u|_R^2``. The first
        variant is minus this over ``2 (alpha_d^2 + mean(dJ_dlam^2))^(1/2)``. The second leaves the
        square out, so that what is left, over ``2 |alpha_d|``, is ``dJ_dlam`` and the effort: it
        orders two symbols alike wherever the mean of their ``dJ_dlam`` exceeds ``alpha_d``, and
        has slopes where J0, and with it alpha_d, vanishes. With ``on_no_descent="default"`` the
        default's comes last, (B, V, N + 1): the best score plus that symbol's ``dJ_dlam``.
        """
        gradients = solution.gradients
        with np.errstate(all="ignore"):
            if self.settings.rule == "steepest":
                scores = (-gradients - self.efforts)[:, None]
            else:
                wanted, extra = self._wanted(solution), self.efforts - self.efforts.min()
                size = 2 * np.sqrt(wanted**2 + (gradients**2).mean(axis=1, keepdims=True))
                squares = (2 * wanted - gradients) * gradients - extra
                first = np.where(size > 0, squares / size, -extra)
                price = np.where(extra > 0, extra / (2 * np.abs(wanted)), 0.0)
                finite = np.isfinite(price).all(axis=1, keepdims=True)
                second = np.where(finite, -gradients - price, first)
                scores = np.stack([first, second], axis=1)
            if self.settings.on_no_descent == "default":
                best = scores[:, :1].argmax(axis=2)[:, :, None]
                slope = np.take_along_axis(gradients[:, None], best, axis=2)
                default = scores.max(axis=2, keepdims=True) + slope
                # symbols that are the default itself must not tie with it
                same = (solution.scales == 0)[:, None]
                low, high = scores.min(axis=2, keepdims=True), scores.max(axis=2, keepdims=True)
                scores = np.where(same, 2 * low - high, scores)
                scores = np.concatenate([scores, default], axis=2)
        return scores

    def possible(self, solution: Solution) -> np.ndarray:
        """Return the masks (B,) of solved states; see `masks`."""
        low, high = self._bounds(solution)
        least = high.min(axis=1)
        could = low <= least[:, None]
        n = could.shape[1]
        margin = TIE * solution.scales
        default = np.zeros(len(could), dtype=bool)
        if self.settings.on_no_descent == "default":
            with np.errstate(invalid="ignore"):
                default = (could & (solution.gradients + margin >= 0)).any(axis=1)
                could &= solution.gradients - margin < 0
        masks = default.astype(np.uint64) << np.uint64(n)
        for i in range(n):
            masks |= could[:, i].astype(np.uint64) << np.uint64(i)
        masks[~np.isfinite(high).all(axis=1)] = 0
        return masks

    def _wanted(self, solution: Solution) -> np.ndarray:
        """Return ``alpha_d`` (B, 1)."""
        return self.settings.wanted_sensitivity(solution.cost)[:, None]

    def _bounds(self, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and greatest scores (B, N) under the perturbations of a tie.

        The greatest is finite only where cost, gradient and scale are: the scale holds the cost.
        """
        margin = TIE * solution.scales
        with np.errstate(invalid="ignore", over="ignore"):
            if self.settings.rule == "steepest":
                low, high = solution.gradients - margin, solution.gradients + margin
            else:
                distance = np.abs(solution.gradients - self._wanted(solution))
                low = np.maximum(distance - margin, 0.0) ** 2
                high = (distance + margin) ** 2
            return low + self.efforts, high + self.efforts


def batch_controller(
    model: Model,
    domain: Box,
    values: np.ndarray,
    default: np.ndarray,
    horizon: float,
    settings: SsacSettings,
    backend: str = "auto",
    seed: int = 0,
) -> BatchController:
    """Return the controller of a model, with its kernel built and its steps chosen.

    Parameters
    ----------
    model : Model
        The system.
    domain : Box
        Where the states of the step-doubling check are drawn from.
    values : (N, m)
        The symbols' control vectors [input units].
    default : (m,)
        Control of the prediction [input units].
    horizon : float
        Prediction horizon T [s].
    settings : SsacSettings
        Options; steps that are not given are chosen by `choose_steps`.
    backend : "auto", "c" or "numpy"
        ``"auto"`` takes C where there is a working compiler, else NumPy with a warning.
    seed : int
        Seed of the sample states.

    Raises
    ------
    KernelBuildError
        ``backend="c"`` and the kernel cannot be built.
    """
    bound = bind_default(model, default)
    solver, used = make_solver(bound, settings.precision, backend)
    if settings.steps is None:
        steps = choose_steps(solver, domain.sample(STEP_SAMPLES, seed), horizon, settings)
        settings = dataclasses.replace(settings, steps=steps)
    efforts = settings.efforts(np.vstack([values, default]))
    preference = tuple(int(k) for k in np.argsort(efforts, kind="stable"))
    return BatchController(solver, used, horizon, efforts[:-1], settings, preference)


def policy_controller(policy: Policy, backend: str = "auto") -> BatchController | None:
    """Return the controller that a policy came from, or None where it does not carry it."""
    if policy.model is None or policy.horizon is None or policy.settings is None:
        return None
    return batch_controller(
        policy.model,
        policy.domain,
        policy.alphabet.values,
        policy.default,
        policy.horizon,
        policy.settings,
        backend,
    )


def bind_default(model: Model, default: np.ndarray) -> Model:
    """Return the model with its control fixed where the prediction uses it."""
    return dataclasses.replace(
        model,
        step=bind(model.step, u=default),
        adjoint=bind(model.adjoint, u=default),
        insertion=bind(model.insertion, u=default),
    )


def make_solver(model: Model, precision: str, backend: str) -> tuple[Solver, str]:
    """Return a solver of a model whose control is bound, and its backend, "c" or "numpy"."""
    one_of("backend", backend, BACKENDS)
    dtype = np.float32 if precision == "single" else np.float64
    rounding = relative_rounding(dtype)
    if backend != "numpy":
        from capsyn.native.kernels import SsacKernel

        try:
            return SsacKernel.build(model, precision, rounding), "c"
        except KernelBuildError as error:
            if backend == "c":
                raise
            warnings.warn(f"solving with NumPy: {error}", CapsynWarning, stacklevel=5)
    return NumpySolver(model, dtype, rounding), "numpy"


def relative_rounding(dtype: Any) -> float:
    """Return the input `rounding` of ``Model.insertion`` for an arithmetic."""
    return float(ROUNDING * np.finfo(dtype).eps / TIE)


@dataclass(frozen=True)
class NumpySolver:
    """The same computation as the compiled kernel, by NumPy on blocks of states."""

    model: Model
    dtype: type[np.floating]
    rounding: float

    def __call__(
        self, states: np.ndarray, horizon: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (cost (B,), gradients (B, N), scales (B, N)) of states (B, n)."""
        parts = [
            self._block(states[k : k + BLOCK], horizon, steps)
            for k in range(0, max(len(states), 1), BLOCK)
        ]
        cost, gradients, scales = zip(*parts)
        return np.concatenate(cost), np.concatenate(gradients), np.concatenate(scales)

    def _block(
        self, states: np.ndarray, horizon: float, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        model, dtype = self.model, self.dtype
        dt = [horizon / steps]
        total = np.zeros(len(states), dtype)
        with np.errstate(all="ignore"):
            path = [np.ascontiguousarray(states.T, dtype)]
            for _ in range(steps):
                state, cost = model.step.evaluate(path[-1], dt, dtype=dtype)
                path.append(state)
                total += cost[0]
            cost, rho = model.terminal_cost.evaluate(path[-1], dtype=dtype)
            total += cost[0]
            for state in reversed(path[:-1]):
                (rho,) = model.adjoint.evaluate(state, dt, rho, dtype=dtype)
            gradients, scales = model.insertion.evaluate(
                path[0], rho, total[None, :], [self.rounding], dtype=dtype
            )
        return total.astype(float), gradients.T.astype(float), scales.T.astype(float)


def choose_steps(solver: Solver, states: np.ndarray, horizon: float, settings: SsacSettings) -> int:
    """Return the fewest steps of `STEP_LADDER` whose error meets ``settings.tolerance``.

    The error is the 99th percentile, over the states (B, n), of the difference that twice the
    steps make to the mode insertion gradients, relative to their scales. It is infinite for states
    that only more steps make finite, and for those whose cost changes by more than a tenth:
    steps that are too long for a stiff model may agree on garbage. Where it stops falling first (a
    switch in the dynamics, single precision), the best steps so far are returned with a warning.
    """
    solve = functools.cache(lambda steps: solver(states, horizon, steps))

    def error_of(steps: int) -> float:
        (coarse_cost, coarse, _), (cost, fine, scale) = solve(steps), solve(2 * steps)
        with np.errstate(all="ignore"):
            errors = np.abs(coarse - fine) / scale
            errors[~np.isfinite(errors)] = np.nan
            usual = np.median(np.abs(cost[np.isfinite(cost)])) if np.isfinite(cost).any() else 0
            errors[np.abs(coarse_cost - cost) > UNRESOLVED * (np.abs(cost) + usual)] = np.inf
            failed = ~(np.isfinite(coarse) & np.isfinite(fine) & np.isfinite(scale))
            if failed.any():
                failed &= np.isfinite(solve(2 * STEP_LADDER[-1])[1])
                errors[failed] = np.inf
            errors = errors[~np.isnan(errors)]
            return float(np.percentile(errors, 99)) if errors.size else 0.0

    best, least = fewest_steps(STEP_LADDER, error_of, settings.tolerance)
    if least <= settings.tolerance:
        return best
    advice = "give `steps` or a larger `tolerance`"
    if best == STEP_LADDER[-1]:
        advice = (
            "shorten the horizon, or give `steps` (--steps) where the model has switches such as "
            "fmax or if_else"
        )
    warnings.warn(
        f"the step-doubling check reached {least:.2g} with {best} steps, not the tolerance "
        f"{settings.tolerance:.2g}: {advice}",
        CapsynWarning,
        stacklevel=5,
    )
    return best


def fewest_steps(
    ladder: Sequence[int], error_of: Callable[[int], float], tolerance: float
) -> tuple[int, float]:
    """Return the first steps of a ladder whose error meets a tolerance, and the error.

    Where it stops falling first, they are the best so far; a NaN counts as infinite.
    """
    best, least, stalled = ladder[0], np.inf, 0
    for steps in ladder:
        error = error_of(steps)
        error = np.inf if np.isnan(error) else error
        if error <= tolerance:
            return steps, error
        stalled = 0 if error < FALLING * least or error > UNRESOLVED else stalled + 1
        if error <= least or least > UNRESOLVED:  # unstable steps may agree on garbage
            best, least = steps, error
        if stalled == STALLS:
            break
    return best, least
