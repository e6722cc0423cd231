"""From a policy to a small decision tree, with a statement of what the tree guarantees.

The leaves of the tree of a policy that remembers are rows. A row lists the next symbol for each
symbol in force, including the default control. Two rows are the same, or a row is right, only if
this holds for every symbol in force.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import FeatureTree
from capsyn.compression.features.cell_fit import MOST_CELLS, fit_cells
from capsyn.compression.features.space import LEAST_MARGIN, Functions, Space, check_functions
from capsyn.compression.fitted.oblique import fine_lattice
from capsyn.compression.judge import Judge
from capsyn.compression.looped.by_loop import MODES as LOOP_MODES
from capsyn.compression.looped.by_loop import check_budget, loop_tree, trial_options
from capsyn.compression.lost import with_lost
from capsyn.compression.proof import prove
from capsyn.compression.rows import tree_of_rows
from capsyn.compression.trees import (
    exact_tree,
    free_trees,
    linear_of,
    linear_tree,
    rows_of,
    smallest_free_tree,
)
from capsyn.errors import ProblemError, warn
from capsyn.policies.file import content_hash
from capsyn.policies.guarantee import MODES, Guarantee
from capsyn.policies.policy import DecisionTree, Policy, cell_tree
from capsyn.validation import BACKENDS, describe, finite_number, one_of, whole_number
from capsyn.verification.agreement import Controller
from capsyn.verification.trials import TrialOptions

DEFAULT_AGREEMENT = 0.99
"""That of mode linear."""
FEATURE_STEPS = 4096
"""Most lattice steps along an axis of a tree of mode linear with features."""
NODE_PRICE = 0.5
"""That of mode freedom where no agreement is asked for."""
MAX_STATES = 10_000_000
"""Most states at which trees are judged."""
OPTION_MODES = {
    "agreement": ("freedom", "linear"),
    "level": ("exact", "freedom"),
    "node_price": ("freedom",),
}
"""The modes that an option is for."""


def compress(
    policy: Policy,
    mode: str | None = None,
    *,
    agreement: float | None = None,
    level: int | None = None,
    node_price: float | None = None,
    states: int = 100_000,
    seed: int = 0,
    controller: Controller | None = None,
    features: Functions | None = None,
    backend: str = "auto",
    judge: str = "volume",
    nodes: int | None = None,
    bytes: int | None = None,
    size: Callable[[DecisionTree], int] | None = None,
    progress: Callable[[str], None] | None = None,
    **loop: Any,
) -> DecisionTree:
    """Return a small decision tree that does the work of a policy.

    Parameters
    ----------
    policy : Policy
        A policy of cells.
    mode : "exact", "freedom" or "linear", optional
        What the tree may do. ``exact`` equals the policy everywhere. ``freedom`` may take, in a
        mixed cell, any symbol that was seen there. (A mixed cell is a finest cell whose test points
        did not agree. With memory, it may take any row of the policy whose symbols were all seen
        there.) ``linear`` has splits that are affine in the state, fitted to the controller of the
        policy. Default: ``exact``, or ``linear`` with `judge` "loop".
    agreement : float, optional
        Least share of the volume, above 0 and below 1, in which the tree must agree with the
        controller. Default: 0.99 for ``linear``, and what `node_price` gives for ``freedom``. Mode
        ``exact`` takes none.
    level : int, optional
        Level below which cells are merged first, for a smaller tree that agrees less. Mode
        ``linear`` takes none, as it does not use the cells of a policy with a model.
    node_price : float, optional
        For ``freedom`` without `agreement`: how many finest cells of disagreement are worth one
        node less, 0.5 by default. A larger price makes a smaller tree.
    states : int
        Number of random states at which the tree is judged.
    seed : int
        Seed of all random numbers. The same seed gives the same tree.
    controller : callable, optional
        The controller that trees are fitted to and judged by. The controller is a function of
        states (B, n), or readings, that returns symbol indices (B,), -1 for the default, whatever
        symbol is in force. The controller may also be a policy, which may remember. Default: sSAC
        with the policy's own model, or the policy itself if it has no model.
    features : dict of functions, optional
        Functions of the state by name that splits may compare beside the states: ``{"energy":
        lambda x: ...}``, or ``lambda x, w: ...`` for a policy that is told exogenous inputs.
        Features take CasADi columns, like the functions of a problem, and are evaluated at the
        centres of the lattice steps of the tree. Features that a tree does not use are dropped.
        Features exclude `level`, `node_price` and, in mode ``freedom``, `agreement`.
    backend : "auto", "c" or "numpy"
        How sSAC is solved and loops are simulated: compiled if possible ("auto"), or as told.
    judge : "volume" or "loop"
        "volume" chooses trees by the share of the volume in which they agree with the controller.
        "loop" chooses trees by the cost and success of their closed loops. Mode ``linear`` then
        fits trees to the states that closed loops visit. Mode ``freedom`` then tries several levels
        and prices. The tree is the best within `nodes` or `bytes`. If neither is given, it is the
        smallest that is near the policy. Trials that no choice saw judge the tree. "loop" excludes
        mode ``exact``, `agreement`, `node_price` and `features`.
    nodes, bytes : int, optional
        Largest number of nodes, or of bytes, of a tree that loops judge.
    size : callable ``tree -> bytes``, optional
        A function that counts `bytes`, such as `capsyn.exports.c.code_size.CodeSize`. Default: the
        bytes of the tree's arrays, each in the smallest integers that hold it.
    progress : callable, optional
        A function that is called with a text now and then, if loops judge.
    **loop
        How loops run: arguments of `capsyn.monte_carlo` by name, such as `duration`, `rate`,
        `initial`, `within`, `hold`, `exogenous`. Default: 400 trials of 10 horizons of the policy.
        Without a target, a trial succeeds if it runs to its end.

    Returns
    -------
    DecisionTree
        The tree, whose `guarantee` says how it compares with the policy.

    Warns
    -----
    CapsynWarning
        A symbol has at most half of its share of the volume in the tree, or none. Or no tree fits
        the budget, or the best tree loses more than a tenth of success or cost against the policy.
        Or no tree reaches `agreement`, and the best tree found is returned. Or `agreement` asks for
        more than the cells of a policy without a controller know, and the tree follows their
        stairs. Or `features` make no tree smaller, and a tree without features is returned. Or the
        value of a feature comes very near to a threshold.

    Raises
    ------
    ProblemError
        An argument that cannot be used.
    """
    cells = cell_tree(policy)
    by_loop = one_of("judge", judge, ("volume", "loop")) == "loop"
    if mode is None:
        mode = "linear" if by_loop else "exact"
    options = {"agreement": agreement, "level": level, "node_price": node_price}
    _check_mode(policy, mode, options, by_loop)
    _check_judge(by_loop, mode, options | {"features": features},
                 {"nodes": nodes, "bytes": bytes, "size": size} | loop)  # fmt: skip
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
    if mode == "exact" and features is None:
        return with_lost(exact_tree(policy, level), policy, seed)
    known = Judge.of(policy, states, seed, backend, controller)
    if by_loop:
        budget = check_budget(nodes, bytes, size)
        loops = trial_options(policy, seed, backend, loop)
        return with_lost(loop_tree(known, mode, level, budget, loops, progress), policy, seed)
    if features is not None:
        tree = feature_tree(known, mode, features, agreement)
    else:
        tree = _volume_tree(known, mode, level, agreement, node_price)
    return with_lost(_told(known, tree), policy, seed)


def _volume_tree(
    judge: Judge, mode: str, level: int | None, agreement: float | None, node_price: float
) -> DecisionTree:
    """Return the tree of mode freedom or linear that agreement by volume chooses."""
    if mode == "linear":
        target = DEFAULT_AGREEMENT if agreement is None else agreement
        if judge.source is None and judge.policy.mixed_share > 1 - target:
            warn(
                f"cells whose test points disagree cover {judge.policy.mixed_share:.2%} of the "
                f"volume: an agreement of {target:g} follows their stairs; give a controller, or "
                "ask for less"
            )
        return linear_tree(judge, target)
    if agreement is None:
        return next(free_trees(judge, level, (node_price,)))
    return smallest_free_tree(judge, level, agreement)


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
        rows = rows_of(judge, target)
        fit = fit_controller(judge.masks(rows), space, len(rows), target, judge.seed, judge.states)
        return linear_of(judge, fit, rows, target)
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


def _check_judge(
    by_loop: bool, mode: str, options: dict[str, Any], of_loops: dict[str, Any]
) -> None:
    """Raise `ProblemError` unless options are for trees that loops judge, or do not."""
    if not by_loop:
        known = {"nodes", "bytes", "size"} | TrialOptions.names()
        for name, value in of_loops.items():
            if name not in known:
                raise ProblemError(f"there is no argument `{name}` here; got {describe(value)}")
            if value is not None:
                raise ProblemError(f"`{name}` is for judge 'loop' only; got {describe(value)}")
        return
    if mode not in LOOP_MODES:
        raise ProblemError(
            f"`mode` must be {' or '.join(LOOP_MODES)} with judge 'loop'; got '{mode}', whose tree "
            "is equal to the policy"
        )
    for name in ("agreement", "node_price", "features"):
        if options[name] is not None:
            got = describe(options[name])
            raise ProblemError(f"`{name}` is not for judge 'loop', which has a budget; got {got}")


def _check_mode(policy: Policy, mode: str, options: dict[str, Any], by_loop: bool) -> None:
    """Raise `ProblemError` unless a policy has a tree of a mode with such options."""
    one_of("mode", mode, list(MODES))
    level = options["level"]
    if policy.kept is not None and (by_loop or mode == "linear" or level is not None):
        raise ProblemError(
            "`mode` must be exact or freedom, without `level` and judge 'loop', for a policy that "
            "keeps limits: other trees would not keep them"
        )
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
