"""Policies that remember, and what runs their exports, from a symbol in force and step by step."""

import dataclasses
import functools
import json

import casadi as ca
import numpy as np
import pytest

from capsyn import Alphabet, Box, Policy, Problem, Switching, problems, synthesize
from capsyn.cells.affine_leaves import PriceRatios
from capsyn.cells.cell_tree import CellTree
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.sequence import golden_sequence
from capsyn.modelling.grid import Grid
from support.exports.policies import MICROPYTHON, by_node, made_by, module, read
from support.features import exact
from support.references.switching import InForce
from support.trees import GRIDS, random_affine_tree, random_policy, random_tree


def random_transitions(labels, rows, forbidden, seed=0):
    """Return a table of so many rows beyond the constant ones, without forbidden transitions."""
    rng = np.random.default_rng([11, seed])
    table = rng.integers(0, labels, (5 * rows, labels))
    stays = np.arange(labels)
    table = np.where((rng.random(table.shape) < 0.4) & (stays < labels - 1), stays, table)
    table = np.where(forbidden[stays, table], stays, table)
    table = np.unique(table[(table != table[:, :1]).any(axis=1)], axis=0)
    some = np.sort(rng.permutation(len(table))[:rows])
    return np.vstack([np.repeat(stays[:, None], labels, axis=1), table[some]])


ALPHABET = Alphabet(
    [[0, 0], [0, 1], [1, 0], [1, 1], [-1, 0.5]],
    names=["off", "cool", "heat", "both", "x"],
    inputs=["heater", "cooler"],
)
SWITCHING = Switching(
    hold={"heater": 0.3, "cooler": 0.75, "heat": 0.5, "x": 0.1, "default": 0.2},
    forbidden=[("heat", "cool"), ("cool", "heat"), ("default", "both")],
)


@functools.cache
def random_rows(grid=3, some_axes=False):
    """Return a policy of random rows over one of the `GRIDS`: two inputs with times of their own.

    The default control is that of the first symbol.
    """
    labels = len(ALPHABET) + 1
    table = random_transitions(labels, 9, SWITCHING.forbids(ALPHABET), grid)
    cells = random_tree(*GRIDS[grid], labels + 9, seed=grid, some_axes=some_axes)
    start = -1 - cells.entries
    entries = np.where(cells.entries < 0, -1 - _allowed(start, labels), cells.entries)
    none = np.zeros(0, dtype=np.int32), np.zeros((0, labels, 1), dtype=np.uint64)
    cells = type(cells)(cells.grid, entries.astype(np.int32), *none, splits=cells.splits)
    return dataclasses.replace(
        random_policy(grid, True, grid),
        alphabet=ALPHABET,
        default=np.zeros(2),
        cells=cells,
        transitions=table,
        switching=SWITCHING,
    )


def random_rules(seed=15):
    """Return a policy on [0, 1] with random times, prices and forbidden changes.

    Its five symbols have four controls at most, that of the first always; symbol 0 is the safe one.
    """
    rng = np.random.default_rng([15, seed])
    count = 5
    names = [f"s{k}" for k in range(count)]
    values = [[0, 0], *rng.integers(0, 2, (count - 1, 2)).tolist()]
    alphabet = Alphabet(values, names=names, inputs=["a", "b"])
    barred = np.argwhere(rng.random((count + 1, count)) < 0.2)
    pairs = [(j, k) for j, k in barred.tolist() if j != k and k > 0 and (j, k) != (0, 1)]
    price = rng.integers(0, 2, (count, count)) * (1 - np.eye(count)) * rng.integers(2)
    switching = Switching(
        price=price,
        hold={name: 0.25 * int(rng.integers(6)) for name in (*names[1:], "a", "b")},
        forbidden=[([*names, "default"][j], names[k]) for j, k in pairs],
    )
    default, first = rng.integers(0, 2, 2), count + 1
    barred = np.isinf(switching.prices(alphabet, default))
    table = random_transitions(first, 12, barred, int(rng.integers(1000)))
    return Policy(
        name="rules",
        domain=Box([0], [1]),
        alphabet=alphabet,
        default=default,
        cells=CellTree(
            Grid((len(table) - first,), (2,), 0),
            -1 - np.arange(first, len(table), dtype=np.int32),
            np.zeros(0, dtype=np.int32),
            np.zeros((0, first, 1), dtype=np.uint64),
        ),
        outside=0,
        transitions=table,
        switching=switching,
    )


def _allowed(rows, labels):
    """Return rows without the constant ones that some symbol may not go to."""
    return np.where(np.isin(rows, (1, 2, 3)), rows + labels, rows)


