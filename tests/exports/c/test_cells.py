"""C style ``cells``: every lattice step, ties, the largest rows, bytes, and when it is chosen."""

import dataclasses
import math
import shutil

import numpy as np
import pytest

from capsyn import compress, problems, synthesize
from capsyn.cells.affine_leaves import LARGEST_SUM
from capsyn.cells.packing import packed_bytes
from capsyn.errors import ProblemError
from capsyn.exports.c import target
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.styles import cells as style_cells
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import OK, Plan
from support.exports.c_machines import (
    WARNINGS,
    Library,
    avr,
    call,
    cortex_m3,
    need,
    prefix_of,
    write,
)
from support.exports.c_plans import (
    COMPILERS,
    UNDEFINED,
    assert_golden,
    files,
    made,
    made_of_counts,
    of_vectors,
)
from support.trees import GRIDS, policy_of_rows, random_affine_policy, random_policy

STEEP = [(0, 0, [16383, 16383]), (1, LARGEST_SUM - 2 * 2**14 * 16384, [-16384, -16384])]
"""Rows as large as they may be."""


def steps_of(counts):
    """Return all steps of a lattice, or many."""
    rng = np.random.default_rng(0)
    inside = rng.integers(counts, size=(20_000, len(counts)))
    if math.prod(counts) < 50_000:
        inside = np.stack(np.indices(counts), axis=-1).reshape(-1, len(counts))
    beyond = rng.integers(-np.array(counts) - 9, 2 * np.array(counts) + 9, (2000, len(counts)))
    beyond = np.clip(beyond, -32768, 32767)
    ends = rng.choice([-32768, -1, 0, 32767], (200, len(counts)))
    return np.concatenate([inside, beyond, ends])


def assert_every_step(plan, directory, compiler="gcc", style="cells"):
    """Compare the code with the policy at golden vectors, at steps of the lattice, and beyond."""
    golden = golden_vectors(plan)
    options = UNDEFINED if compiler == "gcc" else ("-O1",)
    library = Library(files(plan, golden, style=style), directory, plan.n, compiler, options)
    assert_golden(library, golden, True)
    steps = steps_of(plan.counts)
    inner = np.clip(steps, 0, np.array(plan.counts) - 1)
    assert np.array_equal(library.look(steps), plan.policy.cells.labels(inner))


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_affine_leaves_at_every_step(grid, compiler, tmp_path):
    # along some axes by one compiler, along all by the other, and the other way round
    some_axes = (grid + COMPILERS.index(compiler)) % 2 == 0
    assert_every_step(
        Plan.of(random_affine_policy(grid, True, grid, some_axes)), tmp_path, compiler
    )


@pytest.mark.parametrize("grid", [0, 1, 3, 5, 7])
def test_plain_cells_when_asked_for(grid, tmp_path):
    policy = dataclasses.replace(random_policy(grid, True, grid, grid % 2 == 0), outside="nearest")
    assert_every_step(Plan.of(policy), tmp_path)


def test_ties_have_the_lowest_symbol(tmp_path):
    rows = [(0, 3, [0, 1]), (1, 3, [1, 0]), (2, 3, [0, 1])]
    policy = policy_of_rows(rows, (8, 8))
    assert np.count_nonzero(policy.cells.labels(np.array([[k, k] for k in range(8)]))) == 0
    assert_every_step(Plan.of(policy), tmp_path)


@pytest.mark.parametrize("rows", [STEEP, STEEP[::-1]])
def test_the_largest_rows_do_not_overflow(rows, tmp_path):
    rows = [(symbol, *row[1:]) for symbol, row in enumerate(rows)]
    assert_every_step(Plan.of(policy_of_rows(rows, (2**14, 2**14))), tmp_path)


def test_rows_whose_differences_are_wide_are_all_kept(tmp_path):
    rows = [(0, -2_090_000, [32767, 0]), (1, -9, [-32767, 0]), (2, -40_000, [0, 0])]  # all below 0
    policy = policy_of_rows(rows, (64, 32), copies=2)
    tables = style_cells.Tables.of(policy.cells, "p")
    assert len(tables.rows["symbols"].values) == 3  # of two equal leaves
    narrow = style_cells.Tables.of(policy_of_rows(STEEP, (2**14, 2**14)).cells, "p")
    assert narrow.rows["symbols"].values.tolist() == [1]
    assert_every_step(Plan.of(policy), tmp_path)


def test_steps_of_32_bits(tmp_path):
    rows = [(0, 70_000, [1, -2]), (1, 0, [2, -1]), (2, 90_000, [0, 0])]
    plan = Plan.of(policy_of_rows(rows, (1 << 17, 1 << 16), copies=2))
    assert b"const int32_t z[2]" in files(plan, None, style="cells")["rows.h"]
    assert_every_step(plan, tmp_path)


def test_narrow_entries(tmp_path):
    rows = [(0, 0, [0, 0]), (1, 5, [-3, 1])]
    policy = policy_of_rows(rows, (8, 8))
    types = {t.name[2:]: t.type for t in style_cells.Tables.of(policy.cells, "p_").all}
    assert types["_slopes"] == types["_entries"] == np.int8 and types["_constants"] == np.uint8
    assert_every_step(Plan.of(policy), tmp_path, "clang")


@pytest.fixture(scope="module")
def spacecraft():
    """Return a policy in six dimensions whose tree is far larger than its cells."""
    return synthesize(problems.plain("spacecraft"), leaves="affine", max_level=0)


