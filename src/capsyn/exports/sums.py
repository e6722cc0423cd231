"""Sums of products as text."""

from __future__ import annotations

from collections.abc import Iterable


def signed_sum(factors: Iterable[int], products: Iterable[str]) -> str:
    """Return products with the signs of their factors; those of factor 0 are left out."""
    text = ""
    for factor, product in zip(factors, products):
        if factor:
            blank, sign = (" ", "+") if text else ("", "")
            text += f"{blank}{'-' if factor < 0 else sign}{blank}{product}"
    return text
