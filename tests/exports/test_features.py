"""Exports of trees with features: every target gives the policy's symbols, or refuses."""

import dataclasses
import json
import math
import re
import shutil

import numpy as np
import pytest

from capsyn.cells.feature_tree import FeatureTree
from capsyn.cells.split_tree import LEAF, depth_first
from capsyn.errors import ProblemError
from capsyn.exports.c.styles import stream as c_stream
from capsyn.exports.export import all_targets, export
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.policy_json import target as policy_json
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree
from capsyn.policies.report import report
from support.exports.c_machines import WARNINGS, Library, need
from support.exports.c_plans import assert_golden, files, made
from support.exports.policies import RUNNERS, assert_equal, made_by
from support.features import all_steps, exact, pendulum


@pytest.mark.parametrize("to", RUNNERS)
def test_languages(to, tmp_path):
    assert_equal(to, exact(), tmp_path)


@pytest.mark.parametrize("style", ["table", "nested", "grid"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_c(style, compiler, tmp_path):
    need(compiler)
    plan = Plan.of(exact())
    golden = golden_vectors(plan)
    written = files(plan, golden, style=style)
    library = Library(written, tmp_path, plan.n, compiler, [*WARNINGS, "-O2"])
    assert_golden(library, golden, True)
    source = written["cart_pendulum.c"].decode()
    assert ("#include <math.h>" in source) == (style != "grid")
    assert ("PUBLIC m)" in written["CMakeLists.txt"].decode()) == (style != "grid")
    assert max(map(len, source.splitlines())) <= 110


@pytest.mark.parametrize("options", [["-O3", "-march=native", "-ffp-contract=fast"], ["-O0"]])
def test_contracted_products_change_no_symbol(options, tmp_path):
    """Thresholds keep a distance from all values on the lattice."""
    plan = Plan.of(exact())
    library = Library(files(plan, None), tmp_path, plan.n, "gcc", options)
    steps = np.stack(np.indices(plan.tree.cells.counts), axis=-1).reshape(-1, 2)
    labels = pendulum().cells.labels(steps)
    np.testing.assert_array_equal(library.look(steps), labels)


def test_steps_beyond_the_lattice_are_the_nearest(tmp_path):
    plan = Plan.of(exact())
    library = Library(files(plan, None), tmp_path, plan.n, "gcc")
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
    assert data["version"] == 2 and data["tree"]["features"]["margin"] > 1e-9
    assert json.loads(made_by(pendulum(), "json", tmp_path).read_text())["version"] == 2


@pytest.mark.parametrize("to", RUNNERS)
def test_odd_names_break_no_file(to, tmp_path):
    odd = "\\ \"'`${x} */ // [ 1 ] \u2603 \\"
    features = dataclasses.replace(exact().cells.features, names=(odd, "*/"))
    tree = dataclasses.replace(exact(), cells=dataclasses.replace(exact().cells, features=features))
    assert_equal(to, tree, tmp_path)
    if to == "python":
        Library(files(Plan.of(tree), None), tmp_path, 2, "gcc")
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


@pytest.mark.parametrize("to", ["structured-text", "verilog", "dot"])
def test_targets_that_take_no_features(to, tmp_path):
    assert to not in all_targets(exact())
    with pytest.raises(ProblemError, match=f"^target {to} takes no tree with features; .*: c, "):
        export(exact(), to, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arithmetic", ["double", "float"])
def test_c_decides_features_on_lattice_steps(arithmetic, tmp_path):
    with pytest.raises(ProblemError, match="^`arithmetic` must be lattice for a tree with feat"):
        export(exact(), "c", tmp_path, arithmetic=arithmetic)


def test_decisions_by_features_are_not_timed(tmp_path):
    with pytest.raises(
        ProblemError, match="^`cycles` must be false for a tree with features, .*; got true$"
    ):
        export(exact(), "c", tmp_path, cycles=True)


def test_readings_may_be_counts(tmp_path):
    need("gcc")
    scale = [2 * math.pi / 4096, 10 / 4096]
    export(exact(), "c", tmp_path, readings="int16", scale=scale, offset=[0, 0])
    assert shutil.which("gcc") and "typedef int16_t" in (tmp_path / "cart_pendulum.h").read_text()


RANKS = 8
"""Ranks of each of the two features of `shaped`."""


def thresholds(values):
    """Return thresholds far from all values: in the widest gaps near their quantiles."""
    values = np.unique(values)
    places = np.arange(1, RANKS) * len(values) // RANKS
    gaps = [k - 20 + int(np.argmax(np.diff(values[k - 20 : k + 20]))) for k in places]
    return (values[gaps] + values[np.array(gaps) + 1]) / 2


def shaped(form):
    """Return a tree that is its own reflection on a state and a rank, or has a subtree twice."""
    source, features = pendulum(), exact().cells.features
    counts, rng = source.cells.counts, np.random.default_rng(1)
    values = features.values(all_steps(counts))
    features = dataclasses.replace(features, thresholds=tuple(map(thresholds, values)))
    lattice, nodes = (*counts, RANKS, RANKS), []

    def node(split, threshold, *children):
        nodes.append((split, threshold, list(children)))
        return len(nodes) - 1

    def random(lower, upper, depth=0):
        axis = (1, 2, 3)[depth % 3]
        if depth == 6 or upper[axis] - lower[axis] < 2:
            return node(LEAF, int(rng.integers(2)))
        cut = int(rng.integers(lower[axis] + 1, upper[axis]))
        below, above = list(upper), list(lower)
        below[axis] = above[axis] = cut
        return node(axis, cut, random(lower, below, depth + 1), random(above, upper, depth + 1))

    def reflected(i):
        split, threshold, children = nodes[i]
        children = [reflected(child) for child in children]
        if split in (1, 2):
            return node(split, lattice[split] - threshold, *children[::-1])
        return node(split, threshold, *children)

    if form == "mirrors":
        part = random([0] * 4, (*counts, RANKS // 2, RANKS))
        root = node(2, RANKS // 2, part, reflected(part))
    else:
        part = random([0] * 4, lattice)
        root = node(0, counts[0] // 4, part, node(0, counts[0] // 3, node(LEAF, 2), part))
    cells = FeatureTree.of(counts, depth_first(lattice, root, nodes.__getitem__), features)
    cells.check(3)
    return DecisionTree.of(source, cells, Guarantee("exact", "0" * 64))


@pytest.mark.parametrize("form", ["mirrors", "references"])
def test_special_tables(form, tmp_path, monkeypatch):
    """What a table leaves out of the tree of steps and ranks, targets find again."""
    for name in ("MIRRORED_AXIS", "TURNED_LABELS", "REFERRING"):
        monkeypatch.setattr(c_stream, name, 0)
    policy = shaped(form)
    plan = Plan.of(policy)
    golden, steps = golden_vectors(plan), all_steps(plan.counts)
    written = made(plan, golden)
    if form == "mirrors":
        assert [1, 2] in written.written["mirrors"]
    else:
        assert written.written["references"] > 0
    library = Library(written.files, tmp_path, plan.n, "gcc")
    assert_golden(library, golden, True)
    np.testing.assert_array_equal(library.look(steps), policy.cells.labels(steps))
    assert set(all_targets(policy)) == {"c", "fmu", "python", "javascript", "json"}
    for to in RUNNERS:
        assert_equal(to, policy, tmp_path)
