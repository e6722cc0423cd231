"""The options of a closed loop, which trajectories and trials share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.modelling.alphabet import Outside
from capsyn.simulation.plant import MOST_SUBSTEPS
from capsyn.validation import (
    BACKENDS,
    describe,
    finite_number,
    keep,
    one_of,
    true_or_false,
    whole_number,
)


@dataclass(frozen=True)
class LoopOptions:
    """How a closed loop is run, with what can be checked before controller and plant are known.

    The fields are the arguments of `capsyn.simulate`, and of `capsyn.monte_carlo`, where
    disturbance, noise, delay, parameters and exogenous inputs may be what trials draw. Those of
    `capsyn.monte_carlo` alone: `executor`, a Dask client whose workers run the trials of a policy.

    Raises
    ------
    ProblemError
        A value that cannot be used.
    """

    duration: float = 20.0
    rate: float | None = None
    model: Any = None
    parameters: Any = None
    disturbance: Any = None
    noise: Any = None
    delay: Any = None
    min_dwell: float | None = None
    outside: Outside | None = None
    outside_at_once: bool | None = None
    target: Any = None
    stop_at_target: bool = False
    substeps: int | None = None
    seed: int = 0
    backend: str = "auto"
    threads: int | None = None
    executor: Any = None
    exogenous: Any = None
    avoid: Any = None
    stay_in: Any = None
    costs: Any = None

    def __post_init__(self) -> None:
        keep(self, seed=whole_number("seed", self.seed, least=0))
        keep(self, duration=finite_number("duration", self.duration, above=0.0))
        if self.rate is not None:
            keep(self, rate=finite_number("rate", self.rate, above=0.0))
        if not isinstance(self.parameters, Mapping | None):
            raise ProblemError(
                f"`parameters` must be a mapping of names; got {describe(self.parameters)}"
            )
        keep(self, parameters=dict(self.parameters or {}))
        if not isinstance(self.costs, Mapping | None):
            raise ProblemError(
                f"`costs` must be a mapping of names to functions; got {describe(self.costs)}"
            )
        keep(self, costs=dict(self.costs or {}))
        if self.min_dwell is not None:
            keep(self, min_dwell=finite_number("min_dwell", self.min_dwell, least=0.0))
        if self.outside_at_once is not None:
            true_or_false("outside_at_once", self.outside_at_once)
        if self.substeps is not None:
            most = MOST_SUBSTEPS
            keep(self, substeps=whole_number("substeps", self.substeps, least=1, most=most))
        one_of("backend", self.backend, BACKENDS)
        keep(self, threads=processors(self.threads))
