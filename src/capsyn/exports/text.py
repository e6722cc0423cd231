"""Generated text: lines that are cut where they are too long, sums of products, words."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable

from capsyn.policies.policy import Policy

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


def with_unit(name: str, unit: str) -> str:
    """Return a name with its unit in brackets, if it has one."""
    return f"{name} [{unit}]" if unit else name


def kind(policy: Policy, axis: int) -> str:
    """Return what a decision is asked with on an axis: a state, or, after these, something else."""
    return "state" if axis < policy.domain.n else "exogenous input"


def spoken(policy: Policy, text: str) -> str:
    """Return a text about states: about readings, where exogenous inputs come after these."""
    if policy.exogenous is None:
        return text
    return re.sub(r"\b(?:s|(S))tate(s?)\b", lambda m: f"{'R' if m[1] else 'r'}eading{m[2]}", text)


def price(of_switch: float | dict[str, float] | tuple[tuple[float, ...], ...]) -> str:
    """Return a price in words: one, for each unit of change of inputs, or from least to most."""
    if isinstance(of_switch, dict):
        return ", ".join(f"{value!r} a unit of {name}" for name, value in of_switch.items())
    if isinstance(of_switch, tuple):
        others = [p for j, row in enumerate(of_switch) for i, p in enumerate(row) if i != j]
        return f"{min(others)!r} to {max(others)!r}"
    return repr(of_switch)
