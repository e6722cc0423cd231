"""Tables as policies: equal at every point, gaps that stay outside, freedom, exports."""

import dataclasses
import json
import math
import tracemalloc
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import capsyn
from capsyn import Alphabet, Policy, compress, problems
from capsyn.compression.proof import prove
from capsyn.errors import OutsideDomainError, PolicyFormatError, ProblemError
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, Plan
from capsyn.modelling.transcription import transcribe
from capsyn.sources.table import Table
from capsyn.verification.agreement import agreement
from support.exports.c_machines import Library
from support.exports.c_plans import files
from support.exports.policies import RUNNERS, assert_equal
from support.exports.verilog import check as check_verilog
from support.policy_files import refuse, rewrite
from support.tables import assert_same, random_table

COUNTS = [(7,), (37, 23), (16, 8), (11, 6, 5), (5, 4, 3, 3)]


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("outside", ["error", "nearest", 1])
@pytest.mark.parametrize("counts", COUNTS)
def test_policies_and_exact_trees_equal_their_tables(counts, outside, gaps):
    table = random_table(counts, gaps=gaps)
    policy = table.policy(outside=outside)
    assert policy.gaps == gaps
    assert_same(policy, table)
    tree = compress(policy)
    assert_same(tree, table)
    assert tree.gaps == gaps and prove(tree, policy) == 0
    if not gaps or outside == "nearest":  # nothing is added to the grid
        assert policy.cells.counts == counts


@given(
    counts=st.lists(st.integers(1, 40), min_size=1, max_size=3).filter(lambda k: math.prod(k) > 1),
    gaps=st.booleans(),
    seed=st.integers(0, 10**6),
)
def test_any_grid_becomes_well_formed_cells(counts, gaps, seed):
    table = random_table(tuple(counts), gaps=gaps, seed=seed, periodic=[True] * len(counts))
    policy = table.policy()
    cells = policy.cells
    assert cells.counts == tuple(counts)  # a whole turn is not padded
    assert_same(policy, table)
    free = dataclasses.replace(table, periodic=None)
    assert_same(free.policy(), free)
    cells.check(len(table.alphabet) + 1)


def test_cells_are_merged_where_points_are_equal():
    masks = np.ones((64, 96), dtype=np.uint64)
    masks[40:, 50:] = 2
    policy = Table([0, 0], [1, 1], masks, Alphabet([0, 1])).policy()
    assert policy.cells.leaf_count < 100 < masks.size
    masks[5, 5] = 0  # a gap lets odd counts be padded
    policy = Table([0, 0], [1, 1], masks[:63, :95].copy(), Alphabet([0, 1])).policy()
    assert policy.cells.leaf_count < 63 * 95 / 10 and policy.gaps
    assert policy.covers([[4, 5], [5, 5], [5.4, 5.4], [5.6, 5]]).tolist() == [1, 0, 0, 1]


def test_a_gap_is_outside_in_every_way():
    table = random_table((37, 23), seed=3)
    policy = table.policy()
    points, symbols = table.points(), table.symbols.ravel()
    hole, held = points[symbols < 0][0], points[symbols >= 0][0]
    for rule in ("error", "nearest"):
        with pytest.raises(OutsideDomainError, match="is in a gap"):
            policy(hole, outside=rule)
        with pytest.raises(OutsideDomainError, match="state 1 must be where"):
            policy([held, hole], outside=rule)
    assert policy(hole, outside=2) == 2 and policy(hole, outside=-1) == -1
    assert policy.control(hole, outside=1) == 1.0
    assert not policy.covers([math.nan, 0.0]) and not policy.covers(held + 1e6)
    with pytest.raises(ProblemError, match="`states` must have shape"):
        policy.covers(1.0)
    many = np.repeat(points, 1 + 60_000 // len(points), axis=0)  # by the compiled lookup
    assert np.array_equal(policy(many, outside=-1), np.repeat(symbols, len(many) // len(points)))


@pytest.mark.parametrize("as_tree", [False, True])
def test_gaps_survive_the_file_and_older_readers_refuse_it(tmp_path, as_tree, monkeypatch):
    table = random_table((37, 23))
    policy = compress(table.policy()) if as_tree else table.policy()
    policy.save(tmp_path / "t.cap")
    again = Policy.load(tmp_path / "t.cap")
    assert again.gaps and again.statistics["table"]["points"] == 37 * 23
    assert_same(again, table)
    again.save(tmp_path / "u.cap")
    assert (tmp_path / "t.cap").read_bytes() == (tmp_path / "u.cap").read_bytes()
    monkeypatch.setattr("capsyn.policies.file.VERSION", 2)
    with pytest.raises(PolicyFormatError, match="has format version 4"):
        Policy.load(tmp_path / "t.cap")


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda d, a: d["policy"].update(gaps=False), "keys are not those of this format version"),
        (lambda d, a: d["policy"].update(gaps=1), "keys are not those of this format version"),
        (lambda d, a: d.update(version=2), "keys are not those of this format version"),
        (lambda d, a: d["policy"]["statistics"].update(table=[1]), "statistic 'table'"),
        (lambda d, a: d["policy"]["statistics"].update(table={"points": 1}), "statistic 'table'"),
        (lambda d, a: d["policy"]["statistics"]["table"].update(points="9"), "statistic 'table'"),
    ],
)
def test_tampered_gaps_are_refused(change, words, tmp_path):
    random_table((9, 8)).policy().save(tmp_path / "t.cap")
    rewrite(tmp_path / "t.cap", change)
    refuse(tmp_path / "t.cap", words)


