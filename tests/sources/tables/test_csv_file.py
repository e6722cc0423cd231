"""CSV files as other tools write them: the same table, whatever they look like."""

import numpy as np
import pytest

from capsyn import Alphabet, Policy, compress
from capsyn.errors import ProblemError
from capsyn.sources.grid_files import read_csv, read_table
from capsyn.sources.table import Table
from support.processes.command_line import capsyn as command
from support.tables import assert_same, dtcontrol_text, long_csv, made_file, random_table

file = made_file("csv")

ROWS = [(0, 0.5, -5), (0, 1.5, 5), (1, 0.5, 5), (1, 1.5, -5), (2, 0.5, 5), (2, 1.5, 5)]
MASKS = [[1, 2], [2, 1], [2, 2]]


def text_of(separator=",", head=("x", "v", "symbol"), mark=".", rows=ROWS):
    lines = [separator.join(head)]
    lines += [separator.join(str(v).replace(".", mark) for v in row) for row in rows]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        text_of(";"),
        text_of(";", mark=","),
        text_of("\t"),
        text_of("\t", mark=","),
        text_of(" "),
        text_of("   ", mark=","),
        text_of(", "),
        text_of(head=("x", "v", "action")),
        text_of(head=('"x"', '"v"', '"u"')),
        text_of(head=("x [m]", "v (m/s)", "force [N]")),
        text_of(" ", head=("x [m]", "v (m / s)", "force [N]")),
        text_of(";", head=("x", "v", "symbol"), mark=",").replace("0,5", '"0,5"'),
        "sep=;\n" + text_of(";"),
        "# made by hand\n% twice\n" + text_of().replace("\n1,", "\n// between\n1,"),
        "# 6 rows\n# x v symbol\n" + text_of(" ").split("\n", 1)[1],
        "# x,v,symbol\n" + text_of().split("\n", 1)[1],
        text_of().split("\n", 1)[1],
        text_of().replace("\n", ",\n"),
        text_of().replace("\n", "\r\n"),
        text_of().replace("\n", "\r"),
        text_of(head=("", "x", "v", "u"), rows=[(k, *row) for k, row in enumerate(ROWS)]),
        text_of(head=("Unnamed: 0", "x", "v", "u"), rows=[(7 * k, *r) for k, r in enumerate(ROWS)]),
        text_of(" ", rows=[(f'"{k + 1}"', *row) for k, row in enumerate(ROWS)]),
        "\n\n" + text_of().replace("\n1,", "\n\n1,"),
    ],
)
def test_other_ways_to_write_a_file(text, file):
    found = read_csv(file(text))
    assert found.masks.tolist() == MASKS
    assert found.first.tolist() == [0, 0.5] and found.step.tolist() == [1, 1]
    assert found.alphabet.values.ravel().tolist() == [-5, 5]
    if "(" in text:
        assert found.box().units[0] == "m" and found.alphabet.units == ("N",)
        assert found.box().names == ("x", "v") and found.alphabet.inputs == ("force",)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-32", "cp1252"])
def test_encodings(encoding, file):
    found = read_csv(file(text_of(head=("Füllung [°]", "v", "u")).encode(encoding)))
    assert found.masks.tolist() == MASKS
    assert found.box().names[0] == "Füllung" and found.box().units[0] == "°"


@pytest.mark.parametrize("none", ["", "nan", "NaN", "NA", "N/A", "null", "None"])
def test_gaps_have_many_names(none, file):
    for row in ("{}", " {} "):
        text = text_of().replace("1,0.5,5", "1,0.5," + row.format(none))
        assert read_csv(file(text)).masks.tolist() == [[1, 2], [0, 1], [2, 2]]
    names = Alphabet([-5, 5, 0], ["-5", "5", "NA"])  # here it is a symbol
    text = text_of().replace("1,0.5,5", "1,0.5,NA")
    assert read_csv(file(text), names).masks[1, 0] == 4


@pytest.mark.parametrize("separator, number", [(",", repr), (";", "{:.9g}".format), (" ", str)])
@pytest.mark.parametrize("index", [False, True])
def test_rows_for_each_allowed_input_come_back(separator, number, index, file):
    rough = random_table((13, 9), symbols=4, seed=2)
    alphabet = Alphabet([[0, 0], [0, 1], [2.5, -1], [3, 0]], inputs=["fill", "drain"])
    table = Table(rough.first, rough.step, rough.masks, alphabet, ["level", "rate"])
    path = file(long_csv(table, ["level", "rate"], separator, index, number))
    found = read_csv(path, inputs=["fill", "drain"])
    np.testing.assert_array_equal(found.masks, table.masks)
    np.testing.assert_allclose(found.first, table.first)
    assert found.alphabet == alphabet and found.box().names == ("level", "rate")
    assert_same(found.policy(), table)


