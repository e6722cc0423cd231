"""Tables in CSV files and NumPy archives, and the command that imports them."""

import io
import json
import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest

from capsyn import Alphabet, Policy
from capsyn.errors import ProblemError
from capsyn.sources.grid_files import read_csv, read_npz, read_table
from support.processes.command_line import capsyn, error_of
from support.tables import assert_same, csv_text, made_file, npz_bytes, random_table, scots_text

GOOD = "x,v [m/s],symbol\n0,0.1,-5\n0,0.2,5\n1,0.1,\n1,0.2,-5|5\n"


file = made_file("csv")
archive = made_file("npz")


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
    order = np.random.default_rng(0).permutation(table.masks.size)
    found = read_csv(file(csv_text(table, "abc", digits, order)), table.alphabet)
    np.testing.assert_array_equal(found.symbols, table.symbols)
    np.testing.assert_allclose(found.first, table.first, atol=0.01)


def test_names_and_indices_of_an_alphabet(file):
    names = Alphabet([-5, 0, 5], names=["left", "off", "right"])
    for text in ("0,left\n1,off | right\n2,right\n3,\n", "0,0\n1,1|2\n2,2\n3,\n"):
        assert read_csv(file("x,symbol\n" + text), names).masks.tolist() == [1, 6, 4, 0]
    with pytest.raises(ProblemError, match="line 3: expected symbols among left, off, right"):
        read_csv(file("x,symbol\n0,left\n1,lef\n"), names)
    with pytest.raises(
        ProblemError, match="4: expected a symbol's name, like 'left' in line 2, or"
    ):
        read_csv(file("x,symbol\n0,left\n1,off\n2,2\n"), names)


def test_names_that_are_numbers_are_names_where_all_are(file):
    names = Alphabet([2, 1, 0])
    assert names.names == ("2", "1", "0")
    assert read_csv(file("x,symbol\n0,2\n1,0|1\n"), names).masks.tolist() == [1, 6]
    partly = Alphabet([-5, 0, 5])  # its name 0 is index 1
    with pytest.raises(
        ProblemError, match="3: expected a symbol's name, like '0' in line 2, or .* '1'"
    ):
        read_csv(file("x,symbol\n0,0\n1,1\n2,2\n"), partly)
    assert read_csv(file("x,symbol\n0,1\n1,2\n"), partly).masks.tolist() == [2, 4]
    assert read_csv(file("x,symbol\n0,0\n1,5\n"), partly).masks.tolist() == [2, 4]


def test_missing_points_are_named_or_outside(file):
    text = "x,v,symbol\n0,0,1\n0,1,2\n1,0,1\n2,0,2\n2,1,1\n"
    with pytest.raises(ProblemError, match=r"grid of 3 x 2; 1 are missing, the first at \(1, 1\)"):
        read_csv(file(text), missing="error")
    for missing in ("auto", "outside"):
        assert read_csv(file(text), missing=missing).masks.tolist() == [[1, 2], [1, 0], [2, 1]]
    with pytest.raises(ProblemError, match="axis 'x' is not uniform: steps 1 .. 4; axes must be"):
        read_csv(file("x,symbol\n0,1\n1,1\n5,1\n6,1\n"))
    once = read_csv(file("x,symbol\n0,1\n1,1\n5,1\n6,1\n"), missing="outside")
    assert once.masks.tolist() == [1, 1, 0, 0, 0, 1, 1] and once.step == 1


@pytest.mark.parametrize("missing", ["error", "outside"])
def test_where_most_distances_are_not_the_grids_rows_must_tell_it(file, missing):
    text = "x,symbol\n0,1\n1,1\n2,1\n4,1\n6,1\n8,1\n"
    with pytest.raises(ProblemError, match=r"line \d: expected 'x' on the grid"):
        read_csv(file(text), missing=missing)
    assert read_csv(file(text + "3,\n5,\n7,\n")).masks.tolist() == [1, 1, 1, 0, 1, 0, 1, 0, 1]


def test_values_may_be_a_tenth_of_a_step_off_the_grid(file):
    text = "x,symbol\n0,1\n1,1\n{},1\n3,1\n4,1\n"
    assert read_csv(file(text.format(2.09))).counts == (5,)
    with pytest.raises(ProblemError, match="line 4: expected 'x' on the grid"):
        read_csv(file(text.format(2.11)))


