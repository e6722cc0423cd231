"""Evidence in a policy's file: which kinds there are, and what each has at least."""

from __future__ import annotations

from typing import Any

EVIDENCE = {
    "monte_carlo": (("trials", "successes"), ("low", "high", "confidence")),
    "lyapunov": ((), ("proved", "negative", "violated", "undecided")),
    "agreement": (("states", "agreeing"), ("share", "low", "high", "confidence")),
    "optimum": (("starts", "lost"), ("optimality", "confidence")),
}
"""Kinds of evidence, and the counts and shares that each has at least."""


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
    )


def _is_clean(value: Any) -> bool:
    """Return whether plain data holds printable text and finite numbers only."""
    if isinstance(value, dict):
        return all(map(_is_clean, [*value, *value.values()]))
    if isinstance(value, list):
        return all(map(_is_clean, value))
    if isinstance(value, str):
        return value.isprintable()
    return value is None or (isinstance(value, (int, float)) and abs(value) < 1e300)
