"""Modules that remember: the symbol in force, clocks of symbols and inputs, a hold-off."""

import dataclasses
import re

import numpy as np
import pytest

import capsyn
from capsyn import problems
from capsyn.errors import ProblemError
from capsyn.exports.export import export
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.sequence import golden_sequence
from capsyn.exports.verilog import bench
from capsyn.exports.verilog.target import TARGET as target
from support.exports.remembering import random_rules
from support.exports.valves import HOLDS, assert_rules_kept, valves
from support.exports.verilog import check, run, simulate, tool


@pytest.mark.parametrize("inputs, pipeline", [("lattice", False), ("fixed", True)])
@pytest.mark.parametrize("holds", HOLDS)
def test_every_kind_of_least_time(holds, inputs, pipeline, tmp_path):
    at_once, hold_off = (False, 0.36) if inputs == "lattice" else (True, 0.0)
    plan = Plan.of(valves(holds), outside_at_once=at_once, hold_off=hold_off)
    text = check(tmp_path, plan, inputs=inputs, pipeline=pipeline)
    assert "CLOCK_HZ" in text or not plan.waits
    lint = run(tmp_path, "verilator", "--lint-only", "-Wall", "valves_next.v")
    assert lint == ""


@pytest.mark.parametrize("inputs, pipeline", [("lattice", 2), ("fixed", False)])
def test_least_times_alone_gaps_and_nearest(inputs, pipeline, tmp_path):
    for policy in (
        valves("inputs", constant=True),
        valves("symbols", seed=2, outside="nearest"),
        valves("inputs", seed=2, outside=4, gaps=True),
        valves("symbols", seed=3, constant=True, hold=[0.1, 0, 0.1, 0.2, 0, 0.3, 0]),
    ):
        plan = Plan.of(policy, hold_off=0.2, outside_at_once=True, safe=3)
        check(tmp_path, plan, inputs=inputs, pipeline=pipeline)


def test_symbols_of_equal_controls_with_a_price_between(tmp_path):
    check(tmp_path, Plan.of(random_rules()), inputs="lattice")


def test_no_forbidden_transition_and_no_broken_hold(tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "golden_sequence", lambda plan: golden_sequence(plan, 4, 5000))
    policy = valves("inputs", seed=4)
    plan = Plan.of(policy)
    exported = target.files(plan, golden_vectors(plan), inputs="fixed")
    assert simulate(tmp_path, exported.files, "valves_tb.v") == "PASS: 20000 vectors\n"
    period = exported.sequence.period
    for labels, statuses in zip(exported.sequence.labels, exported.sequence.statuses):
        at_once = np.isin(statuses, plan.at_once)
        assert assert_rules_kept(policy, labels, at_once, period) > 500


def test_a_wrong_step_is_found(tmp_path):
    plan = Plan.of(valves())
    files = target.files(plan, golden_vectors(plan)).files
    text = files["valves.v"]
    files["valves.v"] = text.replace(b"held < least ? symbol_held :", b"")
    assert files["valves.v"] != text
    assert "FAIL: " in simulate(tmp_path, files, "valves_tb.v")


def test_names_that_modules_which_remember_keep(tmp_path):
    policy = valves()
    domain = dataclasses.replace(policy.domain, names=["in_force", "level"])
    plan = Plan.of(dataclasses.replace(policy, domain=domain, name="core"))
    text = check(tmp_path, plan, inputs="fixed")
    assert "module core_2\n" in text and " in_force_2," in text and " level_2," in text


def test_clocks_are_those_of_the_times(tmp_path):
    text = check(tmp_path, Plan.of(valves("symbols"), hold_off=1.5), clock_hz=1e6)
    names = re.findall(r"parameter \[63:0\] (\w+) =", text)
    assert names == [
        "CLOCK_HZ", "HOLD_1_CYCLES", "HOLD_2_CYCLES", "HOLD_4_CYCLES", "HOLD_7_CYCLES",
        "HOLD_OFF_CYCLES",
    ]  # fmt: skip
    assert "// at least 120 ms once entered: 1 0, in whole clocks" in text
    plan = Plan.of(valves("symbols"), hold_off=1e12)
    with pytest.raises(ProblemError, match="`hold_off` must be less than 2.63 clocks"):
        target.files(plan, golden_vectors(plan))


def test_prices_of_affine_leaves_are_no_tree():
    plan = Plan.of(valves(priced=True))
    for inputs in ("lattice", "fixed"):
        with pytest.raises(ProblemError, match="affine leaves with prices on switching have none"):
            target.files(plan, golden_vectors(plan), inputs=inputs)


def test_synthesis(tmp_path):
    tool("yosys")
    switching = capsyn.Switching(price="1%", hold=[1.0, 2.0, 0.0, 3.0])
    problem = problems.get("double-tank-b").replace(switching=switching)
    paths = export(capsyn.synthesize(problem), "verilog", tmp_path, name="top")
    assert {path.name for path in paths} == {
        "top.v", "top_next.v", "top_tb.v", "top.mem", "top_sequence_tb.v", "top_sequence.mem",
        "golden.csv", "sequence.csv", "certificate.json",
    }  # fmt: skip
    script = "read_verilog top.v top_next.v; synth_ice40 -top top; stat -top top"
    told = run(tmp_path, "yosys", "-p", script)
    warnings = re.findall("^.*warning.*$", told, re.M | re.I)
    assert not [text for text in warnings if not text.startswith("ABC: ")]
    cells = int(re.findall(r"Number of cells:\s+(\d+)", told)[-1])
    print(f"cells of the priced double-tank-b: {cells}")
    assert 0 < cells < 2000
