"""Symbols that a tree loses are named with both shares: in its guarantee, its file, a warning."""

import warnings

import numpy as np
import pytest

from capsyn import Alphabet, Box, Policy, compress, subdivide
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.report import report

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
