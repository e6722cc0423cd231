"""Random numbers for several purposes from one seed."""

from __future__ import annotations

import numpy as np


def stream(seed: int, *purpose: int) -> np.random.Generator:
    """Return a generator of its own for a purpose.

    Different purposes give independent numbers, and none gives those of
    ``numpy.random.default_rng(seed)`` for a whole number below
    2^128: states that a user draws are fresh.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=purpose))


def derived_seed(seed: int, *purpose: int) -> int:
    """Return a whole number of 63 bits to seed what takes a plain seed."""
    return int(stream(seed, *purpose).integers(2**63))
