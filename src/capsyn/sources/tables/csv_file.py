"""Tables in text files with columns: CSV of all kinds, and that of dtControl.

A row is a state and its controls. Names of columns, ``name``, ``name [unit]`` or ``name (unit)``,
stand above them, or nowhere. A control is a number for each input; or of one input, where an
alphabet is given, a name or an index, and several that are allowed are separated by ``|``, or in
rows of their own. Where there is none, the field is empty, ``nan`` or ``NA``.

dtControl's files have ``#PERMISSIVE`` or ``#NON-PERMISSIVE`` above, then ``#BEGIN n m``, numbers of
states and inputs, and no names.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import LARGEST
from capsyn.sources.table import MOST_POINTS, Table, check_points
from capsyn.sources.tables.columns import Columns, columns_of
from capsyn.sources.tables.lines import Lines, lines_of
from capsyn.sources.tables.numbers import Column, numbers, one_mark
from capsyn.sources.tables.points import MISSING, Points
from capsyn.sources.tables.symbols import Coder, one_input, several_inputs
from capsyn.sources.text import (
    check_alphabet,
    check_room,
    decoded,
    fail,
    naming,
    path_text,
    read_bytes,
)
from capsyn.validation import describe, one_of

PERMISSIVE = re.compile(r"\s*#(NON-)?PERMISSIVE\b", re.IGNORECASE)
"""How dtControl's files begin."""
BEGIN = re.compile(r"^#BEGIN +(\d{1,9}) +(\d{1,9})\b", re.IGNORECASE | re.MULTILINE)
"""Numbers of states and inputs in dtControl's files."""
HEAD = 1 << 16
"""Characters in which these must be."""
MEMORY = 24
"""Bytes that reading takes for each of the file, at most."""


def read_csv(
    path: str | os.PathLike[str],
    alphabet: Alphabet | None = None,
    missing: str = "auto",
    inputs: Sequence[str] | None = None,
) -> Table:
    """Return the table in a CSV file; see `capsyn.sources.tables.csv_file` for what it may be.

    Parameters
    ----------
    path : path
        The file.
    alphabet : Alphabet, optional
        The symbols. Default: the numbers of the file, ascending, as controls. Names of one input
        become symbols in the order of the file, with the controls 0, 1, ..
    missing : "auto", "error" or "outside"
        What a grid point without a row becomes: an error, or a gap ("outside"). ``"auto"`` makes it
        a gap, but is an error if no row of the file has this value of an axis.
    inputs : strings, optional
        Names of the columns that are inputs. Default: the last column, and columns whose names
        differ from its name only by a number at the end; or the columns that begin with ``input``.

    Raises
    ------
    ProblemError
        The file is damaged; the message names the line and what was expected there. Or states are
        off the grid, an axis is not uniform, a point without a row must have one, or no point has a
        symbol.

    Notes
    -----
    The step of an axis is the median distance of its neighbouring values. A value must lie within a
    tenth of a step of a grid point. If so many values of an axis are missing that the median is not
    the grid's step, the file is refused, whatever `missing` is. Add rows with an empty symbol to
    describe such a grid.
    """
    path = path_text(path)
    check_alphabet(alphabet)
    one_of("missing", missing, MISSING)
    if inputs is not None and (
        isinstance(inputs, str)
        or not isinstance(inputs, Sequence)
        or not inputs
        or not all(isinstance(name, str) for name in inputs)
    ):
        raise ProblemError(f"`inputs` must be names of columns; got {describe(inputs)}")
    data = read_bytes(path)
    check_room(path, len(data), MEMORY)
    text = decoded(path, data)
    lines = lines_of(path, text)
    if PERMISSIVE.match(text):
        columns = _of_dtcontrol(path, text, lines)
    else:
        columns = columns_of(lines, inputs)
    with naming(path):
        check_points((1,) * len(columns.states))
    points, found = _read(lines, columns, alphabet)
    return points.table(found, missing)


