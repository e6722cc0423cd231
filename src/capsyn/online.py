"""sSAC and SAC in receding horizon: one whole action per sample (Section III of the paper).

An action is found in four steps. (1) Predict: the state and the cost J0 under the default control,
and the adjoint. (2) Schedule: at every sample time of the prediction the control that would lower
the cost best, eq. (8). (3) Application time: now, or where ``|u| + dJ/dlambda + (t - t0)^1.6`` is
least. (4) Duration: a window around it, clipped to the horizon, halved until the predicted cost
falls by the wanted share; with and without the action it is integrated on one grid that has the
window's ends as points. Where nothing lowers the cost the action is the default control.

The default control is a constant, a signal ``u(t)``, or a policy: a "background controller", whose
symbols are recorded along the prediction and frozen as a signal.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.alphabet import Alphabet
from capsyn.closed_loop import NONE, TIME, Command
from capsyn.domain import Box
from capsyn.errors import CapsynWarning, KernelBuildError, ProblemError
from capsyn.masks import preferred
from capsyn.model import Model
from capsyn.native.kernels import ActionKernel, ActionOptions, TreeArguments, action_type
from capsyn.policy import Policy
from capsyn.problem import Problem
from capsyn.program import Program, is_affine
from capsyn.program_builder import ProgramBuilder
from capsyn.settings import SsacSettings
from capsyn.ssac import ROUNDING, TIE, BatchController, Solution, batch_controller
from capsyn.targets import Target
from capsyn.transcription import transcribe, transcribe_target
from capsyn.validation import describe, finite_number, is_list, numbers, one_of

EXPONENT = 1.6
"""Of the cost of waiting, ``(t - t0)^1.6``, in the search of the application time."""

Default = np.ndarray | Callable[[float], Any] | Policy


@dataclass(frozen=True)
class Actions:
    """What sSAC or SAC would do in some states; the shapes (...) are those of the states.

    Parameters
    ----------
    symbol : (...)
        Symbol of the action; -1 for the default control, -2 for a control of SAC.
    control : (..., m)
        Its control [input units].
    application_time : (...)
        Time tau at which the action is chosen [s from now].
    start, duration : (...)
        It acts from `start` for `duration` [s]; the duration is 0 where there is no action.
    gradient : (...)
        Mode insertion gradient at tau, eq. (6) [cost / s].
    cost, decrease : (...)
        Cost J0 of the default prediction, and what the action takes off it.
    base : (..., m)
        Default control now [input units].
    base_symbol : (...)
        Its symbol where a policy gives it, else -1.
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