def test_blank_lines_are_left_out(file):
    for text in (GOOD + "\n \n", GOOD.replace("\n0,0.2", "\n\n0,0.2")):
        assert read_csv(file(text)).masks.tolist() == [[1, 2], [0, 3]]


def test_a_long_symbol_takes_no_more_memory_for_every_row(file):
    rows = "".join(f"{k},1\n" for k in range(3000))
    text = f"x,symbol\n{rows}3000,{'1|' * 20_000}1\n"
    tracemalloc.start()
    assert read_csv(file(text)).masks.tolist() == [1] * 3001
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "line 1: expected the names of the states, then symbol; the file ends"),
        ("symbol\n0\n", "line 1: expected the names"),
        ("x,symbol\n", "line 2: expected a row of a state and its symbol; the file ends"),
        ("x,symbol\n0,1\n1\n", "line 3: expected 2 fields; got '1'"),
        ("x,symbol\n0,1\n1,2,3\n", "line 3: expected 2 fields; got '1,2,3'"),
        ("x,symbol\n0,1\nb,2\n", "line 3: expected a finite number for 'x'; got 'b'"),
        ("x,symbol\n0,1\nnan,2\n", "line 3: expected a finite number for 'x'; got 'nan'"),
        ("x,symbol\n0,1\n1,up\n", "3: expected controls that are finite numbers; got 'up'"),
        ("x,symbol\n0,1\n1,2\n0,\n",
         "line 4: expected a symbol, as for the same state in line 2; got none"),
        ("x,symbol\n0,1\n1,1\n2,1\n3.4,1\n4,1\n", "line 5: expected 'x' on the grid 0 + 1 k; got"),
        ("x,symbol\n0,1\n0,1\n", "must have two values of 'x' at least; got one"),
        ('x,symbol\n0,"1\n', "line 2: unexpected end of data"),
        (b"\xff\xfe\x00", "is no text in utf-16-le"),
        ("x,y,symbol\n" + "".join(f"{k},{k},1\n" for k in range(9000)), "at most 16,777,216"),
        ("x,x,symbol\n0,0,1\n0,1,1\n1,0,1\n1,1,1\n",
         "made.csv': `names` must be non-empty and distinct"),
        ("x,symbol\n0,\n1,\n", "must have a symbol in some row; all of its points are gaps"),
        ("x,symbol\n0,1\n1e308,1\n", "line 3: expected a number within +-1e+290 for 'x'"),
        ("x,symbol\n0,1\n1e290,1\n", "made.csv': `first` and `step` must make a grid within"),
        ("x,symbol\n0,1\n5e-324,1\n", "made.csv': `step` must be wider than floating point"),
        ("x,symbol\n1e9,1\n1000000000.0000001,1\n", "made.csv': `step` must be wider than"),
        ("x,symbol\n" + "".join(f"{k},{k}\n" for k in range(64)),
         "made.csv': `alphabet` of a table must have at most 63 symbols; got 64"),
        (",".join(f"x{k}" for k in range(17)) + ",symbol\n", "must have at most 16 axes; got 17"),
    ],
)  # fmt: skip
def test_damage_is_named(file, text, words):
    with pytest.raises(ProblemError) as error, warnings.catch_warnings():
        warnings.simplefilter("error")
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
    with pytest.raises(ProblemError, match="there is no 'alphabet'"):
        read_npz(tmp_path / "u.npz")
    np.savez(tmp_path / "v.npz", **arrays | {"symbols": np.array([{}])}, alphabet=[1])
    for damaged in ((tmp_path / "t.npz").read_bytes()[:-40], b"x", b""):
        (tmp_path / "w.npz").write_bytes(damaged)
        with pytest.raises(ProblemError, match="is no NumPy archive"):
            read_npz(tmp_path / "w.npz")
    with pytest.raises(
        ProblemError, match="v.npz' is .*: 'symbols' must be numbers; it has object"
    ):
        read_npz(tmp_path / "v.npz")


SMALL = {"first": [0.0, 0.0], "step": [1.0, 1.0], "symbols": [[0, 1], [1, -1]], "alphabet": [4, 5]}


