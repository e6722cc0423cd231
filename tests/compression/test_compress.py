"""From policies to trees: equal where it is promised, small, and what is promised is so."""

import dataclasses
import math
import re
import warnings

import numpy as np
import pytest

import capsyn
from capsyn import Alphabet, Box, DecisionTree, Policy, compress, problems
from capsyn.cells.cell_tree import CellTree
from capsyn.compression.coarsening import cut_off
from capsyn.compression.fitted import oblique
from capsyn.compression.freedom import VOTES, cell_votes, exact_prices, free_prices
from capsyn.compression.induction import Prices, induce
from capsyn.compression.judge import JUDGING
from capsyn.compression.proof import changed_cells, prove
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.modelling.grid import Grid
from capsyn.policies.file import content_hash
from capsyn.random_streams import derived_seed, stream
from capsyn.verification.agreement import agreement
from support.closed_loops import random_grid_policy, relay_problem
from support.split_trees import all_points, random_split_tree, tree_of
from support.trees import GRIDS, random_policy, random_tree

# small grids and budgets lose symbols, which is told: see test_lost.py
pytestmark = pytest.mark.filterwarnings("ignore:the tree gives some symbols")
FEW = {"states": 2000}


def policy_of(grid, symbols=5, seed=0, split=0.5, mixed=True, **changes):
    """Return a policy over random cells; the default is among its labels."""
    cells = changes.pop("cells", None)
    cells = cells or random_tree(*grid, leaf_count=symbols + 1, split=split, seed=seed)
    if not mixed:
        cells = dataclasses.replace(
            cells, mixed_cells=cells.mixed_cells[:0], mixed_labels=cells.mixed_labels[:0]
        )
    n = len(grid[0])
    box = Box(np.zeros(n), np.arange(1, n + 1), periodic=[seed % 2 == 1] + [False] * (n - 1))
    fields = {"default": np.zeros(1), "cells": cells}
    return Policy("random", box, Alphabet(range(1, symbols + 1)), **fields | changes)


@pytest.fixture(scope="module")
def pendulum():
    return capsyn.synthesize(problems.plain("cart-pendulum"))


@pytest.fixture(scope="module")
def small():
    """A small policy with its model."""
    return capsyn.synthesize(problems.plain("cart-pendulum"), partitions=5, max_level=3)


def assert_equal(tree, cells):
    points = all_points(cells.counts)
    assert np.array_equal(tree.labels(points), cells.labels(points))


# exact


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("seed", range(2))
def test_exact_trees_equal_the_policy_on_every_finest_cell(grid, seed):
    policy = policy_of(grid, seed=seed)
    tree = compress(policy)
    assert type(tree) is DecisionTree and tree.cells.counts == policy.cells.counts
    assert_equal(tree.cells, policy.cells)
    known = tree.guarantee
    assert (known.mode, known.level, known.changed, known.states) == ("exact", None, 0.0, 0)
    assert known.source == content_hash(policy) and known.reached and known.target is None
    assert known.text == "equal to the policy in every cell (proved)"
    for field in dataclasses.fields(Policy):
        if field.name not in ("cells", "evidence", "timings"):
            one, other = getattr(tree, field.name), getattr(policy, field.name)
            assert np.array_equal(one, other)
    assert tree.volume_shares == pytest.approx(policy.volume_shares, abs=1e-12)


@pytest.mark.parametrize("budget", [0, 1, 30, 300])
@pytest.mark.parametrize("grid", [GRIDS[1], GRIDS[3], GRIDS[4], GRIDS[6], GRIDS[7]])
def test_trees_are_right_whatever_is_left_to_the_dynamic_programme(grid, budget):
    policy = policy_of(grid, seed=3)
    tree = induce(policy.cells, exact_prices(policy), budget)
    tree.check(6)
    assert_equal(tree, policy.cells)
    assert tree.node_count >= induce(policy.cells, exact_prices(policy)).node_count
    for node in np.flatnonzero(tree.split >= 0):  # no two leaves that could be one
        pair = [tree.first[node], tree.second[node]]
        if (tree.split[pair] < 0).all():
            assert tree.threshold[pair[0]] != tree.threshold[pair[1]]


