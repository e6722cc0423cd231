"""Trees of policies that remember: a leaf is a row, what follows each label in force."""

import dataclasses
from functools import partial

import casadi as ca
import numpy as np
import pytest

import capsyn
from capsyn import Alphabet, Box, DecisionTree, Policy, compress, problems
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import FeatureTree
from capsyn.cells.masks import holds, masks_of_members, members, singles
from capsyn.cells.packing import packed_bytes
from capsyn.cells.row_table import row_sets
from capsyn.compression.coarsening import cut_off
from capsyn.compression.complexity import complexity
from capsyn.compression.fitted.oblique import fit_tree
from capsyn.compression.judge import Judge
from capsyn.compression.proof import prove
from capsyn.compression.rows import policy_bytes, rows_at
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.modelling.grid import Grid
from capsyn.policies.guarantee import CONFIDENCE
from capsyn.statistics import clopper_pearson
from support.split_trees import all_points
from support.trees import GRIDS, random_tree

N = 2
ROWS = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2], [0, 1, 0], [0, 1, 1], [2, 1, 0]])
PRICED = problems.get("cart-pendulum").replace(switching=capsyn.Switching(price="1%"))
FEW = {"states": 2000}


def random_memory(grid, seed=0):
    """Return a policy of random cells with `ROWS`, and labels seen at random beside their own."""
    rng = np.random.default_rng([3, seed])
    cells = random_tree(*GRIDS[grid], leaf_count=len(ROWS), split=0.6, seed=seed)
    own = singles(ROWS[-1 - cells.entries[cells.mixed_cells]], N + 1)
    seen = own | rng.integers(0, 8, own.shape).astype(np.uint64)
    cells = dataclasses.replace(cells, mixed_labels=seen)
    n = cells.n
    domain = Box(np.zeros(n), np.arange(1, n + 1))
    return Policy("memory", domain, Alphabet([-1, 1]), np.zeros(1), cells, transitions=ROWS)


@pytest.fixture(scope="module")
def small():
    """A small policy with prices, and its model."""
    switching = capsyn.Switching(price="10%")
    return capsyn.synthesize(PRICED, partitions=5, max_level=3, switching=switching)


@pytest.fixture
def quick(monkeypatch):
    """Fits of mode linear to few samples, of one search."""
    monkeypatch.setattr("capsyn.compression.trees.fit_tree", partial(fit_tree, samples=20_000))
    monkeypatch.setattr("capsyn.compression.judge.PILOT", 20_000)
    monkeypatch.setattr("capsyn.compression.fitted.oblique.AIMS", (1.0,))
    monkeypatch.setattr("capsyn.compression.fitted.oblique.ATTEMPTS", 3)


def rows_of(policy, points):
    """Return what follows each label in force at all finest cells, (B, N + 1)."""
    return policy.transitions[policy.cells.labels(points)]


def seen_at(cells, rows, points):
    """Return whether each label was seen in each finest cell, or is its own, (B, J, N + 1)."""
    entries = np.maximum(-1 - cells.entries, 0)
    seen = members(singles(rows[entries], N + 1), N + 1)
    seen[cells.mixed_cells] |= members(cells.mixed_labels, N + 1)
    return seen[cells.find(points)]


@pytest.mark.parametrize("words", [1, 3])
def test_sets_of_rows_against_every_row(words):
    rng = np.random.default_rng(words)
    labels, count = 60 * words, 70 * words
    constant = np.arange(labels)[:, None].repeat(labels, 1)
    rows = np.concatenate([constant, rng.integers(0, labels, (count, labels))])
    near = np.where(rng.random((40, labels)) < 0.02, 0, rows[rng.integers(0, len(rows), 40)])
    sets = singles(near, labels) | singles(rows[rng.integers(0, len(rows), 40)], labels)
    sets[0, 3] = 0
    wanted = np.stack([holds(sets, row).all(axis=1) for row in rows], axis=1)
    assert np.array_equal(row_sets(sets, rows), masks_of_members(wanted)) and wanted.any()
    assert np.array_equal(
        row_sets(sets[:, :1], rows), row_sets(sets[:, :1].repeat(labels, 1), rows)
    )


