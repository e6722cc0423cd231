"""Policies to export, and what runs their exports."""

import bisect
import dataclasses
import functools
import importlib.util
import json
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from capsyn import Alphabet, Box, compress, problems, subdivide, synthesize
from capsyn.cells.split_tree import SplitTree
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
  .map(row => row.map(v => v in special ? special[v] : Number(v)))
  .map(x => [...made.decide(x), made.control(x)]);
console.log(JSON.stringify(found));
"""
MICROPYTHON = Path(__file__).parents[3] / "node_modules" / "@micropython"
RUN_MICROPYTHON = """
import { readFileSync } from "node:fs";
const [interpreter, file, vectors] = process.argv.slice(2);
const { loadMicroPython } = await import(interpreter);
const python = await loadMicroPython({ heapsize: 32 << 20, stdout: line => console.log(line) });
python.FS.writeFile("/made.py", readFileSync(file));
python.FS.writeFile("/vectors.json", readFileSync(vectors));
python.runPython(`
import json, sys
sys.path.append("/")
import made
rows = [[float(v) for v in row] for row in json.load(open("/vectors.json"))]
print(json.dumps([made.decide(x) + (made.control(x),) for x in rows]))
`);
"""


@functools.cache
def built_in(name):
    return synthesize(problems.plain(name))


@functools.cache
def oblique():
    box = Box([0, -1], [6.5, 1], periodic=[True, False])
    policy = subdivide(lambda x: (x[:, 1] > 0.3 * x[:, 0] - 0.9).astype(int), box, 2, max_level=4)
    return compress(policy, "linear", agreement=0.9, states=5000)


@functools.cache
def mixed(gaps=False):
    """Return a tree of a face, planes and a periodic axis; its last symbol is like the default."""
    split = np.array([2, 0, -1, -1, 1, 3, -1, -1, -1])
    threshold = np.array([1, 3, 0, 1, 5, -9, 2, 1, 3])
    second = np.array([4, 3, 2, 3, 8, 7, 6, 7, 8])
    planes = np.array([[2, -3], [-1, 0]])
    arrays = (a.astype(np.int32) for a in (split, threshold, second, planes))
    cells = SplitTree((16, 8), *arrays)
    box = Box([0, -1], [6.5, 1], ["angle", "rate"], ["rad", "rad/s"], [True, False])
    alphabet = Alphabet([[-1.5, 2], [0.1, 0.7], [0, 1 / 3]], inputs=["left", "right"])
    made = compress(random_policy(3))
    return dataclasses.replace(
        made, name="mixed", domain=box, alphabet=alphabet, default=np.array([0, 1 / 3]), cells=cells
    )


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
    return [(*made.decide(row), made.control(row)) for row in readings.tolist()]


def by_node(directory, readings, program, *arguments):
    """Return what a program for Node prints, given files and one of readings."""
    if not NODE:
        pytest.skip("needs node: apt-get install nodejs")
    (directory / "run.mjs").write_text(program)
    rows = [[repr(v) for v in row] for row in readings.tolist()]
    (directory / "vectors.json").write_text(json.dumps(rows))
    command = [NODE, directory / "run.mjs", *arguments, directory / "vectors.json"]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def by_javascript(policy, directory, readings, **options):
    path = made_by(policy, "javascript", directory, **options)
    return by_node(directory, readings, RUN, path)


def by_micropython(policy, directory, readings, **options):
    interpreter = MICROPYTHON / "micropython-webassembly-pyscript" / "micropython.mjs"
    if not interpreter.exists():
        pytest.skip("needs MicroPython for Node: npm ci")
    path = made_by(policy, "python", directory, **options)
    return by_node(directory, readings, RUN_MICROPYTHON, interpreter, path)


def by_json(policy, directory, readings, **options):
    data = json.loads(made_by(policy, "json", directory, **options).read_text())
    found = [read(data, row) for row in readings.tolist()]
    return [(*pair, data["symbols"][pair[0]]["control"]) for pair in found]


def read(data, reading, in_force=None):
    """Return (symbol, status) as the texts of a JSON file say, with a symbol in force if needed."""
    axes = data["states"] + data.get("exogenous", [])
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
    if "features" in data.get("tree", {}):
        z += ranks(data["tree"]["features"], z)
    label = walked(data["tree"], z) if "tree" in data else gone_down(data, z, in_force)
    if "tree" in data and "transitions" in data:
        label = data["transitions"][label][in_force]
    if label == data["outside"].get("gap"):
        return data["outside"]["safe"], 1
    return label, status


def walked(tree, z):
    """Return the label of lattice steps as the texts say of a tree."""
    i = 0
    while tree["split"][i] != -1:
        s = tree["split"][i]
        plane = None if s < len(z) else tree["planes"][s - len(z)]
        v = z[s] if plane is None else sum(a * b for a, b in zip(plane, z))
        i = tree["second"][i] if v >= tree["threshold"][i] else i + 1
    return tree["threshold"][i]


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


def gone_down(data, z, in_force=None):
    """Return the label of lattice steps as the texts say of cells, likewise."""
    cells, n = data["cells"], len(z)
    size, i = list(cells["root_sizes"]), 0
    for j in range(n):
        i = i * cells["partitions"][j] + z[j] // size[j]
    while cells["entries"][i] >= 0:
        c = 0
        for j, parts in enumerate(cells["refinement"]):
            if not cells["splits"] or cells["splits"][i] & 2**j:
                size[j] //= parts
                c = c * parts + z[j] // size[j] % parts
        i = cells["entries"][i] + c
    leaf, count = -1 - cells["entries"][i], data["default"] + 1
    constant = len(data.get("transitions", range(count)))
    if leaf < constant:
        return data["transitions"][leaf][in_force] if "transitions" in data else leaf
    a = leaf - constant
    rows = range(cells["row_starts"][a], cells["row_starts"][a + 1])
    slopes, symbols = cells["row_slopes"], cells["row_symbols"]
    values = {
        symbols[r]: cells["row_constants"][r] + sum(slopes[r * n + j] * z[j] for j in range(n))
        for r in rows
    }
    if "transitions" in data:
        ratios = {k: cells["row_ratios"][in_force * count + k] for k in values}
        values = {
            k: value - cells["row_prices"][a] * ratios[k]
            for k, value in values.items()
            if ratios[k] >= 0
        }
    most = max(values.values(), default=None)
    if not values or values.get(in_force) == most:
        return in_force
    return next(k for k, value in values.items() if value == most)


RUNNERS = {
    "python": by_python,
    "micropython": by_micropython,
    "javascript": by_javascript,
    "json": by_json,
}


def assert_equal(to, policy, directory, **options):
    """Compare an export with golden vectors, and with states many turns away.

    All of them, but for MicroPython, which runs the module of Python slowly: every third.
    """
    plan = Plan.of(policy, **options)
    golden = golden_vectors(plan)
    rng = np.random.default_rng(1)
    far = rng.normal(size=(60, plan.n)) * 10.0 ** rng.integers(0, 300, size=(60, 1))
    readings = np.concatenate([golden.readings, far])[:: 3 if to == "micropython" else 1]
    expected = decide(plan, readings)
    symbols, statuses, controls = zip(*RUNNERS[to](policy, directory, readings, **options))
    np.testing.assert_array_equal(statuses, expected.statuses)
    np.testing.assert_array_equal(symbols, expected.labels)
    np.testing.assert_array_equal(np.array(controls), policy.controls[expected.labels])
