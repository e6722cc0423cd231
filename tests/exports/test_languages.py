"""Exports in Python, JavaScript, JSON and for Graphviz."""

import ast
import dataclasses
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

from capsyn import Alphabet, compress, simulate
from capsyn.exports.plan import Plan
from capsyn.exports.policy_json import target as policy_json
from support.exports.policies import (
    NODE,
    PROBLEMS,
    RUNNERS,
    assert_equal,
    built_in,
    made_by,
    module,
    oblique,
    small,
)
from support.trees import random_policy

OFTEN = [to for to in RUNNERS if to != "micropython"]
"""What runs most exports: MicroPython, which starts slowly, runs the modules of Python."""


@pytest.mark.parametrize(
    ("name", "to"),
    [*((name, to) for name in PROBLEMS for to in OFTEN), ("cart-pole", "micropython")],
)
def test_built_in_problems(name, to, tmp_path):
    assert_equal(to, built_in(name), tmp_path)


@pytest.mark.parametrize(
    ("outside", "to"),
    [*((rule, to) for rule in ("error", "nearest", 1) for to in OFTEN), ("nearest", "micropython")],
)
def test_rules_outside(to, outside, tmp_path):
    policy = dataclasses.replace(small(), outside=outside)
    assert_equal(to, policy, tmp_path)
    assert_equal(to, policy, tmp_path, safe=0)


@pytest.mark.parametrize("to", RUNNERS)
def test_trees_with_and_without_oblique_splits(to, tmp_path):
    assert len(oblique().cells.planes) > 0
    assert_equal(to, oblique(), tmp_path)
    assert_equal(to, compress(small()), tmp_path)


@pytest.mark.parametrize(
    ("grid", "to"), [*((grid, to) for grid in (0, 6, 7) for to in OFTEN), (7, "micropython")]
)
def test_one_to_four_states(to, grid, tmp_path):
    assert_equal(to, random_policy(grid, periodic=True), tmp_path)


@pytest.mark.parametrize("to", RUNNERS)
def test_readings(to, tmp_path):
    policy = dataclasses.replace(small(), outside="nearest")
    assert_equal(to, policy, tmp_path, scale=[-0.0375, 2e-5], offset=[100, 1e3])
    assert_equal(to, policy, tmp_path, scale=1e300, offset=0.1)  # overflows: not finite


def test_python_modules_need_nothing(tmp_path):
    text = made_by(oblique(), "python", tmp_path).read_text()
    tree = ast.parse(text, feature_version=(3, 8))
    names = [a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names]
    assert names == ["math"] and "from " not in text.split('"""')[0].replace("# ", "")
    assert max(map(len, text.splitlines())) <= 200
    (path,) = (p for p in tmp_path.iterdir() if p.suffix == ".py")
    code = f"import {path.stem} as m; print(m.control([0.0, 0.0]), m.SYMBOLS)"
    run = subprocess.run([sys.executable, "-S", "-c", code], cwd=tmp_path, capture_output=True)
    assert run.returncode == 0, run.stderr


def test_python_modules_may_be_called_like_an_encoding(tmp_path):
    policy = dataclasses.replace(small(), name="coding: gray")
    assert module(made_by(policy, "python", tmp_path)).STATES == policy.domain.names


def test_python_module_names_hide_nothing(tmp_path):
    for name, expected in (("math", "math_2.py"), ("class", "class_2.py"), ("x-y", "x_y.py")):
        assert made_by(small(), "python", tmp_path, name=name).name == expected