def test_small_memory_gives_the_same_trees(monkeypatch):
    policy = policy_of(GRIDS[3], seed=4)
    wanted = [induce(policy.cells, exact_prices(policy), budget) for budget in (60, None)]
    monkeypatch.setattr("capsyn.compression.induction.MEMORY", 1)
    for tree, budget in zip(wanted, (60, None)):
        again = induce(policy.cells, exact_prices(policy), budget)
        assert np.array_equal(tree.rows, again.rows)


def test_a_policy_of_one_symbol_is_one_node():
    for grid in (GRIDS[0], GRIDS[3], GRIDS[7]):
        policy = policy_of(grid, mixed=False)
        entries = np.where(policy.cells.entries < 0, -3, policy.cells.entries)
        policy = dataclasses.replace(
            policy, cells=dataclasses.replace(policy.cells, entries=entries.astype(np.int32))
        )
        for mode in ("exact", "freedom"):
            tree = compress(policy, mode, **({} if mode == "exact" else FEW))
            assert tree.node_count == 1 and tree.cells.threshold.tolist() == [2]
            assert tree(policy.domain.sample(9)).tolist() == [2] * 9


def test_a_cut_is_where_labels_change():
    entries = -1 - np.array([0, 0, 0, 1, 1, 5], dtype=np.int32)
    cells = CellTree(Grid((6,), (2,), 2), entries, np.zeros(0, np.int32), np.zeros(0, np.uint64))
    tree = compress(policy_of(((6,), (2,), 2), cells=cells)).cells
    assert tree.node_count == 5 and sorted(tree.threshold[tree.split >= 0].tolist()) == [12, 20]


@pytest.mark.parametrize(("name", "most"), [("cart-pendulum", 799), ("cart-pendulum-4", 1523)])
def test_exact_trees_of_the_built_in_problems_are_small(name, most):
    policy = capsyn.synthesize(problems.plain(name))
    tree = compress(policy)
    assert 100 < tree.node_count <= most
    assert_equal(tree.cells, policy.cells)
    assert compress(policy, "freedom", **FEW).node_count < tree.node_count / 1.8


def deep(n, refinement, depth, seed):
    """Return cells of which one is split again and again."""
    rng, place, children = np.random.default_rng(seed), 0, refinement**n
    entries = [-1 - int(rng.integers(3))]
    for _ in range(depth):
        start = len(entries)
        entries[place] = start
        entries += (-1 - rng.integers(0, 3, children)).tolist()
        place = start + int(rng.integers(children))
    none = np.zeros(0, np.int32), np.zeros(0, np.uint64)
    return CellTree(Grid((1,) * n, (refinement,) * n, depth), np.array(entries, np.int32), *none)


@pytest.mark.parametrize(
    ("n", "refinement", "depth"), [(2, 3, 16), (2, 2, 30), (2, 3, 18), (3, 3, 13), (3, 2, 22)]
)
def test_lattices_of_more_finest_cells_than_numbers_are_exact(n, refinement, depth):
    grid = ((1,) * n, (refinement,) * n, depth)
    for seed in range(3):
        policy = policy_of(grid, cells=deep(n, refinement, depth, seed))
        tree = compress(policy)
        boxes = policy.cells.boxes()
        for corner in (boxes.lower, boxes.upper - 1):
            assert np.array_equal(tree.cells.labels(corner), boxes.labels)


# freedom


def masks_at(cells, points):
    """Return the labels that each finest cell may take, as bit masks."""
    masks = [1 << max(-1 - entry, 0) for entry in cells.entries.tolist()]
    for cell, seen in zip(cells.mixed_cells.tolist(), cells.mixed_labels[:, 0, 0].tolist()):
        masks[cell] |= seen
    return np.array(masks, dtype=np.uint64)[cells.find(points)]


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("node_price", [0.0, 0.5, 30.0])
def test_freedom_stays_within_what_was_seen(grid, node_price):
    policy = policy_of(grid, seed=6)
    tree = compress(policy, "freedom", node_price=node_price, **FEW)
    points = all_points(policy.cells.counts)
    labels, own = tree.cells.labels(points), policy.cells.labels(points)
    assert ((masks_at(policy.cells, points) >> labels.astype(np.uint64)) & np.uint64(1)).all()
    mixed = np.isin(policy.cells.find(points), policy.cells.mixed_cells)
    assert np.array_equal(labels[~mixed], own[~mixed])
    known = tree.guarantee
    assert known.changed == pytest.approx((labels != own).mean(), abs=1e-12)
    assert (known.mode, known.controller, known.states) == ("freedom", "policy", 2000)
    found = agreement(tree, 2000, controller=policy, seed=derived_seed(0, JUDGING, 0))
    assert (known.agreeing, known.low, known.high) == (found.agreeing, found.low, found.high)
    if len(grid[0]) < 4:  # of more axes the cuts are a guess
        assert tree.node_count <= compress(policy).node_count


