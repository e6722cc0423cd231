"""The options of switched sequential action control."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.validation import (
    describe,
    finite_array,
    finite_number,
    keep,
    numbers,
    one_of,
    whole_number,
)

MAX_STEPS = 100_000
"""Most integration steps over a horizon."""


@dataclass(frozen=True)
class SsacSettings:
    """Options of switched sequential action control (Section III of the paper).

    Parameters
    ----------
    gamma : float
        Wanted sensitivity relative to the cost: ``alpha_d = gamma * J0``, eq. (8); <= 0.
    alpha_d : float, optional
        Wanted sensitivity as an absolute value [cost / time unit], <= 0. `alpha_d` replaces
        `gamma`.
    control_weight : float or (m, m)
        Weight R of the control effort ``u^T R u``, symmetric positive semidefinite.
    rule : "schedule" or "steepest"
        What the chosen symbol minimises: ``(dJ_dlam - alpha_d)^2 + |u|_R^2``, eq. (8), for
        "schedule", and ``dJ_dlam + |u|_R^2`` for "steepest".
    on_no_descent : "best" or "default"
        What a state gets if its chosen symbol has ``dJ_dlam >= 0``: this symbol, or the default
        control.
    steps : int, optional
        Runge-Kutta steps over the horizon. For None, capsyn chooses steps that meet `tolerance` in
        a step-doubling check on sampled states.
    tolerance : float
        Bound on the 99th percentile of the error of ``dJ_dlam``, relative to its largest possible
        size.
    precision : "double" or "single"
        Floating-point arithmetic of the solves that make policies.
    application_time : "now" or "search"
        When the online controller acts: at once ("now"), or when waiting and effect balance best
        ("search"). The solves that make policies always act at once.
    initial_duration, shrink, max_backtracks, descent
        Line search of the online controller: the first duration of an action [time unit], the
        factor that shortens it, how often it is shortened, and the share of the cost that the
        action must save.
    sample_time : float, optional
        Sample time of closed loops that are given no other [time unit]. Default: about a hundredth
        of the horizon; see `usual_sample_time`.
    sensitivity : "exact" or "first order", optional
        Only for a discrete-time problem: what replaces ``dJ_dlam``. It is the change of the cost
        [cost] when a symbol acts for one sample, and the default control follows. "exact", the
        default there, is this change. "first order" is ``rho_1 . (F(x, u_i) - F(x, u_default))``
        with the adjoint after one sample.

    Raises
    ------
    ProblemError
        A value that cannot be used, or both `gamma` and `alpha_d`.
    """

    gamma: float = -5.0
    alpha_d: float | None = None
    control_weight: Any = 0.0
    rule: str = "schedule"
    on_no_descent: str = "best"
    steps: int | None = None
    tolerance: float = 1e-6
    precision: str = "double"
    application_time: str = "now"
    initial_duration: float = 0.1
    shrink: float = 0.5
    max_backtracks: int = 4
    descent: float = 0.01
    sample_time: float | None = None
    sensitivity: str | None = None

    def __post_init__(self) -> None:
        keep(self, gamma=finite_number("gamma", self.gamma))
        if self.gamma > 0:
            raise ProblemError(f"`gamma` must be <= 0; got {self.gamma:g}")
        if self.alpha_d is not None:
            keep(self, alpha_d=finite_number("alpha_d", self.alpha_d))
            if self.alpha_d > 0:
                raise ProblemError(f"`alpha_d` must be <= 0; got {self.alpha_d:g}")
            if self.gamma != type(self).gamma:
                raise ProblemError("`alpha_d` must not be given together with `gamma`; got both")
        if numbers("control_weight", self.control_weight).ndim:
            weight = finite_array("control_weight", self.control_weight, 2)
            got = describe(self.control_weight)
            if not weight.size or not np.array_equal(weight, weight.T):
                raise ProblemError(
                    f"`control_weight` must be a number or a symmetric (m, m) matrix; got {got}"
                )
            if np.linalg.eigvalsh(weight).min() < -1e-12 * np.abs(weight).max():
                raise ProblemError(f"`control_weight` must be positive semidefinite; got {got}")
            keep(self, control_weight=tuple(map(tuple, weight.tolist())))
        else:
            keep(
                self, control_weight=finite_number("control_weight", self.control_weight, least=0.0)
            )
        one_of("rule", self.rule, ["schedule", "steepest"])
        one_of("on_no_descent", self.on_no_descent, ["best", "default"])
        one_of("precision", self.precision, ["double", "single"])
        if self.sensitivity is not None:
            one_of("sensitivity", self.sensitivity, ["exact", "first order"])
        if self.steps is not None:
            keep(self, steps=whole_number("steps", self.steps, least=1, most=MAX_STEPS))
        one_of("application_time", self.application_time, ["now", "search"])
        keep(
            self,
            max_backtracks=whole_number("max_backtracks", self.max_backtracks, least=0, most=20),
        )
        for name in ("tolerance", "initial_duration", "sample_time"):
            if name == "sample_time" and self.sample_time is None:
                continue
            keep(self, **{name: finite_number(name, getattr(self, name), above=0.0)})
        for name in ("shrink", "descent"):
            value = finite_number(name, getattr(self, name), least=0.0)
            if not value < 1 or (name == "shrink" and value == 0):
                raise ProblemError(f"`{name}` must be between 0 and 1; got {value:g}")
            keep(self, **{name: value})

    def efforts(self, values: np.ndarray) -> np.ndarray:
        """Return the control efforts ``u^T R u`` (N,) of the control vectors `values` (N, m).

        Raises
        ------
        ProblemError
            `control_weight` is a matrix of another size.
        """
        m = values.shape[1]
        weight = np.asarray(self.control_weight)
        if weight.ndim == 0:
            weight = weight * np.eye(m)
        if weight.shape != (m, m):
            raise ProblemError(
                f"`control_weight` must be a number or have shape ({m}, {m}); got {weight.shape}"
            )
        return np.einsum("si,ij,sj->s", values, weight, values)

    def sampled(self, horizon: float) -> SsacSettings:
        """Return the settings with the sample time of a horizon [time unit] if they say none."""
        if self.sample_time is not None:
            return self
        return dataclasses.replace(self, sample_time=usual_sample_time(horizon))

    def replaced(self, given: Any, said: bool) -> Any:
        """Return the settings of a changed problem, which are `given`, or these themselves.

        A sample time that was `said` stays unless they say one; else it is to be found again.
        """
        if given is self and not said:
            return dataclasses.replace(self, sample_time=None)
        if said and isinstance(given, SsacSettings) and given.sample_time is None:
            return dataclasses.replace(given, sample_time=self.sample_time)
        return given

    @property
    def period(self) -> float:
        """The sample time, of settings that say one, as those of problems and policies do."""
        assert self.sample_time is not None
        return self.sample_time

    def wanted_sensitivity(self, costs: np.ndarray) -> np.ndarray:
        """Return ``alpha_d`` (B,) [cost / time unit] of eq. (8) for predicted `costs` J0 (B,)."""
        if self.alpha_d is not None:
            return np.full(costs.shape, self.alpha_d)
        return self.gamma * costs

    def to_json(self) -> dict[str, Any]:
        """Return the settings as plain data; a sensitivity that is not said is left out."""
        data = dataclasses.asdict(self)
        return data if self.sensitivity else {k: v for k, v in data.items() if k != "sensitivity"}


def usual_sample_time(horizon: float) -> float:
    """Return a hundredth of a horizon [time unit], rounded down to 1, 2 or 5 times a power of 10.

    It is the sample time of a problem that says none.
    """
    mantissa, exponent = f"{horizon / 100:.12e}".split("e")
    first = max(digit for digit in (1, 2, 5) if digit <= float(mantissa))
    return float(f"{first}e{exponent}")
