"""Symbols that a decision tree loses: whose share of the volume falls to 0, or by half."""

from __future__ import annotations

import dataclasses

import numpy as np

from capsyn.compression.rows import rows_at
from capsyn.errors import warn
from capsyn.modelling.switching import DEFAULT
from capsyn.policies.policy import DecisionTree, Policy, cell_tree
from capsyn.random_streams import derived_seed

STATES, LOOK = 100_000, 8
"""Random states at which shares are estimated where planes bound symbols, and their purpose."""
FEWEST = 10
"""States of a symbol below which half of them may be chance."""


def with_lost(tree: DecisionTree, policy: Policy, seed: int) -> DecisionTree:
    """Return a tree whose guarantee names the symbols that it loses, with a warning if any.

    A symbol is lost where its share of the volume, of a policy that remembers the mean over the
    symbols in force, is 0, or at most half of that of the policy. The default control is among
    them. Where shares are sampled, it is 0 only if no leaf of the tree has the symbol.
    """
    if tree.guarantee.mode == "exact" and tree.guarantee.level is None:
        return tree
    own, left, least = _shares(policy, tree, seed)
    has = np.isin(np.arange(len(own)), tree.transitions[tree.cells.leaf_labels()])
    own = np.where(has, own, _in_cells(policy, own))
    left[~has] = 0.0
    gone = (own > 0) & ~has
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


def _in_cells(policy: Policy, sampled: np.ndarray) -> np.ndarray:
    """Return the shares (N + 1,) of labels in a policy, none 0 whose symbol a whole cell has.

    Beside a policy's affine leaves its shares are `sampled`.
    """
    if not policy.has_planes:
        return policy.volume_shares
    cells, rows = cell_tree(policy), policy.transitions
    places, volumes = cells.volumes()
    numbers = cells.labels_at(places)
    whole = numbers < len(rows)
    taken = rows[numbers[whole]][:, slice(None, -1) if policy.remembers else slice(-1, None)]
    weights = np.repeat(volumes[whole] / np.prod(cells.counts, dtype=float), taken.shape[1])
    shares = np.bincount(taken.ravel(), weights, rows.shape[1]) / taken.shape[1]
    return np.maximum(sampled, shares)