def test_gaps_are_true_or_false():
    with pytest.raises(ProblemError, match="`gaps` must be True or False; got 1"):
        dataclasses.replace(random_table((5, 5)).policy(), gaps=1)


@pytest.mark.parametrize("outside", ["error", "nearest", 1])
def test_closed_loops_end_in_a_gap_or_take_the_safe_symbol(outside):
    problem = problems.plain("cart-pendulum")
    box, counts = problem.domain, (40, 40)
    step = box.widths / counts
    masks = np.ones(counts, dtype=np.uint64)
    masks[20:, 20:] = 0
    table = Table(box.lower + step / 2, step, masks, problem.alphabet, periodic=[True, False])
    policy = table.policy(outside=outside)
    assert policy.domain.n == 2 and policy.gaps
    x0 = box.sample(50, 1)
    runs = [
        capsyn.simulate(policy, x0, 2.0, 100.0, model=problem, backend=backend)
        for backend in ("c", "numpy")
    ]
    for name in ("symbols", "ended", "last", "outside"):
        assert np.array_equal(getattr(runs[0], name), getattr(runs[1], name)), name
    np.testing.assert_allclose(runs[0].states, runs[1].states, rtol=1e-9, atol=1e-9)
    with pytest.raises(ProblemError, match="`policy` must have no gaps; 'table' has some"):
        capsyn.lyapunov(dataclasses.replace(policy, model=transcribe(problem)), lambda x: x[0])
    run = runs[0]
    if outside == 1:
        assert set(run.ended) == {"time"} and run.outside.sum() > 0
        seen = run.states[:, :-1].reshape(-1, 2)
        symbols = run.symbols.ravel()
        assert np.array_equal(symbols == 1, ~policy.covers(seen))
    else:
        assert "left the domain" in run.ended and (run.symbols <= 0).all()


def test_freedom_takes_any_symbol_that_the_table_allows_and_keeps_gaps():
    table = random_table((60, 50), symbols=4, seed=5)
    policy = table.policy()
    assert policy.statistics["table"]["several"] == len(policy.cells.mixed_cells) > 300
    exact, free = compress(policy), compress(policy, "freedom", states=2000)
    assert free.node_count < 0.9 * exact.node_count
    points = table.points()
    inside = table.masks.ravel() != 0
    np.testing.assert_array_equal(free.covers(points), inside)
    found = free(points[inside]).astype(np.uint64)
    assert ((table.masks.ravel()[inside] >> found) & np.uint64(1)).all()
    assert prove(free, policy) > 0 and free.guarantee.controller == "policy"
    assert agreement(exact, 5000, controller=policy).share == 1
    for options in ({"mode": "linear"}, {"level": 0}, {"mode": "freedom", "level": 1}):
        with pytest.raises(ProblemError, match="for a policy with gaps"):
            compress(policy, **options)


@pytest.mark.parametrize("outside", ["error", "nearest", 2])
@pytest.mark.parametrize("to", RUNNERS)
def test_exports_give_the_safe_symbol_and_the_status_in_gaps(to, outside, tmp_path):
    policy = random_table((13, 9), seed=2).policy(outside=outside)
    assert_equal(to, policy, tmp_path)
    assert_equal(to, policy, tmp_path, safe=0)


