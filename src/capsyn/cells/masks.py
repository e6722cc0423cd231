"""Sets of symbols as bit masks: bit `i` for symbol `i`, bit N for the default control."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.validation import describe

Label = Callable[[np.ndarray], np.ndarray]
"""A labelling function: states (B, n) to masks (B,), 0 where there is no finite answer."""
Scored = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""One with scores: states (B, n) to masks (B,) and scores (B, V, S) in V variants."""


def several(masks: np.ndarray) -> np.ndarray:
    """Return whether each mask holds more than one symbol."""
    return (masks & (masks - masks.dtype.type(1))) != 0


def members(masks: np.ndarray, count: int) -> np.ndarray:
    """Return whether each mask (...) holds each of the first `count` bits, (..., count)."""
    return masks[..., None] >> np.arange(count, dtype=masks.dtype) & masks.dtype.type(1) != 0


def masks_of_members(held: np.ndarray) -> np.ndarray:
    """Return the masks (B,) uint64 that hold the symbols where `held` (B, S) is true."""
    bits = np.uint64(1) << np.arange(held.shape[1], dtype=np.uint64)
    return np.bitwise_or.reduce(np.where(held, bits, np.uint64(0)), axis=1)


def holds(masks: np.ndarray, symbols: np.ndarray) -> np.ndarray:
    """Return whether each mask (B,) holds its symbol (B,)."""
    return masks >> symbols.astype(masks.dtype) & masks.dtype.type(1) != 0


def preferred(masks: np.ndarray, order: Sequence[int]) -> np.ndarray:
    """Return the symbol of each mask that comes first in `order`; anything where it is 0."""
    labels = np.full(masks.shape, order[-1], dtype=np.int32)
    for symbol in reversed(order[:-1]):
        labels[(masks & masks.dtype.type(1 << symbol)) != 0] = symbol
    return labels


def most_voted(masks: np.ndarray, order: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the labels (K,) and the sets of labels seen (K,) of mixed cells.

    `masks` (P, K) are those of their test points.

    The labels seen are those of determined points, or of all points where none is determined.
    Every point votes for each label it could have; ties go by `order`.
    """
    single = np.where(several(masks), masks.dtype.type(0), masks)
    seen = np.bitwise_or.reduce(single, axis=0)
    seen = np.where(seen == 0, np.bitwise_or.reduce(masks, axis=0), seen)
    labels = np.full(len(seen), order[0], dtype=np.int32)
    most = np.zeros(len(seen), dtype=np.int64)
    for symbol in order:
        bit = masks.dtype.type(1 << symbol)
        votes = np.count_nonzero(masks & bit, axis=0) * ((seen & bit) != 0)
        labels[votes > most] = symbol
        most = np.maximum(votes, most)
    return labels, np.asarray(seen)


def checked_masks(label: Label, n_symbols: int) -> Label:
    """Return the labelling function with its masks checked."""
    known = np.uint64(2 ** (n_symbols + 1) - 1)

    def masks(states: np.ndarray) -> np.ndarray:
        sets = np.asarray(label(states))
        if sets.shape != (len(states),) or sets.dtype.kind != "u":
            raise ProblemError(
                f"`label` must return ({len(states)},) unsigned integers; got "
                f"{sets.dtype} of shape {sets.shape}"
            )
        wrong = sets > known
        if wrong.any():
            i = int(np.flatnonzero(wrong)[0])
            raise ProblemError(
                f"`label` must return masks of bits 0 to {n_symbols}; got {int(sets[i]):#b} "
                f"at state {states[i].tolist()}"
            )
        return sets

    return masks


def masks_of_symbols(label: Label, n_symbols: int, name: str = "label") -> Label:
    """Return a labelling function that gives masks from one that gives symbols.

    Errors call it `name`.
    """

    def masks(states: np.ndarray) -> np.ndarray:
        symbols = np.asarray(label(states))
        if symbols.shape != (len(states),) or not np.issubdtype(symbols.dtype, np.integer):
            raise ProblemError(
                f"`{name}` must return ({len(states)},) integers; got "
                f"{symbols.dtype} of shape {symbols.shape}"
            )
        wrong = (symbols < -1) | (symbols >= n_symbols)
        if wrong.any():
            i = int(np.flatnonzero(wrong)[0])
            raise ProblemError(
                f"`{name}` must return symbols from -1 to {n_symbols - 1}; got {symbols[i]} "
                f"at state {states[i].tolist()}"
            )
        bits = np.where(symbols < 0, n_symbols, symbols).astype(np.uint64)
        return np.uint64(1) << bits

    return masks


def indicators(label: Label, n_symbols: int) -> Scored:
    """Return a labelling function with scores (B, N + 1): 1, shared by the symbols of a mask."""

    def scored(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        masks = label(states)
        held = members(masks, n_symbols + 1).astype(float)
        return masks, (held / np.maximum(held.sum(axis=1, keepdims=True), 1))[:, None]

    return scored


def masks_of_scores(label: Callable[[np.ndarray], np.ndarray], n_symbols: int) -> Scored:
    """Return a labelling function with scores, of one that gives scores (B, N) or (B, N + 1)."""

    def scored(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scores = _checked_scores(label(states), len(states), n_symbols)
        finite = np.isfinite(scores).all(axis=1)
        masks = masks_of_members(scores == scores.max(axis=1, keepdims=True))
        masks[~finite] = 0
        return masks, scores[:, None]

    return scored


def checked_pair(label: Callable[[np.ndarray], Any], n_symbols: int) -> Scored:
    """Return the labelling function, of masks and scores, with both checked."""

    def scored(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pair = label(states)
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise ProblemError(
                f"`label` must return a pair of masks and scores; got {describe(pair)}"
            )
        masks = checked_masks(lambda _: pair[0], n_symbols)(states)
        scores = np.asarray(pair[1])
        if scores.ndim == 3:
            for variant in np.moveaxis(scores, 1, 0):
                _checked_scores(variant, len(states), n_symbols)
            return masks, scores
        return masks, _checked_scores(scores, len(states), n_symbols)[:, None]

    return scored


def _checked_scores(answer: Any, count: int, n_symbols: int) -> np.ndarray:
    scores = np.asarray(answer)
    if scores.dtype.kind != "f" or scores.shape not in (
        (count, n_symbols),
        (count, n_symbols + 1),
    ):
        raise ProblemError(
            f"`label` must return ({count}, {n_symbols}) scores, or with the default's last "
            f"({count}, {n_symbols + 1}); got {scores.dtype} of shape {scores.shape}"
        )
    return scores
