"""Exports: golden vectors, names, costs, files, and the command line."""

import csv
import dataclasses
import hashlib
import json
import math

import numpy as np
import pytest

from capsyn.errors import ProblemError
from capsyn.exports import export as core
from capsyn.exports.export import TARGETS, all_targets, export
from capsyn.exports.golden import golden_vectors
from capsyn.exports.identifiers import file_name, identifiers, renamed
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, Plan
from capsyn.exports.policy_json import target as policy_json
from support.exports.policies import module, oblique, small
from support.processes.command_line import capsyn, error_of
from support.trees import GRIDS, random_policy

# ---- golden vectors ----


@pytest.mark.parametrize("outside", ["error", "nearest", 1, -1])
@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_golden_vectors_are_what_the_policy_says(grid, outside):
    policy = dataclasses.replace(random_policy(grid, grid % 2 == 0), outside=outside)
    golden = golden_vectors(Plan.of(policy))
    symbols = np.where(golden.labels == len(policy.alphabet), -1, golden.labels)
    known = golden.statuses == OK
    if outside == "nearest":
        known |= golden.statuses == OUTSIDE
    elif outside != "error":
        known[:] = True
    np.testing.assert_array_equal(symbols[known], policy(golden.states[known]))
    assert (symbols[~known] == -1).all()


@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_golden_vectors_are_everywhere(grid):
    policy = random_policy(grid, periodic=True)
    plan, domain = Plan.of(policy), policy.domain
    golden, counts = golden_vectors(plan), policy.cells.counts
    assert len(golden) >= 2000 and golden.readings is golden.states
    expected = {OK, NOT_FINITE} | (set() if all(domain.periodic) else {OUTSIDE})
    assert set(golden.statuses.tolist()) == expected
    faces = [domain.faces(i, np.arange(c + 1), c) for i, c in enumerate(counts)]
    on = np.stack([np.isin(x, face) for x, face in zip(golden.states.T, faces)], axis=1)
    assert (on.sum(axis=1) == 1).sum() > 50 or domain.n == 1
    assert on.all(axis=1).sum() > 50  # corners
    for i in range(domain.n):
        for bound in (domain.lower[i], domain.upper[i]):
            values = golden.states[:, i]
            for value in (np.nextafter(bound, -np.inf), bound, np.nextafter(bound, np.inf)):
                assert (values == value).any()
        for special in (np.isnan, np.isposinf, np.isneginf):
            assert special(golden.states[:, i]).any()
    again = golden_vectors(Plan.of(random_policy(grid, periodic=True)))
    np.testing.assert_array_equal(golden.states, again.states)


@pytest.mark.parametrize("scale, offset", [(-0.0375, 100.0), (2e-5, 1e3), (1e6, -0.1), (1.0, 0.5)])
def test_readings_pass_faces_where_states_do(scale, offset):
    plan = Plan.of(small(), scale=scale, offset=offset)
    golden = golden_vectors(plan)
    np.testing.assert_array_equal(golden.states, golden.readings * scale + offset)
    again = golden_vectors(Plan.of(small()))
    assert len(golden) == len(again) and (np.rint(golden.readings) == golden.readings).sum() > 500
    # readings next to each other on both sides of a face
    column, count = golden.readings[:, 0], small().cells.counts[0]
    steps = plan.policy.domain.locate(golden.states[golden.statuses < 2], (count,) * plan.n)[:, 0]
    column = column[golden.statuses < 2]
    order = np.argsort(column, kind="stable")
    column, steps = column[order], steps[order]
    adjacent = np.nextafter(column[:-1], np.inf) == column[1:]
    assert (adjacent & (steps[:-1] != steps[1:])).sum() >= 0.8 * count


def test_golden_vectors_as_csv():
    policy = random_policy(4)
    domain = dataclasses.replace(policy.domain, names=["a, b", 'say "x"'])
    plan = Plan.of(dataclasses.replace(policy, domain=domain))
    golden = golden_vectors(plan)
    text = golden.to_csv(plan).decode().splitlines()
    assert [line[2:] for line in text if line[0] == "#"] == list(plan.header)
    rows = list(csv.reader(text[len(plan.header) :]))
    assert rows[0] == ["a, b", 'say "x"', "step_0", "step_1", "symbol", "status"]
    data = np.array(rows[1:], dtype=float)
    np.testing.assert_array_equal(data[:, :2], golden.readings)
    np.testing.assert_array_equal(data[:, 2:4], golden.steps)
    np.testing.assert_array_equal(data[:, 4:], np.stack([golden.labels, golden.statuses], axis=1))


# ---- plans, names ----


def test_safe_symbols_and_dwell_are_the_policys_unless_given():
    policy = dataclasses.replace(small(), outside=1, min_dwell=0.25)
    assert Plan.of(policy).safe == 1 and Plan.of(policy).dwell == 0.25
    plan = Plan.of(policy, safe="-1", dwell=0)  # the name of the first symbol
    assert plan.safe == 0 and plan.dwell == 0
    assert Plan.of(policy, safe=2).safe == 2  # the default by its number in exports
    assert Plan.of(policy, safe=-1).safe == Plan.of(policy, safe="default").safe == 2
    assert Plan.of(small()).safe == 2 and not Plan.of(small()).nearest


