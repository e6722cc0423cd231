"""Intervals: what a program gives in a box lies in its bounds, whatever the operation."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn.programs.intervals import INTERVALS, evaluate_intervals
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program
from support.random_programs import SPECIAL, random_intervals, random_program


def single(name):
    """Return the program of one operation."""
    arity = OPERATIONS[name].arity
    inputs = (("a", 1), ("b", 1))[:arity]
    return Program(name, inputs, (("y", 1),), ((name, *range(arity)),), (arity,))


def enclose(name, *intervals):
    """Return the bounds of one operation on intervals given as pairs of numbers."""
    ((low, high),) = evaluate_intervals(
        single(name), *(([[low]], [[high]]) for low, high in intervals)
    )
    return low[0, 0], high[0, 0]


def points_in(rng, bounds, count=12):
    """Return points (count, B) of intervals: the ends, special numbers inside, and random ones."""
    low, high = bounds
    with np.errstate(all="ignore"):
        share = rng.random((count, low.size))
        inside = np.clip(low * (1 - share) + high * share, low, high)
        special = np.clip(rng.choice(SPECIAL, (count, low.size)), low, high)
    chosen = np.where(np.isnan(inside) | (rng.random(inside.shape) < 0.3), special, inside)
    chosen[0], chosen[1] = low, high
    return np.where((chosen == 0) & (rng.random(chosen.shape) < 0.5), -0.0, chosen)


def assert_encloses(bounds, values, message):
    """Check bounds (B,) of values (P, B): all inside, and undefined where one of them is."""
    low, high = bounds
    known = ~np.isnan(low)
    np.testing.assert_array_equal(known, ~np.isnan(high))
    with np.errstate(invalid="ignore"):
        inside = (values >= low) & (values <= high)
    wrong = known & ~inside.all(axis=0)
    assert not wrong.any(), (message, low[wrong][:3], high[wrong][:3], values[:, wrong][:, :3])


def test_every_operation_has_an_interval_form():
    assert set(INTERVALS) == set(OPERATIONS)


@pytest.mark.parametrize("name", OPERATIONS)
def test_computed_values_are_enclosed(name):
    rng = np.random.default_rng(list(OPERATIONS).index(name))
    boxes = [random_intervals(rng, 6000) for _ in range(OPERATIONS[name].arity)]
    points = [points_in(rng, box) for box in boxes]
    ((low, high),) = evaluate_intervals(single(name), *((b[:1], b[1:]) for b in boxes))
    (values,) = single(name).evaluate(*(p[None] for p in points))
    assert_encloses((low[0], high[0]), values[0], name)
    assert (low[0] <= high[0])[~np.isnan(low[0])].all()
    assert np.mean(np.isnan(low)) < 0.9, "some boxes must be defined"


@pytest.mark.parametrize("name", ["add", "sub", "mul", "div"])
def test_exact_results_of_arithmetic_are_enclosed(name):
    rng = np.random.default_rng(1)
    exact = {"add": lambda a, b: a + b, "sub": lambda a, b: a - b}
    exact |= {"mul": lambda a, b: a * b, "div": lambda a, b: a / b}
    scale = 10.0 ** rng.uniform(-170, 170, (2, 400))
    numbers = rng.normal(size=(2, 400)) * np.where(rng.random((2, 400)) < 0.5, scale, 1.0)
    a, b = numbers[:, None]
    ((low, high),) = evaluate_intervals(single(name), (a, a), (b, b))
    rounded = 0
    for one, two, bottom, top in zip(a[0], b[0], low[0], high[0]):
        value = exact[name](Fraction(one), Fraction(two))
        assert bottom == -math.inf or Fraction(bottom) <= value
        assert top == math.inf or value <= Fraction(top)
        rounded += (
            Fraction(bottom) < value < Fraction(top) if np.isfinite([bottom, top]).all() else 0
        )
    assert rounded > 100


def test_exact_products_that_underflow_keep_their_sign():
    assert enclose("mul", (1e-300, 1e-300), (1e-300, 1e-300)) == (0.0, 5e-324)
    assert enclose("mul", (-1e-300, -1e-300), (1e-300, 1e-300)) == (-5e-324, 0.0)
    assert enclose("div", (1e-300, 1e-300), (1e300, 1e300)) == (0.0, 5e-324)
    assert enclose("mul", (0.0, 1.0), (0.0, 3.0))[0] == 0.0
    assert enclose("mul", (-1.0, 0.0), (-3.0, 0.0))[0] == 0.0
    assert enclose("mul", (-1.0, 1.0), (0.0, 0.0)) == (0.0, 0.0)
    assert enclose("add", (-0.1, -0.1), (0.1, 0.1)) == (0.0, 0.0)


REAL = "sqrt exp expm1 log log1p sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"


@pytest.mark.parametrize("name", [*REAL.split(), "atan2", "hypot", "pow", "fmod"])
def test_values_of_higher_precision_are_enclosed(name):
    rng = np.random.default_rng(2)
    arity = OPERATIONS[name].arity
    points = rng.normal(size=(arity, 4000)) * 10.0 ** rng.uniform(-3, 2, (arity, 4000))
    points[:, :1000] = np.clip(points[:, :1000], -0.99, 0.99)
    arguments = [row[None] for row in points]
    ((low, high),) = evaluate_intervals(single(name), *((a, a) for a in arguments))
    with np.errstate(all="ignore"):
        values = OPERATIONS[name].numpy(*(a[0].astype(np.longdouble) for a in arguments))
    known = ~np.isnan(low[0])
    assert known.mean() > 0.1
    np.testing.assert_array_equal(known, ~np.isnan(values))
    assert ((low[0] <= values) & (values <= high[0]))[known].all()


def test_bounds_of_functions_are_wider_than_their_errors_and_not_much_wider():
    points = np.random.default_rng(3).uniform(0.05, 0.95, (1, 500))
    for name, operation in OPERATIONS.items():
        shift = {"acosh": 1.0}.get(name, 0.0)
        arguments = [points + shift, points[:, ::-1] + 2][: operation.arity]
        ((low, high),) = evaluate_intervals(single(name), *((a, a) for a in arguments))
        (values,) = single(name).evaluate(*arguments)
        size = np.abs(values) + 2 * (name == "remainder")
        assert ((high - low) <= 1.5e-14 * size).all(), name
        if operation.libm and name not in ("fabs", "floor", "ceil", "copysign", "fmod"):
            assert ((high - low) >= 4 * np.spacing(values)).all(), name


CASES = [
    ("sin", [(0.0, 3.0)], (0.0, 1.0)),
    ("sin", [(-0.5, 0.0)], (-math.sin(0.5), 0.0)),
    ("sin", [(3.0, 6.0)], (-1.0, math.sin(3.0))),
    ("cos", [(-1.0, 0.5)], (math.cos(1.0), 1.0)),
    ("cos", [(3.0, 3.5)], (-1.0, math.cos(3.5))),
    ("cos", [(4.0, 20.0)], (-1.0, 1.0)),
    ("sin", [(1.5707964, 1.6)], (math.sin(1.6), 1.0)),
    ("sin", [(1e12, 1e12 + 1)], (-1.0, 1.0)),
    ("fabs", [(-2.0, 1.0)], (0.0, 2.0)),
    ("fabs", [(-2.0, -1.0)], (1.0, 2.0)),
    ("cosh", [(-1.0, 0.5)], (1.0, math.cosh(1.0))),
    ("pow", [(-2.0, 1.0), (2.0, 2.0)], (0.0, 4.0)),
    ("pow", [(-2.0, 1.0), (3.0, 3.0)], (-8.0, 1.0)),
    ("pow", [(2.0, 4.0), (-2.0, -2.0)], (1 / 16, 1 / 4)),
    ("pow", [(-4.0, -2.0), (-1.0, -1.0)], (-1 / 2, -1 / 4)),
    ("pow", [(0.5, 2.0), (-1.0, 2.0)], (0.25, 4.0)),
    ("pow", [(0.0, 4.0), (0.5, 0.5)], (0.0, 2.0)),
    ("atan2", [(1.0, 2.0), (-1.0, 1.0)], (math.pi / 4, 3 * math.pi / 4)),
    ("atan2", [(-1.0, 1.0), (-1.0, 1.0)], (-math.pi, math.pi)),
    ("atan2", [(0.0, 1.0), (1.0, 2.0)], (0.0, math.pi / 4)),
    ("hypot", [(-3.0, 1.0), (-4.0, 0.0)], (0.0, 5.0)),
    ("fmod", [(5.0, 6.0), (4.0, 4.0)], (1.0, 2.0)),
    ("fmod", [(-6.0, -5.0), (4.0, 4.0)], (-2.0, -1.0)),
    ("fmod", [(3.0, 5.0), (4.0, 4.0)], (0.0, 4.0)),
    ("fmod", [(3.0, 5.0), (4.0, 99.0)], (0.0, 5.0)),
    ("tanh", [(0.0, 1.0)], (0.0, math.tanh(1.0))),
    ("asinh", [(-1.0, 0.0)], (-math.asinh(1.0), 0.0)),
    ("log", [(1.0, 2.0)], (0.0, math.log(2.0))),
    ("tan", [(-1.0, 0.0)], (-math.tan(1.0), 0.0)),
    ("remainder", [(5.0, 5.5), (4.0, 4.0)], (1.0, 1.5)),
    ("remainder", [(5.0, 7.0), (4.0, 4.0)], (-2.0, 2.0)),
    ("copysign", [(1.0, 2.0), (-1.0, -0.5)], (-2.0, -1.0)),
    ("copysign", [(1.0, 2.0), (-1.0, 0.5)], (-2.0, 2.0)),
    ("sign", [(-1.0, 0.0)], (-1.0, 0.0)),
    ("lt", [(0.0, 1.0), (2.0, 3.0)], (1.0, 1.0)),
    ("lt", [(0.0, 1.0), (1.0, 3.0)], (0.0, 1.0)),
    ("lt", [(1.0, 2.0), (0.0, 1.0)], (0.0, 0.0)),
    ("le", [(0.0, 1.0), (1.0, 3.0)], (1.0, 1.0)),
    ("le", [(2.0, 3.0), (0.0, 1.0)], (0.0, 0.0)),
    ("eq", [(1.0, 1.0), (1.0, 1.0)], (1.0, 1.0)),
    ("eq", [(1.0, 2.0), (1.0, 1.0)], (0.0, 1.0)),
    ("ne", [(1.0, 2.0), (3.0, 4.0)], (1.0, 1.0)),
    ("not", [(0.0, 0.0)], (1.0, 1.0)),
    ("and", [(1.0, 2.0), (0.0, 1.0)], (0.0, 1.0)),
    ("or", [(1.0, 2.0), (0.0, 1.0)], (1.0, 1.0)),
    ("select", [(1.0, 1.0), (2.0, 3.0)], (2.0, 3.0)),
    ("select", [(0.0, 1.0), (2.0, 3.0)], (0.0, 3.0)),
    ("fmin", [(0.0, 3.0), (1.0, 2.0)], (0.0, 2.0)),
    ("div", [(1.0, 2.0), (-4.0, -2.0)], (-1.0, -0.25)),
]


@pytest.mark.parametrize("name, operands, expected", CASES)
def test_bounds_are_as_tight_as_the_range(name, operands, expected):
    low, high = enclose(name, *operands)
    np.testing.assert_allclose([low, high], expected, rtol=1e-14, atol=1e-14)
    assert name not in ("sin", "cos") or -1 <= low <= high <= 1
    for bound, limit in zip((low, high), expected):
        if limit == 0 or name in ("sign", "select", "fmin", "lt", "le", "eq"):
            assert bound == limit, "the sign must be exact"


UNDEFINED = [
    ("sqrt", [(-1e-300, 4.0)]),
    ("log", [(0.0, 1.0)]),
    ("log", [(0.0, math.inf)]),
    ("log1p", [(-1.0, 1.0)]),
    ("atanh", [(0.0, 1.0)]),
    ("asin", [(0.5, 1.5)]),
    ("acos", [(-1.5, 0.5)]),
    ("acosh", [(0.5, 2.0)]),
    ("div", [(0.0, 0.0), (-1.0, 1.0)]),
    ("div", [(1.0, 1.0), (0.0, 1.0)]),
    ("div", [(1.0, math.inf), (1.0, math.inf)]),
    ("add", [(0.0, math.inf), (-math.inf, 0.0)]),
    ("sub", [(0.0, math.inf), (0.0, math.inf)]),
    ("mul", [(-1.0, 1.0), (1.0, math.inf)]),
    ("pow", [(-1.0, 2.0), (0.5, 0.5)]),
    ("pow", [(-1.0, 2.0), (-1.0, -1.0)]),
    ("pow", [(0.0, 2.0), (0.0, 1.0)]),
    ("pow", [(-2.0, -1.0), (1.0, 2.0)]),
    ("tan", [(1.0, 2.0)]),
    ("tan", [(1.0, math.pi / 2)]),
    ("sin", [(0.0, math.inf)]),
    ("fmod", [(1.0, 2.0), (-1.0, 1.0)]),
    ("fmod", [(1.0, math.inf), (1.0, 1.0)]),
    ("remainder", [(1.0, 2.0), (0.0, 1.0)]),
    ("remainder", [(1.0, 2.0), (1.0, math.inf)]),
]


@pytest.mark.parametrize("name, operands", UNDEFINED)
def test_what_may_be_undefined_is_nan(name, operands):
    assert np.isnan(enclose(name, *operands)).all()


@pytest.mark.parametrize("name", OPERATIONS)
def test_nan_taints_everything_but_a_branch_that_is_not_taken(name):
    nan, good = (math.nan, math.nan), (0.5, 1.0)
    arity = OPERATIONS[name].arity
    for place in range(arity):
        operands = [nan if k == place else good for k in range(arity)]
        assert np.isnan(enclose(name, *operands)).all()
    assert np.isnan(enclose(name, *[(0.5, math.nan)] * arity)).all()
    assert enclose("select", (0.0, 0.0), nan) == (0.0, 0.0)
    assert np.isnan(enclose("select", (0.0, 1.0), nan)).all()


def test_overflow_leaves_a_number_below():
    largest = np.finfo(float).max
    for name, *operands in (
        ("exp", (800.0, 900.0)),
        ("mul", (1e300, 1e300), (1e300, 1e300)),
        ("add", (largest, largest), (largest, largest)),
        ("pow", (1e200, 1e201), (2.0, 2.0)),
        ("cosh", (-900.0, -800.0)),
    ):
        assert enclose(name, *operands) == (largest, math.inf), name
    assert enclose("mul", (-1e300, -1e300), (1e300, 1e300)) == (-math.inf, -largest)
    assert enclose("sinh", (-900.0, -800.0)) == (-math.inf, -largest)
    low, high = enclose("div", (1.0, 1.0), (1.0, math.inf))
    assert low == 0.0 and 1.0 <= high < 1.0 + 1e-15


@pytest.mark.parametrize("name", ["sin", "cos", "tan"])
def test_waves_are_sound_next_to_multiples_of_half_pi(name):
    rng = np.random.default_rng(4)
    k = np.concatenate([np.arange(-50, 51), rng.integers(-(10**8), 10**8, 3000)])
    center = k * (np.pi / 2)
    width = np.spacing(np.abs(center)) * rng.integers(0, 5, k.size) + 10.0 ** rng.uniform(
        -18, -6, k.size
    ) * (rng.random(k.size) < 0.5)
    low, high = center - width * rng.random(k.size), center + width * rng.random(k.size)
    points = points_in(rng, (low, high)).astype(np.longdouble)
    ((bottom, top),) = evaluate_intervals(single(name), (low[None], high[None]))
    values = OPERATIONS[name].numpy(points)
    assert_encloses((bottom[0], top[0]), values, name)
    # pi / 2 as a longdouble tells truly which boxes hold an extremum or a pole
    quarter = np.longdouble(np.pi) / 2 + np.longdouble(1.2246467991473532e-16) / 2
    inner = (low <= k * quarter) & (k * quarter <= high)
    assert inner.sum() > 300
    odd = (k % 2 == 1) & inner
    if name == "tan":
        assert np.isnan(bottom[0, odd]).all()
    else:
        extreme = odd if name == "sin" else (k % 2 == 0) & inner
        assert ((bottom[0] == -1) | (top[0] == 1))[extreme].all()
        assert bottom.min() == -1 and top.max() == 1


def test_a_product_with_itself_is_a_square():
    program = Program("p", (("x", 1),), (("y", 2),), (("mul", 0, 0), ("neg", 1)), (1, 2))
    ((low, high),) = evaluate_intervals(program, ([[-2.0, 0.0]], [[1.0, 0.0]]))
    np.testing.assert_allclose(low, [[0, 0], [-4, 0]], rtol=1e-15)
    np.testing.assert_allclose(high, [[4, 0], [0, 0]], rtol=1e-15)
    assert high[0, 0] > 4 > 0 == low[0, 0] == high[1, 0]


def test_of_two_opposite_comparisons_one_holds():
    rows = (("le", 0, 1), ("le", 1, 0), ("add", 2, 3), ("const", 1.0), ("div", 5, 4), ("add", 2, 2))
    program = Program("p", (("x", 2),), (("y", 3),), rows, (4, 6, 7))
    ((low, high),) = evaluate_intervals(
        program, ([[0.0, 0.0], [0.5, 3.0]], [[1.0, 1.0], [2.0, 4.0]])
    )
    np.testing.assert_allclose(low, [[1, 1], [0.5, 1], [0, 2]], rtol=1e-15)
    np.testing.assert_allclose(high, [[2, 1], [1, 1], [2, 2]], rtol=1e-15)


def test_inexact_constants_are_widened():
    third = Program("p", (("x", 1),), (("y", 1),), (("const", 1 / 3),), (1,))
    box = ([[0.0]], [[1.0]])
    assert evaluate_intervals(third, box)[0] == (1 / 3, 1 / 3)
    ((low, high),) = evaluate_intervals(third, box, inexact=frozenset({1}))
    assert Fraction(float(low[0, 0])) < Fraction(1, 3) < Fraction(float(high[0, 0]))


def test_outputs_and_boxes_keep_their_places():
    program = Program(
        "p", (("x", 2), ("u", 1)), (("y", 1), ("z", 2)), (("add", 0, 1), ("neg", 2)), (3, 4, 0)
    )
    x, u = np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]), np.array([[7.0, 8.0, 9.0]])
    (y, z) = evaluate_intervals(program, (x, x + 1), (u, u))
    assert y[0].shape == (1, 3) and z[0].shape == (2, 3)
    assert ((y[0] <= x.sum(axis=0)) & (y[1] >= x.sum(axis=0) + 2)).all()
    np.testing.assert_array_equal(z[0], [-u[0], x[0]])
    np.testing.assert_array_equal(z[1], [-u[0], x[0] + 1])
    (empty, _) = evaluate_intervals(program, (x[:, :0], x[:, :0]), (u[:, :0], u[:, :0]))
    assert empty[0].shape == (1, 0)
    for wrong in ((x[:1], x[:1]), (x, x[:, :2])):
        with pytest.raises(ValueError, match="`x` must be two arrays"):
            evaluate_intervals(program, wrong, (u, u))


@settings(max_examples=150)
@given(st.data())
def test_random_programs_are_enclosed(data):
    program = data.draw(random_program())
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    boxes = np.stack([random_intervals(rng, 40) for _ in range(program.input_count)], axis=1)
    points = np.stack([points_in(rng, boxes[:, k]) for k in range(program.input_count)])
    ((low, high),) = evaluate_intervals(program, (boxes[0], boxes[1]))
    (values,) = program.evaluate(points)
    for k in range(len(low)):
        assert_encloses((low[k], high[k]), values[k], program)
