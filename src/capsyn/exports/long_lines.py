"""Lines of generated text that are cut where they are too long."""

from __future__ import annotations

import textwrap

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
