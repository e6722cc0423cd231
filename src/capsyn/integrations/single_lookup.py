"""Lookups of one state after another, for loops that cannot wait for many."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.native.compiled import compiled
from capsyn.policies.lookup import LookupKernel, TreeArguments
from capsyn.policies.policy import Policy
from capsyn.validation import numbers


def single_lookup(policy: Policy) -> Callable[..., int]:
    """Return ``(state (n,), current=-1) -> symbol``, the same as calling the policy.

    -1 is the default control; `current` is the symbol in force.

    It is compiled where there is a compiler, and then takes some microseconds. Not for threads. A
    state of another shape, or that is no numbers, is a `ProblemError`.
    """
    n, count = policy.space.n, len(policy.alphabet)

    def checked(state: Any) -> np.ndarray:
        array = numbers("state", state)
        if array.shape != (n,):
            raise ProblemError(f"`state` must have shape ({n},); got {array.shape}")
        return array

    kernel = compiled(lambda: LookupKernel.build(n), "auto") if policy.cells.compiled else None
    if kernel is None:
        return lambda state, current=-1: int(policy(checked(state), current=current))
    buffer, (in_force, label) = np.empty(n), np.empty((2, 1), dtype=np.int32)
    tree = TreeArguments.of(policy.space, policy.cells)
    nearest = policy.outside == "nearest"
    arrays = (in_force.ctypes.data, label.ctypes.data)
    places = (buffer.ctypes.data, ctypes.addressof(tree), nearest, *arrays)
    keep = (buffer, in_force, label, tree)
    table = policy.transitions

    def look_up(state: Any, current: int = -1) -> int:
        keep[0][:] = checked(state)
        if not -1 <= current <= count:
            return int(policy(keep[0], current=current))  # which says what is wrong
        now = count if current < 0 else current
        keep[1][0] = now
        kernel.function(1, *places)
        row = int(label[0])
        found = int(table[row, now]) if row >= 0 else row
        return found if 0 <= found < count else int(policy(keep[0], current=current))

    return look_up
