"""Makes programs: collects operations, folds, simplifies, drops what nobody needs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Instruction, Ports, Program


class ProgramBuilder:
    """Collects operations into a `Program`, each distinct one once.

    Constants are folded and neutral elements removed (``0 * x`` is 0 here, as in CasADi). A
    selection or a 0/1 factor is moved outwards through products, quotients and sums of the same
    condition, ``select(c, y) * p -> select(c, y * p)``: in a derivative this keeps the branch that
    is not taken, where `p` may be infinite or NaN, from leaking into the result.
    """

    def __init__(self) -> None:
        self._inputs = 0
        self._instructions: list[Instruction] = []
        self._known: dict[Instruction, int] = {}
        self._constants: dict[int, float] = {}

    def input(self) -> int:
        """Return the value of the next input component; all inputs come before any operation."""
        if self._instructions:
            raise ValueError("inputs must be declared before operations")
        self._inputs += 1
        return self._inputs - 1

    def constant(self, number: float) -> int:
        """Return the value of a constant."""
        number = float(number)
        if math.isnan(number):
            raise ValueError("a constant of the model is NaN")
        value = self._emit(("const", number + 0.0))
        self._constants[value] = number + 0.0
        return value

    def apply(self, name: str, *operands: int) -> int:
        """Return the value of an operation on earlier values, simplified."""
        if all(k in self._constants for k in operands):
            numbers = [self._constants[k] for k in operands]
            with np.errstate(all="ignore"):
                folded = float(OPERATIONS[name].numpy(*map(np.float64, numbers)))
            if not math.isnan(folded):
                return self.constant(folded)
        rule = _SIMPLIFICATIONS.get(name)
        value = rule(self, *operands) if rule else None
        if value is not None:
            return value
        if name in ("add", "mul", "eq", "ne", "and", "or"):
            operands = tuple(sorted(operands))
        return self._emit((name, *operands))

    def call(self, program: Program, *inputs: Sequence[int]) -> list[int]:
        """Return the results of another program on earlier values, one sequence per input."""
        values = [value for port in inputs for value in port]
        for name, *operands in program.instructions:
            if name == "const":
                values.append(self.constant(operands[0]))
            else:
                values.append(self.apply(name, *(values[k] for k in operands)))
        return [values[k] for k in program.results]

    def build(self, name: str, inputs: Ports, outputs: Ports, results: Sequence[int]) -> Program:
        """Return the program of the operations that the `results` need."""
        first, needed = self._inputs, set(results)
        for k in range(len(self._instructions) - 1, -1, -1):
            op, *operands = self._instructions[k]
            if first + k in needed and op != "const":
                needed.update(operands)
        number = {k: k for k in range(first)}
        kept: list[Instruction] = []
        for k, (op, *operands) in enumerate(self._instructions):
            if first + k in needed:
                number[first + k] = first + len(kept)
                kept.append((op, *operands) if op == "const" else (op, *map(number.get, operands)))
        return Program(name, inputs, outputs, tuple(kept), tuple(number[k] for k in results))

    def _emit(self, instruction: Instruction) -> int:
        if instruction not in self._known:
            self._known[instruction] = self._inputs + len(self._instructions)
            self._instructions.append(instruction)
        return self._known[instruction]

    def _definition(self, value: int) -> Instruction:
        return self._instructions[value - self._inputs] if value >= self._inputs else ("input",)

    def _number(self, value: int) -> float | None:
        return self._constants.get(value)

    def _selection(self, value: int) -> tuple[int, int | None] | None:
        """Return (condition, selected) of a selection; selected is None for a 0/1 value."""
        name, *operands = self._definition(value)
        if name == "select":
            return operands[0], operands[1]
        if name in OPERATIONS and OPERATIONS[name].boolean:
            return value, None
        return None

    def _sum(self, name: str, a: int, b: int) -> int | None:
        one, two = self._selection(a), self._selection(b)
        if one is None or two is None or one[0] != two[0]:
            return None
        (condition, left), (_, right) = one, two
        if left is None or right is None:
            return None
        return self.apply("select", condition, self.apply(name, left, right))

    def _add(self, a: int, b: int) -> int | None:
        if self._number(a) == 0:
            return b
        if self._number(b) == 0:
            return a
        return self._sum("add", a, b)

    def _sub(self, a: int, b: int) -> int | None:
        if self._number(b) == 0:
            return a
        if self._number(a) == 0:
            return self.apply("neg", b)
        return self._sum("sub", a, b)

    def _mul(self, a: int, b: int) -> int | None:
        for one, two in ((a, b), (b, a)):
            number = self._number(one)
            if number == 0:
                return self.constant(0.0)
            if number == 1:
                return two
            if number == -1:
                return self.apply("neg", two)
        for one, two in ((a, b), (b, a)):
            selection = self._selection(one)
            if selection:
                condition, chosen = selection
                product = two if chosen is None else self.apply("mul", chosen, two)
                return self.apply("select", condition, product)
        return None

    def _div(self, a: int, b: int) -> int | None:
        if self._number(b) == 1:
            return a
        if self._number(a) == 0:
            return self.constant(0.0)
        selection = self._selection(a)
        if selection:
            condition, chosen = selection
            numerator = self.constant(1.0) if chosen is None else chosen
            return self.apply("select", condition, self.apply("div", numerator, b))
        return None

    def _neg(self, a: int) -> int | None:
        name, *operands = self._definition(a)
        if name == "neg":
            return operands[0]
        selection = self._selection(a)
        if selection and selection[1] is not None:
            return self.apply("select", selection[0], self.apply("neg", selection[1]))
        return None

    def _choose(self, condition: int, value: int) -> int | None:
        number = self._number(condition)
        if number is not None:
            return value if number != 0 else self.constant(0.0)
        if self._number(value) == 0:
            return value
        selection = self._selection(value)
        if selection and selection[0] == condition:
            return value
        return None


_SIMPLIFICATIONS: Mapping[str, Callable[..., int | None]] = {
    "add": ProgramBuilder._add,
    "sub": ProgramBuilder._sub,
    "mul": ProgramBuilder._mul,
    "div": ProgramBuilder._div,
    "neg": ProgramBuilder._neg,
    "select": ProgramBuilder._choose,
}


def bind(program: Program, **constants: Any) -> Program:
    """Return the program with some inputs fixed to constants, folded and simplified."""
    unknown = set(constants) - {name for name, _ in program.inputs}
    if unknown:
        raise ValueError(f"'{program.name}' has no input '{min(unknown)}'")
    builder = ProgramBuilder()
    remaining = tuple(port for port in program.inputs if port[0] not in constants)
    free = {name: [builder.input() for _ in range(size)] for name, size in remaining}
    values: list[Sequence[int]] = []
    for name, size in program.inputs:
        if name in free:
            values.append(free[name])
        else:
            numbers = np.asarray(constants[name], dtype=float).reshape(size)
            values.append([builder.constant(number) for number in numbers])
    results = builder.call(program, *values)
    return builder.build(program.name, remaining, program.outputs, results)


def restricted(
    program: Program, inputs: Ports, outputs: Ports, last: Mapping[str, np.ndarray]
) -> Program:
    """Return the program of the first components of its ports, as many as `inputs`, `outputs` say.

    The other components of an input are the constants `last` of its name, and 0 without any.
    """
    builder, values = ProgramBuilder(), []
    free = [[builder.input() for _ in range(size)] for _, size in inputs]
    for own, (name, size) in zip(free, program.inputs):
        rest = last.get(name, np.zeros(size - len(own)))
        values.append([*own, *(builder.constant(number) for number in rest[: size - len(own)])])
    results, kept, start = builder.call(program, *values), [], 0
    for (_, size), (_, wanted) in zip(program.outputs, outputs):
        kept += results[start : start + wanted]
        start += size
    return builder.build(program.name, inputs, outputs, kept)


def selected(program: Program, results: Sequence[int]) -> Program:
    """Return the program of some components of a program's one output, of what they need alone."""
    ((name, _),) = program.outputs
    builder = ProgramBuilder()
    inputs = [[builder.input() for _ in range(size)] for _, size in program.inputs]
    values = builder.call(program, *inputs)
    ports: Ports = ((name, len(results)),)
    return builder.build(program.name, program.inputs, ports, [values[k] for k in results])


