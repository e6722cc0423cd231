"""Plans that tests of exported C share, their golden vectors, what target c makes of them."""

import dataclasses
import functools
import warnings

import numpy as np

import capsyn
from capsyn import problems
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.masks import word_count
from capsyn.cells.split_tree import LEAF, SplitTree, _second_children
from capsyn.errors import CapsynWarning
from capsyn.exports.c.language import round_up
from capsyn.exports.c.target import TARGET as c
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import OK, Plan
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree
from support.trees import GRIDS, random_policy, random_tree

POLICIES = {
    "cart-pendulum": {},
    "cart-pendulum-4": {},
    "double-tank-a": {},
    "double-tank-b": {},
    "cart-pole": {"max_level": 2},
}


NAMES = (*POLICIES, "lopsided")
"""Policies, and a random tree: that of the pendulum is the same at theta and at -theta."""


STYLES = ("table", "nested", "grid")


COMPILERS = ("gcc", "clang")


NESTED = ("linear", "nested")


UNDEFINED = ["-O1", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover"]
"""Options by which a program ends where what it does is undefined."""


class Files(dict):
    """Files of an export that know their plan, by which machines check what the files say."""

    plan = None


def made(plan, golden=None, **options):
    """Return what target c makes."""
    if golden is None and options.get("arithmetic") == "float":
        golden = golden_vectors(plan)
    code = c.files(plan, golden, **options)
    files = Files(code.files)
    files.plan = plan
    return dataclasses.replace(code, files=files)


def files(plan, golden, **options):
    """Return the files of target c."""
    return made(plan, golden, **options).files


@functools.cache
def policy(name):
    return capsyn.synthesize(problems.plain(name), **POLICIES[name])


@functools.cache
def plan_of(name, mode="exact"):
    if name == "lopsided":
        return random_plan(144)
    if mode == "linear":  # as such trees are, but made at once
        return random_plan(200, 2, 7, oblique=0.4)
    return Plan.of(policy(name) if mode == "exact" else capsyn.compress(policy(name), mode=mode))


@functools.cache
def golden_of(name, mode="exact"):
    return golden_vectors(plan_of(name, mode))


def random_plan(count, label_count=3, depth=10, seed=1, oblique=0.0):
    """Return a plan of a random tree over the pendulum's states with many steps per axis.

    A share of its splits is oblique.
    """
    rng = np.random.default_rng(seed)
    source = policy("cart-pendulum")
    nodes, planes = [], []

    def grow(lower, upper, level):
        axis = int(rng.integers(2))
        if level == depth or upper[axis] - lower[axis] < 2 or rng.random() < 0.03:
            nodes.append((LEAF, int(rng.integers(label_count))))
            return
        if rng.random() < oblique:
            plane = rng.integers(-60, 61, 2)
            nodes.append((2 + len(planes), int(plane @ rng.integers(lower, upper))))
            planes.append(plane)
            grow(lower, upper, level + 1)
            return grow(lower, upper, level + 1)
        cut = int(rng.integers(lower[axis] + 1, upper[axis]))
        nodes.append((axis, cut))
        below, above = list(upper), list(lower)
        below[axis] = above[axis] = cut
        grow(lower, below, level + 1)
        grow(above, upper, level + 1)

    grow([0, 0], [count, count], 0)
    split, threshold = np.array(nodes, dtype=np.int32).T.copy()
    second = _second_children(split == LEAF).astype(np.int32)
    rows = np.array(planes, dtype=np.int32).reshape(-1, 2)
    tree = SplitTree((count, count), split, threshold, second, rows)
    tree.check(label_count)
    return Plan.of(DecisionTree.of(source, tree, Guarantee("exact", "0" * 64)))


def assert_golden(library, golden, lattice):
    symbols, statuses = library.decide(golden.states)
    assert np.array_equal(symbols, golden.labels)
    assert np.array_equal(statuses, golden.statuses)
    if lattice:
        assert np.array_equal(library.steps(golden.states), golden.steps)
        found = golden.statuses == OK
        assert np.array_equal(library.look(golden.steps[found]), golden.labels[found])


def plan_of_nodes(counts, split, threshold, planes=(), box=None, label_count=2):
    """Return a plan of a tree that is given by its nodes, over a box from 0 to 1 by default."""
    n, split = len(counts), np.array(split, dtype=np.int32)
    second = _second_children(split == LEAF).astype(np.int32)
    planes = np.array(planes, dtype=np.int32).reshape(-1, n)
    tree = SplitTree(counts, split, np.array(threshold, dtype=np.int32), second, planes)
    tree.check(label_count)
    box = box or capsyn.Box([0] * n, [1] * n)
    alphabet = capsyn.Alphabet(np.arange(1.0, label_count))
    cells = random_tree((1,) * n, (2,) * n, 0, leaf_count=label_count)
    source = capsyn.Policy("few", box, alphabet, np.zeros(1), cells)
    return Plan.of(DecisionTree.of(source, tree, Guarantee("exact", "0" * 64)))


def back_in_single_precision(domain, states):
    """Return float states with periodic axes brought back as the header says."""
    states = states.copy()
    for i in np.flatnonzero(domain.periodic):
        low, high = round_up(domain.lower[i : i + 1])[0], round_up(domain.upper[i : i + 1])[0]
        off = np.isfinite(states[:, i]) & ~((states[:, i] >= low) & (states[:, i] < high))
        rest = np.fmod(states[off, i] - low, high - low)
        rest = low + np.where(rest < 0, rest + (high - low), rest)
        states[off, i] = np.where(rest >= high, low, rest)
    return states


COUNTS = {
    "encoder and converter": ([2 * np.pi / 4096, 10 / 4096], [0.0, -5.0]),
    "falling": ([-2 * np.pi / 4096, -0.003], [0.1, 0.25]),
    "full scale": ([2 * np.pi / 65536, 10 / 65536], [-0.5, 0.0]),
    "no power of two": ([2 * np.pi / 1000, -10 / 999], [100.0, 0.0]),
    "on faces": ([-2 * np.pi / 144, 1 / 3000], [0.0, 0.1]),
    "coarse": ([2 * np.pi / 100, 0.5], [0.01, 0.0]),
    "seam": ([-2 * np.pi / 36000, 0.01], [-np.pi, 0.0]),
    "tables": ([2 * np.pi / 65536, 0.001], [0.0, 0.0]),
}
"""Scales and offsets of counts, for the pendulum's angle and speed."""


FINE = {
    "coarse, falling": ([-2 * np.pi / 1000, -0.007], [0.5, 0.001], ["", "held"]),
    "coarse, offset": ([2 * np.pi / 1024, 0.0045], [-np.pi, 0.7], ["less", "wide held"]),
    "decimal": ([2 * np.pi / 6250, 0.0005], [0.1, 0.0003], ["wide", "wide"]),
    "decimal, on faces": ([2 * np.pi / 65536, 0.0004], [-np.pi, 0.001], ["less", "less more"]),
    "decimal, falling": ([-2 * np.pi / 10000, -0.00031], [0.1, 0.1], ["wide", "wide"]),
    "on faces": ([-2 * np.pi / 8192, 0.0007], [np.pi, 0.3], ["less", "less more"]),
}
"""The same for 8,192 steps per axis, with the lines that give the steps of counts."""


def made_of_counts(plan):
    """Return what target c makes for counts, whatever their tables take."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CapsynWarning)
        return made(plan, readings="int16")


def of_vectors(golden, rows):
    """Return some rows of golden vectors."""
    columns = {field.name: getattr(golden, field.name) for field in dataclasses.fields(golden)}
    known = {name: column[rows] for name, column in columns.items() if column is not None}
    return dataclasses.replace(golden, **known)


def remembering(grid=3, seed=0, hold=0.0, forbidden=(), symbols=4, own_rows=9):
    """Return a policy of random rows: two inputs with two values each, or one with many.

    The first symbol is the default control.
    """
    rng = np.random.default_rng(seed)
    source = random_policy(grid, periodic=True, seed=seed)
    values = np.arange(symbols)[:, None]
    if symbols == 4:
        values = [[0, 0], [0, 1], [1, 0], [1, 1]]
    names = ["off", "valve on", "fan on", "both"] if symbols == 4 else None
    alphabet = capsyn.Alphabet(values, names, ["fan", "valve"][: np.shape(values)[1]])
    switching = capsyn.Switching(hold=hold, forbidden=forbidden)
    allowed = np.isfinite(switching.prices(alphabet, np.zeros(alphabet.m)))
    choices = [np.flatnonzero(row[:symbols]) for row in allowed]
    rows = {tuple(int(rng.choice(some)) for some in choices) for _ in range(own_rows)}
    keeps = [[j if rng.random() < 0.5 and j < symbols else best for j in range(symbols + 1)]
             for best in rng.integers(symbols, size=own_rows)]  # fmt: skip
    rows |= {row for row in map(tuple, keeps) if allowed[np.arange(symbols + 1), row].all()}
    rows = sorted(row for row in rows if len(set(row)) > 1)
    constant = np.repeat(np.arange(symbols + 1)[:, None], symbols + 1, 1)
    table = np.vstack([constant, *(np.array([row]) for row in rows)])
    free = np.flatnonzero(allowed[np.arange(symbols + 1), table].all(axis=1))
    free = rng.permutation(free)[:60]
    tree = random_tree(*GRIDS[grid], leaf_count=len(free), seed=seed)
    entries = np.where(tree.entries < 0, -1 - free[np.maximum(-1 - tree.entries, 0)], tree.entries)
    sets = np.zeros((0, symbols + 1, word_count(symbols + 1)), dtype=np.uint64)
    cells = CellTree(tree.grid, entries.astype(np.int32), np.zeros(0, dtype=np.int32), sets)
    return dataclasses.replace(
        source,
        name="remembering",
        alphabet=alphabet,
        default=np.zeros(alphabet.m),
        cells=cells,
        transitions=table,
        switching=switching,
    )


FORBIDDEN = (("off", "both"), ("both", "off"), ("valve on", "fan on"))
REMEMBERING = {
    "rows": {},
    "holds": {"hold": (0.2, 0.5, 0.1, 0.2)},
    "inputs": {"hold": {"fan": 0.4, "valve": 1.0, "valve on": 0.7, "default": 0.5}},
    "forbidden": {"hold": {"valve": 0.6}, "forbidden": FORBIDDEN},
    "ways": {"forbidden": FORBIDDEN},
    "many": {"symbols": 300, "hold": {"7": 0.3}},
}
"""Options of `remembering`."""