def test_six_dimensions(spacecraft, tmp_path):
    plan = Plan.of(spacecraft)
    code = made(plan)
    assert code.chosen == {"style": "cells"}
    assert_every_step(plan, tmp_path, style=None)
    states = spacecraft.domain.sample(20_000, 3)
    found = Library(code.files, tmp_path / "states", plan.n, options=("-O2",)).decide(states)[0]
    assert np.array_equal(found, spacecraft(states) % plan.labels)
    assert len(np.unique(found)) >= 6


def test_bytes_are_about_those_of_the_packed_cells(spacecraft):
    need("gcc", "arm-none-eabi-gcc")
    code = made(Plan.of(spacecraft))
    tables = style_cells.cells_bytes(spacecraft.cells)
    assert tables <= packed_bytes(spacecraft.cells)
    for measured in sizes(code.files, prefix_of(code.files)).values():
        assert tables < measured["decision"] <= tables + 1200
        assert measured["ram"] == 0


def test_the_smaller_of_cells_and_tree_is_taken():
    chosen = set()
    for grid in range(len(GRIDS)):
        plan = Plan.of(random_affine_policy(grid, True, grid))
        style = made(plan).chosen["style"]
        tree = target.table_bytes(plan.tree.cells)
        assert style == ("cells" if tree > style_cells.cells_bytes(plan.policy.cells) else "table")
        chosen.add(style)
        default, asked = files(plan, None), files(plan, None, style=style)
        assert default == asked
    assert chosen == {"cells", "table"}
    plain = Plan.of(random_policy(3))
    assert files(plain, None) == files(plain, None, style="table")


def test_a_tree_that_is_too_large_is_given_up(spacecraft, monkeypatch):
    monkeypatch.setattr(target, "table_bytes", lambda tree: 0)
    assert made(Plan.of(spacecraft)).chosen == {"style": "cells"}  # however small it would be
    monkeypatch.setattr("capsyn.compression.trees.MAX_NODES", 1000)
    with pytest.raises(ProblemError, match="more than 1,000 nodes: .*style cells.*leaf_error") as e:
        files(Plan.of(spacecraft), None, style="table")
    assert "\n" not in str(e.value)


def test_a_tree_has_no_cells():
    with pytest.raises(ProblemError, match="`style` cells is for policies of cells; got Decision"):
        files(Plan.of(compress(random_policy(3))), None, style="cells")
    with pytest.raises(ProblemError, match="`style` must be one of .*'cells'"):
        files(Plan.of(random_policy(3)), None, style="cell")


@pytest.mark.parametrize("arithmetic", ["double", "float"])
def test_other_arithmetics(arithmetic, tmp_path):
    plan = Plan.of(random_affine_policy(3, True, 1))
    golden = golden_vectors(plan)
    code = made(plan, golden, style="cells", arithmetic=arithmetic)
    golden = code.golden or golden
    symbols, statuses = Library(code.files, tmp_path, plan.n).decide(golden.readings)
    assert np.array_equal(symbols, golden.labels)
    assert np.array_equal(statuses, golden.statuses)
    with pytest.raises(ProblemError, match="tabulates all 32,766 faces of cells"):
        plan = Plan.of(policy_of_rows(STEEP, (2**14, 2**14)))
        files(plan, None, style="cells", arithmetic="float")


def test_counts_gaps_and_dwell(tmp_path):
    policy = dataclasses.replace(random_affine_policy(3, seed=1), gaps=True, min_dwell=0.1)
    scale = (policy.domain.widths / 1000).tolist()
    plan = Plan.of(policy, scale=scale, offset=policy.domain.lower, safe=1)
    code = made_of_counts(plan)
    symbols, statuses = Library(code.files, tmp_path, plan.n).decide(code.golden.readings)
    assert np.array_equal(symbols, code.golden.labels)
    assert np.array_equal(statuses, code.golden.statuses)
    inside = ((code.golden.readings >= 0) & (code.golden.readings <= 1000)).all(axis=1)
    assert (code.golden.statuses[inside] != OK).any()  # in gaps


@pytest.mark.parametrize("some_axes", [False, True])
def test_on_processors(some_axes, tmp_path):
    plan = Plan.of(random_affine_policy(3, True, 2, some_axes))
    golden = golden_vectors(plan)
    written = files(plan, golden, style="cells")
    golden = of_vectors(golden, np.flatnonzero(golden.statuses == OK))
    assert cortex_m3(written, golden, tmp_path / "arm") == 0
    assert avr(written, of_vectors(golden, slice(None, None, 2)), tmp_path / "avr") == 0
    wrong = dataclasses.replace(golden, labels=np.r_[golden.labels[:-1], 9])
    assert cortex_m3(written, wrong, tmp_path / "wrong") == 1


def test_an_avr_is_told_what_it_does_not_reach(tmp_path, monkeypatch):
    plan = Plan.of(random_affine_policy(3))
    assert b"#error" not in files(plan, None, style="cells")["random.c"]
    monkeypatch.setattr(style_cells, "AVR_MEMORY", 100)
    write(files(plan, None, style="cells"), tmp_path)
    for compiler in filter(shutil.which, COMPILERS):
        call([compiler, "-std=c99", *WARNINGS, "-c", "random.c"], tmp_path)
    need("avr-gcc")
    with pytest.raises(AssertionError, match="bytes: an AVR reaches 100"):
        call(["avr-gcc", "-std=c99", "-c", "random.c"], tmp_path)
