"""Schedulers of Storm and strategies of PRISM: read back as they were written."""

import json

import numpy as np
import pytest

from capsyn import Alphabet
from capsyn.errors import ProblemError
from capsyn.sources.grid_files import read_table
from capsyn.sources.tables.prism import read_prism
from capsyn.sources.tables.storm import read_storm
from support.tables import assert_same, prism_texts, storm_text, whole_table

COUNTS = [(6,), (7, 5), (4, 3, 5)]


def same_as(found, table):
    """Compare tables whose symbols are in another order; the found one may be less wide."""
    names = [*table.alphabet.names, None]
    points = table.points()
    place = np.rint(points - found.first).astype(int)
    inside = ((place >= 0) & (place < found.counts)).all(axis=1)
    symbols = np.full(len(points), -1)
    symbols[inside] = found.symbols[tuple(place[inside].T)]
    own = [*found.alphabet.names, None]
    assert [own[k] for k in symbols] == [names[k] for k in table.symbols.ravel()]
    assert found.box().names == table.box().names and (found.step == 1).all()
    assert_same(found.policy(), found)


@pytest.mark.parametrize("counts", COUNTS)
@pytest.mark.parametrize("kind", ["labels", "origin"])
def test_schedulers_of_storm_come_back(counts, kind, tmp_path):
    table = whole_table(counts, seed=1)
    path = tmp_path / "scheduler.json"
    path.write_text(storm_text(table, kind))
    same_as(read_table(path), table)


@pytest.mark.parametrize("counts", COUNTS)
@pytest.mark.parametrize("kind", ["numbered", "values", "induced"])
def test_strategies_of_prism_come_back(counts, kind, tmp_path):
    table = whole_table(counts, seed=2)
    text, states = prism_texts(table, kind != "values", kind == "induced")
    path = tmp_path / ("strategy.tra" if kind == "induced" else "strategy.txt")
    path.write_text(f"# of PRISM\n{text}")
    (tmp_path / "strategy.sta").write_text(f"# States\n{states}")
    same_as(read_table(path), table)
    if kind == "numbered":
        (tmp_path / "strategy.sta").rename(tmp_path / "other")
        with pytest.raises(ProblemError, match="numbers its states; `states` .--exported-states."):
            read_table(path)
        same_as(read_table(path, states=tmp_path / "other"), table)


def test_permissive_strategies_have_several_symbols(tmp_path):
    table = whole_table((5, 4), seed=3, several=True)
    text, states = prism_texts(table)
    (tmp_path / "s.prism").write_text(text)
    (tmp_path / "s_states.prism").write_text(states)  # as dtControl calls it
    found = read_table(tmp_path / "s.prism", table.alphabet)
    assert found.alphabet == table.alphabet
    np.testing.assert_array_equal(found.masks, table.masks)


def test_controls_may_be_given_by_name_or_in_order(tmp_path):
    path = tmp_path / "s.txt"
    path.write_text("(0)=up\n(1)=down\n(2)=up\n(3)=?\n")
    by_name = Alphabet([-1, 0, 1], ["down", "off", "up"])
    assert read_prism(path, by_name).masks.tolist() == [4, 1, 4, 0]
    assert read_prism(path, Alphabet([1, -1])).masks.tolist() == [1, 2, 1, 0]
    for wrong in (Alphabet([1, 2, 3]), Alphabet([1, 2], ["up", "left"])):
        with pytest.raises(
            ProblemError, match="must have the names of the file's symbols, or be 2"
        ):
            read_prism(path, wrong)
    path.write_text("(0)=error\n(1)=a\n")  # a name that is taken
    assert read_prism(path).alphabet.names == ("error_", "a")
    assert read_prism(path, Alphabet([7, 8], ["a", "error_"])).masks.tolist() == [2, 1]
    path.write_text("(0)=3\n(true)=1\n")  # indices of choices
    assert read_prism(path).alphabet.values.ravel().tolist() == [1, 3]


ENTRY = {"s": {"x": 0, "b": True}, "c": [{"index": 0, "labels": ["a"], "prob": 1.0}]}


