"""Sets of symbols as bit masks: words of bits, symbol `i` is bit ``i % b`` of word ``i // b``.

An array of sets (...) has one axis more, that of the words (..., W): of 64 bits, or of fewer where
one word is enough. Bit N is the default control.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.validation import describe

WORD = 64
"""Most bits of a word."""
Label = Callable[[np.ndarray], np.ndarray]
"""A labelling function: states (B, n) to masks (B, W), 0 where there is no finite answer."""
Scored = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""One with scores: states (B, n) to masks (B, W) and scores (B, V, S) in V variants."""
COST_TIE = 1e-9
"""Share of the least cost by which another symbol's may be larger and still tie with it."""


def word_count(count: int) -> int:
    """Return how many words hold so many bits."""
    return -(-count // WORD)


def word_type(count: int) -> np.dtype[Any]:
    """Return the smallest type of words for sets of so many symbols."""
    return np.dtype(f"uint{next((b for b in (8, 16, 32) if count <= b), WORD)}")


def _bit(sets: np.ndarray, symbol: int) -> tuple[int, Any]:
    """Return the word that a symbol is in, and its bit there."""
    bits = 8 * sets.dtype.itemsize
    return symbol // bits, sets.dtype.type(1 << symbol % bits)


def last_all(true: np.ndarray) -> np.ndarray:
    """Return whether all along the last axis is true; a view where that is of length 1."""
    return true[..., 0] if true.shape[-1] == 1 else np.asarray(true.all(axis=-1))


def last_any(true: np.ndarray) -> np.ndarray:
    """Return whether any along the last axis is true; a view where that is of length 1."""
    return true[..., 0] if true.shape[-1] == 1 else np.asarray(true.any(axis=-1))


def empty(sets: np.ndarray) -> np.ndarray:
    """Return whether each set (...) holds nothing."""
    return last_all(sets == 0)


def several(sets: np.ndarray) -> np.ndarray:
    """Return whether each set (...) holds more than one symbol."""
    more = last_any((sets & (sets - sets.dtype.type(1))) != 0)
    if sets.shape[-1] > 1:
        more = more | ((sets != 0).sum(axis=-1) > 1)
    return more


def members(sets: np.ndarray, count: int) -> np.ndarray:
    """Return whether each set (...) holds each of the first `count` symbols, (..., count)."""
    symbols = np.arange(count)
    bits = 8 * sets.dtype.itemsize
    words = np.take(sets, symbols // bits, axis=-1)
    return words >> (symbols % bits).astype(sets.dtype) & sets.dtype.type(1) != 0


def masks_of_members(held: np.ndarray, words: int | None = None) -> np.ndarray:
    """Return the sets (..., W) uint64 that hold the symbols where `held` (..., S) is true.

    By default they have as few words as hold them.
    """
    octets = np.packbits(held, axis=-1, bitorder="little")
    sets = np.zeros((*held.shape[:-1], 8 * (words or word_count(held.shape[-1]))), dtype=np.uint8)
    sets[..., : octets.shape[-1]] = octets
    return sets.view("<u8").astype(np.uint64, copy=False)


def cheapest(costs: np.ndarray) -> np.ndarray:
    """Return which costs (..., N) are finite and, within `COST_TIE`, the least of the N."""
    least = costs.min(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        near = costs <= least + COST_TIE * np.abs(least)
    return np.asarray(near & np.isfinite(costs))


def priced_sets(low: np.ndarray, high: np.ndarray, prices: np.ndarray) -> np.ndarray:
    """Return the sets (B, J, W) of symbols that could be best for each of J labels in force.

    `low` and `high` (B, S) bound what the symbols score, least is best; going from j to i costs
    `prices` (J, S) more. A symbol could be best where no other surely is better. Sets are empty
    where no bound is finite.
    """
    sets = np.empty((len(low), len(prices), word_count(low.shape[1])), dtype=np.uint64)
    for j, price in enumerate(prices):
        least = (high + price).min(axis=1, keepdims=True)
        could = (low + price <= least) & np.isfinite(least)
        sets[:, j] = masks_of_members(could)
    return sets


def singles(symbols: np.ndarray, count: int) -> np.ndarray:
    """Return the sets (..., W) uint64 of one symbol each, of `count` symbols in all."""
    if word_count(count) == 1:
        return (np.uint64(1) << symbols.astype(np.uint64))[..., None]
    sets = np.zeros((*symbols.shape, word_count(count)), dtype=np.uint64)
    symbols = np.asarray(symbols).astype(np.int64)[..., None]
    np.put_along_axis(sets, symbols // WORD, np.uint64(1) << (symbols % WORD).astype(np.uint64), -1)
    return sets


def or_else(sets: np.ndarray, symbol: int, stays: np.ndarray | None = None) -> np.ndarray:
    """Return sets (..., W), those that are empty with a symbol.

    Where `stays` (J,), of sets (..., J, W), with the one in force instead: none may follow.
    """
    none = empty(sets)
    if not none.any():
        return sets
    word, bit = _bit(sets, symbol)
    sets = sets.copy()
    sets[none, word] = bit
    for own in np.flatnonzero(stays) if stays is not None else ():
        word, bit = _bit(sets, int(own))
        sets[none[..., own], own] = 0
        sets[none[..., own], own, word] = bit
    return sets


def holds(sets: np.ndarray, symbols: np.ndarray) -> np.ndarray:
    """Return whether each set (...) holds its symbol (...)."""
    bits = 8 * sets.dtype.itemsize
    if sets.shape[-1] == 1:
        word = sets[..., 0]
    else:
        places = np.broadcast_to(symbols, sets.shape[:-1])[..., None] // bits
        word = np.take_along_axis(sets, places.astype(np.int64), axis=-1)[..., 0]
    return word >> (symbols % bits).astype(sets.dtype) & sets.dtype.type(1) != 0


def _present(sets: np.ndarray, order: Sequence[int]) -> list[int]:
    """Return those symbols of an order, in order, that some set (..., W) holds."""
    there = np.bitwise_or.reduce(sets.reshape(-1, sets.shape[-1]), axis=0)
    held = members(there, max(order, default=0) + 1)
    return [symbol for symbol in order if held[symbol]]


def preferred(sets: np.ndarray, order: Sequence[int]) -> np.ndarray:
    """Return the symbol of each set that comes first in `order`; anything where it is empty."""
    labels = np.full(sets.shape[:-1], order[-1], dtype=np.int32)
    for symbol in reversed(_present(sets, order[:-1])):
        word, bit = _bit(sets, symbol)
        labels[(sets[..., word] & bit) != 0] = symbol
    return labels


def most_voted(sets: np.ndarray, order: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the labels (...), their votes and the sets of labels seen (..., W) of mixed cells.

    `sets` (P, ..., W) are those of their test points.

    The labels seen are those of determined points, or of all points where none is determined.
    Every point votes for each label it could have; ties go by `order`.
    """
    undetermined = several(sets)[..., None]
    seen: np.ndarray = np.bitwise_or.reduce(
        np.where(undetermined, sets.dtype.type(0), sets), axis=0
    )
    np.copyto(seen, np.bitwise_or.reduce(sets, axis=0), where=empty(seen)[..., None])
    shape, words = seen.shape[:-1], seen.shape[-1]
    flat, own = sets.reshape(len(sets), -1, words), seen.reshape(-1, words)
    labels = np.full(len(own), order[0], dtype=np.int32)
    most = np.zeros(len(own), dtype=np.int64)
    for symbol in _present(seen, order):
        word, bit = _bit(sets, symbol)
        known = np.flatnonzero(own[:, word] & bit)
        votes = np.count_nonzero(flat[:, known, word] & bit, axis=0)
        more = votes > most[known]
        labels[known[more]], most[known[more]] = symbol, votes[more]
    return labels.reshape(shape), most.reshape(shape), seen


def checked_masks(label: Callable[[np.ndarray], Any], n_symbols: int, in_force: int = 1) -> Label:
    """Return a labelling function of sets (B, W), or (B,) where W is 1, with its sets checked.

    For several labels `in_force` they are sets (B, J, W), or (B, J).
    """
    words = word_count(n_symbols + 1)
    top = np.uint64(2 ** ((n_symbols + 1) % WORD or WORD) - 1)

    def masks(states: np.ndarray) -> np.ndarray:
        sets = np.asarray(label(states))
        wanted = (len(states), words) if in_force == 1 else (len(states), in_force, words)
        if sets.ndim == len(wanted) - 1 and words == 1:
            sets = sets[..., None]
        if sets.shape != wanted or sets.dtype.kind != "u":
            shape = wanted[:-1] if words == 1 else wanted
            raise ProblemError(
                f"`label` must return {shape} unsigned integers; got "
                f"{sets.dtype} of shape {sets.shape}"
            )
        wrong = last_any(sets[..., -1:] > top)
        if wrong.any():
            place = tuple(np.argwhere(wrong)[0])
            got = sum(int(word) << WORD * k for k, word in enumerate(sets[place].tolist()))
            raise ProblemError(
                f"`label` must return masks of bits 0 to {n_symbols}; got {got:#b} "
                f"at state {states[place[0]].tolist()}"
            )
        return sets.astype(word_type(n_symbols + 1), copy=False)

    return masks


def masks_of_symbols(
    label: Callable[[np.ndarray], Any], n_symbols: int, name: str = "label", in_force: int = 1
) -> Label:
    """Return a labelling function that gives masks from one that gives symbols.

    Errors call it `name`. For several labels `in_force` they are symbols (B, J).
    """

    def masks(states: np.ndarray) -> np.ndarray:
        symbols = np.asarray(label(states))
        wanted = (len(states),) if in_force == 1 else (len(states), in_force)
        if symbols.shape != wanted or not np.issubdtype(symbols.dtype, np.integer):
            raise ProblemError(
                f"`{name}` must return {wanted} integers; got "
                f"{symbols.dtype} of shape {symbols.shape}"
            )
        wrong = (symbols < -1) | (symbols >= n_symbols)
        if wrong.any():
            i = tuple(np.argwhere(wrong)[0])
            raise ProblemError(
                f"`{name}` must return symbols from -1 to {n_symbols - 1}; got {symbols[i]} "
                f"at state {states[i[0]].tolist()}"
            )
        return singles(np.where(symbols < 0, n_symbols, symbols), n_symbols + 1)

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
        best = scores == scores.max(axis=1, keepdims=True)
        masks = masks_of_members(best, word_count(n_symbols + 1))
        masks[~finite] = 0
        return masks, scores[:, None]

    return scored


def checked_pair(label: Callable[[np.ndarray], Any], n_symbols: int, in_force: int = 1) -> Scored:
    """Return the labelling function, of masks and scores, with both checked."""

    def scored(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pair = label(states)
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise ProblemError(
                f"`label` must return a pair of masks and scores; got {describe(pair)}"
            )
        masks = checked_masks(lambda _: pair[0], n_symbols, in_force)(states)
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
