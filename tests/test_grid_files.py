"""Tables in CSV files and NumPy archives, and the command that imports them."""

import json

import numpy as np
import pytest

from capsyn import Alphabet, Policy
from capsyn.errors import ProblemError
from capsyn.sources.grid_files import read_csv, read_npz, read_table
from tables import assert_same, random_table, scots_text
from test_cli import capsyn, error_of

GOOD = "x,v [m/s],symbol\n0,0.1,-5\n0,0.2,5\n1,0.1,\n1,0.2,-5|5\n"


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "made.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def test_numbers_become_controls(file):
    table = read_csv(file(GOOD))
    assert table.alphabet.values.ravel().tolist() == [-5, 5]
    assert table.masks.tolist() == [[1, 2], [0, 3]]
    policy = table.policy()
    assert policy.domain.names == ("x", "v") and policy.domain.units == ("", "m/s")
    np.testing.assert_allclose(policy.domain.lower, [-0.5, 0.05])
    assert policy([1, 0.2]) == 0 and not policy.covers([1, 0.1])


@pytest.mark.parametrize("digits", [3, 17])
def test_rows_may_come_in_any_order_and_rounded(file, digits):
    table = random_table((7, 6, 5), seed=8)
    points, symbols = table.points(), table.symbols.ravel()
    order = np.random.default_rng(0).permutation(len(points))
    rows = [
        ",".join([*(f"{v:.{digits}g}" for v in points[i]), str(symbols[i]).replace("-1", "")])
        for i in order
    ]
    found = read_csv(file("a,b,c,symbol\n" + "\n".join(rows)), table.alphabet)
    np.testing.assert_array_equal(found.symbols, table.symbols)
    np.testing.assert_allclose(found.first, table.first, atol=0.01)


def test_names_and_indices_of_an_alphabet(file):
    names = Alphabet([-5, 0, 5], names=["left", "off", "right"])
    text = "x,symbol\n0,left\n1,off | right\n2,2\n3,\n"
    assert read_csv(file(text), names).masks.tolist() == [1, 6, 4, 0]
    with pytest.raises(ProblemError, match="line 3: expected symbols among left, off, right"):
        read_csv(file("x,symbol\n0,left\n1,lef\n"), names)


def test_missing_points_are_named_or_outside(file):
    text = "x,v,symbol\n0,0,1\n0,1,2\n1,0,1\n2,0,2\n2,1,1\n"
    with pytest.raises(ProblemError, match=r"grid of 3 x 2; 1 are missing, the first at \(1, 1\)"):
        read_csv(file(text))
    assert read_csv(file(text), missing="outside").masks.tolist() == [[1, 2], [1, 0], [2, 1]]


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "line 1: expected the names of the states, then symbol; the file ends"),
        ("x,v\n0,1\n", "line 1: expected the names of the states, then symbol; got 'x,v'"),
        ("symbol\n0\n", "line 1: expected the names"),
        ("x,symbol\n", "line 2: expected a row of a state and its symbol; the file ends"),
        ("x,symbol\n0,1\n1\n", "line 3: expected 2 fields; got '1'"),
        ("x,symbol\n0,1\n1,2,3\n", "line 3: expected 2 fields; got '1,2,3'"),
        ("x,symbol\n0,1\nb,2\n", "line 3: expected a finite number for 'x'; got 'b'"),
        ("x,symbol\n0,1\nnan,2\n", "line 3: expected a finite number for 'x'; got 'nan'"),
        ("x,symbol\n0,1\n1,up\n", "3: expected controls that are finite numbers; got 'up'"),
        ("x,symbol\n0,1\n1,2\n0,2\n",
         "line 4: expected a state that has no row yet (line 2 has it); got '0'"),
        ("x,symbol\n0,1\n1,1\n2,1\n3.4,1\n4,1\n", "line 5: expected 'x' on the grid 0 + 1 k; got"),
        ("x,symbol\n0,1\n0,1\n", "must have two values of 'x' at least; got one"),
        ('x,symbol\n0,"1\n', "line 2: unexpected end of data"),
        (b"\xff\xfe\x00", "is no CSV file: it is not text in UTF-8"),
        ("x,y,symbol\n" + "".join(f"{k},{k},1\n" for k in range(9000)), "at most 16,777,216"),
        ("x,x,symbol\n0,0,1\n0,1,1\n1,0,1\n1,1,1\n", "`names` must be non-empty and distinct"),
    ],
)  # fmt: skip
def test_damage_is_named(file, text, words):
    with pytest.raises(ProblemError) as error:
        read_csv(file(text))
    assert words in str(error.value) and "\n" not in str(error.value)


