"""CasADi's interpolants, and other functions that are called, as expressions of plain operations.

``casadi.interpolant`` gives a function whose table CasADi keeps to itself. Here the table is read
back from the C code that CasADi writes for it, and becomes a sum of clipped coordinates: a cell c
of an axis, from b to b', has ``r = clip(x, b, b') - b``, which is 0 below it and constant above, so
that ``v + sum_c p_c(r_c)`` with polynomials of ``p_c(0) = 0`` is the interpolant of one axis, and
sums of products are those of more. No cell is chosen, and none that is not met gives infinity; all
is ``fmin`` and ``fmax``, which are continuous, and of which bounds over boxes are exact.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from capsyn.errors import ProblemError

MAX_COEFFICIENTS = 2000
"""Most coefficients of an interpolant: its code is as long as they are many."""
PROBES = 200
"""Random points at which a table that was read back is compared with CasADi's own values."""
AGREEMENT = 1e-9
"""How far these may differ, relative to the largest value."""
_tables: set[int] = set()
"""Hashes of the functions of `table_function`, whose calls stay calls, with their derivatives."""
_KINDS = ("LinearInterpolant", "BSplineInterpolant")
_CALLS = re.compile(r"\b(?:casadi_)?(interpn|nd_boor_eval)\)?\(([^;]*)\);")
_ARRAYS = re.compile(r"static const casadi_(?:int|real) casadi_(\w+)\[(\d+)\] =\s*\{([^}]*)\};")


def without_calls(name: str, value: ca.SX, arguments: Sequence[ca.SX]) -> ca.SX:
    """Return a value of arguments with every call of a function in it written out.

    Those that are left are calls of `table_function`, which are plain functions with derivatives of
    their own. A function that cannot be written out is a `ProblemError` that names it; `name` is
    where the value stands.
    """
    function = ca.Function("value", list(arguments), [value], {"allow_free": True})
    if not _calls(function):
        return value
    (column,) = _written_out(name, function, [ca.vec(a) for a in arguments])
    return ca.reshape(column, value.shape)


def _calls(function: ca.Function) -> list[int]:
    """Return the numbers of the instructions of an SX function that call others."""
    count = function.n_instructions()
    return [k for k in range(count) if function.instruction_id(k) == ca.OP_CALL]


