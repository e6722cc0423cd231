"""Texts with one error each, which a strict compiler must refuse."""

from __future__ import annotations

import re
from collections.abc import Iterator

KINDS = ("BOOL", "INT", "DINT", "REAL", "LREAL", "TIME")
CONVERSION = re.compile(r"\b(?:INT|DINT|REAL|LREAL)_TO_\w+(?=\()")
DECLARED = re.compile(r"(\w+) : (?:ARRAY\[[0-9.]+\] OF )?(BOOL|INT|DINT|REAL|LREAL|TIME)\b")
DECIMAL = re.compile(r"(?<![\w.])\d+\.\d+(?:E-?\d+)?")
WHOLE = re.compile(r"(?<![\w.#])\d+(?![\w.])")
TIME = re.compile(r"T#\w+")
SIZE = re.compile(r"(?<=ARRAY\[0\.\.)\d+(?=\] OF \w+ := \[)")
EQUIVALENT = ("doublings", "INT")
"""Numbers up to 2,100 are INT as well as DINT."""


def without_comments(text: str) -> str:
    """Return a text with blanks for its comments."""
    return re.sub(r"\(\*.*?\*\)", lambda found: " " * len(found[0]), text, flags=re.DOTALL)


def mutants(source: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield what was changed, and the changed text.

    Each conversion is left out, each declared type becomes each other, each literal becomes one of
    another kind and one out of range, each table another size, each semicolon is left out.
    """
    text = without_comments(source.decode("ascii"))

    def changed(found: re.Match[str], group: int, new: str) -> tuple[str, bytes]:
        start, end = found.span(group)
        line = text.count("\n", 0, start) + 1
        made = text[:start] + new + text[end:]
        return f"line {line}: {found[group]} is {new or 'left out'}", made.encode()

    for found in CONVERSION.finditer(text):
        yield changed(found, 0, "")
    for found in DECLARED.finditer(text):
        for kind in KINDS:
            if kind != found[2] and (found[1], kind) != EQUIVALENT:
                yield changed(found, 2, kind)
    for found in DECIMAL.finditer(text):
        for new in ("1", "3.5E38"):
            yield changed(found, 0, new)
    for found in WHOLE.finditer(text):
        for new in ("1.0", "2147483648"):
            yield changed(found, 0, new)
    for found in TIME.finditer(text):
        for new in ("5", "0.5", "T#25d"):
            yield changed(found, 0, new)
    for found in SIZE.finditer(text):
        yield changed(found, 0, str(int(found[0]) + 1))
    for found in re.finditer(";", text):
        yield changed(found, 0, "")


def unmarked(source: bytes) -> Iterator[bytes]:
    """Yield texts of Siemens SCL without one mark of a variable, quotes or type of a literal."""
    text = without_comments(source.decode("ascii"))
    for found in re.finditer(r'(?<!LREAL)#(?=[a-z])|LREAL#|"\w+"(?=\()|VERSION : 0.1|BEGIN', text):
        kept = found[0].strip('"') if found[0].startswith('"') else ""
        yield (text[: found.start()] + kept + text[found.end() :]).encode()
