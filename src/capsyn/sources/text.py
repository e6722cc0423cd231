"""What readers of files share: bytes within bounds, text, and errors that name file and line."""

from __future__ import annotations

import codecs
import contextlib
import os
import re
from collections.abc import Iterator
from typing import Any, NoReturn

import numpy as np

from capsyn.errors import ProblemError
from capsyn.execution.memory import check_memory
from capsyn.modelling.alphabet import Alphabet
from capsyn.validation import describe

MOST_BYTES = 1 << 30
"""Largest file that is read."""
SMALL = 1 << 20
"""Bytes of a file that may be read whatever the memory."""
MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF32_LE: "utf-32-le",  # before UTF-16, whose mark it begins with
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
"""Byte order marks, and the encodings that they tell."""


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


def read_bytes(path: str, most: int = -1) -> bytes:
    """Return what is in a file of at most `MOST_BYTES`; `ProblemError` where there is none.

    With `most`, only as many bytes of its beginning are read.
    """
    try:
        if os.path.exists(path) and not os.path.isfile(path):
            raise ProblemError(f"'{path}' is no file")
        if os.path.getsize(path) > MOST_BYTES:
            raise ProblemError(f"'{path}' must have at most {MOST_BYTES:,} bytes")
        with open(path, "rb") as file:
            return file.read(most)
    except ProblemError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = getattr(error, "strerror", None) or error
        raise ProblemError(f"cannot read '{path}': {reason}") from None


def check_room(path: str, size: int, factor: int) -> None:
    """Raise `ProblemError` where `factor` bytes of memory for each of `size` are too much.

    For a small file nobody asks how much there is.
    """
    if size > SMALL:
        check_memory(factor * size, f"the table in '{path}'")


def decoded(path: str, data: bytes, whole: bool = True) -> str:
    """Return the text of a file's bytes; `ProblemError` where they are none.

    A byte order mark says the encoding. Without one it is UTF-16 where every other byte at the
    beginning is 0, else UTF-8, and where that fails Windows-1252 or Latin-1. Of a file's beginning,
    which is not the `whole`, the last character may be cut.
    """
    mark = next((mark for mark in MARKS if data.startswith(mark)), b"")
    body, head = data[len(mark) :], data[:64]
    zeros = [2 * head[k::2].count(0) > len(head) // 2 for k in (0, 1)]
    if mark:
        encodings = [MARKS[mark]]
    elif zeros[0] != zeros[1]:
        encodings = ["utf-16-be" if zeros[0] else "utf-16-le"]
    else:
        encodings = ["utf-8", "cp1252", "latin-1"]
    text = None
    for encoding in encodings:
        with contextlib.suppress(UnicodeDecodeError):
            text = codecs.getincrementaldecoder(encoding)().decode(body, final=whole)
            break
    if text is None or re.search(r"[\x00-\x08\x0e-\x1f\x7f]", text):
        raise ProblemError(f"'{path}' is no text in {' or '.join(encodings[:2])}")
    return text


def fail(path: str, line: Any, wanted: str, got: str | None, quote: bool = True) -> NoReturn:
    """Raise the error of a line that is not what was expected; None where the file ends.

    What it has instead is shortened and quoted, or taken as it is.
    """
    instead = "the file ends" if got is None else f"got {describe(got) if quote else got}"
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
