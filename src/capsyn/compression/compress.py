"""From a policy to a small decision tree, with a statement of what the tree guarantees.

Of a policy that remembers, a leaf of the tree is a row, what follows each symbol in force, and all
that is said of symbols is said of whole rows: two are the same, or right, where they are so for
every symbol in force, the default control among them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import FeatureTree
from capsyn.compression.affine_tree import MAX_NODES, affine_tree
from capsyn.compression.coarsening import cut_off
from capsyn.compression.features.cell_fit import MOST_CELLS, fit_cells
from capsyn.compression.features.space import LEAST_MARGIN, Functions, Space, check_functions
from capsyn.compression.fitted.oblique import Fit, fine_lattice, fit_tree
from capsyn.compression.freedom import cell_votes, exact_prices, free_prices
from capsyn.compression.induction import Prices, induce
from capsyn.compression.judge import Judge
from capsyn.compression.proof import prove
from capsyn.compression.rows import tree_of_rows
from capsyn.errors import ProblemError, warn
from capsyn.policies.file import content_hash
from capsyn.policies.guarantee import MODES, Guarantee
from capsyn.policies.policy import DecisionTree, Policy, cell_tree
from capsyn.validation import BACKENDS, describe, finite_number, one_of, whole_number
from capsyn.verification.agreement import Controller

FREE_PRICES = (16.0, 2.0, 1.0, 0.5, 0.25, 0.1, 0.05)
"""Finest cells of disagreement that a node is worth, from the smallest tree on."""
DEFAULT_AGREEMENT = 0.99
"""That of mode linear."""
FEATURE_STEPS = 4096
"""Most lattice steps along an axis of a tree of mode linear with features."""
NODE_PRICE = 0.5
"""That of mode freedom where no agreement is asked for."""
MAX_STATES = 10_000_000
"""Most states at which trees are judged."""
MAX_NODE_PRICE = 1000.0
"""Larger prices make no smaller trees."""
WAYS_OUT = (
    "export the cells themselves (style cells of c and structured-text; python, javascript, json "
    "and fmu do), compress in mode linear, or synthesize with fewer symbols or solves, or a larger "
    "leaf_error"
)
"""What may be done where the tree of a policy with affine leaves is too large."""
OPTION_MODES = {
    "agreement": ("freedom", "linear"),
    "level": ("exact", "freedom"),
    "node_price": ("freedom",),
}
"""The modes that an option is for."""


def compress(
    policy: Policy,
    mode: str = "exact",
    *,
    agreement: float | None = None,
    level: int | None = None,
    node_price: float | None = None,
    states: int = 100_000,
    seed: int = 0,
    controller: Controller | None = None,
    features: Functions | None = None,
    backend: str = "auto",
) -> DecisionTree:
    """Return a small decision tree that does the work of a policy.

    Parameters
    ----------
    policy : Policy
        A policy of cells.
    mode : "exact", "freedom" or "linear"
        ``exact``: equal to the policy everywhere. ``freedom``: mixed cells, those at the finest
        level whose test points did not agree, may take any symbol seen in them; with memory any row
        of the policy whose symbols were all seen in them, each for its symbol in force. ``linear``:
        splits
        may be affine in the state, fitted to the controller that the policy came from.
    agreement : float, optional
        Least share of the volume, above 0 and below 1, where the tree shall agree with the
        controller. For ``linear`` 0.99 by default, for ``freedom`` what `node_price` gives. Not for
        ``exact``.
    level : int, optional
        Merge the cells below this level first: a smaller tree that agrees less. Not for
        ``linear``, which makes no use of the cells where there is a model.
    node_price : float, optional
        For ``freedom`` without `agreement`: how many finest cells of disagreement saving one node
        is worth, 0.5 by default. The larger, the smaller the tree.
    states : int
        Random states at which the tree is judged.
    seed : int
        Of everything that is random; the same seed gives the same tree.
    controller : callable, optional
        What trees are fitted to and judged by: states (B, n), or readings, to symbol indices (B,),
        -1 for the default, whatever is in force; or a policy, which may remember. Default: sSAC
        with the policy's own model, or the policy where that has none.
    features : dict of functions, optional
        Functions of the state by name, in CasADi's terms like a problem's, that splits may compare
        beside the states: ``{"energy": lambda x: ...}``, and ``lambda x, w: ...`` for a policy that
        is told exogenous inputs. They are evaluated at the centres of the steps of the tree's
        lattice, and those that a tree does not use are dropped. Not with `level`, `node_price`, or,
        in mode ``freedom``, `agreement`.
    backend : "auto", "c" or "numpy"
        How sSAC is solved.

    Returns
    -------
    DecisionTree
        Its `guarantee` says what it has in common with the policy.

    Warns
    -----
    CapsynWarning
        `agreement` was not reached, and the best tree found is returned; or it is finer than the
        cells of a policy without a controller, so that the tree follows their stairs. `features`
        make no tree smaller, and one without is returned; or one comes very near to a threshold.

    Raises
    ------
    ProblemError
        An argument that cannot be used.
    """
    cells = cell_tree(policy)
    options = {"agreement": agreement, "level": level, "node_price": node_price}
    _check_mode(policy, mode, options)
    if features is not None:
        check_functions(features)
        _check_features(cells, mode, options)
    if agreement is not None:
        agreement = finite_number("agreement", agreement, above=0.0)
        if agreement >= 1:
            raise ProblemError(f"`agreement` must be above 0 and below 1; got {agreement:g}")
        if node_price is not None:
            raise ProblemError("`agreement` and `node_price` exclude each other; got both")
    if level is not None:
        level = whole_number("level", level, least=0, most=max(cells.max_level, cells.depth))
    node_price = finite_number(
        "node_price", NODE_PRICE if node_price is None else node_price, least=0.0
    )
    states = whole_number("states", states, least=1, most=MAX_STATES)
    seed = whole_number("seed", seed, least=0)
    one_of("backend", backend, BACKENDS)
    if features is not None:
        judge = Judge.of(policy, states, seed, backend, controller)
        return _told(judge, feature_tree(judge, mode, features, agreement))
    if mode == "exact":
        return exact_tree(policy, level)
    judge = Judge.of(policy, states, seed, backend, controller)
    if mode == "linear":
        target = DEFAULT_AGREEMENT if agreement is None else agreement
        if judge.source is None and policy.mixed_share > 1 - target:
            warn(
                f"cells whose test points disagree cover {policy.mixed_share:.2%} of the volume: "
                f"an agreement of {target:g} follows their stairs; give a controller, or ask for "
                "less"
            )
        tree = linear_tree(judge, target)
    elif agreement is None:
        (tree,) = free_trees(judge, level, (node_price,))
    else:
        tree = _smallest_free_tree(judge, level, agreement)
    return _told(judge, tree)


def _told(judge: Judge, tree: DecisionTree) -> DecisionTree:
    """Return a tree, with a warning where it misses its target, or features need a check."""
    if isinstance(tree.cells, FeatureTree):
        margin = tree.cells.features.margin
        if margin is not None and margin < LEAST_MARGIN:
            warn(
                f"a feature comes as near as {margin:.1e} of its span to a threshold: targets that "
                "round otherwise may give another symbol there"
            )
    if not tree.guarantee.reached:
        warn(judge.advice(tree))
    return tree


def feature_tree(
    judge: Judge, mode: str, functions: Functions, agreement: float | None
) -> DecisionTree:
    """Return the tree of a mode whose splits may compare features, judged."""
    from capsyn.compression.features.controller_fit import fit_controller

    policy = judge.policy
    told = policy.space.n - policy.domain.n
    if mode == "linear":
        target = DEFAULT_AGREEMENT if agreement is None else agreement
        space = Space.of(functions, policy.space, fine_lattice(policy.space, FEATURE_STEPS), told)
        rows = _rows(judge, target)
        fit = fit_controller(judge.masks(rows), space, len(rows), target, judge.seed, judge.states)
        return _linear(judge, fit, rows, target)
    plain = exact_tree(policy) if mode == "exact" else next(free_trees(judge, None, (NODE_PRICE,)))
    space = Space.of(functions, policy.space, cell_tree(policy).counts, told)
    cells = fit_cells(policy, space, mode == "freedom", plain.node_count)
    if cells is None:
        warn(f"no tree with `features` is smaller than the {plain.node_count} nodes without")
        return plain
    claim = Guarantee(mode, content_hash(policy))
    tree = tree_of_rows(policy, cells, policy.transitions, claim)
    tree = dataclasses.replace(
        tree, guarantee=dataclasses.replace(claim, changed=prove(tree, policy))
    )
    return tree if mode == "exact" else judge.judged(tree, None)


def _check_features(cells: CellTree, mode: str, options: dict[str, Any]) -> None:
    """Raise `ProblemError` unless cells have a tree with features of a mode with such options."""
    for name, value in options.items():
        if value is not None and mode != "linear":
            raise ProblemError(f"`{name}` is not for mode {mode} with `features`; got {value!r}")
    if mode != "linear" and (cells.affine is not None or math.prod(cells.counts) > MOST_CELLS):
        raise ProblemError(
            f"`features` in mode {mode} are for at most {MOST_CELLS:,} finest cells, of one symbol "
            f"each; mode linear has no such limit; got {math.prod(cells.counts):,}"
            + (" and affine leaves" if cells.affine is not None else "")
        )


def _check_mode(policy: Policy, mode: str, options: dict[str, Any]) -> None:
    """Raise `ProblemError` unless a policy has a tree of a mode with such options."""
    one_of("mode", mode, list(MODES))
    level = options["level"]
    if policy.gaps and (mode == "linear" or level is not None):
        raise ProblemError(
            "`mode` must be exact or freedom, without `level`, for a policy with gaps: other trees "
            "would give symbols there"
        )
    for name, value in options.items():
        if value is not None and mode not in OPTION_MODES[name]:
            modes = " and ".join(OPTION_MODES[name])
            raise ProblemError(f"`{name}` is for mode {modes} only; got {describe(value)}")
    if policy.has_planes and (mode == "freedom" or level is not None):
        got = "level" if level is not None else "mode 'freedom'"
        there = "is mode linear" if policy.cells.priced else "are modes exact and linear"
        raise ProblemError(
            f"`policy` has affine leaves, for which there {there}, without level; got {got}"
        )


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
    return _proved_tree(policy, base, "exact", level, exact_prices(base))


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
    for tree in _free_trees(judge, level, node_prices):
        yield judge.judged(tree, None)


def _free_trees(
    judge: Judge, level: int | None, node_prices: Iterable[float]
) -> Iterator[DecisionTree]:
    policy = judge.policy
    base = policy if level is None else cut_off(policy, level)
    votes = cell_votes(base, None if judge.source is None else judge.sets, judge.seed)
    for node_price in node_prices:
        prices = free_prices(base, votes, min(node_price, MAX_NODE_PRICE))
        yield _proved_tree(policy, base, "freedom", level, prices)


def _proved_tree(
    policy: Policy, base: Policy, mode: str, level: int | None, prices: Prices
) -> DecisionTree:
    """Return the tree of a cut-off policy under some prices, its guarantee proved cell by cell."""
    claim = Guarantee(mode, content_hash(policy), level)
    tree = tree_of_rows(policy, induce(cell_tree(base), prices), base.transitions, claim)
    guarantee = dataclasses.replace(claim, changed=prove(tree, policy))
    return dataclasses.replace(tree, guarantee=guarantee)


def _smallest_free_tree(judge: Judge, level: int | None, target: float) -> DecisionTree:
    """Return the smallest tree of mode freedom that reaches a target, or else the best.

    A tree that reaches it at the states that trees are chosen by is judged at states of its own.
    """
    tried: list[DecisionTree] = []
    own = judge.compare(judge.policy)
    prices = FREE_PRICES if own.high >= target else FREE_PRICES[-1:]  # freedom only loses
    for look, tree in enumerate(_free_trees(judge, level, prices), start=1):
        tried.append(judge.judged(tree, target))
        if tried[-1].guarantee.reached:
            tried[-1] = judge.judged(tree, target, look)
            if tried[-1].guarantee.reached:
                return tried[-1]
    best = max(tried, key=lambda tree: tree.guarantee.agreeing)
    return judge.judged(best, target, len(tried) + 1)


def linear_tree(judge: Judge, target: float) -> DecisionTree:
    """Return the tree of mode linear that `fit_tree` finds for a target, judged."""
    policy, rows = judge.policy, _rows(judge, target)
    kept = {"seed": judge.seed, "states": judge.states}
    fit = fit_tree(judge.masks(rows), policy.space, len(rows), target, **kept)
    return _linear(judge, fit, rows, target)


def _rows(judge: Judge, target: float) -> np.ndarray:
    """Return the rows (R, N + 1) that trees are fitted with, and warn where they are too few."""
    rows, share = judge.rows()
    if share < target:
        warn(
            f"the controller has more rows than the {len(rows)} most frequent, which are right at "
            f"{share:.2%} of the states: a tree with these cannot agree at {target:.6g}"
        )
    return rows


def _linear(judge: Judge, fit: Fit, rows: np.ndarray, target: float) -> DecisionTree:
    """Return a tree of some rows fitted to a controller, judged."""
    policy = judge.policy
    tree = tree_of_rows(policy, fit.tree, rows, Guarantee("linear", content_hash(policy)))
    changed = 1.0 - judge.compare(tree, with_policy=True).share
    return judge.with_counts(tree, target, fit.judged, fit.right, changed=changed)
