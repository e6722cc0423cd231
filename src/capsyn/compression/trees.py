"""The trees of a policy in modes exact, freedom and linear, with what they guarantee."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np

from capsyn.compression.affine_tree import MAX_NODES, affine_tree
from capsyn.compression.coarsening import cut_off
from capsyn.compression.fitted.oblique import Fit, fit_tree
from capsyn.compression.freedom import cell_votes, exact_prices, free_prices
from capsyn.compression.induction import Prices, induce
from capsyn.compression.judge import Judge
from capsyn.compression.proof import prove
from capsyn.compression.rows import tree_of_rows
from capsyn.errors import ProblemError, warn
from capsyn.policies.file import content_hash
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree, Policy, cell_tree

FREE_PRICES = (16.0, 2.0, 1.0, 0.5, 0.25, 0.1, 0.05)
"""Finest cells of disagreement that a node is worth, from the smallest tree on."""
MAX_NODE_PRICE = 1000.0
"""Larger prices make no smaller trees."""
WAYS_OUT = (
    "export the cells themselves (style cells of c and structured-text; python, javascript, json "
    "and fmu do), compress in mode linear, or synthesize with fewer symbols or solves, or a larger "
    "leaf_error"
)
"""What may be done where the tree of a policy with affine leaves is too large."""


def tree_of(policy: Policy) -> DecisionTree:
    """Return a decision tree as it is, and of a policy of cells its exact tree."""
    return policy if isinstance(policy, DecisionTree) else exact_tree(policy)


def exact_tree(policy: Policy, level: int | None = None) -> DecisionTree:
    """Return the tree of mode exact of a policy, cut off at a level.

    That of a policy with affine leaves has oblique splits.
    """
    if cell_tree(policy).priced:
        raise ProblemError(
            "`policy` has affine leaves with prices, which have no exact tree: export the cells "
            "themselves, or compress in mode linear"
        )
    if cell_tree(policy).affine is not None:
        tree = affine_tree_of(policy, MAX_NODES)
        if tree is None:
            raise ProblemError(
                f"the tree of this policy with affine leaves has more than {MAX_NODES:,} nodes: "
                f"{WAYS_OUT}"
            )
        return tree
    base = policy if level is None else cut_off(policy, level)
    return proved_tree(policy, base, "exact", level, exact_prices(base))


def affine_tree_of(policy: Policy, most: int) -> DecisionTree | None:
    """Return the exact tree of a policy with affine leaves; None where it has too many nodes.

    So it is where leaves have prices, which no tree of rows is equal to.
    """
    tree = affine_tree(cell_tree(policy), most)
    guarantee = Guarantee("exact", content_hash(policy))  # by construction
    return None if tree is None else DecisionTree.of(policy, tree, guarantee)


def free_trees(
    judge: Judge, level: int | None, node_prices: Iterable[float]
) -> Iterator[DecisionTree]:
    """Yield the trees of mode freedom of a policy, cut off at a level, for some prices; judged."""
    for tree in proved_free_trees(judge, level, node_prices):
        yield judge.judged(tree, None)


def proved_free_trees(
    judge: Judge, level: int | None, node_prices: Iterable[float]
) -> Iterator[DecisionTree]:
    """Yield the same, not judged."""
    policy = judge.policy
    base = policy if level is None else cut_off(policy, level)
    votes = cell_votes(base, None if judge.source is None else judge.sets, judge.seed)
    for node_price in node_prices:
        prices = free_prices(base, votes, min(node_price, MAX_NODE_PRICE))
        yield proved_tree(policy, base, "freedom", level, prices)


def proved_tree(
    policy: Policy, base: Policy, mode: str, level: int | None, prices: Prices
) -> DecisionTree:
    """Return the tree of a cut-off policy under some prices, its guarantee proved cell by cell."""
    claim = Guarantee(mode, content_hash(policy), level)
    tree = tree_of_rows(policy, induce(cell_tree(base), prices), base.transitions, claim)
    guarantee = dataclasses.replace(claim, changed=prove(tree, policy))
    return dataclasses.replace(tree, guarantee=guarantee)


def smallest_free_tree(judge: Judge, level: int | None, target: float) -> DecisionTree:
    """Return the smallest tree of mode freedom that reaches a target, or else the best.

    A tree that reaches it at the states that trees are chosen by is judged at states of its own.
    """
    tried: list[DecisionTree] = []
    own = judge.compare(judge.policy)
    prices = FREE_PRICES if own.high >= target else FREE_PRICES[-1:]  # freedom only loses
    for look, tree in enumerate(proved_free_trees(judge, level, prices), start=1):
        tried.append(judge.judged(tree, target))
        if tried[-1].guarantee.reached:
            tried[-1] = judge.judged(tree, target, look)
            if tried[-1].guarantee.reached:
                return tried[-1]
    best = max(tried, key=lambda tree: tree.guarantee.agreeing)
    return judge.judged(best, target, len(tried) + 1)


def linear_tree(judge: Judge, target: float) -> DecisionTree:
    """Return the tree of mode linear that `fit_tree` finds for a target, judged."""
    policy, rows = judge.policy, rows_of(judge, target)
    kept = {"seed": judge.seed, "states": judge.states}
    fit = fit_tree(judge.masks(rows), policy.space, len(rows), target, **kept)
    return linear_of(judge, fit, rows, target)


def rows_of(judge: Judge, target: float) -> np.ndarray:
    """Return the rows (R, N + 1) that trees are fitted with, and warn where they are too few."""
    rows, share = judge.rows()
    if share < target:
        warn(
            f"the controller has more rows than the {len(rows)} most frequent, which are right at "
            f"{share:.2%} of the states: a tree with these cannot agree at {target:.6g}"
        )
    return rows


def linear_of(judge: Judge, fit: Fit, rows: np.ndarray, target: float) -> DecisionTree:
    """Return a tree of some rows fitted to a controller, judged."""
    policy = judge.policy
    tree = tree_of_rows(policy, fit.tree, rows, Guarantee("linear", content_hash(policy)))
    changed = 1.0 - judge.compare(tree, with_policy=True).share
    return judge.with_counts(tree, target, fit.judged, fit.right, changed=changed)