@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_exact_trees_equal_the_policy_whatever_is_in_force(grid, tmp_path):
    policy = random_memory(grid)
    points = all_points(policy.cells.counts)
    tree = compress(policy)
    assert np.array_equal(rows_of(tree, points), rows_of(policy, points))
    assert prove(tree, policy) == 0.0 == tree.guarantee.changed
    used = np.unique(policy.cells.leaf_labels())
    rest = ROWS[used[used > N]]  # rows that no leaf has are dropped
    assert tree.transitions.tolist() == [*ROWS[: N + 1].tolist(), *rest.tolist()]
    tree.save(tmp_path / "tree")
    loaded = Policy.load(tmp_path / "tree")
    assert type(loaded) is DecisionTree and np.array_equal(loaded.transitions, tree.transitions)
    states = policy.domain.sample(300)
    for current in (-1, 0, 1):
        wanted = policy(states, current=current)
        for other in (tree, loaded):
            assert np.array_equal(other(states, current=current), wanted)
    assert policy_bytes(tree) == packed_bytes(tree.cells) + rest.size


@pytest.mark.parametrize("grid", range(len(GRIDS)))
@pytest.mark.parametrize("options", [{}, {"node_price": 30.0}, {"level": 1}, {"level": 0}])
@pytest.mark.filterwarnings("ignore:the tree gives some symbols")
def test_freedom_takes_rows_whose_labels_were_all_seen(grid, options):
    policy = random_memory(grid, seed=1)
    if options.get("level", 0) > policy.cells.max_level:
        return
    base = policy if "level" not in options else cut_off(policy, options["level"])
    tree = compress(policy, "freedom", **options, **FEW)
    points = all_points(policy.cells.counts)
    coarse = points // (np.array(policy.cells.counts) // base.cells.counts)
    found = rows_of(tree, coarse)
    seen = seen_at(base.cells, ROWS, coarse)
    assert np.take_along_axis(seen, found[:, :, None], axis=2).all()
    mixed = np.isin(base.cells.find(coarse), base.cells.mixed_cells)
    assert np.array_equal(found[~mixed], rows_of(base, coarse)[~mixed])
    changed = (found != rows_of(policy, points)).any(axis=1).mean()
    assert tree.guarantee.changed == pytest.approx(changed, abs=1e-12)
    assert prove(tree, policy) == tree.guarantee.changed
    assert set(map(tuple, tree.transitions)) <= set(map(tuple, ROWS))


