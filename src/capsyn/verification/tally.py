"""What is counted where a policy and a controller are compared at random states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.masks import (
    Label,
    empty,
    holds,
    members,
    or_else,
    preferred,
    several,
    singles,
    word_count,
)
from capsyn.policies.policy import Policy, cell_tree

KEPT = 10_000
"""Most disagreeing states, and most islands, that are kept; all are counted."""


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
    in_force : int, optional
        The symbol in force there, where that matters; `symbol` is what follows it.
    """

    level: int
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    symbol: int
    others: tuple[int, ...]
    states: int
    disagreeing: int
    example: tuple[float, ...]
    in_force: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the island as plain data."""
        told = {k: v for k, v in vars(self).items() if v is not None}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in told.items()}


@dataclass(frozen=True, eq=False)
class Rule:
    """What a policy is compared with, for J symbols in force."""

    masks: Label  # states (B, n) to masks of the symbols that are right there, (B, J, W) or (B, W)
    preference: tuple[int, ...]  # among ties
    in_force: int  # J: 1 where neither the policy nor the controller depends on the symbol in force


class Tally:
    """Counts over chunks of states: in all, by cell, and by pair of symbols."""

    def __init__(self, policy: Policy, rule: Rule) -> None:
        cells = policy.cells.node_count
        self._policy, self._rule = policy, rule
        self._leaves = len(policy.alphabet) + 1
        self._drawn = np.zeros(cells, dtype=np.int64)
        self._wrong = np.zeros(cells, dtype=np.int64)
        self._seen = np.zeros((cells, word_count(self._leaves)), dtype=np.uint64)
        self._pairs = np.zeros((self._leaves, self._leaves), dtype=np.int64)
        self._agreeing = np.zeros(rule.in_force, dtype=np.int64)
        self._examples: list[tuple[np.ndarray, ...]] = []
        self._kept: list[tuple[np.ndarray, ...]] = []
        self._room = KEPT
        self._ties = self._not_finite = 0

    @property
    def wrong(self) -> int:
        """Pairs of a state and a symbol in force that disagree."""
        return int(self._wrong.sum())

    def add(self, states: np.ndarray, masks: np.ndarray) -> None:
        """Count states (B, n) with the controller's masks (B, W) or (B, J, W)."""
        default, in_force = self._leaves - 1, self._rule.in_force
        if masks.ndim == 2:
            masks = np.repeat(masks[:, None], in_force, axis=1)
        masks = masks.reshape(-1, masks.shape[-1])
        first = default if in_force == 1 else 0
        now = np.tile(np.arange(first, self._leaves), len(states))
        states = np.repeat(states, in_force, axis=0)
        own, cells = self._following(states, now)
        self._ties += int(several(masks).sum())
        self._not_finite += int(empty(masks).sum())
        masks = or_else(masks, default)
        agree = holds(masks, own)
        wanted = preferred(masks, self._rule.preference)
        if in_force > 1:
            wanted = np.where(holds(masks, now), now, wanted)
        other = np.where(agree, own, wanted)
        np.add.at(self._pairs, (own, other), 1)
        self._agreeing += agree.reshape(-1, in_force).sum(axis=0)
        places, counts = np.unique(cells, return_counts=True)
        self._drawn[places] += counts

        states, cells, own, other, now = (x[~agree] for x in (states, cells, own, other, now))
        places, at, counts = np.unique(cells, return_index=True, return_counts=True)
        new = self._wrong[places] == 0
        self._examples.append((places[new], states[at[new]], now[at[new]]))
        self._wrong[places] += counts
        np.bitwise_or.at(self._seen, cells, singles(other, self._leaves))
        symbols = np.stack([own, other, now], axis=1)[: self._room]
        self._kept.append((states[: self._room], np.where(symbols == default, -1, symbols)))
        self._room -= len(symbols)

    def _following(self, states: np.ndarray, now: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what follows labels in force (B,) at states (B, n), and the cells of these."""
        tree = self._policy.cells
        steps = self._policy.space.locate(states, tree.counts)
        cells = tree.find(steps)
        return self._policy.transitions[tree.labels_in(cells, steps, now), now], cells

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
            "disagreeing_symbols": symbols[:, :2],
            "island_cells": len(islands),
            "island_states": int(uniform_wrong.sum()),
            "islands": self._islands(islands) if len(islands) else (),
            **(
                {"in_force_agreeing": self._agreeing, "disagreeing_in_force": symbols[:, 2]}
                if self._rule.in_force > 1
                else {}
            ),
        }

    def _islands(self, cells: np.ndarray) -> tuple[Island, ...]:
        """Return uniform cells (K,) with disagreeing states, most of these first."""
        tree, domain = cell_tree(self._policy), self._policy.space
        level = np.zeros(len(cells), dtype=np.int64)
        lower, upper = np.zeros((2, len(cells), tree.n), dtype=np.int64)
        for layer in tree.levels():  # whose places stand side by side
            first, last = layer.places[0], layer.places[-1]
            some = slice(*np.searchsorted(cells, (first, last + 1)))
            here = cells[some] - first
            level[some] = layer.level
            lower[some], upper[some] = layer.lower[here], layer.lower[here] + layer.sizes[here]
        places, states, labels = (np.concatenate(parts) for parts in zip(*self._examples))
        order = np.argsort(places)
        chosen = order[np.searchsorted(places, cells, sorter=order)]
        examples, now = states[chosen], labels[chosen]
        own, _ = self._following(examples, now)
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
                    in_force=symbol(int(now[i])) if self._rule.in_force > 1 else None,
                )
            )
        return tuple(islands)
