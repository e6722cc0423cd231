"""A policy sample after sample, where what follows depends on what is in force and since when."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from capsyn.integrations.single_lookup import single_lookup
from capsyn.policies.policy import Policy
from capsyn.simulation.closed_loop import Holds

Step = Callable[[Any, np.ndarray], tuple[int, np.ndarray]]
"""``(reading (n,), memory (2 + m,)) -> (symbol, memory)``; -1 is the default control.

The memory is 0 before the first decision, else 1 more than the label in force; the samples that it
has been held; and those that each input has been held. All of it is 0 at the start.
"""


def has_memory(policy: Policy) -> bool:
    """Return whether what follows depends on what is in force, or its `Switching` on since when."""
    return policy.remembers or has_holds(policy)


def has_holds(policy: Policy) -> bool:
    """Return whether the policy's `Switching` has least times."""
    rules = policy.rules
    return policy.switching is not None and bool(rules.holds.any() or rules.input_holds.any())


def stepper(policy: Policy, period: float) -> Step:
    """Return what decides sample after sample, a period [time unit] apart, as closed loops do.

    Of an infinite period least times are not kept.
    """
    look_up, holds, count = (
        single_lookup(policy),
        Holds.of(policy.rules, period),
        len(policy.alphabet),
    )

    def at_once(state: Any) -> bool:
        lost = policy.outside_at_once and not policy.covers(state)
        return lost or not np.isfinite(np.asarray(state, dtype=float)).all()

    def step(state: Any, memory: np.ndarray) -> tuple[int, np.ndarray]:
        first, then = memory[0] == 0, np.ones(2 + policy.alphabet.m)
        now = count if first else int(memory[0]) - 1
        taken = look_up(state, now) % (count + 1)  # the default is the last label
        if not first:
            if holds.kinds[taken] != holds.kinds[now] and not at_once(state):
                before, wanted, since = np.array([now]), np.array([taken]), memory[None, 1:]
                taken = int(holds.permitted(before, wanted, since[:, 0], since[:, 1:])[0])
            own, other = holds.controls[now], holds.controls[taken]
            kept = [holds.kinds[taken] == holds.kinds[now], *(own == other)]
            then[1:] += np.where(kept, memory[1:], 0)
        then[0] = 1 + taken
        return (-1 if taken == count else taken), then

    return step
