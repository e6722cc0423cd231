"""What a subdivision may take: solves, seconds, memory."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from capsyn.errors import ProblemError
from capsyn.validation import describe, finite_number, whole_number

UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
UNITS |= {"KIB": 2**10, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40}


@dataclass(frozen=True)
class Limits:
    """What a subdivision may take; see `subdivide`.

    Parameters
    ----------
    max_solves : int, optional
        Budget of solves.
    max_seconds : float, optional
        Budget of time [s].
    max_memory, memory_limit : int, optional
        Budget of memory, and what a run may need at worst [bytes].
    room : int, optional
        What a block of cells took before [bytes], where a run goes on: blocks stay as they were
        unless there is no longer memory for them.
    """

    max_solves: int | None = None
    max_seconds: float | None = None
    max_memory: int | None = None
    memory_limit: int | None = None
    room: int | None = None

    @staticmethod
    def of(max_solves: Any, max_seconds: Any, max_memory: Any, memory_limit: Any) -> Limits:
        """Return validated limits; None where there is none."""
        return Limits(
            None if max_solves is None else whole_number("max_solves", max_solves, least=1),
            None if max_seconds is None else finite_number("max_seconds", max_seconds, above=0.0),
            None if max_memory is None else memory("max_memory", max_memory),
            None if memory_limit is None else memory("memory_limit", memory_limit),
        )


def memory(name: str, value: Any) -> int:
    """Return an amount of memory [bytes] that is a whole number, or a text as ``"1.5 GB"``."""
    if not isinstance(value, str):
        return whole_number(name, value, least=1)
    found = re.fullmatch(r"\s*(\d{1,15}(?:\.\d{1,9})?)\s*([A-Za-z]*)\s*", value, re.ASCII)
    unit = UNITS.get(found[2].upper()) if found else None
    amount = int(float(found[1]) * unit) if found and unit else 0
    if amount < 1:
        raise ProblemError(
            f"`{name}` must be bytes, or a text as '800MB' or '2GiB'; got {describe(value)}"
        )
    return amount