def _of_dtcontrol(path: str, text: str, lines: Lines) -> Columns:
    """Return the columns that the head of dtControl's file tells."""
    begin = BEGIN.search(text, 0, HEAD)
    if begin is None:
        fail(path, 2, "#BEGIN, the number of states, and that of inputs", None)
    n, m = int(begin[1]), int(begin[2])
    width = len(lines.first() or [])
    if not n or not m or n + m != width:
        wanted = f"{n} states and {m} inputs, as #BEGIN says"
        fail(path, lines.numbers[0] if lines.numbers else 3, wanted, f"{width} fields", quote=False)
    names = {k: f"x_{k}" if k < n else f"u_{k - n}" for k in range(width)}
    places = list(range(width))
    return Columns(width, places[:n], places[n:], names, dict.fromkeys(places, ""), True)


def _read(lines: Lines, columns: Columns, alphabet: Alphabet | None) -> tuple[Points, Alphabet]:
    """Return states and symbols of the rows, and the alphabet."""
    path = lines.path
    if len(lines.rows) > MOST_POINTS * 64:
        raise ProblemError(f"'{path}' must have at most {MOST_POINTS * 64:,} rows")
    coders = [Coder() for _ in columns.inputs]
    axes = [Column() for _ in columns.states]
    states, numbered, codes, index = [], [], [], []
    for rows, at in lines.chunks(columns.width):
        fields = list(zip(*rows))
        if columns.end and any(fields[-1]):
            row = next(k for k, text in enumerate(fields[-1]) if text)
            fail(path, at[row], "nothing behind the last separator", fields[-1][row])
        states.append(_states(path, columns, axes, fields, at))
        codes.append(np.stack([code(fields[k], at) for code, k in zip(coders, columns.inputs)], 1))
        numbered.append(np.array(at))
        if columns.index is not None:
            index.append(numbers(fields[columns.index]))
    if not states:
        fail(path, (lines.numbers or [lines.line + 1])[0], "a row of a state and its symbol", None)
    if columns.index is not None:
        _check_index(path, np.concatenate(index), lines.line)
    every, where, coded = (np.concatenate(parts) for parts in (states, numbered, codes))
    names, units = _inputs(columns)
    found: Any
    if len(coders) == 1:
        found = one_input(path, coders[0], coded[:, 0], alphabet, names, units)
    else:
        found = several_inputs(path, coders, coded, alphabet, names, units)
    bits, alphabet = found
    own = [columns.names[k] for k in columns.states] if columns.named else None
    own_units = [columns.units[k] for k in columns.states]
    return Points(path, own, own_units, every, where, bits), alphabet


def _states(
    path: str, columns: Columns, axes: list[Column], fields: list[Any], at: list[int]
) -> np.ndarray:
    """Return the states (B, n) in columns of fields."""
    states = np.stack([axis(fields[k]) for axis, k in zip(axes, columns.states)], axis=1)
    wrong = np.argwhere(~(np.abs(states) <= LARGEST))
    if len(wrong):
        i, axis = wrong[0]
        place = columns.states[axis]
        text = fields[place][i]
        far, of = np.isfinite(states[i, axis]), f"for '{columns.names[place]}'"
        kind = f"a number within +-{LARGEST:g} {of}" if far else f"a finite number {of}"
        fail(path, at[i], kind if far else one_mark(text, kind), text)
    return states


def _check_index(path: str, index: np.ndarray, line: int) -> None:
    """Raise `ProblemError` unless a column without a name numbers rows."""
    whole = np.isfinite(index) & (index == np.rint(index))
    if not whole.all() or len(np.unique(index)) < len(index):
        fail(path, line, "a name for column 1, which does not number rows", "none", quote=False)


def _inputs(columns: Columns) -> tuple[list[str] | None, list[str] | None]:
    """Return names and units of the inputs; none where they only say that they are symbols."""
    names = [columns.names[k] for k in columns.inputs]
    units = [columns.units[k] for k in columns.inputs]
    if not columns.named or names == ["symbol"]:
        return None, units
    return names, units
