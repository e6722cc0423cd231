"""Every refusal is one line that names the argument, what it must be, and what came."""

import numpy as np
import pytest

from capsyn.errors import CapsynError, ProblemError
from capsyn.validation import (
    describe,
    distinct,
    finite_array,
    finite_number,
    is_list,
    numbers,
    one_of,
    texts,
    whole_number,
    whole_numbers,
)

NAN, INF = float("nan"), float("inf")
HUGE = 10**400  # an int that no float can hold

REFUSED = [
    (numbers, ("a", "3"), {}, "`a` must be numbers; got '3'"),
    (numbers, ("a", ["3"]), {}, "`a` must be numbers; got ['3']"),
    (numbers, ("a", [1, "3"]), {}, "`a` must be numbers; got [1, '3']"),
    (numbers, ("a", np.array([1j])), {}, "`a` must be numbers; got array([0.+1.j])"),
    (numbers, ("a", [[1], [1, 2]]), {}, "`a` must be numbers; got [[1], [1, 2]]"),
    (numbers, ("a", {1, 2}), {}, "`a` must be numbers; got {1, 2}"),
    (numbers, ("a", b"3"), {}, "`a` must be numbers; got b'3'"),
    (
        numbers,
        ("a", np.array("2020", dtype="M8[Y]")),
        {},
        "`a` must be numbers; got array('2020', dtype='datetime64[Y]')",
    ),
    (numbers, ("a", [HUGE]), {}, "`a` must be numbers; got [1" + "0" * 55 + "..."),
    (finite_array, ("a", 1.0, 1), {}, "`a` must be a list of numbers; got 1.0"),
    (finite_array, ("a", [[1.0]], 1), {}, "`a` must be a list of numbers; got [[1.0]]"),
    (finite_array, ("a", [1.0], 2), {}, "`a` must be a matrix of numbers; got [1.0]"),
    (finite_array, ("a", [1.0, NAN], 1), {}, "`a` must be finite; got [1.0, nan]"),
    (finite_array, ("a", [-INF], 1), {}, "`a` must be finite; got [-inf]"),
    (finite_number, ("a", "3"), {}, "`a` must be a number; got '3'"),
    (finite_number, ("a", None), {"least": 0}, "`a` must be a number >= 0; got None"),
    (finite_number, ("a", 1j), {}, "`a` must be a number; got 1j"),
    (finite_number, ("a", np.array(1j)), {}, "`a` must be a number; got array(0.+1.j)"),
    (finite_number, ("a", [1.0]), {"above": 0}, "`a` must be a number > 0; got [1.0]"),
    (finite_number, ("a", HUGE), {}, "`a` must be a number; got 1" + "0" * 56 + "..."),
    (finite_number, ("a", NAN), {}, "`a` must be a finite number; got nan"),
    (finite_number, ("a", INF), {"least": 0}, "`a` must be a finite number >= 0; got inf"),
    (finite_number, ("a", 0.0), {"above": 0}, "`a` must be a finite number > 0; got 0.0"),
    (finite_number, ("a", -0.5), {"least": 0}, "`a` must be a finite number >= 0; got -0.5"),
    (whole_number, ("a", 4.0), {"least": 1}, "`a` must be a whole number >= 1; got 4.0"),
    (whole_number, ("a", True), {"least": 0}, "`a` must be a whole number >= 0; got True"),
    (whole_number, ("a", "4"), {"least": 1}, "`a` must be a whole number >= 1; got '4'"),
    (whole_number, ("a", 0), {"least": 1}, "`a` must be a whole number >= 1; got 0"),
    (
        whole_number,
        ("a", 8),
        {"least": 1, "most": 7},
        "`a` must be a whole number >= 1 and <= 7; got 8",
    ),
    (
        whole_numbers,
        ("a", [1, 2, 3], 2),
        {"least": 1},
        "`a` must be a whole number or 2 of them, one per axis; got [1, 2, 3]",
    ),
    (
        whole_numbers,
        ("a", "12", 2),
        {"least": 1},
        "`a` must be a whole number or 2 of them, one per axis; got '12'",
    ),
    (
        whole_numbers,
        ("a", np.array(3), 1),
        {"least": 1},
        "`a` must be a whole number or 1 of them, one per axis; got array(3)",
    ),
    (
        whole_numbers,
        ("a", 2.0, 1),
        {"least": 1},
        "`a` must be a whole number or 1 of them, one per axis; got 2.0",
    ),
    (whole_numbers, ("a", [1, 0], 2), {"least": 1}, "`a[1]` must be a whole number >= 1; got 0"),
    (
        whole_numbers,
        ("a", [1, 9], 2),
        {"least": 1, "most": 8},
        "`a[1]` must be a whole number >= 1 and <= 8; got 9",
    ),
    (whole_numbers, ("a", False, 2), {"least": 0}, "`a` must be a whole number >= 0; got False"),
    (texts, ("a", "ab", 2, []), {}, "`a` must be 2 printable string(s); got 'ab'"),
    (texts, ("a", ["x"], 2, []), {}, "`a` must be 2 printable string(s); got ['x']"),
    (texts, ("a", ["x", 1], 2, []), {}, "`a` must be 2 printable string(s); got ['x', 1]"),
    (distinct, ("a", ["x", "x"]), {}, "`a` must be non-empty and distinct; got ['x', 'x']"),
    (distinct, ("a", ["x", ""]), {}, "`a` must be non-empty and distinct; got ['x', '']"),
    (one_of, ("a", "c", ["b", "d"]), {}, "`a` must be one of 'b', 'd'; got 'c'"),
    (one_of, ("a", ["b"], ["b", "d"]), {}, "`a` must be one of 'b', 'd'; got ['b']"),
]


