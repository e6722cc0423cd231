"""Agreement: where a policy gives another symbol than the controller that it came from.

Algorithm 1 looks at test points only. Random states show what lies between them: how well the
cells along a switching surface follow it, and the islands that all test points of a cell missed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.masks import (
    Label,
    empty,
    holds,
    masks_of_symbols,
    members,
    or_else,
    preferred,
    several,
    singles,
    word_count,
)
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.policies.policy import Policy, cell_tree
from capsyn.statistics import TOLD, check_confidence, clopper_pearson
from capsyn.validation import BACKENDS, describe, one_of, whole_number

CHUNK = 8192
"""States that are compared at once."""
KEPT = 10_000
"""Most disagreeing states, and most islands, that are kept; all are counted."""
WAVE = 32
"""Chunks of states that are in memory at once."""

Controller = Callable[[np.ndarray], Any]
"""States (B, n) to symbols (B,); -1 is the default control."""


@dataclass(frozen=True)
class Island:
    """A cell whose test points agreed, in which a random state disagrees.

    Parameters
    ----------
    level : int
        Level of the cell.
    lower, upper : n floats
        Bounds of the cell [state units].
    symbol : int
        What the policy gives there; -1 is the default control.
    others : ints
        What the controller gives at the states that disagree, ascending.
    states, disagreeing : int
        Random states in the cell, and those of them that disagree.
    example : n floats
        The first state that disagrees [state units].
    """

    level: int
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    symbol: int
    others: tuple[int, ...]
    states: int
    disagreeing: int
    example: tuple[float, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the island as plain data."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items()}


@dataclass(frozen=True, eq=False)
class Agreement:
    """How often a policy of N symbols equals its controller at random states.

    Parameters
    ----------
    symbols : N + 1 strings
        Names of the symbols, "default" last.
    seed : int
        Seed of the states: they are ``policy.domain.sample(states, seed)``.
    states, agreeing : int
        Random states, and those at which the policy agrees.
    confidence, low, high : float
        Clopper-Pearson interval of the share that agrees.
    ties : int
        States where several symbols could be best; any of them agrees.
    not_finite : int
        States where the controller has no finite result; there only the default agrees.
    level_states, level_agreeing : (depth + 1,)
        States in cells of each level, and those that agree. A decision tree has one level.
    mixed_states, mixed_agreeing : int
        States in cells whose test points did not agree, and those that agree. The other states
        lie in uniform cells. The leaves of a decision tree count as mixed.
    pairs : (N + 1, N + 1)
        States by the policy's symbol (row) and the controller's (column), the default last.
    disagreeing_states : (D, n)
        The first states that disagree [state units], at most `KEPT`.
    disagreeing_symbols : (D, 2)
        The policy's and the controller's symbol at each of them; -1 is the default control.
    island_cells, island_states : int
        Uniform cells with disagreeing states, and those states.
    islands : tuple of Island
        These cells, most disagreeing states first, at most `KEPT`.
    """

    symbols: tuple[str, ...]
    seed: int
    states: int
    agreeing: int
    confidence: float
    low: float
    high: float
    ties: int
    not_finite: int
    level_states: np.ndarray
    level_agreeing: np.ndarray
    mixed_states: int
    mixed_agreeing: int
    pairs: np.ndarray
    disagreeing_states: np.ndarray
    disagreeing_symbols: np.ndarray
    island_cells: int
    island_states: int
    islands: tuple[Island, ...]

    @property
    def share(self) -> float:
        """Share of the states, an estimate of that of the volume, where the policy agrees."""
        return self.agreeing / self.states

    def __repr__(self) -> str:
        return (
            f"Agreement({self.agreeing} of {self.states} states, {self.low:.3%} to "
            f"{self.high:.3%}, {self.island_cells} islands)"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data, with the first `TOLD` states and islands."""
        data = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}
        return data | {
            "symbols": list(self.symbols),
            "share": self.share,
            "disagreeing_states": self.disagreeing_states[:TOLD].tolist(),
            "disagreeing_symbols": self.disagreeing_symbols[:TOLD].tolist(),
            "islands": [island.to_json() for island in self.islands[:TOLD]],
        }


