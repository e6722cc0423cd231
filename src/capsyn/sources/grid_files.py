"""Tables in CSV files and NumPy archives.

A CSV file has a line of names, ``name`` or ``name [unit]`` for each state, then ``symbol``; and a
row for each point of a uniform grid, in any order. A symbol is the number of a control of one
input, or, where an alphabet is given, a name or an index; several that are allowed are separated
by ``|``, and where there is none, the field is empty. A file has names in all its rows, or in none:
where every symbol in it is a name of the alphabet they are names, or else all are indices.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
import zipfile
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import LARGEST
from capsyn.sources.table import MOST_POINTS, Table, check_points, check_symbols
from capsyn.sources.text import check_alphabet, fail, first_repeat, naming, path_text, read_bytes
from capsyn.validation import one_line, one_of

OFF_GRID = 0.1
"""Distance from the grid, in steps, from which on a state is not on it."""
HEADER = 1 << 14
"""Bytes at the beginning of an array that its header must fit."""
MOST_SMALL = 1 << 16
"""Most numbers of the arrays of an archive that are not its symbols."""


def read_csv(
    path: str | os.PathLike[str], alphabet: Alphabet | None = None, missing: str = "error"
) -> Table:
    """Return the table in a CSV file.

    Parameters
    ----------
    path : path
        The file.
    alphabet : Alphabet, optional
        The symbols. Default: the numbers that the file has, ascending, as controls of one input.
    missing : "error" or "outside"
        What a grid point without a row is.

    Raises
    ------
    ProblemError
        A damaged file (the line, and what was expected there), duplicate rows, states off the
        grid, points without a row, or no symbol at any.

    Notes
    -----
    The distance of the grid's points along an axis is the median of those of neighbouring values,
    and a value must be within `OFF_GRID` of that distance from a point. Where points are missing
    at so many values of an axis that the median is not the grid's, the file is refused, whatever
    `missing` is; rows with an empty symbol tell the grid then.
    """
    path = path_text(path)
    check_alphabet(alphabet)
    one_of("missing", missing, ["error", "outside"])
    names, units, rows, symbols, lines = _read(path)
    states = _states(path, names, rows, lines)
    first, step, places = _grid(path, names, states, lines)
    counts = tuple((places.max(axis=0) + 1).tolist())
    with naming(path):
        check_points(counts)
    flat = np.ravel_multi_index(tuple(places.T), counts)
    if repeat := first_repeat(flat):
        again, first_row = repeat
        wanted = f"a state that has no row yet (line {lines[first_row]} has it)"
        fail(path, lines[again], wanted, ",".join(rows[again]))
    total = int(np.prod(counts))
    if len(flat) < total and missing == "error":
        absent = np.ones(total, dtype=bool)
        absent[flat] = False
        where = np.array(np.unravel_index(np.flatnonzero(absent)[0], counts))
        state = ", ".join(f"{v:.6g}" for v in first + step * where)
        raise ProblemError(
            f"'{path}' must have a row for each point of its grid of "
            f"{' x '.join(map(str, counts))}; {total - len(flat)} are missing, the first at "
            f'({state}) (missing="outside", or --missing outside, takes them as outside)'
        )
    bits, alphabet = _masks(path, symbols, lines, alphabet)
    masks = np.zeros(total, dtype=np.uint64)
    masks[flat] = bits
    with naming(path):
        return Table(first, step, masks.reshape(counts), alphabet, names, units)


def _read(path: str) -> tuple[list[str], list[str], list[list[str]], list[str], list[int]]:
    """Return names, units, coordinates as text, symbols as text, and lines."""
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ProblemError(f"'{path}' is no CSV file: it is not text in UTF-8") from None
    rows: list[list[str]] = []
    symbols, lines = [], []
    reader = csv.reader(text.rstrip().splitlines(), strict=True)
    try:
        head = [name.strip() for name in next(reader, [])]
        if len(head) < 2 or head[-1] != "symbol":
            got = ",".join(head) if text else None
            fail(path, 1, "the names of the states, then symbol", got)
        with naming(path):
            check_points((1,) * (len(head) - 1))
        for row in reader:
            if len(rows) == MOST_POINTS:
                raise ProblemError(f"'{path}' must have at most {MOST_POINTS:,} rows")
            if len(row) != len(head):
                fail(path, reader.line_num, f"{len(head)} fields", ",".join(row))
            rows.append(row[:-1])
            symbols.append(row[-1].strip())
            lines.append(reader.line_num)
    except csv.Error as error:
        raise ProblemError(f"'{path}', line {reader.line_num}: {error}") from None
    if not rows:
        fail(path, 2, "a row of a state and its symbol", None)
    parts = [re.fullmatch(r"(.*?)\s*\[([^\]]*)\]", name) for name in head[:-1]]
    names = [part[1] if part else name for part, name in zip(parts, head)]
    return names, [part[2] if part else "" for part in parts], rows, symbols, lines


def _states(path: str, names: list[str], rows: list[list[str]], lines: list[int]) -> np.ndarray:
    try:
        states = np.array(rows, dtype=float)
    except ValueError:
        states = np.array([[_number(text) for text in row] for row in rows])
    wrong = np.argwhere(~(np.abs(states) <= LARGEST))
    if len(wrong):
        i, axis = wrong[0]
        kind = f"number within +-{LARGEST:g}" if np.isfinite(states[i, axis]) else "finite number"
        fail(path, lines[i], f"a {kind} for '{names[axis]}'", rows[i][axis])
    return states


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def _grid(
    path: str, names: list[str], states: np.ndarray, lines: list[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return first point (n,) and distances (n,) of the grid of states (B, n), and places there.

    The distance along an axis is the usual one between neighbouring values, so that a state that
    is off the grid is told from the others.
    """
    first, step = np.empty((2, states.shape[1]))
    places = np.empty(states.shape, dtype=np.int64)
    for axis, name in enumerate(names):
        values, back = np.unique(states[:, axis], return_inverse=True)
        apart = np.diff(values)
        apart = apart[apart > 1e-9 * (values[-1] - values[0])]
        if not len(apart):
            raise ProblemError(f"'{path}' must have two values of '{name}' at least; got one")
        usual = np.sort(apart)[(len(apart) - 1) // 2]
        k = np.concatenate([[0], np.cumsum(np.rint(np.diff(values) / usual))])
        step[axis] = np.median((values - values[0])[k > 0] / k[k > 0])
        first[axis] = np.median(values - step[axis] * k)
        off = np.abs(values - first[axis] - step[axis] * k) > OFF_GRID * step[axis]
        rows = np.flatnonzero(off[back.reshape(-1)])
        if len(rows):
            grid = f"{first[axis]:.6g} + {step[axis]:.6g} k"
            value = repr(float(states[rows[0], axis]))
            fail(path, lines[rows[0]], f"'{name}' on the grid {grid}", value)
        places[:, axis] = k[back.reshape(-1)].astype(np.int64)
    return first, step, places


def _masks(
    path: str, symbols: list[str], lines: list[int], alphabet: Alphabet | None
) -> tuple[np.ndarray, Alphabet]:
    """Return the masks (B,) of symbols as text, and the alphabet."""
    parts_of: dict[str, list[str]] = {}
    where: dict[str, int] = {}
    for text, line in zip(symbols, lines):
        if text not in parts_of:
            parts_of[text] = [part.strip() for part in text.split("|")] if text else []
            for part in parts_of[text]:
                where.setdefault(part, line)
    if not where:
        raise ProblemError(f"'{path}' must have a symbol in some row; all of its points are gaps")
    if alphabet is None:
        numbers = {part: _number(part) + 0.0 for part in where}
        for part, value in numbers.items():
            if not np.isfinite(value):
                fail(path, where[part], "controls that are finite numbers", part)
        values = sorted(set(numbers.values()))
        with naming(path):
            alphabet = Alphabet(values)
        known = {part: values.index(value) for part, value in numbers.items()}
    else:
        known = _names_or_indices(path, where, alphabet)
    masks = {text: sum(1 << k for k in {known[p] for p in some}) for text, some in parts_of.items()}
    return np.array([masks[text] for text in symbols], dtype=np.uint64), alphabet


def _names_or_indices(path: str, where: dict[str, int], alphabet: Alphabet) -> dict[str, int]:
    """Return the symbols that texts stand for, names or else indices; `where` has their lines."""
    names = {name: k for k, name in enumerate(alphabet.names)}
    indices = {str(k): k for k in range(len(alphabet))}
    named, rest = ([p for p in where if (p in names) == is_name] for is_name in (True, False))
    for part in rest:
        if part not in indices:
            wanted = f"symbols among {', '.join(alphabet.names)}, or their indices"
            fail(path, where[part], wanted, part)
    if named and rest:
        wanted = f"a symbol's name, like '{named[0]}' in line {where[named[0]]}, or indices alone"
        fail(path, where[rest[0]], wanted, rest[0])
    return indices if rest else names


def read_npz(path: str | os.PathLike[str], alphabet: Alphabet | None = None) -> Table:
    """Return the table in a NumPy archive, ``.npz``.

    It holds ``first`` and ``step`` (n,), ``symbols`` as `Table.of` takes them, and ``alphabet``
    (N, m) or (N,) unless one is given. Nothing in it is ever run, and no array is read before its
    type and shape are known to be those of a table.

    Parameters
    ----------
    path : path
        The file.
    alphabet : Alphabet, optional
        The symbols. Default: the file's.

    Raises
    ------
    ProblemError
        Another file, or arrays that make no table.
    """
    path = path_text(path)
    check_alphabet(alphabet)
    data = read_bytes(path)
    keys = ["first", "step", "symbols"] + ["alphabet"] * (alphabet is None)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, naming(path):
            for key in keys:
                if f"{key}.npy" not in archive.namelist():
                    raise ProblemError(
                        f"a table must have the arrays {', '.join(keys)}; there is no '{key}'"
                    )
            first, step = _small_array(archive, "first"), _small_array(archive, "step")
            if alphabet is None:
                alphabet = Alphabet(_small_array(archive, "alphabet"))
            check_symbols(*_header(archive, "symbols"), first, step, len(alphabet))
            symbols = _array(archive, "symbols")
    except ProblemError:
        raise
    except Exception as error:  # damage of a foreign format comes as almost any of them
        reason = one_line(str(error)) or type(error).__name__
        raise ProblemError(f"'{path}' is no NumPy archive of arrays: {reason}") from None
    with naming(path):
        return Table.of(first, step, symbols, alphabet)


def _header(archive: zipfile.ZipFile, key: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return shape and type of an array in an archive, whose size is checked against them."""
    info = archive.getinfo(f"{key}.npy")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"'{key}' is compressed in a way that NumPy does not write")
    with archive.open(info) as file:
        start = io.BytesIO(file.read(HEADER))
    version = np.lib.format.read_magic(start)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(start)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(start)
    else:
        raise ValueError(f"'{key}' has an unknown version of the array format, {version}")
    if dtype.kind not in "biuf":
        raise ValueError(f"'{key}' must be numbers; it has {one_line(str(dtype))}")
    size = info.file_size - start.tell()
    if min(shape, default=1) < 0 or size != math.prod(shape) * dtype.itemsize:
        raise ValueError(
            f"'{key}' has {info.file_size:,} bytes, which its shape {shape} does not take"
        )
    return shape, dtype


def _array(archive: zipfile.ZipFile, key: str) -> np.ndarray:
    """Return an array in an archive whose header has been checked."""
    with archive.open(f"{key}.npy") as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def _small_array(archive: zipfile.ZipFile, key: str) -> np.ndarray:
    shape, _ = _header(archive, key)
    if math.prod(shape) > MOST_SMALL:
        raise ValueError(f"'{key}' must have at most {MOST_SMALL:,} numbers; its shape is {shape}")
    return _array(archive, key)


def read_table(
    path: str | os.PathLike[str], alphabet: Alphabet | None = None, missing: str = "error"
) -> Table:
    """Return the table in a ``.scs``, ``.csv`` or ``.npz`` file, by its ending.

    Parameters
    ----------
    path : path
        The file.
    alphabet : Alphabet, optional
        The symbols, see the reader of each format.
    missing : "error" or "outside"
        Of a CSV file, see `read_csv`.

    Raises
    ------
    ProblemError
        Another ending, or what the reader refuses.
    """
    from capsyn.sources.scots import read_scots

    path = path_text(path)
    ending = os.path.splitext(path)[1].lower()
    if ending == ".csv":
        return read_csv(path, alphabet, missing)
    if missing != "error":
        raise ProblemError(f"`missing` (--missing) is for .csv files only; got '{path}'")
    if ending == ".scs":
        return read_scots(path, alphabet)
    if ending == ".npz":
        return read_npz(path, alphabet)
    raise ProblemError(f"a table must end in .scs, .csv or .npz; got '{path}'")
