"""FMUs: valid, the same bytes, and equal to the policy and to simulations."""

import ctypes
import dataclasses
import functools
import shutil
import subprocess
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest

from capsyn import Alphabet, simulate
from capsyn.errors import CapsynWarning, KernelBuildError
from capsyn.exports.export import export
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.sequence import golden_sequence
from capsyn.modelling.time_unit import to_seconds
from support.exports.policies import PROBLEMS, built_in, oblique, small
from support.exports.remembering import POLICIES, random_rows
from support.features import exact
from support.processes.command_line import capsyn
from support.trees import random_affine_policy, random_policy

fmpy = pytest.importorskip("fmpy")
validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu


@pytest.fixture
def run(tmp_path):
    """Return what exports a policy and starts its FMU; ended after the test."""
    from fmpy.fmi2 import FMU2Slave

    units = []

    def start(policy, parameters=None, library=None, **options):
        path = export(policy, "fmu", tmp_path / str(len(units)), **options)[0]
        about = fmpy.read_model_description(path)
        unit = FMU2Slave(
            guid=about.guid,
            unzipDirectory=fmpy.extract(path, tmp_path / f"unit{len(units)}"),
            modelIdentifier=about.coSimulation.modelIdentifier,
            instanceName="unit",
            libraryPath=library and str(library),
        )
        unit.instantiate()
        unit.setupExperiment(startTime=0.0)
        unit.enterInitializationMode()
        for reference, value in (parameters or {}).items():
            unit.setReal([reference], [value])
        unit.exitInitializationMode()
        units.append(unit)
        return unit

    yield start
    for unit in units:
        unit.terminate()
        unit.freeInstance()


def decisions(unit, plan, readings):
    """Return symbols and statuses (K, 2) and control vectors (K, m) of readings (K, n)."""
    references = list(range(plan.n))
    outputs = [plan.n + i for i in range(plan.policy.alphabet.m)]
    found, controls = [], []
    for k, row in enumerate(readings.tolist()):
        unit.setReal(references, row)
        found.append(unit.getInteger([0, 1]))
        controls.append(unit.getReal(outputs))
        unit.doStep(float(k), 1.0)
        assert unit.getInteger([0, 1]) == found[-1]
        assert unit.getReal(outputs) == controls[-1]
    return np.array(found), np.array(controls)


def assert_equal(start, policy, **options):
    plan = Plan.of(policy, **options)
    golden = golden_vectors(plan)
    far = np.random.default_rng(1).normal(size=(60, plan.n)) * 10.0 ** np.arange(0, 300, 5)[:, None]
    expected = decide(plan, np.concatenate([golden.readings, far]))
    found, controls = decisions(start(policy, **options), plan, expected.readings)
    np.testing.assert_array_equal(found[:, 1], expected.statuses)
    np.testing.assert_array_equal(found[:, 0], expected.labels)
    np.testing.assert_array_equal(controls, plan.policy.controls[expected.labels])


@pytest.mark.parametrize("name", PROBLEMS)
def test_built_in_problems(name, run):
    assert_equal(run, built_in(name))


def test_trees_with_features(run):
    assert_equal(run, exact())


@pytest.mark.parametrize("outside", ["error", "nearest", 1])
def test_rules_outside(outside, run):
    assert_equal(run, dataclasses.replace(small(), outside=outside))
    assert_equal(run, dataclasses.replace(small(), outside=outside), safe=0)


def test_oblique_splits_readings_and_other_dimensions(run):
    assert_equal(run, oblique())
    assert_equal(run, random_policy(0, periodic=True))
    assert_equal(run, random_policy(7, periodic=True), scale=-0.0375, offset=100)


@pytest.mark.parametrize("some_axes", [False, True])
def test_affine_leaves(some_axes, run):
    assert_equal(run, random_affine_policy(3, True, 1, some_axes), scale=-0.0375, offset=0.1)
    policy = dataclasses.replace(random_affine_policy(6, True, 2, some_axes), gaps=True)
    assert_equal(run, policy, safe=1)


