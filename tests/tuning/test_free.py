"""Ranges and choices in the place of values, and the problems that they make."""

import pytest

from capsyn import Free, Problem, problems
from capsyn.errors import ProblemError
from capsyn.tuning.advice import advice
from capsyn.tuning.family import Family, with_settings
from capsyn.tuning.free import free_arguments
from capsyn.tuning.goal import Goal
from support.problems.block import block


def test_a_range_over_a_factor_of_ten_is_searched_by_its_logarithm():
    assert Free(0.1, 10).middle == 1.0 and Free(0.1, 10).log
    assert Free(1, 9).middle == 5.0 and not Free(1, 9).log
    assert Free(0, 10).middle == 5.0 and Free(-50, -0.5).middle == -25.25
    assert Free(1, 100, log=False).middle == 50.5
    assert [Free(0.1, 10).at(share) for share in (0.0, 1.0)] == [0.1, 10.0]


def test_values_have_four_digits_and_lie_within_the_bounds():
    assert Free(0, 1).value(0.123456) == 0.1235
    assert Free(0.12352, 1).value(0.12352) == 0.12352
    assert Free("0.1%", "10%").value(3.14159) == "3.142%"
    assert Free(1000.01, 1000.02).value(1000.0123456) == 1000.012346
    assert Free("0.1%", "10%").middle == "1.0%"


def test_choices():
    free = Free(choices=["schedule", "steepest"])
    assert free.middle == "schedule" and free.at(1.0) == "steepest"
    assert free.edge("schedule") is None and str(free) == "schedule, steepest"


@pytest.mark.parametrize(
    ("value", "edge"), [(0.1, 0.1), (0.11, 0.1), (1.0, None), (9.9, 10), (10, 10)]
)
def test_what_lies_at_a_bound(value, edge):
    assert Free(0.1, 10).edge(value) == edge


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((2, 1), "low < high; got 2 and 1"),
        ((1, 1), "low < high"),
        ((), "`low` must be a number; got None"),
        (("1%", 2), "two numbers or two shares"),
        (("a", "b"), "`low` must be a finite number"),
        ((1, float("inf")), "`high` must be a finite number"),
    ],
)
def test_bounds_that_cannot_be_used(arguments, said):
    with pytest.raises(ProblemError, match=said):
        Free(*arguments)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"low": 0, "high": 1, "log": True}, "low > 0 with `log`; got 0"),
        ({"low": 1, "high": 2, "log": 3}, "`log` must be True or False"),
        ({"choices": ["one"]}, "`choices` must be two or more values"),
        ({"choices": "ab"}, "`choices` must be two or more values"),
        ({"choices": [1, [2]]}, "texts, numbers or None"),
        ({"low": 1, "choices": [1, 2]}, "either bounds or `choices`"),
    ],
)
def test_options_that_cannot_be_used(options, said):
    with pytest.raises(ProblemError, match=said):
        Free(**options)


def test_arguments_of_a_function_are_free_and_become_settings():
    assert list(free_arguments(block)) == ["horizon", "effort"]
    assert free_arguments(block(1.0, 1.0)) == {} == free_arguments(Problem)
    made = Family.of(block)({"horizon": 2.0, "effort": 0.5})
    assert (made.horizon, made.settings.control_weight) == (2.0, 0.5)


def test_settings_of_any_problem():
    settings = {
        "horizon": 0.9,
        "control_weight": 0.7,
        "gamma": -2.0,
        "rule": "steepest",
        "price": "2%",
    }
    made = with_settings(problems.get("cart-pendulum"), settings)
    assert (made.horizon, made.switching.price) == (0.9, "2%")
    own = made.settings
    assert (own.control_weight, own.gamma, own.rule) == (0.7, -2.0, "steepest")
    tailed = with_settings(block(1.0, 0.1), {"tail": 0.5})
    assert tailed.tail == "riccati:0.5" and tailed.horizon != 1.0
    assert with_settings(block(1.0, 0.1), {"tail": 0.5, "horizon": 0.3}).horizon == 0.3
    fitted = with_settings(block(1.0, 0.1), {"tail": "fit"})
    assert (fitted.tail, fitted.horizon) == ("fit", 1.0)


def test_settings_that_cannot_be_used():
    with pytest.raises(ProblemError, match="no setting 'size' to be free; known are horizon, eff"):
        Family.of(block, {"size": Free(0, 1)})
    with pytest.raises(ProblemError, match="`free` horizon must be a capsyn.Free; got 3"):
        Family.of(block, {"horizon": 3})
    with pytest.raises(ProblemError, match="`problem` must be a capsyn.Problem, or a function"):
        Family.of(3)
    with pytest.raises(ProblemError, match="all that is free; effort is missing"):
        with_settings(block, {"horizon": 1.0})
    with pytest.raises(ProblemError, match="`horizon` must be a finite number > 0; got -1"):
        with_settings(block(1.0, 0.1), {"horizon": -1})


def broken(speed=Free(1, 2)):
    return 1 / (speed - speed)


def wrong(speed=Free(1, 2)):
    return speed


def test_functions_that_make_no_problem():
    with pytest.raises(ProblemError, match="`broken` failed: ZeroDivisionError"):
        with_settings(broken, {"speed": 1.5})
    with pytest.raises(ProblemError, match="`wrong` must return a capsyn.Problem; got 1.5"):
        with_settings(wrong, {"speed": 1.5})


def test_advice_names_ranges_at_whose_bounds_the_best_is_and_what_is_fixed():
    family = Family.of(block)
    said = advice(family, {"horizon": 3, "effort": 1.0}, Goal(0.99))
    assert said == "widen horizon, which is best at its bound 3, give the problem a tail"
    family = Family.of(block(1.0, 0.1), {"control_weight": Free(0.1, 10)})
    said = advice(family, {"control_weight": 1.0}, Goal(0.99, "switches"))
    assert said == "give the problem a tail, free horizon, free price"
    tailed = block(1.0, 0.1).replace(tail="riccati")
    free = {"control_weight": Free(0.1, 10), "horizon": Free(0.1, 1)}
    said = advice(Family.of(tailed, free), {"control_weight": 1.0, "horizon": 0.3}, Goal(0.99))
    assert said == "free tail"
