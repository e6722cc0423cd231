"""What a search among alphabets has found, kept in a file from which it goes on."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sqlite3
from collections.abc import Iterator, Mapping
from typing import Any

from capsyn.errors import ProblemError
from capsyn.validation import describe, one_line

ASKED = "asked"
"""Key of what was asked of a search."""
WAIT = 60.0
"""Seconds that a process waits while another writes."""


class Storage:
    """Scores by key, in memory or in an SQLite file; of equal keys the first stays.

    A score is a list: loops that are lost, the mean of the others or None, and whole numbers.

    Parameters
    ----------
    path : path, optional
        The file. None: in memory.
    asked : mapping of text to text
        What a search that goes on must have in common with the one that made the file, in words.

    Raises
    ------
    ProblemError
        A file that cannot be used, or that holds what was found for another search.
    """

    def __init__(self, path: str | os.PathLike[str] | None, asked: Mapping[str, str]) -> None:
        self.path, self._known = path, dict[str, Any]()
        if path is None:
            return
        with self._connected() as connection:
            connection.execute(
                "CREATE TABLE IF NOT EXISTS found (key TEXT PRIMARY KEY, value TEXT NOT NULL)"
            )
            if not connection.execute("SELECT key FROM found LIMIT 1").fetchall():
                first = (ASKED, json.dumps(dict(asked)))  # of two processes, one of them is first
                connection.execute("INSERT OR IGNORE INTO found VALUES (?, ?)", first)
            rows = connection.execute("SELECT key, value FROM found").fetchall()
        try:
            self._known = {str(key): json.loads(value) for key, value in rows}
        except (TypeError, ValueError, RecursionError) as error:
            raise ProblemError(f"`storage` '{path}' holds what is no JSON: {error}") from None
        known = self._known.pop(ASKED, None)
        if not isinstance(known, dict) or not all(map(_is_score, self._known.values())):
            raise ProblemError(f"`storage` '{path}' was not made by a search among alphabets")
        for what, value in asked.items():
            if known.get(what) != value:
                raise ProblemError(
                    f"the search in '{path}' has another {what}: {describe(known.get(what))}; got "
                    f"{describe(value)}; give another storage, or the same {what}"
                )

    def __contains__(self, key: str) -> bool:
        return key in self._known

    def __getitem__(self, key: str) -> Any:
        return self._known[key]

    def add(self, found: Mapping[str, Any]) -> None:
        """Keep what was found, all of it or nothing."""
        new = {key: value for key, value in found.items() if key not in self._known}
        if self.path is not None and new:
            with self._connected() as connection:
                connection.executemany(
                    "INSERT OR IGNORE INTO found VALUES (?, ?)",
                    [(key, json.dumps(value)) for key, value in new.items()],
                )
        self._known |= new

    @contextlib.contextmanager
    def _connected(self) -> Iterator[sqlite3.Connection]:
        try:
            with contextlib.closing(sqlite3.connect(str(self.path), timeout=WAIT)) as connection:
                with connection:
                    yield connection
        except sqlite3.Error as error:
            raise ProblemError(
                f"`storage` cannot be used: {describe(str(self.path))}: {one_line(str(error))}"
            ) from error


def _is_score(value: Any) -> bool:
    """Return whether plain data are a score."""
    if not isinstance(value, list) or len(value) != 3 or not isinstance(value[2], list):
        return False
    lost, mean, used = value
    known = mean is None or (type(mean) in (int, float) and math.isfinite(mean))
    return known and all(type(count) is int and 0 <= count < 1 << 53 for count in [lost, *used])
