"""Affine leaves: integer rows, the same symbol everywhere, and files that are not trusted."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsyn import Alphabet, Box, Policy
from capsyn.cells.affine_leaves import LARGEST_SUM, ROW_ARRAYS, AffineLeaves
from capsyn.cells.cell_tree import CellTree
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.modelling.grid import Grid
from capsyn.policies.file import content_hash
from support.policy_files import read, refuse, rewrite
from support.trees import GRIDS, random_affine_policy, random_affine_tree, states_at_faces


def slow_label(tree, step):
    """Return the label of a finest cell by the rules, in Python's own integers."""
    entries, place, lower = tree.entries.tolist(), 0, []
    for z, q, size in zip(step, tree.partitions, tree.sizes(0).tolist()):
        place = place * q + z // size
        lower.append(z // size * size)
    sizes = tree.sizes(0).tolist()
    while entries[place] >= 0:
        child = 0
        for i, factor in enumerate(tree.refinement):
            if tree.splits is None or tree.splits[place] >> i & 1:
                sizes[i] //= factor
                child = child * factor + (step[i] - lower[i]) // sizes[i]
                lower[i] += (step[i] - lower[i]) // sizes[i] * sizes[i]
        place = entries[place] + child
    leaf = -1 - entries[place]
    rows = tree.affine
    if rows is None or leaf < rows.first:
        return leaf
    values = {}
    for row in range(rows.starts[leaf - rows.first], rows.starts[leaf - rows.first + 1]):
        products = (int(c) * int(z) for c, z in zip(rows.slopes[row], step))
        values[int(rows.symbols[row])] = int(rows.constants[row]) + sum(products)
    most = max(values.values())
    return min(symbol for symbol, value in values.items() if value == most)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("grid", range(len(GRIDS)))
@pytest.mark.parametrize("some_axes", [False, True])
def test_compiled_is_numpy_is_the_rules(grid, periodic, some_axes):
    policy = random_affine_policy(grid, periodic, grid, some_axes)
    states = states_at_faces(policy.domain, policy.cells.counts, 300, seed=grid)
    found = policy(states, outside="nearest", backend="numpy")
    assert np.array_equal(found, policy(states, outside="nearest", backend="c"))
    steps = policy.domain.locate(states, policy.cells.counts)
    slow = np.array([slow_label(policy.cells, step) for step in steps.tolist()])
    assert np.array_equal(np.where(slow == 2, -1, slow), found)
    assert len(set(found.tolist())) > 1 or grid == 0


def test_equal_rows_give_the_lowest_symbol():
    leaves = AffineLeaves.of(
        4,
        np.array([3]),
        np.array([1, 2, 3], dtype=np.int32),
        np.array([5, 5, 0], dtype=np.int32),
        np.array([[0], [0], [1]], dtype=np.int16),
    )
    assert leaves.labels(np.full(7, 4), np.arange(7)[:, None]).tolist() == [1] * 6 + [3]


def extreme(sign):
    """Return a policy whose rows are as large as they may be."""
    counts = (2**14, 2**14)
    slopes = np.array([[32767, 32767], [-32767, -32767]]) // 2 * sign
    constants = np.array([0, LARGEST_SUM - 2 * 2**14 * 16384])
    affine = AffineLeaves.of(
        3,
        np.array([2]),
        np.array([0, 1], dtype=np.int32),
        constants.astype(np.int32),
        slopes.astype(np.int16),
    )
    empty = np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.uint64)
    tree = CellTree(Grid((1, 1), (2, 2), 14), np.array([-4], dtype=np.int32), *empty, affine)
    assert tree.counts == counts
    return Policy("extreme", Box([0, 0], [1, 1]), Alphabet([0, 1]), np.zeros(1), tree)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_largest_rows_do_not_overflow(sign):
    policy = extreme(sign)
    states = policy.domain.sample(2000, 1)
    steps = policy.domain.locate(states, policy.cells.counts)
    slow = [slow_label(policy.cells, step) for step in steps.tolist()]
    for backend in ("c", "numpy"):
        assert policy(states, backend=backend).tolist() == slow
    with pytest.raises(PolicyFormatError, match="sums beyond 31 bits"):
        rows = policy.cells.affine
        steeper = dataclasses.replace(rows, constants=rows.constants + np.int32(2**15))
        dataclasses.replace(policy, cells=dataclasses.replace(policy.cells, affine=steeper))


