"""What readers of files share: bytes within bounds, and errors that name the file and line."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any, NoReturn

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.validation import describe

MOST_BYTES = 1 << 30
"""Largest file that is read."""


def path_text(path: Any) -> str:
    """Return a path as text; `ProblemError` where it is none."""
    try:
        return os.fsdecode(path)
    except TypeError:
        raise ProblemError(f"`path` must be the path of a file; got {describe(path)}") from None


def check_alphabet(alphabet: Any) -> None:
    """Raise `ProblemError` unless an alphabet is one, or None."""
    if alphabet is not None and not isinstance(alphabet, Alphabet):
        raise ProblemError(f"`alphabet` must be a capsyn.Alphabet; got {describe(alphabet)}")


def read_bytes(path: str) -> bytes:
    """Return what is in a file of at most `MOST_BYTES`; `ProblemError` where there is none."""
    try:
        if os.path.exists(path) and not os.path.isfile(path):
            raise ProblemError(f"'{path}' is no file")
        if os.path.getsize(path) > MOST_BYTES:
            raise ProblemError(f"'{path}' must have at most {MOST_BYTES:,} bytes")
        with open(path, "rb") as file:
            return file.read()
    except ProblemError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = getattr(error, "strerror", None) or error
        raise ProblemError(f"cannot read '{path}': {reason}") from None


def fail(path: str, line: int, wanted: str, got: str | None) -> NoReturn:
    """Raise the error of a line that is not what was expected; None where the file ends."""
    instead = "the file ends" if got is None else f"got {describe(got)}"
    raise ProblemError(f"'{path}', line {line}: expected {wanted}; {instead}")


def first_repeat(values: np.ndarray) -> tuple[int, int] | None:
    """Return the first place of (K,) values whose value stands before, and where; None for none."""
    order = np.argsort(values, kind="stable")
    again = order[1:][np.diff(values[order]) == 0]
    if not len(again):
        return None
    place = int(again.min())
    return place, int(np.flatnonzero(values == values[place])[0])


@contextlib.contextmanager
def naming(path: str) -> Iterator[None]:
    """Name a file in the `ProblemError` of what is made of its contents."""
    try:
        yield
    except ProblemError as error:
        raise ProblemError(f"'{path}': {error}") from None