@functools.cache
def random_prices(grid=3, some_axes=False):
    """Return a policy of affine leaves with random prices, and a forbidden change."""
    cells = random_affine_tree(*GRIDS[grid], 4, seed=grid, some_axes=some_axes)
    affine, rng = cells.affine, np.random.default_rng([12, grid])
    alphabet, matrix = Alphabet([-1, 1, 2]), rng.integers(1, 9, (3, 3)) * (1 - np.eye(3))
    switching = Switching(matrix, forbidden=[("-1", "1")], hold={"1": 0.4})
    ratios = PriceRatios.of(switching.prices(alphabet, np.zeros(1))).ratios
    prices = rng.integers(0, 60, len(affine))
    affine = dataclasses.replace(affine, prices=prices.astype(np.int32), ratios=ratios)
    entries = np.where(cells.entries == -2, np.int32(-1), cells.entries)  # 1 never follows 0
    none = np.zeros(0, dtype=np.int32), np.zeros((0, 4, 1), dtype=np.uint64)
    return dataclasses.replace(
        random_policy(grid, True, grid),
        alphabet=alphabet,
        cells=type(cells)(cells.grid, entries, *none, affine, cells.splits),
        switching=switching,
    )


@functools.cache
def pendulum():
    """Return the pendulum with a price of 1 %, and one symbol that is held."""
    problem = problems.plain("cart-pendulum")
    switching = Switching(price="1%", hold={"5": 0.02})
    return synthesize(problem.replace(switching=switching))


@functools.cache
def house():
    """Return a house that is heated and cooled, in minutes; never from one to the other at once."""
    return synthesize(
        Problem(
            name="house",
            dynamics=lambda x, u: [(-0.1 * (x[0] - 15) + u[0]) / 10],
            domain=Box([10], [30], names=["T"], units=["degC"]),
            alphabet=Alphabet([0, 2, -2], names=["off", "heat", "cool"]),
            default=0.6,
            horizon=15.0,
            running_cost=lambda x: ca.fmax(20 - x[0], 0) ** 2 + ca.fmax(x[0] - 22, 0) ** 2,
            partitions=80,
            max_level=2,
            outside="nearest",
            time_unit="min",
            switching=Switching(
                price=0.1,
                hold={"heat": 10, "off": 5, "cool": 10},
                forbidden=[("heat", "cool"), ("cool", "heat")],
            ),
        )
    )


def only_times():
    """Return a policy whose next symbol does not depend on that in force, with several times."""
    return dataclasses.replace(
        random_policy(3, True), switching=Switching(hold={"-1": 0.25, "1": 0.6})
    )


def only_transitions():
    """Return a policy that has no times to wait for."""
    return dataclasses.replace(random_rows(), switching=dataclasses.replace(SWITCHING, hold=0.0))


def with_gaps():
    """Return a policy whose default control stands for states outside."""
    return dataclasses.replace(random_rows(1), gaps=True, outside=0)


@functools.cache
def with_features():
    """Return a tree with features, and a random row in every other leaf."""
    tree = exact()
    leaves = np.flatnonzero(tree.cells.split < 0)[::2]
    threshold = tree.cells.threshold.copy()
    threshold[leaves] = 3 + np.arange(len(leaves)) % 4
    table = random_transitions(3, 4, np.zeros((3, 3), dtype=bool))
    cells = dataclasses.replace(tree.cells, threshold=threshold)
    switching = Switching(hold={"5": 0.02, "-5": 0.05})
    return dataclasses.replace(tree, cells=cells, transitions=table, switching=switching)


POLICIES = {
    "rows": random_rows,
    "like symbols": random_rules,
    "one axis": lambda: random_rows(1),
    "four axes": lambda: random_rows(7, True),
    "prices": random_prices,
    "prices of some axes": lambda: random_prices(6, True),
    "pendulum": pendulum,
    "house": house,
    "times": only_times,
    "no times": only_transitions,
    "gaps": with_gaps,
    "features": with_features,
}
"""What makes them, by name."""


