"""sSAC and SAC in receding horizon: one whole action per sample (Section III of the paper).

An action is found in four steps. (1) Predict the state, the cost J0 under the default control, and
the adjoint. (2) Schedule: at every sample time of the prediction, find the control that would lower
the cost best, eq. (8). (3) Choose the application time: now, or where ``|u| + dJ/dlambda + (t -
t0)^1.6`` is least. (4) Choose the duration: a window around that time, clipped to the horizon, is
halved until the predicted cost falls by the wanted share. The costs with and without the action are
integrated on one grid, with the window's ends as points. If nothing lowers the cost, the action is
the default control.

The default control is a constant, a signal ``u(t)``, or a policy. A policy is a "background
controller": its symbols are recorded along the prediction and frozen as a signal.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.controllers.action_kernel import ActionKernel, ActionOptions
from capsyn.controllers.actions import EXPONENT, ROUNDING, Actions, NumpyActions, outside_label
from capsyn.controllers.command import TIME, Command
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.sac import sac_program
from capsyn.controllers.solver import TIE
from capsyn.controllers.ssac import batch_controller
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.discrete import refuse_map
from capsyn.modelling.domain import Box
from capsyn.modelling.exogenous import readings
from capsyn.modelling.problem import Problem
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import SwitchRules
from capsyn.modelling.targets import Target
from capsyn.modelling.transcription import transcribe, transcribe_target
from capsyn.native.compiled import compiled
from capsyn.policies.lookup import TreeArguments
from capsyn.policies.policy import Policy
from capsyn.programs.model import Model
from capsyn.programs.program import Program
from capsyn.validation import BACKENDS, describe, finite_number, one_of

POLICY_STEPS = 100
"""Least steps of a prediction under a policy, whose symbols may change at every step."""

Default = np.ndarray | Callable[[float], Any] | Policy


@dataclass(frozen=True, eq=False)
class OnlineController:
    """A controller by sSAC or SAC in receding horizon; `online_controller` makes it.

    `simulate` and `monte_carlo` take it like a policy. A call with a time and states (B, n) returns
    the controls (B, m) that act at once. If the controller is told exogenous inputs, the call takes
    them last.

    Parameters
    ----------
    method : "ssac" or "sac"
        Whether controls are symbols ("ssac") or continuous ("sac").
    formulation : Formulation
        Model, horizon and settings, from the problem or policy or in their place.
    domain, exogenous, alphabet, min_dwell, target, time_unit
        The fields of the same names of the problem or policy.
    background : callable ``time -> (m,)``, Policy or None
        Default control of the prediction, if it is not constant.
    kernel, numpy
        The functions that find actions: compiled, if there is a compiler, and in NumPy.
    rules : SwitchRules, optional
        Least times and forbidden transitions, which a closed loop keeps.
    """

    method: str
    formulation: Formulation
    domain: Box
    exogenous: Box | None
    alphabet: Alphabet
    background: Callable[[float], Any] | Policy | None
    min_dwell: float
    target: Target | None
    kernel: ActionKernel | None
    numpy: NumpyActions
    time_unit: str
    rules: SwitchRules | None

    def __repr__(self) -> str:
        kind = "policy" if isinstance(self.background, Policy) else "signal"
        around = "" if self.background is None else f" around a {kind}"
        horizon = f"{self.horizon:g} {self.time_unit}"
        return f"OnlineController('{self.method}'{around}, horizon {horizon})"

    def actions(
        self, states: Any, exogenous: Any = None, time: float = 0.0, schedule: bool = False
    ) -> Actions:
        """Return the actions in states (..., n) at a time; see `Actions`.

        Parameters
        ----------
        states, exogenous : (..., n) and (..., k)
            States, and exogenous inputs if there are some, as a policy takes them.
        time : float
            The present time [time unit], for a default control that is a signal.
        schedule : bool
            Whether to return the whole schedule as well.

        Raises
        ------
        ProblemError
            States or exogenous inputs of another shape.
        """
        n, m = self.space.n, self.alphabet.m
        states = readings(states, exogenous, self.domain, self.exogenous)
        flat, shape = states.reshape(-1, n), states.shape[:-1]
        signal = None if isinstance(self.background, Policy) else self.background
        steps = self.steps
        schedules = np.empty((len(flat), steps + 1, m)) if schedule else None
        if self.kernel is not None:
            options = self._options
            if signal is not None:
                feed = self._feed(time)
                options = ActionOptions.from_buffer_copy(options)  # other threads have their own
                options.feed = feed.ctypes.data
            records = self.kernel(flat, options, schedules)
        else:
            policy = self.background if isinstance(self.background, Policy) else None
            records = self.numpy(flat, policy or self._feed(time), schedules)
        if signal is not None:  # now, not in the middle of the first step
            records["base"] = self.alphabet.control("default", signal(time))
            idle = records["symbol"] == -1
            records["control"][idle] = records["base"][idle]
        records = records.reshape(shape)
        names = [f.name for f in dataclasses.fields(Actions) if f.name in records.dtype.names]
        return Actions(
            application_time=records["time"][()],
            schedule=None if schedules is None else schedules.reshape((*shape, steps + 1, m)),
            **{name: records[name][()] for name in names},  # [()]: numbers of a single state
        )

    def __call__(self, time: float, states: Any, exogenous: Any = None) -> np.ndarray:
        """Return the controls (..., m) that act at once in states (..., n) at a time.

        `exogenous` are the exogenous inputs (..., k), if there are some.
        """
        planned = self.actions(states, exogenous, time)
        acts = np.asarray((planned.duration > 0) & (planned.start <= 0))
        return np.where(acts[..., None], planned.control, planned.base)

    def decide(
        self, time: float, measured: np.ndarray, in_force: np.ndarray | None = None
    ) -> Command:
        """Return the command over a sample: default control, action, default control.

        `simulate` calls this with the readings `measured` (B, n) at `time`. `in_force` changes
        nothing.
        """
        planned = self.actions(measured, time=time)
        start = np.where(planned.duration > 0, planned.start, np.inf)
        stop, now = start + planned.duration, start <= 0
        first = np.where(now[:, None], planned.control, planned.base)
        return Command(
            np.stack([first, planned.control, planned.base], axis=1),
            np.stack([np.where(now, stop, start), stop, np.full(len(start), np.inf)], axis=1),
            np.where(now, planned.symbol, planned.base_symbol),
            np.full(len(start), TIME),
            np.zeros(len(start), dtype=bool),
        )

    @property
    def model(self) -> Model:
        """The system and its costs, as programs."""
        return self.formulation.model

    @property
    def space(self) -> Box:
        """The box of readings: states, then exogenous inputs."""
        return self.formulation.domain

    @property
    def default(self) -> np.ndarray:
        """Default control (m,) [input units], if it is constant."""
        return self.formulation.default

    @property
    def default_control(self) -> np.ndarray:
        """The same as `default`, under the name that a problem uses."""
        return self.default

    @property
    def horizon(self) -> float:
        """Prediction horizon T [time unit]."""
        return self.formulation.horizon

    @property
    def settings(self) -> SsacSettings:
        """Settings of the controller, with `steps` given."""
        return self.formulation.settings

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
            "efforts": np.ascontiguousarray(self.numpy.chooser.efforts),
            "preference": np.array(self.numpy.chooser.preference, dtype=np.int64),
        }
        if isinstance(policy, Policy):
            outside, lost = outside_label(policy), len(policy.alphabet)
            gap = lost if policy.gaps else -1
            arrays["table"] = policy.controls
            if policy.remembers:
                arrays["transitions"] = np.ascontiguousarray(policy.transitions)
            cells = TreeArguments.of(policy.space, policy.cells)
        else:
            outside, lost, gap, cells = -1, -1, -1, TreeArguments()
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
            rounding=ROUNDING,
            steps=self.steps,
            search=settings.application_time == "search",
            steepest=settings.rule == "steepest",
            to_default=settings.on_no_descent == "default",
            backtracks=settings.max_backtracks,
            outside=outside,
            lost=lost,
            gap=gap,
            cells=cells,
            **{name: array.ctypes.data for name, array in arrays.items()},
        )
        options.arrays = [arrays, cells]
        return options


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

    The controller plans without prices and delay. Closed loops keep its least times.

    Parameters
    ----------
    source : Problem or Policy
        The model, the costs, the alphabet, and all options that are not given below.
    method : "ssac" or "sac"
        "ssac" chooses symbols of the alphabet. "sac" has continuous controls, saturated: ``u* =
        (Lambda + R)^-1 (Lambda u_default + h^T rho alpha_d)`` with ``Lambda = h^T rho rho^T h``,
        for ``f = g(x) + h(x) u``.
    default : (m,), callable ``time -> (m,)`` or Policy, optional
        Default control of the prediction, which also acts if nothing is better. The default must be
        given here if the problem's default is a law. Under a policy, the prediction has at least
        `POLICY_STEPS` steps, unless `settings` give their number.
    horizon : float, optional
        Prediction horizon T [time unit].
    settings : SsacSettings, optional
        Settings of the controller. SAC needs a positive definite `control_weight`.
    limits : (lower (m,), upper (m,)), optional
        Bounds of SAC's controls [input units]. Default: the bounds of the alphabet.
    backend : "auto", "c" or "numpy"
        How to solve: compiled if possible ("auto"), or as told.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or dynamics that are not control-affine under SAC.

    References
    ----------
    A. R. Ansari and T. D. Murphey, "Sequential Action Control: Closed-Form Optimal Control for
    Nonlinear and Nonsmooth Systems", IEEE Transactions on Robotics 32 (2016).
    """
    one_of("method", method, ["ssac", "sac"])
    one_of("backend", backend, BACKENDS)
    if isinstance(source, Problem):
        model, target = transcribe(source), transcribe_target(source)
    elif isinstance(source, Policy) and source.model is not None:
        model, target = source.model, source.target
    else:
        got = describe(source)
        raise ProblemError(f"`source` must be a Problem or a Policy with a model; got {got}")
    refuse_map(source, "source", "whole actions begin and end between samples")
    horizon = source.horizon if horizon is None else finite_number("horizon", horizon, above=0.0)
    said = source.settings if settings is None and isinstance(source, Problem) else settings
    settings = source.settings if settings is None else settings
    if horizon is None or settings is None:
        raise ProblemError("`horizon` and `settings` must be given for a policy without them")
    settings = _settings(source, settings, horizon)
    if source.switching is not None and source.switching.forbidden:
        raise ProblemError("`source` must have no forbidden transitions for an online controller")
    if model.prediction is not None and default is None:
        raise ProblemError(
            "`default` must be given, a constant or a policy: that of the problem is a law, which "
            "whole actions do not follow; got None"
        )
    model = dataclasses.replace(model, prediction=None)
    alphabet, (constant, background) = source.alphabet, _defaults(source, default)
    sac = sac_program(model, alphabet, settings, limits) if method == "sac" else None
    formulation = Formulation(model, source.space, alphabet.values, constant, horizon, settings)
    chooser = batch_controller(formulation, backend)
    chosen = chooser.settings
    assert chosen.steps is not None
    if isinstance(background, Policy) and (said is None or said.steps is None):
        chosen = dataclasses.replace(chosen, steps=max(chosen.steps, POLICY_STEPS))
    kernel = _kernel(model, sac, background, backend)
    formulation = dataclasses.replace(formulation, settings=chosen)
    return OnlineController(
        method,
        formulation,
        source.domain,
        source.exogenous,
        alphabet,
        background,
        source.min_dwell,
        target,
        kernel,
        NumpyActions(formulation, chooser, sac),
        source.time_unit,
        SwitchRules.of(source) if method == "ssac" and source.switching is not None else None,
    )


