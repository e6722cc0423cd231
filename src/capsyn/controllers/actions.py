"""Whole actions of sSAC and SAC by NumPy, as action.c finds them; see `online`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsyn.controllers.action_kernel import action_type
from capsyn.controllers.command import NONE
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import relative_rounding
from capsyn.controllers.ssac import BatchController, Solution
from capsyn.policies.policy import Policy
from capsyn.programs.program import Program

EXPONENT = 1.6
"""Of the cost of waiting, ``(t - t0)^1.6``, in the search of the application time."""
ROUNDING = relative_rounding(float)


@dataclass(frozen=True)
class Actions:
    """The actions of sSAC or SAC in some states. The shapes (...) are those of the states.

    Parameters
    ----------
    symbol : (...)
        Symbol of the action; -1 for the default control, -2 for a control of SAC.
    control : (..., m)
        Control of the action [input units].
    application_time : (...)
        Time tau at which the action is chosen [time unit from now].
    start, duration : (...)
        Start of the action, and time for which it acts [time unit]; the duration is 0 if there is
        no action.
    gradient : (...)
        Mode insertion gradient at tau, eq. (6) [cost / time unit].
    cost, decrease : (...)
        Cost J0 of the default prediction, and how much the action lowers it.
    base : (..., m)
        Default control now [input units].
    base_symbol : (...)
        Symbol of the default control now, if a policy gives it; otherwise -1.
    schedule : (..., steps + 1, m), optional
        The controls u*(t) at the sample times of the prediction.
    """

    symbol: np.ndarray
    control: np.ndarray
    application_time: np.ndarray
    start: np.ndarray
    duration: np.ndarray
    gradient: np.ndarray
    cost: np.ndarray
    decrease: np.ndarray
    base: np.ndarray
    base_symbol: np.ndarray
    schedule: np.ndarray | None = None


@dataclass(frozen=True)
class NumpyActions:
    """What finds whole actions, by NumPy on all states at once."""

    formulation: Formulation  # its settings with `steps`
    chooser: BatchController  # what chooses symbols by scores
    sac: Program | None  # the schedule of SAC, in place of the chooser's

    def __call__(
        self, states: np.ndarray, signal: np.ndarray | Policy, schedules: np.ndarray | None
    ) -> np.ndarray:
        """Return actions (B,), records of `action_type`, of states (B, n) [state units].

        The signal is the default control (steps, m) of each step of the prediction, or the
        background policy. `schedules` (B, steps + 1, m), where given, gets the schedules.
        """
        formulation, count = self.formulation, len(states)
        model, steps = formulation.model, formulation.settings.steps
        assert steps is not None
        dt, m = [formulation.horizon / steps], formulation.values.shape[1]
        actions = np.zeros(count, action_type(m))
        actions["base_symbol"] = -1
        x, total, path, controls, labels = states.T, np.zeros(count), [], [], None
        for k in range(steps):
            if isinstance(signal, Policy):
                labels = predicted_labels(signal, x.T, labels)
                u = signal.controls[labels].T
                if k == 0:
                    actions["base_symbol"] = np.where(labels == len(signal.alphabet), -1, labels)
            else:
                u = np.tile(signal[k][:, None], count)
            path.append(x)
            controls.append(u)
            x, part = model.step.evaluate(x, u, dt)
            total = total + part[0]
        path.append(x)
        controls.append(controls[-1])
        part, rho = model.terminal_cost.evaluate(x)
        total = total + part[0]
        adjoints = [rho]
        for k in reversed(range(steps)):
            adjoints.append(model.adjoint.evaluate(path[k], controls[k], dt, adjoints[-1])[0])
        adjoints.reverse()

        actions["cost"], actions["base"], actions["control"] = total, controls[0].T, controls[0].T
        search = self.formulation.settings.application_time == "search"
        best = np.full(count, np.inf)
        for k in range(steps + 1 if search or schedules is not None else 1):
            control, gradient, symbol = self._schedule(path[k], controls[k], adjoints[k], total)
            if schedules is not None:
                schedules[:, k] = control.T
            with np.errstate(invalid="ignore"):
                value = np.sqrt((control**2).sum(axis=0)) + gradient + (k * dt[0]) ** EXPONENT
                take = value < best if search else np.full(count, k == 0)
            best[take] = value[take]
            actions["time"][take] = k * dt[0]
            actions["gradient"][take] = gradient[take]
            actions["symbol"][take] = symbol[take]
            actions["control"][take] = control.T[take]
        wanted = np.isfinite(total) & (actions["gradient"] < 0)
        self._search_duration(actions, np.flatnonzero(wanted), path[0], controls)
        return actions

    def _schedule(
        self, x: np.ndarray, u: np.ndarray, rho: np.ndarray, cost: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return controls (m, B), gradients (B,) and symbols (B,) at one time, eq. (8)."""
        count = len(cost)
        if self.sac is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                alpha = self.formulation.settings.wanted_sensitivity(cost)
            control, gradient = self.sac.evaluate(x, u, rho, alpha[None, :])
            return control, gradient[0], np.full(count, NONE)
        gradients, scales = self.formulation.model.insertion.evaluate(
            x, u, rho, cost[None, :], [ROUNDING]
        )
        symbol = self.chooser.chosen(self.chooser.possible(Solution(cost, gradients.T, scales.T)))
        chosen = symbol >= 0
        control = np.where(chosen, self.formulation.values[symbol].T, u)
        return control, np.where(chosen, gradients[symbol, np.arange(count)], 0.0), symbol

    def _search_duration(
        self, actions: np.ndarray, rows: np.ndarray, x0: np.ndarray, controls: list[np.ndarray]
    ) -> None:
        """Find start, duration and decrease of the actions `rows`, in place."""
        settings = self.formulation.settings
        width = settings.initial_duration
        for attempt in range(settings.max_backtracks + 1):
            start = np.maximum(actions["time"][rows] - width, 0.0)
            stop = np.minimum(actions["time"][rows] + width, self.formulation.horizon)
            action = actions["control"][rows].T
            base = [u[:, rows] for u in controls[:-1]]
            idle = self._cost(x0[:, rows], base, action, start, stop, False)
            acting = self._cost(x0[:, rows], base, action, start, stop, True)
            last = attempt == settings.max_backtracks
            with np.errstate(invalid="ignore"):
                good = acting < idle - (0.0 if last else settings.descent * np.abs(idle))
            taken = rows[good]
            actions["start"][taken], actions["duration"][taken] = start[good], (stop - start)[good]
            actions["decrease"][taken] = (idle - acting)[good]
            rows, width = rows[~good], width * settings.shrink

    def _cost(
        self,
        x: np.ndarray,
        base: list[np.ndarray],
        action: np.ndarray,
        start: np.ndarray,
        stop: np.ndarray,
        act: bool,
    ) -> np.ndarray:
        """Return costs (B,) with or without the action, on a grid with its ends as points."""
        steps = len(base)
        dt = self.formulation.horizon / steps
        total, now, k = np.zeros(len(start)), np.zeros(len(start)), np.zeros(len(start), int)
        signal = np.stack(base)
        lanes = np.arange(len(start))
        for _ in range(steps + 2):
            whole = np.where(k < steps, (k + 1) * dt, now)
            until = np.where((now < start) & (start < whole), start, whole)
            until = np.where((now < stop) & (stop < until), stop, until)
            acts = act & (now >= start) & (now < stop)
            u = np.where(acts, action, signal[np.minimum(k, steps - 1), :, lanes].T)
            x, part = self.formulation.model.step.evaluate(x, u, (until - now)[None, :])
            total = total + part[0]
            k, now = k + (until == whole), until
        return total + self.formulation.model.terminal_cost.evaluate(x)[0][0]


def outside_label(policy: Policy) -> int:
    """Return the label of predicted states outside a background policy's domain, -1: nearest."""
    if policy.outside == "nearest":
        return -1
    count = len(policy.alphabet)
    return count if policy.outside == "error" else int(policy.outside) % (count + 1)


def predicted_labels(
    policy: Policy, states: np.ndarray, in_force: np.ndarray | None = None
) -> np.ndarray:
    """Return labels (B,) of predicted states; the default where a rule would raise.

    They follow those in force (B,), by default the default's.
    """
    rule = outside_label(policy)
    labels = policy.leaves(states, rule < 0, "numpy", in_force)
    return np.where(labels < 0, len(policy.alphabet) if rule < 0 else rule, labels)