@dataclass(frozen=True, eq=False)
class OnlineController:
    """sSAC or SAC in receding horizon; build it with `online_controller`.

    `simulate` and `monte_carlo` take it like a policy. Calling it with a time and states (B, n)
    returns the controls (B, m) that act at once.
    """

    method: str
    model: Model
    domain: Box
    alphabet: Alphabet
    default: np.ndarray
    background: Callable[[float], Any] | Policy | None
    horizon: float
    settings: SsacSettings
    target: Target | None
    sac: Program | None
    kernel: ActionKernel | None
    chooser: BatchController

    def actions(self, states: Any, time: float = 0.0, schedule: bool = False) -> Actions:
        """Return the actions in states (..., n) at a time [s]; see `Actions`.

        Parameters
        ----------
        schedule : bool
            Whether to return the whole schedule, too.
        """
        states = numbers("states", states)
        n, m = self.domain.n, self.alphabet.m
        if states.ndim == 0 or states.shape[-1] != n:
            raise ProblemError(f"`states` must have shape (..., {n}); got {states.shape}")
        flat, shape = states.reshape(-1, n), states.shape[:-1]
        steps = self.steps
        schedules = np.empty((len(flat), steps + 1, m)) if schedule else None
        if self.kernel is not None:
            options = self._options
            if callable(self.background) and not isinstance(self.background, Policy):
                feed = self._feed(time)
                options.feed = feed.ctypes.data
            found = self.kernel(flat, options, schedules)
        else:
            found = self._solve(flat, time, schedules)

        found = found.reshape(shape)[()]
        return Actions(
            symbol=found["symbol"],
            control=found["control"],
            application_time=found["time"],
            start=found["start"],
            duration=found["duration"],
            gradient=found["gradient"],
            cost=found["cost"],
            decrease=found["decrease"],
            base=found["base"],
            base_symbol=found["base_symbol"],
            schedule=None if schedules is None else schedules.reshape((*shape, steps + 1, m)),
        )

    def __call__(self, time: float, states: Any) -> np.ndarray:
        """Return the controls (..., m) that act at once in states (..., n) at a time [s]."""
        found = self.actions(states, time)
        acts = np.asarray((found.duration > 0) & (found.start <= 0))
        return np.where(acts[..., None], found.control, found.base)

    def decide(self, time: float, measured: np.ndarray) -> Command:
        """Return the command over a sample: default control, action, default control."""
        found = self.actions(measured, time)
        acts = found.duration > 0
        start = np.where(acts, found.start, np.inf)
        ends = np.stack([start, start + found.duration, np.full(len(start), np.inf)], axis=1)
        return Command(
            np.stack([found.base, found.control, found.base], axis=1),
            ends,
            np.where(start <= 0, found.symbol, found.base_symbol),
            np.full(len(start), TIME),
            np.zeros(len(start), dtype=bool),
        )

    @property
    def steps(self) -> int:
        """Integration steps over the horizon."""
        assert self.settings.steps is not None
        return self.settings.steps

    def _feed(self, time: float) -> np.ndarray:
        """Return default controls (steps, m) of the prediction's steps, taken at their middles."""
        if self.background is None:
            return np.tile(self.default, (self.steps, 1))
        middles = time + (np.arange(self.steps) + 0.5) * (self.horizon / self.steps)
        return np.array([self.alphabet.control("default", self.background(t)) for t in middles])

    @functools.cached_property
    def _options(self) -> ActionOptions:
        """What the kernel needs, with the arrays that it points to kept alive."""
        settings, policy = self.settings, self.background
        arrays = {
            "values": np.ascontiguousarray(self.alphabet.values),
            "efforts": np.ascontiguousarray(self.chooser.efforts),
            "preference": np.array(self.chooser.preference, dtype=np.int64),
        }
        if isinstance(policy, Policy):
            outside, lost = _outside_label(policy), len(policy.alphabet)
            arrays["table"] = np.vstack([policy.alphabet.values, policy.default])
            cells = TreeArguments.of(policy.domain, policy.cells)
        else:
            outside, lost, cells = -1, -1, TreeArguments()
            arrays["feed"] = self._feed(0.0)
        options = ActionOptions(
            horizon=self.horizon,
            gamma=settings.gamma,
            alpha_d=np.nan if settings.alpha_d is None else settings.alpha_d,
            initial=settings.initial_duration,
            shrink=settings.shrink,
            descent=settings.descent,
            exponent=EXPONENT,
            tie=TIE,
            rounding=_ROUNDING,
            steps=self.steps,
            search=settings.application_time == "search",
            steepest=settings.rule == "steepest",
            to_default=settings.on_no_descent == "default",
            backtracks=settings.max_backtracks,
            outside=outside,
            lost=lost,
            cells=cells,
            **{name: array.ctypes.data for name, array in arrays.items()},
        )
        options.arrays = [arrays, cells]
        return options

    def _solve(self, states: np.ndarray, time: float, schedules: np.ndarray | None) -> np.ndarray:
        """Return actions (B,) as the compiled kernel does, by NumPy."""
        model, steps, count = self.model, self.steps, len(states)
        dt, m = [self.horizon / steps], self.alphabet.m
        found = np.zeros(count, action_type(m))
        found["base_symbol"] = -1
        policy = self.background if isinstance(self.background, Policy) else None
        feed = np.zeros((steps, m)) if policy else self._feed(time)
        x, total, path, controls = states.T, np.zeros(count), [], []
        for k in range(steps):
            if policy is None:
                u = np.tile(feed[k][:, None], count)
            else:
                labels = _labels(policy, x.T)
                u = np.vstack([policy.alphabet.values, policy.default])[labels].T
                if k == 0:
                    found["base_symbol"] = np.where(labels == len(policy.alphabet), -1, labels)
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

        found["cost"], found["base"], found["control"] = total, controls[0].T, controls[0].T
        search = self.settings.application_time == "search"
        best = np.full(count, np.inf)
        for k in range(steps + 1 if search or schedules is not None else 1):
            control, gradient, symbol = self._schedule(path[k], controls[k], adjoints[k], total)
            if schedules is not None:
                schedules[:, k] = control.T
            with np.errstate(invalid="ignore"):
                value = np.sqrt((control**2).sum(axis=0)) + gradient + (k * dt[0]) ** EXPONENT
                take = value < best if search else np.full(count, k == 0)
            best[take] = value[take]
            found["time"][take] = k * dt[0]
            found["gradient"][take] = gradient[take]
            found["symbol"][take] = symbol[take]
            found["control"][take] = control.T[take]
        wanted = np.isfinite(total) & (found["gradient"] < 0)
        found["symbol"][~wanted & (found["symbol"] == NONE)] = NONE
        self._search_duration(found, np.flatnonzero(wanted), path[0], controls)
        return found

    def _schedule(
        self, x: np.ndarray, u: np.ndarray, rho: np.ndarray, cost: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return controls (m, B), gradients (B,) and symbols (B,) at one time, eq. (8)."""
        count = len(cost)
        if self.sac is not None:
            alpha = self.settings.gamma * cost
            if self.settings.alpha_d is not None:
                alpha = np.full(count, self.settings.alpha_d)
            control, gradient = self.sac.evaluate(x, u, rho, alpha[None, :])
            return control, gradient[0], np.full(count, NONE)
        gradients, scales = self.model.insertion.evaluate(x, u, rho, cost[None, :], [_ROUNDING])
        masks = self.chooser.possible(Solution(cost, gradients.T, scales.T))
        symbol = preferred(masks, self.chooser.preference)
        symbol = np.where((masks == 0) | (symbol == len(gradients)), -1, symbol)
        chosen = symbol >= 0
        control = np.where(chosen, self.alphabet.values[symbol].T, u)
        return control, np.where(chosen, gradients[symbol, np.arange(count)], 0.0), symbol

    def _search_duration(
        self, found: np.ndarray, rows: np.ndarray, x0: np.ndarray, controls: list[np.ndarray]
    ) -> None:
        """Find start, duration and decrease of the actions `rows`, in place."""
        settings = self.settings
        width = settings.initial_duration
        for attempt in range(settings.max_backtracks + 1):
            start = np.maximum(found["time"][rows] - width, 0.0)
            stop = np.minimum(found["time"][rows] + width, self.horizon)
            action = found["control"][rows].T
            base = [u[:, rows] for u in controls[:-1]]
            idle = self._cost(x0[:, rows], base, action, start, stop, False)
            acting = self._cost(x0[:, rows], base, action, start, stop, True)
            last = attempt == settings.max_backtracks
            with np.errstate(invalid="ignore"):
                good = acting < idle - (0.0 if last else settings.descent * np.abs(idle))
            taken = rows[good]
            found["start"][taken], found["duration"][taken] = start[good], (stop - start)[good]
            found["decrease"][taken] = (idle - acting)[good]
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
        dt, steps = self.horizon / self.steps, self.steps
        total, now, k = np.zeros(len(start)), np.zeros(len(start)), np.zeros(len(start), int)
        signal = np.stack(base)
        lanes = np.arange(len(start))
        for _ in range(steps + 2):
            whole = np.where(k < steps, (k + 1) * dt, now)
            until = np.where((now < start) & (start < whole), start, whole)
            until = np.where((now < stop) & (stop < until), stop, until)
            acts = act & (now >= start) & (now < stop)
            u = np.where(acts, action, signal[np.minimum(k, steps - 1), :, lanes].T)
            x, part = self.model.step.evaluate(x, u, (until - now)[None, :])
            total = total + part[0]
            k, now = k + (until == whole), until
        return total + self.model.terminal_cost.evaluate(x)[0][0]


_ROUNDING = float(ROUNDING * np.finfo(float).eps / TIE)


def _outside_label(policy: Policy) -> int:
    """Return the label of predicted states outside a background policy's domain, -1: nearest."""
    if policy.outside == "nearest":
        return -1
    count = len(policy.alphabet)
    return count if policy.outside == "error" else int(policy.outside) % (count + 1)


def _labels(policy: Policy, states: np.ndarray) -> np.ndarray:
    """Return labels (B,) of predicted states; the default where a rule would raise."""
    count = len(policy.alphabet)
    rule = _outside_label(policy)
    labels = np.full(len(states), count if rule < 0 else rule)
    known = np.isfinite(states).all(axis=1)
    if rule >= 0:
        known &= policy.domain.contains(states)
    labels[known] = policy(states[known], "nearest", backend="numpy") % (count + 1)
    return labels


def online_controller(
    source: Problem | Policy,
    method: str = "ssac",
    *,
    default: Any = None,
    horizon: float | None = None,
    settings: SsacSettings | None = None,
    limits: Any = None,
    backend: str = "auto",
) -> OnlineController:
    """Return sSAC or SAC in receding horizon for a problem, or for the model of a policy.

    Parameters
    ----------
    source : Problem or Policy
        Model, costs, alphabet, and what is not given below.
    method : "ssac" or "sac"
        Symbols of the alphabet, or continuous controls ``u* = (Lambda + R)^-1 (Lambda u_default +
        h^T rho alpha_d)`` with ``Lambda = h^T rho rho^T h`` for ``f = g(x) + h(x) u`` [1]_,
        saturated.
    default : (m,), callable ``time -> (m,)`` or Policy, optional
        Default control of the prediction, which also acts where nothing is better.
    horizon : float, optional
        Prediction horizon T [s].
    settings : SsacSettings, optional
        Options; SAC needs a positive definite `control_weight`.
    limits : (lower (m,), upper (m,)), optional
        Bounds of SAC's controls [input units]. Default: those of the alphabet.
    backend : "auto", "c" or "numpy"
        How to solve.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or dynamics that are not control-affine under SAC.

    References
    ----------
    .. [1] A. R. Ansari and T. D. Murphey, "Sequential Action Control: Closed-Form Optimal Control
       for Nonlinear and Nonsmooth Systems", IEEE Transactions on Robotics 32 (2016).
    """
    one_of("method", method, ["ssac", "sac"])
    one_of("backend", backend, ["auto", "c", "numpy"])
    if isinstance(source, Problem):
        model, target = transcribe(source), transcribe_target(source)
    elif isinstance(source, Policy) and source.model is not None:
        model, target = source.model, source.target
    else:
        raise ProblemError(
            f"`source` must be a Problem or a Policy with a model; got {describe(source)}"
        )
    horizon = source.horizon if horizon is None else finite_number("horizon", horizon, above=0.0)
    settings = source.settings if settings is None else settings
    if horizon is None or settings is None:
        raise ProblemError("`horizon` and `settings` must be given for a policy without them")
    alphabet, constant, background = source.alphabet, source.default, None
    if isinstance(default, Policy):
        if (default.domain.n, default.alphabet.m) != (source.domain.n, alphabet.m):
            raise ProblemError(
                f"`default` must be a policy of {source.domain.n} state(s) and {alphabet.m} "
                f"input(s); got {default.domain.n} and {default.alphabet.m}"
            )
        background = default
    elif callable(default):
        background = default
        alphabet.control("default", default(0.0))
    elif default is not None:
        constant = alphabet.control("default", default)
    chooser = batch_controller(
        model, source.domain, alphabet.values, constant, horizon, settings, backend
    )
    sac = _sac_program(model, alphabet, chooser.settings, limits) if method == "sac" else None
    kernel = None
    if backend != "numpy":
        try:
            kernel = ActionKernel.build(model, sac)
        except KernelBuildError as error:
            if backend == "c":
                raise
            warnings.warn(f"solving with NumPy: {error}", CapsynWarning, stacklevel=2)
    return OnlineController(
        method,
        model,
        source.domain,
        alphabet,
        constant,
        background,
        horizon,
        chooser.settings,
        target,
        sac,
        kernel,
        chooser,
    )


def _sac_program(model: Model, alphabet: Alphabet, settings: SsacSettings, limits: Any) -> Program:
    """Return SAC's schedule ``(x, u, rho, alpha) -> (control, gradient)``.

    Lambda has rank one, so that ``u* = R^-1 v (v . u + alpha) / (1 + v . R^-1 v)``, v = h^T rho.
    """
    n, m = dict(model.dynamics.inputs)["x"], alphabet.m
    if not is_affine(model.dynamics, "u"):
        raise ProblemError("`dynamics` must be affine in u for the method 'sac'")
    weight = np.asarray(settings.control_weight) * (
        np.eye(m) if np.ndim(settings.control_weight) == 0 else 1
    )
    if np.linalg.eigvalsh(weight).min() <= 0:
        raise ProblemError("`control_weight` must be positive definite for the method 'sac'")
    inverse = np.linalg.inv(weight)
    lower, upper = alphabet.values.min(axis=0), alphabet.values.max(axis=0)
    if limits is not None:
        if not is_list(limits, 2):
            raise ProblemError(f"`limits` must be (lower, upper); got {describe(limits)}")
        lower, upper = (alphabet.control("limits", value) for value in limits)
        if (lower > upper).any():
            raise ProblemError(f"`limits` must have lower <= upper; got {describe(limits)}")
    builder = ProgramBuilder()
    ports = (("x", n), ("u", m), ("rho", n), ("alpha", 1))
    x, u, rho, alpha = ([builder.input() for _ in range(size)] for _, size in ports)
    apply, constant = builder.apply, builder.constant

    def dot(a: list[int], b: list[int]) -> int:
        return functools.reduce(
            lambda total, pair: apply("add", total, apply("mul", *pair)), zip(a, b), constant(0.0)
        )

    zero = [constant(0.0)] * m
    drift = builder.call(model.dynamics, x, zero)
    v = []
    for i in range(m):
        unit = [constant(float(i == j)) for j in range(m)]
        rates = builder.call(model.dynamics, x, unit)
        v.append(dot(rho, [apply("sub", a, b) for a, b in zip(rates, drift)]))
    weighted = [dot([constant(value) for value in row], v) for row in inverse]
    size = apply(
        "div", apply("add", dot(v, u), alpha[0]), apply("add", constant(1.0), dot(v, weighted))
    )
    control = [
        apply("fmin", apply("fmax", apply("mul", w, size), constant(low)), constant(high))
        for w, low, high in zip(weighted, lower, upper)
    ]
    gradient = dot(v, [apply("sub", a, b) for a, b in zip(control, u)])
    return builder.build("sac", ports, (("control", m), ("gradient", 1)), [*control, gradient])
