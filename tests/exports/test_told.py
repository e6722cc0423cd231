"""Exports of policies with exogenous inputs: golden vectors in every language, and what files say.

The policy has two states and two exogenous inputs, of which the second is periodic.
"""

import dataclasses
import functools
import json
import re

import numpy as np
import pytest

from capsyn import Alphabet, Box, Problem, Switching, compress, synthesize
from capsyn.errors import OutsideDomainError
from capsyn.exports.export import all_targets, export
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, Plan
from capsyn.exports.policy_json import target as policy_json
from capsyn.exports.sequence import golden_sequence
from capsyn.exports.structured_text.target import TARGET as structured_text
from capsyn.modelling.time_unit import to_seconds
from support.exports import policies, remembering
from support.exports.c_machines import Library
from support.exports.c_plans import made, of_vectors
from support.exports.policies import made_by, module
from support.exports.verilog import check as check_verilog
from support.processes.command_line import capsyn, error_of

SCALED = {"scale": [0.05, 1.0, -0.04, 0.01], "offset": [20.0, 0.0, 30.0, -1.5]}
"""Readings that are no states, and exogenous inputs."""


@functools.cache
def problem():
    """Return a house with two rooms, in minutes, that is told a set point and the time of day."""

    def rates(x, u, w):
        outdoor = 12 + 3 * w[1] - w[1] * w[1] / 8
        one = 0.02 * (outdoor - x[0]) + 0.05 * (x[1] - x[0]) + u[0]
        return [one, 0.03 * (outdoor - x[1]) + 0.05 * (x[0] - x[1]) + 0.8 * u[1]]

    return Problem(
        name="rooms",
        dynamics=rates,
        domain=Box([15, 15], [27, 26], names=["T1", "T2"], units=["degC", "degC"]),
        exogenous=Box([18, 0], [23, 24], ["set point", "hour"], ["degC", "h"], [False, True]),
        alphabet=Alphabet([[0, 0], [1, 0], [0, 1]], ["off", "one", "two"], ["h1", "h2"]),
        default=[0.25, 0.25],
        horizon=10.0,
        running_cost=lambda x, w: (x[0] - w[0]) ** 2 + (x[1] - w[0]) ** 2,
        target=lambda x, w: abs(x[0] - w[0]) < 0.5,
        outside="nearest",
        time_unit="min",
        partitions=3,
        max_level=1,
    )


@functools.cache
def policy(kind):
    if kind == "memory":
        return synthesize(problem().replace(switching=Switching(price="1%", hold={"one": 2.0})))
    if kind == "affine":
        return synthesize(problem(), leaves="affine", partitions=2, max_level=0)
    if kind == "tree":
        return compress(policy("constant"), "linear", agreement=0.8, states=2000)
    if kind == "cut":
        return policy("constant").at({"set point": 20.1, "hour": 7.0})
    return synthesize(problem())


KINDS = ("constant", "affine", "tree", "memory", "cut")


def plan_of(kind, **options):
    return Plan.of(policy(kind), **options)


# ---- every language ----


def by_texts(to, plan, directory, **options):
    """Compare an export to Python, JavaScript or JSON."""
    if plan.has_state:
        remembering.assert_remembers(to, plan.source, directory, 2, 60, **options)
    else:
        policies.assert_equal(to, plan.source, directory, **options)


def by_c(plan, directory, **options):
    golden = golden_vectors(plan)
    code = made(plan, golden, **options)
    golden = code.golden or golden
    library = Library(code.files, directory, plan.n)
    if plan.has_state:
        symbols, statuses = library.next(golden.in_force, golden.readings)
    else:
        symbols, statuses = library.decide(golden.readings)
    np.testing.assert_array_equal(symbols, golden.labels)
    np.testing.assert_array_equal(statuses, golden.statuses)


def by_structured_text(plan, directory, **options):
    pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="its grammar is not installed")
    from support.exports.structured_text import check

    vectors = golden_vectors(plan)
    golden = structured_text.files(plan, vectors, **options).golden or vectors
    check(plan, of_vectors(golden, slice(None, None, 9)), **options)


