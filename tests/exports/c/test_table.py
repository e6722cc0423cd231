"""Style table: skips, mirrors, references, and how many nodes a lookup reads."""

import dataclasses
import functools
import json
import time

import numpy as np
import pytest

from capsyn.cells.split_tree import LEAF, depth_first
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.styles import diagram as c_diagram
from capsyn.exports.c.styles import mirrors as c_mirrors
from capsyn.exports.c.styles import stream as c_stream
from capsyn.exports.c.styles import table as c_table
from capsyn.exports.c.styles.diagram import Diagram, ordered
from capsyn.exports.export import export
from capsyn.exports.plan import OK
from support.exports.c_machines import (
    Library,
    avr,
    cortex_m3,
    need,
)
from support.exports.c_plans import (
    UNDEFINED,
    files,
    golden_of,
    made,
    of_vectors,
    plan_of,
    plan_of_nodes,
    random_plan,
)
from support.split_trees import random_split_tree


def reflected(tree, axes, turned, pivot):
    """Return a tree that is one before the middle of an axis, and beyond it what that reflects."""
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


def stairs(counts, least):
    """Return a tree whose label is whether the sum of steps is at least so much."""

    def look(box):
        lower, upper = box
        if sum(lower) >= least or sum(upper) - len(upper) < least:
            return LEAF, int(sum(lower) >= least), []
        axis = int(np.argmax(np.subtract(upper, lower)))
        cut = (lower[axis] + upper[axis]) // 2
        below, above = list(upper), list(lower)
        below[axis] = above[axis] = cut
        return axis, cut, [(lower, below), (above, upper)]

    return depth_first(counts, ([0] * len(counts), list(counts)), look)


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
    assert (diagram.references > 0) == (skips < 40)
    assert (diagram.tree.depths[diagram.target[diagram.target >= 0]] >= skips).all()
    written = c_stream.Stream((), diagram, form, c_stream.encode(diagram, form))
    steps = steps_of(tree, 3000)
    labels, reads = np.array([read(written, z) for z in steps.tolist()]).T
    assert np.array_equal(labels, tree.labels(steps))
    assert reads.max() <= diagram.nodes_read(skips)


def test_nodes_read_of_a_diagram_are_reached():
    """A path through references is counted as the code walks it, at its worst."""
    tree = stairs((6, 6, 6), 8)
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


def test_lines_of_the_same_key_are_told_apart(monkeypatch):
    tree = stairs((6, 6, 6), 8)
    expected = ordered(tree)
    monkeypatch.setattr(c_diagram, "_factors", lambda count: np.ones(count, dtype=np.uint64))
    found = ordered(tree)
    assert len(found.rows) == len(expected.rows)
    steps = np.stack(np.indices(tree.counts), axis=-1).reshape(-1, 3)
    diagram = found.written(0)
    form = c_stream.layout(diagram, 0)
    written = c_stream.Stream((), diagram, form, c_stream.encode(diagram, form))
    labels = [read(written, z)[0] for z in steps.tolist()]
    assert np.array_equal(labels, tree.labels(steps))


def test_equal_subtrees_are_written_once():
    # the label is the parity of three comparisons
    split = [0, 1, 2, -1, -1, 2, -1, -1, 1, 2, -1, -1, 2, -1, -1]
    threshold = [4, 3, 2, 0, 1, 2, 1, 0, 3, 2, 1, 0, 2, 0, 1]
    diagram = ordered(plan_of_nodes((8, 8, 8), split, threshold).tree.cells).written(0)
    assert (diagram.references, diagram.tree.node_count) == (2, 5 + 4 + 2)
    assert diagram.comparisons == 3


@pytest.mark.parametrize(
    ("counts", "axes", "turned", "reversal"),
    [
        ((50,), (0,), (2, 1, 0), 2),
        ((21, 12), (0,), (0, 1, 2), None),  # the layer in the middle is its own mirror
        ((40, 21), (0, 1), (1, 0, 2), None),
        ((9, 16, 12), (0, 1), (2, 1, 0), 2),
        ((12, 12, 12), (0, 1, 2), (3, 2, 1, 0), 3),
    ],
)
def test_mirrors_of_a_symmetric_tree(tmp_path, monkeypatch, counts, axes, turned, reversal):
    n, last, pivot = len(counts), np.array(counts) - 1, int(np.argmax(counts))
    some = random_split_tree(counts, labels=len(turned), depth=8, seed=2)
    tree = reflected(some, axes, turned, pivot)
    (mirror,) = c_mirrors.mirrors(tree)
    assert (mirror.pivot, mirror.axes) == (pivot, axes)
    steps = steps_of(tree)
    other = tree.labels(np.where(np.isin(np.arange(n), axes), last - steps, steps))
    assert np.array_equal(np.array(mirror.turned)[tree.labels(steps)], other)
    assert mirror.turns == (turned != (0, 1, 2))
    assert mirror.reversal == reversal
    half = c_mirrors.half(tree, mirror)
    before = steps[steps[:, pivot] < c_mirrors.middle(tree, mirror)]
    assert np.array_equal(half.labels(before), tree.labels(before))
    monkeypatch.setattr(c_stream, "MIRRORED_AXIS", 0)
    monkeypatch.setattr(c_stream, "TURNED_LABELS", 0)
    plan = plan_of_nodes(counts, tree.split, tree.threshold, label_count=len(turned))
    written = made(plan)
    assert written.written["mirrors"] == [list(axes)]
    library = Library(written.files, tmp_path, n, "gcc", UNDEFINED)
    ends = np.array([-32768, -32767, -1, 0, 32766, 32767])
    far = np.stack(np.meshgrid(*[ends] * n), axis=-1).reshape(-1, n)
    steps = np.concatenate([steps, far, steps_of(tree) * 3 - last])
    assert np.array_equal(library.look(steps), tree.labels(np.clip(steps, 0, last)))


