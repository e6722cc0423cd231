"""Trees of least cost of small grids, against plain recursion over all cuts."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn.compression.optimal import FORBIDDEN, optimal_splits, sub_box_count

SHAPES = [(1,), (2,), (7,), (12,), (1, 1), (3, 4), (5, 5), (1, 6), (2, 3, 2), (3, 3, 3)]


def penalties(shape, labels, seed, priced, batch=3):
    """Return penalties of random grids in which every cell may take some label."""
    rng = np.random.default_rng(seed)
    full = (batch, labels, *shape)
    cost = rng.integers(0, 9, full) if priced else np.zeros(full, dtype=np.int64)
    if priced and seed % 2:
        cost[rng.random(full) < 0.5] = 0
    allowed = rng.random(full) < (0.5 if priced else 0.3)
    kept = rng.integers(0, labels, (batch, *shape))
    allowed |= np.moveaxis(np.arange(labels) == kept[..., None], -1, 1)
    return np.where(allowed, cost, FORBIDDEN).astype(np.int64)


def least(penalty, leaf_price):
    """Return the least cost of one grid (L, k1, ..), and the least leaves that it takes."""

    @functools.cache
    def best(low, high):
        part = penalty[(slice(None), *map(slice, low, high))]
        found = (int(part.reshape(len(part), -1).sum(axis=1).min()) + leaf_price, 1)
        for axis in range(len(low)):
            for cut in range(low[axis] + 1, high[axis]):
                middle_high = (*high[:axis], cut, *high[axis + 1 :])
                middle_low = (*low[:axis], cut, *low[axis + 1 :])
                one, two = best(low, middle_high), best(middle_low, high)
                found = min(found, (one[0] + two[0], one[1] + two[1]))
        return found

    return best((0,) * (penalty.ndim - 1), penalty.shape[1:])


def walk(found, root, shape):
    """Return the boxes of the leaves of one tree, and how many nodes it has."""
    axis, cut, first, second = found
    stack, boxes = [(root, (0,) * len(shape), shape)], []
    nodes = set()
    while stack:
        node, low, high = stack.pop()
        assert node not in nodes
        nodes.add(node)
        a = axis[node]
        if a < 0:
            assert first[node] == second[node] == cut[node] == -1
            boxes.append((low, high))
            continue
        k = int(cut[node])
        assert low[a] < k < high[a]  # both parts hold cells
        stack.append((int(first[node]), low, (*high[:a], k, *high[a + 1 :])))
        stack.append((int(second[node]), (*low[:a], k, *low[a + 1 :]), high))
    return boxes, nodes


def check(penalty, leaf_price):
    found = optimal_splits(penalty, leaf_price)
    shape, seen = penalty.shape[2:], set()
    for root in range(len(penalty)):
        boxes, nodes = walk(found, root, shape)
        seen |= nodes
        cost = 0
        for low, high in boxes:
            part = penalty[(root, slice(None), *map(slice, low, high))]
            own = int(part.reshape(len(part), -1).sum(axis=1).min())
            assert own < FORBIDDEN  # some label is allowed in the whole leaf
            cost += own + leaf_price
        wanted, leaves = least(penalty[root], leaf_price)
        assert cost == wanted
        if not (penalty % FORBIDDEN).any():
            assert len(boxes) == leaves
    assert seen == set(range(len(found[0])))  # each node belongs to one tree


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("priced", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_trees_are_of_least_cost(shape, priced, seed):
    penalty = penalties(shape, 2 + seed, seed, priced)
    for leaf_price in (1, 5, 40):
        check(penalty, leaf_price)


@settings(max_examples=40)
@given(st.lists(st.integers(1, 4), min_size=1, max_size=3), st.integers(1, 4), st.integers(0, 999))
def test_trees_of_random_grids(shape, labels, seed):
    check(penalties(tuple(shape), labels, seed, seed % 3 > 0, batch=2), 1 + seed % 7)


@pytest.mark.parametrize("price", [1, 2**12, 2**15, 2**29, 2**31])
def test_every_size_of_prices(price):
    penalty = penalties((3, 4), 3, 4, True)
    penalty[penalty < FORBIDDEN] *= price
    check(penalty, price)
    check(penalty, 1)


def test_two_halves_take_one_cut():
    cells = np.array([0, 0, 1, 1, 1])
    penalty = np.where(np.arange(2)[:, None] == cells, 0, FORBIDDEN)[None]
    axis, cut, first, second = optimal_splits(penalty)
    assert axis.tolist() == [0, -1, -1] and cut[0] == 2
    assert {int(first[0]), int(second[0])} == {1, 2}


def test_of_equal_cuts_the_most_even_one_is_taken():
    cells = np.arange(8)
    penalty = np.where(np.arange(8)[:, None] == cells, 0, FORBIDDEN)[None]
    axis, cut, first, second = optimal_splits(penalty)
    depth = {0: 0}
    for node in range(len(axis)):
        if axis[node] >= 0:
            depth[int(first[node])] = depth[int(second[node])] = depth[node] + 1
    assert max(depth.values()) == 3 and cut[0] == 4


def test_a_leaf_that_costs_as_much_as_its_parts_stays_whole():
    penalty = np.array([[[0, 5], [5, 0]]])
    assert optimal_splits(penalty, 5)[0].tolist() == [-1]
    assert sorted(optimal_splits(penalty, 4)[0].tolist()) == [-1, -1, 0]


@pytest.mark.parametrize("shape", SHAPES)
def test_sub_boxes_are_counted(shape):
    corners = [[(a, b) for a in range(k) for b in range(a + 1, k + 1)] for k in shape]
    assert sub_box_count(shape) == functools.reduce(lambda x, y: x * len(y), corners, 1)
