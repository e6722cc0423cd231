"""Tables in NumPy archives, and in files of any format that is known by its content."""

from __future__ import annotations

import io
import math
import os
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.sources.scots import read_scots
from capsyn.sources.table import Table, check_symbols
from capsyn.sources.tables.csv_file import read_csv
from capsyn.sources.tables.prism import CHOICE, COUNTS, read_prism
from capsyn.sources.tables.storm import read_storm
from capsyn.sources.tables.stratego import Strategy, read_stratego
from capsyn.sources.text import check_alphabet, decoded, naming, path_text, read_bytes
from capsyn.validation import one_line, one_of

__all__ = ["read_csv", "read_npz", "read_table"]

FORMATS = ("csv", "npz", "scots", "stratego", "storm", "prism")
"""The formats of tables by name."""
HEAD = 1 << 16
"""Bytes at the beginning of a file that its format is told by."""
HEADER = 1 << 14
"""Bytes at the beginning of an array that its header must fit."""
MOST_SMALL = 1 << 16
"""Most numbers of the arrays of an archive that are not its symbols."""


def read_npz(path: str | os.PathLike[str], alphabet: Alphabet | None = None) -> Table:
    """Return the table in a NumPy archive, ``.npz``.

    The archive holds ``first`` and ``step`` (n,), ``symbols`` as `Table.of` takes them, and
    ``alphabet`` (N, m) or (N,) unless an alphabet is given. capsyn never runs anything in the
    archive. It reads no array before it knows that type and shape are those of a table.

    Parameters
    ----------
    path : path
        The file.
    alphabet : Alphabet, optional
        The symbols. Default: the alphabet of the file.

    Raises
    ------
    ProblemError
        The file is no archive, or its arrays make no table.
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
    path: str | os.PathLike[str],
    alphabet: Alphabet | None = None,
    missing: str = "auto",
    inputs: Sequence[str] | None = None,
    format: str | None = None,
    states: str | os.PathLike[str] | None = None,
    domain: Mapping[str, tuple[float, float]] | None = None,
) -> Table | Strategy:
    """Return the table, or the strategy, in a file of any known format.

    Parameters
    ----------
    path : path
        The file.
    alphabet : Alphabet, optional
        The symbols; see the reader of each format.
    missing, inputs
        Arguments of `read_csv`, for a CSV file.
    format : str, optional
        One of `FORMATS`. Default: the format that the file's content looks like.
    states
        Argument of `read_prism`.
    domain
        Argument of `read_stratego`.

    Raises
    ------
    ProblemError
        An argument is for another format, or the reader refuses the file.
    """
    path = path_text(path)
    check_alphabet(alphabet)
    if format is not None:
        one_of("format", format, FORMATS)
    kind = _format(path) if format is None else format
    options = {"missing": missing, "inputs": inputs, "states": states, "domain": domain}
    unset = {"missing": "auto", "inputs": None, "states": None, "domain": None}
    readers: dict[str, tuple[Callable[..., Table | Strategy], tuple[str, ...]]] = {
        "csv": (read_csv, ("missing", "inputs")),
        "npz": (read_npz, ()),
        "scots": (read_scots, ()),
        "stratego": (read_stratego, ("domain",)),
        "storm": (read_storm, ()),
        "prism": (read_prism, ("states",)),
    }
    read, taken = readers[kind]
    for name in unset:
        if name not in taken and options[name] != unset[name]:
            of = next(other for other, (_, takes) in readers.items() if name in takes)
            option = {"states": "exported-states"}.get(name, name)
            raise ProblemError(
                f"`{name}` (--{option}) is for files of format {of} only; '{path}' is {kind}"
            )
    return read(path, alphabet, **{name: options[name] for name in taken})


def _format(path: str) -> str:
    """Return the format that a file's content looks like."""
    head = read_bytes(path, HEAD)
    ending = os.path.splitext(path)[1].lower()
    if head.startswith(b"PK") or ending == ".npz":
        return "npz"
    try:
        text = decoded(path, head, whole=False).lstrip()
    except ProblemError:
        text = ""
    if text.startswith("#SCOTS") or ending == ".scs":
        return "scots"
    if "\nState: (" in text:
        raise ProblemError(
            f"'{path}' is a strategy of UPPAAL as text; learn it with Stratego, and save it as "
            "JSON with saveStrategy"
        )
    if text.startswith("{"):
        return "stratego"
    if text.startswith("["):
        return "storm"
    lines = [" ".join(line.split()) for line in text.splitlines()]
    first = next((line for line in lines if line and not line.startswith("#")), "")
    comma = "," in first and not first.startswith("(") and not re.match(r"\d+,\d+\s*[:=]", first)
    if ending != ".csv" and (
        COUNTS.fullmatch(first) and ending == ".tra" or CHOICE.fullmatch(first) and not comma
    ):
        return "prism"
    return "csv"