def test_a_cell_that_breaks_a_symmetry_is_found(monkeypatch):
    monkeypatch.setattr(c_mirrors, "SAMPLES", (1,))  # samples miss it
    tree = plan_of("cart-pendulum").tree.cells
    assert [mirror.axes for mirror in c_mirrors.mirrors(tree)] == [(0,), (1,)]
    boxes = tree.boxes()
    leaf = boxes.places[np.argmin(boxes.volumes())]
    threshold = tree.threshold.copy()
    threshold[leaf] = 1 - threshold[leaf]
    broken = dataclasses.replace(tree, threshold=threshold)
    assert c_mirrors.mirrors(broken) == []
    stream = c_stream.stream(broken)
    assert not stream.mirrors
    steps = np.concatenate([steps_of(tree, 500), boxes.lower[boxes.places == leaf]])
    labels = [read(stream, z)[0] for z in steps.tolist()]
    assert np.array_equal(labels, broken.labels(steps))


def test_a_symmetry_of_some_axes_together():
    # none of one axis alone, and the one of both has no other axis' pivot
    some = random_split_tree((12, 14), labels=2, depth=8, seed=4)
    tree = reflected(reflected(some, (0,), (0, 1), 0), (0, 1), (1, 0), 1)
    found = {mirror.axes: mirror.turned for mirror in c_mirrors.mirrors(tree)}
    assert found == {(0,): (0, 1), (1,): (1, 0)}
    tree = reflected(some, (0, 1), (1, 0), 1)
    assert [mirror.axes for mirror in c_mirrors.mirrors(tree)] == [(0, 1)]


def test_mirrors_that_share_an_axis(tmp_path, monkeypatch):
    # found are first those of axes 0 and 1, then that of 1 and 2: what is left is not on its pivot
    counts, turned = (16, 14, 12), (1, 0, 2)
    some = random_split_tree(counts, labels=3, depth=8, seed=5)
    tree = reflected(reflected(some, (0, 2), (0, 1, 2), 0), (1, 2), turned, 1)
    found = {mirror.axes: (mirror.pivot, mirror.turned) for mirror in c_mirrors.mirrors(tree)}
    assert found == {(0, 2): (0, (0, 1, 2)), (1, 2): (1, turned)}
    monkeypatch.setattr(c_stream, "MIRRORED_AXIS", 0)
    monkeypatch.setattr(c_stream, "TURNED_LABELS", 0)
    written = made(plan_of_nodes(counts, tree.split, tree.threshold, label_count=3))
    assert len(written.written["mirrors"]) == 2
    steps = np.concatenate([steps_of(tree), steps_of(tree) * 3 - 12])
    library = Library(written.files, tmp_path, 3, "gcc", UNDEFINED)
    last = np.array(counts) - 1
    assert np.array_equal(library.look(steps), tree.labels(np.clip(steps, 0, last)))