def test_inputs_are_known_by_their_names(file):
    rough = random_table((6, 5), several=False, seed=3)
    for inputs in (["u1", "u2"], ["input_a", "input_b"], ["act[0]", "act[1]"], ["u_1", "u_2"]):
        alphabet = Alphabet([[0, 0], [0, 1], [2, 1]], inputs=inputs)
        table = Table(rough.first, rough.step, rough.masks, alphabet)
        found = read_csv(file(long_csv(table, ["x1", "x2"])))
        np.testing.assert_array_equal(found.masks, table.masks)
        assert found.alphabet == alphabet
    assert read_csv(file("x1,x2\n0,5\n1,6\n")).counts == (2,)  # not all of them
    text = "u1,x,u2\n1,0,2\n3,1,4\n"
    assert read_csv(file(text), inputs=["u2", "u1"]).alphabet.values.tolist() == [[2, 1], [4, 3]]


def test_names_of_symbols_make_an_alphabet(file):
    found = read_csv(file('level,do\n0,"fill"\n1,off\n2,drain\n3,\n4,off|drain\n'))
    assert found.alphabet.names == ("fill", "off", "drain") and found.alphabet.inputs == ("do",)
    assert found.masks.tolist() == [1, 2, 4, 0, 6]


def test_controls_may_be_vectors_in_brackets_or_true_and_false(file):
    for texts in (("(1, 0)", "(0, 1)"), ("[1 0]", "[0 1]"), ("(1.0;0)", "(0;1.0)")):
        found = read_csv(file("x,u\n" + "".join(f'{k},"{texts[k % 2]}"\n' for k in range(4))))
        assert found.alphabet.values.tolist() == [[0, 1], [1, 0]]
        assert found.masks.tolist() == [2, 1, 2, 1]
    found = read_csv(file("x,u\n0,(1)\n1,(1 2)\n"))  # names
    assert found.alphabet.names == ("(1)", "(1 2)")
    text = "x,fill,drain\n0,True,False\n1,False,True\n"
    found = read_csv(file(text), inputs=["fill", "drain"])
    assert found.alphabet.values.tolist() == [[0, 1], [1, 0]] and found.masks.tolist() == [2, 1]


def test_the_command_takes_several_inputs(tmp_path):
    path, made = tmp_path / "t.csv", tmp_path / "t.cap"
    path.write_text("level (m),fill,drain [l/s]\n0,1,0\n1,0,2\n2,NA,NA\n", encoding="utf-16")
    for options, names in (([], ("(0, 2)", "(1, 0)")), (["--alphabet", "b=0,2;a=1,0"], ("b", "a"))):
        command("import", path, "--inputs", "fill,drain", "-o", made, *options)
        policy = Policy.load(made)
        assert policy.alphabet.names == names and policy.alphabet.units == ("", "l/s")
        assert policy.alphabet.inputs == ("fill", "drain")
        assert policy.control([[0.0], [1.0]]).tolist() == [[1, 0], [0, 2]]
        assert policy.domain.units == ("m",) and not policy.covers([2.0])
        assert_same(policy, read_table(path, policy.alphabet, inputs=["fill", "drain"]))
    tree = compress(policy)
    assert tree([0.4]) == 1 and tree.control([0.6]).tolist() == [0, 2]


def test_vectors_are_those_of_an_alphabet(file):
    alphabet = Alphabet([[1, 0], [0, 1]], ["fill", "drain"])
    text = "x,u1,u2\n0,1,0\n1,0,1\n2,,\n"
    found = read_csv(file(text), alphabet)
    assert found.alphabet == alphabet and found.masks.tolist() == [1, 2, 0]
    with pytest.raises(
        ProblemError, match=r"must have controls of `alphabet` .*; got \[1.0, 1.0\]"
    ):
        read_csv(file(text.replace("0,1\n", "1,1\n")), alphabet)


