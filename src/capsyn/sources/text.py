"""What readers of text files share: bytes within bounds, and errors that name the line."""

from __future__ import annotations

import os
from typing import NoReturn

from capsyn.errors import ProblemError
from capsyn.validation import describe

MOST_BYTES = 1 << 30
"""Largest file that is read."""


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return what is in a file of at most `MOST_BYTES`; `ProblemError` where there is none."""
    try:
        if os.path.exists(path) and not os.path.isfile(path):
            raise ProblemError(f"'{path}' is no file")
        if os.path.getsize(path) > MOST_BYTES:
            raise ProblemError(f"'{path}' must have at most {MOST_BYTES:,} bytes")
        with open(path, "rb") as file:
            return file.read()
    except OSError as error:
        raise ProblemError(f"cannot read '{path}': {error.strerror or error}") from None


def fail(path: str, line: int, wanted: str, got: str | None) -> NoReturn:
    """Raise the error of a line that is not what was expected; None where the file ends."""
    found = "the file ends" if got is None else f"got {describe(got)}"
    raise ProblemError(f"'{path}', line {line}: expected {wanted}; {found}")