def with_sums(program: Program, factors: Sequence[Sequence[float]]) -> Program:
    """Return a program with weighted sums (J, K) of its one output's components (K) after them."""
    ((name, size),) = program.outputs
    builder = ProgramBuilder()
    values = builder.call(
        program, *([builder.input() for _ in range(count)] for _, count in program.inputs)
    )
    results = list(values)
    for row in factors:
        total = builder.constant(0.0)
        for factor, value in zip(row, values):
            term = builder.apply("mul", builder.constant(factor), value)
            total = builder.apply("add", total, term)
        results.append(total)
    ports: Ports = ((name, size + len(factors)),)
    return builder.build(program.name, program.inputs, ports, results)


RANGES = {"sqrt": (0.0, np.inf), "asin": (-1.0, 1.0), "acos": (-1.0, 1.0)}
"""Closed ranges, at whose ends slopes are infinite but values are not; ``pow`` is one more, of
bases >= 0, where its exponent is no whole number."""
_POSITIVE = {"fabs", "sqrt", "exp", "cosh", "hypot", "acosh", "acos"}


def extended(program: Program) -> Program:
    """Return a program whose operations outside their range have the value at its nearest end.

    ``sqrt(a)`` becomes that of 0 where a is negative, which is what a model is where the step of
    an integration oversteps the edge of where it is defined: a tank that has run empty. NaN stays
    NaN. A program whose operations cannot leave their range is returned as it is.
    """
    positive = _not_negative(program)
    places = [_range(program, k, positive) for k in range(len(program.instructions))]
    if not any(places):
        return program
    builder = ProgramBuilder()
    values = [builder.input() for _ in range(program.input_count)]
    for place, (name, *operands) in zip(places, program.instructions):
        if name == "const":
            values.append(builder.constant(operands[0]))
            continue
        mine = [values[k] for k in operands]
        if place:
            low, high = place
            mine[0] = _at_least(builder, mine[0], low)
            if high < np.inf:  # at most it
                negative = _at_least(builder, builder.apply("neg", mine[0]), -high)
                mine[0] = builder.apply("neg", negative)
        values.append(builder.apply(name, *mine))
    results = [values[k] for k in program.results]
    return builder.build(program.name, program.inputs, program.outputs, results)


