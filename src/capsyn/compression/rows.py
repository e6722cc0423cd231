"""Policies as rows, which label follows each label in force, and trees whose leaves are rows."""

from __future__ import annotations

import dataclasses

import numpy as np

from capsyn.cells.packing import packed_bytes, smallest_type
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.errors import ProblemError
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree, Policy


def rows_at(policy: Policy, states: np.ndarray) -> np.ndarray:
    """Return the label (B, N + 1) that follows each label in force at states (B, n) of the domain.

    The label of a gap is the default's.
    """
    cells, rows = policy.cells, policy.transitions
    steps = policy.space.locate(states, cells.counts)
    if not cells.priced:
        return rows[cells.labels(steps)]
    found = np.empty((len(steps), rows.shape[1]), dtype=rows.dtype)
    for now in range(rows.shape[1]):
        numbers = cells.labels(steps, np.full(len(steps), now, dtype=np.int32))
        found[:, now] = rows[numbers, now]
    return found


def tree_of_rows(
    policy: Policy, cells: SplitTree, rows: np.ndarray, guarantee: Guarantee
) -> DecisionTree:
    """Return `policy` with a tree for its cells, whose leaves are numbers of `rows` (R, N + 1).

    The first N + 1 are constant. Of the others it keeps those that a leaf has, in order.
    """
    constant = rows.shape[1]
    used = np.unique(cells.leaf_labels())
    used = used[used >= constant]
    kept, place = np.unique(rows[used], axis=0, return_inverse=True)
    numbers = np.arange(len(rows))
    numbers[used] = constant + place.ravel()
    known = {f.name: getattr(policy, f.name) for f in dataclasses.fields(Policy)}
    known |= {
        "cells": renumbered(cells, numbers),
        "transitions": np.concatenate([rows[:constant], kept]),
        "evidence": {},
        "timings": {},
    }
    return DecisionTree(guarantee=guarantee, **known)


def renumbered(cells: SplitTree, numbers: np.ndarray) -> SplitTree:
    """Return a tree with new numbers (R,) for the rows of its leaves."""
    threshold = cells.threshold.copy()
    leaves = cells.split == LEAF
    threshold[leaves] = numbers[threshold[leaves]]
    return dataclasses.replace(cells, threshold=threshold)


def numbered_like(tree: DecisionTree, policy: Policy) -> SplitTree:
    """Return a tree's cells with the numbers that a policy has for its rows.

    A row that the policy does not have is a `ProblemError`.
    """
    if np.array_equal(tree.transitions, policy.transitions):
        return tree.cells
    known = {row.tobytes(): number for number, row in enumerate(policy.transitions)}
    numbers = np.array([known.get(row.tobytes(), -1) for row in tree.transitions])
    strange = numbers[tree.cells.leaf_labels()] < 0
    if strange.any():
        row = tree.transitions[tree.cells.leaf_labels()[strange][0]].tolist()
        raise ProblemError(f"`tree` does not keep its word: `policy` has no row {row}")
    return renumbered(tree.cells, numbers)


def policy_bytes(policy: Policy) -> int:
    """Return the bytes of what a lookup needs: cells, and rows that are not constant."""
    rows = policy.transitions[policy.transitions.shape[1] :]
    return packed_bytes(policy.cells) + rows.size * smallest_type(rows).itemsize
