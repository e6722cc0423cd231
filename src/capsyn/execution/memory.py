"""Amounts of memory: what is available, what is asked for, and texts as ``"2GB"``."""

from __future__ import annotations

import re
from typing import Any

from capsyn.errors import ProblemError
from capsyn.validation import describe, whole_number

UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
UNITS |= {"KIB": 2**10, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40}


def available_memory() -> int:
    """Return the bytes of memory that are free for use."""
    import psutil  # heavy for a lookup, which needs none of it

    return int(psutil.virtual_memory().available)


def check_memory(needed: float, what: str) -> None:
    """Raise `ProblemError` where something asks for more bytes than there are."""
    available = available_memory()
    if needed > available:
        raise ProblemError(
            f"{what} is too large: {needed / 1e9:.3g} GB are needed, {available / 1e9:.3g} GB are "
            "available"
        )


def memory(name: str, value: Any) -> int:
    """Return an amount of memory [bytes] that is a whole number, or a text as ``"1.5 GB"``."""
    if not isinstance(value, str):
        return whole_number(name, value, least=1)
    match = re.fullmatch(r"\s*(\d{1,15}(?:\.\d{1,9})?)\s*([A-Za-z]*)\s*", value, re.ASCII)
    unit = UNITS.get(match[2].upper()) if match else None
    amount = int(float(match[1]) * unit) if match and unit else 0
    if amount < 1:
        raise ProblemError(
            f"`{name}` must be bytes, or a text as '800MB' or '2GiB'; got {describe(value)}"
        )
    return amount