@given(st.integers(0, 7), st.integers(0, 50), st.booleans())
def test_random_trees_are_well_formed(grid, seed, some_axes):
    tree = random_affine_tree(*GRIDS[grid], seed=seed, some_axes=some_axes)
    tree.check(3)
    places, volumes = tree.volumes()
    assert volumes.sum() == np.prod(tree.counts, dtype=float)
    assert np.array_equal(np.sort(places), np.flatnonzero(tree.entries < 0))


def put(name, place, value):
    def change(arrays):
        arrays[name][place] = value

    return change


def cut(name, count):
    def change(arrays):
        arrays[name] = arrays[name][:count].copy()

    return change


BROKEN = {
    "starts begin later": (put("row_starts", 0, 1), "two or more"),
    "starts end early": (put("row_starts", -1, 3), "two or more"),
    "starts fall": (put("row_starts", 1, 9), "two or more"),
    "one row": (put("row_starts", 1, 1), "two or more"),
    "no start": (cut("row_starts", 0), "unknown label"),
    "no leaf": (cut("row_starts", 1), "unknown label"),
    "fewer symbols": (cut("row_symbols", -1), "two or more"),
    "fewer constants": (cut("row_constants", -1), "differ in length"),
    "fewer slopes": (cut("row_slopes", -1), "differ in length"),
    "negative symbol": (put("row_symbols", 0, -1), "unknown symbol"),
    "symbol beyond": (put("row_symbols", 1, 3), "unknown symbol"),
    "twice the symbol": (put("row_symbols", slice(0, 2), 1), "ascend by symbol"),
    "constant beyond": (put("row_constants", 0, 2**31 - 1), "sums beyond 31 bits"),
    "least constant": (put("row_constants", 0, -(2**31)), "sums beyond 31 bits"),
    "another order": (
        lambda arrays: np.copyto(arrays["entries"], arrays["entries"][::-1].copy()),
        "numbered in the order|blocks|block|deeper",
    ),
    "unknown leaf": (put("entries", 0, -999), "unknown label"),
}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "affine.cap"
    random_affine_policy(3, periodic=True, seed=4).save(path)
    return path


@pytest.mark.parametrize("name", BROKEN)
def test_tables_that_do_not_fit_are_refused(name, file):
    change, message = BROKEN[name]
    rewrite(file, lambda _, arrays: change(arrays))
    refuse(file, message)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_save_and_load_is_equality(grid, seed, tmp_path):
    policy = random_affine_policy(grid, seed=seed, some_axes=seed == 1)
    policy.save(tmp_path / "a.cap")
    loaded = Policy.load(tmp_path / "a.cap")
    assert content_hash(loaded) == content_hash(policy)
    for name in ("entries", "mixed_cells", "mixed_labels"):
        assert np.array_equal(getattr(loaded.cells, name), getattr(policy.cells, name))
    assert loaded.cells.affine.first == 3
    for name, dtype in ROW_ARRAYS.items():
        mine, theirs = (p.cells.affine.arrays()[name] for p in (policy, loaded))
        assert np.array_equal(mine, theirs) and theirs.dtype == dtype
    document, arrays = read(tmp_path / "a.cap")
    some_axes = policy.cells.splits is not None
    assert (document["version"], len(arrays)) == ((5, 8) if some_axes else (3, 7))
    loaded.save(tmp_path / "b.cap")
    assert (tmp_path / "a.cap").read_bytes() == (tmp_path / "b.cap").read_bytes()


@pytest.mark.parametrize("version", [1, 2])
def test_rows_in_a_file_of_an_older_version_are_refused(file, version):
    rewrite(file, lambda document, _: document.update(version=version))
    refuse(file, "not those of this format version")


@pytest.mark.parametrize("name", ROW_ARRAYS)
def test_a_missing_table_or_another_type_is_refused(name, file):
    whole = file.read_bytes()
    rewrite(file, lambda _, arrays: arrays.pop(name))
    refuse(file, "does not hold the arrays")
    file.write_bytes(whole)
    rewrite(file, lambda _, arrays: arrays.update({name: arrays[name].astype(np.int64)}))
    refuse(file, f"array '{name}' must be")


def test_what_needs_one_symbol_per_cell_says_so():
    tree = random_affine_tree(*GRIDS[3])
    with pytest.raises(ProblemError, match="leaves='constant'"):
        tree.boxes()
