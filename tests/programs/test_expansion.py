"""Expanded programs: equal to the plain ones, tighter where terms cancel."""

import math
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn.modelling.transcription import user_program
from capsyn.programs.expansion import MAX_BITS, MAX_TERMS, expand
from capsyn.programs.intervals import evaluate_intervals
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program
from support.random_programs import random_program


def program_of(function, n=3):
    return user_program("f", function, (("x", n),), (("y", 1),))


def bounds(program, lower, upper):
    """Return the bounds (2,) of the expanded program over one box."""
    expansion = expand(program)
    box = (
        np.reshape(np.array(lower, dtype=float), (-1, 1)),
        np.reshape(np.array(upper, dtype=float), (-1, 1)),
    )
    ((low, high),) = evaluate_intervals(expansion.program, box, inexact=expansion.inexact)
    return low[0, 0], high[0, 0]


def operations(program):
    return [name for name, *_ in program.instructions if name != "const"]


CANCELLING = {
    "square of a sum": lambda x: (x[0] + x[1]) ** 2 - x[0] ** 2 - 2 * x[0] * x[1] - x[1] ** 2,
    "product of sums": lambda x: (x[0] + 3) * (x[1] - 2) - x[0] * x[1] + 2 * x[0] - 3 * x[1] + 6,
    "functions": lambda x: x[1] * ca.sin(x[0]) * 3 - ca.sin(x[0]) * x[1] - 2 * x[1] * ca.sin(x[0]),
    "even functions": lambda x: ca.cos(x[0] - x[1]) - ca.cos(x[1] - x[0]),
    "odd functions": lambda x: ca.sin(x[0] - x[1]) + ca.sin(x[1] - x[0]),
    "canonical operands": lambda x: ca.exp(x[0] * (x[1] + 1)) - ca.exp(x[0] + x[1] * x[0]),
    "quotients": lambda x: (x[0] + x[1]) / x[2] - x[0] / x[2] - x[1] / x[2],
    "constant quotients": lambda x: (x[0] + x[1]) / 3 - x[0] / 3 - x[1] / 3,
    "powers": lambda x: (x[0] + 1) ** 5 - (x[0] + 1) * (x[0] ** 2 + 2 * x[0] + 1) ** 2,
    "branches": lambda x: (
        ca.if_else(x[0] > 1, x[1] * x[2], x[1]) * x[0]
        - ca.if_else(x[0] > 1, x[0] * x[2], x[0]) * x[1]
    ),
    "branches that are no comparisons": lambda x: (
        ca.if_else(x[0], x[1] + 1, 0.0) * x[2]
        - ca.if_else(x[0], x[2] * x[1], 0.0)
        - ca.if_else(x[0], x[2], 0.0)
    ),
}


@pytest.mark.parametrize("case", CANCELLING)
def test_terms_cancel_exactly(case):
    program = program_of(CANCELLING[case])
    assert len(operations(program)) > 1
    expansion = expand(program)
    assert expansion.program.instructions == (("const", 0.0),)
    assert not expansion.inexact


def test_what_does_not_cancel_exactly_stays():
    # in doubles 0.1 * 3 is not 0.3: the program means its constants
    rows = [("const", 0.1), ("mul", 0, 1), ("const", 3.0), ("mul", 2, 3), ("const", 0.3)]
    rows += [("mul", 0, 5), ("sub", 4, 6)]
    program = Program("p", (("x", 1),), (("y", 1),), tuple(rows), (7,))
    low, high = bounds(program, [1.0], [1.0])
    exact = 3 * Fraction(0.1) - Fraction(0.3)
    assert exact > 0
    assert Fraction(float(low)) <= exact <= Fraction(float(high)) and low > 0


def test_constants_that_are_no_doubles_are_enclosed():
    program = program_of(lambda x: x[0] / 3 + x[1] / 7 + (x[0] + 1e-20) * 1.1 * 1.3, 2)
    assert len(expand(program).inexact) == 3
    low, high = bounds(program, [5.0, -2.0], [5.0, -2.0])
    exact = Fraction(5, 3) - Fraction(2, 7)
    exact += (5 + Fraction(1e-20)) * Fraction(1.1) * Fraction(1.3)
    assert Fraction(float(low)) < exact < Fraction(float(high))
    assert high - low < 3e-14


