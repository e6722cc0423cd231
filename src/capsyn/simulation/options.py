"""The options of a closed loop, which trajectories and trials share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.modelling.alphabet import Outside
from capsyn.simulation.plant import MOST_SUBSTEPS
from capsyn.validation import BACKENDS, describe, finite_number, one_of, whole_number


@dataclass(frozen=True)
class LoopOptions:
    """How a closed loop is run, with what can be checked before controller and plant are known.

    Parameters
    ----------
    duration : float
        Time to simulate [s], rounded to whole samples.
    rate : float, optional
        Samples per second [1 / s]. Default: 1 over the ``sample_time`` of the controller's
        settings.
    model : Problem, Policy or callable ``(x, u) -> xdot`` or ``(x, u, p) -> xdot``, optional
        Another plant than the controller's own model.
    parameters : mapping of name to float, or to what trials draw
        The components of `p`, in order; None is an empty one.
    disturbance : (n,), what trials draw, or callable ``time -> (n,)``, optional
        Added to the rates of the states [state units / s].
    noise : float, (n,) or what trials draw, optional
        Standard deviation of Gaussian noise on the measured states [state units].
    delay : float or what trials draw
        Time from a sample until its control acts [s].
    min_dwell : float, optional
        Least time between switches [s]. Default: the controller's own.
    outside : "error", "nearest" or symbol, optional
        What a state outside the domain gets. Default: the policy's own rule.
    target : Ball, Box or callable ``x -> true or false``, optional
        Whose reaching is noted. Default: the controller's own, else the plant's.
    stop_at_target : bool
        Whether a trajectory ends there.
    substeps : int, optional
        Runge-Kutta steps per sample. Default: as many as step doubling asks for.
    seed : int
        Of everything that is drawn.
    backend : "auto", "c" or "numpy"
        How policies are simulated.
    threads : int
        Threads that simulate; None is one per processor.
    executor : dask.distributed.Client, optional
        A cluster whose workers run the trials of a policy.

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
    delay: Any = 0.0
    min_dwell: float | None = None
    outside: Outside | None = None
    target: Any = None
    stop_at_target: bool = False
    substeps: int | None = None
    seed: int = 0
    backend: str = "auto"
    threads: int | None = None
    executor: Any = None

    def __post_init__(self) -> None:
        def keep(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        keep("seed", whole_number("seed", self.seed, least=0))
        keep("duration", finite_number("duration", self.duration, above=0.0))
        if self.rate is not None:
            keep("rate", finite_number("rate", self.rate, above=0.0))
        if not isinstance(self.parameters, Mapping | None):
            raise ProblemError(
                f"`parameters` must be a mapping of names; got {describe(self.parameters)}"
            )
        keep("parameters", dict(self.parameters or {}))
        if self.min_dwell is not None:
            keep("min_dwell", finite_number("min_dwell", self.min_dwell, least=0.0))
        if self.substeps is not None:
            keep("substeps", whole_number("substeps", self.substeps, least=1, most=MOST_SUBSTEPS))
        one_of("backend", self.backend, BACKENDS)
        keep("threads", processors(self.threads))
