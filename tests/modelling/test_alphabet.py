"""The alphabet: distinct finite symbols, with names."""

import json
import pickle

import numpy as np
import pytest

from capsyn import Alphabet
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import MAX_SYMBOLS

REFUSED = [
    (([],), {}, "`alphabet` must have at least one symbol; got none"),
    (([[]],), {}, "`alphabet` must have shape (N, m); got (1, 0)"),
    ((5.0,), {}, "`alphabet` must have shape (N, m); got ()"),
    ((np.zeros((2, 2, 2)),), {}, "`alphabet` must have shape (N, m); got (2, 2, 2)"),
    ((["on", "off"],), {}, "`alphabet` must be numbers; got ['on', 'off']"),
    (([[1], [1, 2]],), {}, "`alphabet` must be numbers; got [[1], [1, 2]]"),
    (([10**400],), {}, "`alphabet` must be numbers; got [1" + "0" * 55 + "..."),
    (([1.0, float("nan")],), {}, "`alphabet` must be finite; got array([[ 1.], [nan]])"),
    (([1.0, float("inf")],), {}, "`alphabet` must be finite; got array([[ 1.], [inf]])"),
    (
        ([0.0, -0.0],),
        {},
        "`alphabet` must have distinct symbols, or names that tell them apart; got [0.0] twice",
    ),
    (
        ([[1, 2], [3, 4], [1, 2]],),
        {},
        "`alphabet` must have distinct symbols, or names that tell them apart; "
        "got [1.0, 2.0] twice",
    ),
    ((range(4097),), {}, "`alphabet` must have at most 4096 symbols; got 4097"),
    (([1, 2],), {"names": ["a"]}, "`alphabet names` must be 2 printable string(s); got ['a']"),
    (
        ([1, 2],),
        {"names": ["a", "a"]},
        "`alphabet names` must be non-empty and distinct; got ('a', 'a')",
    ),
    (
        ([1, 2],),
        {"inputs": ["u", "v"]},
        "`alphabet inputs` must be 1 printable string(s); got ['u', 'v']",
    ),
    (
        ([[1, 2]],),
        {"inputs": ["u", ""]},
        "`alphabet inputs` must be non-empty and distinct; got ('u', '')",
    ),
    (([1, 2],), {"units": "V"}, "`alphabet units` must be 1 printable string(s); got 'V'"),
]


@pytest.mark.parametrize(("arguments", "options", "message"), REFUSED)
def test_refusals(arguments, options, message):
    with pytest.raises(ProblemError) as caught:
        Alphabet(*arguments, **options)
    assert str(caught.value) == message


def test_one_input_accepts_a_flat_list():
    flat, column = Alphabet([-5, 5]), Alphabet([[-5.0], [5.0]])
    assert flat == column and hash(flat) == hash(column)
    assert flat.values.shape == (2, 1) and flat.m == 1 and len(flat) == 2
    assert flat.names == ("-5", "5") and flat.inputs == ("u1",) and flat.units == ("",)


def test_default_names_keep_close_symbols_apart():
    close = Alphabet([0.1, np.nextafter(0.1, 1), 1e300, 1e-300])
    assert len(set(close.names)) == 4
    assert [float(n) for n in close.names] == close.values[:, 0].tolist()
    assert Alphabet([[0, 1.5], [2, -3]]).names == ("(0, 1.5)", "(2, -3)")


def test_most_symbols():
    assert MAX_SYMBOLS == 4096 and len(Alphabet(range(4096))) == 4096


def test_values_are_a_read_only_copy():
    source = np.array([[1.0], [2.0]])
    alphabet = Alphabet(source)
    source[0] = 9
    assert alphabet.values.tolist() == [[1.0], [2.0]]
    with pytest.raises(ValueError, match="read-only"):
        alphabet.values[0] = 3


def test_equality_needs_every_field():
    options = {"names": ["a", "b"], "inputs": ["v"], "units": ["V"]}
    base = Alphabet([1, 2], **options)
    others = [
        Alphabet([1, 3], **options),
        Alphabet([2, 1], **options),
        Alphabet([1, 2], **{**options, "names": ["a", "c"]}),
        Alphabet([1, 2], **{**options, "inputs": ["w"]}),
        Alphabet([1, 2], **{**options, "units": ["A"]}),
    ]
    assert all(base != other for other in others) and base != "alphabet"
    assert base == Alphabet(np.int32([1, 2]), **options)


@pytest.mark.parametrize(
    "alphabet",
    [
        Alphabet([0.0, 1 / 3, -1e-308]),
        Alphabet([[1, 2], [3, 4]], ["up", "ü"], ["a", "b"], ["V", "m/s²"]),
    ],
)
def test_json_and_pickle_round_trips_are_equality(alphabet):
    again = Alphabet(**json.loads(json.dumps(alphabet.to_json(), allow_nan=False)))
    assert again == alphabet and hash(again) == hash(alphabet)
    assert pickle.loads(pickle.dumps(alphabet)) == alphabet
