"""Numbers in texts: decimal points and decimal commas, and what stands for none."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

NONE = {"", "nan", "na", "n/a", "#n/a", "<na>", "null", "none"}
"""Texts that say that there is nothing, in lower case."""
MOST_CHARACTERS = 400
"""Most characters of a number."""
PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def is_none(text: str) -> bool:
    """Return whether a text says that there is nothing."""
    return text.strip().lower() in NONE


def number(text: str) -> float:
    """Return the number that a text is, with a decimal point or comma; NaN where it is none."""
    text = text.strip()
    if len(text) > MOST_CHARACTERS:
        return np.nan
    if text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    return float(text) if PLAIN.fullmatch(text) else np.nan


def is_number(text: str) -> bool:
    """Return whether a text is a finite number."""
    return bool(np.isfinite(number(text)))


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
