"""Style table: skips, mirrors, references, and how many nodes a lookup reads."""

import dataclasses
import functools
import itertools
import time

import numpy as np
import pytest

from capsyn.cells.split_tree import LEAF, SplitTree, depth_first
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.styles import mirrors as c_mirrors
from capsyn.exports.c.styles import stream as c_stream
from capsyn.exports.c.styles.diagram import Diagram, ordered
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import OK
from support.exports.c_machines import (
    Library,
    avr,
    cortex_m3,
    need,
)
from support.exports.c_plans import (
    UNDEFINED,
    assert_golden,
    files,
    golden_of,
    made,
    of_vectors,
    plan_of,
    plan_of_nodes,
    random_plan,
)
from support.trees import random_split_tree


def reflected(tree, axes, turned, pivot):
    """Return a tree that has the labels of one before the middle of an axis, and its mirror."""
    middle = (tree.counts[pivot] + 1) // 2

    def look(node):
        i, mirror = node
        if i is None:
            return pivot, middle, [(0, False), (0, True)]
        axis, threshold = int(tree.split[i]), int(tree.threshold[i])
        if axis == LEAF:
            return LEAF, turned[threshold] if mirror else threshold, []
        children = [(i + 1, mirror), (int(tree.second[i]), mirror)]
        if mirror and axis in axes:
            return axis, tree.counts[axis] - threshold, children[::-1]
        return axis, threshold, children

    return depth_first(tree.counts, (None, False), look)


def steps_of(tree, count=4000):
    return np.random.default_rng(1).integers(tree.counts, size=(count, tree.n))


def read(stream, steps):
    """Return label and number of windows that the C code would take, bit by bit."""
    form, value = stream.form, int.from_bytes(stream.data, "little")
    at = depth = reads = 0

    def window():
        nonlocal reads
        reads += 1
        return value >> at

    def field(bits, shift, width):
        return bits >> shift & (1 << width) - 1

    bits = window()
    while bits & 1:
        cut = field(bits, 1 + form.axis, form.threshold)
        beyond = steps[field(bits, 1, form.axis)] >= cut
        at += form.node
        if depth < form.skips:
            at += form.skip + beyond * field(bits, form.node, form.skip)
        elif beyond:
            left = 1
            while left:
                bits = window()
                if bits & 1:
                    at, left = at + form.node, left + 1
                else:
                    refers = form.reference and field(bits, 1, form.label) == form.refers
                    at, left = at + 1 + form.label + refers * form.reference, left - 1
        depth, bits = depth + 1, window()
        if form.reference and bits & 1 == 0 and field(bits, 1, form.label) == form.refers:
            at, depth = field(bits, 1 + form.label, form.reference), max(depth, form.skips)
            bits = window()
    return field(bits, 1, form.label), reads


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a", "cart-pole"])
def test_few_nodes_are_read(name):
    tree = plan_of(name).tree.cells
    most, diagram = c_stream.most_read(tree), Diagram.of(tree)
    skips = c_stream.best_skips(tree, most)
    assert diagram.nodes_read(skips) <= most
    assert skips == 0 or diagram.nodes_read(skips - 1) > most
    assert diagram.nodes_read(tree.depth) == tree.depth + 1
    assert diagram.nodes_read(0) <= tree.node_count
    assert diagram.comparisons == tree.depth
    assert c_stream.stream(tree).figures["nodes_read"] <= most


def test_nodes_read_are_those_of_the_code():
    tree = plan_of("lopsided").tree.cells
    for skips in (0, 3, tree.depth):
        most, todo = 0, [(0, 0, 1)]
        while todo:
            node, depth, so_far = todo.pop()
            most = max(most, so_far)
            if tree.split[node] != LEAF:
                over = tree.second[node] - node - 1 if depth >= skips else 0
                todo += [(node + 1, depth + 1, so_far + 1)]
                todo += [(tree.second[node], depth + 1, so_far + 1 + over)]
        assert Diagram.of(tree).nodes_read(skips) == most


@pytest.mark.parametrize("name", ["lopsided", "cart-pole"])
@pytest.mark.parametrize("skips", [0, 2, 5, 40])
def test_a_diagram_is_its_tree(name, skips):
    tree = plan_of(name).tree.cells
    diagram = ordered(tree).written(skips)
    form = c_stream.layout(diagram, skips)
    assert (diagram.references > 0) == (name == "cart-pole" and skips < 40)
    assert (diagram.tree.depths[diagram.target[diagram.target >= 0]] >= skips).all()
    written = c_stream.Stream((), diagram, form, c_stream.encode(diagram, form))
    steps = steps_of(tree, 3000)
    labels, reads = np.array([read(written, z) for z in steps.tolist()]).T
    assert np.array_equal(labels, tree.labels(steps))
    assert reads.max() <= diagram.nodes_read(skips)


def test_nodes_read_of_a_diagram_are_reached():
    """A path through references is counted as the code walks it, at its worst."""
    tree = random_split_tree((8, 8, 8), labels=2, depth=9, seed=3)
    rows = ordered(tree)
    steps = np.stack(np.indices(tree.counts), axis=-1).reshape(-1, 3)
    seen = 0
    for skips in (0, 3):
        diagram = rows.written(skips)
        form = c_stream.layout(diagram, skips)
        written = c_stream.Stream((), diagram, form, c_stream.encode(diagram, form))
        reads = max(read(written, z)[1] for z in steps.tolist())
        assert reads == diagram.nodes_read(skips)
        seen += diagram.references
    assert seen


def test_equal_subtrees_are_written_once():
    # z1 matters only where z0 < 2 or z0 >= 6, and in the same way
    split = [0, 1, -1, -1, 0, -1, 1, -1, -1]
    plan = plan_of_nodes((8, 8), split, [2, 3, 0, 1, 6, 0, 3, 0, 1])
    diagram = ordered(plan.tree.cells).written(0)
    assert (diagram.references, diagram.tree.node_count) == (1, 7)
    assert diagram.comparisons == 3


@pytest.mark.parametrize(
    ("counts", "axes", "turned", "reversal"),
    [
        ((50,), (0,), (2, 1, 0), 2),
        ((21, 40), (0,), (0, 1, 2), None),
        ((40, 21), (0, 1), (1, 0, 2), None),
        ((9, 16, 12), (0, 1), (1, 2 - 1 - 1, 2), None),
        ((12, 12, 12), (0, 1, 2), (3, 2, 1, 0), 3),
    ],
)
@pytest.mark.parametrize("style", ["table"])
def test_mirrors_of_a_symmetric_tree(tmp_path, counts, axes, turned, reversal, style):
    pivot = max(axes, key=lambda a: counts[a] - 0.1 * a)
    seed = random_split_tree(counts, labels=len(turned), depth=7, seed=2)
    if counts[pivot] % 2:  # the layer in the middle is its own mirror
        axes = (pivot,)
    tree = reflected(seed, axes, turned, pivot)
    steps = steps_of(tree)
    last = np.array(counts) - 1
    (mirror,) = c_mirrors.mirrors(tree)
    assert (mirror.pivot, mirror.axes) == (pivot, axes)
    other = tree.labels(np.where(np.isin(np.arange(len(counts)), axes), last - steps, steps))
    assert np.array_equal(np.array(mirror.turned)[tree.labels(steps)], other)
    if mirror.turns:
        assert mirror.reversal == reversal
    half = c_mirrors.half(tree, mirror)
    before = steps[steps[:, pivot] < c_mirrors.middle(tree, mirror)]
    assert np.array_equal(half.labels(before), tree.labels(before))
    assert half.node_count < 0.6 * tree.node_count
