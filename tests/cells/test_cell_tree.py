"""Cells: every finest cell lies in exactly one leaf; malformed trees are refused."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsyn.cells.cell_tree import CellTree
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.modelling.grid import MAX_COUNT, Grid
from support.trees import GRIDS, random_tree

LEAVES = 3


def all_steps(tree):
    """Return every finest cell (K, n) in C order."""
    return np.stack(np.unravel_index(np.arange(math.prod(tree.counts)), tree.counts), axis=1)


def paint(tree, value):
    """Return an array over the finest cells that adds ``value(leaves)`` over each leaf's box."""
    canvas = np.zeros(tree.counts, dtype=np.int64)
    for leaves in tree.leaves():
        for corner, size, number in zip(leaves.lower, leaves.sizes, value(leaves)):
            canvas[tuple(slice(a, a + s) for a, s in zip(corner, size))] += number
    return canvas


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("some_axes", [False, True])
def test_leaves_tile_the_domain_exactly_once(grid, seed, some_axes):
    tree = random_tree(*grid, LEAVES, seed=seed, some_axes=some_axes)
    tree.check(LEAVES)
    assert (paint(tree, lambda x: np.ones(len(x.places), int)) == 1).all()
    assert math.fsum(tree.boxes().volumes()) == math.prod(tree.counts)
    assert sum(len(x.places) for x in tree.leaves()) == tree.leaf_count


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("split", [0.2, 0.9])
@pytest.mark.parametrize("some_axes", [False, True])
def test_find_is_the_leaf_whose_box_holds_the_cell(grid, split, some_axes):
    tree = random_tree(*grid, LEAVES, split, seed=2, some_axes=some_axes)
    steps = all_steps(tree)
    entries = paint(tree, lambda x: x.places).ravel()
    labels = paint(tree, lambda x: tree.labels_at(x.places)).ravel()
    assert np.array_equal(tree.find(steps), entries)
    assert np.array_equal(tree.labels(steps), labels)
    order = np.random.default_rng(0).permutation(len(steps))
    assert np.array_equal(tree.find(steps[order]), entries[order])


@given(st.data())
def test_find_on_random_trees(data):
    n = data.draw(st.integers(1, 4))
    numbers = st.lists(st.integers(1, 3), min_size=n, max_size=n)
    partitions = tuple(data.draw(numbers))
    refinement = tuple(1 + r for r in data.draw(numbers))
    max_level = data.draw(st.integers(0, 3 if n < 3 else 2 if n < 4 else 1))
    seed = data.draw(st.integers(0, 99))
    some_axes = data.draw(st.booleans())
    tree = random_tree(partitions, refinement, max_level, LEAVES, 0.3, seed, some_axes)
    tree.check(LEAVES)
    steps = np.random.default_rng(seed).integers(0, tree.counts, (50, n))
    holds = np.zeros(len(steps), dtype=int)
    entries = np.zeros(len(steps), dtype=int)
    for leaves in tree.leaves():
        for place, corner, size in zip(*leaves[1:]):
            inside = ((steps >= corner) & (steps < corner + size)).all(axis=1)
            holds += inside
            entries[inside] = place
    assert (holds == 1).all()
    assert np.array_equal(tree.find(steps), entries)


def test_find_takes_no_cells():
    tree = random_tree(*GRIDS[3], LEAVES)
    assert tree.find(np.empty((0, 2), dtype=np.int64)).shape == (0,)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("some_axes", [False, True])
def test_levels_visit_every_cell_once_below_its_parent(grid, some_axes):
    tree = random_tree(*grid, LEAVES, 0.7, seed=3, some_axes=some_axes)
    seen, above = [], None
    for number, cells in enumerate(tree.levels()):
        level, places, lower, sizes = cells
        assert level == number and len(places) == len(lower) == len(sizes)
        assert (lower % sizes == 0).all() and (lower >= 0).all()
        assert (lower + sizes <= tree.counts).all()
        if not some_axes:
            assert (sizes == tree.sizes(level)).all()
        if above is not None:  # the cells of a block lie in its cell
            start = 0
            for corner, size, factors in zip(above.lower, above.sizes, tree.factors(above.places)):
                block = slice(start, start + math.prod(factors.tolist()))
                assert (lower[block] >= corner).all()
                assert (lower[block] + sizes[block] <= corner + size).all()
                assert (sizes[block] * factors == size).all()
                start = block.stop
            assert start == len(places)
        above = cells.where(tree.entries[places] >= 0)
        seen.append(places)
    assert np.array_equal(np.concatenate(seen), np.arange(len(tree.entries)))
    assert not len(above.places)