@pytest.mark.parametrize("safe", [None, 1])
def test_golden_vectors_tell_gaps(safe):
    table = random_table((13, 9), seed=2)
    policy = table.policy()
    golden = golden_vectors(Plan.of(policy, safe=safe))
    inside = golden.statuses == OK
    assert set(golden.statuses.tolist()) == {OK, OUTSIDE, NOT_FINITE}
    np.testing.assert_array_equal(inside, policy.covers(golden.states))
    np.testing.assert_array_equal(golden.labels[inside], policy(golden.states[inside]))
    assert set(golden.labels[~inside]) == {3 if safe is None else safe}
    holes = policy.domain.contains(golden.states) & ~inside
    assert holes.sum() > 50 and (golden.statuses[holes] == OUTSIDE).all()


@pytest.mark.parametrize(
    "style, arithmetic", [("table", "lattice"), ("nested", "float"), ("grid", "double")]
)
def test_c_gives_the_status_in_gaps(style, arithmetic, tmp_path):
    plan = Plan.of(random_table((13, 9), seed=2).policy(outside=1))
    golden = golden_vectors(plan)
    made = files(plan, golden, style=style, arithmetic=arithmetic)
    library = Library(made, tmp_path, plan.n)
    with np.errstate(over="ignore"):
        states = golden.states.astype(library.real).astype(float)
    golden = decide(plan, states)
    symbols, statuses = library.decide(states)
    np.testing.assert_array_equal(symbols, golden.labels)
    np.testing.assert_array_equal(statuses, golden.statuses)


def test_structured_text_tells_gaps():
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="tree-sitter is not installed")
    from support.exports.structured_text import check

    for style in ("nested", "table"):
        check(Plan.of(random_table((13, 9), seed=2).policy(outside=1)), style=style)


@pytest.mark.parametrize("inputs", ["lattice", "fixed"])
@pytest.mark.parametrize("pipeline", [False, True])
@pytest.mark.parametrize("dwell", [0.0, 0.01])
def test_verilog_tells_gaps(inputs, pipeline, dwell, tmp_path):
    for outside in ("error", "nearest"):
        plan = Plan.of(
            random_table((13, 9), seed=2).policy(min_dwell=dwell, outside=outside), safe=1
        )
        text = check_verilog(tmp_path, plan, inputs=inputs, pipeline=pipeline)
        assert "output wire outside" in text


def test_fmus_tell_gaps(tmp_path):
    fmpy = pytest.importorskip("fmpy")
    from fmpy.fmi2 import FMU2Slave

    policy = random_table((13, 9), seed=2).policy(outside=1)
    golden = golden_vectors(Plan.of(policy))
    path = capsyn.export(policy, "fmu", tmp_path)[0]
    about = fmpy.read_model_description(path)
    unit = FMU2Slave(
        guid=about.guid, unzipDirectory=fmpy.extract(path, tmp_path / "unit"),
        modelIdentifier=about.coSimulation.modelIdentifier, instanceName="unit",
    )  # fmt: skip
    unit.instantiate()
    unit.setupExperiment(startTime=0.0)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    known = {v.name: v.valueReference for v in about.modelVariables}
    wanted = [known["symbol"], known["status"]]
    for k in range(0, len(golden), 7):
        unit.setReal([0, 1], golden.readings[k].tolist())
        assert unit.getInteger(wanted) == [golden.labels[k], golden.statuses[k]]
    unit.terminate()
    unit.freeInstance()