RUN = """
import { readFileSync } from "node:fs";
const [file, more, rows] = process.argv.slice(2);
const made = await import(file);
const special = { nan: NaN, inf: Infinity, "-inf": -Infinity };
const readings = JSON.parse(readFileSync(rows, "utf8"))
  .map(row => row.map(v => v in special ? special[v] : Number(v)));
const { in_force, runs, steps, period } = JSON.parse(readFileSync(more, "utf8"));
const next = in_force.map((symbol, k) => made.next(symbol, readings[k]));
const found = [];
for (let at = in_force.length, run = 0; run < runs; run++) {
  const controller = new made.Controller();
  for (let k = 0; k < steps; k++, at++) {
    found.push(period ? controller.step(readings[at], k * period) : controller.step(readings[at]));
  }
}
console.log(JSON.stringify([next, found]));
"""
RUN_MICROPYTHON = """
import { readFileSync } from "node:fs";
const [interpreter, file, more, rows] = process.argv.slice(2);
const { loadMicroPython } = await import(interpreter);
const python = await loadMicroPython({ heapsize: 64 << 20, stdout: line => console.log(line) });
python.FS.writeFile("/made.py", readFileSync(file));
python.FS.writeFile("/more.json", readFileSync(more));
python.FS.writeFile("/rows.json", readFileSync(rows));
python.FS.writeFile("/steps.py", PYTHON);
python.runPython(`
import json, sys
sys.path.append("/")
import made, steps
rows = [[float(v) for v in row] for row in json.load(open("/rows.json"))]
print(json.dumps(steps.found(made, rows, **json.load(open("/more.json")))))
`);
"""
STEPS = """
def found(made, rows, in_force, runs, steps, period):
    following = [made.next_symbol(s, row) for s, row in zip(in_force, rows)]
    pairs, at = [], len(in_force)
    for _ in range(runs):
        controller = made.Controller()
        assert controller.control() == made.CONTROLS[made.DEFAULT]
        for k in range(steps):
            time = (k * period,) if period else ()
            pairs.append(controller.step(rows[at + k], *time))
            assert controller.control() == made.CONTROLS[pairs[-1][0]]
        at += steps
    return following, pairs
"""


def by_python(path, directory, readings, more):
    names = {}
    exec(STEPS, names)
    return names["found"](module(path), readings.tolist(), **more)


def by_javascript(path, directory, readings, more):
    return by_node(directory, readings, RUN, path, _file(directory, more))


def by_micropython(path, directory, readings, more):
    interpreter = MICROPYTHON / "micropython-webassembly-pyscript" / "micropython.mjs"
    if not interpreter.exists():
        pytest.skip("needs MicroPython for Node: npm ci")
    program = RUN_MICROPYTHON.replace("PYTHON", json.dumps(STEPS))
    return by_node(directory, readings, program, interpreter, path, _file(directory, more))


def _file(directory, more):
    path = directory / "more.json"
    path.write_text(json.dumps(more))
    return path


def by_json(path, directory, readings, more):
    data, rows = json.loads(path.read_text()), readings.tolist()
    count, period = len(more["in_force"]), more["period"] or 1.0
    following = [read(data, row, now) for row, now in zip(rows, more["in_force"])]
    found = []
    for run in range(more["runs"]):
        held = Held(data)
        for k in range(more["steps"]):
            found.append(held.step(rows[count + run * more["steps"] + k], k * period))
    return following, found


class Held:
    """The symbol in force, as the texts under "dwell" say."""

    def __init__(self, data):
        self.data = data
        controls = [symbol["control"] for symbol in data["symbols"]]
        rules = (data[key] for key in ("kinds", "holds", "input_holds", "forbidden"))
        self.rule = InForce(controls, *rules, data["outside"]["safe"], data["hold_off"])

    def step(self, reading, time):
        wanted, status = read(self.data, reading, self.rule.now)
        return self.rule.step(wanted, status in self.data["at_once"], time), status


RUNNERS = {
    "python": by_python,
    "micropython": by_micropython,
    "javascript": by_javascript,
    "json": by_json,
}


def assert_remembers(to, policy, directory, runs=16, steps=250, **options):
    """Compare an export with golden vectors and golden sequences of a policy that remembers."""
    plan = Plan.of(policy, **options)
    slow = to == "micropython"  # the module of Python, by another interpreter
    golden, sequence = golden_vectors(plan), golden_sequence(plan, 2 if slow else runs, steps)
    some = slice(None, None, 3 if slow else 1)
    in_force = np.zeros(len(golden), dtype=int) if golden.in_force is None else golden.in_force
    in_force, runs = in_force[some], len(sequence.labels)
    more = {"in_force": in_force.tolist(), "runs": runs, "steps": steps}
    more["period"] = sequence.period if plan.waits else None
    readings = np.concatenate([golden.readings[some], sequence.readings.reshape(-1, plan.n)])
    path = made_by(policy, "python" if to == "micropython" else to, directory, **options)
    following, found = map(np.array, RUNNERS[to](path, directory, readings, more))
    np.testing.assert_array_equal(following[:, 0], golden.labels[some])
    np.testing.assert_array_equal(following[:, 1], golden.statuses[some])
    np.testing.assert_array_equal(found[:, 0], sequence.labels.ravel())
    np.testing.assert_array_equal(found[:, 1], sequence.statuses.ravel())
