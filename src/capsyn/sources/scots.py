"""Static controllers of SCOTS, the text format ``.scs`` of its versions 0.1 and 0.2.

A file has a header with the grids of states and inputs. Each grid has its dimension, distances
``eta``, and lower left and upper right points. A matrix follows, with a row for each state of the
winning domain: the state's index, then the indices of its valid inputs. Indices run with the first
axis fastest.
Lines that are blank, or begin with ``#`` and no word of the format, are comments.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.sources.table import MOST_AXES, MOST_SYMBOLS, Table, check_points
from capsyn.sources.text import (
    MARKS,
    check_alphabet,
    decoded,
    fail,
    first_repeat,
    naming,
    path_text,
    read_bytes,
)

MOST_INPUTS = 1 << 53
"""Most points of an input grid; an index of more does not fit a float exactly."""
_GRIDS = ("#SCOTS:V0", "#SCOTS:STATE_SPACE", "#SCOTS:INPUT_SPACE")
WORDS = (*_GRIDS, "#TYPE:", "#MEMBER:", "#VECTOR:", "#MATRIX:", "#BEGIN:", "#END")
"""What lines of the format begin with, without blanks and in capitals; others are comments."""
COMMENT = re.compile(rb"#(?:[# \t\r]|(?=\n)|\Z|SCOTS:)[^\n]*")
"""A comment among the rows."""
ROUNDED = 0.1
"""How far corners may be from whole steps, in steps: writers round to 6 digits."""
MOST_DIGITS = 15
"""Digits of an index; more of them do not fit a float exactly."""


@dataclass(frozen=True)
class _Grid:
    """A uniform grid: first point and distances (n,), and points along each axis."""

    first: np.ndarray
    step: np.ndarray
    counts: tuple[int, ...]

    @property
    def size(self) -> int:
        return math.prod(self.counts)

    def points(self, indices: np.ndarray) -> np.ndarray:
        """Return the points (K, n) with indices (K,), the first axis fastest."""
        places = np.stack(np.unravel_index(indices, self.counts, order="F"), axis=1)
        return self.first + self.step * places


class _Lines:
    """The lines of a file's header, one after the other."""

    def __init__(self, path: str, text: bytes) -> None:
        self.path, self.text = path, text
        self.number, self.place = 0, 0

    def next(self, wanted: str) -> str:
        """Return the next line that is not blank and no comment."""
        while True:
            self.number += 1
            if self.place >= len(self.text):
                fail(self.path, self.number, wanted, None)
            end = self.text.find(b"\n", self.place)
            end = len(self.text) if end < 0 else end
            line = self.text[self.place : end].decode("ascii", "replace").strip()
            self.place = min(end + 1, len(self.text))
            if line and (not line.startswith("#") or _word(line).startswith(WORDS)):
                return line

    def expect(self, *wanted: str) -> str:
        """Return the next line, which must be one of some but for blanks and capitals."""
        line = self.next(wanted[0])
        if _word(line) not in map(_word, wanted):
            fail(self.path, self.number, wanted[0], line)
        return line

    def whole(self, what: str, text: str | None = None) -> int:
        """Return the next line, or a text of this line, as a whole number above 0."""
        line = self.next(what) if text is None else text
        if not line.isdecimal() or not 0 < len(line) <= MOST_DIGITS or not int(line):
            fail(self.path, self.number, what, line)
        return int(line)

    def vector(self, name: str, size: int) -> np.ndarray:
        self.expect(f"#VECTOR:{name}")
        self.expect(f"#BEGIN:{size}")
        values = []
        for _ in range(size):
            line = self.next("a number")
            try:
                values.append(float(line))
            except ValueError:
                fail(self.path, self.number, "a number", line)
            if not np.isfinite(values[-1]):
                fail(self.path, self.number, "a finite number", line)
        self.expect("#END")
        return np.array(values)

    def grid(self, name: str) -> _Grid:
        self.expect(f"#SCOTS:{name}")
        self.expect("#TYPE:UNIFORMGRID")
        self.expect("#MEMBER:DIM")
        size = self.whole(f"a dimension, 1 to {MOST_AXES}")
        if size > MOST_AXES:
            fail(self.path, self.number, f"a dimension, 1 to {MOST_AXES}", str(size))
        step = self.vector("ETA", size)
        first, last = self.vector("LOWER_LEFT", size), self.vector("UPPER_RIGHT", size)
        if not (step > 0).all() or not (first <= last).all():
            raise ProblemError(
                f"'{self.path}': the grid above line {self.number + 1} must have distances above 0 "
                "and a lower left point that is not above the upper right one"
            )
        with np.errstate(all="ignore"):
            counts = np.rint((last - first) / step) + 1
            off = np.abs(first + (counts - 1) * step - last) / step
            near = off <= ROUNDED
        if not near.all() or counts.max() > 2**31:
            raise ProblemError(
                f"'{self.path}': the grid above line {self.number + 1} must have corners that are "
                f"whole steps apart; got {first.tolist()} and {last.tolist()}, {step.tolist()} each"
            )
        exact = (last - first) / np.maximum(counts - 1, 1)
        step = np.where(off > 1e-6, exact, step)
        return _Grid(first, step, tuple(int(k) for k in counts))


def _word(line: str) -> str:
    """Return a line of the header without blanks, in capitals."""
    return "".join(line.split()).upper()


