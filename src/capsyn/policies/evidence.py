"""Evidence in a policy's file: which kinds there are, and what each has at least."""

from __future__ import annotations

import math
from typing import Any, TypeGuard

from capsyn.cells.run_lengths import runs_of
from capsyn.errors import ProblemError
from capsyn.modelling.time_unit import NAMES

EVIDENCE = {
    "monte_carlo": (("trials", "successes"), ("low", "high", "confidence")),
    "lyapunov": ((), ("proved", "negative", "violated", "undecided")),
    "agreement": (("states", "agreeing"), ("share", "low", "high", "confidence")),
    "optimum": (("starts", "lost"), ("optimality", "confidence")),
    "certificate": ((), ("arrival", "staying", "avoiding", "open")),
}
"""Kinds of evidence, and the counts and shares that each has at least."""

MOST_MAP_TEXT, MOST_MAP_CELLS = 100_000, 2**20
"""Most characters and cells of the map in a certificate."""


def is_evidence(kind: str, data: Any) -> bool:
    """Return whether plain data has the figures of a kind of evidence, and they make sense."""
    if kind not in EVIDENCE or not isinstance(data, dict) or not _is_clean(data):
        return False
    counts, shares = ([data.get(name) for name in names] for names in EVIDENCE[kind])
    numbers = [count for count in counts if type(count) is int]
    return (
        len(numbers) == len(counts)
        and numbers == sorted(numbers, reverse=True)  # no more successes than trials
        and min(numbers, default=0) >= 0
        and all(isinstance(share, (int, float)) and 0 <= share <= 1 for share in shares)
        and data.get("low", 0) <= data.get("high", 1)
        and isinstance(data.get("conditions", {}), dict)
        and (kind != "certificate" or _is_certificate(data))
    )


def _is_certificate(data: dict[str, Any]) -> bool:
    """Return whether the other figures of a certificate are what sentences and pages take."""
    names, units, refuted = (data.get(name) for name in ("states", "units", "refuted"))
    if not _is_texts(names) or not _is_texts(units) or len(names) != len(units):
        return False
    n, ripple = len(names), data.get("ripple")
    return (
        all(data.get(name) is None or _is_time(data[name]) for name in ("within", "switch_rate"))
        and (data["arrival"] == 0 or data.get("within") is not None)
        and (ripple is None or (_is_list(ripple, n) and all(_is_numbers(r, 2) for r in ripple)))
        and isinstance(refuted, list)
        and all(_is_refuted(start, n) for start in refuted)
        and data.get("conditions", {}).get("time_unit", "s") in NAMES
        and type(data.get("stopped")) is bool
        and ("map" not in data or _is_map(data["map"], n))
    )


def _is_map(data: Any, n: int) -> bool:
    """Return whether plain data is a map of cells of `n` states, and not too large."""
    if not isinstance(data, dict) or not _is_list(data.get("counts"), n):
        return False
    counts, text = data["counts"], data.get("runs")
    if not all(type(count) is int and 0 < count <= MOST_MAP_CELLS for count in counts):
        return False
    cells = math.prod(counts)
    if cells > MOST_MAP_CELLS or not isinstance(text, str) or len(text) > MOST_MAP_TEXT:
        return False
    try:
        values, lengths = runs_of(text)
    except ProblemError:
        return False
    return int(lengths.sum()) == cells


def _is_refuted(data: Any, n: int) -> bool:
    return (
        isinstance(data, dict)
        and _is_numbers(data.get("state"), n)
        and isinstance(data.get("failure"), str)
        and isinstance(data.get("replay", ""), str)
    )


def _is_list(data: Any, count: int) -> bool:
    return isinstance(data, list) and len(data) == count


def _is_texts(data: Any) -> TypeGuard[list[str]]:
    return isinstance(data, list) and all(isinstance(text, str) for text in data)


def _is_numbers(data: Any, count: int) -> bool:
    return _is_list(data, count) and all(type(value) in (int, float) for value in data)


def _is_time(data: Any) -> bool:
    return type(data) in (int, float) and data >= 0


def _is_clean(value: Any) -> bool:
    """Return whether plain data holds printable text and finite numbers only."""
    if isinstance(value, dict):
        return all(map(_is_clean, [*value, *value.values()]))
    if isinstance(value, list):
        return all(map(_is_clean, value))
    if isinstance(value, str):
        return value.isprintable()
    return value is None or (isinstance(value, (int, float)) and abs(value) < 1e300)