def test_shape_of_a_tree():
    tree = CellTree(Grid((3, 1), (2, 3), 2), np.full(3, -1, np.int32), *empty_mixed())
    assert tree.n == 2 and tree.counts == (12, 9) and tree.leaf_count == 3
    assert tree.sizes(0).tolist() == [4, 9] and tree.sizes(2).tolist() == [1, 1]
    volumes = [math.prod(tree.sizes(k).tolist()) / math.prod(tree.counts) for k in range(3)]
    assert volumes == [1 / 3, 1 / 18, 1 / 108]


def test_a_refinement_that_is_never_used_costs_nothing():
    tree = CellTree(
        Grid((1, 1), (MAX_COUNT, MAX_COUNT), 1), np.full(1, -1, np.int32), *empty_mixed()
    )
    tree.check(1)
    assert [tree.labels_at(x.places).tolist() for x in tree.leaves()] == [[0]]
    assert tree.labels(np.array([[MAX_COUNT - 1, 0]])).tolist() == [0]


def empty_mixed():
    return np.empty(0, np.int32), np.empty(0, np.uint64)


def int32(*values):
    return np.array(values, dtype=np.int32)


def uint64(*values):
    return np.array(values, dtype=np.uint64)


GOOD = CellTree(  # two root cells; the first is split, and so is its second child
    Grid((2,), (2,), 2), int32(2, -1, -2, 4, -3, -1), int32(2, 4), uint64(0b011, 0b110)
)

BLOCKS = "the blocks of cells are not one after the other"
DEEPER = "the cells are deeper or more than the file says"
MIXED = "the mixed cells are no ascending leaf cells"
MALFORMED = [
    ("1 cells are fewer than the root grid's 2", {"entries": int32(-1), "mixed_cells": int32()}),
    ("6 cells are fewer than the root grid's 100", {"grid": Grid((100,), (2,), 2)}),
    ("a cell has an unknown label", {"entries": int32(2, -1, -2, 4, -3, -4)}),
    ("a cell has an unknown label", {"entries": int32(2, -(2**31), -2, 4, -3, -1)}),
    (BLOCKS, {"entries": int32(0, -1, -2, 4, -3, -1)}),  # a block that holds itself
    (BLOCKS, {"entries": int32(2, -1, -2, 2, -3, -1)}),  # a cycle
    (BLOCKS, {"entries": int32(3, -1, -2, 4, -3, -1)}),  # askew
    (BLOCKS, {"entries": int32(2, -1, -2, 2**31 - 1, -3, -1)}),  # far beyond the end
    (BLOCKS, {"entries": int32(2, 2, -2, 4, -3, -1)}),  # shared
    (BLOCKS, {"entries": int32(4, 2, -1, -1, -1, -1)}),  # in the wrong order
    (DEEPER, {"grid": Grid((2,), (2,), 1)}),
    (DEEPER, {"grid": Grid((2,), (2,), 0)}),
    (DEEPER, {"entries": int32(2, -1, -2, 4)}),  # cut off
    (DEEPER, {"entries": int32(2, -1, -2, 4, -3, 6)}),
    ("1 cells belong to no block", {"entries": int32(2, -1, -2, 4, -3, -1, -1)}),
    ("2 cells belong to no block", {"entries": int32(-1, -1, -2, -1)}),
    ("mixed cells and their labels differ in number", {"mixed_cells": int32(2)}),
    ("mixed cells and their labels differ in number", {"mixed_labels": uint64(3, 6, 1)}),
    (MIXED, {"mixed_cells": int32(-4, 4)}),
    (MIXED, {"mixed_cells": int32(2, 6)}),
    (MIXED, {"mixed_cells": int32(2, 2)}),
    (MIXED, {"mixed_cells": int32(4, 2)}),
    (MIXED, {"mixed_cells": int32(2, 3)}),  # a cell that is split
    ("label is not among the labels seen in it", {"mixed_labels": uint64(0b101, 0b110)}),
    ("label is not among the labels seen in it", {"mixed_labels": uint64(0b011, 0)}),
    ("a mixed cell has an unknown label", {"mixed_labels": uint64(0b1011, 0b110)}),
    ("a mixed cell has an unknown label", {"mixed_labels": uint64(0b011, 2**63 | 0b110)}),
]