@pytest.mark.parametrize("name", POLICIES)
def test_units_remember(name, run):
    options = {"hold_off": 0.3} if name in ("rows", "prices", "no times") else {}
    plan = Plan.of(POLICIES[name](), **options)
    sequence, unit = golden_sequence(plan), run(plan.policy, **options)
    period = to_seconds(sequence.period, plan.policy.time_unit)
    references = list(range(plan.n))
    outputs = [plan.n + i for i in range(plan.policy.alphabet.m)]
    for readings, labels, statuses in zip(sequence.readings, sequence.labels, sequence.statuses):
        unit.reset()
        for k, (row, *expected) in enumerate(zip(readings.tolist(), labels, statuses)):
            unit.setReal(references, row)
            if k % 50 == 49:  # a state that is kept is that of the policy, times and all
                kept = unit.getFMUState()
                unit.setReal(references, [0.0] * plan.n)
                unit.doStep(k * period, 1e9)
                unit.doStep(1e9, 1.0)
                unit.setFMUState(kept)
                unit.freeFMUState(kept)
            unit.doStep(k * period, period)
            assert unit.getInteger([0, 1]) == expected
            assert unit.getReal(outputs) == plan.policy.controls[expected[0]].tolist()


def test_each_time_is_a_parameter(run, tmp_path):
    policy = dataclasses.replace(random_rows(), time_unit="min")
    path = export(policy, "fmu", tmp_path, hold_off=0.5)[0]
    assert validate_fmu(path) == []
    about = fmpy.read_model_description(path)
    found = {v.name: float(v.start) for v in about.modelVariables if v.causality == "parameter"}
    assert found == {
        "hold_heat": 30.0,
        "hold_x": 6.0,
        "hold_default": 12.0,
        "hold_heater": 18.0,
        "hold_cooler": 45.0,
        "hold_off": 30.0,
    }
    texts = {v.name: v.description for v in about.modelVariables}
    assert texts["hold_heat"] == "How long symbol 2 (heat) is held once it is entered"
    assert texts["hold_cooler"] == "How long input cooler is held once it has changed"
    # other times, by parameters, are those of a policy that has them
    hold = {"heater": 0.1, "cooler": 0.2, "heat": 0.3, "x": 0.4, "default": 0.2}
    other = dataclasses.replace(
        random_rows(), switching=dataclasses.replace(policy.switching, hold=hold)
    )
    sequence = golden_sequence(Plan.of(other))
    times = [0.3, 0.4, 0.2, 0.1, 0.2]
    unit = run(random_rows(), parameters=dict(zip(range(4, 9), times)))
    for k, (row, label) in enumerate(zip(sequence.readings[0].tolist(), sequence.labels[0])):
        unit.setReal([0, 1], row)
        unit.doStep(k * sequence.period, sequence.period)
        assert unit.getInteger([0]) == [label]
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.setReal([9], [1.0])
    one = export(policy, "fmu", tmp_path / "one", dwell=0.25, name="one")[0]
    names = {v.name: v.start for v in fmpy.read_model_description(one).modelVariables}
    assert names["min_dwell"] == "15.0" and not any(name.startswith("hold") for name in names)


def quoted():
    return dataclasses.replace(small(), name='a "<b>" & */ c')


@pytest.mark.parametrize("make", [small, oblique, quoted])
def test_units_are_valid_and_the_same_bytes(make, tmp_path):
    policy = make()
    path = export(policy, "fmu", tmp_path / "a")[0]
    assert validate_fmu(path) == []
    again = export(policy, "fmu", tmp_path / "b" / "c")[0]
    assert path.read_bytes() == again.read_bytes() and path.name == again.name
    other = export(policy, "fmu", tmp_path / "d", safe=1)[0]
    guids = [fmpy.read_model_description(p).guid for p in (path, again, other)]
    assert guids[0] == guids[1] != guids[2]
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        library = archive.read(next(name for name in names if name.startswith("binaries/")))
    stem = path.stem
    expected = ["modelDescription.xml", f"sources/{stem}.c", f"binaries/linux64/{stem}.so"]
    assert names == expected and b"/tmp" not in library


