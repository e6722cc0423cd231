"""Writing files whole or not at all."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import errno
import os
import re
import secrets
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from capsyn.errors import ProblemError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors of a disk that is full or fails."""
_unfinished: set[Path] = set()


def atomic_write(path: str | os.PathLike[str], write: Callable[[Path], None]) -> None:
    """Call `write` with a temporary name beside `path`, then rename it to `path`.

    A failure at any moment leaves what was at `path`, and no temporary file. A symbolic link is
    followed. Where there cannot be a file, or is a directory or a device, and where the disk is
    full or fails, it is a `ProblemError`.
    """
    check_writable(path)
    target = Path(os.path.realpath(path))
    temporary = target.parent / f".capsyn-{secrets.token_hex(8)}{target.suffix}"
    old = target.exists()
    _unfinished.add(temporary)
    # a new file gets what the umask leaves of 0o666; asking for the umask is not safe in threads
    start = 0o600 if old else 0o666
    try:
        os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, start))
        mode = (target if old else temporary).stat().st_mode & 0o777
        write(temporary)
        temporary.chmod(mode | 0o200)  # writers may put another file in its place
        with open(temporary, "r+b") as written:  # Windows does not flush what is read only
            os.fsync(written.fileno())  # on the disk before it takes the name
        temporary.chmod(mode)
        os.replace(temporary, target)
    except OSError as error:
        if error.errno not in FULL:
            raise
        raise _unwritten(path, error) from error
    finally:
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()
        _unfinished.discard(temporary)


def remove_unfinished() -> None:
    """Remove what is being written under temporary names, for a process that is to end now."""
    for temporary in tuple(_unfinished):
        with contextlib.suppress(OSError):
            temporary.unlink()


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text as UTF-8, whole or not at all; see `atomic_write`."""

    def write(temporary: Path) -> None:
        temporary.write_bytes(text.encode())

    atomic_write(path, write)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise `ProblemError` unless a file can be written at `path`; nothing there is touched."""
    target = Path(os.path.realpath(path))
    try:
        if target.is_dir():
            raise IsADirectoryError(f"'{path}' is a directory")
        if target.exists() and not target.is_file():
            raise OSError("it is a device or a pipe, not a file")
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except OSError as error:
        raise _unwritten(path, error) from None


def _unwritten(path: str | os.PathLike[str], error: OSError) -> ProblemError:
    reason = os.strerror(error.errno) if error.errno in FULL else error.strerror or error
    return ProblemError(f"cannot write the output '{path}': {reason}")


def save_arrays(arrays: dict[str, Any], path: Path, metadata: dict[str, str]) -> None:
    """Write arrays as a file of safetensors; what keeps it from being written is an `OSError`."""
    from safetensors import SafetensorError
    from safetensors.numpy import save_file

    try:
        save_file(arrays, path, metadata)
    except SafetensorError as error:
        number = re.search(r"os error (\d+)", str(error))
        raise OSError(int(number[1]) if number else errno.EIO, str(error)) from error


def save_points(points: Sequence[Any], path: str | os.PathLike[str]) -> None:
    """Write dataclasses of one kind as CSV, one line each, after a line with their fields."""

    def write(temporary: Path) -> None:
        with open(temporary, "w", newline="", encoding="utf-8") as file:
            rows = csv.DictWriter(file, [field.name for field in dataclasses.fields(points[0])])
            rows.writeheader()
            rows.writerows(dataclasses.asdict(point) for point in points)

    atomic_write(path, write)
