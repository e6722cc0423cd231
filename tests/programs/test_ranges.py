"""Operations kept to their range, and which operation of a program is not finite at a point."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from capsyn.controllers.unsolved.diagnosis import singular
from capsyn.modelling.transcription import user_program
from capsyn.programs.builder import extended
from capsyn.programs.program import Program


def program_of(function, n: int = 2, size: int = 1) -> Program:
    return user_program("f", function, (("x", n),), (("value", size),))


@pytest.mark.parametrize("function, points, values", [
    (lambda x: ca.sqrt(x[0]), [4, 0, -1], [2, 0, 0]),
    (lambda x: x[0] ** 0.3, [1, 0, -1], [1, 0, 0]),
    (lambda x: ca.asin(x[0]), [1, -1, -2], [np.pi / 2, -np.pi / 2, -np.pi / 2]),
    (lambda x: ca.acos(2 * x[0]), [0.5, 3, -1], [0, 0, np.pi]),
    (lambda x: ca.sqrt(1 - ca.sqrt(x[0])), [0.25, 4, -1], [0.5**0.5, 0, 1]),
])  # fmt: skip
def test_outside_their_range_operations_have_the_value_at_its_end(function, points, values):
    program = program_of(function)
    x = np.array([points, np.zeros(len(points))])
    assert extended(program).evaluate(x)[0][0] == pytest.approx(values, abs=1e-15)
    inside = program.evaluate(x)[0][0]
    finite = np.isfinite(inside)
    assert (inside[finite] == extended(program).evaluate(x)[0][0][finite]).all()
    assert np.isnan(inside[2])
    assert np.isnan(extended(program).evaluate(x * np.nan)[0][0]).all()


@pytest.mark.parametrize("function", [
    lambda x: ca.sqrt(x[0] ** 2 + ca.fabs(x[1])),
    lambda x: ca.norm_2(x) + ca.sqrt(ca.exp(x[0]) / (1 + x[1] ** 2)),
    lambda x: ca.sqrt(ca.fmax(x[0], 0)) + x[0] ** 3 + ca.log(x[0]),
])  # fmt: skip
def test_what_cannot_leave_its_range_stays_the_very_program(function):
    program = program_of(function)
    assert extended(program) is program


def test_what_is_not_finite_is_found_values_before_slopes():
    program = program_of(lambda x: ca.vertcat(ca.sqrt(x[0]), 1 / (x[1] - 2) + x[0]), size=2)
    assert singular(program, [1.0, 3.0]) is None
    slope = singular(program, [0.0, 3.0])
    assert slope is not None and slope.slope
    assert (slope.result, slope.name, slope.numbers, slope.inputs) == (0, "sqrt", (0.0,), ((0,),))
    value = singular(program, [0.0, 2.0])
    assert value is not None and not value.slope
    assert (value.result, value.name, value.numbers[1]) == (1, "div", 0.0)
    assert value.inputs[1] == (1,)


def test_a_value_that_nobody_takes_is_no_fault():
    program = program_of(lambda x: ca.if_else(x[0] > 0, ca.log(x[0]), x[1]))
    assert singular(program, [-1.0, 3.0]) is None
    assert singular(program, [1e-300, 3.0]) is None
