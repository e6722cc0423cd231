"""Static controllers of SCOTS: read as they are, and every damage named by its line."""

import re
import tracemalloc
import warnings

import numpy as np
import pytest

from capsyn import Alphabet
from capsyn.errors import ProblemError
from capsyn.sources.scots import read_scots
from support.tables import assert_same, made_file, random_table, scots_file, scots_text

FIRST, STEP = [-0.3, 2.0], [0.1, 0.25]


file = made_file("scs")


def good():
    table = random_table((7, 5), seed=4)
    return table, scots_text(table, FIRST, STEP)


def head_of(text):
    """Return what is before the first row."""
    return text[: text.index("#BEGIN:35 1\n") + 12]


@pytest.mark.parametrize("counts", [(6,), (7, 5), (5, 4, 3)])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_files_are_read_as_they_were_written(counts, ending, file):
    table = random_table(counts, symbols=5, seed=1)
    first, step = np.linspace(-1, 2, len(counts)).tolist(), [0.02] * len(counts)
    text = scots_text(table, first, step).replace("\n", ending)
    found = read_scots(file(text))
    np.testing.assert_array_equal(found.masks, table.masks)
    np.testing.assert_allclose(found.first, first)
    assert found.step.tolist() == step and found.counts == counts
    assert found.alphabet.values.ravel().tolist() == [0, 1, 2, 3, 4]
    assert_same(found.policy(), found)


def test_the_first_axis_runs_fastest(file):
    _, text = good()
    head = head_of(text)
    found = read_scots(file(head + "1 2\n7 0 1\n#END\n"))
    assert found.masks[1, 0] == 4 and found.masks[0, 1] == 3
    assert np.count_nonzero(found.masks) == 2


def test_controls_may_be_named_anew(file):
    table, text = good()
    found = read_scots(file(text), Alphabet([-5, 0, 5], names=["left", "off", "right"]))
    assert found.alphabet.names == ("left", "off", "right")
    np.testing.assert_array_equal(found.masks, table.masks)
    with pytest.raises(ProblemError, match="`alphabet` must have 3 symbols like the input grid"):
        read_scots(file(text), Alphabet([0, 1]))


def test_of_many_inputs_those_in_use_are_symbols(file):
    _, text = good()
    head = head_of(text)
    head = re.sub(r"(INPUT_SPACE.*?UPPER_RIGHT\n#BEGIN:1\n)2.0", r"\g<1>99.0", head, flags=re.S)
    found = read_scots(file(head + "1 20 98\n7 3\n#END\n"))
    assert found.alphabet.values.ravel().tolist() == [3, 20, 98]
    assert found.masks[1, 0] == 6 and found.masks[0, 1] == 1
    rows = "".join(f"{k} {2 * k} {2 * k + 1}\n" for k in range(33))
    with pytest.raises(ProblemError, match="uses 66 inputs; a table has at most 63"):
        read_scots(file(head + rows + "#END\n"))


@pytest.mark.parametrize(
    "old, new, line, words",
    [
        ("v0.2", "v0.3", 1, "expected #SCOTS:v0.2; got '#SCOTS:v0.3'"),
        ("STATICCONTROLLER", "SETS", 2, "expected #TYPE:STATICCONTROLLER"),
        ("#MEMBER:DIM\n2", "#MEMBER:DIM\ntwo", 6, "expected a dimension, 1 to 16; got 'two'"),
        ("#MEMBER:DIM\n2", "#MEMBER:DIM\n17", 6, "expected a dimension, 1 to 16; got '17'"),
        ("0.25\n#END", "0.25x\n#END", 10, "expected a number; got '0.25x'"),
        ("0.25\n#END", "nan\n#END", 10, "expected a finite number; got 'nan'"),
        ("#VECTOR:ETA", "#VECTOR:ETTA", 7, "expected #VECTOR:ETA; got"),
        ("#BEGIN:35 1", "#BEGIN:36 1", 41, "expected #BEGIN:35, the points of the state grid"),
        ("#TYPE:WINNINGDOMAIN", "#TYPE:OTHER", 38, "expected #TYPE:WINNINGDOMAIN"),
    ],
)  # fmt: skip
def test_a_wrong_header_is_named_by_its_line(file, old, new, line, words):
    _, text = good()
    assert old in text
    with pytest.raises(ProblemError) as error:
        read_scots(file(text.replace(old, new, 1)))
    assert f"line {line}: " in str(error.value) and words in str(error.value)


