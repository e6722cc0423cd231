"""The system that a controller is tried on: a policy's own model, or another."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError, warn
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.discrete import charged_time, check_period, whole_samples
from capsyn.modelling.domain import Box
from capsyn.modelling.exogenous import joined
from capsyn.modelling.problem import Problem
from capsyn.modelling.targets import Target
from capsyn.modelling.transcription import transcribe, transcribe_target, user_program
from capsyn.policies.policy import Policy
from capsyn.programs.builder import loop_programs
from capsyn.programs.continuity import rate_kinks
from capsyn.programs.model import Model
from capsyn.programs.program import Ports, Program
from capsyn.programs.step_doubling import KINKED, fewest_steps
from capsyn.validation import describe

SAMPLES = 256
"""Random states at which `choose_substeps` tries steps."""
ACCURACY = 1e-9
"""Error that `choose_substeps` allows, in widths of the domain per time unit."""
MOST_SUBSTEPS = 4096
"""Most Runge-Kutta steps per sample."""
LADDER = tuple(1 << k for k in range(MOST_SUBSTEPS.bit_length() - 1))
"""Steps that `choose_substeps` tries; it compares each with twice as many."""
COST_ACCURACY = 100.0
"""Error of the cost of a period, relative to what periods cost, that it allows in accuracies."""
TRIED = 16
"""Steps from which on an error that does not fall ends its search."""
PIECES = 8
"""Parts of a period between which kinks are looked for."""
PERCENTILE = 95
"""Percentile, over the states, of the error that counts there."""


@dataclass(frozen=True)
class Plant:
    """A system for closed loops, as programs."""

    dynamics: Program  # (x, u) -> xdot, or (x, u, p) -> xdot: its rates [state unit / time unit],
    # or of a map, which has a `sample_time`, the state one sample later [state unit]
    running_cost: Program  # x -> cost that a trajectory gathers [cost / time unit, or / sample]
    terminal_cost: Program  # x -> (cost of the state where it ends, gradient)
    domain: Box  # names and units of its states
    alphabet: Alphabet  # names and units of its inputs, and the controls that steps are chosen for
    default: np.ndarray  # (m,) control until a first one arrives [input units]
    target: Target | None  # what arriving means
    parameters: tuple[str, ...] = ()  # names of the components of p
    time_unit: str = "s"  # what its rates are per
    delay: float = 0.0  # input delay that is known [time unit]
    exogenous: Box | None = None  # names and units of what it is told, after the states in x
    sample_time: float | None = None  # of a map [time unit]; None: its dynamics are rates

    @functools.cached_property
    def in_loops(self) -> tuple[Program, Program]:
        """Dynamics and running cost as closed loops take them; see `loop_programs`."""
        return loop_programs(self.dynamics, self.running_cost, self.sample_time is not None)

    @functools.cached_property
    def space(self) -> Box:
        """The domain, and after its axes those of the exogenous inputs, whose rates are 0."""
        return joined(self.domain, self.exogenous)

    @functools.cached_property
    def kinks(self) -> Program:
        """Conditions (x, u) or (x, u, p) that are constant where rates and cost are smooth."""
        return rate_kinks(*self.in_loops)

    @property
    def told(self) -> int:
        """Number of exogenous inputs."""
        return 0 if self.exogenous is None else self.exogenous.n

    @property
    def states(self) -> int:
        """Number of states without the exogenous inputs."""
        return self.n - self.told

    @property
    def n(self) -> int:
        """Number of components of x: states, and after them exogenous inputs."""
        return dict(self.dynamics.inputs)["x"]

    @property
    def m(self) -> int:
        """Number of inputs."""
        return dict(self.dynamics.inputs)["u"]

    def rates(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the rates (n, B) of states (n, B) under controls (m, B), parameters (P, B)."""
        inputs = (x, u, p) if self.parameters else (x, u)
        return self.in_loops[0].evaluate(*inputs)[0]

    def advance(
        self,
        x: np.ndarray,
        cost: np.ndarray,
        u: np.ndarray,
        p: np.ndarray,
        push: np.ndarray,
        duration: np.ndarray,
        substeps: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return states (n, B) and costs (B,) after durations (B,) of `substeps` steps each.

        They are those of the classical Runge-Kutta method under controls (m, B), parameters (P, B),
        and a push (n, B) that is added to the rates; durations are in the plant's time unit. Those
        of a map are so many samples each, or 0, and the push is added after each.
        """
        if self.sample_time is not None:
            return self._iterated(x, cost, u, p, push, duration > 0, substeps)

        def slope(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return self.rates(y, u, p) + push, self.in_loops[1].evaluate(y)[0][0]

        with np.errstate(all="ignore"):
            h = duration / substeps
            for _ in range(substeps):
                k1, c1 = slope(x)
                k2, c2 = slope(x + 0.5 * h * k1)
                k3, c3 = slope(x + 0.5 * h * k2)
                k4, c4 = slope(x + h * k3)
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                cost = cost + h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
        return x, cost

    def _iterated(
        self,
        x: np.ndarray,
        cost: np.ndarray,
        u: np.ndarray,
        p: np.ndarray,
        push: np.ndarray,
        moves: np.ndarray,
        samples: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return states (n, B) and costs (B,) of those that move after so many samples of a map."""
        with np.errstate(all="ignore"):
            for _ in range(samples):
                cost = np.where(moves, cost + self.running_cost.evaluate(x)[0][0], cost)
                x = np.where(moves, self.rates(x, u, p) + push, x)
        return x, cost

    def charged_time(self, period: float) -> float:
        """Return what a cost per time unit counts over a sample; see `charged_time`."""
        return charged_time(self.sample_time, period)

    def check_loop(self, name: str, period: float, substeps: int | None) -> None:
        """Raise where a map's loop is asked for another sample time, as `name`, or for substeps."""
        check_period(self.sample_time, self.time_unit, name, period)
        if self.sample_time is not None and substeps is not None:
            raise ProblemError(
                "`substeps` must be left out: the model is a map, which takes one step a sample; "
                f"got {substeps}"
            )


def plant_of(controller: Any, model: Any = None, parameters: Sequence[str] = ()) -> Plant:
    """Return the plant for a controller: its own model where no other is given.

    Costs and names of a model that is a function are those of the controller's own, and it is a map
    where that is one. It takes w where the controller is told exogenous inputs, and `p` only where
    there are names of `parameters`, which the controller is not told.

    Raises
    ------
    ProblemError
        There is no model, or its dimensions or its unit of time do not fit the controller.
    """
    if not callable(controller):
        raise ProblemError(
            "`controller` must be a Policy, an OnlineController or a function of time and states; "
            f"got {describe(controller)}"
        )
    function = model if callable(model) and not isinstance(model, Policy) else None
    source = controller if model is None or function else model
    programs = transcribe(source) if isinstance(source, Problem) else getattr(source, "model", None)
    if not isinstance(programs, Model):
        if model is not None and not function:
            raise ProblemError(
                "`model` must be a Problem, a Policy with a model or a function of x and u; "
                f"got {describe(model)}"
            )
        raise ProblemError(
            "`model` must be a Problem, or a Policy with a model, for a controller without one"
        )
    target = transcribe_target(source) if isinstance(source, Problem) else source.target
    plant = Plant(
        programs.dynamics,
        programs.running_cost,
        programs.terminal_cost,
        source.domain,
        source.alphabet,
        source.default_control,
        target,
        time_unit=source.time_unit,
        delay=getattr(source, "delay", 0.0),
        exogenous=getattr(source, "exogenous", None),
        sample_time=programs.sample_time,
    )
    if function:
        inputs: Ports = (("x", plant.n), ("u", plant.m))
        inputs += (("p", len(parameters)),) if parameters else ()
        dynamics = user_program(
            "model",
            function,
            inputs,
            (("xdot", plant.n),),
            told=plant.told,
            rates=True,
            parameters=True,
            discrete=plant.sample_time is not None,
        )
        used = dynamics.used_inputs()
        for k, name in enumerate(parameters):
            if plant.n + plant.m + k not in used:
                raise ProblemError(
                    f"`parameters` must all be used by the model; p[{k}] ('{name}') is not"
                )
        plant = dataclasses.replace(plant, dynamics=dynamics, parameters=tuple(parameters))
    elif parameters:
        raise ProblemError(
            "`parameters` need a `model` that is a function of x, u and p; got "
            + ("none" if model is None else describe(model, 40))
            + ("; what the controller is told is `exogenous`" if plant.told else "")
        )
    _check_fit(controller, plant)
    return plant


def _check_fit(controller: Any, plant: Plant) -> None:
    """Raise unless a controller that has dimensions, and a unit of time, has those of a plant."""
    domain, alphabet = getattr(controller, "domain", None), getattr(controller, "alphabet", None)
    told = getattr(controller, "exogenous", None)
    if domain is not None and alphabet is not None:
        sizes = (domain.n, alphabet.m, 0 if told is None else told.n)
        if sizes != (plant.states, plant.m, plant.told):
            raise ProblemError(
                f"`model` must have {_sizes(*sizes)} like the controller; got "
                + _sizes(plant.states, plant.m, plant.told)
            )
    own = getattr(controller, "time_unit", plant.time_unit)
    if own != plant.time_unit:
        raise ProblemError(
            f"`model` must count time in {own} like the controller; got {plant.time_unit}"
        )


def _sizes(n: int, m: int, told: int) -> str:
    exogenous = f" and {told} exogenous" if told else ""
    return f"{n} state(s) and {m} input(s){exogenous}"


def choose_substeps(
    plant: Plant,
    controls: np.ndarray,
    parameters: np.ndarray,
    period: float,
    accuracy: float = ACCURACY,
) -> int:
    """Return the fewest Runge-Kutta steps per sample whose error is at most `accuracy`.

    The error is the 95th percentile, over seeded states of the domain under every control
    (N, m), with parameters (P, K) in turn, of the difference that twice the steps make after one
    period [time unit]: to the state in widths of the domain, or if that is more, to the cost
    relative to the mean of all states, over `COST_ACCURACY`. It counts `KINKED` where the model
    has a kink on the way. Where it stops falling (a jump in the dynamics), the best steps so far
    are taken. Of a map they are the samples in the period, which must be whole.
    """
    if plant.sample_time is not None:
        return whole_samples("period", period, plant.sample_time, least=1)
    states = plant.space.sample(SAMPLES, 0).T
    u = controls[np.arange(SAMPLES) % len(controls)].T
    p = parameters[:, np.arange(SAMPLES) % parameters.shape[1]]
    push, cost, time = np.zeros_like(states), np.zeros(SAMPLES), np.full(SAMPLES, period)
    weight = np.where(_meets_kink(plant, states, u, p, time), KINKED, 1.0)

    @functools.cache
    def end(substeps: int) -> tuple[np.ndarray, np.ndarray]:
        x, paid = plant.advance(states, cost, u, p, push, time, substeps)
        return x / plant.space.widths[:, None], paid

    def error_of(substeps: int) -> float:
        (coarse, paid), (fine, exact) = end(substeps), end(2 * substeps)
        with np.errstate(all="ignore"):
            usual = np.abs(exact[np.isfinite(exact)]).mean() if np.isfinite(exact).any() else 0.0
            errors = np.abs(fine - coarse).max(axis=0)
            if usual > 0:
                errors = np.maximum(errors, np.abs(exact - paid) / usual * (period / COST_ACCURACY))
            finite = np.isfinite(errors)
            errors[~finite] = np.inf
            errors = (weight * errors)[finite | np.isfinite(fine).all(axis=0)]
            return float(np.percentile(errors, PERCENTILE)) if errors.size else np.inf

    best, least = fewest_steps(LADDER, error_of, accuracy * period, TRIED)
    if least <= accuracy * period:
        return best
    warn(
        f"the closed loop is integrated with {best} steps per sample, to {least:.2g} widths of "
        f"the domain, not {accuracy * period:.2g}: give `substeps`, or a higher `rate`"
    )
    return best


def _meets_kink(
    plant: Plant, x: np.ndarray, u: np.ndarray, p: np.ndarray, period: np.ndarray
) -> np.ndarray:
    """Return where (B,) the model has a kink between states (n, B) and those a period later."""
    kinks = plant.kinks
    inputs = (u, p) if plant.parameters else (u,)
    met = np.zeros(x.shape[1], dtype=bool)
    if not kinks.used_inputs():
        return met
    still, none = np.zeros_like(x), np.zeros(x.shape[1])
    (first,) = kinks.evaluate(x, *inputs)
    for _ in range(PIECES):
        x, _ = plant.advance(x, none, u, p, still, period / PIECES, 1)
        with np.errstate(all="ignore"):
            met |= (kinks.evaluate(x, *inputs)[0] != first).any(axis=0)
    return met