def test_variables_say_what_they_are(tmp_path):
    policy = dataclasses.replace(
        small(),
        domain=dataclasses.replace(small().domain, names=["symbol", "Größe"], units=["m/s", ""]),
        alphabet=Alphabet([-1, 1], names=["zu", "auf"], inputs=["symbol"], units=["N"]),
        min_dwell=0.5,
    )
    about = fmpy.read_model_description(export(policy, "fmu", tmp_path)[0])
    found = {v.name: (v.causality, v.unit, v.start) for v in about.modelVariables}
    assert found == {
        "symbol_2": ("input", "m/s", "0"),
        "Groe": ("input", None, "0"),
        "symbol_3": ("output", "N", None),
        "symbol": ("output", None, None),
        "status": ("output", None, None),
        "min_dwell": ("parameter", "s", "0.5"),
    }
    texts = {v.name: v.description for v in about.modelVariables}
    assert texts["Groe"] == "State Größe" and texts["symbol"] == "Symbol; 0: zu, 1: auf, 2: default"
    path = export(policy, "fmu", tmp_path, scale=2)[0]
    (first, *_) = fmpy.read_model_description(path).modelVariables
    assert first.unit is None and first.description.endswith("[m/s] is reading * 2.0 + 0.0")


@pytest.mark.parametrize(("unit", "seconds", "factor"), [("min", 30.0, 1 / 60), ("ms", 5e-4, 1e3)])
def test_dwell_times_are_in_seconds_and_displayed_in_the_unit(unit, seconds, factor, tmp_path):
    policy = dataclasses.replace(small(), min_dwell=0.5, time_unit=unit)
    path = export(policy, "fmu", tmp_path)[0]
    assert validate_fmu(path) == []
    about = fmpy.read_model_description(path)
    (dwell,) = (v for v in about.modelVariables if v.name == "min_dwell")
    assert (dwell.unit, dwell.displayUnit, float(dwell.start)) == ("s", unit, seconds)
    (second,) = (u for u in about.unitDefinitions if u.name == "s")
    (shown,) = second.displayUnits
    assert second.baseUnit.s == 1 and (shown.name, float(shown.factor)) == (unit, factor)
    assert float(shown.factor) * seconds == pytest.approx(0.5, rel=1e-15)


@pytest.mark.parametrize("dwell", [0.0, 0.05, 0.1])
def test_steps_hold_as_simulations_do(dwell, run):
    policy = built_in("cart-pendulum")
    loop = simulate(policy, x0=[0.5, 0.3], duration=4.0, rate=100.0, min_dwell=dwell)
    by_policy = run(policy, dwell=dwell)
    by_parameter = run(policy, parameters={3: dwell})
    for unit in (by_policy, by_parameter):
        for k, (state, symbol) in enumerate(zip(loop.states[:-1].tolist(), loop.symbols.tolist())):
            unit.setReal([0, 1], state)
            unit.doStep(k / 100, 0.01)
            assert unit.getInteger([0])[0] % 3 == symbol % 3
            assert unit.getReal([2]) == policy.controls[symbol].tolist()


def test_fmpy_simulates(tmp_path):
    policy = built_in("cart-pendulum")
    loop = simulate(policy, x0=[0.5, 0.3], duration=2.0, rate=100.0)
    path = export(policy, "fmu", tmp_path)[0]
    names = [*policy.domain.names]
    times = np.arange(len(loop.states)) / 100
    rows = [(t, *state) for t, state in zip(times.tolist(), loop.states.tolist())]
    signal = np.array(rows, dtype=[(name, float) for name in ["time", *names]])
    found = fmpy.simulate_fmu(
        path, input=signal, stop_time=2.0, output_interval=0.01, output=["symbol", "acceleration"]
    )
    # the outputs at a time are those of the step before it
    agree = found["symbol"][1 : len(loop.symbols) + 1] == loop.symbols % 3
    assert agree.mean() > 0.99  # FMPy interpolates inputs


def test_states_of_units_can_be_kept_and_units_reset(run):
    policy = dataclasses.replace(built_in("cart-pendulum"), min_dwell=10.0)
    one, other = ([3.0, 1.0], [3.0, -4.0])
    assert len({int(policy(x)) for x in (one, other)}) == 2
    unit = run(policy)
    unit.setReal([0, 1], one)
    unit.doStep(0.0, 1.0)
    (first,) = unit.getInteger([0])
    kept = unit.getFMUState()
    data = unit.serializeFMUState(kept)
    unit.setReal([0, 1], other)
    unit.doStep(1.0, 1.0)
    assert unit.getInteger([0]) == [first] and unit.getReal([0, 1]) == other  # held
    unit.doStep(10.0, 1.0)
    assert unit.getInteger([0]) != [first]
    unit.setFMUState(kept)
    assert unit.getInteger([0]) == [first] and unit.getReal([0, 1]) == one
    unit.freeFMUState(kept)
    kept = unit.deSerializeFMUstate(data)
    unit.doStep(20.0, 1.0)
    unit.setFMUState(kept)
    assert unit.getReal([0, 1]) == one
    unit.freeFMUState(kept)
    unit.reset()
    unit.setReal([0, 1], other)
    assert unit.getInteger([0]) != [first]


