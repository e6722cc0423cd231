"""Policies with affine leaves in all languages: as their cells, without a tree."""

import dataclasses
import json

import numpy as np
import pytest

from capsyn import problems, synthesize
from capsyn.cells.packing import packed_bytes
from capsyn.errors import ProblemError
from capsyn.exports import export as core
from capsyn.exports import plan as plans
from capsyn.exports.export import TARGETS, all_targets, export
from capsyn.exports.plan import Plan
from capsyn.exports.policy_json import target as policy_json
from capsyn.exports.verilog import target as verilog
from support.exports.policies import RUNNERS, assert_equal, made_by
from support.processes.command_line import capsyn
from support.trees import GRIDS, random_affine_policy, random_policy


@pytest.mark.parametrize("some_axes", [False, True])
@pytest.mark.parametrize(
    ("grid", "to"),
    [(grid, to) for grid in (0, 2, 4, 7) for to in RUNNERS if to != "micropython" or grid == 7],
)
def test_languages(to, grid, some_axes, tmp_path):
    assert_equal(to, random_affine_policy(grid, True, grid, some_axes), tmp_path)


@pytest.mark.parametrize("to", RUNNERS)
def test_gaps_and_rules_outside(to, tmp_path):
    policy = random_affine_policy(3, seed=1)
    for changes in ({"gaps": True}, {"outside": "nearest"}):
        assert_equal(to, dataclasses.replace(policy, **changes), tmp_path, safe=1)


@pytest.mark.parametrize("some_axes", [False, True])
def test_structured_text(some_axes):
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="the grammar is not installed")
    from support.exports import structured_text

    for grid in (1, 3, 6):
        policy = dataclasses.replace(random_affine_policy(grid, True, grid, some_axes), gaps=True)
        structured_text.check(Plan.of(policy))
        structured_text.check(Plan.of(random_policy(grid, True, grid, some_axes)), style="cells")
    text = structured_text.source(Plan.of(policy)).decode()
    assert "INT_TO_DINT(slopes[" in text and "FUNCTION random_tree" not in text
    assert (
        "FUNCTION random_tree" in structured_text.source(Plan.of(policy), style="nested").decode()
    )
    with pytest.raises(ProblemError, match="`style` must be one of 'nested', 'table', 'cells'"):
        structured_text.source(Plan.of(policy), style="trees")


def test_json_follows_its_schema(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    path = made_by(random_affine_policy(3), "json", tmp_path)
    data, schema = (json.loads(p.read_text()) for p in (path, tmp_path / policy_json.SCHEMA))
    check = jsonschema.Draft202012Validator(schema).validate
    check(data)
    assert data["version"] == 2 and "tree" not in data
    for wrong in ({"version": 1}, {"cells": {}}, {"more": 1}):
        with pytest.raises(jsonschema.ValidationError):
            check(data | wrong)


def test_no_tree_is_made(tmp_path, monkeypatch):
    def refused(*_):
        raise AssertionError("a tree was made")

    monkeypatch.setattr(plans, "_tree_of", refused)
    monkeypatch.setattr(plans, "_affine_tree_of", lambda policy, most: None)
    policy = random_affine_policy(3)
    targets = all_targets(policy)
    assert set(TARGETS) - set(targets) == {"dot", "verilog"}
    export(policy, targets, tmp_path)
    for name, text in (("verilog", "has more than 200,000 nodes: .*linear"), ("dot", "boxes")):
        with pytest.raises(ProblemError, match=text) as error:
            export(policy, name, tmp_path)
        assert "\n" not in str(error.value)


def test_targets_of_trees_alone_take_small_ones(tmp_path, monkeypatch):
    policy = random_affine_policy(3)
    assert "verilog" in all_targets(policy)
    export(policy, "verilog", tmp_path)
    about = json.loads((tmp_path / "certificate.json").read_text())
    assert about["nodes"] == Plan.of(policy).tree.node_count
    assert any(line.startswith("Tree: ") for line in about["header"])
    monkeypatch.setattr(core, "MOST_NODES", about["nodes"] - 2)
    monkeypatch.setattr(verilog, "MOST_NODES", about["nodes"] - 2)
    assert "verilog" not in all_targets(policy)
    with pytest.raises(ProblemError, match="target verilog"):
        export(policy, "verilog", tmp_path)


@pytest.mark.parametrize("some_axes", [False, True])
@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_certificates_tell_what_lookups_take(grid, some_axes, tmp_path):
    policy = random_affine_policy(grid, seed=grid, some_axes=some_axes)
    export(policy, "python", tmp_path)
    data = json.loads((tmp_path / "certificate.json").read_text())
    cells, affine = policy.cells, policy.cells.affine
    steps = np.stack(np.indices(cells.counts), axis=-1).reshape(-1, cells.n)
    places = cells.find(steps)
    leaf = cells.labels_at(places) - affine.first
    rows = np.where(leaf < 0, 0, np.diff(affine.starts)[leaf.clip(0)])
    level = np.zeros(len(cells.entries), dtype=int)
    for here in cells.levels():
        level[here.places] = here.level
    assert data["rows_evaluated"] == {"most": rows.max(), "mean": pytest.approx(rows.mean())}
    assert data["levels"]["most"] == level[places].max()
    assert data["levels"]["mean"] == pytest.approx(level[places].mean())
    worst = np.flatnonzero((steps == data["worst"]).all(axis=1))[0]
    assert rows[worst] == rows.max()
    assert level[places[worst]] == level[places[rows == rows.max()]].max()
    assert data["cells"] == cells.leaf_count and data["affine_leaves"] == len(affine)
    assert data["rows"] == len(affine.symbols) and data["cells_bytes"] == packed_bytes(cells)
    assert any(line.startswith(f"Cells: {cells.leaf_count} leaves") for line in data["header"])
    assert "nodes" not in data and data["lattice"] == list(cells.counts)


def test_commands(tmp_path):
    policy = synthesize(problems.plain("spacecraft"), leaves="affine", max_level=0)
    path = tmp_path / "spacecraft.cap"
    policy.save(path)
    out, _ = capsyn("export", path, "--to", "c,python", "-o", tmp_path)
    assert (
        f"{policy.cells.leaf_count:,} cells with {len(policy.cells.affine.symbols):,} rows" in out
    )
    assert "nodes" not in out
    options = json.loads((tmp_path / "c" / "certificate.json").read_text())["options"]
    assert options["style"] == "cells"