def _kernel(
    model: Model, sac: Program | None, background: Any, backend: str
) -> ActionKernel | None:
    """Return the kernel of a controller; None where NumPy does the work."""
    if isinstance(background, Policy) and not background.cells.compiled:
        return None
    return compiled(lambda: ActionKernel.build(model, sac), backend, "solving")


def _settings(source: Problem | Policy, settings: Any, horizon: float) -> SsacSettings:
    """Return settings checked, with the sample time of the source if they say none."""
    if not isinstance(settings, SsacSettings):
        raise ProblemError(f"`settings` must be a capsyn.SsacSettings; got {describe(settings)}")
    settings = (source.settings or settings).replaced(settings, True).sampled(horizon)
    settings.efforts(source.alphabet.values)
    return settings


def _defaults(
    source: Problem | Policy, default: Any
) -> tuple[np.ndarray, Callable[[float], Any] | Policy | None]:
    """Return the default control (m,) and what stands in its place in predictions, if anything."""
    alphabet = source.alphabet
    if isinstance(default, Policy):
        fits = (default.domain.n, default.space.n, default.alphabet.m)
        if fits != (source.domain.n, source.space.n, alphabet.m):
            raise ProblemError(
                f"`default` must be a policy of {source.domain.n} state(s)"
                f"{_told(source)} and {alphabet.m} input(s); got {default.domain.n}"
                f"{_told(default)} and {default.alphabet.m}"
            )
        if default.time_unit != source.time_unit:
            raise ProblemError(
                f"`default` must count time in {source.time_unit} like the model; got "
                f"{default.time_unit}"
            )
        return source.default_control, default
    if callable(default):
        alphabet.control("default", default(0.0))
        return source.default_control, default
    return source.default_control if default is None else alphabet.control("default", default), None


def _told(source: Problem | Policy) -> str:
    return "" if source.exogenous is None else f" + {source.exogenous.n} exogenous"