@pytest.mark.parametrize(
    "rows, line, words",
    [
        ("1 2\n5 x\n#END\n", 43, "a row of whole numbers: a state and its inputs; got '5 x'"),
        ("1 2\n5 -1\n#END\n", 43, "expected a row of whole numbers"),
        ("1 2\n5 1.5\n#END\n", 43, "got '5 1.5'"),
        ("1 2\n5\n#END\n", 43, "expected a state and its inputs; got '5'"),
        ("1 2\n35 1\n#END\n", 43, "expected a state of the grid, 0 to 34; got '35 1'"),
        ("1 2\n4 0 3\n#END\n", 43, "expected inputs of the grid, 0 to 2; got '4 0 3'"),
        ("1 2\n\n4 0\n1 0\n#END\n", 45,
         "expected a state that has no row yet (line 42 has it); got '1 0'"),
        ("1 2\n4 0\n", 44, "expected #END, or a row of a state and its inputs; the file ends"),
        ("1 2\n4 0", 44, "the file ends"),
        ("1 2\n#EN\n", 43, "expected #END, or a row of a state and its inputs; got '#EN'"),
        ("1 2\n4 99999999999999999999\n#END\n", 43, "expected a row of whole numbers"),
    ],
)  # fmt: skip
def test_a_wrong_row_is_named_by_its_line(file, rows, line, words):
    _, text = good()
    head = head_of(text)
    assert head.count("\n") == 41
    with pytest.raises(ProblemError) as error:
        read_scots(file(head + rows))
    assert f"made.scs', line {line}: " in str(error.value) and words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_cut_off_anywhere_is_refused(file):
    _, text = good()
    for size in range(0, len(text) - 1, 3):
        with pytest.raises(ProblemError, match=r"line \d+: expected|the grid above"):
            read_scots(file(text[:size]))


def test_what_is_no_file_is_refused(tmp_path):
    with pytest.raises(ProblemError, match="cannot read '.*': No such file"):
        read_scots(tmp_path / "none.scs")
    with pytest.raises(ProblemError, match="is no file"):
        read_scots(tmp_path)


def test_grids_of_many_axes_and_points_take_neither_time_nor_memory(file):
    axes = 16
    one, many = (
        ([0.0] * axes, [1.0] * axes, [1] * axes),
        ([0.0] * axes, [1.0] * axes, [2**31] * axes),
    )
    small = ([0.0], [1.0], [2])
    tracemalloc.start()
    found = read_scots(file(scots_file(one, small, ["0 1"])))
    policy = found.policy()
    assert policy([0.3] * axes) == 1 and policy.cells.node_count == 1
    for inputs, words in (
        (
            many,
            "must have an input grid of at most 9,007,199,254,740,992 points; got 2,147,483,648 x",
        ),
        (([0.0, 0.0], [1.0, 1.0], [2**30, 2**24]), "at most 9,007,199,254,740,992 points"),
    ):
        with pytest.raises(ProblemError, match=words) as error:
            read_scots(file(scots_file(one, inputs, ["0 1"])))
        assert "\n" not in str(error.value) and len(str(error.value)) < 600
    with pytest.raises(ProblemError, match="must have at most 16,777,216 points"):
        read_scots(file(scots_file(many, small, ["0 1"], points=1)))
    found = read_scots(file(scots_file(one, ([0.0, 0.0], [1.0, 1.0], [2**30, 2**23]), ["0 7 9"])))
    assert found.alphabet.values.tolist() == [[7, 0], [9, 0]]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4e6


