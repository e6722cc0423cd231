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


def single_lookup(policy: Policy) -> Callable[[Any], int]:
    """Return ``state (n,) -> symbol``, the same as calling the policy, -1 for the default control.

    It is compiled where there is a compiler, and then takes some microseconds. Not for threads. A
    state of another shape, or that is no numbers, is a `ProblemError`.
    """
    n, count = policy.domain.n, len(policy.alphabet)

    def checked(state: Any) -> np.ndarray:
        array = numbers("state", state)
        if array.shape != (n,):
            raise ProblemError(f"`state` must have shape ({n},); got {array.shape}")
        return array

    kernel = compiled(lambda: LookupKernel.build(n), "auto") if policy.cells.compiled else None
    if kernel is None:
        return lambda state: int(policy(checked(state)))
    buffer, label = np.empty(n), np.empty(1, dtype=np.int32)
    tree = TreeArguments.of(policy.domain, policy.cells)
    nearest = policy.outside == "nearest"
    places = (buffer.ctypes.data, ctypes.addressof(tree), nearest, label.ctypes.data)
    keep = (buffer, label, tree)

    def look_up(state: Any) -> int:
        keep[0][:] = checked(state)
        kernel.function(1, *places)
        found = int(label[0])
        return found if 0 <= found < count else int(policy(keep[0]))  # by its rules

    return look_up