@pytest.mark.parametrize(
    "change, words",
    [
        (
            {"symbols": [[0.5, 1], [1, 0]]},
            "`symbols` must be whole numbers or booleans; got float64",
        ),
        ({"symbols": [[0, 2], [1, 0]]}, r"`symbols` must be -1 to 1; got 2 at grid point \(0, 1\)"),
        ({"symbols": np.ones((2, 2, 3), bool)}, r"booleans of shape \(k1, .., kn, 2\)"),
        ({"symbols": 1}, "`symbols` must be those of a grid of points"),
        ({"first": [0.0]}, "`first` and `step` must have 2 entries, one per axis; got 1 and 2"),
        ({"step": [1.0, np.nan]}, "`step` must be finite"),
        ({"step": [1.0, 1e300]}, r"`first` and `step` must make a grid within \+-1e\+290"),
        ({"step": np.array([1, 1j])}, "is no NumPy archive of arrays: 'step' must be numbers"),
        ({"alphabet": ["a", "b"]}, "is no NumPy archive of arrays: 'alphabet' must be numbers"),
        ({"alphabet": [4, 4]}, "`alphabet` must have distinct symbols"),
        ({"first": np.zeros(1 << 17)}, "'first' must have at most 65,536 numbers"),
    ],
)
def test_archives_of_other_arrays_are_refused(archive, change, words):
    path = archive(npz_bytes(**SMALL))
    assert read_npz(path).masks.tolist() == [[1, 2], [2, 0]]
    with pytest.raises(ProblemError, match=words) as error:
        read_npz(archive(npz_bytes(**SMALL | change)))
    assert str(error.value).startswith(f"'{path}'")


def npy_head(shape, dtype="|i1", version=1):
    """Return the header of an array, in a version of the format."""
    text = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape!r}, }}\n".encode()
    return b"\x93NUMPY" + bytes([version, 0]) + len(text).to_bytes(2 * version, "little") + text


@pytest.mark.parametrize(
    "key, head, words",
    [
        ("symbols", npy_head((1 << 13, 1 << 13)), "at most 16,777,216 points; got 8,192 x 8,192"),
        ("symbols", npy_head((1 << 26,)), "at most 16,777,216 points"),
        ("symbols", npy_head((1,) * 17 + (1 << 26,)), "at most 16 axes"),
        (
            "symbols",
            npy_head((2, 2)),
            r"'symbols' has 67,.* bytes, which its shape \(2, 2\) does not",
        ),
        ("symbols", npy_head((-(1 << 13), -(1 << 13))), "bytes, which its shape"),
        ("first", npy_head((1 << 26,)), "'first' must have at most 65,536 numbers"),
        ("step", npy_head((1 << 23,), "<f8"), "'step' must have at most 65,536 numbers"),
        ("symbols", b"\x93NUMPY\2\0" + (1 << 26).to_bytes(4, "little"), "is no NumPy archive"),
        ("symbols", npy_head((1 << 26,), version=2), "at most 16,777,216 points"),
        ("symbols", b"\x93NUMPY\3\0", "an unknown version of the array format, "),
    ],
)
def test_archives_that_unpack_to_much_are_refused_unread(archive, key, head, words):
    refused_unread(archive, key, head, words)