@pytest.mark.parametrize(
    "options, words",
    [
        ({"safe": "nearest"}, "`safe` must be a symbol"),
        ({"safe": 7}, "`safe` must be a symbol"),
        ({"dwell": -1}, "`dwell` must be a finite number >= 0"),
        ({"scale": 0}, "`scale` must not be 0"),
        ({"scale": [1, 2, 3]}, "`scale` must be one number or 2"),
        ({"scale": "1"}, "`scale` must be numbers"),
        ({"offset": 1e30}, "must keep the 24 lattice steps of axis 'x1' apart .*; got 1 and 1e.30"),
        ({"scale": 5e-324}, "must keep the"),
        ({"scale": 1e308, "offset": 1e308}, "must keep the"),
        ({"name": ""}, "`name` must be a printable text"),
        ({"offset": math.nan}, "`offset` must be finite"),
        ({"style": "x"}, "`style` is no option of target python, which has name"),
        ({"name": "a\nb"}, "`name` must be a printable text"),
    ],
)
def test_wrong_options_are_told(options, words, tmp_path):
    with pytest.raises(ProblemError, match=words):
        export(small(), "python", tmp_path / "new", **options)
    assert not list(tmp_path.iterdir())


def test_unknown_targets_list_the_known(tmp_path):
    for wrong in ("fortran", None, ["python", "fortran"], [], {"c"}):
        with pytest.raises(ProblemError, match="c, structured-text, .*json, or several; got"):
            export(small(), wrong, tmp_path)
    with pytest.raises(ProblemError, match="`policy` must be a capsyn.Policy"):
        export("p.cap", "python", tmp_path)


def test_identifiers():
    names = ["-5", "5", "(-5.0, 2)", "valve open", "valve-open", "größe", "θ", "", "if", "IF"]
    found = identifiers(names, {"if"})
    assert found[:5] == ("minus_5", "n5", "minus_5_0_2", "valve_open", "valve_open_2")
    assert found[5:] == ("groe", "n", "n_2", "if_2", "IF")
    assert identifiers(["jet+", "jet-", "a - b", "+5"]) == (
        "jet_plus",
        "jet_minus",
        "a_b",
        "plus_5",
    )
    assert identifiers(["a", "A", "a"], fold=True) == ("a", "A_2", "a_3")
    assert all(name.isidentifier() and name.isascii() for name in found)
    assert len(set(found)) == len(found) and found == identifiers(names, {"if"})
    assert renamed(["a", "b c"], ["a", "b_c"]) == {"b c": "b_c"}
    assert file_name(None, "cart-pole") == "cart_pole" and file_name("x y", "cart") == "x_y"


# ---- files ----


@pytest.mark.parametrize("to", ["python", "javascript", "json", "dot"])
def test_the_same_policy_gives_the_same_bytes_and_no_trace_of_the_place(to, tmp_path):
    first = export(small(), to, tmp_path / "a")
    second = export(random_policy(3, periodic=True), to, tmp_path / "b" / "c")
    assert [p.name for p in first] == [p.name for p in second]
    for one, other in zip(first, second):
        assert one.read_bytes() == other.read_bytes()
        assert str(tmp_path) not in one.read_text()
    header = Plan.of(small()).header
    assert all(json.dumps(line)[1:-1] in first[0].read_text() for line in header)
    assert {p.name for p in (tmp_path / "a").iterdir()} == {p.name for p in first}


@pytest.mark.parametrize("policy", [small, oblique])
def test_certificates_are_exact(policy, tmp_path):
    policy = policy()
    files = export(policy, "python", tmp_path)
    data = json.loads((tmp_path / "certificate.json").read_text())
    tree = Plan.of(policy).tree
    assert data["nodes"] == tree.node_count and data["planes"] == len(tree.cells.planes)
    assert data["comparisons"]["most"] == tree.depth and data["lattice"] == list(tree.cells.counts)
    assert (data["comparisons"]["mean"] is None) == bool(data["planes"])
    found = {p.name: p.read_bytes() for p in files if p.name != "certificate.json"}
    assert set(found) == set(data["files"])
    for name, content in found.items():
        digest = hashlib.sha256(content).hexdigest()
        assert data["files"][name] == {"bytes": len(content), "sha256": digest}
    assert data["options"] == {"name": None} and data["changed_by_rounding"] is None
    assert data["target"] == "python" and data["guarantee"] == tree.guarantee.text