@pytest.mark.parametrize("grid", [1, 3, 6])
def test_cut_off_takes_the_row_of_most_volume_and_all_labels_seen(grid):
    policy = random_memory(grid, seed=2)
    cells = policy.cells
    points = all_points(cells.counts)
    own, seen = cells.labels(points), seen_at(cells, ROWS, points)
    for level in range(cells.max_level):
        cut = cut_off(policy, level)
        cut.cells.check(N + 1, policy.transitions)
        block = cut.cells.find(points // (np.array(cells.counts) // cut.cells.counts))
        deeper = block != cells.find(points)
        deeper |= cells.entries[block] >= 0
        for place in np.unique(block[deeper]):
            inside = block == place
            most = np.bincount(own[inside], minlength=len(ROWS)).argmax()
            assert cut.cells.labels_at(place) == most
            at = np.searchsorted(cut.cells.mixed_cells, place)
            wanted = masks_of_members(seen[inside].any(axis=0))
            assert np.array_equal(cut.cells.mixed_labels[at], wanted)


def test_a_row_that_the_policy_does_not_have_is_found():
    policy = random_memory(3)
    tree = compress(policy)
    rows = tree.transitions.copy()
    rows[-1] = [1, 1, 0]
    with pytest.raises(ProblemError, match=r"keep its word: `policy` has no row \[1, 1, 0\]"):
        prove(dataclasses.replace(tree, transitions=rows), policy)


@pytest.mark.parametrize("mode", ["freedom", "linear"])
def test_a_state_agrees_where_the_whole_row_could_be_best(small, quick, mode):
    options = {"agreement": 0.9} if mode == "linear" else {}
    tree = compress(small, mode, states=20_000, **options)
    known = tree.guarantee
    assert known.controller == "ssac" and known.states == 20_000 and tree.remembers
    assert known.reached and known.low >= options.get("agreement", 0.0)
    states = small.domain.sample(40_000, 17)
    sets = policy_controller(small, "auto").masks(states)
    right = np.ones(len(states), dtype=bool)
    for label, current in ((0, 0), (1, 1), (2, -1)):
        found = tree(states, current=current) % (N + 1)
        right &= (sets[:, label, 0] >> found.astype(np.uint64)) & np.uint64(1) != 0
    low, high = clopper_pearson(int(right.sum()), len(states), CONFIDENCE)
    assert low - 0.01 < known.agreement < high + 0.01
    rows = tree.transitions[N + 1 :]
    assert np.array_equal(rows, np.unique(rows, axis=0)) and len(rows)
    wrong = (rows_at(tree, states) != rows_at(small, states)).any(axis=1).mean()
    assert known.changed == pytest.approx(wrong, abs=0.02)
    assert capsyn.agreement(tree, 5000).share >= known.low - 0.01  # the mean over the labels


def test_a_tree_with_features_keeps_its_word():
    policy = capsyn.synthesize(PRICED)  # where pairs of far cells hide values between them
    features = {"energy": lambda x: x[1] ** 2 / 2 + 9.81 * ca.cos(x[0])}
    tree = compress(policy, "freedom", features=features, **FEW)
    assert prove(tree, policy) == tree.guarantee.changed > 0
    assert type(tree.cells) is FeatureTree and len(tree.transitions) > N + 1


def test_affine_leaves_with_prices_have_no_exact_tree():
    policy = capsyn.synthesize(PRICED, partitions=5, max_level=3, leaves="affine")
    assert policy.cells.priced and complexity(policy)["tree"] is None
    for options in ({}, {"level": 1}, {"mode": "freedom"}):
        with pytest.raises(ProblemError, match="mode linear") as caught:
            compress(policy, **options)
        assert "\n" not in str(caught.value)
    states = policy.domain.sample(200)
    for current, column in ((0, 0), (1, 1), (-1, N)):
        rows = rows_at(policy, states)
        assert np.array_equal(rows[:, column], policy(states, current=current) % (N + 1))


@pytest.mark.filterwarnings("ignore:the tree gives some symbols")
def test_a_controller_without_memory_gives_what_may_follow(quick):
    names = ["off", "heat", "cool"]
    rows = np.concatenate([np.arange(4)[:, None].repeat(4, 1), [[0, 1, 2, 0]]])
    none = np.zeros(0, dtype=np.int32), np.zeros((0, 4, 1), dtype=np.uint64)
    policy = Policy(
        "house",
        Box([0], [1]),
        Alphabet([0, 1, -1], names=names),
        np.zeros(1),
        CellTree(Grid((4,), (2,), 0), np.full(4, -5, dtype=np.int32), *none),
        transitions=rows,
        switching=capsyn.Switching(forbidden=[("heat", "cool")]),
    )

    def controller(states):
        return np.where(states[:, 0] < 0.5, 1, 2)

    tree = compress(policy, "linear", controller=controller, **FEW)
    assert tree.node_count == 3 and tree.guarantee.controller == "function"
    assert rows_at(tree, np.array([[0.2], [0.8]])).tolist() == [[1, 1, 1, 1], [2, 1, 2, 2]]
    other = compress(policy, "linear", controller=policy, **FEW)  # one that remembers
    assert other.node_count == 1 and other.transitions.tolist() == rows.tolist()


def test_rows_beyond_the_most_frequent_are_told_of(quick, monkeypatch):
    policy = random_memory(3)
    monkeypatch.setattr("capsyn.compression.judge.MOST_ROWS", 1)
    judge = Judge.of(policy, 1000, 0, "auto")
    rows, share = judge.rows()
    assert len(rows) == N + 2 and 0.2 < share < 0.9
    with pytest.warns(CapsynWarning) as caught:
        tree = compress(policy, "linear", agreement=0.5 + share / 2, **FEW)
    stairs, few, missed = (str(warning.message) for warning in caught)
    assert few.startswith("the controller has more rows than the 4 most frequent, which are right")
    assert not tree.guarantee.reached and "follows their stairs" in stairs
    assert "was not reached" in missed and tree.guarantee.agreement <= share + 0.05