@pytest.mark.parametrize(
    "text, words",
    [
        (
            "x,v,symbol\n0,0,1\n1,0,1\n2,0,1\n5,0,1\n10,1,1\n20,1,1\n",
            "axis 'x' is not uniform: steps 1 .. 10; axes must be",
        ),
        ("x,u\n1,1\n2,1\n4,1\n8,1\n16,1\n", "axis 'x' is not uniform: steps 1 .. 8; axes must be"),
        ("x,u1,u2\n0,1,0\n1,0,\n", "line 3: expected a number for every input, or for none"),
        ("x,u1,u2\n0,1,0\n1,0,on\n", "line 3: expected controls that are finite numbers; got 'on'"),
        (
            "x,v,fill,drain\n0,0,0,1\n0,1,1,0\n1,0,1,0\n1,1,0,1\n",
            "has one value of 'fill' for each of x, v: if it is an input, `inputs` (--inputs) must",
        ),
        ("x;u\n0.5;1\n1,5;1\n2;1\n", "line 3: expected a finite number for 'x', with the "
         "decimal mark of the other rows; got '1,5'"),
        ("x;u\n0;1\n1_0;1\n20;1\n", "line 3: expected a finite number for 'x'; got '1_0'"),
        ("x;u\n0;1\n1;1_0\n2;5\n", "line 3: expected controls that are finite numbers; got '1_0'"),
        ("x;u1;u2\n0;1;1\n1;1;1_0\n", "line 3: expected controls that are finite num"),
        ("x;u\n0;1\n\u0661;1\n2;5\n", "line 3: expected a finite number for 'x'; got '\u0661'"),
        ("x;u\n0;1\n1;\u0661\n2;5\n", "line 3: expected controls that are finite numbers; got"),
        ("x;u\n0;1,000\n1;0.5\n", "line 2: expected controls that are finite numbers, with the "
         "decimal mark of the other rows; got '1,000'"),
        ("x;u\n0;0.5\n1;2|1,5\n", "line 3: expected controls that are finite numbers, with the de"),
        ("x;u1;u2\n0;1,000;0\n1;0.5;0\n", "line 2: expected controls that are finite numbers, wi"),
        ("x;u\n0,5;1\n1,5;1\nx.y;1\n", "line 4: expected a finite number for 'x'; got 'x.y'"),
        ("x;u\n1e300;1\n2;1\n", "line 2: expected a number within +-1e+290 for 'x'; got '1e300'"),
        (",x,u\n0.5,1,1\n1,2,1\n", "line 1: expected a name for column 1, which does not number"),
        ("x,u,\n0,1,\n1,1,2\n", "line 3: expected nothing behind the last separator; got '2'"),
        ("#PERMISSIVE\n0,1\n1,1\n", "line 2: expected #BEGIN, the number of states"),
        ("#PERMISSIVE\n#BEGIN 3 1\n0,1\n1,1\n", "line 3: expected 3 states and 1 inputs, as"),
        ("x,u\n" + "".join(f"{k},{k}\n" for k in range(99)), "at most 63 symbols; got 99"),
        ("x,u1,u2\n" + "".join(f"{k},{k},0\n" for k in range(99)), "at most 63 symbols; got 99"),
        ("x,u\n" + "".join(f"{k},s{k}\n" for k in range(99)), "at most 63 symbols; got 99"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_told(text, words, file):
    with pytest.raises(ProblemError) as error:
        read_csv(file(text))
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("rows", [("0,5", "1", "1.5"), ("0.5", "1", "1,5"), ("0", "0,5", "1.0")])
def test_a_column_has_one_decimal_mark_however_it_is_read(rows, file, monkeypatch):
    for chunk in (1, 2, 3):
        monkeypatch.setattr("capsyn.sources.tables.lines.CHUNK", chunk)
        path = file("x;u\n" + "".join(f"{row};1\n" for row in rows))
        with pytest.raises(ProblemError, match="'x', with the decimal mark of the other rows; got"):
            read_csv(path)
        each = read_csv(file("x;u\n0,5;1.5\n1,0;1.25\n1,5;1.5\n"))  # its own
        assert each.first == 0.5 and each.alphabet.values.ravel().tolist() == [1.25, 1.5]


@pytest.mark.parametrize(
    "comment, names",
    [
        ("# made on 2024, by me", None),
        ("# author: me, 2024", None),
        ("# 2024-01-01, v1", None),
        ("# see, https://example.org", None),
        ("# ,", None),
        ("# x, u", ("x",)),
        ("# x' [m / s], u (N)", ("x'",)),
        ('% "Ball[0].p", u', ("Ball[0].p",)),
        ("// F\u00fcllung[l],u_1", ("F\u00fcllung",)),
    ],
)
def test_a_comment_has_names_of_columns_where_it_looks_like_them(comment, names, file):
    found = read_csv(file(f"{comment}\n0,1\n1,2\n"))
    assert found.box().names == (names or ("x1",)) and found.masks.tolist() == [1, 2]
    assert names is None or found.alphabet.inputs[0].startswith("u")


def test_inputs_must_be_columns(file):
    path = file("x,v,u\n0,0,1\n0,1,1\n1,0,1\n1,1,1\n")
    for inputs, words in (
        (["w"], "must name columns of the file, each once, among x, v, u; got 'w'"),
        (["u", "u"], "must name columns of the file, each once"),
        (["x", "v", "u"], "expected a column for a state beside the inputs; got 'x,v,u'"),
        ("u", "`inputs` must be names of columns; got 'u'"),
        ([], "`inputs` must be names of columns"),
        ([3], "`inputs` must be names of columns"),
    ):
        with pytest.raises(ProblemError) as error:
            read_csv(path, inputs=inputs)
        assert words in str(error.value)


@pytest.mark.parametrize("several", [False, True])
def test_files_of_dtcontrol_come_back(several, file):
    rough = random_table((8, 7, 3), several=several, seed=9)
    alphabet = Alphabet([[0, 0.1], [0, 0.15], [1, 0.1]], inputs=["u_0", "u_1"])
    table = Table(rough.first, rough.step, rough.masks, alphabet)
    text = dtcontrol_text(table)
    assert text.startswith("#PERMISSIVE" if several else "#NON-PERMISSIVE")
    found = read_table(file(text))
    np.testing.assert_array_equal(found.masks, table.masks)
    assert found.alphabet == alphabet and found.box().names == ("x_0", "x_1", "x_2")
    assert_same(found.policy(), table)