def by_fmu(plan, directory, **options):
    fmpy = pytest.importorskip("fmpy")
    from fmpy.fmi2 import FMU2Slave

    path = export(plan.source, "fmu", directory, **options)[0]
    about, folder = fmpy.read_model_description(path), fmpy.extract(path, directory / "unit")
    name = about.coSimulation.modelIdentifier
    unit = FMU2Slave(guid=about.guid, unzipDirectory=folder, modelIdentifier=name, instanceName="a")
    unit.instantiate()
    golden, sequence = golden_vectors(plan), golden_sequence(plan, 1)
    readings, labels, statuses = golden.readings, golden.labels, golden.statuses
    period = to_seconds(sequence.period, plan.policy.time_unit)
    if plan.has_state:  # of a unit that keeps the symbol in force
        readings, labels = sequence.readings[0], sequence.labels[0]
        statuses = sequence.statuses[0]
    unit.setupExperiment(startTime=0.0)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    for k, (row, *expected) in enumerate(zip(readings.tolist(), labels, statuses)):
        unit.setReal(list(range(plan.n)), row)
        unit.doStep(k * period, period)
        assert unit.getInteger([0, 1]) == expected, row
    unit.terminate()
    unit.freeInstance()


def by_verilog(plan, directory, **options):
    check_verilog(directory, plan, **options)


