"""Small whole numbers as text: how long each stays the same."""

from __future__ import annotations

import base64
import binascii

import numpy as np

from capsyn.errors import ProblemError

BITS = 3
"""Bits of a value."""
MOST_BYTES = 5
"""Most bytes of a run."""


def run_lengths(values: np.ndarray) -> str:
    """Return values (K,), each below 8, as text: base64 of the bytes of their runs.

    A run is the number ``length * 8 + value``, seven bits in a byte, the lowest first; each of its
    bytes but the last has its eighth bit set.
    """
    values = np.asarray(values, np.int64)
    starts = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    codes = (np.diff(starts, append=len(values)) << BITS) | values[starts]
    groups = (codes[:, None] >> 7 * np.arange(MOST_BYTES)) & 0x7F
    used = np.cumsum(groups[:, ::-1] > 0, axis=1)[:, ::-1] > 0
    used[:, 0] = True
    more = np.concatenate([used[:, 1:], np.zeros((len(used), 1), bool)], axis=1)
    return base64.b64encode((groups | more * 0x80)[used].astype(np.uint8).tobytes()).decode()


def runs_of(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the values (R,) and the lengths (R,) in a text of `run_lengths`.

    Raises
    ------
    ProblemError
        A text that is not of this kind.
    """
    try:
        data = np.frombuffer(base64.b64decode(text, validate=True), np.uint8).astype(np.int64)
    except (binascii.Error, ValueError):
        raise ProblemError("runs must be base64") from None
    ends = np.flatnonzero(data < 0x80)
    if len(ends) == 0 or ends[-1] != len(data) - 1:
        raise ProblemError("runs must end with a whole run")
    sizes = np.diff(ends, prepend=-1)
    if sizes.max() > MOST_BYTES:
        raise ProblemError(f"a run must have at most {MOST_BYTES} bytes")
    first = ends - sizes + 1
    place = np.arange(len(data)) - np.repeat(first, sizes)
    codes = np.add.reduceat((data & 0x7F) << 7 * place, first)
    lengths = codes >> BITS
    if not lengths.all():
        raise ProblemError("runs must be longer than 0")
    return codes & ((1 << BITS) - 1), lengths