def test_grids_that_make_no_sense_are_refused(file):
    _, text = good()
    for old, new, words in (
        ("-0.3", "9.5", "lower left point that is not above"),
        ("0.25", "0.26", "corners that are whole steps apart"),
        ("0.25", "-0.25", "distances above 0"),
        ("0.25", "1e-300", "corners that are whole|at most 16,777,216 points"),
        ("0.25", "0.00000001", "at most 16,777,216 points"),
        ("-0.3", "-1e308", "corners that are whole steps apart"),
        ("0.25", "5e-324", "corners that are whole steps apart"),
    ):
        with pytest.raises(ProblemError, match=words), warnings.catch_warnings():
            warnings.simplefilter("error")
            read_scots(file(text.replace(old, new, 1)))


def test_a_table_without_rows_is_refused(file):
    _, text = good()
    with pytest.raises(ProblemError, match="must have rows of states and inputs; it has none"):
        read_scots(file(head_of(text) + "#END\n"))


def same_as(found, table):
    np.testing.assert_array_equal(found.masks, table.masks)
    np.testing.assert_allclose(found.first, FIRST, atol=1e-5)
    np.testing.assert_allclose(found.step, STEP, atol=1e-5)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: ("\ufeff" + text).encode("utf-16-be"),
        lambda text: text.replace("v0.2", "v0.1"),
        lambda text: text.replace("#SCOTS:i (", "#SCOTS: i  ("),
        lambda text: text.replace("#SCOTS:i (state) j_0 ... j_n (valid inputs)\n", ""),
        lambda text: text.replace("#TYPE:W", "\n# written today\n## twice\n#TYPE:W"),
        lambda text: text.replace("#VECTOR:ETA", "# of the grid\n\n#Vector: eta"),
        lambda text: text.replace("0.25\n#END", "# by hand\n0.25 \n#END"),
        lambda text: text.replace("#BEGIN:35 1\n", "#BEGIN: 35\n# rows\n\n") + "\n# the end",
        lambda text: re.sub(r"\n(\d+) (\d)", r"\n  \1\t\2", text).replace("\n", "\r\n"),
    ],
)
def test_files_may_be_written_in_other_ways(change, file):
    table, text = good()
    changed = change(text)
    assert changed != text
    same_as(read_scots(file(changed)), table)


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
@pytest.mark.parametrize("comment", ["#", "##", "# ", "#SCOTS:i"])
def test_a_comment_among_the_rows_takes_no_row_with_it(comment, ending, file):
    _, text = good()
    rows = f"1 2\n{comment}\n4 0\n#\n#\n5 1\n#END\n#"
    found = read_scots(file((head_of(text) + rows).replace("\n", ending)))
    assert np.flatnonzero(found.masks.ravel(order="F")).tolist() == [1, 4, 5]
    with pytest.raises(ProblemError, match="line 4[34]: expected #END, .*; the file ends"):
        read_scots(file((head_of(text) + "1 2\n#").replace("\n", ending)))


@pytest.mark.parametrize("digits", [4, 6])
@pytest.mark.parametrize("turns", [1, 3])
def test_steps_may_be_rounded(digits, turns, file):
    """Steps of a part of a turn have no end in decimals."""
    table = random_table((35, 21), seed=5)
    step, first = [turns * 2 * np.pi / 35, 0.2], [-turns * np.pi * 34 / 35, -2.0]
    text = scots_text(table, first, step)
    rounded = re.sub(r"-?\d+\.\d+", lambda match: f"{float(match[0]):.{digits}g}", text)
    assert rounded != text
    found = read_scots(file(rounded))
    np.testing.assert_array_equal(found.masks, table.masks)
    np.testing.assert_allclose(found.step, step, rtol=10.0 ** (1 - digits))
    last = found.first + found.step * 34  # steps come from the corners
    np.testing.assert_allclose(last[0], -first[0], rtol=10.0 ** (1 - digits))
