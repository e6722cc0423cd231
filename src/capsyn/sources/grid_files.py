"""Tables in CSV files and NumPy archives.

A CSV file has a line of names, ``name`` or ``name [unit]`` for each state, then ``symbol``; and a
row for each point of a uniform grid, in any order. A symbol is the number of a control of one
input, or, where an alphabet is given, a name or an index; several that are allowed are separated
by ``|``, and where there is none, the field is empty.
"""

from __future__ import annotations

import csv
import os
import re
import zipfile
from typing import Any

import numpy as np

from capsyn.alphabet import Alphabet
from capsyn.errors import ProblemError
from capsyn.sources.table import Table, check_points
from capsyn.sources.text import fail, read_bytes
from capsyn.validation import one_line, one_of

OFF_GRID = 0.1
"""Distance from the grid, in steps, from which on a state is not on it."""


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
        grid, or points without a row.
    """
    path = os.fspath(path)
    one_of("missing", missing, ["error", "outside"])
    names, units, rows, symbols, lines = _read(path)
    states = _states(path, names, rows, lines)
    first, step, places = _grid(path, names, states, lines)
    counts = tuple((places.max(axis=0) + 1).tolist())
    check_points(counts)
    flat = np.ravel_multi_index(tuple(places.T), counts)
    order = np.argsort(flat, kind="stable")
    twice = order[1:][np.diff(flat[order]) == 0]
    if len(twice):
        again = int(twice.min())
        before = lines[int(np.flatnonzero(flat == flat[again])[0])]
        state = ",".join(rows[again])
        fail(path, lines[again], f"a state that has no row yet (line {before} has it)", state)
    total = int(np.prod(counts))
    if len(flat) < total and missing == "error":
        absent = np.ones(total, dtype=bool)
        absent[flat] = False
        where = np.array(np.unravel_index(np.flatnonzero(absent)[0], counts))
        state = ", ".join(f"{v:.6g}" for v in first + step * where)
        raise ProblemError(
            f"'{path}' must have a row for each point of its grid of "
            f"{' x '.join(map(str, counts))}; {total - len(flat)} are missing, the first at "
            f'({state}) (missing="outside" takes them as outside)'
        )
    bits, alphabet = _masks(path, symbols, lines, alphabet)
    masks = np.zeros(total, dtype=np.uint64)
    masks[flat] = bits
    return Table(first, step, masks.reshape(counts), alphabet, names, units)


def _read(path: str) -> tuple[list[str], list[str], list[list[str]], list[str], list[int]]:
    """Return names, units, coordinates as text, symbols as text, and lines."""
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ProblemError(f"'{path}' is no CSV file: it is not text in UTF-8") from None
    wanted = "the names of the states, then symbol"
    rows, symbols, lines = [], [], []
    reader = csv.reader(text.splitlines(), strict=True)
    try:
        head = [name.strip() for name in next(reader, [])]
        if len(head) < 2 or head[-1] != "symbol":
            fail(path, 1, wanted, ",".join(head) if text else None)
        for row in reader:
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
    wrong = np.argwhere(~np.isfinite(states))
    if len(wrong):
        i, axis = wrong[0]
        fail(path, lines[i], f"a finite number for '{names[axis]}'", rows[i][axis])
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
        if k[-1] >= 2**31:
            raise ProblemError(f"'{path}' has values of '{name}' that are too far apart")
        places[:, axis] = k[back.reshape(-1)].astype(np.int64)
    return first, step, places


def _masks(
    path: str, symbols: list[str], lines: list[int], alphabet: Alphabet | None
) -> tuple[np.ndarray, Alphabet]:
    """Return the masks (B,) of symbols as text, and the alphabet."""
    texts, first, back = np.unique(np.array(symbols), return_index=True, return_inverse=True)
    parts = [[p.strip() for p in text.split("|")] if text else [] for text in texts.tolist()]
    if alphabet is None:
        numbers = [[_number(part) for part in some] for some in parts]
        for some, at in zip(numbers, first):
            if not np.isfinite(some).all():
                fail(path, lines[at], "controls that are finite numbers", symbols[at])
        values = sorted({value + 0.0 for some in numbers for value in some})
        alphabet = Alphabet(values)
        found = [[values.index(value) for value in given] for given in numbers]
    else:
        known = {str(k): k for k in range(len(alphabet))}
        known |= {name: k for k, name in enumerate(alphabet.names)}
        for told, at in zip(parts, first):
            if not set(told) <= set(known):
                wanted = f"symbols among {', '.join(alphabet.names)}, or their indices"
                fail(path, lines[at], wanted, symbols[at])
        found = [[known[part] for part in told] for told in parts]
    bits = np.array([sum(1 << k for k in set(some)) for some in found], dtype=np.uint64)
    return bits[back.reshape(-1)], alphabet


def read_npz(path: str | os.PathLike[str], alphabet: Alphabet | None = None) -> Table:
    """Return the table in a NumPy archive, ``.npz``.

    It holds ``first`` and ``step`` (n,), ``symbols`` as `Table.of` takes them, and ``alphabet``
    (N, m) or (N,) unless one is given. Nothing in it is ever run.

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
    read_bytes(path)  # within bounds, and with the errors of all readers
    keys = ["first", "step", "symbols"] + ["alphabet"] * (alphabet is None)
    arrays: dict[str, Any] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for key in keys:
                if f"{key}.npy" not in archive.namelist():
                    raise ProblemError(
                        f"'{path}' must hold the arrays {', '.join(keys)}; it has no '{key}'"
                    )
                with archive.open(f"{key}.npy") as file:
                    arrays[key] = np.lib.format.read_array(file, allow_pickle=False)
    except ProblemError:
        raise
    except (zipfile.BadZipFile, ValueError, OSError, EOFError, MemoryError) as error:
        raise ProblemError(
            f"'{path}' is no NumPy archive of arrays: {one_line(str(error))}"
        ) from None
    chosen = alphabet if alphabet is not None else Alphabet(arrays["alphabet"])
    return Table.of(arrays["first"], arrays["step"], arrays["symbols"], chosen)


def read_table(
    path: str | os.PathLike[str], alphabet: Alphabet | None = None, missing: str = "error"
) -> Table:
    """Return the table in a .scs, .csv or .npz file, by its ending; see the readers of each."""
    from capsyn.sources.scots import read_scots

    ending = os.path.splitext(path)[1].lower()
    if ending == ".csv":
        return read_csv(path, alphabet, missing)
    if missing != "error":
        raise ProblemError(f"`missing` is for .csv files only; got '{path}'")
    if ending == ".scs":
        return read_scots(path, alphabet)
    if ending == ".npz":
        return read_npz(path, alphabet)
    raise ProblemError(f"a table must end in .scs, .csv or .npz; got '{path}'")
