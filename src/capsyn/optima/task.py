"""What is optimised: a plant, what loops of it cost, and what changes of symbols wait for."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.discrete import charged_time, check_period
from capsyn.modelling.domain import Box
from capsyn.modelling.exogenous import exogenous_text, one_exogenous
from capsyn.modelling.problem import Problem
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import Switching, SwitchRules
from capsyn.modelling.targets import Target, target_program
from capsyn.modelling.transcription import transcribe, transcribe_target
from capsyn.optima.grid import MOST_AXES
from capsyn.policies.cut import cut_target
from capsyn.policies.policy import Policy
from capsyn.programs.model import Model, gathered_cost
from capsyn.programs.program import Program
from capsyn.simulation.closed_loop import Holds, warn_of_parts
from capsyn.simulation.plant import Plant, choose_substeps, plant_of
from capsyn.synthesis.synthesize import priced
from capsyn.validation import describe, finite_number


@dataclass(frozen=True, eq=False)
class Task:
    """What closed loops are to do at the least cost.

    It serves as ``model`` of `capsyn.simulate`, whose running cost is then what is optimised.
    """

    name: str
    model: Model  # at fixed exogenous inputs; its running cost is what a loop gathers
    domain: Box  # of the states
    alphabet: Alphabet
    default_control: np.ndarray  # (m,) [input units]
    target: Target | None
    time_unit: str
    objective: str  # what the cost is, in words
    stop: bool  # whether a loop ends in the target
    period: float  # sample time [time unit]
    efforts: np.ndarray  # (N,) what each symbol costs [cost / time unit]
    switches: np.ndarray  # (N + 1, N) what each change costs [cost], infinite: forbidden
    held: np.ndarray  # (N,) ints: samples that each is held once entered, at least 1
    switching: Switching | None  # with prices as numbers
    told: np.ndarray | None  # (k,) exogenous inputs, which stay

    @functools.cached_property
    def plant(self) -> Plant:
        """The plant."""
        return plant_of(lambda: None, self)

    @functools.cached_property
    def inside(self) -> Program:
        """Whether a loop ends in a state."""
        return target_program(self.target if self.stop else None, self.domain)

    @functools.cached_property
    def substeps(self) -> int:
        """Runge-Kutta steps per sample, as closed loops have them."""
        controls = np.vstack([self.alphabet.values, self.default_control])
        return choose_substeps(self.plant, controls, np.zeros((0, 1)), self.period)

    @property
    def remembers(self) -> bool:
        """Whether the best symbol depends on the one in force."""
        return bool(self.switches[:-1].any() or (self.held > 1).any())

    @property
    def prices(self) -> np.ndarray | None:
        """What each change costs (N, N); None where the symbol in force does not matter."""
        return self.switches[:-1] if self.remembers else None

    @property
    def rows(self) -> int:
        """Rows of values."""
        return int(self.held.sum()) if self.remembers else 1

    @property
    def tops(self) -> np.ndarray:
        """Rows of values (N,) where each symbol in force may be left."""
        return np.cumsum([0, *self.held[:-1]]) if self.remembers else np.zeros_like(self.held)

    @property
    def entries(self) -> np.ndarray:
        """Rows of values (N,) after a first sample of each symbol."""
        return self.tops + self.held - 1


def task_of(
    source: Any, rate: float | None, exogenous: Any, control_weight: Any, stop: bool
) -> Task:
    """Return the task of a problem, or of a policy with a model; see `capsyn.optimum`."""
    if not isinstance(source, (Problem, Policy)):
        raise ProblemError(
            f"`problem` must be a capsyn.Problem or a capsyn.Policy; got {describe(source)}"
        )
    if isinstance(source, Policy) and source.model is None:
        raise ProblemError("`problem` must be a policy with a model; this one has none")
    if source.domain.n > MOST_AXES:
        raise ProblemError(
            f"`problem` must have at most {MOST_AXES} states for a grid; got {source.domain.n}"
        )
    if source.delay:
        raise ProblemError(
            "`problem` must have no input delay; got one of "
            f"{source.delay:g} {source.time_unit}: replace(delay=0) says what it costs"
        )
    if source.exogenous is not None and exogenous is None:
        raise ProblemError(
            f"`exogenous` must fix what is told: {exogenous_text(source.exogenous)}; got None"
        )
    w = one_exogenous(exogenous, source.exogenous)
    model: Any = transcribe(source) if isinstance(source, Problem) else source.model
    switching = source.switching
    if isinstance(source, Problem) and switching is not None and switching.has_share:
        switching = priced(source, model)[0]
        source = source.replace(switching=switching)
    rules = SwitchRules.of(source)
    target = transcribe_target(source) if isinstance(source, Problem) else source.target
    if source.exogenous is not None:
        model, target = model.at(w), cut_target(target, source.space, source.domain.n, w)
    if stop and target is None:
        raise ProblemError("`stop_at_target` needs a target; there is none")
    period = _period(source, rate)
    check_period(model.sample_time, source.time_unit, "rate", period)
    charged = charged_time(model.sample_time, period)
    model, objective = _gathering(model, source.time_unit)
    alphabet = source.alphabet
    warn_of_parts(rules, period, source.time_unit)
    holds = Holds.of(rules, period)
    if (holds.inputs > 1).any():
        raise ProblemError(
            "`hold` must be times of symbols, not of inputs, for an optimum; got one of "
            f"'{alphabet.inputs[int(np.argmax(holds.inputs))]}'"
        )
    priced_switches = rules.prices[np.isfinite(rules.prices)].any()
    objective += ", and prices of switches" if priced_switches else ""
    efforts = SsacSettings(control_weight=control_weight).efforts(alphabet.values)
    objective += ", and effort" if efforts.any() else ""
    return Task(
        source.name, model, source.domain, alphabet, source.default_control, target,
        source.time_unit, objective, stop, period, efforts * (charged / period),
        rules.prices[:, :-1] * charged,
        np.maximum(holds.symbols[:-1], 1), switching, None if source.exogenous is None else w,
    )  # fmt: skip


def _period(source: Problem | Policy, rate: float | None) -> float:
    """Return the sample time [time unit] of loops at a rate, or of the source's settings."""
    if rate is not None:
        return 1 / finite_number("rate", rate, above=0.0)
    if source.settings is None:
        raise ProblemError("`rate` must be given for a policy without settings")
    return source.settings.period


def _gathering(model: Model, time_unit: str) -> tuple[Model, str]:
    """Return a model whose running cost is what loops gather, and that in words."""
    time_unit = time_unit if model.sample_time is None else "samples"
    cost = gathered_cost(model.running_cost, model.terminal_cost)
    if cost is model.running_cost:
        return model, f"running cost, over {time_unit}"
    return (
        dataclasses.replace(model, running_cost=cost),
        f"terminal cost, over {time_unit}, since there is no running cost",
    )
