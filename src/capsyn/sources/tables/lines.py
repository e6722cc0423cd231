"""The lines of a text with columns: separator, comments, names of columns, fields.

Columns are separated by tabs, semicolons, commas or blanks, whichever cuts the first lines into
equally many fields. Blank lines and comments (``#``, ``%``, ``//``) are left out. Where the first
line is one of numbers, a comment before it may have the names of the columns.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from capsyn.errors import ProblemError
from capsyn.sources.tables.numbers import is_number
from capsyn.sources.text import fail

SEPARATORS = ("\t", ";", ",", " ")
"""What columns may be separated by, in the order in which they are tried."""
COMMENTS = ("#", "%", "//")
"""What a comment begins with."""
SAMPLE = 20
"""Lines that the separator is chosen by."""
CHUNK = 1 << 16
"""Rows that are read at a time."""
NAME = re.compile(r"[^\W\d][^\s:;]{0,99}(?:\s{0,9}\[[^\]]{0,40}\]|\s{1,9}\([^)]{0,40}\))?")
"""A name, with a unit in brackets, in a comment that has the names of the columns."""
WORD = re.compile(r'"[^"]*"|[^\s"]+(?:\s+[\[(][^\])]{0,40}[\])])?')
"""A name between blanks, with a unit in brackets."""


@dataclass(frozen=True)
class Lines:
    """The lines of a text with columns.

    Parameters
    ----------
    path : str
        The file, for errors.
    names : list of str, optional
        The names of the columns, as they are written; None where the file has none.
    line : int
        Where they are.
    separator : str
        Between fields.
    rows : list of str
        The lines with fields.
    numbers : list of int
        Their numbers in the file.
    """

    path: str
    names: list[str] | None
    line: int
    separator: str
    rows: list[str]
    numbers: list[int]

    def chunks(self, width: int) -> Iterator[tuple[list[list[str]], list[int]]]:
        """Yield rows of `width` fields, and their lines in the file, some at a time."""
        rows: list[list[str]] = []
        lines: list[int] = []
        reader = _reader(self.rows, self.separator)
        try:
            for row in reader:
                line = self.numbers[reader.line_num - 1]
                if len(row) != width:
                    fail(self.path, line, f"{width} fields", self.separator.join(row))
                rows.append(row)
                lines.append(line)
                if len(rows) == CHUNK:
                    yield rows, lines
                    rows, lines = [], []
        except csv.Error as error:
            line = self.numbers[max(reader.line_num, 1) - 1]
            raise ProblemError(f"'{self.path}', line {line}: {error}") from None
        if rows:
            yield rows, lines

    def first(self) -> list[str] | None:
        """Return the fields of the first row, if there is one."""
        return _fields(self.rows[0], self.separator) if self.rows else None


def lines_of(path: str, text: str) -> Lines:
    """Return the lines of a text; `ProblemError` where there are no columns.

    `path` is for errors.
    """
    every = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    start = 1 if re.fullmatch(r"sep=.", every[0].strip().lower()) else 0  # of spreadsheets
    numbers = [k for k in range(start, len(every)) if every[k] and not every[k].isspace()]
    comments = [k for k in numbers if every[k].lstrip().startswith(COMMENTS)]
    if comments:
        left_out = set(comments)
        numbers = [k for k in numbers if k not in left_out]
    rows = [every[k] for k in numbers]
    if not rows:
        fail(path, 1, "the names of the states, then symbol", None)
    separator = _separator(rows[: SAMPLE + 1])
    if separator == " ":
        rows = [" ".join(row.split()) for row in rows]
    first = _names(rows[0], separator)
    if len(first) < 2:
        fail(path, numbers[0] + 1, "the names of the states, then symbol", rows[0])
    lines = [k + 1 for k in numbers]
    if not all(is_number(field) for field in first[:-1]):
        return Lines(path, first, lines[0], separator, rows[1:], lines[1:])
    above = [k for k in comments if k < numbers[0]]
    names = _names(every[above[-1]].lstrip().lstrip("#%/"), separator) if above else []
    if len(names) != len(first) or not _are_names(names):
        return Lines(path, None, lines[0], separator, rows, lines)
    return Lines(path, names, above[-1] + 1, separator, rows, lines)


def _reader(rows: list[str], separator: str) -> Any:
    return csv.reader(rows, delimiter=separator, strict=True, skipinitialspace=True)


def _fields(row: str, separator: str) -> list[str]:
    """Return the fields of a row, which may be damaged."""
    try:
        return next(csv.reader([row], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return []


def _names(row: str, separator: str) -> list[str]:
    """Return the fields of a row of names; between blanks, units belong to the names."""
    if separator == " ":
        return [word.strip('"') for word in WORD.findall(row)]
    return [field.strip() for field in _fields(row, separator)]


def _are_names(parts: list[str]) -> bool:
    """Return whether the parts of a comment look like names; that of a number of rows is empty."""
    return any(parts) and all(not part or NAME.fullmatch(part) for part in parts)


def _separator(rows: list[str]) -> str:
    """Return what separates the fields of most of the first rows into equally many."""
    found = []
    for separator in SEPARATORS:
        joined = [" ".join(row.split()) if separator == " " else row for row in rows]
        head = len(_names(joined[0], separator))
        if head < 2:
            continue
        widths = [len(_fields(row, separator)) for row in joined[1:]] or [head]
        same = sum(width in (head, head + 1) for width in widths)  # one more: numbers of rows
        if 2 * same > len(widths):
            return separator
        found.append(separator)
    return next((separator for separator in (",", ";", "\t", " ") if separator in found), ",")