@pytest.mark.parametrize(("check", "arguments", "options", "message"), REFUSED)
@pytest.mark.filterwarnings("error")
def test_refusals_say_what_is_wanted_and_what_came(check, arguments, options, message):
    with pytest.raises(ProblemError) as caught:
        check(*arguments, **options)
    assert str(caught.value) == message
    assert isinstance(caught.value, ValueError) and isinstance(caught.value, CapsynError)


def test_finite_array_is_a_read_only_copy():
    source = np.arange(3.0)
    array = finite_array("a", source, 1)
    source[0] = 7.0
    assert array.tolist() == [0.0, 1.0, 2.0] and array.dtype == float
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1.0


@pytest.mark.parametrize("value", [[1, 2], (True, 2.0), np.float32([1, 2]), np.array([1, 2], "u1")])
def test_numbers_of_any_real_type_become_floats(value):
    array = numbers("a", value)
    assert array.dtype == np.float64 and array.tolist() == [1.0, 2.0]


def test_numbers_copies_only_where_it_must():
    source = np.arange(4.0)
    assert numbers("a", source) is source
    assert np.shares_memory(numbers("a", source[::2]), source)


def test_bounds_are_inclusive_or_not_as_they_say():
    assert finite_number("a", 0, least=0) == 0.0
    assert finite_number("a", 5e-324, above=0) == 5e-324
    assert whole_number("a", 7, least=7, most=7) == 7


def test_whole_numbers_are_plain_ints():
    for value in (3, np.int64(3), [3, 3], (3, np.uint8(3)), np.array([3, 3])):
        found = whole_numbers("a", value, 2, least=1)
        assert found == (3, 3) and all(type(v) is int for v in found)


def test_is_list():
    assert is_list([1, 2], 2) and is_list((), 0) and is_list(np.zeros(2), 2)
    assert not any(is_list(v, 2) for v in ("ab", [1], {1, 2}, np.zeros((2, 2)), np.array(2), None))


def test_texts_default_and_copy():
    assert texts("a", None, 2, ["x", "y"]) == ("x", "y")
    assert texts("a", ["u", "v"], 2, []) == ("u", "v")


def test_describe_is_one_short_line():
    text = describe(np.arange(1000.0).reshape(100, 10))
    assert "\n" not in text and len(text) == 60 and text.endswith("...")
    assert describe("a" * 10) == repr("a" * 10)