def test_archives(tmp_path):
    table = random_table((9, 8), several=False)
    arrays = {"first": table.first, "step": table.step, "symbols": table.symbols}
    np.savez(tmp_path / "t.npz", **arrays, alphabet=[0, 1, 2])
    found = read_table(tmp_path / "t.npz")
    np.testing.assert_array_equal(found.masks, table.masks)
    assert read_npz(tmp_path / "t.npz", Alphabet([7, 8, 9])).alphabet.values[0] == 7
    np.savez(tmp_path / "u.npz", **arrays)
    with pytest.raises(ProblemError, match="it has no 'alphabet'"):
        read_npz(tmp_path / "u.npz")
    np.savez(tmp_path / "v.npz", **arrays | {"symbols": np.array([{}])}, alphabet=[1])
    for damaged in ((tmp_path / "t.npz").read_bytes()[:-40], b"x", b""):
        (tmp_path / "w.npz").write_bytes(damaged)
        with pytest.raises(ProblemError, match="is no NumPy archive"):
            read_npz(tmp_path / "w.npz")
    with pytest.raises(ProblemError, match="is no NumPy archive of arrays: .*pickle"):
        read_npz(tmp_path / "v.npz")


def test_other_endings_are_refused(tmp_path):
    with pytest.raises(ProblemError, match="a table must end in .scs, .csv or .npz; got 't.txt'"):
        read_table("t.txt")
    with pytest.raises(ProblemError, match="`missing` is for .csv files only"):
        read_table("t.scs", missing="outside")


def test_the_command_makes_a_policy_that_other_commands_take(tmp_path):
    table = random_table((20, 12), symbols=2, seed=6)
    path, made = tmp_path / "t.scs", tmp_path / "t.cap"
    path.write_text(scots_text(table, [0.0, -1.0], [0.1, 0.2]))
    out, _ = capsyn(
        "import", path, "-o", made, "--states", "angle,rate", "--alphabet", "-5;5",
        "--default", "0", "--outside", "5", "--name", "mine",
    )  # fmt: skip
    assert "from a table of 240 points" in " ".join(out.split()) and "in gaps" in out
    policy = Policy.load(made)
    assert policy.name == "mine" and policy.domain.names == ("angle", "rate")
    assert policy.alphabet.values.ravel().tolist() == [-5, 5] and policy.outside == 1
    found = read_table(path)
    assert_same(policy, found)
    capsyn("export", made, "--to", "c", "-o", tmp_path / "c")
    assert (tmp_path / "c" / "mine.c").exists()
    assert json.loads(capsyn("info", made, "--json", "--quick")[0])["gaps"] is True


def test_the_command_names_what_is_wrong(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(GOOD)
    out = tmp_path / "t.cap"
    capsyn("import", path, "--periodic", "x", cwd=tmp_path)
    assert Policy.load(out).domain.periodic == (True, False) and Policy.load(out).name == "t"
    assert "--periodic must name states among x, v; got 'w'" in error_of(
        "import", path, "-o", out, "--periodic", "w"
    )
    assert "the output must be another file" in error_of("import", path, "-o", path)
    path.write_text(GOOD.replace("0.2", "0.2x", 1))
    assert "line 3: expected a finite number for 'v'; got '0.2x'" in error_of(
        "import", path, "-o", out
    )
