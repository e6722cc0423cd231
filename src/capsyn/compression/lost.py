"""Symbols that a decision tree loses: whose share of the volume falls to 0, or by half."""

from __future__ import annotations

import dataclasses

import numpy as np

from capsyn.compression.rows import rows_at
from capsyn.errors import warn
from capsyn.modelling.switching import DEFAULT
from capsyn.policies.policy import DecisionTree, Policy
from capsyn.random_streams import derived_seed

STATES, LOOK = 100_000, 8
"""Random states at which shares are estimated where planes bound symbols, and their purpose."""
FEWEST = 10
"""States of a symbol below which half of them may be chance."""


def with_lost(tree: DecisionTree, policy: Policy, seed: int) -> DecisionTree:
    """Return a tree whose guarantee names the symbols that it loses, with a warning if any.

    A symbol is lost where its share of the volume, of a policy that remembers the mean over the
    symbols in force, is 0, or at most half of that of the policy. The default control is among
    them.
    """
    if tree.guarantee.mode == "exact" and tree.guarantee.level is None:
        return tree
    own, left, least = _shares(policy, tree, seed)
    leaves = np.unique(tree.transitions[tree.cells.leaf_labels()])
    left[np.setdiff1d(np.arange(len(left)), leaves)] = 0.0
    gone = (own > 0) & (left == 0)
    fallen = (own >= least) & (left <= own / 2)
    names = (*policy.alphabet.names, DEFAULT)
    lost = {names[k]: (float(own[k]), float(left[k])) for k in np.flatnonzero(gone | fallen)}
    tree = dataclasses.replace(tree, guarantee=dataclasses.replace(tree.guarantee, lost=lost))
    if lost:
        warn(tree.guarantee.lost_text)
    return tree


def _shares(policy: Policy, tree: DecisionTree, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the shares (N + 1,) of labels in both, and from which on they are no chance."""
    if not (policy.has_planes or tree.has_planes):
        return policy.volume_shares, tree.volume_shares.copy(), np.finfo(float).tiny
    states = policy.space.sample(STATES, derived_seed(seed, LOOK))
    in_force = slice(None, -1) if policy.remembers or tree.remembers else slice(-1, None)
    count = policy.transitions.shape[1]
    rows = (rows_at(one, states)[:, in_force].ravel() for one in (policy, tree))
    own, left = (np.bincount(row, minlength=count) / row.size for row in rows)
    return own, left, FEWEST / STATES