def test_a_constant_may_be_exact_in_one_place_and_rounded_in_another():
    rows = (("const", 3.0), ("div", 0, 3), ("const", 1 / 3), ("mul", 1, 5), ("add", 4, 6))
    expansion = expand(Program("p", (("x", 3),), (("y", 1),), rows, (7,)))
    thirds = [
        k + 3 for k, row in enumerate(expansion.program.instructions) if row == ("const", 1 / 3)
    ]
    assert len(thirds) == 2 and len(expansion.inexact) == 1
    assert expansion.inexact < set(thirds)


def test_coefficients_beyond_the_range_of_doubles_are_enclosed():
    rows = [("const", 1e200), ("mul", 0, 1), ("mul", 2, 1), ("const", 1e-200), ("mul", 3, 4)]
    large = Program("p", (("x", 1),), (("y", 2),), tuple(rows), (3, 5))
    expansion = expand(large)
    ((low, high),) = evaluate_intervals(
        expansion.program, ([[1.0]], [[1.0]]), inexact=expansion.inexact
    )
    assert 1e308 < low[0, 0] < high[0, 0] == math.inf
    # 1e400 / 1e200 is multiplied out exactly where doubles overflow
    assert low[1, 0] == pytest.approx(1e200, rel=1e-15)
    tiny = Program("p", (("x", 1),), (("y", 1),), (rows[3], rows[1], ("mul", 2, 1)), (3,))
    low, high = bounds(tiny, [1.0], [1.0])
    assert low <= 0 < high < 1e-300


def test_common_factors_decide_the_sign():
    program = program_of(lambda x: 3 * x[0] * x[1] ** 2 - x[0] * x[1] * x[2])
    assert bounds(program, [0.0, 1.0, 0.0], [2.0, 4.0, 2.9])[0] == 0.0
    (plain,) = evaluate_intervals(program, ([[0.0], [1.0], [0.0]], [[2.0], [4.0], [3.0]]))
    assert plain[0][0, 0] < -10
    assert bounds(program, [-2.0, 1.0, 0.0], [0.0, 4.0, 2.9])[1] == 0.0


def test_powers_are_tight():
    cube = program_of(lambda x: x[0] * x[0] * x[0], 1)
    np.testing.assert_allclose(bounds(cube, [-1.0], [2.0]), [-1, 8], rtol=1e-14)
    fourth = program_of(lambda x: x[0] * x[0] * x[0] * x[0], 1)
    low, high = bounds(fourth, [-2.0], [1.0])
    assert low == 0.0 and high == pytest.approx(16)
    large = program_of(lambda x: x[0] ** 40, 1)
    assert bounds(large, [-1.0], [0.5])[0] == 0.0


def test_any_value_but_zero_is_a_condition():
    rows = (("select", 0, 1), ("fabs", 0), ("select", 3, 1), ("lt", 0, 1), ("select", 5, 1))
    program = Program("p", (("x", 2),), (("y", 3),), rows, (2, 4, 6))
    expansion = expand(program)
    x = np.array([[2.0, 0.0, 5.0], [3.0, 3.0, 3.0]])
    ((low, high),) = evaluate_intervals(expansion.program, (x, x))
    np.testing.assert_allclose(low, [[3, 0, 3], [3, 0, 3], [3, 3, 0]], rtol=1e-15)
    np.testing.assert_allclose(high, low, rtol=1e-15)


def test_constant_exponents_are_multiplied_out():
    rows = [("const", 3.0), ("pow", 0, 1), ("mul", 0, 0), ("mul", 0, 3), ("sub", 2, 4)]
    cube = Program("p", (("x", 1),), (("y", 1),), tuple(rows), (5,))
    assert expand(cube).program.instructions == (("const", 0.0),)
    for exponent in (-2.0, 0.0, 0.5, 17.0):
        rows = (("const", exponent), ("pow", 0, 1))
        other = Program("p", (("x", 1),), (("y", 1),), rows, (2,))
        low, high = bounds(other, [1.5], [1.5])
        assert low <= 1.5**exponent <= high < low * (1 + 1e-13)


@pytest.mark.parametrize("name", OPERATIONS)
def test_functions_of_either_sign_keep_their_value(name):
    # x - y and y - x: one of them is turned round where the function is odd or even
    arity = OPERATIONS[name].arity
    rows = [("sub", 0, 1), ("sub", 1, 0), (name, *[3] * arity), (name, *[4] * arity)]
    program = Program(name, (("x", 3),), (("y", 2),), tuple(rows), (5, 6))
    expansion = expand(program)
    for state in ([0.75, 0.25, 0.0], [0.25, 0.75, 0.0], [2.0, 0.5, 0.0]):
        column = np.array(state)[:, None]
        (values,) = program.evaluate(column)
        ((low, high),) = evaluate_intervals(
            expansion.program, (column, column), inexact=expansion.inexact
        )
        same = (low <= values) & (values <= high)
        assert (same | np.isnan(values) | np.isnan(low)).all()
        np.testing.assert_array_equal(np.isnan(values), np.isnan(low))