def _written_out(name: str, function: ca.Function, inputs: Sequence[ca.SX]) -> list[ca.SX]:
    """Return the nonzeros of the outputs of an SX function, of the nonzeros of its inputs."""
    nodes = function.instructions_sx()
    outputs = [ca.SX.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    work: dict[int, ca.SX] = {}
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        into, operands = function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_INPUT:
            work[into[0]] = inputs[operands[0]][operands[1]]
        elif code == ca.OP_OUTPUT:
            outputs[into[0]][into[1]] = work[operands[0]]
        elif code in (ca.OP_CONST, ca.OP_PARAMETER):
            work[into[0]] = nodes[k]
        elif code == ca.OP_CALL:
            called, given = nodes[k].which_function(), ca.vertcat(*(work[i] for i in operands))
            work.update(zip(into, ca.vertsplit(_called(name, called, given))))
        elif len(operands) == 1:
            work[into[0]] = ca.SX.unary(code, work[operands[0]])
        else:
            work[into[0]] = ca.SX.binary(code, *(work[i] for i in operands))
    return outputs


def _called(name: str, function: ca.Function, given: ca.SX) -> ca.SX:
    """Return all nonzeros that a function gives, of all that are given to it."""
    if function.__hash__() in _tables:
        return ca.vec(function(given))
    if function.class_name() in _KINDS:
        # what is not a number stays none, though fmin and fmax take the other operand
        return ca.vec(table_function(name, function)(given)) + 1e-300 * ca.sum1(given)
    given_to = [ca.SX.sym("i", function.sparsity_in(i)) for i in range(function.n_in())]
    plain = function if function.class_name() == "SXFunction" else None
    with contextlib.suppress(RuntimeError):  # what has no symbolic form
        plain = ca.Function("plain", given_to, function.call(given_to, True, False))
    if plain is None or any(
        plain.instructions_sx()[k].which_function().__hash__() == function.__hash__()
        for k in _calls(plain)
    ):
        raise ProblemError(
            f"`{name}` calls the function '{function.name()}' of CasADi's class "
            f"{function.class_name()}, which cannot be written out in plain operations"
        )
    ends = np.cumsum([0] + [plain.nnz_in(i) for i in range(plain.n_in())])
    inputs = [given[start:end] for start, end in zip(ends, ends[1:])]
    return ca.vertcat(*_written_out(name, plain, inputs))


def table_function(name: str, interpolant: ca.Function) -> ca.Function:
    """Return the function of an interpolant of plain operations, with a Jacobian of its own.

    The derivative at a knot is that of the cell above it, as CasADi has it. An interpolant that
    cannot be had so is a `ProblemError`; `name` is where it is used.
    """
    try:
        return _table_function(interpolant.serialize())
    except _Refused as reason:
        raise ProblemError(
            f"`{name}` uses the interpolant '{interpolant.name()}', {reason}"
        ) from None


class _Refused(Exception):
    """Why an interpolant has no plain function."""


@functools.cache  # for good: an address in `_tables` is not used again
def _table_function(text: str) -> ca.Function:
    interpolant = ca.Function.deserialize(text)
    if interpolant.n_in() != 1 or interpolant.size2_in(0) != 1:
        raise _Refused("whose table is an argument: give the values when it is made")
    axes, values = _read_back(interpolant)
    x = ca.SX.sym("x", len(axes))
    columns: list[ca.SX] = []
    slopes: list[list[ca.SX]] = []
    for table in values:
        coefficients = functools.reduce(
            lambda array, k: axes[k].coefficients(array, k), range(len(axes)), table
        )
        if coefficients.size > MAX_COEFFICIENTS:
            raise _Refused(
                f"which has {coefficients.size:,} coefficients; at most {MAX_COEFFICIENTS:,} can "
                "be written out: make its grid coarser"
            )
        inside: Any = math.prod(axis.inside(x[k]) for k, axis in enumerate(axes))
        cells = [axis.cells(x[k]) for k, axis in enumerate(axes)]
        columns.append(_where(inside, _sum(coefficients, cells, axes)))
        slopes.append([])
        for k in range(len(axes)):
            order = [k, *(i for i in range(len(axes)) if i != k)]
            turned = np.transpose(coefficients, order)
            slope = _slope(turned, [cells[i] for i in order], [axes[i] for i in order], x[k])
            slopes[-1].append(_where(inside, slope))
    column = ca.vertcat(*columns)
    jacobian = ca.vertcat(*(ca.horzcat(*row) for row in slopes))
    unused = ca.SX.sym("out", len(columns), 1)
    own = ca.Function(f"jac_{interpolant.name()}", [x, unused], [ca.densify(jacobian)])
    options: Any = {
        "custom_jacobian": own,
        "never_inline": True,
        "enable_forward": False,
        "enable_reverse": False,
    }
    function = ca.Function(interpolant.name(), [x], [ca.densify(column)], options)
    _compare(interpolant, function, axes)
    _tables.add(function.__hash__())
    return function


@dataclass(frozen=True)
class _Axis:
    """An axis of a table: cells between breaks, on each of which it is a polynomial."""

    breaks: np.ndarray  # (K + 1,), rising
    degree: int
    knots: np.ndarray | None  # of a B-spline, which is 0 outside; None extrapolates linearly

    def coefficients(self, table: np.ndarray, axis: int) -> np.ndarray:
        """Return a table with this axis of it turned to (1 + degree K,) coefficients.

        They are the value at the first break, and those of each cell's powers of r from 1.
        """
        table = np.moveaxis(table, axis, 0)
        if self.knots is None:
            widths = np.diff(self.breaks).reshape(-1, *(1,) * (table.ndim - 1))
            rows = [table[:1], np.diff(table, axis=0) / widths]
        else:
            from scipy.interpolate import BSpline  # heavy, and few models use it

            spline, starts = BSpline(self.knots, table, self.degree), self.breaks[:-1]
            powers = [
                spline.derivative(k)(starts) / math.factorial(k) if k else spline(starts)
                for k in range(self.degree + 1)
            ]
            rows = [powers[0][:1], np.stack(powers[1:], axis=1).reshape(-1, *table.shape[1:])]
        return np.moveaxis(np.concatenate(rows), 0, axis)

    def inside(self, x: ca.SX) -> ca.SX:
        """Return whether the interpolant is defined by its cells."""
        if self.knots is None:
            return ca.SX(1)
        return ca.logic_and(self.breaks[0] <= x, x <= self.breaks[-1])

    def cells(self, x: ca.SX) -> list[ca.SX]:
        """Return ``clip(x, b, b') - b`` for each cell; the outer ones may go on."""
        last, every = len(self.breaks) - 2, []
        for c, (low, high) in enumerate(zip(self.breaks, self.breaks[1:])):
            clipped = x
            if self.knots is not None or c < last:
                clipped = ca.fmin(clipped, high)
            if self.knots is not None or c > 0:
                clipped = ca.fmax(clipped, low)
            every.append(clipped - low)
        return every

    def passed(self, x: ca.SX) -> list[ca.SX]:
        """Return whether x has come to each cell but the first."""
        return [low <= x for low in self.breaks[1:-1]]


def _where(condition: ca.SX, value: ca.SX) -> ca.SX:
    return ca.if_else(condition, value, 0)


def _sum(array: Any, cells: Sequence[Sequence[ca.SX]], axes: Sequence[_Axis]) -> ca.SX:
    """Return the value of coefficients, of the clipped coordinates of every axis."""
    if not axes:
        return ca.SX(float(array))
    rows = [_sum(row, cells[1:], axes[1:]) for row in array]
    total, degree = rows[0], axes[0].degree
    for c, r in enumerate(cells[0]):
        part = ca.SX(0)
        for row in reversed(rows[1 + c * degree : 1 + (c + 1) * degree]):
            part = (part + row) * r
        total = total + part
    return total


def _slope(
    array: np.ndarray, cells: Sequence[Sequence[ca.SX]], axes: Sequence[_Axis], x: ca.SX
) -> ca.SX:
    """Return the derivative of `_sum` by the first coordinate x."""
    degree = axes[0].degree
    if degree > 1:  # continuous
        factors = np.arange(1, degree + 1).reshape(-1, *(1,) * (array.ndim - 1))
        slopes = array[1:].reshape(-1, degree, *array.shape[1:]) * factors
        array = np.concatenate([slopes[0, :1], slopes[:, 1:].reshape(-1, *array.shape[1:])])
        return _sum(array, cells, [dataclasses.replace(axes[0], degree=degree - 1), *axes[1:]])
    rows = [_sum(row, cells[1:], axes[1:]) for row in array[1:]]
    total = rows[0]
    for below, above, passed in zip(rows, rows[1:], axes[0].passed(x)):
        total = total + _where(passed, above - below)
    return total


def _read_back(interpolant: ca.Function) -> tuple[list[_Axis], np.ndarray]:
    """Return the axes and the tables, one for each output, that CasADi's C code has."""
    writer = ca.CodeGenerator("interpolant")
    writer.add(interpolant)
    text = writer.dump()
    arrays = {}
    for key, size, numbers in _ARRAYS.findall(text):
        arrays[key] = np.zeros(int(size))  # as in C, what is not given is 0
        given = [float(number) for number in numbers.split(",")]
        arrays[key][: len(given)] = given
    calls = [
        (kind, [part.strip() for part in arguments.split(",")])
        for kind, arguments in _CALLS.findall(text)
        if "casadi_c" in arguments
    ]
    if len(calls) != 1:
        raise _Refused("whose table CasADi does not tell: make it without `inline`")
    ((kind, (_, _, *words)),) = calls

    def of(word: str) -> np.ndarray:
        return arrays[word.removeprefix("casadi_")]

    grid, ends = of(words[0]), of(words[1]).astype(int)
    points = [grid[start:end] for start, end in zip(ends, ends[1:])]
    if kind == "interpn":
        axes = [_Axis(knots, 1, None) for knots in points]
        sizes, numbers, outputs = [len(knots) for knots in points], of(words[2]), words[5]
    else:
        degrees = of(words[2]).astype(int)
        axes = [_spline_axis(knots, int(p)) for knots, p in zip(points, degrees)]
        sizes = [len(knots) - int(p) - 1 for knots, p in zip(points, degrees)]
        numbers, outputs = of(words[4]), words[5]
    return axes, numbers.reshape((int(outputs), *sizes), order="F")


def _spline_axis(knots: np.ndarray, degree: int) -> _Axis:
    breaks, often = np.unique(knots[degree : len(knots) - degree], return_counts=True)
    if degree == 0 or often[1:-1].max(initial=0) > max(degree - 1, 1):
        raise _Refused(f"a spline of degree {degree} that jumps or bends at its knots")
    return _Axis(breaks, degree, knots)


def _compare(interpolant: ca.Function, function: ca.Function, axes: Sequence[_Axis]) -> None:
    """Raise `_Refused` where a function differs from the interpolant, inside or outside."""
    low, high = (np.array([axis.breaks[k] for axis in axes]) for k in (0, -1))
    margin = (high - low) / 4
    points = np.random.default_rng(0).uniform(low - margin, high + margin, (PROBES, len(axes))).T
    wanted, got = (np.array(each.map(PROBES)(points)) for each in (interpolant, function))
    if not np.abs(wanted - got).max() <= AGREEMENT * np.abs(wanted).max():
        raise _Refused("whose table could not be read back")