@pytest.mark.parametrize("how", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_archives_that_numpy_does_not_write_are_refused_unread(archive, how):
    refused_unread(archive, "step", npy_head((2,)), "compressed in a way that NumPy does not", how)


def refused_unread(archive, key, head, words, how=zipfile.ZIP_DEFLATED):
    """Refuse an archive whose array `key` is a head and 64 MiB of zeros."""
    made = io.BytesIO()
    level = 1 if how == zipfile.ZIP_DEFLATED else None
    with zipfile.ZipFile(made, "w", how, compresslevel=level) as packed:
        for name, values in SMALL.items():
            with packed.open(f"{name}.npy", "w") as file:
                if name != key:
                    np.lib.format.write_array(file, np.array(values))
                    continue
                file.write(head)
                for _ in range(64):
                    file.write(bytes(1 << 20))
    path = archive(made.getvalue())
    tracemalloc.start()
    with pytest.raises(ProblemError, match=words):
        read_npz(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4e6 < 1 << 26


ENCODINGS = ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("shift", range(4))
def test_a_format_is_told_by_the_beginning_of_a_file(encoding, shift, tmp_path, monkeypatch):
    """Wherever the beginning ends, also within a character; what follows is not read."""
    path = tmp_path / "t.txt"
    text = "#SCOTS:v0.2\n" + "x" * shift + "\U0001f600\n\u0a0a" * 100_000 + "\nState: ("
    path.write_bytes(text.encode(encoding))
    tracemalloc.start()
    with pytest.raises(ProblemError, match="is for files of format csv only; '.*' is scots"):
        read_table(path, missing="outside")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = path.stat().st_size
    monkeypatch.setattr("capsyn.sources.text.MOST_BYTES", size - 1)
    with pytest.raises(ProblemError, match="must have at most"):
        read_table(path, missing="outside")
    assert peak < size


def test_arguments_for_other_formats_are_refused(tmp_path):
    with pytest.raises(ProblemError, match="cannot read 't.txt'"):
        read_table("t.txt")
    path = tmp_path / "t.scs"
    path.write_text("#SCOTS:v0.2\n")
    for more, words in (
        ({"missing": "outside"}, r"`missing` \(--missing\) is for files of format csv only"),
        ({"inputs": ["u"]}, r"`inputs` \(--inputs\) is for files of format csv only; .* is scots"),
        ({"states": "s.sta"}, r"`states` \(--exported-states\) is for files of format prism only"),
        ({"domain": {"x": (0, 1)}}, r"`domain` \(--domain\) is for files of format stratego only"),
        ({"format": "xls"}, "`format` must be one of 'csv', .*; got 'xls'"),
    ):
        with pytest.raises(ProblemError, match=words):
            read_table(path, **more)
    with pytest.raises(TypeError, match="domian"):
        read_table(path, domian={"x": (0, 1)})
    for name in ("t.csv", "t.scs", "t.npz"):
        with pytest.raises(ProblemError, match="`alphabet` must be a capsyn.Alphabet; got 3"):
            read_table(name, 3)
        with pytest.raises(ProblemError, match="cannot read .*null"):
            read_table("\0" + name)
    with pytest.raises(ProblemError, match="`path` must be the path of a file; got 3"):
        read_table(3)


def test_the_command_makes_a_policy_that_other_commands_take(tmp_path):
    table = random_table((20, 12), symbols=2, seed=6)
    path, made = tmp_path / "t.scs", tmp_path / "t.cap"
    path.write_text(scots_text(table, [0.0, -1.0], [0.1, 0.2]))
    out, _ = capsyn(
        "import", path, "-o", made, "--states", "angle, rate", "--alphabet", "-5;5",
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


def test_the_command_takes_names_of_symbols(tmp_path):
    path, made = tmp_path / "t.csv", tmp_path / "t.cap"
    path.write_text("x,symbol\n0,fill\n1,off\n2,drain|off\n")
    capsyn("import", path, "-o", made, "--alphabet", "fill=1,0; drain=0,1;off=0,0")
    policy = Policy.load(made)
    assert policy.alphabet == Alphabet([[1, 0], [0, 1], [0, 0]], ["fill", "drain", "off"])
    assert policy(np.array([[0.0], [1.0], [2.0]])).tolist() == [0, 2, 1]
    for text, reason in (
        ("fill=1,0;0,1", "--alphabet must have names for all symbols or none; got 'fill=1,0;0,1'"),
        ("fill=1,0;drain=0,x", "`--alphabet` must be a number; got 'x'"),
        ("fill=1,0;fill=0,1", "`alphabet names` must be non-empty and distinct"),
    ):
        assert reason in error_of("import", path, "-o", made, "--alphabet", text)
    path.write_text("x,symbol\n0,1\n2,0\n3,0\n")
    assert "or --missing outside, takes" in error_of("import", path, "-o", made)


def test_the_command_names_what_is_wrong(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(GOOD)
    out = tmp_path / "t.cap"
    capsyn("import", path, "--periodic", "x", cwd=tmp_path)
    assert Policy.load(out).domain.periodic == (True, False) and Policy.load(out).name == "t"
    capsyn("import", path, "--states", "a, b ", "--periodic", " b, a", cwd=tmp_path)
    assert Policy.load(out).domain.names == ("a", "b")
    assert Policy.load(out).domain.periodic == (True, True)
    assert "--periodic must name states among x, v; got 'w'" in error_of(
        "import", path, "-o", out, "--periodic", "x,w,q,r,s,t"
    )  # the first that is none
    for option in ("--alphabet", "--default"):
        wanted = f"`{option}` must be a number; got 'p'"
        assert wanted in error_of("import", path, "-o", out, option, "1,p")
    assert "the output must be another file" in error_of("import", path, "-o", path)
    assert "--states must name 2 states; got 'a'" in error_of(
        "import", path, "-o", out, "--states", "a"
    )
    path.write_text(GOOD.replace("0.2", "0.2x", 1))
    assert "line 3: expected a finite number for 'v'; got '0.2x'" in error_of(
        "import", path, "-o", out
    )
