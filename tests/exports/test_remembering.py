"""Exports of policies that remember: golden vectors and sequences, and what may never happen."""

import csv
import dataclasses
import functools
import json
import math
import shutil
import subprocess

import numpy as np
import pytest

from capsyn import Switching, simulate
from capsyn.errors import ProblemError
from capsyn.exports.export import TARGETS, all_targets, export
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.policy_json import target as policy_json
from capsyn.exports.sequence import golden_sequence, run
from support.exports.policies import made_by, module, small
from support.exports.remembering import (
    POLICIES,
    RUNNERS,
    assert_remembers,
    house,
    only_times,
    pendulum,
    random_prices,
    random_rows,
    random_rules,
)
from support.processes.command_line import capsyn, error_of
from support.references.switching import InForce, kinds_of

OPTIONS = {
    "rows": {"hold_off": 0.3, "safe": "off"},
    "one axis": {"outside_at_once": True, "scale": -0.1, "offset": 5},
    "prices": {"hold_off": 0.35, "outside_at_once": True},
    "no times": {"hold_off": 20.0},
    "house": {"dwell": 7.5},
}


MICROPYTHON = ("rows", "prices", "house", "gaps", "features", "pendulum")
"""Policies whose Python modules MicroPython runs, too; it is slow."""


@pytest.mark.parametrize(
    ("name", "to"),
    [
        (name, to)
        for name in POLICIES
        for to in RUNNERS
        if to != "micropython" or name in MICROPYTHON
    ],
)
def test_languages(name, to, tmp_path):
    assert_remembers(to, POLICIES[name](), tmp_path, 8, **OPTIONS.get(name, {}))


@pytest.mark.parametrize("to", ["python", "javascript"])
def test_many_steps(to, tmp_path):
    assert_remembers(to, random_rows(), tmp_path, 200, 500)


# ---- the reference ----


def since(changed):
    """Return the steps (S, K) since the last change before each step; the first step is one."""
    steps = np.arange(changed.shape[1])
    last = np.maximum.accumulate(np.where(changed, steps, 0), axis=1)
    return steps[1:] - last[:, :-1]


@pytest.mark.parametrize("name", ["rows", "four axes", "prices", "house", "times", "gaps"])
def test_no_forbidden_transition_and_no_broken_time(name):
    plan = Plan.of(POLICIES[name](), **OPTIONS.get(name, {}))
    made = golden_sequence(plan, 400, 500)
    rules, labels, period = plan.policy.rules, made.labels, made.period
    before = np.hstack([np.full((len(labels), 1), plan.default), labels[:, :-1]])
    assert (
        not rules.forbidden[before, labels].any() and not rules.forbidden[before, made.wanted].any()
    )
    at_once = np.isin(made.statuses, plan.at_once)
    entered = rules.kinds[labels] != rules.kinds[before]
    moved = rules.controls[labels] != rules.controls[before]
    entered[:, 0] = moved[:, 0] = True
    least = np.ceil(rules.holds / period - 1e-9)
    pending = since(entered) < least[before[:, 1:]]
    assert not (entered & ~at_once)[:, 1:][pending].any()
    for i, time in enumerate(rules.input_holds):
        locked = since(moved[:, :, i]) < math.ceil(time / period - 1e-9)
        assert not (moved[:, :, i] & ~at_once)[:, 1:][locked].any()
        pending |= locked
    waits = (labels != made.wanted)[:, 1:]
    assert not waits[~pending].any()  # for nothing else
    assert waits.any() == plan.waits and len(np.unique(labels)) > 2
    off = math.ceil(plan.hold_off / period - 1e-9)
    assert (labels[:, :off] == plan.safe).all()


def test_the_reference_is_the_closed_loop():
    for policy, start in ((pendulum(), [2.0, 0.5]), (house(), [14.0]), (random_rows(), None)):
        start = policy.domain.lower + policy.domain.widths / 3 if start is None else start
        if policy.model is None:
            continue
        rate = 4 / min(t for t in policy.rules.holds if t)
        loop = simulate(policy, start, 400 / rate, rate=rate)
        made = run(Plan.of(policy), loop.states[None, :-1], 1 / rate)
        labels = len(policy.alphabet) + 1
        np.testing.assert_array_equal(made.labels[0] % labels, loop.symbols % labels)
        assert len(np.unique(loop.symbols)) > 1