@pytest.mark.parametrize("grid", [GRIDS[2], GRIDS[3], GRIDS[6]])
def test_dearer_nodes_give_no_larger_trees(grid):
    policy = policy_of(grid, symbols=2, seed=8)
    sizes, changed = [], []
    for price in (0.0, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 16.0, 1e9):
        tree = compress(policy, "freedom", node_price=price, **FEW)
        sizes.append(tree.node_count)
        changed.append(tree.guarantee.changed)
    assert sizes == sorted(sizes, reverse=True) and sizes[0] > sizes[-1]
    assert changed == sorted(changed) and changed[0] < changed[-1]
    assert compress(policy, "freedom", node_price=1e300, **FEW).node_count == sizes[-1]


def test_free_trees_are_of_least_cost():
    """The whole grid is left to the dynamic programme: no tree of another price is cheaper."""
    policy = policy_of(GRIDS[3], symbols=2, seed=9)
    votes = cell_votes(policy, None, 0)
    points = all_points(policy.cells.counts)
    own = policy.cells.labels(points)

    def cost(tree, price):
        leaf_price = max(1, round(2 * VOTES * price))
        return leaf_price * tree.leaf_count + VOTES * (tree.labels(points) != own).sum()

    prices = (0.0, 0.1, 0.5, 2.0, 16.0)
    trees = {p: induce(policy.cells, free_prices(policy, votes, p)) for p in prices}
    trees["exact"] = induce(policy.cells, exact_prices(policy))
    for p in prices:
        assert cost(trees[p], p) == min(cost(tree, p) for tree in trees.values())


@pytest.mark.parametrize("grid", [GRIDS[1], GRIDS[3], GRIDS[6], GRIDS[7]])
@pytest.mark.parametrize("budget", [0, 40, None])
def test_leaves_have_the_cheapest_label_and_none_could_be_one(grid, budget):
    policy = policy_of(grid, symbols=3, seed=12)
    cells = policy.cells
    votes = np.random.default_rng(0).integers(0, VOTES + 1, (len(cells.mixed_cells), 4))
    points, merged = all_points(cells.counts), 0
    entries, masks = cells.find(points), masks_at(cells, points)
    price = np.zeros((len(cells.entries), 4), dtype=int)
    price[cells.mixed_cells] = VOTES - votes
    for node_price in (0.05, 1.0):
        tree = induce(cells, free_prices(policy, votes, node_price), budget)
        leaves = tree.find(points)
        for leaf in np.unique(leaves):
            inside = leaves == leaf
            common = int(np.bitwise_and.reduce(masks[inside]))
            cost = price[entries[inside]].sum(axis=0)
            cheapest = min(cost[k] for k in range(4) if common >> k & 1)
            label = tree.threshold[leaf]
            assert common >> int(label) & 1 and cost[label] == cheapest
        for node in np.flatnonzero(tree.split >= 0):
            one, two = tree.first[node], tree.second[node]
            if tree.split[one] < 0 and tree.split[two] < 0:
                merged += 1
                assert tree.threshold[one] != tree.threshold[two]
    assert merged


def test_freedom_of_a_policy_without_mixed_cells_is_exact():
    policy = policy_of(GRIDS[3], mixed=False, seed=2)
    free, exact = compress(policy, "freedom", node_price=100, **FEW), compress(policy)
    assert np.array_equal(free.cells.rows, exact.cells.rows)
    assert free.guarantee.changed == 0 and free.guarantee.agreement == 1


