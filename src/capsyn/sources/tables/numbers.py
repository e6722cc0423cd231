"""Numbers in texts: decimal points and decimal commas, and what stands for none."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence

import numpy as np

NONE = {"", "nan", "na", "n/a", "#n/a", "<na>", "null", "none"}
"""Texts that say that there is nothing, in lower case."""
MOST_CHARACTERS = 400
"""Most characters of a number."""
LOGIC = {"true": 1.0, "false": 0.0}
VECTOR = re.compile(r"[\[(]([^\[\]()]*)[\])]")
"""Numbers in brackets."""
PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def is_none(text: str) -> bool:
    """Return whether a text says that there is nothing."""
    return text.strip().lower() in NONE


def number(text: str) -> float:
    """Return the number that a text is, with a decimal point or comma; NaN where it is none.

    True is 1, and false is 0.
    """
    text = text.strip()
    if len(text) > MOST_CHARACTERS:
        return np.nan
    if text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    return float(text) if PLAIN.fullmatch(text) else LOGIC.get(text.lower(), np.nan)


def is_number(text: str) -> bool:
    """Return whether a text is a finite number."""
    return bool(np.isfinite(number(text)))


def vector(text: str) -> tuple[float, ...]:
    """Return the numbers that a text such as ``(1, 0)`` has in brackets; none where it has none."""
    match = VECTOR.fullmatch(text.strip())
    if match is None:
        return ()
    values = tuple(number(part) + 0.0 for part in re.split(r"[,;]|\s+", _tight(match[1])))
    return values if np.isfinite(values).all() else ()


def _tight(text: str) -> str:
    """Return a text without blanks around separators."""
    return re.sub(r"\s*([,;])\s*", r"\1", " ".join(text.split()))


class Column:
    """The numbers of a column, all with one decimal mark: the point, if the first have any."""

    def __init__(self) -> None:
        self.mark = ""

    def __call__(self, texts: Sequence[str]) -> np.ndarray:
        """Return the numbers (B,) that the next texts are; NaN where one is none."""
        joined = " ".join(texts)
        if not self.mark:
            marks = [mark for mark in ".," if mark in joined]
            if len(marks) > 1:  # those of numbers: names and vectors have some, too
                marks = [k for k in marks if any(k in text and is_number(text) for text in texts)]
            self.mark = marks[0] if marks else ""
        if self.mark != "," and joined.isascii() and "_" not in joined:  # float() takes 1_0
            with contextlib.suppress(ValueError):
                return np.array(texts, dtype=float)
        other = {".": ",", ",": "."}.get(self.mark)
        kept = ["" if other and other in text else text for text in texts]
        return np.array([number(text) for text in kept], dtype=float)


def numbers(texts: Sequence[str]) -> np.ndarray:
    """Return the numbers (B,) that the texts of a column are; see `Column`."""
    return Column()(texts)


def one_mark(text: str, what: str) -> str:
    """Return what is expected instead of a text that is no number of its column."""
    return f"{what}, with the decimal mark of the other rows" if is_number(text) else what