@pytest.mark.parametrize("seed", range(24))
def test_the_reference_is_the_rule_as_it_is_told(seed):
    """In a plain statement of it, on random rules, with symbols of equal controls."""
    rng, period, steps = np.random.default_rng([16, seed]), 0.25, 400
    policy = random_rules(seed)
    options = {"hold_off": 0.75 * (seed % 3), "outside_at_once": seed % 2 == 0}
    readings = np.where(rng.random((4, steps)) < 0.05, np.nan, 1.2 * rng.random((4, steps)) - 0.1)
    plan = Plan.of(policy, **options)
    made = run(plan, readings[:, :, None], period)
    controls, holds = policy.controls.tolist(), policy.switching.hold
    names = [*policy.alphabet.names, "default"]
    pairs = [[names.index(name) for name in pair] for pair in policy.switching.forbidden]
    like = controls.index(controls[-1])  # what the default control is, of the symbols
    pairs += [[j, plan.default] for j, k in pairs if k == like and j < plan.default]
    times = [holds.get(name, 0.0) for name in names]
    times[-1] = times[like]
    kinds = kinds_of(controls, policy.rules.prices.tolist())
    inputs = [holds.get(name, 0.0) for name in policy.alphabet.inputs]
    rows = policy.transitions[-1 - policy.cells.entries]
    for reading, labels in zip(readings, made.labels):
        rule = InForce(controls, kinds, times, inputs, pairs, 0, options["hold_off"])
        for k, x in enumerate(reading):
            inside = 0 <= x <= 1
            wanted = rows[min(int(x * len(rows)), len(rows) - 1), rule.now] if inside else 0
            at_once = bool(np.isnan(x)) or (not inside and options["outside_at_once"])
            assert rule.step(int(wanted), at_once, k * period) == labels[k], (k, x)
    assert len(np.unique(made.labels)) > 2


def test_golden_vectors_go_through_all_symbols_in_force(tmp_path):
    for policy in (random_rows(), random_prices()):
        plan = Plan.of(policy)
        golden = golden_vectors(plan)
        assert set(golden.in_force) == set(range(plan.labels))
        current = np.where(golden.in_force == plan.default, -1, golden.in_force)
        known = golden.statuses == 0
        symbols = policy(golden.states[known], current=current[known])
        np.testing.assert_array_equal(golden.labels[known] % plan.labels, symbols % plan.labels)
    export(policy, "python", tmp_path)
    golden, sequence = (
        list(csv.DictReader(line for line in path.read_text().splitlines() if line[0] != "#"))
        for path in (tmp_path / "golden.csv", tmp_path / "sequence.csv")
    )
    assert list(golden[0]) == "x1 x2 step_0 step_1 in_force symbol status".split()
    assert list(sequence[0]) == "run step x1 x2 symbol status".split()
    assert "# A step every 0.1 s; each run from a new start" in (
        (tmp_path / "sequence.csv").read_text()
    )


# ---- plans ----


def test_plans_take_one_time_for_all_others():
    plan = Plan.of(random_rows(), dwell=0.25)
    assert set(plan.policy.rules.holds) == {0.25} and not plan.policy.rules.input_holds.any()
    assert plan.has_state and plan.forbidden == Plan.of(random_rows()).forbidden != []
    assert (
        plan.sha256 == Plan.of(random_rows()).sha256 and plan.tree.guarantee.source == plan.sha256
    )
    assert not Plan.of(only_times(), dwell=0.25).has_state
    assert not Plan.of(random_rows(), dwell=0).waits
    assert Plan.of(small(), hold_off=1.0).has_state and not Plan.of(small()).has_state


def test_headers_say_what_is_remembered():
    price = {"heater": 0.5, "cooler": 1}
    policy = dataclasses.replace(
        random_rows(),
        switching=dataclasses.replace(random_rows().switching, price=price),
        delay=0.1,
    )
    lines = Plan.of(policy, hold_off=2).header
    for line in (
        "The next symbol depends on the symbol in force, which stays where it ties",
        "Price of a switch: 0.5 a unit of heater, 1.0 a unit of cooler [cost / s]",
        "Forbidden: heat to cool, cool to heat, default to both",
        "Least times [s]: heat 0.5, x 0.1, default 0.2, heater 0.3, cooler 0.75",
        "After the start the safe symbol is held for 2.0 s",
        "Compensates an input delay of 0.1 s",
    ):
        assert line in lines
    matrix = Switching(price=(1 - np.eye(5)) * 2 + np.tri(5, k=-1))
    assert "Price of a switch: 2.0 to 3.0 [cost / s]" in (
        Plan.of(dataclasses.replace(random_rows(), switching=matrix)).header
    )


