"""Generated text: lines that are cut where they are too long, and sums of products."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

WIDTH = 99
"""Most characters of a line."""


def broken(line: str, width: int = WIDTH) -> list[str]:
    """Return a line, or several where it is too long, cut at blanks."""
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.wrap(
        line.strip(),
        width,
        initial_indent=indent,
        subsequent_indent=indent + "    ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def signed_sum(factors: Iterable[int], products: Iterable[str]) -> str:
    """Return products with the signs of their factors; those of factor 0 are left out."""
    text = ""
    for factor, product in zip(factors, products):
        if factor:
            blank, sign = (" ", "+") if text else ("", "")
            text += f"{blank}{'-' if factor < 0 else sign}{blank}{product}"
    return text
