"""Figures of complexity against what they must be."""

import dataclasses
import json

import numpy as np
import pytest

from capsyn import Box, compress, problems, subdivide, synthesize
from capsyn.cells.packing import packed_bytes, smallest_type
from capsyn.compression import complexity as sizes
from capsyn.compression.complexity import complexity, entropy, switching_entropy
from capsyn.errors import CapsynWarning
from support.trees import random_affine_policy, random_policy, random_tree


def test_entropies():
    assert entropy(np.array([0.25, 0.25, 0.5, 0.0])) == 1.5
    assert str(entropy(np.array([1.0, 0.0]))) == "0.0"
    # out of 0 one goes to 1 or 2 alike, out of 1 always to 0, out of 2 never
    rates = np.array([[0, 1, 1], [2, 0, 0], [0, 0, 0.0]])
    assert switching_entropy(rates) == pytest.approx(0.5)
    assert switching_entropy(np.zeros((3, 3))) == 0.0


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ([], "i1"), ([-128, 127], "i1"), ([0, 128], "u1"), ([0, 255], "u1"), ([-1, 200], "i2"),
        ([0, 256], "i2"), ([0, 40_000], "u2"), ([-1, 40_000], "i4"), ([70_000], "i4"),
    ],
)  # fmt: skip
def test_the_smallest_type_that_holds_all_values(values, kind):
    assert smallest_type(np.array(values, dtype=np.int32)) == np.dtype(kind)


def test_a_policy_of_cells_and_its_tree():
    policy = synthesize(problems.plain("cart-pendulum"), max_level=3)
    found = complexity(policy)
    json.dumps(found)
    tree = compress(policy)
    assert found["symbol_entropy"] == pytest.approx(1.0, abs=1e-6)
    # nine cells per axis are told apart by 4 comparisons, halves by one
    assert found["table"] == {"bytes": packed_bytes(policy.cells), "comparisons": 8 + 3 * 2}
    assert found["tree"]["nodes"] == tree.node_count and found["tree"]["mode"] == "exact"
    assert found["tree"]["comparisons"] == tree.depth
    steps = np.stack(np.unravel_index(np.arange(72 * 72), (72, 72)), axis=1)
    depths = tree.cells.depths[tree.cells.find(steps)]
    assert found["tree"]["mean_comparisons"] == pytest.approx(depths.mean())
    deepest = tree.domain.locate(np.array([found["tree"]["deepest"]]), tree.cells.counts)
    assert tree.cells.depths[tree.cells.find(deepest)] == [tree.depth]
    machine = found["automaton"]
    assert (machine["regions"], machine["edges"], machine["possible_edges"]) == (2, 4, 4)
    assert machine["switch_rate"] > 0 and machine["switching_entropy"] == 0.0
    same = complexity(tree)
    # rates are sums over samples of faces, and a tree has other faces
    assert same["automaton"] == {
        key: pytest.approx(value, rel=0.02) for key, value in machine.items()
    }
    assert same["tree"] == found["tree"] and same["table"] is None


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("some_axes", [False, True])
def test_a_lookup_halves_the_axes_that_cells_are_split_along_and_no_others(seed, some_axes):
    cells = random_tree((2, 3), (3, 2), 3, 3, seed=seed, some_axes=some_axes)
    policy = dataclasses.replace(random_policy(3), cells=cells)
    most = 0
    for z in np.ndindex(cells.counts):  # down to the leaf of every finest cell
        size, comparisons = cells.sizes(0), 1 + 2
        place, rest = np.ravel_multi_index(z // size, (2, 3)), z % size
        while cells.entries[place] >= 0:
            factors = cells.factors(np.array([place]))[0]
            comparisons += sum({1: 0, 2: 1, 3: 2}[k] for k in factors.tolist())
            size = size // factors
            place = cells.entries[place] + np.ravel_multi_index(rest // size, factors)
            rest = rest % size
        most = max(most, comparisons)
    assert complexity(policy)["table"]["comparisons"] == most


def test_without_a_model_nothing_is_said_of_switches():
    machine = complexity(random_policy(3))["automaton"]
    assert machine["switch_rate"] is machine["switching_entropy"] is None
    assert machine["possible_edges"] == machine["edges"] == machine["regions"] ** 2


def test_oblique_splits_have_no_boxes():
    policy = subdivide(
        lambda x: (x @ [1.0, 1.0, 0.5] > 0.1).astype(int), Box([-1] * 3, [1] * 3), 2,
        partitions=2, max_level=2,
    )  # fmt: skip
    with pytest.warns(CapsynWarning, match="follows their stairs; give a controller"):
        tree = compress(policy, "linear", agreement=0.9)
    found = complexity(tree)
    assert found["tree"]["planes"] > 0 and found["tree"]["mean_comparisons"] is None
    assert found["tree"]["deepest"] is None
    assert found["automaton"] is None and 0.9 < found["symbol_entropy"] <= 1


def test_a_tree_that_is_too_large_is_left_out(monkeypatch):
    policy = random_affine_policy(3)
    found = complexity(policy)
    monkeypatch.setattr(sizes, "MOST_NODES", found["tree"]["nodes"] - 2)
    assert complexity(policy) == found | {"tree": None}


def test_one_cell():
    policy = subdivide(lambda x: np.zeros(len(x), int), Box([0], [1]), 1, partitions=1, max_level=0)
    found = complexity(policy)
    assert found["table"]["comparisons"] == found["tree"]["comparisons"] == 0
    assert found["tree"]["nodes"] == found["automaton"]["edges"] == 1
    assert found["symbol_entropy"] == 0.0
