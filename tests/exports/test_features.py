"""Exports of trees with features: every target gives the policy's symbols, or refuses."""

import dataclasses
import json
import math
import re
import shutil

import numpy as np
import pytest

from capsyn.errors import ProblemError
from capsyn.exports.c.target import TARGET as c
from capsyn.exports.export import all_targets, export
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.policy_json import target as policy_json
from capsyn.policies.report import report
from support.exports.c_machines import WARNINGS, Library, need
from support.exports.c_plans import assert_golden
from support.exports.policies import RUNNERS, assert_equal, made_by
from support.features import exact, pendulum


@pytest.mark.parametrize("to", RUNNERS)
def test_languages(to, tmp_path):
    assert_equal(to, exact(), tmp_path)


@pytest.mark.parametrize("style", ["table", "nested", "grid"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_c(style, compiler, tmp_path):
    need(compiler)
    plan = Plan.of(exact())
    golden = golden_vectors(plan)
    files = c.files(plan, golden, style=style).files
    options = [*WARNINGS, "-O2"]
    library = Library(files, tmp_path, plan.n, compiler, options)
    assert_golden(library, golden, True)
    source = files["cart_pendulum.c"].decode()
    assert ("#include <math.h>" in source) == (style != "grid")
    assert ("PUBLIC m)" in files["CMakeLists.txt"].decode()) == (style != "grid")
    assert max(map(len, source.splitlines())) <= 110


@pytest.mark.parametrize("options", [["-O3", "-march=native", "-ffp-contract=fast"], ["-O0"]])
def test_contracted_products_change_no_symbol(options, tmp_path):
    """Thresholds keep a distance from all values on the lattice."""
    plan = Plan.of(exact())
    golden = golden_vectors(plan)
    library = Library(c.files(plan, golden).files, tmp_path, plan.n, "gcc", options)
    steps = np.stack(np.indices(plan.tree.cells.counts), axis=-1).reshape(-1, 2)
    labels = pendulum().cells.labels(steps)
    np.testing.assert_array_equal(library.look(steps), labels)


def test_steps_beyond_the_lattice_are_the_nearest(tmp_path):
    plan = Plan.of(exact())
    library = Library(c.files(plan, golden_vectors(plan)).files, tmp_path, plan.n, "gcc")
    counts = np.array(plan.tree.cells.counts)
    steps = np.array([[-3, 5], [10, 2000], [300, -1], [70, 70]])
    np.testing.assert_array_equal(
        library.look(steps), plan.tree.cells.labels(np.clip(steps, 0, counts - 1))
    )


def test_json_follows_its_schema(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    path = made_by(exact(), "json", tmp_path)
    data, schema = (json.loads(p.read_text()) for p in (path, tmp_path / policy_json.SCHEMA))
    validator = jsonschema.Draft202012Validator(schema)
    validator.validate(data)
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(data | {"version": 1})
    assert data["version"] == 3 and data["tree"]["features"]["margin"] > 1e-9
    assert json.loads(made_by(pendulum(), "json", tmp_path).read_text())["version"] == 1


@pytest.mark.parametrize("to", RUNNERS)
def test_odd_names_break_no_file(to, tmp_path):
    odd = "\\ \"'`${x} */ // [ 1 ] \u2603 \\"
    features = dataclasses.replace(exact().cells.features, names=(odd, "*/"))
    tree = dataclasses.replace(exact(), cells=dataclasses.replace(exact().cells, features=features))
    assert_equal(to, tree, tmp_path)
    if to == "python":
        files = c.files(Plan.of(tree), golden_vectors(Plan.of(tree))).files
        Library(files, tmp_path, 2, "gcc")
        export(tree, "fmu", tmp_path)


def test_the_certificate_tells_the_features(tmp_path):
    for policy in (exact(), pendulum()):
        export(policy, "python", tmp_path)
        certificate = json.loads((tmp_path / "certificate.json").read_text())
        assert certificate.get("features") == report(exact())["features"] or policy is pendulum()
    assert "features" not in certificate


def test_the_header_tells_the_features(tmp_path):
    text = made_by(exact(), "c", tmp_path).read_text()
    assert "Features: energy, cos(theta) * omega\n" in text
    note = re.sub(r"\n \*\s+", " ", text)
    assert re.search(r"by \d+ operations in double precision\. On the lattice none comes", note)


def test_flash_counts_the_mathematical_library(tmp_path):
    need("arm-none-eabi-gcc")
    export(exact(), "c", tmp_path)
    measured = json.loads((tmp_path / "measured.json").read_text())
    if "cortex-m0" not in measured:
        pytest.skip("needs math.h for the Cortex-M0: apt-get install libnewlib-arm-none-eabi")
    sizes = measured["cortex-m0"]
    assert sizes["decision"] < 1000 and sizes["with_library"] > sizes["decision"] + 5000


def test_a_processor_without_doubles_is_refused(tmp_path):
    path = made_by(exact(), "c", tmp_path)
    assert '#error "double precision is needed' in path.read_text()


@pytest.mark.parametrize("to", ["verilog", "dot"])
def test_targets_that_take_no_features(to, tmp_path):
    assert to not in all_targets(exact())
    with pytest.raises(ProblemError, match=f"^target {to} takes no tree with features; .*: c, "):
        export(exact(), to, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arithmetic", ["double", "float"])
def test_c_decides_features_on_lattice_steps(arithmetic, tmp_path):
    with pytest.raises(ProblemError, match="^`arithmetic` must be lattice for a tree with feat"):
        export(exact(), "c", tmp_path, arithmetic=arithmetic)


def test_readings_may_be_counts(tmp_path):
    need("gcc")
    scale = [2 * math.pi / 4096, 10 / 4096]
    export(exact(), "c", tmp_path, readings="int16", scale=scale, offset=[0, 0])
    assert shutil.which("gcc") and "int16_t x[2]" in (tmp_path / "cart_pendulum.h").read_text()