@pytest.mark.parametrize(("message", "changes"), MALFORMED)
def test_malformed_trees_are_refused(message, changes):
    GOOD.check(LEAVES)
    tree = dataclasses.replace(GOOD, **changes)
    with pytest.raises(PolicyFormatError, match=message):
        tree.check(LEAVES)


@pytest.mark.parametrize("grid", GRIDS)
def test_any_changed_entry_is_refused_or_another_well_formed_tree(grid):
    tree = random_tree(*grid, LEAVES, seed=4)
    rng = np.random.default_rng(5)
    refused = 0
    for place in rng.integers(0, len(tree.entries), 60):
        entries = tree.entries.copy()
        entries[place] = rng.integers(-5, len(entries) + 5)
        changed = dataclasses.replace(tree, entries=entries)
        try:
            changed.check(LEAVES)
        except PolicyFormatError:
            refused += 1
            continue
        assert (paint(changed, lambda x: np.ones(len(x.places), int)) == 1).all()
    assert refused


def test_all_64_leaf_numbers_are_usable():
    labels = np.arange(64)
    tree = CellTree(
        Grid((64,), (2,), 0),
        (-1 - labels).astype(np.int32),
        labels.astype(np.int32),
        np.full(64, 2**64 - 1, dtype=np.uint64),
    )
    tree.check(64)
    assert np.array_equal(tree.labels(labels[:, None]), labels)
    with pytest.raises(PolicyFormatError, match="a cell has an unknown label"):
        tree.check(63)
    entries = np.maximum(tree.entries, -63)
    with pytest.raises(PolicyFormatError, match="a mixed cell has an unknown label"):
        dataclasses.replace(tree, entries=entries).check(63)


def test_grids_spread_and_bound():
    assert Grid.of(9, [2, 3], 4, 2) == Grid((9, 9), (2, 3), 4)
    assert Grid((9, 9), (2, 3), 4).counts == (144, 729)
    assert Grid.of(1, 2, 30, 3).max_level == 30
    assert Grid.of(MAX_COUNT, 2, 0, 1) == Grid((MAX_COUNT,), (2,), 0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 2, 0, 1), f"`partitions` must be a whole number >= 1 and <= {MAX_COUNT}; got 0"),
        (([9, 9], 2, 0, 1), "`partitions` must be a whole number or 1 of them, one per axis; "),
        (([9, 0], 2, 0, 2), r"`partitions\[1\]` must be a whole number >= 1 and <= .*; got 0"),
        ((2**31, 2, 0, 1), f"`partitions` must be a whole number >= 1 and <= {MAX_COUNT}; got 2"),
        ((10**400, 2, 0, 1), "`partitions` must be a whole number >= 1 and <= .*; got 1000"),
        ((9, 1, 0, 1), f"`refinement` must be a whole number >= 2 and <= {MAX_COUNT}; got 1"),
        ((9, 2**40, 0, 1), f"`refinement` must be a whole number >= 2 and <= {MAX_COUNT}; got"),
        ((9, 2, -1, 1), "`max_level` must be a whole number >= 0 and <= 27; got -1"),
        ((9, 2, 28, 1), "`max_level` must be a whole number >= 0 and <= 27; got 28"),
        ((9, [2, 10], 9, 2), "`max_level` must be a whole number >= 0 and <= 8; got 9"),
        ((1, 2, 31, 1), "`max_level` must be a whole number >= 0 and <= 30; got 31"),
        ((9, 2, 2.0, 1), "`max_level` must be a whole number >= 0 and <= 27; got 2.0"),
    ],
)
def test_grids_refuse(arguments, message):
    with pytest.raises(ProblemError, match="^" + message):
        Grid.of(*arguments)