def agreement(
    policy: Policy,
    states: int = 100_000,
    *,
    controller: Controller | None = None,
    seed: int = 0,
    confidence: float = 0.95,
    backend: str = "auto",
    threads: int | None = None,
) -> Agreement:
    """Return how often a policy equals a controller at random states of its domain, and where not.

    Parameters
    ----------
    policy : Policy
        The policy.
    states : int
        Number of states, drawn uniformly from the domain.
    controller : callable, optional
        States (B, n) to symbol indices (B,), -1 for the default, such as another policy.
        Default: sSAC with the policy's own model, horizon and settings.
    seed : int
        Seed of the states.
    confidence : float
        Confidence of the interval of the share.
    backend : "auto", "c" or "numpy"
        How sSAC is solved.
    threads : int, optional
        Threads that call the controller. Default: one per processor for sSAC, one for a given
        `controller`. The result does not depend on it.

    Raises
    ------
    ProblemError
        An argument that cannot be used, a policy that carries no model where no `controller` is
        given, or a controller whose output is no symbols.
    KernelBuildError
        ``backend="c"`` without a working compiler.

    Notes
    -----
    Where several symbols tie, the policy agrees if it gives one of them, see
    `BatchController.masks`.
    """
    if not isinstance(policy, Policy):
        raise ProblemError(f"`policy` must be a capsyn.Policy; got {describe(policy)}")
    states = whole_number("states", states, least=1)
    seed = whole_number("seed", seed, least=0)
    confidence = check_confidence(confidence)
    one_of("backend", backend, BACKENDS)
    threads = 1 if threads is None and controller is not None else processors(threads)
    masks, preference = _label(policy, controller, backend)
    tally = _Tally(policy)
    with ThreadPoolExecutor(threads) as pool:
        run = map if threads == 1 else pool.map
        for wave in _waves(policy, states, seed):
            for chunk, labels in zip(wave, run(masks, wave)):
                tally.add(chunk, labels, preference)
    low, high = clopper_pearson(states - tally.wrong, states, confidence)
    return Agreement(
        symbols=(*policy.alphabet.names, "default"),
        seed=seed,
        states=states,
        agreeing=states - tally.wrong,
        confidence=confidence,
        low=low,
        high=high,
        **tally.results(),
    )


def _label(
    policy: Policy, controller: Controller | None, backend: str
) -> tuple[Label, tuple[int, ...]]:
    """Return the controller as a function that gives masks, and its preference among ties."""
    n_symbols = len(policy.alphabet)
    if controller is None:
        ssac = policy_controller(policy, backend)
        if ssac is None:
            raise ProblemError(
                "`policy` must carry its model, horizon and settings, or `controller` must be "
                f"given; got {policy!r} without them"
            )
        return ssac.masks, ssac.preference
    if not callable(controller):
        raise ProblemError(f"`controller` must be a function; got {describe(controller)}")
    if isinstance(controller, Policy) and controller.gaps:
        controller = dataclasses.replace(controller, gaps=False)  # a gap is a label like others
    masks = masks_of_symbols(controller, n_symbols, "controller")
    return masks, tuple(range(n_symbols + 1))


def _waves(policy: Policy, count: int, seed: int) -> Iterator[list[np.ndarray]]:
    """Yield the states of ``policy.domain.sample(count, seed)``, as lists of chunks (B, n)."""
    domain, random = policy.domain, np.random.default_rng(seed)
    sizes = [min(CHUNK, count - start) for start in range(0, count, CHUNK)]
    for start in range(0, len(sizes), WAVE):
        yield [
            domain.lower + random.random((size, domain.n)) * domain.widths
            for size in sizes[start : start + WAVE]
        ]


