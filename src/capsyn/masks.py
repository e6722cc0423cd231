"""Sets of symbols as bit masks: bit `i` for symbol `i`, bit N for the default control."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from capsyn.errors import ProblemError

Label = Callable[[np.ndarray], np.ndarray]
"""A labelling function: states (B, n) to masks (B,), 0 where there is no finite answer."""


def several(masks: np.ndarray) -> np.ndarray:
    """Return whether each mask holds more than one symbol."""
    return (masks & (masks - masks.dtype.type(1))) != 0


def preferred(masks: np.ndarray, order: Sequence[int]) -> np.ndarray:
    """Return the symbol of each mask that comes first in `order`; anything where it is 0."""
    labels = np.full(masks.shape, order[-1], dtype=np.int32)
    for symbol in reversed(order[:-1]):
        labels[(masks & masks.dtype.type(1 << symbol)) != 0] = symbol
    return labels


def checked_masks(label: Label, n_symbols: int) -> Label:
    """Return the labelling function with its masks checked."""
    known = np.uint64(2 ** (n_symbols + 1) - 1)

    def masks(states: np.ndarray) -> np.ndarray:
        found = np.asarray(label(states))
        if found.shape != (len(states),) or found.dtype.kind != "u":
            raise ProblemError(
                f"`label` must return ({len(states)},) unsigned integers; got "
                f"{found.dtype} of shape {found.shape}"
            )
        wrong = found > known
        if wrong.any():
            i = int(np.flatnonzero(wrong)[0])
            raise ProblemError(
                f"`label` must return masks of bits 0 to {n_symbols}; got {int(found[i]):#b} "
                f"at state {states[i].tolist()}"
            )
        return found

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
