"""Compiled bounds over boxes: those of NumPy or wider, and the exact values inside."""

from fractions import Fraction

import numpy as np
import pytest

import capsyn.native.bounds as bounds
from capsyn import problems
from capsyn.errors import KernelBuildError
from capsyn.modelling.transcription import transcribe
from capsyn.native.bounds import BoundsKernel, box_bounds
from capsyn.programs.intervals import evaluate_intervals
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program
from support.random_programs import random_intervals


def of_two(rows, name="all"):
    """Return a program of two numbers whose outputs are all of its instructions."""
    results = tuple(range(2, 2 + len(rows)))
    outputs = tuple((f"y{k}", 1) for k in range(len(rows)))
    return Program(name, (("a", 1), ("b", 1)), outputs, tuple(rows), results)


def random_boxes(count, seed=1):
    rng = np.random.default_rng(seed)
    return [tuple(random_intervals(rng, count)[:, None]) for _ in range(2)]


def check_not_tighter(names, got, wanted):
    for name, (low, high), (least, most) in zip(names, got, wanted, strict=True):
        assert np.array_equal(np.isnan(low), np.isnan(high)), name
        assert np.array_equal(np.isnan(low), np.isnan(least)), name
        tighter = (low > least) | (high < most)
        assert not tighter.any(), name


@pytest.mark.parametrize("part", range(6))
def test_every_operation_is_bounded_as_by_numpy_or_wider(part):
    names = list(OPERATIONS)[part::6]
    program = of_two([(name, *range(OPERATIONS[name].arity)) for name in names])
    boxes = random_boxes(40_000)
    got = BoundsKernel.build(program)(*boxes)
    check_not_tighter(names, got, evaluate_intervals(program, *boxes))


def test_undefined_operands_constants_and_what_is_special_in_programs():
    rows = [
        ("const", 0.1),
        ("const", float("inf")),
        ("mul", 0, 0),  # a square is not negative
        ("le", 0, 1),
        ("le", 1, 0),
        ("add", 5, 6),  # 1 or 2: one of them holds
        ("sqrt", 0),
        ("select", 5, 8),  # undefined only where it may be taken
        ("fmin", 8, 1),
        ("mul", 2, 4),
        ("sub", 11, 2),
    ]
    program, boxes = of_two(rows), random_boxes(20_000, 2)
    inexact = frozenset({2})
    got = BoundsKernel.build(program, inexact)(*boxes)
    check_not_tighter(range(len(rows)), got, evaluate_intervals(program, *boxes, inexact=inexact))
    assert got[0][0].max() < 0.1 < got[0][1].min()
    assert got[2][0].min() >= 0 and got[5][0].min() == 1 and got[5][1].max() == 2
    assert np.isnan(got[6][0]).any() and np.isnan(got[7][0]).any()


def test_a_chain_of_random_operations_is_never_tighter():
    rng = np.random.default_rng(3)
    names, rows = list(OPERATIONS), []
    for known in range(2, 42):
        name = names[rng.integers(len(names))]
        rows.append((name, *rng.integers(max(0, known - 20), known, OPERATIONS[name].arity)))
    program, boxes = of_two(rows), random_boxes(5000, 4)
    wanted = evaluate_intervals(program, *boxes)
    for row, (low, high), (least, most) in zip(rows, BoundsKernel.build(program)(*boxes), wanted):
        undefined = np.isnan(low)  # wider operands may reach where an operation is undefined
        assert not (np.isnan(least) & ~undefined).any(), row
        assert not ((low > least) | (high < most)).any(), row


@pytest.mark.parametrize("name", ["add", "sub", "mul", "div"])
def test_sums_products_and_quotients_hold_the_exact_values(name):
    exact = {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
    }[name]
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(2, 1, 2000)) * 10.0 ** rng.uniform(-300, 300, (2, 1, 2000))
    a[:, :1000], b[:, :1000] = rng.normal(size=(2, 1, 1000))
    ((low, high),) = BoundsKernel.build(of_two([(name, 0, 1)]))((a, a), (b, b))
    for x, y, least, most in zip(a[0], b[0], low[0], high[0]):
        value = exact(Fraction(x), Fraction(y))
        assert least == -np.inf or Fraction(least) < value
        assert most == np.inf or value < Fraction(most)


@pytest.mark.parametrize("name", ["cart-pole", "double-tank-a"])
def test_models_in_many_boxes(name):
    problem = problems.get(name)
    dynamics = transcribe(problem).dynamics
    rng = np.random.default_rng(6)
    lower = problem.domain.sample(1001, 7).T
    upper = lower + rng.random(lower.shape) * 0.1 * problem.domain.widths[:, None]
    control = np.repeat(problem.alphabet.values[:1].T, 1001, axis=1)
    boxes = (lower, upper), (control, control)
    got = box_bounds(dynamics, "c")(*boxes)
    check_not_tighter(["rates"], got, box_bounds(dynamics, "numpy")(*boxes))
    assert np.median(got[0][1] - got[0][0]) < np.inf
    one = box_bounds(dynamics, "c")(*((low[:, :1], high[:, :1]) for low, high in boxes))
    assert np.array_equal(one[0][0], got[0][0][:, :1])  # a box alone, in lanes of the same


def test_inputs_and_backends_are_checked(monkeypatch):
    kernel = BoundsKernel.build(of_two([("add", 0, 1)]))
    line = np.zeros((1, 3))
    with pytest.raises(ValueError, match=r"pairs of arrays \(1, B\)"):
        kernel((line, line), (line[0], line[0]))

    def fails(*_):
        raise KernelBuildError("no compiler")

    monkeypatch.setattr(bounds, "load", fails)
    program = of_two([("sub", 0, 1)])
    ((low, high),) = box_bounds(program)((line, line), (line, line))
    assert not low.any() and not high.any()
    with pytest.raises(KernelBuildError):
        box_bounds(program, "c")


def test_a_choice_is_one_of_its_branches():
    """What CasADi makes of if_else: both branches where either may hold, and no 0 beside them."""
    rows = [
        ("lt", 0, 1),
        ("not", 2),
        ("select", 2, 0),
        ("sqrt", 1),
        ("select", 3, 5),
        ("add", 4, 6),
    ]
    program = of_two(rows)
    lower = np.array([[1.0, 5.0, 2.0, 3.0]]), np.array([[4.0, 4.0, 3.0, -2.0]])
    upper = np.array([[2.0, 6.0, 4.0, 4.0]]), np.array([[4.0, 4.0, 5.0, -1.0]])
    boxes = (lower[0], upper[0]), (lower[1], upper[1])
    wanted = evaluate_intervals(program, *boxes)
    check_not_tighter(range(len(rows)), BoundsKernel.build(program)(*boxes), wanted)
    low, high = wanted[-1]
    assert low[0, :2].tolist() == [1.0, pytest.approx(2.0)] and high[0, 0] == 2.0
    assert 1.7 < low[0, 2] < 3**0.5 and high[0, 2] == 4.0  # a state of either branch
    assert np.isnan(low[0, 3])  # the branch that is taken is undefined
