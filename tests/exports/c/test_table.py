"""The table of nodes: skips, and how many nodes a lookup reads."""

import functools
import time

import numpy as np
import pytest

from capsyn.cells.split_tree import LEAF
from capsyn.exports.c.styles import table as c_table
from support.exports.c_machines import (
    Library,
)
from support.exports.c_plans import (
    files,
    plan_of,
    random_plan,
)


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a", "cart-pole"])
def test_few_nodes_are_read(name):
    tree = plan_of(name).tree.cells
    skips = c_table.best_skips(tree)
    assert c_table.nodes_read(tree, skips) <= c_table.most_read(tree)
    assert skips == 0 or c_table.nodes_read(tree, skips - 1) > c_table.most_read(tree)
    assert c_table.nodes_read(tree, tree.depth) == tree.depth + 1
    assert c_table.nodes_read(tree, 0) <= tree.node_count


def test_nodes_read_are_those_of_the_code():
    tree = plan_of("lopsided").tree.cells
    for skips in (0, 3, tree.depth):
        most, todo = 0, [(0, 0, 1)]
        while todo:
            node, depth, read = todo.pop()
            most = max(most, read)
            if tree.split[node] != LEAF:
                over = tree.second[node] - node - 1 if depth >= skips else 0
                todo += [(node + 1, depth + 1, read + 1)]
                todo += [(tree.second[node], depth + 1, read + 1 + over)]
        assert c_table.nodes_read(tree, skips) == most


def test_skips_of_a_large_tree_are_found_fast():
    tree = random_plan(1 << 20, depth=18).tree.cells
    assert tree.node_count > 100_000
    started = time.process_time()
    assert c_table.nodes_read(tree, c_table.best_skips(tree)) <= c_table.most_read(tree)
    assert time.process_time() - started < 2


def test_skips_wider_than_a_window(tmp_path, monkeypatch):
    wide = functools.partial(c_table.layout, skip=30)
    monkeypatch.setattr(c_table, "layout", wide)
    plan = random_plan(1 << 30)
    form = wide(plan.tree.cells, c_table.best_skips(plan.tree.cells))
    assert form.node + form.skip > 57 and form.apart and form.window == 8
    steps = np.random.default_rng(0).integers(1 << 30, size=(3000, 2))
    library = Library(files(plan, None), tmp_path, 2)
    assert np.array_equal(library.look(steps), plan.tree.cells.labels(steps))