def loop_programs(
    dynamics: Program, running_cost: Program, discrete: bool
) -> tuple[Program, Program]:
    """Return dynamics and running cost as closed loops take them: rates `extended`, a map itself.

    A map has no states between samples that could overstep where it is defined.
    """
    if discrete:
        return dynamics, running_cost
    return extended(dynamics), extended(running_cost)


def _at_least(builder: ProgramBuilder, value: int, least: float) -> int:
    """Return a value where it is not below `least`, which it is there; NaN, unlike by fmax, is."""
    bound = builder.constant(least)
    below = builder.apply("lt", value, bound)
    own = builder.apply("select", builder.apply("not", below), value)
    return builder.apply("add", own, builder.apply("select", below, bound))


def _range(program: Program, k: int, positive: Sequence[bool]) -> tuple[float, float] | None:
    """Return the range of the first operand of an instruction, None where it cannot leave it."""
    name, *operands = program.instructions[k]
    if name == "pow":
        exponent = _constant(program, operands[1])
        place = None if exponent is None or exponent == np.rint(exponent) else (0.0, np.inf)
    else:
        place = RANGES.get(name)
    if place is None or (place[0] == 0 and positive[operands[0]]):
        return None
    return place


def _constant(program: Program, value: int) -> float | None:
    k = value - program.input_count
    if k >= 0 and program.instructions[k][0] == "const":
        return float(program.instructions[k][1])
    return None


def _not_negative(program: Program) -> list[bool]:
    """Return which values cannot be negative, as far as their operations show."""
    positive = [False] * program.input_count
    for name, *operands in program.instructions:
        if name == "const":
            positive.append(operands[0] >= 0)
            continue
        mine = [positive[k] for k in operands]
        positive.append(
            name in _POSITIVE
            or OPERATIONS[name].boolean
            or (name == "mul" and operands[0] == operands[1])
            or (name in ("add", "mul", "div", "fmin") and all(mine))
            or (name == "fmax" and any(mine))
            or (name == "select" and mine[1])
        )
    return positive