def read_scots(path: str | os.PathLike[str], alphabet: Alphabet | None = None) -> Table:
    """Return the table of a static controller of SCOTS.

    Parameters
    ----------
    path : path
        The file.
    alphabet : Alphabet, optional
        Control vectors in place of the grid's, in the order of the symbols. Default: all points of
        the input grid, or only the points in use if there are more than 63.

    Raises
    ------
    ProblemError
        The file has another format or is damaged. The message names the line and what was expected
        there.
    """
    path = path_text(path)
    check_alphabet(alphabet)
    text = _plain(path)
    lines = _Lines(path, text)
    lines.expect("#SCOTS:v0.2", "#SCOTS:v0.1")
    lines.expect("#TYPE:STATICCONTROLLER")
    states, inputs = lines.grid("STATE_SPACE"), lines.grid("INPUT_SPACE")
    with naming(path):
        check_points(states.counts)
    if inputs.size > MOST_INPUTS:
        counts = " x ".join(f"{k:,}" for k in inputs.counts)
        raise ProblemError(
            f"'{path}' must have an input grid of at most {MOST_INPUTS:,} points; got {counts}"
        )
    lines.expect("#TYPE:WINNINGDOMAIN")
    lines.expect("#MATRIX:DATA")
    head = lines.next(f"#BEGIN:{states.size} and columns")
    if not re.fullmatch(rf"#BEGIN:\s*{states.size}(\s+\d*)?", head, re.IGNORECASE):
        fail(path, lines.number, f"#BEGIN:{states.size}, the points of the state grid", head)
    row, column = _pairs(path, text, lines.place, lines.number + 1, states.size, inputs.size)
    used = np.unique(column)
    kept = np.arange(inputs.size) if inputs.size <= MOST_SYMBOLS else used
    if len(kept) > MOST_SYMBOLS:
        raise ProblemError(
            f"'{path}' uses {len(kept)} inputs; a table has at most {MOST_SYMBOLS} symbols"
        )
    if alphabet is None:
        with naming(path):
            alphabet = Alphabet(inputs.points(kept))
    elif len(alphabet) != len(kept):
        raise ProblemError(
            f"`alphabet` must have {len(kept)} symbols like the input grid; got {len(alphabet)}"
        )
    masks = np.zeros(states.size, dtype=np.uint64)
    bit = np.uint64(1) << np.searchsorted(kept, column).astype(np.uint64)
    np.bitwise_or.at(masks, row, bit)
    grid = masks.reshape(states.counts, order="F")
    with naming(path):
        return Table(states.first, states.step, grid, alphabet)


def _plain(path: str) -> bytes:
    """Return the bytes of a file in ASCII, without a byte order mark."""
    text = read_bytes(path)
    if any(text.startswith(mark) for mark in MARKS):
        return decoded(path, text).encode("ascii", "replace")
    return text


def _pairs(
    path: str, text: bytes, place: int, line: int, states: int, inputs: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs (P,), (P,) of state and input in the rows from a place on, at a line."""
    end = text.find(b"#", place)
    if end >= 0 and COMMENT.match(text, end):
        blank = COMMENT.sub(lambda comment: b" " * len(comment[0]), text[place:])
        text = text[:place] + blank
        end = text.find(b"#", place)
    body = np.frombuffer(text, dtype=np.uint8, offset=place)
    body = body if end < 0 else body[: end - place]
    breaks = np.flatnonzero(body == 10)

    def fail_at(at: int, wanted: str) -> None:
        number = line + int(np.searchsorted(breaks, at))
        start = place + (0 if number == line else int(breaks[number - line - 1]) + 1)
        stop = text.find(b"\n", start)
        row = text[start : len(text) if stop < 0 else stop].decode("ascii", "replace").strip()
        fail(path, number, wanted, row)

    wanted = "a row of whole numbers: a state and its inputs"
    digit = (body >= 48) & (body <= 57)
    strange = np.flatnonzero(~digit & (body != 32) & (body != 10) & (body != 13) & (body != 9))
    if len(strange):
        fail_at(int(strange[0]), wanted)
    edge = np.diff(digit.astype(np.int8), prepend=0, append=0)
    starts, stops = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
    long = np.flatnonzero(stops - starts > MOST_DIGITS)
    if len(long):
        fail_at(int(starts[long[0]]), wanted)
    tail = text[end:].split(b"\n")[0].strip() if end >= 0 else None
    if tail != b"#END":
        got = None if tail is None else tail.decode("ascii", "replace")
        number = line + len(breaks) + (end < 0 and len(body) > 0 and body[-1] != 10)
        fail(path, number, "#END, or a row of a state and its inputs", got)
    values = _numbers(body, starts, stops)
    row = np.searchsorted(breaks, starts)
    new = np.diff(row, prepend=-1) != 0
    state = values[np.flatnonzero(new)]
    owner = np.cumsum(new) - 1
    if not len(values):
        raise ProblemError(f"'{path}' must have rows of states and inputs; it has none")
    alone = np.flatnonzero(np.bincount(owner) == 1)
    heads = starts[new]
    if len(alone):
        fail_at(int(heads[alone[0]]), "a state and its inputs")
    beyond = np.flatnonzero(state >= states)
    if len(beyond):
        fail_at(int(heads[beyond[0]]), f"a state of the grid, 0 to {states - 1}")
    beyond = np.flatnonzero(~new & (values >= inputs))
    if len(beyond):
        fail_at(int(starts[beyond[0]]), f"inputs of the grid, 0 to {inputs - 1}")
    if repeat := first_repeat(state):
        again, first = repeat
        before = line + int(np.searchsorted(breaks, heads[first]))
        fail_at(int(heads[again]), f"a state that has no row yet (line {before} has it)")
    return state[owner][~new], values[~new]


def _numbers(body: np.ndarray, starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Return the whole numbers (K,) that stand at some places in a text."""
    values = np.zeros(len(starts), dtype=np.int64)
    longest = int((stops - starts).max(initial=0))
    for k in range(longest):
        at = starts + k
        within = at < stops
        values[within] = values[within] * 10 + (body[at[within]] - 48)
    return values