@pytest.mark.parametrize(
    "change, words",
    [
        ([], "must be a list of states, as Storm writes it"),
        ([{"s": 1}], "state 1 of the list: expected an object with 's' and 'c'"),
        ([ENTRY | {"m": 1}], "expected a scheduler without memory; got memory state 1"),
        ([ENTRY, ENTRY | {"s": {"x": 1}}], "state 2 of the list: expected the variables x, b"),
        ([ENTRY | {"s": {"x": "0"}}], "expected a whole number or boolean for 'x'; got '0'"),
        ([ENTRY | {"s": {"x": 0.5}}], "state 1: expected a whole number for 'x'; got 0.5"),
        ([ENTRY | {"s": {"x": 1e300}}], "expected a number within +-1e15 for 'x'"),
        ([ENTRY | {"c": ENTRY["c"] * 2}], "the scheduler must not be randomised; got 2 choices"),
        ([ENTRY | {"c": "undefined"}], "must have a symbol at some state; all of them are gaps"),
        ([ENTRY | {"c": [{"index": 3}]}], "must have names of choices: run Storm with"),
        ([ENTRY | {"c": [{"labels": ["\n"]}]}], "expected a printable name of a choice"),
        ([ENTRY, ENTRY | {"s": {"x": 2**24, "b": False}}], "at most 16,777,216 points"),
        ([ENTRY | {"s": {f"x{k}": 0 for k in range(17)}}], "at most 16 axes; got 17"),
    ],
)  # fmt: skip
def test_other_schedulers_are_refused(change, words, tmp_path):
    path = tmp_path / "s.json"
    path.write_text(json.dumps(change))
    with pytest.raises(ProblemError) as error:
        read_storm(path)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_choices_without_labels_have_names_of_their_own(tmp_path):
    path = tmp_path / "s.json"
    origins = [{"action-label": "", "transitions": [k]} for k in (1, 2, 1)]
    choices = [[{"index": k, "origin": origin}] for k, origin in enumerate(origins)]
    choices += [[{"index": 3}], [{"index": 4, "origin": {"action-label": "go"}}]]
    path.write_text(json.dumps([{"s": {"x": k}, "c": c} for k, c in enumerate(choices)]))
    found = read_storm(path)
    assert found.alphabet.names == ("command 1", "command 2", "loop", "go")
    assert found.symbols.tolist() == [0, 1, 0, 2, 3]


@pytest.mark.parametrize(
    "text, states, words",
    [
        ("", None, "line 1: expected a state and its action; the file ends"),
        ("(0)=a\n(1) b\n", None, "line 2: expected a state and its action, as 0:action or"),
        ("(0),1=a\n", None, "line 1: expected a strategy without memory"),
        ("(0)={0.5:a,0.5:b}\n", None, "line 1: expected one action: the strategy must not be"),
        ("(0)=a\n(0,1)=b\n", None, "line 2: expected 1 values of variables"),
        ("(x)=a\n", None, "line 1: expected values of variables: whole numbers, true or false"),
        ("(0.5)=a\n", None, "line 1: expected a whole number for 'x1'; got 0.5"),
        ("(0)=a\n(99999999)=a\n", None, "at most 16,777,216 points"),
        ("0:a\n7:b\n", "(x)\n0:(0)\n", "line 2: expected a state of"),
        ("0:a\n", "(x)\n0:(0)\n0:(1)\n", "line 3: expected a state that has no line yet"),
        ("0:a\n", "(x)\n0:(0,1)\n", "line 2: expected 1 values of variables"),
        ("0:a\n", "0:(0)\n", "line 1: expected (NAME,..), the variables; got '0:(0)'"),
        ("0:a\n", "(x)\n0 (0)\n", "line 2: expected a state, as 0:(0,1); got '0 (0)'"),
        ("2 1\n0 0 1\n", "(x)\n0:(0)\n", "line 2: expected 3 numbers and the name of an action"),
        ("(0)=\n(1)=-\n", None, "must have a symbol at some state; all of them are gaps"),
        ("".join(f"({k})=a{k}\n" for k in range(64)), None, "at most 63 symbols; got 64"),
    ],
)  # fmt: skip
def test_other_strategies_of_prism_are_refused(text, states, words, tmp_path):
    path = tmp_path / "s.txt"
    path.write_text(text)
    if states is not None:
        (tmp_path / "s.sta").write_text(states)
    with pytest.raises(ProblemError) as error:
        read_prism(path)
    assert words in str(error.value) and "\n" not in str(error.value)
