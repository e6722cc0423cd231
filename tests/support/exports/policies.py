"""Policies to export, and what runs their exports."""

import bisect
import functools
import importlib.util
import json
import math
import shutil
import subprocess

import numpy as np
import pytest

from capsyn import Box, compress, problems, subdivide, synthesize
from capsyn.exports.export import export
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import Plan
from support.trees import random_policy

PROBLEMS = ("cart-pendulum", "cart-pendulum-4", "double-tank-a", "double-tank-b", "cart-pole")
NODE = shutil.which("node")
RUN = """
import { readFileSync } from "node:fs";
const [file, ...vectors] = process.argv.slice(2);
const made = await import(file);
const special = { nan: NaN, inf: Infinity, "-inf": -Infinity };
const found = JSON.parse(readFileSync(vectors[0], "utf8"))
  .map(row => made.decide(row.map(v => v in special ? special[v] : Number(v))));
console.log(JSON.stringify(found));
"""


@functools.cache
def built_in(name):
    return synthesize(problems.get(name))


@functools.cache
def oblique():
    box = Box([0, -1], [6.5, 1], periodic=[True, False])
    policy = subdivide(lambda x: (x[:, 1] > 0.3 * x[:, 0] - 0.9).astype(int), box, 2, max_level=4)
    return compress(policy, "linear", agreement=0.9, states=5000)


@functools.cache
def small():
    return random_policy(3, periodic=True)


def made_by(policy, to, directory, **options):
    """Return the first file of an export."""
    return export(policy, to, directory, **options)[0]


def module(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def by_python(policy, directory, readings, **options):
    made = module(made_by(policy, "python", directory, **options))
    return [made.decide(row) for row in readings.tolist()]


def by_javascript(policy, directory, readings, **options):
    if not NODE:
        pytest.skip("needs node: apt-get install nodejs")
    path = made_by(policy, "javascript", directory, **options)
    (directory / "run.mjs").write_text(RUN)
    rows = [[repr(v) for v in row] for row in readings.tolist()]
    (directory / "vectors.json").write_text(json.dumps(rows))
    command = [NODE, directory / "run.mjs", path, directory / "vectors.json"]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def by_json(policy, directory, readings, **options):
    data = json.loads(made_by(policy, "json", directory, **options).read_text())
    return [read(data, row) for row in readings.tolist()]


def read(data, reading):
    """Return (symbol, status) as the texts of a JSON file say."""
    axes, tree = data["states"], data["tree"]
    x = [v * axis["scale"] + axis["offset"] for v, axis in zip(reading, axes)]
    if not all(map(math.isfinite, x)):
        return data["outside"]["safe"], 2
    status, z = 0, []
    for v, axis in zip(x, axes):
        low, high, steps = axis["lower"], axis["upper"], axis["steps"]
        if not axis["periodic"] and not low <= v <= high:
            status = 1
        if axis["periodic"] and not low <= v < high:
            r = math.fmod(v - low, high - low)
            r = low + (r + (high - low) if r < 0 else r)
            v = low if r >= high else r
        v = min(max(v, low), high)
        after = bisect.bisect_right(range(steps), v, key=lambda k: low + (high - low) * (k / steps))  # noqa: B023
        z.append(max(after - 1, 0))
    if status == 1 and data["outside"]["rule"] != "nearest":
        return data["outside"]["safe"], 1
    z += ranks(tree["features"], z) if "features" in tree else []
    i = 0
    while tree["split"][i] != -1:
        s = tree["split"][i]
        plane = None if s < len(z) else tree["planes"][s - len(z)]
        v = z[s] if plane is None else sum(a * b for a, b in zip(plane, z))
        i = tree["second"][i] if v >= tree["threshold"][i] else i + 1
    if tree["threshold"][i] == data["outside"].get("gap"):
        return data["outside"]["safe"], 1
    return tree["threshold"][i], status


def ranks(features, z):
    """Return the ranks of features at lattice steps, for the operations of `support.features`."""
    operations = {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "cos": math.cos,
    }
    values = list(map(float, z))
    for name, *operands in features["program"]["instructions"]:
        if name == "const":
            values.append(operands[0])
        else:
            values.append(operations[name](*(values[k] for k in operands)))
    found = [values[k] for k in features["program"]["results"]]
    return [sum(v >= t for t in row) for v, row in zip(found, features["thresholds"])]


RUNNERS = {"python": by_python, "javascript": by_javascript, "json": by_json}


def assert_equal(to, policy, directory, **options):
    """Compare an export with all golden vectors, and with states many turns away."""
    plan = Plan.of(policy, **options)
    golden = golden_vectors(plan)
    rng = np.random.default_rng(1)
    far = rng.normal(size=(60, plan.n)) * 10.0 ** rng.integers(0, 300, size=(60, 1))
    readings = np.concatenate([golden.readings, far])
    expected = decide(plan, readings)
    found = np.array(RUNNERS[to](policy, directory, readings, **options))
    np.testing.assert_array_equal(found[:, 1], expected.statuses)
    np.testing.assert_array_equal(found[:, 0], expected.labels)