def test_a_controller_votes_in_each_mixed_cell(small):
    ssac = policy_controller(small, "auto")
    votes = cell_votes(small, ssac.masks, 3)
    cells = small.cells
    assert votes.shape == (len(cells.mixed_cells), 3) and votes.min() >= 0
    assert (votes.sum(axis=1) >= VOTES).all() and votes.max() == VOTES
    boxes = cells.boxes()
    asked = []

    def masks(states):
        asked.append(cells.find(small.domain.locate(states, cells.counts)))
        return np.full((len(states), 1), 0b101, dtype=np.uint64)

    votes = cell_votes(small, masks, 3)
    assert len(asked) == VOTES and all(np.array_equal(a, cells.mixed_cells) for a in asked)
    assert (votes == [VOTES, 0, VOTES]).all() and len(boxes) > len(votes)
    nobody = cell_votes(small, lambda states: np.zeros((len(states), 1), dtype=np.uint64), 3)
    assert (nobody == [0, 0, VOTES]).all()  # no finite answer: the default is right
    alone = cell_votes(small, None, 3)
    assert alone.sum() == VOTES * len(alone)
    assert np.array_equal(alone.argmax(axis=1), -1 - cells.entries[cells.mixed_cells])


def test_free_trees_are_judged_by_the_controller(small):
    tree = compress(small, "freedom", states=4000, seed=5)
    known = tree.guarantee
    assert known.controller == "ssac" and known.states == 4000
    found = agreement(tree, 4000, seed=derived_seed(5, JUDGING, 0))
    assert known.agreeing == found.agreeing < 4000
    assert known.text.endswith("with 95% confidence)") and "agrees with sSAC at" in known.text
    cheap = compress(small, "freedom", states=4000, seed=5, node_price=50)
    assert cheap.node_count < tree.node_count
    assert cheap.guarantee.agreeing != known.agreeing


# agreement


def test_an_agreement_that_is_reached(pendulum):
    sizes = []
    for target in (0.9, 0.99):
        tree = compress(pendulum, "freedom", agreement=target, states=20_000)
        known = tree.guarantee
        assert known.reached and known.target == target <= known.low < known.agreement
        sizes.append(tree.node_count)
    assert sizes[0] < sizes[1]


def not_reached(policy, mode, target, **options):
    with pytest.warns(CapsynWarning) as caught:
        tree = compress(policy, mode, agreement=target, **options)
    warning = caught[0]  # then what symbols are lost, if any
    assert all(str(w.message).startswith("the tree gives some") for w in caught[1:])
    text = str(warning.message)
    assert "\n" not in text and text.startswith(f"an agreement of {target:g} was not reached: the ")
    assert f"best tree of mode {mode} has {tree.node_count} nodes and agrees at " in text
    assert warning.filename == __file__
    assert not tree.guarantee.reached and tree.guarantee.target == target
    assert tree.guarantee.low < target
    return text, tree


def test_an_agreement_that_takes_a_finer_policy(pendulum):
    text, tree = not_reached(pendulum, "freedom", 0.999, states=20_000)
    level = pendulum.cells.max_level
    own = agreement(pendulum, 20_000, seed=derived_seed(0, JUDGING, 0)).share
    more = math.ceil(math.log2((1 - own) / 0.001))
    assert more >= 1 and 0.98 < own < 0.999
    wanted = f"the policy itself agrees at {own:.3%}: synthesize it with max_level {level + more} "
    assert wanted in text and text.endswith("then compress")
    assert tree.guarantee.agreement > 0.993  # of the dearest nodes it is 0.989


def test_an_agreement_that_no_linear_tree_reached_takes_no_finer_cells(monkeypatch):
    monkeypatch.setattr(oblique, "AIMS", (1.0,))
    monkeypatch.setattr(oblique, "ATTEMPTS", 1)
    policy = capsyn.synthesize(problems.plain("cart-pendulum"), partitions=5, max_level=1)
    text, tree = not_reached(policy, "linear", 0.9999, states=20_000)
    low = tree.guarantee.low
    less = float(re.search("ask for less, such as (0.[0-9]+), or try another `seed`$", text)[1])
    assert "max_level" not in text and low - 0.1 * (1 - low) < less <= low


def test_an_agreement_that_more_states_may_tell(pendulum):
    text, _ = not_reached(pendulum, "freedom", 0.97, states=100)
    assert text.endswith("; mode exact agrees at 100.000% (more `states` would tell)")


