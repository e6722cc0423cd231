"""Numbers in texts: decimal points and decimal commas, and what stands for none."""

from __future__ import annotations

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


def numbers(texts: Sequence[str]) -> np.ndarray:
    """Return the numbers (B,) that texts are; NaN where one is none.

    A comma is no decimal mark beside texts that have points.
    """
    try:
        return np.array(texts, dtype=float)
    except ValueError:
        points = any("." in text for text in texts)
        kept = ["" if points and "," in text else text for text in texts]
        return np.array([number(text) for text in kept], dtype=float)