def test_failures_leave_what_was_there(tmp_path, monkeypatch):
    export(small(), "python", tmp_path)
    (tmp_path / "mine.txt").write_text("mine")
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}

    def unchanged():
        return before == {p: p.read_bytes() for p in tmp_path.iterdir()}

    real, calls = core.os.replace, []

    def failing(source, target):
        calls.append(target)
        if len(calls) == 4:
            raise OSError("disk full")
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(core.os, "replace", failing)
        with pytest.raises(ProblemError, match="cannot write to .*: disk full"):
            export(small(), "python", tmp_path, safe=1)
    assert len(calls) > 4 and unchanged()
    with monkeypatch.context() as patch:
        patch.setattr(policy_json, "document", lambda plan: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            export(small(), "json", tmp_path)
    assert unchanged()
    with pytest.raises(ProblemError, match="oblique splits"):
        export(oblique(), "dot", tmp_path)
    assert unchanged()
    export(small(), "python", tmp_path, safe=1)
    assert not unchanged()
    (tmp_path / "random.json").mkdir()
    with pytest.raises(ProblemError, match="it is a directory"):
        export(small(), "json", tmp_path)
    assert not (tmp_path / policy_json.SCHEMA).exists()
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(ProblemError, match="cannot write to '.*taken/new'"):
        export(small(), ["python", "json"], tmp_path / "taken" / "new")


def test_folders_of_failed_exports_do_not_stay(tmp_path):
    (tmp_path / "old" / "json" / "random.json").mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ProblemError, match="it is a directory"):
        export(small(), ["python", "json"], tmp_path / "old")
    assert sorted(tmp_path.rglob("*")) == before
    export(small(), ["python", "json"], tmp_path / "new" / "deep")
    assert {p.name for p in (tmp_path / "new" / "deep").iterdir()} == {"python", "json"}


def test_files_of_every_export_keep_their_names(tmp_path):
    for name in ("certificate", "measured"):
        with pytest.raises(ProblemError, match=f"the export has a {name}.json of its own"):
            export(small(), "json", tmp_path, name=name)
    assert not list(tmp_path.iterdir())
    (path, *_) = export(dataclasses.replace(small(), name="x" * 300), "python", tmp_path)
    assert path.name == "x" * 64 + ".py"


def test_all_targets_but_those_that_cannot_be(tmp_path):
    assert all_targets(small()) == tuple(TARGETS)
    assert set(TARGETS) - set(all_targets(oblique())) == {"dot"}


# ---- command line ----


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "p.cap"
    dataclasses.replace(small(), outside="nearest").save(path)
    return path


def test_command_writes_files_and_tells_costs(file, tmp_path):
    out, _ = capsyn("export", file, "--to", "python", "-o", tmp_path / "a", "--name", "mine")
    assert f"wrote {tmp_path / 'a' / 'mine.py'}" in out and "comparisons at most" in out
    out, _ = capsyn(
        "export", file, "--to", "json", "-o", tmp_path / "b", "--safe", "1", "--dwell", "0.5",
        "--scale", "-1,2", "--offset", "0.25", "--json",
    )  # fmt: skip
    found = json.loads(out)
    assert found["certificate"] == json.loads((tmp_path / "b" / "certificate.json").read_text())
    data = json.loads((tmp_path / "b" / "random.json").read_text())
    assert found["files"][0] == str(tmp_path / "b" / "random.json")
    assert data["min_dwell"] == 0.5 and data["outside"] == {"rule": "nearest", "safe": 1}
    assert [(s["scale"], s["offset"]) for s in data["states"]] == [(-1.0, 0.25), (2.0, 0.25)]


def test_command_takes_several_targets_and_reads_certificates_only(file, tmp_path):
    out, _ = capsyn("export", file, "--to", "python, json", "-o", tmp_path, "--json")
    found = json.loads(out)
    certificates = found["certificate"]
    assert {name: data["target"] for name, data in certificates.items()} == {
        name: name for name in ("python", "json")
    }
    assert "measured" not in found


def test_command_takes_trees(file, tmp_path):
    capsyn("compress", file, "-o", tmp_path / "t.cap")
    capsyn("export", tmp_path / "t.cap", "--to", "python", "-o", tmp_path)
    capsyn("export", file, "--to", "python", "-o", tmp_path / "cells")
    tree, cells = (module(p / "random_2.py") for p in (tmp_path, tmp_path / "cells"))
    assert tree.SPLIT == cells.SPLIT and tree.THRESHOLD == cells.THRESHOLD


def test_command_help_lists_targets():
    out = " ".join(capsyn("export", "--help")[0].split())
    assert ", ".join(TARGETS) in out


@pytest.mark.parametrize(
    "options, words",
    [
        (["--to", "fortran"], "`to` must be one of c, structured-text"),
        (["--to", "dot", "--style", "table"], "`style` is no option of target dot"),
        (["--to", "json", "--option", "to=c"], "`to` is no option of target json"),
        (["--to", "json", "--option", "to"], "--option must be NAME=VALUE"),
        (["--to", "json", "--scale", "1,x"], "`--scale` must be a number"),
        (["--to", "json", "--offset", "1,2,3"], "`offset` must be one number or 2"),
        (["--to", "json", "--safe", "up"], "`safe` must be a symbol"),
    ],
)
def test_command_errors_are_one_line_and_leave_nothing(file, options, words, tmp_path):
    assert words in error_of("export", file, *options, "-o", tmp_path / "new")
    assert not list(tmp_path.iterdir())


def test_command_refuses_a_file_as_directory(file, tmp_path):
    (tmp_path / "taken").write_text("mine")
    error_of("export", file, "--to", "json", "-o", tmp_path / "taken")
    assert (tmp_path / "taken").read_text() == "mine"