def test_json_with_gaps_fits_its_schema(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    made = capsyn.export(random_table((13, 9)).policy(), "json", tmp_path)
    data, schema = (json.loads(path.read_text()) for path in made[:2])
    assert data["outside"]["gap"] == 3
    jsonschema.validate(data, schema)


def test_tables_of_symbols_and_of_booleans():
    symbols = np.array([[0, -1, 1], [1, 1, 0]])
    one = Table.of([0, 0], [1, 1], symbols, [-5, 5])
    np.testing.assert_array_equal(one.symbols, symbols)
    allowed = np.stack([symbols == 0, symbols >= 0], axis=-1)
    two = Table.of([0, 0], [1, 1], allowed, [-5, 5], names=["a", "b"])
    assert two.masks.tolist() == [[3, 0, 2], [2, 2, 3]] and two.policy().domain.names == ("a", "b")
    assert one.policy("mine", default=3, min_dwell=0.1).control([0, 1], outside=-1) == [3]


@pytest.mark.parametrize(
    "change, words",
    [
        ({"first": [0]}, "`first` and `step` must have 2 entries, one per axis; got 1 and 2"),
        ({"step": [1, 0]}, "`step` must be above 0"),
        ({"masks": np.zeros((2, 2))}, "`masks` must be a grid of uint64; got float64"),
        ({"masks": np.full((2, 2), 8, np.uint64)}, "must hold symbols 0 to 1; got 0b1000 at state"),
        ({"alphabet": 3}, "`alphabet` must be a capsyn.Alphabet"),
        ({"names": ["a"]}, "`names` must be 2 printable"),
        ({"masks": [[1, 2], [1]]}, "`masks` must be a grid, with rows of equal lengths"),
        (
            {"step": [1, 1e308]},
            r"`first` and `step` must make a grid within \+-1e\+290; got \[0.0, ",
        ),
        ({"first": [0, 1e17]}, "`step` must be wider than floating point is fine near the points"),
    ],
)
def test_bad_tables_are_refused(change, words):
    good = {
        "first": [0, 0], "step": [1, 1], "masks": np.ones((2, 2), np.uint64),
        "alphabet": Alphabet([0, 1]),
    }  # fmt: skip
    Table(**good)
    with pytest.raises(ProblemError, match=words), warnings.catch_warnings():
        warnings.simplefilter("error")
        Table(**good | change)


@pytest.mark.parametrize(
    "symbols, words",
    [
        (np.array([[0, 2]]), r"`symbols` must be -1 to 1; got 2 at grid point \(0, 1\)"),
        (np.zeros((2, 2)), "`symbols` must be whole numbers or booleans"),
        (np.ones((2, 2, 3), bool), r"booleans of shape \(k1, .., kn, 2\); got \(2, 2, 3\)"),
        (np.ones(2, bool), r"`symbols` must be those of a grid of points; got shape \(2,\)"),
        (
            [[0, 1], [1]],
            r"`symbols` must be a grid, with rows of equal lengths; got \[\[0, 1\], \[1",
        ),
        ([[0, 1], [1, 2**70]], "`symbols` must be whole numbers or booleans; got object"),
        (3, r"`symbols` must be those of a grid of points; got shape \(\)"),
        (np.zeros((2, 0), int), "`symbols` must be those of a grid of points"),
        (np.zeros(2, int), "`first` and `step` must have 1 entries, one per axis; got 2 and 2"),
    ],
)
def test_bad_symbols_are_refused(symbols, words):
    with pytest.raises(ProblemError, match=words):
        Table.of([0, 0], [1, 1], symbols, [0, 1])


def test_grids_that_are_too_large_are_refused_unread():
    words = "at most 16,777,216 points; got 8,192 x 8,192"
    ones = np.broadcast_to(np.ones(1, np.uint64), (1 << 13, 1 << 13))
    allowed = np.broadcast_to(np.ones(1, bool), (1 << 13, 1 << 13, 1))
    tracemalloc.start()
    with pytest.raises(ProblemError, match=words):
        Table([0, 0], [1, 1], ones, Alphabet([0]))
    for symbols in (ones.view(np.int64), allowed):
        with pytest.raises(ProblemError, match=words):
            Table.of([0, 0], [1, 1], symbols, [0])
    many = [0.0] * 17
    with pytest.raises(ProblemError, match="a table must have at most 16 axes; got 17"):
        Table.of(many, np.ones(17), np.zeros((1,) * 17, int), [0])
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()


def test_the_most_axes_make_a_policy_with_levels():
    counts = (1,) * 14 + (4, 4)
    symbols = np.zeros(counts, int)
    symbols[..., 2:, :] = 1
    table = Table.of(np.zeros(16), np.ones(16), symbols, [0, 1])
    assert_same(table.policy(), table)


def test_a_table_does_not_change_with_the_array_that_it_was_made_of():
    masks = np.ones((2, 2), np.uint64)
    table = Table([0, 0], [1, 1], masks, Alphabet([0, 1]))
    masks[:] = 2
    assert (table.symbols == 0).all()
    with pytest.raises(ValueError, match="read-only"):
        table.masks[0, 0] = 2


@pytest.mark.parametrize("as_tree", [False, True])
def test_notebooks_show_gaps_as_outside(as_tree):
    policy = random_table((37, 23)).policy()
    text = (compress(policy) if as_tree else policy)._repr_html_()
    assert ">outside</text>" in text and ">default</text>" not in text
