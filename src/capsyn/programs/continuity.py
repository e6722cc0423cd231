"""Where a program may jump, or have a kink: the conditions that decide which side it is on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Set
from fractions import Fraction

from capsyn.programs.builder import ProgramBuilder
from capsyn.programs.expansion import Polynomial, polynomials
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.patterns import alternatives, instruction
from capsyn.programs.program import Program

LOGIC = ("not", "and", "or")


def jump_conditions(program: Program) -> Program:
    """Return a program of the same inputs, constant over boxes where `program` is continuous.

    Its outputs are the conditions of its selections, but for those between values that are equal
    where the condition changes, and what tells on which side of a jump a floor, a sign or an angle
    is. A program without any has the one output 0.
    """
    return _conditions(program, _meeting_selections(program), kinks=False)


def kink_conditions(program: Program) -> Program:
    """Return a program of the same inputs, constant over boxes where `program` is smooth.

    Its outputs are those of `jump_conditions`, with the conditions of all selections, and what
    tells on which side of a kink an absolute value, a minimum or a maximum is.
    """
    return _conditions(program, frozenset(), kinks=True)


def rate_kinks(dynamics: Program, running_cost: Program) -> Program:
    """Return the `kink_conditions` of dynamics and running cost, of the dynamics' inputs."""
    builder = ProgramBuilder()
    inputs = [[builder.input() for _ in range(size)] for _, size in dynamics.inputs]
    results = builder.call(dynamics, *inputs) + builder.call(running_cost, inputs[0])
    outputs = (*dynamics.outputs, *running_cost.outputs)
    return kink_conditions(builder.build("rates", dynamics.inputs, outputs, results))


def _conditions(program: Program, meeting: Set[int], kinks: bool) -> Program:
    """Return the program of `jump_conditions`, or with `kinks` that of `kink_conditions`."""
    builder = ProgramBuilder()
    values = [builder.input() for _ in range(program.input_count)]
    sides: list[int] = []
    apply, constant = builder.apply, builder.constant
    used = set(program.results)
    for k, (name, *operands) in enumerate(program.instructions, start=program.input_count):
        if name == "const":
            values.append(constant(operands[0]))
            continue
        mine = [values[i] for i in operands]
        values.append(apply(name, *mine))
        if name not in LOGIC:
            used.update(operands[1:] if name == "select" else operands)
        if name == "select" and k not in meeting:
            sides.append(apply("ne", mine[0], constant(0.0)))
        elif name in ("floor", "ceil", "sign"):
            sides.append(values[-1])
        elif name == "copysign":
            sides.append(apply("copysign", constant(1.0), mine[1]))
        elif name in ("fmod", "remainder"):
            turns = apply("div", *mine)
            shift = constant(0.5 if name == "remainder" else 0.0)
            sides += [apply("floor", apply("add", turns, shift)), apply("sign", turns)]
        elif name == "atan2":
            left = apply("le", mine[1], constant(0.0))
            sides.append(apply("select", left, apply("sign", mine[0])))
        elif kinks and name == "fabs":
            sides.append(apply("sign", mine[0]))
        elif kinks and name in ("fmin", "fmax"):
            sides.append(apply("lt", *mine))
    for k, (name, *_) in enumerate(program.instructions, start=program.input_count):
        if name in OPERATIONS and OPERATIONS[name].boolean and k in used:
            sides.append(values[k])  # taken as a number
    results = sides or [constant(0.0)]
    outputs = (("conditions", len(results)),)
    return builder.build("conditions", program.inputs, outputs, results)


def _meeting_selections(program: Program) -> set[int]:
    """Return the selections of ``if_else(c, a, b)`` with a = b where c changes.

    Of an order c between p and q they are so where a - b is a multiple of p - q.
    """
    values = polynomials(program)
    uses = Counter(k for name, *operands in program.instructions if name != "const"
                   for k in operands)  # fmt: skip
    uses.update(program.results)
    found: set[int] = set()
    for name, *operands in program.instructions:
        chosen = alternatives(program, *operands) if name == "add" else None
        if chosen is None or any(uses[k] != 1 for k in operands):
            continue
        condition, one, other = chosen
        order, *sides = instruction(program, condition)
        if order in ("le", "lt") and _is_multiple(
            values[one], values[other], *(values[k] for k in sides)
        ):
            found.update(operands)
    return found


def _is_multiple(a: Polynomial, b: Polynomial, p: Polynomial, q: Polynomial) -> bool:
    """Return whether a - b is a constant times p - q."""
    one, two = _difference(a, b), _difference(p, q)
    if not one:
        return True
    if set(one) != set(two):
        return False
    return len({one[monomial] / two[monomial] for monomial in one}) == 1


def _difference(a: Polynomial, b: Polynomial) -> dict[object, Fraction]:
    terms: dict[object, Fraction] = dict(a)
    for monomial, c in b:
        terms[monomial] = terms.get(monomial, Fraction(0)) - c
    return {monomial: c for monomial, c in terms.items() if c}