@pytest.mark.parametrize("case", ["above a skip", "wider than a node"])
def test_references(tmp_path, monkeypatch, case):
    tree, skips = stairs((8, 8, 8), 12), 0
    if case == "above a skip":  # a subtree of two nodes first deep down, then below the root
        part = ([2, -1, 2, -1, -1], [3, 0, 5, 1, 0])
        other = ([2, -1, 2, -1, -1], [3, 1, 5, 0, 1])
        split = [0, 1, *part[0], 1, *other[0], *part[0], *part[0]]
        threshold = [4, 2, *part[1], 4, *other[1], *part[1], *part[1]]
        tree, skips = plan_of_nodes((8, 8, 8), split, threshold).tree.cells, 2
    plan = plan_of_nodes(tree.counts, tree.split, tree.threshold)
    diagram = ordered(tree).written(skips)
    form = c_stream.layout(diagram, skips)
    places = diagram.tree.depths[diagram.target >= 0]
    assert len(places) and (places < skips).any() == (case == "above a skip")
    assert (1 + form.label + form.reference > form.node + form.skip) == (skips == 0)
    written = c_stream.Stream((), diagram, form, c_stream.encode(diagram, form))
    monkeypatch.setattr(c_table, "stream", lambda *_: written)
    steps = np.stack(np.indices(tree.counts), axis=-1).reshape(-1, 3)
    library = Library(files(plan, None), tmp_path, 3, "gcc", UNDEFINED)
    assert np.array_equal(library.look(steps), tree.labels(steps))


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a", "cart-pole"])
def test_no_processor_takes_more(name, monkeypatch):
    need("arm-none-eabi-gcc", "avr-gcc")
    prefix = name.replace("-", "_")
    found = sizes(files(plan_of(name), None), prefix)
    most = {"cart-pendulum": 400, "double-tank-a": 970, "cart-pole": 1000}[name]
    assert found["cortex-m0"]["decision"] <= most
    monkeypatch.setattr(c_stream, "mirrors", lambda tree: [])
    monkeypatch.setattr(c_stream, "ordered", lambda tree: None)
    c_stream.stream.cache_clear()
    before = sizes(files(plan_of(name), None), prefix)
    c_stream.stream.cache_clear()
    for processor, measured in found.items():
        assert measured["decision"] <= before[processor]["decision"]


def test_code_for_mirrors_and_references_is_not_more_than_counted(monkeypatch):
    """The smallest gain that is taken is one on every processor, so that none loses."""
    need("arm-none-eabi-gcc", "avr-gcc")
    plan = plan_of("cart-pole")
    found, code = {}, {}
    for case in ("plain", "mirrors", "references"):
        with monkeypatch.context() as patch:
            if case != "mirrors":
                patch.setattr(c_stream, "mirrors", lambda tree: [])
            if case != "references":
                patch.setattr(c_stream, "ordered", lambda tree: None)
            c_stream.stream.cache_clear()
            stream = c_stream.stream(plan.tree.cells)
            code[case] = stream.code
            for processor, measured in sizes(files(plan, None), "cart_pole").items():
                found[case, processor] = measured["decision"] - len(stream.data)
    c_stream.stream.cache_clear()
    assert code["plain"] == 0 < code["references"] < code["mirrors"]
    for case, processor in found:
        assert found[case, processor] - found["plain", processor] <= code[case]


def test_mirrors_and_references_on_processors(tmp_path):
    plan, golden = plan_of("cart-pole"), golden_of("cart-pole")
    golden = of_vectors(golden, golden.statuses == OK)
    written = made(plan, golden)
    assert written.written["mirrors"] == [[0, 1, 2, 3]] and written.written["references"] > 0
    few = of_vectors(golden, slice(None, None, 4))
    assert cortex_m3(written.files, golden, tmp_path / "arm") == 0
    assert avr(written.files, few, tmp_path / "avr") == 0
    wrong = dataclasses.replace(few, labels=1 - few.labels)
    assert avr(written.files, wrong, tmp_path / "wrong") > 0


def test_what_is_written_is_said(tmp_path):
    policy = plan_of("cart-pole").policy
    export(policy, ["c", "python"], tmp_path)
    said, other = (
        json.loads((tmp_path / target / "certificate.json").read_text())
        for target in ("c", "python")
    )
    figures = c_stream.stream(plan_of("cart-pole").tree.cells).figures
    assert said["written"] == figures and "written" not in other
    assert said["nodes"] > figures["nodes"] and said["comparisons"]["most"] == 19
    text = " ".join((tmp_path / "c" / "cart_pole.c").read_text().replace("\n *", "").split())
    assert (
        f"The tree is written as {figures['nodes']} nodes, {figures['references']} of them "
        "references to subtrees that stand elsewhere, without what follows from reflection "
        f"(axes 0, 1, 2, 3). A decision reads at most {figures['nodes_read']}."
    ) in text
    export(policy, "c", tmp_path / "nested", style="nested")
    assert "written" not in json.loads((tmp_path / "nested" / "certificate.json").read_text())


def test_skips_of_a_large_tree_are_found_fast():
    tree = random_plan(1 << 20, depth=18).tree.cells
    assert tree.node_count > 100_000
    started = time.process_time()
    most = c_stream.most_read(tree)
    assert Diagram.of(tree).nodes_read(c_stream.best_skips(tree, most)) <= most
    assert time.process_time() - started < 2


def test_skips_wider_than_a_window(tmp_path, monkeypatch):
    wide = functools.partial(c_stream.layout, skip=30)
    monkeypatch.setattr(c_stream, "layout", wide)
    plan = random_plan(1 << 30)
    form = c_stream.stream(plan.tree.cells).form
    assert form.node + form.skip > 57 and form.apart and form.window == 8
    steps = np.random.default_rng(0).integers(1 << 30, size=(3000, 2))
    library = Library(files(plan, None), tmp_path, 2)
    assert np.array_equal(library.look(steps), plan.tree.cells.labels(steps))
