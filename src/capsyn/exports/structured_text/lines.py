"""Lines of Structured Text: literals, comments and conditions."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable

import numpy as np

from capsyn.exports.text import WIDTH

UNITS = {"d": 86_400_000, "h": 3_600_000, "m": 60_000, "s": 1000, "ms": 1}
"""Units of a TIME literal [ms]."""


def real(value: float, kind: str = "LREAL") -> str:
    """Return a literal of LREAL or REAL: the digits that it needs, always with a point."""
    shortest = repr(float(value)) if kind == "LREAL" else str(np.float32(value))
    digits, _, power = shortest.partition("e")
    digits += "" if "." in digits else ".0"
    return f"{digits}E{int(power)}" if power else digits


def time(milliseconds: int) -> str:
    """Return a TIME literal, of the largest unit that it is a whole number of."""
    unit = next(name for name, size in UNITS.items() if milliseconds % size == 0)
    return f"T#{milliseconds // UNITS[unit]}{unit if milliseconds else 'ms'}"


def plain(text: str) -> str:
    """Return text for a comment: ASCII, of one line, without marks of comments."""
    text = re.sub(r"[\x00-\x1f\x7f]+", " ", text).replace("(*", "( *").replace("*)", "* )")
    return text.encode("ascii", "backslashreplace").decode()


def comment(lines: Iterable[str], indent: int = 0) -> Iterable[str]:
    """Return lines as comments, broken where they are too long."""
    for line in lines:
        for part in textwrap.wrap(plain(line), WIDTH - 6 - indent, subsequent_indent="  ") or [""]:
            yield f"{indent * ' '}(* {part} *)"


def condition(before: str, parts: Iterable[str], after: str, by: str = "AND") -> list[str]:
    """Return a condition of several parts, one a line, that are joined by AND or OR."""
    indent = " " * (len(before) - len(before.lstrip()) + 4)
    rows = [f"{indent}{f'{by} ' * (k > 0)}{part}" for k, part in enumerate(parts)]
    return [before, *rows, f"{indent[4:]}{after}"]


def indented(lines: Iterable[str], levels: int = 1) -> list[str]:
    """Return lines, some levels deeper."""
    return [" " * 4 * levels + line for line in lines]
