"""Why a state has no finite solution: which part of the model is not finite, and where."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import bind_default
from capsyn.programs.builder import RANGES
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program

UNKNOWN = "check the model there, and whether `steps` and the horizon fit it"


@dataclass(frozen=True)
class Diagnosis:
    """What is not finite of the model that a controller is made of."""

    formulation: Formulation  # its settings with `steps`

    def defined(self, states: np.ndarray) -> np.ndarray:
        """Return whether rates, under every control, and running cost are finite at states (B, n).

        Where they are, and there is no finite solution, a gradient may be infinite.
        """
        model, x = self.formulation.model, states.T
        finite = np.isfinite(model.running_cost.evaluate(x)[0][0])
        for control in (self.formulation.default, *self.formulation.values):
            rates = model.dynamics.evaluate(x, control[:, None])[0]
            finite &= np.isfinite(rates).all(axis=0)
        return np.asarray(finite)

    def why(self, state: Sequence[float]) -> str:
        """Return what is not finite at a state (n,), or in its prediction, in one line.

        Values are looked at before slopes: of dynamics and costs there, then along the prediction.
        """
        return _why_not_finite(self.formulation, state)


def _why_not_finite(formulation: Formulation, state: Sequence[float]) -> str:
    model, steps = formulation.model, formulation.settings.steps
    x = np.array(state, dtype=float)
    own = model.prediction
    law = formulation.default if own is None else own.law.evaluate(x[:, None])[0][:, 0]
    parts: list[tuple[str, Program, tuple[Any, ...]]] = [
        *(("dynamics", model.dynamics, (control,)) for control in (law, *formulation.values)),
        ("running_cost", model.running_cost, ()),
    ]
    places = _prediction(formulation, x)
    names = formulation.domain.names

    def found(slope: bool) -> Iterator[str]:
        for time, place in places:
            for name, program, control in parts[:1] + parts[-1:] if time else parts:
                what = singular(program, place, *control)
                if what is not None and what.slope == slope:
                    yield _told(name, what, names, (*place, *np.ravel(control)), time)
        if len(places) - 1 == steps:
            what = singular(model.terminal_cost.first, places[-1][1])
            if what is not None and what.slope == slope:
                yield _told("terminal_cost", what, names, (*places[-1][1],), formulation.horizon)

    for slope in (False, True):
        for text in found(slope):
            return text
    if len(places) - 1 != steps:
        remedy = "more `steps`, or a shorter horizon"
        if model.sample_time is not None:
            remedy = "a shorter horizon"
        return (
            f"the prediction grows without bound, {places[-1][0]:.3g} after its start: take "
            + remedy
        )
    return UNKNOWN


def _prediction(formulation: Formulation, x: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Return times and states of the prediction from a state, up to the last that is finite."""
    steps = formulation.settings.steps
    assert steps is not None
    step = bind_default(formulation.model, formulation.default).step
    dt, places = formulation.horizon / steps, [(0.0, x)]
    for k in range(steps):
        end, cost = step.evaluate(places[-1][1][:, None], [dt])
        if not (np.isfinite(end).all() and np.isfinite(cost).all()):
            break
        places.append(((k + 1) * dt, end[:, 0]))
    return places


def _told(
    name: str, what: Singular, names: Sequence[str], values: Sequence[float], time: float
) -> str:
    """Return one line of what is not finite; `values` are those of all inputs of the program."""
    words = [*names, *(f"u[{k}]" for k in range(len(values) - len(names)))]
    place = 1 if what.name == "div" else 0
    operand, number = what.operands[place], what.numbers[place]
    used = what.inputs[place] or what.inputs[0]
    of = " and ".join(f"`{words[k]}`" for k in used)
    if operand >= len(values):
        of = f"an expression of {of} that is {number:.6g}"
    where = ", ".join(f"{words[k]} = {values[k]:.6g}" for k in used)
    operation = "a quotient by" if what.name == "div" else f"{what.name} of"
    component = f"{name}[{what.result}]" if name == "dynamics" else name
    later = f", {time:.3g} after the start of the prediction" if time else ""
    return (
        f"{'the gradient of ' if what.slope else ''}{component} is not finite: {operation} {of}, "
        f"at {where}{later}"
    )


@dataclass(frozen=True)
class Singular:
    """An operation of a program whose value, or slope, is not finite at a point."""

    result: int  # the first component of the outputs that it is part of
    name: str  # of the operation
    operands: tuple[int, ...]  # its operands
    numbers: tuple[float, ...]  # their values there
    inputs: tuple[tuple[int, ...], ...]  # the input components that each operand depends on
    slope: bool  # whether it is the slope only


def singular(program: Program, *inputs: Any) -> Singular | None:
    """Return the first operation whose value is not finite at a point, else whose slope is not.

    The inputs are those of the program, (size,) each.
    """
    values: list[float] = [float(number) for port in inputs for number in np.asarray(port)]
    of: list[frozenset[int]] = [frozenset([k]) for k in range(len(values))]
    found: list[tuple[int, bool]] = []
    with np.errstate(all="ignore"):
        for k, (name, *operands) in enumerate(program.instructions, start=len(values)):
            if name == "const":
                values.append(operands[0])
                of.append(frozenset())
                continue
            mine = [np.float64(values[i]) for i in operands]
            values.append(float(OPERATIONS[name].numpy(*mine)))
            of.append(frozenset().union(*(of[i] for i in operands)))
            if of[-1] and np.isfinite(mine).all():
                if not np.isfinite(values[-1]):
                    found.append((k, False))
                elif _steep(name, mine):
                    found.append((k, True))
    for k, slope in sorted(found, key=lambda each: each[1]):
        name, *operands = program.instructions[k - program.input_count]
        result = _first_result(program, k)
        if result is not None and (slope or not np.isfinite(values[program.results[result]])):
            numbers = tuple(values[i] for i in operands)
            parts = tuple(tuple(sorted(of[i])) for i in operands)
            return Singular(result, name, tuple(operands), numbers, parts, slope)
    return None


def _steep(name: str, operands: Sequence[float]) -> bool:
    """Return whether the slope of an operation is infinite."""
    if name in RANGES:
        return operands[0] in RANGES[name]
    if name == "pow":
        return operands[0] == 0 and 0 < operands[1] < 1
    return name == "hypot" and not any(operands)


def _first_result(program: Program, value: int) -> int | None:
    """Return the first result that a value is part of."""
    part = {value}
    for k, (name, *operands) in enumerate(program.instructions, start=program.input_count):
        if name != "const" and not part.isdisjoint(operands):
            part.add(k)
    return next((i for i, k in enumerate(program.results) if k in part), None)
