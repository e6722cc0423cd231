"""Symbols that a tree loses are named with both shares: in its guarantee, its file, a warning."""

import dataclasses
import warnings

import numpy as np
import pytest

from capsyn import Alphabet, Box, Policy, compress, subdivide
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.compression.lost import _shares, with_lost
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.modelling.switching import DEFAULT
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree
from capsyn.policies.report import report
from support.trees import random_affine_policy

RARE = Alphabet([-1, 0, 1], names=["left", "off", "right"])


def labels(x):
    """Return left and right, and off in 1 % of the square."""
    off = np.abs(x).max(axis=1) < 0.1
    return np.where(off, 1, np.where(x[:, 0] + 0.3 * x[:, 1] < 0, 2, 0))


@pytest.fixture(scope="module")
def policy():
    return subdivide(labels, Box([-1, -1], [1, 1]), RARE, partitions=10, max_level=2)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_rare_symbol_that_oblique_splits_cut_away_is_named(policy, seed):
    with pytest.warns(CapsynWarning, match=r"off from [01]\.\d\d% to 0\.00% of the volume"):
        tree = compress(policy, "linear", agreement=0.97, controller=labels, seed=seed)
    own, left = tree.guarantee.lost.pop("off")
    assert not tree.guarantee.lost and left == 0 and own == pytest.approx(0.01, abs=0.001)


def test_it_is_told_wherever_the_tree_goes(policy, tmp_path):
    with pytest.warns(CapsynWarning, match="half as often as the policy, or never"):
        tree = compress(policy, "exact", level=0)  # cells of 0.2: off falls from 1 % or is gone
    lost = tree.guarantee.lost
    assert list(lost) == ["off"]
    shares = [dict(zip(RARE.names, p.volume_shares))["off"] for p in (policy, tree)]
    assert lost["off"] == tuple(shares) and 0 <= 2 * shares[1] <= shares[0]
    tree.save(tmp_path / "tree.cap")
    again = Policy.load(tmp_path / "tree.cap")
    assert again.guarantee == tree.guarantee
    data = report(again)
    assert data["guarantee"]["lost"] == {"off": list(shares)}
    assert sum("off" in hint for hint in data["hints"]) == 1
    assert tree.guarantee.lost_text in data["hints"]


def test_nothing_is_said_where_all_symbols_stay(policy):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trees = [
            compress(policy),
            compress(policy, "freedom"),
            compress(policy, "linear", agreement=0.995, controller=labels),
        ]
    for tree in trees:
        assert not tree.guarantee.lost and "lost" not in tree.guarantee.to_json()
        assert not [hint for hint in report(tree)["hints"] if "never" in hint]


def cut(policy, *nodes):
    """Return a decision tree of nodes (split, threshold, second), oblique along x + y."""
    split, threshold, second = np.array(nodes, dtype=np.int32).T
    planes = np.ones(((split >= 0).sum(), policy.domain.n), dtype=np.int32)
    cells = SplitTree(policy.cells.counts, split, threshold, second, planes)
    cells.check(len(policy.alphabet))
    known = {f.name: getattr(policy, f.name) for f in dataclasses.fields(Policy)}
    return DecisionTree(**known | {"cells": cells, "guarantee": Guarantee("linear", "0" * 64)})


@pytest.fixture(scope="module")
def dotted():
    """Return a policy of 90,000 cells, of which one is off."""

    def corner(x):
        return np.where(x.min(axis=1) > 0.992, 1, np.where(x.sum(axis=1) < 0, 0, 2))

    return subdivide(corner, Box([-1, -1], [1, 1]), RARE, partitions=300, max_level=0)


HALVES = [(2, 300, 2), (LEAF, 0, 1), (LEAF, 2, 2)]


def test_a_symbol_is_gone_where_no_leaf_has_it_whether_sampled_or_not(dotted):
    tree, sampled = cut(dotted, *HALVES), set()
    for seed in range(6):
        sampled.add(_shares(dotted, tree, seed)[0][1])
        with pytest.warns(CapsynWarning, match="off from"):
            lost = with_lost(tree, dotted, seed).guarantee.lost
        assert lost == {"off": (pytest.approx(1 / 90_000), 0.0)}
    assert 0.0 in sampled and len(sampled) > 1


def test_a_sampled_state_is_no_loss_where_a_leaf_has_the_symbol(dotted):
    elsewhere = [(2, 1, 2), (LEAF, 1, 1), (3, 300, 4), (LEAF, 0, 3), (LEAF, 2, 4)]
    tree, sampled = cut(dotted, *elsewhere), set()
    for seed in range(6):
        own, left, _ = _shares(dotted, tree, seed)
        sampled.add(bool(own[1] > 0 and left[1] == 0))
        assert not with_lost(tree, dotted, seed).guarantee.lost
    assert True in sampled


def test_whole_cells_beside_affine_leaves_count_without_samples(monkeypatch):
    policy = random_affine_policy(3)
    monkeypatch.setattr("capsyn.compression.lost.STATES", 1)
    whole = np.unique(policy.cells.constant_leaves(len(policy.transitions)))
    names = [*policy.alphabet.names, DEFAULT]
    assert len(whole) > 1
    with pytest.warns(CapsynWarning):
        lost = with_lost(cut(policy, (LEAF, whole[0], 0)), policy, 0).guarantee.lost
    assert {names[k] for k in whole[1:]} <= set(lost) and names[whole[0]] not in lost


def test_a_symbol_that_was_never_used_is_no_loss_and_a_hint_of_the_policy():
    wide = Alphabet([-1, 0, 1], names=["left", "idle", "right"])
    policy = subdivide(lambda x: 2 * (x[:, 0] > 0), Box([-1, -1], [1, 1]), wide, partitions=3)
    tree = compress(policy, "linear", agreement=0.9)
    assert not tree.guarantee.lost
    (own,) = [hint for hint in report(policy)["hints"] if "idle" in hint]
    (told,) = [hint for hint in report(tree)["hints"] if "idle" in hint]
    assert own.startswith("never used: idle; drop") and "in the tree: idle" in told
    (equal,) = [hint for hint in report(compress(policy))["hints"] if "idle" in hint]
    assert equal == own


@pytest.mark.parametrize(
    "lost", [{"off": (0.1, 0.06)}, {"off": (0.0, 0.0)}, {"off": 0.1}, {"\n": (0.1, 0.0)}, [], None]
)
def test_losses_that_make_no_sense_are_refused(lost):
    with pytest.raises(ProblemError, match="does not make sense"):
        Guarantee("exact", "0" * 64, lost=lost)
