"""The tree that `capsyn.compress` returns where closed loops judge it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from capsyn.cells.cell_tree import CellTree
from capsyn.compression.judge import Judge
from capsyn.compression.looped.choice import Budget, LoopChoice
from capsyn.compression.looped.fitting import fit_candidates
from capsyn.compression.looped.loops import Loops
from capsyn.compression.trees import FREE_PRICES, proved_free_trees
from capsyn.errors import ProblemError, warn
from capsyn.modelling.discrete import horizon_time
from capsyn.policies.guarantee import LOSS, LoopFigures
from capsyn.policies.policy import DecisionTree, Policy
from capsyn.validation import describe, one_of, whole_number
from capsyn.verification.trials import TrialOptions

TRIALS = 400
"""Closed loops that choose a tree, and others that judge it, unless told."""
HORIZONS, DURATION = 10.0, 20.0
"""Time of a loop unless told, in prediction horizons; of a policy without one [time unit]."""
MODES = ("linear", "freedom")
"""Modes whose trees may be judged by loops."""
NOT_ASKED = ("stop_at_target", "executor", "track")
"""Arguments of closed loops that are not those of `compress`."""


def check_budget(
    nodes: int | None, bytes: int | None, size: Callable[[DecisionTree], int] | None
) -> Budget:
    """Return what a tree may take; `ProblemError` for what cannot be meant."""
    if nodes is not None and bytes is not None:
        raise ProblemError("`nodes` and `bytes` exclude each other; got both")
    if size is not None and not callable(size):
        raise ProblemError(f"`size` must be a function of a tree; got {describe(size)}")
    if size is not None and bytes is None:
        raise ProblemError("`size` needs `bytes`")
    if bytes is None:
        limit = None if nodes is None else whole_number("nodes", nodes, least=1)
        return Budget(limit)
    limit = whole_number("bytes", bytes, least=1)
    if size is None:
        return Budget(limit, packed, "bytes packed")
    return Budget(limit, size, getattr(size, "name", "bytes"))


def packed(tree: DecisionTree) -> int:
    """Return the bytes of a tree's arrays and rows, each in the smallest integers that hold it."""
    from capsyn.compression.rows import policy_bytes

    return policy_bytes(tree)


def trial_options(
    policy: Policy, seed: int, backend: str, given: Mapping[str, Any]
) -> TrialOptions:
    """Return how loops run that judge trees of a policy, with arguments of `capsyn.monte_carlo`."""
    duration = HORIZONS * time if (time := horizon_time(policy)) else DURATION
    known = {"duration": duration, "trials": TRIALS} | dict(given)
    own = {"seed": seed, "backend": backend}
    for name in own:
        if name in given:
            raise ProblemError(f"there is no argument `{name}` of closed loops")
    return TrialOptions.of(without=NOT_ASKED, **known, **own)


def loop_tree(
    judge: Judge,
    mode: str,
    level: int | None,
    budget: Budget,
    options: TrialOptions,
    progress: Callable[[str], None] | None = None,
) -> DecisionTree:
    """Return the tree of a mode that is best in closed loop within a budget, judged.

    Without a limit it is the smallest that loses little against the policy.
    """
    choice = _begun(judge, options, budget, progress)
    look(choice, mode, level)
    tree = choice.judged(*choice.best())
    if not tree.guarantee.reached:
        warn(_shortfall(tree))
    return tree


def loop_choice(
    judge: Judge, options: TrialOptions, nodes: int, progress: Callable[[str], None] | None = None
) -> LoopChoice:
    """Return a choice among trees of mode linear, of up to so many nodes."""
    choice = _begun(judge, options, Budget(nodes), progress)
    look(choice, "linear", None)
    return choice


def _begun(
    judge: Judge,
    options: TrialOptions,
    budget: Budget,
    progress: Callable[[str], None] | None,
) -> LoopChoice:
    """Return a choice among no trees yet; `ProblemError` where the policy itself does nothing."""
    choice = LoopChoice.of(judge, Loops.of(judge.policy, options), budget, progress)
    if not choice.own.success.any():
        raise ProblemError(
            f"`policy` itself succeeds in none of {len(choice.own.success)} closed loops over "
            f"{options.loop.duration:g} {judge.policy.time_unit}: there is nothing to judge trees "
            "by; see `duration`, `initial` and `target`"
        )
    return choice


def look(choice: LoopChoice, mode: str, level: int | None) -> None:
    """Make candidates of the trees of a mode."""
    judge = choice.judge
    if one_of("mode", mode, MODES) == "linear":
        rows, _ = judge.rows()
        fit_candidates(choice, rows)
        return
    for tree in _free(judge, level):
        choice.look(tree)


def _free(judge: Judge, level: int | None) -> Iterator[DecisionTree]:
    """Yield the trees of mode freedom for several prices, at one level or all."""
    cells = judge.policy.cells
    assert isinstance(cells, CellTree)
    for cut in range(1, cells.depth + 1) if level is None else (level,):
        own = None if cut == cells.depth else cut
        yield from proved_free_trees(judge, own, FREE_PRICES)


def _shortfall(tree: DecisionTree) -> str:
    """Return that the best tree does not fit, or is worse than its policy."""
    figures = tree.guarantee.loop
    assert isinstance(figures, LoopFigures)
    size, of = f"{figures.size:,} {figures.measure}", f"of {figures.trials:,} loops"
    if not figures.fits:
        limit = f"{figures.limit:,} {figures.measure}"
        return f"no tree of at most {limit} was found: the smallest takes {size}"
    more = "" if figures.limit is None else "; allow more"
    return (
        f"the best tree, of {size}, loses more than {LOSS:.0%} against the policy: it succeeds in "
        f"{figures.success:.1%} {of}, the policy in {figures.own_success:.1%}, at "
        f"{figures.ratio:.3g} times the cost{more}"
    )