def test_an_agreement_that_the_policy_itself_has():
    policy = policy_of(GRIDS[3], seed=1)
    text, tree = not_reached(policy, "freedom", 0.98, level=0, states=2000)
    assert text.endswith("; mode exact agrees at 100.000%")
    assert tree.guarantee.level == 0


def test_an_agreement_that_too_few_states_cannot_tell():
    policy = policy_of(GRIDS[3], seed=1)
    text, _ = not_reached(policy, "freedom", 0.99, level=0, states=100)
    assert text.endswith("; mode exact agrees at 100.000% (more `states` would tell)")


# levels


def brute_cut(cells, level, labels):
    """Return label and mask arrays over the finest cells of cells cut off at a level."""
    points = all_points(cells.counts)
    own = cells.labels(points)
    masks = masks_at(cells, points)
    boxes = cells.boxes()
    place = np.zeros(len(cells.entries), dtype=int)
    place[boxes.places] = boxes.levels
    deeper = place[cells.find(points)] > level
    size = cells.sizes(level)
    groups = np.unique(points // size, axis=0, return_inverse=True)[1].ravel()
    own, masks = own.copy(), masks.copy()
    for group in np.unique(groups[deeper]):
        inside = groups == group
        own[inside] = np.bincount(own[inside], minlength=labels).argmax()
        masks[inside] = np.bitwise_or.reduce(masks[inside])
    return points, own, masks, deeper


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("seed", range(2))
def test_cut_off_takes_the_label_of_most_volume(grid, seed):
    policy = policy_of(grid, symbols=2, seed=seed, split=0.7)
    cells = policy.cells
    for level in range(cells.max_level + 1):
        cut = cut_off(policy, level)
        cut.cells.check(3)
        assert cut.cells.max_level == level and cut.statistics == {} == cut.evidence
        points, own, masks, deeper = brute_cut(cells, level, 3)
        coarse = points // cells.sizes(level)
        assert np.array_equal(cut.cells.labels(coarse), own)
        assert np.array_equal(masks_at(cut.cells, coarse), masks)
        mixed = np.isin(cut.cells.find(coarse), cut.cells.mixed_cells)
        was = np.isin(cells.find(points), cells.mixed_cells)
        assert np.array_equal(mixed, deeper | was)
    same = cut_off(policy, cells.max_level)
    assert np.array_equal(same.cells.entries, cells.entries)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("seed", range(2))
def test_cells_split_along_some_axes_are_cut_off_likewise(grid, seed):
    cells = random_tree(*grid, leaf_count=3, split=0.7, seed=seed, some_axes=True)
    policy = policy_of(grid, symbols=2, cells=cells)
    for level in range(cells.depth + 1):
        cut = cut_off(policy, level).cells
        cut.check(3)
        assert cut.depth == level
        scale = np.array(cells.counts) // cut.counts
        places, volumes = cells.volumes()
        for here in cut.leaves():
            for place, lower, size in zip(*here[1:]):
                middle = (lower * scale)[None]
                if cells.entries[place] < 0:
                    assert cut.entries[place] == cells.entries[cells.find(middle)[0]]
                    continue
                found = np.zeros(3)
                for part in cells.leaves():
                    inside = (part.lower >= middle).all(axis=1)
                    inside &= (part.lower < (lower + size) * scale).all(axis=1)
                    sizes = np.prod(part.sizes[inside], axis=1)
                    np.add.at(found, -1 - cells.entries[part.places[inside]], sizes)
                assert cut.labels_at(np.array([place])) == found.argmax()
                assert place in cut.mixed_cells
    assert np.array_equal(cut.entries, cells.entries)
    assert np.array_equal(cut.splits, cells.splits)
    tree = compress(policy)
    points = all_points(cells.counts)
    assert np.array_equal(tree.cells.labels(points), cells.labels(points))


def test_of_equal_volumes_the_first_label_is_taken():
    entries = np.array([1, -3, -2], dtype=np.int32)
    cells = CellTree(Grid((1,), (2,), 1), entries, np.zeros(0, np.int32), np.zeros(0, np.uint64))
    policy = policy_of(((1,), (2,), 1), cells=cells)
    cut = cut_off(policy, 0).cells
    assert cut.entries.tolist() == [-2] and cut.mixed_labels[:, 0, 0].tolist() == [0b110]


def test_cutting_off_cells_without_blocks_costs_nothing():
    base = random_policy(0)
    cells = dataclasses.replace(base.cells, grid=Grid((1,), (2**31 - 1,), 1))
    policy = dataclasses.replace(base, cells=cells, domain=Box([0], [1]))
    assert compress(policy, level=0).node_count == 1


@pytest.mark.parametrize("grid", [GRIDS[2], GRIDS[3], GRIDS[4], GRIDS[6]])
@pytest.mark.parametrize("mode", ["exact", "freedom"])
def test_trees_of_a_level(grid, mode):
    policy = policy_of(grid, symbols=2, seed=11, split=0.7)
    cells, sizes = policy.cells, []
    for level in range(cells.max_level + 1):
        tree = compress(policy, mode, level=level, **({} if mode == "exact" else FEW))
        points, own, masks, _ = brute_cut(cells, level, 3)
        coarse = points // cells.sizes(level)
        assert tree.cells.counts == cut_off(policy, level).cells.counts
        labels = tree.cells.labels(coarse)
        if mode == "exact":
            assert np.array_equal(labels, own)
        assert ((masks >> labels.astype(np.uint64)) & np.uint64(1)).all()
        known = tree.guarantee
        changed = (labels != cells.labels(points)).mean()
        assert known.level == level and known.changed == pytest.approx(changed, abs=1e-12)
        assert known.source == content_hash(policy)
        assert f"equal to the policy cut off at level {level} in every cell" in known.text
        assert ("another symbol than the policy's in" in known.text) == (changed > 0)
        states = policy.domain.sample(500)
        steps = policy.domain.locate(states, cells.counts)
        flat = labels.reshape(cells.counts)[tuple(steps.T)]
        assert np.array_equal(tree(states) % 3, flat)
        sizes.append(tree.node_count)
    assert sizes[0] < sizes[-1] and changed == 0 if mode == "exact" else True


# the proof


@pytest.mark.parametrize("grid", GRIDS)
def test_changed_cells_against_every_finest_cell(grid):
    cells = random_tree(*grid, seed=3)
    points = all_points(cells.counts)
    boxes = cells.boxes()
    for seed in range(4):
        tree = random_split_tree(cells.counts, depth=5, seed=seed)
        unlike = tree.labels(points) != cells.labels(points)
        wanted = np.bincount(cells.find(points), unlike, minlength=len(cells.entries))
        assert np.array_equal(changed_cells(tree, cells), wanted[boxes.places])
        assert changed_cells(tree, cells).sum() == unlike.sum()


def test_one_wrong_label_is_found():
    policy = policy_of(GRIDS[3], seed=3)
    tree = compress(policy)
    assert prove(tree, policy) == 0.0
    for leaf in np.flatnonzero(tree.cells.split < 0)[::7]:
        threshold = tree.cells.threshold.copy()
        threshold[leaf] = (threshold[leaf] + 1) % 6
        cells = dataclasses.replace(tree.cells, threshold=threshold)
        with pytest.raises(ProblemError, match="`tree` does not keep its word: cell"):
            prove(dataclasses.replace(tree, cells=cells), policy)


def test_a_proof_is_that_of_a_policy_and_a_level(small):
    for options in ({"mode": "exact", "level": 1}, {"mode": "freedom"} | FEW):
        tree = compress(small, **options)
        assert prove(tree, small) == tree.guarantee.changed > 0
    with pytest.raises(ProblemError, match="was made from another$"):
        prove(tree, policy_of(GRIDS[3]))
    # what freedom may change, exact may not
    claim = dataclasses.replace(tree, guarantee=dataclasses.replace(tree.guarantee, mode="exact"))
    with pytest.raises(ProblemError, match="does not keep its word"):
        prove(claim, small)
    linear = dataclasses.replace(tree.guarantee, mode="linear")
    with pytest.raises(ProblemError, match="^`tree` must be a decision tree of mode exact or free"):
        prove(dataclasses.replace(tree, guarantee=linear), small)


def test_trees_of_another_lattice_do_not_tile():
    policy = policy_of(GRIDS[3], seed=3)
    with pytest.raises(ProblemError, match="oblique splits has no boxes"):
        changed_cells(random_split_tree(policy.cells.counts, 1), policy.cells)


# prices


def test_prices_of_entries():
    masks = np.array([0b001, 0b110, 0b111, 0b010], dtype=np.uint64)[:, None]
    prices = Prices(masks, np.array([1, 2]), np.array([[9, 1, 2], [3, 4, 5]]), 1)
    found = prices.of(np.array([0, 1, 2, 3, 2]), np.array([7, 1, 1, 7, 10]))
    none = 2**40
    assert found.tolist() == [
        [0, none, none],
        [none, 1, 2],
        [3, 4, 5],
        [none, 0, none],
        [30, 40, 50],
    ]


def test_prices_of_nodes():
    policy = policy_of(GRIDS[3], seed=1)
    votes = cell_votes(policy, None, 0)
    for node_price, leaf_price in ((0.0, 1), (0.01, 1), (0.5, VOTES), (2.0, 4 * VOTES)):
        assert free_prices(policy, votes, node_price).leaf_price == leaf_price
    made = free_prices(policy, votes, 1.0)
    assert np.array_equal(made.prices + votes, np.full(votes.shape, VOTES))
    assert exact_prices(policy).leaf_price == 1 and not len(exact_prices(policy).priced)


# whoever asks


def test_the_same_gives_the_same_bytes(small, tmp_path):
    for mode in ("exact", "freedom"):
        options = {} if mode == "exact" else {"states": 3000, "seed": 4}
        for name in ("one", "two"):
            compress(small, mode, **options).save(tmp_path / name)
        assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
        loaded = Policy.load(tmp_path / "one")
        assert type(loaded) is DecisionTree
        assert loaded.guarantee == compress(small, mode, **options).guarantee
    other = compress(small, "freedom", states=3000, seed=5)
    assert other.guarantee.agreeing != loaded.guarantee.agreeing
    again = Policy.load(tmp_path / "one")
    small.save(tmp_path / "policy")
    from_file = compress(Policy.load(tmp_path / "policy"), "freedom", states=3000, seed=4)
    assert content_hash(from_file) == content_hash(again)


def test_both_backends_give_the_same_tree(small):
    one, two = (compress(small, "freedom", states=3000, backend=b) for b in ("c", "numpy"))
    assert np.array_equal(one.cells.rows, two.cells.rows) and one.guarantee == two.guarantee


def test_a_tree_keeps_no_evidence_of_the_policy(small):
    found = agreement(small, 500)
    evident = small.with_evidence(agreement=found.to_json())
    tree = compress(evident)
    assert evident.evidence and tree.evidence == {} and tree.timings == {}
    assert tree.model is not None and tree.settings == small.settings
    assert tree.guarantee.source == content_hash(small)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mode": "other"}, "`mode` must be one of 'exact', 'freedom', 'linear'; got 'other'"),
        ({"mode": 3}, "`mode` must be"),
        ({"agreement": 0.9}, "`agreement` is for mode freedom and linear only; got 0.9"),
        ({"mode": "linear", "level": 1}, "`level` is for mode exact and freedom only; got 1"),
        ({"node_price": 1.0}, "`node_price` is for mode freedom only; got 1.0"),
        ({"mode": "linear", "node_price": 1.0}, "`node_price` is for mode freedom only; got 1.0"),
        ({"mode": "freedom", "agreement": 1.0}, "`agreement` must be above 0 and below 1; got 1"),
        ({"mode": "freedom", "agreement": 1.5}, "`agreement` must be above 0 and below 1; got 1.5"),
        ({"mode": "freedom", "agreement": 0}, "`agreement` must be a finite number > 0; got 0"),
        ({"mode": "linear", "agreement": -0.5}, "`agreement` must be a finite number > 0; got -"),
        ({"mode": "freedom", "agreement": float("nan")}, "`agreement` must be a finite number"),
        ({"mode": "freedom", "agreement": "0.9"}, "`agreement` must be a number > 0; got"),
        (
            {"mode": "freedom", "agreement": 0.9, "node_price": 1.0},
            "`agreement` and `node_price` exclude each other; got both",
        ),
        ({"level": -1}, "`level` must be a whole number >= 0 and <= 3; got -1"),
        ({"level": 4}, "`level` must be a whole number >= 0 and <= 3; got 4"),
        ({"level": 1.0}, "`level` must be a whole number"),
        ({"mode": "freedom", "node_price": -1}, "`node_price` must be a finite number >= 0; got"),
        ({"mode": "freedom", "node_price": float("inf")}, "`node_price` must be a finite number"),
        ({"states": 0}, "`states` must be a whole number >= 1 and <= 10000000; got 0"),
        ({"states": 1e5}, "`states` must be a whole number >= 1 and <= 10000000; got 100000.0"),
        ({"seed": -1}, "`seed` must be a whole number >= 0; got -1"),
        ({"seed": None}, "`seed` must be a whole number"),
        ({"backend": "gpu"}, "`backend` must be one of 'auto', 'c', 'numpy'; got 'gpu'"),
    ],
)
def test_arguments_that_cannot_be_used(arguments, message):
    with pytest.raises(ProblemError) as caught:
        compress(policy_of(GRIDS[3]), **arguments)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_only_policies_of_cells_are_compressed():
    for thing, message in (
        (None, "`policy` must be a capsyn.Policy; got None"),
        (relay_problem(), "`policy` must be a capsyn.Policy; got Problem"),
        (
            tree_of((5, 7)),
            "`policy` must be one of cells, as synthesize makes them; got ",
        ),
        (compress(policy_of(GRIDS[3])), "`policy` must be one of cells"),
    ):
        for mode in ("exact", "freedom", "linear"):
            with pytest.raises(ProblemError) as caught:
                compress(thing, mode)
            assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_a_policy_without_a_model_is_its_own_judge():
    policy = policy_of(GRIDS[3], seed=8)
    tree = compress(policy, "freedom", node_price=0, **FEW)
    assert tree.guarantee.controller == "policy" and tree.guarantee.agreement == 1
    assert "agrees with the policy at 100.00% of 2,000 random states" in tree.guarantee.text
    with_model = random_grid_policy(relay_problem())
    assert compress(with_model, "freedom", **FEW).guarantee.controller == "ssac"