class _Tally:
    """Counts over chunks of states: in all, by cell, and by pair of symbols."""

    def __init__(self, policy: Policy) -> None:
        cells = policy.cells.node_count
        self._policy = policy
        self._leaves = len(policy.alphabet) + 1
        self._drawn = np.zeros(cells, dtype=np.int64)
        self._wrong = np.zeros(cells, dtype=np.int64)
        self._seen = np.zeros((cells, word_count(self._leaves)), dtype=np.uint64)
        self._pairs = np.zeros((self._leaves, self._leaves), dtype=np.int64)
        self._examples: list[tuple[np.ndarray, np.ndarray]] = []
        self._kept: list[tuple[np.ndarray, np.ndarray]] = []
        self._room = KEPT
        self._ties = self._not_finite = 0

    @property
    def wrong(self) -> int:
        """States that disagree."""
        return int(self._wrong.sum())

    def add(self, states: np.ndarray, masks: np.ndarray, preference: tuple[int, ...]) -> None:
        """Count states (B, n) with the controller's masks (B, W)."""
        tree, default = self._policy.cells, self._leaves - 1
        steps = self._policy.domain.locate(states, tree.counts)
        cells = tree.find(steps)
        own = tree.labels_in(cells, steps)
        self._ties += int(several(masks).sum())
        self._not_finite += int(empty(masks).sum())
        masks = or_else(masks, default)
        agree = holds(masks, own)
        other = np.where(agree, own, preferred(masks, preference))
        np.add.at(self._pairs, (own, other), 1)
        places, counts = np.unique(cells, return_counts=True)
        self._drawn[places] += counts

        states, cells, own, other = (x[~agree] for x in (states, cells, own, other))
        places, first, counts = np.unique(cells, return_index=True, return_counts=True)
        new = self._wrong[places] == 0
        self._examples.append((places[new], states[first[new]]))
        self._wrong[places] += counts
        np.bitwise_or.at(self._seen, cells, singles(other, self._leaves))
        symbols = np.stack([own, other], axis=1)[: self._room]
        self._kept.append((states[: self._room], np.where(symbols == default, -1, symbols)))
        self._room -= len(symbols)

    def results(self) -> dict[str, Any]:
        """Return the fields of an `Agreement` that are counts and places."""
        tree = self._policy.cells
        mixed = tree.mixed_cells
        uniform_wrong = self._wrong.copy()
        uniform_wrong[mixed] = 0
        islands = np.flatnonzero(uniform_wrong)
        level_states, level_wrong = (
            np.array([counts[places].sum() for places in tree.layers()])
            for counts in (self._drawn, self._wrong)
        )
        states, symbols = (np.concatenate(parts) for parts in zip(*self._kept))
        return {
            "ties": self._ties,
            "not_finite": self._not_finite,
            "level_states": level_states,
            "level_agreeing": level_states - level_wrong,
            "mixed_states": int(self._drawn[mixed].sum()),
            "mixed_agreeing": int((self._drawn - self._wrong)[mixed].sum()),
            "pairs": self._pairs,
            "disagreeing_states": states,
            "disagreeing_symbols": symbols,
            "island_cells": len(islands),
            "island_states": int(uniform_wrong.sum()),
            "islands": self._islands(islands) if len(islands) else (),
        }

    def _islands(self, cells: np.ndarray) -> tuple[Island, ...]:
        """Return uniform cells (K,) with disagreeing states, most of these first."""
        tree, domain = cell_tree(self._policy), self._policy.domain
        level = np.zeros(len(cells), dtype=np.int64)
        lower, upper = np.zeros((2, len(cells), tree.n), dtype=np.int64)
        for layer in tree.levels():  # whose places stand side by side
            first, last = layer.places[0], layer.places[-1]
            some = slice(*np.searchsorted(cells, (first, last + 1)))
            here = cells[some] - first
            level[some] = layer.level
            lower[some], upper[some] = layer.lower[here], layer.lower[here] + layer.sizes[here]
        places, states = (np.concatenate(parts) for parts in zip(*self._examples))
        order = np.argsort(places)
        examples = states[order[np.searchsorted(places, cells, sorter=order)]]
        own = tree.labels_in(cells, domain.locate(examples, tree.counts))
        low, high = domain.points(lower, tree.counts), domain.points(upper, tree.counts)

        def symbol(leaf: int) -> int:
            return -1 if leaf == self._leaves - 1 else leaf

        islands = []
        for i in np.argsort(-self._wrong[cells], kind="stable")[:KEPT]:
            seen = np.flatnonzero(members(self._seen[cells[i]], self._leaves))
            islands.append(
                Island(
                    level=int(level[i]),
                    lower=tuple(low[i].tolist()),
                    upper=tuple(high[i].tolist()),
                    symbol=symbol(int(own[i])),
                    others=tuple(map(symbol, seen.tolist())),
                    states=int(self._drawn[cells[i]]),
                    disagreeing=int(self._wrong[cells[i]]),
                    example=tuple(examples[i].tolist()),
                )
            )
        return tuple(islands)