def test_wrong_calls_are_refused(run):
    unit = run(small())
    for call in (
        lambda: unit.getReal([99]),
        lambda: unit.setReal([2], [1.0]),  # an output
        lambda: unit.setReal([3], [-1.0]),  # a dwell time below 0
        lambda: unit.getInteger([2]),
        lambda: unit.getBoolean([0]),
        lambda: unit.getDirectionalDerivative([2], [0], [1.0]),
    ):
        with pytest.raises(fmpy.fmi1.FMICallException):
            call()


def test_without_a_compiler_there_are_sources_and_that_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.warns(CapsynWarning, match="the FMU has no binary, only sources: .*no-such"):
        path = export(small(), "fmu", tmp_path)[0]
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == ["modelDescription.xml", f"sources/{path.stem}.c"]
        description = ElementTree.fromstring(archive.read("modelDescription.xml"))
    assert description.find(".//SourceFiles/File").get("name") == f"{path.stem}.c"


def test_zig_builds_where_there_is_no_compiler(run, monkeypatch):
    pytest.importorskip("ziglang")
    policy = built_in("cart-pendulum")
    monkeypatch.setenv("CC", "no-such-compiler")
    assert_equal(functools.partial(run, platforms="linux64"), policy)


def test_a_failing_compiler_leaves_what_was_there(tmp_path, monkeypatch):
    script = tmp_path / "cc"
    script.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && echo cc 1 && exit\necho broken >&2; exit 1'
    )
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    with pytest.raises(KernelBuildError, match="failed on the source of the FMU: broken"):
        export(small(), "fmu", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def built(path, compiler, directory):
    """Return the library of a unit's source, built as importers may, without a warning."""
    if not shutil.which(compiler):
        pytest.skip(f"needs {compiler}")
    with zipfile.ZipFile(path) as archive:
        (source,) = (name for name in archive.namelist() if name.startswith("sources/"))
        (directory / "unit.c").write_bytes(archive.read(source))
    flags = ["-std=gnu11", "-O2", "-march=native", "-ffp-contract=fast", "-Wall", "-Wextra"]
    more = ["-Wpedantic", "-Wconversion", "-Werror", "-fPIC", "-shared", "-lm"]
    for library, prefix in (("unit.so", []), ("prefixed.so", ["-DFMI2_FUNCTION_PREFIX=a_"])):
        command = [compiler, *flags, *prefix, "unit.c", *more, "-o", library]
        subprocess.run(command, cwd=directory, check=True)
    return directory / "unit.so"


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("name", ["rows", "prices", "times"])
def test_sources_that_remember_have_no_warnings(name, compiler, tmp_path):
    path = export(POLICIES[name](), "fmu", tmp_path, sources_only=True)[0]
    built(path, compiler, tmp_path)


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_sources_work_whatever_the_flags(compiler, tmp_path, run):
    policy = built_in("cart-pole")
    options = {"scale": [0.1, 0.3, 0.7, 1.1], "offset": [0.1, 0.2, 0.3, 0.4]}
    path = export(policy, "fmu", tmp_path, sources_only=True, **options)[0]
    library = built(path, compiler, tmp_path)
    assert hasattr(ctypes.CDLL(str(tmp_path / "prefixed.so")), "a_fmi2DoStep")
    assert_equal(functools.partial(run, library=library), policy, **options)


def test_command_line(tmp_path):
    small().save(tmp_path / "p.cap")
    out, _ = capsyn(
        "export", tmp_path / "p.cap", "--to", "fmu", "-o", tmp_path / "a",
        "--option", "sources-only=yes", "--name", "valve 1",
    )  # fmt: skip
    assert f"wrote {tmp_path / 'a' / 'valve_1.fmu'}" in out
