"""Decision trees over lattices: lookups, boxes and starts; malformed trees are refused."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsyn.cells.split_tree import LEAF, MAX_DEPTH, START_NODES, SplitTree
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.modelling.grid import MAX_COUNT
from support.split_trees import LABELS, all_points, leaf_of, random_split_tree

LATTICES = [(1,), (2,), (13,), (5, 7), (1, 9), (16, 3), (4, 3, 5), (2, 3, 2, 3)]


def int32(*values):
    return np.array(values, dtype=np.int32)


def chain(depth, counts=(MAX_COUNT,)):
    """Return a tree whose second children go ``depth`` comparisons deep."""
    inner = np.arange(depth)
    split = np.append(np.tile([0, LEAF], depth), LEAF)
    threshold = np.append(np.stack([1 + inner, inner % 2], axis=1).ravel(), 1)
    second = np.arange(2 * depth + 1)
    second[:-1:2] += 2
    arrays = (x.astype(np.int32) for x in (split, threshold, second))
    return SplitTree(counts, *arrays, np.zeros((0, len(counts)), np.int32))


@pytest.mark.parametrize("counts", LATTICES)
@pytest.mark.parametrize("planes", [0, 1, 4])
@pytest.mark.parametrize("seed", range(3))
def test_find_and_labels_are_those_of_the_rule(counts, planes, seed):
    tree = random_split_tree(counts, planes, seed=seed)
    tree.check(LABELS)
    points = all_points(counts)
    leaves = np.array([leaf_of(tree, z.tolist())[0] for z in points])
    assert np.array_equal(tree.find(points), leaves)
    assert (tree.split[leaves] == LEAF).all()
    assert np.array_equal(tree.labels(points), tree.threshold[leaves])
    assert np.array_equal(tree.labels_at(leaves), tree.threshold[leaves])
    order = np.random.default_rng(0).permutation(len(points))
    assert np.array_equal(tree.find(points[order]), leaves[order])


@pytest.mark.parametrize("planes", [0, 2])
def test_find_takes_no_points(planes):
    tree = random_split_tree((4, 3), planes)
    assert tree.find(np.empty((0, 2), dtype=np.int64)).shape == (0,)


@pytest.mark.parametrize("counts", LATTICES)
@pytest.mark.parametrize("planes", [0, 3])
def test_counts_depths_and_children(counts, planes):
    tree = random_split_tree(counts, planes, seed=5)
    depths = {0: 0}
    for node in range(tree.node_count):
        if tree.split[node] == LEAF:
            assert tree.first[node] == tree.second[node] == node
        else:
            assert tree.first[node] == node + 1
            for child in (tree.first[node], tree.second[node]):
                assert int(child) not in depths
                depths[int(child)] = depths[node] + 1
    assert tree.depths.tolist() == [depths[node] for node in range(tree.node_count)]
    assert tree.depth == max(depths.values())
    leaves = np.flatnonzero(tree.split == LEAF)
    assert np.array_equal(tree.mixed_cells, leaves) and tree.leaf_count == len(leaves)
    assert tree.node_count == 2 * len(leaves) - 1 and tree.n == len(counts)


@pytest.mark.parametrize("counts", LATTICES)
@pytest.mark.parametrize("seed", range(3))
def test_parts_tile_boxes_and_lie_in_their_leaves(counts, seed):
    tree = random_split_tree(counts, seed=seed)
    rng = np.random.default_rng(seed)
    corners = np.sort(rng.integers(0, np.array(counts) + 1, (2, 9, len(counts))), axis=0)
    lower, upper = corners[:, (corners[0] < corners[1]).all(axis=1)]
    lower, upper = np.vstack([lower, np.zeros(len(counts), int)]), np.vstack([upper, counts])
    leaf, box, low, high = tree.parts(lower, upper)
    assert (tree.split[leaf] == LEAF).all()
    for number in range(len(lower)):
        canvas = np.full(counts, -1)
        for i in np.flatnonzero(box == number):
            inside = tuple(map(slice, low[i], high[i]))
            assert canvas[inside].size and (canvas[inside] == -1).all()
            canvas[inside] = leaf[i]
        points = all_points(counts)
        held = ((points >= lower[number]) & (points < upper[number])).all(axis=1)
        assert np.array_equal(canvas.ravel(), np.where(held, tree.find(points), -1))


@pytest.mark.parametrize("counts", LATTICES)
def test_boxes_are_the_leaves_in_order(counts):
    tree = random_split_tree(counts, seed=7)
    boxes = tree.boxes()
    points = all_points(counts)
    canvas = np.full(counts, -1)
    for place, low, high in zip(boxes.places, boxes.lower, boxes.upper):
        inside = tuple(map(slice, low, high))
        assert (canvas[inside] == -1).all()
        canvas[inside] = place
    assert np.array_equal(canvas.ravel(), tree.find(points))
    assert (np.diff(boxes.places) > 0).all() and not boxes.levels.any()
    assert np.array_equal(boxes.labels, tree.threshold[boxes.places])
    assert boxes.volumes().sum() == math.prod(counts)


@pytest.mark.parametrize("threshold", [-3, 0, 5, 1000])
def test_splits_beyond_the_lattice_are_refused(threshold):
    tree = random_split_tree((5, 7), seed=3)
    wrong = tree.threshold.copy()
    wrong[np.flatnonzero(tree.split == 0)[0]] = threshold
    with pytest.raises(PolicyFormatError, match="splits an axis beyond its lattice"):
        dataclasses.replace(tree, threshold=wrong).check(LABELS)


def test_oblique_trees_have_no_boxes():
    tree = random_split_tree((5, 7), planes=1)
    for ask in (tree.boxes, lambda: tree.parts(np.zeros((1, 2), int), np.array([[5, 7]]))):
        with pytest.raises(ProblemError, match="^a tree with oblique splits has no boxes; .*$"):
            ask()


@pytest.mark.parametrize("factors", [(1, 1), (2, 2), (3, 1), (4, 5)])
def test_a_refined_tree_gives_the_same_on_a_finer_lattice(factors):
    tree = random_split_tree((5, 7), seed=3)
    fine = tree.refined((5 * factors[0], 7 * factors[1]))
    fine.check(LABELS)
    points = all_points(fine.counts)
    assert np.array_equal(fine.find(points), tree.find(points // factors))
    assert fine.threshold.dtype == np.int32


@pytest.mark.parametrize("counts", LATTICES)
@pytest.mark.parametrize("planes", [0, 2])
@pytest.mark.parametrize("most", [1, 4, 30, START_NODES])
def test_starts_are_the_deepest_nodes_that_hold_a_block(counts, planes, most, monkeypatch):
    monkeypatch.setattr("capsyn.cells.split_tree.START_NODES", most)
    monkeypatch.setattr("capsyn.cells.split_tree.STARTS_PER_NODE", 0)
    tree = random_split_tree(counts, planes, seed=len(counts) + planes)
    shift, starts = tree.starts
    shape = tuple(((c - 1) >> shift) + 1 for c in counts)
    assert len(starts) == math.prod(shape) <= most and starts.dtype == np.int32
    if shift:  # no finer blocks would do
        assert math.prod(((c - 1) >> (shift - 1)) + 1 for c in counts) > most
    points = all_points(counts)
    ways = [leaf_of(tree, z.tolist())[1] for z in points]
    blocks = np.ravel_multi_index(tuple((points >> shift).T), shape)
    for way, block in zip(ways, blocks):
        assert starts[block] in way
    if planes:
        return
    for block in range(len(starts)):  # where splits are along axes the least box is tight
        inside = [way for way, b in zip(ways, blocks) if b == block]
        common = list(itertools.takewhile(lambda x: len(set(x)) == 1, zip(*inside)))
        assert starts[block] == common[-1][0]


def test_starts_of_the_last_block_know_where_the_lattice_ends(monkeypatch):
    monkeypatch.setattr("capsyn.cells.split_tree.START_NODES", 4)
    monkeypatch.setattr("capsyn.cells.split_tree.STARTS_PER_NODE", 1)
    none = np.zeros((0, 1), np.int32)
    tree = SplitTree((13,), int32(0, -1, -1), int32(14, 0, 1), int32(2, 1, 2), none)
    assert tree.starts[0] == 2 and tree.starts[1].tolist() == [1, 1, 1, 1]
    sums = SplitTree((13,), int32(1, -1, -1), int32(25, 0, 1), int32(2, 1, 2), int32([2]))
    assert sums.starts[1].tolist() == [1, 1, 1, 1] and sums.labels(np.array([[12]])) == 0


def test_starts_are_few_on_huge_lattices():
    tree = chain(3, (MAX_COUNT, MAX_COUNT))
    shift, starts = tree.starts
    assert START_NODES / 4 < len(starts) <= START_NODES and shift > 20
    many = random_split_tree((2,) * 14)
    shift, starts = many.starts
    assert shift == 1 and len(starts) == 1 and starts[0] == 0


@pytest.mark.parametrize("planes", [0, 2])
def test_rows_are_the_nodes_for_walks(planes):
    tree = random_split_tree((5, 7), planes, seed=1)
    rows = tree.rows
    assert rows.dtype == np.int32 and rows.flags.c_contiguous and rows.shape == (len(rows), 4)
    for node, (split, threshold, first, second) in enumerate(rows.tolist()):
        leaf = tree.split[node] == LEAF
        assert split == (0 if leaf else tree.split[node]) and threshold == tree.threshold[node]
        assert (first, second) == ((node, node) if leaf else (node + 1, tree.second[node]))


def test_arrays_cannot_be_written():
    tree = random_split_tree((5, 7), 1)
    for name in ("split", "threshold", "second", "planes"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(tree, name)[0] = 0


GOOD = SplitTree(  # x < 2: label 0; else by the plane x - y: label 1 or 2
    (4, 3), int32(0, -1, 2, -1, -1), int32(2, 0, 1, 1, 2), int32(2, 1, 4, 3, 4), int32([1, -1])
)
LENGTH = "the arrays of the tree differ in length, or are empty"
AXIS = "a node of the tree splits an unknown axis"
LABEL = "a leaf of the tree has an unknown label"
TREE = "the nodes are not one tree in depth-first order"
PLANES = "the tree's planes must have 2 coefficients"
NONE = int32()
MALFORMED = [
    (LENGTH, {"split": NONE, "threshold": NONE, "second": NONE}),
    (LENGTH, {"threshold": int32(2, 0, 1, 1)}),
    (LENGTH, {"second": int32(2, 1, 4, 3, 4, 5)}),
    (LENGTH, {"split": int32(0, -1, 2, -1)}),
    (AXIS, {"split": int32(0, -1, 3, -1, -1)}),
    (AXIS, {"split": int32(0, -1, 2**31 - 1, -1, -1)}),
    (AXIS, {"split": int32(0, -1, -2, -1, -1)}),
    (AXIS, {"planes": np.zeros((0, 2), np.int32)}),
    (LABEL, {"threshold": int32(2, 0, 1, 1, 3)}),
    (LABEL, {"threshold": int32(2, -1, 1, 1, 2)}),
    (LABEL, {"threshold": int32(2, 0, 1, -(2**31), 2)}),
    (TREE, {"second": int32(0, 1, 4, 3, 4)}),  # a node that is its own child
    (TREE, {"second": int32(2, 1, 0, 3, 4)}),  # a cycle
    (TREE, {"second": int32(2, 1, -1, 3, 4)}),
    (TREE, {"second": int32(2, 2, 4, 3, 4)}),  # a leaf with a child
    (TREE, {"second": int32(2, 1, 4, 3, 3)}),
    (TREE, {"second": int32(4, 1, 4, 3, 4)}),  # two parents
    (TREE, {"second": int32(1, 1, 4, 3, 4)}),  # both children the same
    (TREE, {"second": int32(2, 1, 3, 3, 4)}),
    (TREE, {"second": int32(2, 1, 5, 3, 4)}),  # beyond the end
    (TREE, {"second": int32(2, 1, 2**31 - 1, 3, 4)}),
    (TREE, {"split": int32(0, -1, -1, -1, -1), "second": int32(2, 1, 2, 3, 4)}),  # no parent
    (TREE, {"split": int32(0, -1, 2, -1, 0), "second": int32(2, 1, 4, 3, 5)}),
    (  # nodes after the whole tree
        TREE,
        {
            "split": int32(-1, 0, 2, -1, -1),
            "threshold": int32(0, 1, 1, 1, 2),
            "second": int32(0, 5, 4, 3, 4),
        },
    ),
    (  # in another order
        TREE,
        {"split": int32(0, 0, -1, -1, -1), "second": int32(3, 4, 2, 3, 4)},
    ),
    (PLANES, {"planes": int32([1, -1, 0])}),
    (PLANES, {"planes": int32([1])}),
    (PLANES, {"planes": np.zeros(2, np.int32)}),
    (PLANES, {"planes": np.zeros((1, 2, 1), np.int32)}),
    ("the tree's lattice has ", {"counts": (4, 0)}),
    ("the tree's lattice has ", {"counts": (4, 2**31)}),
    ("a plane of the tree has sums beyond 32 bits", {"planes": int32([2**29, 1])}),
    ("a plane of the tree has sums beyond 32 bits", {"planes": int32([1, -(2**31)])}),
    ("a plane of the tree has sums beyond 32 bits", {"counts": (2**30, 2**30 + 1)}),
]


@pytest.mark.parametrize(("message", "changes"), MALFORMED)
def test_malformed_trees_are_refused(message, changes):
    GOOD.check(LABELS)
    with pytest.raises(PolicyFormatError, match=message) as caught:
        dataclasses.replace(GOOD, **changes).check(LABELS)
    assert "\n" not in str(caught.value)


def test_sums_of_32_bits_are_enough():
    dataclasses.replace(GOOD, planes=int32([2**29 - 1, 1])).check(LABELS)
    dataclasses.replace(GOOD, counts=(2**30, 2**30 - 1)).check(LABELS)


def test_a_tree_may_be_so_deep_and_no_deeper():
    deepest = chain(MAX_DEPTH)
    deepest.check(2)
    assert deepest.depth == MAX_DEPTH
    assert deepest.labels(np.array([[MAX_DEPTH - 1], [MAX_DEPTH]])).tolist() == [1, 1]
    for depth in (MAX_DEPTH + 1, MAX_DEPTH + 2, 5 * MAX_DEPTH):
        with pytest.raises(PolicyFormatError, match="takes more than 1000 comparisons"):
            chain(depth).check(2)


@given(st.integers(0, 10_000))
def test_any_changed_number_is_refused_or_another_well_formed_tree(seed):
    rng = np.random.default_rng(seed)
    counts = LATTICES[seed % len(LATTICES)]
    tree = random_split_tree(counts, seed % 3, depth=4, seed=seed)
    name = ("split", "threshold", "second")[rng.integers(3)]
    changed = getattr(tree, name).copy()
    changed[rng.integers(len(changed))] = rng.integers(-3, len(changed) + 3)
    other = dataclasses.replace(tree, **{name: changed})
    try:
        other.check(LABELS)
    except PolicyFormatError as error:
        assert "\n" not in str(error)
        return
    points = all_points(counts)
    leaves = np.array([leaf_of(other, z.tolist())[0] for z in points])
    assert np.array_equal(other.find(points), leaves)
    assert other.threshold[leaves].min() >= 0 and other.threshold[leaves].max() < LABELS