@pytest.mark.parametrize("dwell", [0.0, 0.05, 0.1])
def test_controllers_hold_as_simulations_do(dwell, tmp_path):
    policy = built_in("cart-pendulum")
    run = simulate(policy, x0=[0.5, 0.3], duration=4.0, rate=100.0, min_dwell=dwell)
    made = module(made_by(policy, "python", tmp_path, dwell=dwell))
    controller = made.Controller()
    assert controller.control() == tuple(policy.default)
    states, times = run.states[:-1].tolist(), [k / 100 for k in range(len(run.symbols))]
    found = [controller.step(x, t)[0] % 3 for x, t in zip(states, times)]
    np.testing.assert_array_equal(found, run.symbols % 3)
    assert controller.control() == tuple(policy.controls[found[-1]])
    if not NODE:
        pytest.skip("needs node: apt-get install nodejs")
    path = made_by(policy, "javascript", tmp_path, dwell=dwell)
    code = (
        f"const m = await import({json.dumps(str(path))}); const c = new m.Controller();"
        f"const x = {json.dumps(states)}, t = {json.dumps(times)};"
        "console.log(JSON.stringify(x.map((v, k) => c.step(v, t[k])[0])));"
    )
    (tmp_path / "dwell.mjs").write_text(code)
    out = subprocess.run([NODE, tmp_path / "dwell.mjs"], capture_output=True, text=True, check=True)
    assert json.loads(out.stdout) == found


def in_days():
    return dataclasses.replace(small(), time_unit="d", outside_at_once=True)


@pytest.mark.parametrize("policy", [small, oblique, in_days, lambda: built_in("cart-pole")])
def test_json_follows_its_schema(policy, tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    path = made_by(policy(), "json", tmp_path)
    data, schema = (json.loads(p.read_text()) for p in (path, tmp_path / policy_json.SCHEMA))
    validator = jsonschema.Draft202012Validator
    validator.check_schema(schema)
    validator(schema).validate(data)
    assert data["$schema"] == policy_json.SCHEMA
    assert (
        list(map(len, (data["tree"]["split"], data["tree"]["second"])))
        == [data["tree"]["nodes"]] * 2
    )
    assert ("time_unit" in data) == (policy is in_days)
    wrongs = [{"version": 1}, {"sha256": "x"}, {"min_dwell": -1}, {"more": 1}, {"symbols": []}]
    for wrong in (*wrongs, {"time_unit": "m"}, {"at_once": [0]}):
        with pytest.raises(jsonschema.ValidationError):
            validator(schema).validate(data | wrong)


def test_json_keeps_texts_as_they_are(tmp_path):
    domain = dataclasses.replace(small().domain, names=["[ 1 ]", "[\t2, 3 ]".replace("\t", "  ")])
    data = policy_json.document(Plan.of(dataclasses.replace(small(), domain=domain)))
    path = made_by(dataclasses.replace(small(), domain=domain), "json", tmp_path)
    assert json.loads(path.read_text()) == data
    assert [state["name"] for state in data["states"]] == list(domain.names)


@pytest.mark.parametrize("policy", [small, lambda: built_in("double-tank-a")])
def test_graphviz_draws_the_automaton(policy, tmp_path):
    path = made_by(policy(), "dot", tmp_path)
    assert "digraph" in path.read_text()
    if not shutil.which("dot"):
        pytest.skip("needs dot: apt-get install graphviz")
    run = subprocess.run(["dot", "-Tsvg", path], capture_output=True, text=True)
    assert run.returncode == 0 and run.stdout.count('class="node"') == len(
        {int(label) for label in np.unique(Plan.of(policy()).tree.cells.boxes().labels)}
    )


def test_odd_names_break_no_file(tmp_path):
    odd = "\\ \"'`${x} */ // [ 1 ] ☃ \\"
    policy = dataclasses.replace(
        small(),
        name=odd,
        domain=dataclasses.replace(small().domain, names=[odd, "x"], units=[odd, "\\"]),
        alphabet=Alphabet([-1, 1], names=[odd, "b"], inputs=[odd], units=[odd]),
    )
    for to in RUNNERS:
        assert_equal(to, policy, tmp_path)
    made = module(made_by(policy, "python", tmp_path))
    assert made.STATES == (odd, "x") and made.SYMBOLS == (odd, "b", "default")
    path = made_by(policy, "dot", tmp_path)
    assert path.name == "x_1.dot"
    if shutil.which("dot"):
        subprocess.run(["dot", "-Tsvg", path], check=True, capture_output=True)