TARGETS = {
    "c": by_c,
    "structured-text": by_structured_text,
    "verilog": by_verilog,
    "fmu": by_fmu,
    **{to: functools.partial(by_texts, to) for to in ("python", "javascript", "json")},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("to", TARGETS)
def test_every_golden_vector_has_its_symbol(to, kind, tmp_path):
    TARGETS[to](plan_of(kind), tmp_path)


@pytest.mark.parametrize("to", TARGETS)
def test_scales_and_offsets_of_exogenous_inputs(to, tmp_path):
    plan, by = plan_of("constant", **SCALED), TARGETS[to]
    own = to in ("c", "structured-text", "verilog")  # these take the plan alone
    by(plan, tmp_path, **({} if own else SCALED))


@pytest.mark.parametrize("by, options", [
    (by_c, {"readings": "int16"}),
    (by_c, {"readings": "int16", "style": "cells"}),
    (by_c, {"style": "grid"}),
    (by_c, {"style": "nested", "arithmetic": "double"}),
    (by_c, {"arithmetic": "float"}),
    (by_structured_text, {"readings": "INT", "style": "table"}),
    (by_structured_text, {"style": "cells", "dialect": "siemens"}),
    (by_structured_text, {"real": "REAL"}),
])  # fmt: skip
def test_styles_and_counts(by, options, tmp_path):
    by(plan_of("constant", scale=0.01, offset=[20.0, 20.0, 20.0, 12.0]), tmp_path, **options)


def test_fixed_point_ports_of_exogenous_inputs(tmp_path):
    text = check_verilog(tmp_path, plan_of("constant", scale=[1, 1, 0.5, 1]), inputs="fixed")
    assert "// set_point: exogenous input, " in text


# ---- golden vectors ----


@pytest.mark.parametrize("kind", KINDS[:4])
@pytest.mark.parametrize("options", [{}, SCALED])
def test_golden_vectors_vary_exogenous_inputs(kind, options):
    plan = plan_of(kind, **options)
    made_policy, golden = plan.policy, golden_vectors(plan)
    x, w = golden.states[:, :2], golden.states[:, 2:]
    current = None
    if golden.in_force is not None:
        current = np.where(golden.in_force == plan.default, -1, golden.in_force)
    safe = -1 if plan.safe == plan.default else plan.safe
    finite = golden.statuses != NOT_FINITE
    symbols = np.full(len(golden), safe)
    symbols[finite] = made_policy(
        x[finite], w[finite], current=None if current is None else current[finite]
    )
    np.testing.assert_array_equal(golden.labels % plan.labels, symbols % plan.labels)
    # an exogenous input alone is lost, or beyond its bounds; the periodic one never is
    told, within = made_policy.exogenous, made_policy.domain.contains(x)
    lost = ~np.isfinite(w).all(axis=1) & np.isfinite(x).all(axis=1)
    assert lost.sum() > 10 and (golden.statuses[lost] == NOT_FINITE).all()
    assert (golden.labels[lost] == plan.safe).all()
    beyond = within & np.isfinite(w).all(axis=1)
    beyond &= (w[:, 0] < told.lower[0]) | (w[:, 0] > told.upper[0])
    assert beyond.sum() > 10 and (golden.statuses[beyond] == OUTSIDE).all()
    turned = within & told.contains(w) & ((w[:, 1] < 0) | (w[:, 1] > 24))
    assert turned.sum() > 5 and (golden.statuses[turned] == OK).all()
    assert all(len(np.unique(column)) > 1000 for column in w.T)
    if not options:
        faces = told.faces(0, np.arange(plan.counts[2] + 1), plan.counts[2])
        assert len(np.intersect1d(faces, w[:, 0])) > min(len(faces) // 2, 50)


def test_what_is_lost_is_lost_for_states_and_exogenous_inputs_alike(tmp_path):
    asked = module(made_by(policy("constant"), "python", tmp_path))
    x, nan, far = [20.0, 20.0], float("nan"), 90.0
    assert asked.decide([*x, nan, 5.0]) == asked.decide([nan, 20.0, 20.0, 5.0])
    assert asked.decide([*x, nan, 5.0])[1] == asked.NOT_FINITE
    nearest = asked.decide([*x, far, 5.0])
    assert nearest == (asked.decide([*x, 23.0, 5.0])[0], asked.OUTSIDE)
    assert asked.decide([*x, 20.0, 29.0]) == asked.decide([*x, 20.0, 5.0])
    with pytest.raises(OutsideDomainError, match="^the reading must be finite"):
        policy("constant")(x, [nan, 5.0])


# ---- what files say ----


def test_headers_say_what_stands_where(tmp_path):
    lines = plan_of("constant", **SCALED).header
    assert lines[1:10] == (
        "State 0: T1 in [15.0, 27.0] degC",
        "State 1: T2 in [15.0, 26.0] degC",
        "Exogenous input 2: set point in [18.0, 23.0] degC",
        "Exogenous input 3: hour in [0.0, 24.0] h, periodic",
        "State 0 = 0.05 * reading + 20.0",
        "State 1 = 1.0 * reading + 0.0",
        "Exogenous input 2 = -0.04 * reading + 30.0",
        "Exogenous input 3 = 0.01 * reading - 1.5",
        "Readings: states, then exogenous inputs; 'state' below is either of them",
    )
    assert not any("xogenous" in line for line in plan_of("cut").header)
    law = problem().replace(default=lambda x, w: [0.1 * (w[0] - 20), 0.5])
    header = Plan.of(synthesize(law, partitions=1, max_level=0)).header
    assert "The default control is that of a law in the middle of all bounds" in header


def test_constants_and_comments(tmp_path):
    names = list(all_targets(policy("constant")))
    export(policy("constant"), names, tmp_path)
    made_module = module(tmp_path / "python" / "rooms.py")
    assert made_module.STATES == ("T1", "T2") and made_module.EXOGENOUS == ("set point", "hour")
    assert made_module.UNITS == ("degC", "degC", "degC", "h")
    script = (tmp_path / "javascript" / "rooms.mjs").read_text()
    assert 'export const EXOGENOUS = ["set point", "hour"];' in script
    for text in (script, (tmp_path / "python" / "rooms.py").read_text()):
        assert "quantise(reading)" in text and not re.search(r"\(.*\bstate\b.*\)", text)
    header = (tmp_path / "c" / "rooms.h").read_text()
    assert "/* What decisions are asked for: 2 state(s), then 2 exogenous input(s). */" in header
    assert "/* Return the symbol of readings. */" in header
    assert "/* states, then exogenous inputs */" in (tmp_path / "c/example/main.c").read_text()
    block = (tmp_path / "structured-text" / "rooms.st").read_text()
    for line in ("T1 : LREAL; (* T1 [degC] *)", "hour : LREAL; (* exogenous input hour [h] *)"):
        assert f"    {line}\n" in block
    circuit = (tmp_path / "verilog" / "rooms.v").read_text()
    assert "// set_point_step: 6 steps of exogenous input set point\n" in circuit
    assert "// T1_step: 6 steps of T1\n" in circuit


def test_units_and_descriptions_of_fmus(tmp_path):
    fmpy = pytest.importorskip("fmpy")
    path = made_by(policy("constant"), "fmu", tmp_path, sources_only=True)
    variables = fmpy.read_model_description(path).modelVariables
    found = {v.name: (v.unit, v.description) for v in variables if v.causality == "input"}
    assert list(found.values()) == [
        ("degC", "State T1"),
        ("degC", "State T2"),
        ("degC", "Exogenous input set point"),
        ("h", "Exogenous input hour"),
    ]


@pytest.mark.parametrize("kind, version", [("constant", 4), ("affine", 4), ("memory", 5)])
def test_json_follows_its_schema(kind, version, tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    path = made_by(policy(kind), "json", tmp_path)
    data = json.loads(path.read_text())
    schema = json.loads((tmp_path / policy_json.SCHEMAS[version]).read_text())
    validator = jsonschema.Draft202012Validator
    validator.check_schema(schema)
    validator(schema).validate(data)
    assert data["version"] == version
    assert [[axis["name"] for axis in data[key]] for key in ("states", "exogenous")] == [
        ["T1", "T2"],
        ["set point", "hour"],
    ]
    for wrong in ({"version": version - 2}, {"exogenous": []}):
        with pytest.raises(jsonschema.ValidationError):
            validator(schema).validate(data | wrong)
    with pytest.raises(jsonschema.ValidationError):
        validator(schema).validate({k: v for k, v in data.items() if k != "exogenous"})


def test_a_note_says_what_stands_for_a_law():
    law = problem().replace(default=lambda x, w: [(w[0] - 18) / 50, 0], partitions=1, max_level=0)
    made = synthesize(law, outside=-1)
    for one, end in ((made, True), (made.at([20, 7]), True), (policy("constant"), False)):
        said = "".join(Plan.of(one, safe="default").notes)
        assert ("the default's law in the middle of all bounds)" in said) == end


# ---- the command line ----


def test_info_and_query_tell_states_and_exogenous_inputs(tmp_path):
    path = tmp_path / "rooms.cap"
    dataclasses.replace(policy("constant")).save(path)
    data = json.loads(capsyn("info", path, "--quick", "--json")[0])
    assert [axis["name"] for axis in data["states"]] == ["T1", "T2"]
    assert data["exogenous"][1] == {
        "name": "hour", "unit": "h", "lower": 0.0, "upper": 24.0, "periodic": True, "steps": 6,
        "partitions": 3, "refinement": 2,
    }  # fmt: skip
    assert "law" not in data["default"]
    out = capsyn("info", path, "--quick")[0]
    assert re.search(r"^exogenous +hour in \[0, 24\] h, periodic$", out, re.M)
    assert "root grid 3 x 3 x 3 x 3" in out
    found = json.loads(capsyn("query", path, "20", "20", "21", "-3", "--json")[0])
    assert found["state"] == [20.0, 20.0] and found["exogenous"] == [21.0, -3.0]
    assert found["symbol"] == policy("constant")([20.0, 20.0], [21.0, -3.0])
    words = "the state and the exogenous inputs must be 4 number(s) (T1, T2, set point, hour)"
    assert words in error_of("query", path, "20", "20")
    args = ("query", path, "20", "20", "90", "3", "--outside")
    assert "'one'" in capsyn(*args, "one")[0]
    assert "the reading must lie in the domain" in error_of(*args, "error")