def test_pendulum_keeps_only_the_input():
    def derivative(x):
        theta, omega, u = x[0], x[1], x[2]
        energy = 2 * omega**2 + 19.62 * (ca.cos(theta) - 1)
        xdot = [omega, (9.81 * ca.sin(theta) + u * ca.cos(theta)) / 2]
        slope = ca.gradient(ca.fabs(energy), x)
        return slope[0] * xdot[0] + slope[1] * xdot[1]

    program = program_of(derivative)
    assert "sin" in operations(program) and "sin" not in operations(expand(program).program)
    low, high = bounds(program, [0.1, 4.0, 1.0], [1.2, 5.0, 2.0])
    exact = [2 * math.cos(1.2) * 4.0 * 1.0, 2 * math.cos(0.1) * 5.0 * 2.0]
    np.testing.assert_allclose([low, high], exact, rtol=1e-13)


def test_infinite_constants_and_divisions_by_zero_are_kept():
    rows = (("const", math.inf), ("fmin", 0, 1), ("const", 0.0), ("div", 0, 3), ("neg", 1))
    program = Program("p", (("x", 1),), (("y", 3),), rows, (2, 4, 5))
    expansion = expand(program)
    ((low, high),) = evaluate_intervals(expansion.program, ([[1.0]], [[2.0]]))
    np.testing.assert_array_equal(low[:, 0], [1, np.nan, -np.inf])
    np.testing.assert_array_equal(high[:, 0], [2, np.nan, -np.inf])


def test_work_is_bounded():
    def tower(x):
        y = 1.1 * x[0] + x[1]
        for _ in range(60):
            y = y * y
        return y

    def product(x):
        y = 1.0
        for k in range(30):
            y = y * (x[0] + x[1] * 1.1 + x[2] * k + 1)
        return y

    def scaled(x):
        y = x[0]
        for k in range(1, 4000):
            y = y / (2 * k + 1.1)
        return y

    for function in (tower, product, scaled):
        expansion = expand(program_of(function))
        assert len(expansion.program.instructions) < 20 * MAX_TERMS + MAX_BITS
        low, high = bounds(program_of(function), [0.1, 0.1, 0.1], [0.2, 0.2, 0.2])
        assert 0 <= low <= high


def test_results_that_are_inputs_or_the_same_keep_their_places():
    program = Program("p", (("x", 2), ("u", 1)), (("y", 2), ("z", 2)), (), (1, 0, 2, 1))
    assert expand(program).program == program
    rows = (("mul", 0, 0), ("mul", 1, 3), ("mul", 0, 1), ("mul", 0, 5))
    program = Program("p", (("x", 3),), (("y", 2),), rows, (4, 6))
    first, second = expand(program).program.results
    assert first == second


@settings(max_examples=150)
@given(st.data())
def test_random_programs_mean_the_same(data):
    program = data.draw(random_program())
    expansion = expand(program)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    middle = rng.normal(size=(3, 60)) * 10.0 ** rng.uniform(-2, 1, (3, 60))
    middle = np.where(rng.random(middle.shape) < 0.3, np.rint(middle), middle)
    width = rng.random(middle.shape) * 10.0 ** rng.uniform(-9, 0, 60) * (rng.random(60) < 0.7)
    box = middle - width, middle + width
    (plain,) = evaluate_intervals(program, box)
    (other,) = evaluate_intervals(expansion.program, box, inexact=expansion.inexact)
    # both hold the true values, so they meet
    apart = (plain[0] > other[1]) | (other[0] > plain[1])
    assert not apart.any(), program
    (values,) = program.evaluate(middle)
    (points,) = evaluate_intervals(expansion.program, (middle, middle), inexact=expansion.inexact)
    (near,) = evaluate_intervals(program, (middle, middle))
    with np.errstate(invalid="ignore"):
        slack = near[1] - near[0]  # what rounding may do to the plain values
        off = (values < points[0] - slack) | (values > points[1] + slack)
    assert not off.any(), program
