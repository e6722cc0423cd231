"""Switched sequential action control (Section III of the paper), for batches of states."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from capsyn.cells.masks import empty, masks_of_members, preferred, priced_sets, word_count
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.one_step import one_step_solver
from capsyn.controllers.solver import TIE, Solver, bind_default, make_solver
from capsyn.controllers.steps import choose_steps
from capsyn.modelling.settings import SsacSettings
from capsyn.policies.policy import Policy
from capsyn.programs.builder import bind

DELAY_STEPS = 4
"""Least Runge-Kutta steps over a delay."""


@dataclass(frozen=True)
class Solution:
    """Steps 1 and 2 of sSAC at t0 for B states and N symbols."""

    cost: np.ndarray  # (B,): ``J0`` of the default prediction, eq. (3)
    gradients: np.ndarray  # (B, N): ``dJ/dlambda+`` at t0, eq. (6) [cost / time unit]; of a map
    # what one sample changes [cost]
    scales: np.ndarray  # (B, N): largest sizes, given the adjoint and the change of dynamics


@dataclass(frozen=True, eq=False)
class BatchController:
    """sSAC for batches of states: one forward and one adjoint pass each.

    Build it with `batch_controller`.
    """

    solver: Solver  # safe to call from threads
    backend: str  # of the solver: c or numpy
    formulation: Formulation  # its settings with `steps`
    efforts: np.ndarray  # (N,): control efforts ``u^T R u``
    preference: tuple[int, ...]  # N for the default; by least control effort, then by lowest index

    @property
    def settings(self) -> SsacSettings:
        """Options, with `steps` given."""
        return self.formulation.settings

    @property
    def horizon(self) -> float:
        """Prediction horizon T [time unit]."""
        return self.formulation.horizon

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

    @property
    def in_force(self) -> int:
        """Number of labels in force that `masks` tells apart: 1, or N + 1, the default last."""
        return 1 if self.formulation.prices is None else len(self.formulation.prices)

    def symbols(self, states: np.ndarray) -> np.ndarray:
        """Return the symbols (B,) that sSAC applies at t0, the default in force; see `masks`."""
        masks = self.masks(states)
        return self.chosen(masks if self.in_force == 1 else masks[:, -1])

    def chosen(self, masks: np.ndarray) -> np.ndarray:
        """Return the symbols (B,) of masks (B, W); -1 is the default control.

        Ties go as in a policy, by `preference`. States without a finite result get the default.
        """
        best = preferred(masks, self.preference)
        best[empty(masks) | (best == len(self.efforts))] = -1
        return best

    def masks(self, states: np.ndarray) -> np.ndarray:
        """Return the symbols that could be best as bit masks (B, W), 0 without a finite result.

        A symbol could be best when it is for some perturbation of each mode insertion gradient
        by at most `TIE` of its scale. Bit N stands for the default control. With prices on
        switching, or a delay, there is one for each label in force, (B, J, W).
        """
        if self.in_force == 1:
            return self.possible(self.solve(states))
        if not self.formulation.delay:
            return self.next_possible(self.solve(states))
        return self._after_delay(states)

    def scored(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `masks` and, of the same solves, `smooth_scores` of states (B, n).

        Not with a delay: what decides is then another state for each label in force.
        """
        solution = self.solve(states)
        scores = self.smooth_scores(solution)
        if self.in_force == 1:
            return self.possible(solution), scores
        own, count = self._own_default, len(self.efforts)
        if own is not None and scores.shape[2] > count:  # see `_score_bounds`
            plain = self._symbol_scores(solution)[:, :, own]
            scores[:, :, own] = np.maximum(plain, scores[:, :, count])
            scores = scores[:, :, :count]
        return self.next_possible(solution), scores

    @property
    def _own_default(self) -> int | None:
        """The first symbol whose control is the default's; None where there is none."""
        same = (self.formulation.values == self.formulation.default).all(axis=1)
        return int(np.argmax(same)) if same.any() else None

    def _after_delay(self, states: np.ndarray) -> np.ndarray:
        """Return `masks` (B, J, W) for where states (B, n) will be when a decision takes effect.

        ``T_d(j, x) = T(j, Phi_d(x, u_j))``, with the flow under the control in force.
        """
        formulation = self.formulation
        controls = np.vstack([formulation.values, formulation.default])
        prices = formulation.prices
        assert prices is not None
        sets = np.empty((len(states), self.in_force, word_count(len(prices))), dtype=np.uint64)
        unique, kind = np.unique(controls, axis=0, return_inverse=True)
        for k, control in enumerate(unique):
            solution = self.solve(flow(formulation, states, control))
            some = np.flatnonzero(kind.ravel() == k)
            sets[:, some] = self.next_possible(solution, some)
        return sets

    def next_possible(
        self, solution: Solution, in_force: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Return the masks (B, J, W) of solved states, for some labels in force; see `masks`."""
        assert self.formulation.prices is not None
        low, high = self._score_bounds(solution)
        return priced_sets(low, high, self.formulation.prices[in_force])

    def decided(self, results: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        """Return the masks (B, W) of what a solver returns, the default in force; see `masks`."""
        solution = Solution(*results)
        if self.in_force == 1:
            return self.possible(solution)
        return self.next_possible(solution, slice(-1, None))[:, 0]

    def _score_bounds(self, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds (B, N + 1) of minus the first of `smooth_scores`, the default's last.

        They are those of a tie; infinite for labels that are no candidates, and where there is no
        finite result. The default competes by what it would have to save: the best score less the
        mode insertion gradient of its symbol; where a symbol has its control, that one does.
        """
        margin, gradients = TIE * solution.scales, solution.gradients
        with np.errstate(all="ignore"):
            if self.settings.rule == "steepest":
                low, high = (gradients + side + self.efforts for side in (-margin, margin))
            else:
                wanted, extra = self._wanted(solution), self.efforts - self.efforts.min()
                size = self._size(solution)
                squares = gradients * (gradients - 2 * wanted) + margin**2 + extra
                distance = np.abs(gradients - wanted)
                reach = 2 * margin * distance
                low = np.where(distance > margin, squares - reach, extra - wanted**2)
                high = squares + reach
                low, high = (np.where(size > 0, side / size, extra) for side in (low, high))
            lost = ~(np.isfinite(high) & np.isfinite(solution.scales)).all(axis=1)
            idle_low = idle_high = np.full((len(low), 1), np.inf)
            if self.settings.on_no_descent == "default":
                could = low <= high.min(axis=1, keepdims=True)
                rises = np.where(could, gradients + margin, -np.inf).max(axis=1, keepdims=True)
                falls = np.where(could, gradients - margin, np.inf).min(axis=1, keepdims=True)
                idle_low = low.min(axis=1, keepdims=True) - rises
                idle_high = high.min(axis=1, keepdims=True) - falls
                if (own := self._own_default) is not None:  # competes in the default's place, too
                    low[:, own] = np.minimum(low[:, own], idle_low[:, 0])
                    high[:, own] = np.minimum(high[:, own], idle_high[:, 0])
                    idle_low = idle_high = np.full((len(low), 1), np.inf)
        low, high = np.hstack([low, idle_low]), np.hstack([high, idle_high])
        low[lost], high[lost] = np.inf, np.inf
        return low, high

    def spread(self, solution: Solution) -> float:
        """Return the median, over solved states, of the worst score less the best [cost / time]."""
        scores = self._symbol_scores(solution)[:, 0]
        ranges = np.ptp(scores, axis=1)
        ranges = ranges[np.isfinite(ranges)]
        return float(np.median(ranges)) if ranges.size else 0.0

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
        scores = self._symbol_scores(solution)
        if self.settings.on_no_descent == "default":
            best = scores[:, :1].argmax(axis=2)[:, :, None]
            slope = np.take_along_axis(solution.gradients[:, None], best, axis=2)
            default = scores.max(axis=2, keepdims=True) + slope
            # symbols that are the default itself must not tie with it
            same = (solution.scales == 0)[:, None]
            low, high = scores.min(axis=2, keepdims=True), scores.max(axis=2, keepdims=True)
            with np.errstate(all="ignore"):
                scores = np.where(same, 2 * low - high, scores)
            scores = np.concatenate([scores, default], axis=2)
        return scores

    def _symbol_scores(self, solution: Solution) -> np.ndarray:
        """Return `smooth_scores` of the symbols alone, (B, V, N)."""
        gradients = solution.gradients
        with np.errstate(all="ignore"):
            if self.settings.rule == "steepest":
                return np.asarray((-gradients - self.efforts)[:, None])
            wanted, extra = self._wanted(solution), self.efforts - self.efforts.min()
            size = self._size(solution)
            squares = (2 * wanted - gradients) * gradients - extra
            first = np.where(size > 0, squares / size, -extra)
            price = np.where(extra > 0, extra / (2 * np.abs(wanted)), 0.0)
            finite = np.isfinite(price).all(axis=1, keepdims=True)
            second = np.where(finite, -gradients - price, first)
            return np.stack([first, second], axis=1)

    def possible(self, solution: Solution) -> np.ndarray:
        """Return the masks (B, W) of solved states; see `masks`."""
        low, high = self._bounds(solution)
        least = high.min(axis=1)
        could = np.zeros((len(low), low.shape[1] + 1), dtype=bool)
        could[:, :-1] = low <= least[:, None]
        if self.settings.on_no_descent == "default":
            margin = TIE * solution.scales
            with np.errstate(invalid="ignore"):
                could[:, -1] = (could[:, :-1] & (solution.gradients + margin >= 0)).any(axis=1)
                could[:, :-1] &= solution.gradients - margin < 0
        could[~np.isfinite(high).all(axis=1)] = False
        return masks_of_members(could)

    def _size(self, solution: Solution) -> np.ndarray:
        """Return what the scores of eq. (8) are divided by, (B, 1); see `smooth_scores`."""
        squares = (solution.gradients**2).mean(axis=1, keepdims=True)
        return np.asarray(2 * np.sqrt(self._wanted(solution) ** 2 + squares))

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
    formulation: Formulation, backend: str = "auto", seed: int = 0
) -> BatchController:
    """Return the controller of a formulation, with its kernel built and its steps chosen.

    Steps that are not given are chosen by `choose_steps`, at states drawn from the domain with a
    seed; those of a map are the samples of its horizon. Backends are those of `compiled`.
    """
    default, settings = formulation.default, formulation.settings
    bound, mapped = bind_default(formulation.model, default), formulation.model.sample_time
    if mapped is not None:
        settings = dataclasses.replace(settings, steps=round(formulation.horizon))
        formulation = dataclasses.replace(formulation, settings=settings)
    if mapped is not None and settings.sensitivity != "first order":
        solver, used = one_step_solver(formulation, backend)
    else:
        solver, used = make_solver(bound, settings.precision, backend)
    efforts = settings.efforts(np.vstack([formulation.values, default]))
    preference = tuple(int(k) for k in np.argsort(efforts, kind="stable"))
    controller = BatchController(solver, used, formulation, efforts[:-1], preference)
    if settings.steps is not None:
        return controller
    steps = choose_steps(solver, controller.decided, formulation, bound, seed)
    settings = dataclasses.replace(settings, steps=steps)
    formulation = dataclasses.replace(formulation, settings=settings)
    return dataclasses.replace(controller, formulation=formulation)


def policy_controller(policy: Policy, backend: str = "auto") -> BatchController | None:
    """Return the controller that a policy came from, or None where it does not carry it."""
    if policy.model is None or policy.horizon is None or policy.settings is None:
        return None
    return batch_controller(Formulation.of(policy, policy.model), backend)


def flow(formulation: Formulation, states: np.ndarray, control: np.ndarray) -> np.ndarray:
    """Return where states (B, n) are after the delay, under a control (m,) that is held.

    Runge-Kutta steps are no longer than those of the prediction, and at least `DELAY_STEPS`. A map
    takes one for each sample.
    """
    settings, delay, period = formulation.settings, formulation.delay, formulation.model.sample_time
    assert settings.steps is not None
    count = max(DELAY_STEPS, math.ceil(delay / formulation.horizon * settings.steps))
    count = count if period is None else round(delay / period)
    step = bind(formulation.model.step, u=control)
    x = np.ascontiguousarray(states.T)
    with np.errstate(all="ignore"):
        for _ in range(count):
            x = step.evaluate(x, [delay / count])[0]
    return x.T