@pytest.mark.parametrize(
    "options, words",
    [
        (
            {"safe": "heat"},
            "`safe` must be a symbol .*the transition from 'cool' to 'heat' is forb",
        ),
        ({"hold_off": -1}, "`hold_off` must be a finite number >= 0"),
        ({"hold_off": "1"}, "`hold_off` must be a number"),
        ({"dwell": math.inf}, "`dwell` must be a finite number >= 0"),
    ],
)
def test_wrong_options_are_told_in_a_line(options, words, tmp_path):
    with pytest.raises(ProblemError, match=words) as error:
        export(random_rows(), "python", tmp_path / "new", **options)
    assert "\n" not in str(error.value) and not list(tmp_path.iterdir())


# ---- files ----


def test_decisions_without_a_symbol_in_force(tmp_path):
    made = module(made_by(random_rows(), "python", tmp_path))
    assert not hasattr(made, "decide") and not hasattr(made, "MIN_DWELL")
    for wrong in (-1, 6):
        with pytest.raises(ValueError, match="a symbol in force is 0 to 5"):
            made.next_symbol(wrong, [0.0, 0.0])
    times = module(made_by(only_times(), "python", tmp_path / "times"))
    assert times.decide([3.0, 0.0]) == times.next_symbol(1, [3.0, 0.0])
    with pytest.raises(TypeError):
        times.Controller().step([3.0, 0.0])  # needs a time


@pytest.mark.parametrize("name", ["rows", "prices", "house", "times", "features"])
def test_json_follows_its_schema(name, tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    path = made_by(POLICIES[name](), "json", tmp_path)
    data, schema = (json.loads(p.read_text()) for p in (path, tmp_path / policy_json.SCHEMA_3))
    validator = jsonschema.Draft202012Validator
    validator.check_schema(schema)
    validator(schema).validate(data)
    assert data["version"] == 3 and data["$schema"] == policy_json.SCHEMA_3
    assert ("transitions" in data) == (name != "times") and "min_dwell" not in data
    for wrong in ({"version": 2}, {"holds": [-1]}, {"forbidden": [[1]]}, {"kinds": []}):
        with pytest.raises(jsonschema.ValidationError):
            validator(schema).validate(data | wrong)


def test_graphviz_draws_the_switches_that_there_are(tmp_path):
    text = made_by(house(), "dot", tmp_path).read_text()
    assert "// Least times [min]: off 5.0, heat 10.0, cool 10.0" in text
    names = {k: k for k in range(4)}
    edges = {tuple(map(int, line.split("[")[0].split("->"))) for line in text.splitlines()
             if " -> " in line}  # fmt: skip
    assert (0, 1) in edges and (1, 2) not in edges and (2, 1) not in edges and names
    if shutil.which("dot"):
        subprocess.run(["dot", "-Tsvg", tmp_path / "house.dot"], check=True, capture_output=True)


@pytest.mark.parametrize("to", ["python", "javascript", "json", "dot", "fmu"])
def test_the_same_bytes_and_what_they_cost(to, tmp_path):
    policy = house()
    first, second = (export(policy, to, tmp_path / name, hold_off=3) for name in "ab")
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]
    certificate = json.loads((tmp_path / "a" / "certificate.json").read_text())
    table = policy.transitions
    assert certificate["transitions"] == {"rows": len(table), "bytes": table.size}
    assert set(certificate["files"]) == {p.name for p in first} - {"certificate.json"}
    assert "After the start the safe symbol is held for 3.0 min" in certificate["header"]


def test_all_targets_are_those_that_remember():
    able = {name for name in TARGETS if name in all_targets(only_times())}
    assert {"c", "fmu", "python", "javascript", "json", "dot"} <= able
    assert able == set(all_targets(random_rows()))


def test_commands(tmp_path):
    path = tmp_path / "house.cap"
    house().save(path)
    there = functools.partial(capsyn, "export", path, "--to", "json", "-o", tmp_path)
    out, _ = there("--hold-off", "2.5", "--dwell", "4")
    assert f"; {len(house().transitions)} rows of transitions of" in " ".join(out.split())
    data = json.loads((tmp_path / "house.json").read_text())
    assert data["hold_off"] == 2.5 and set(data["holds"]) == {4.0}
    told = error_of("export", path, "--to", "json", "-o", tmp_path / "new", "--safe", "heat")
    assert "the transition from 'cool' to 'heat' is forbidden" in told