def test_nothing_is_warned_of_without_an_agreement(small):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        compress(small)
        compress(small, "freedom", node_price=1000, **FEW)


# a controller of one's own


def sectors(states):
    return (np.arctan2(states[:, 1], states[:, 0]) // (np.pi / 3) % 2).astype(int)


def test_a_given_controller_is_fitted_and_judged():
    box = Box([-1, -1], [1, 1])
    policy = capsyn.subdivide(sectors, box, 2, partitions=4, max_level=3)
    tree = compress(policy, "linear", agreement=0.98, controller=sectors)
    known = tree.guarantee
    assert known.controller == "function" and known.reached and "its controller" in known.text
    states = box.sample(50_000, 0)
    assert (tree(states) == sectors(states)).mean() > 0.98
    with pytest.warns(CapsynWarning, match="follows their stairs; give a controller"):
        compress(policy, "linear", agreement=0.99)
    with pytest.raises(ProblemError, match="^`controller` must be a function; got 3"):
        compress(policy, "freedom", controller=3)


def test_no_internal_stream_is_one_that_a_user_draws():
    first = np.random.default_rng(0).random(3)
    streams = [stream(0).random(3), *(stream(0, k).random(3) for k in range(8))]
    streams += [stream(0, 3, k).random(3) for k in range(3)]
    streams += [np.random.default_rng(derived_seed(0, JUDGING, k)).random(3) for k in range(3)]
    known = {tuple(first)} | {tuple(x) for x in streams[1:]}
    assert len(known) == len(streams)
    assert np.array_equal(streams[0], first)  # the only one, and nobody uses it


def test_combs_take_neither_depth_nor_time():
    comb = CellTree(
        Grid((150, 150), (2, 2), 0),
        -1 - np.tile(np.arange(150) % 2, (150, 1)).ravel().astype(np.int32),
        np.zeros(0, np.int32), np.zeros(0, np.uint64),
    )  # fmt: skip
    place = np.arange(150)
    stairs = (-1 - np.add.outer(place, place) // 3 % 2).ravel().astype(np.int32)
    tilted = dataclasses.replace(comb, entries=stairs)
    for cells in (comb, tilted):
        tree = compress(policy_of(((150, 150), (2, 2), 0), cells=cells, symbols=2), "exact")
        assert tree.depth < 100
