"""Checkpoints: what a labelling function answered, kept so that a run that was killed goes on.

Algorithm 1 asks for the same chunks of states whenever it runs, whatever the threads. A checkpoint
keeps the answer of each finished chunk under a hash of its states, so a run that starts again
replays the algorithm, takes from there what it finds, and ends with the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.errors import ProblemError, warn
from capsyn.execution.answers import Answer, Labelling, Packed, digest, kind, parts
from capsyn.execution.files import atomic_write, save_arrays, write_text
from capsyn.validation import describe, one_line, whole_number

if TYPE_CHECKING:
    from filelock import BaseFileLock

FORMAT = "capsyn-checkpoint"
VERSION = 2
INTERVAL = 1.0
"""Least time between two blocks [s]."""
SHARE = 0.01
"""Share of the running time so far that may pass between two blocks: a long run makes few."""
BLOCK_BYTES = 1 << 26
"""Size of answers that are written at once even so."""
MANIFEST, LOCK, BLOCK = "manifest.json", "lock", "block-{:06d}.safetensors"
HASH_BYTES = 16
_LOG = logging.getLogger(__name__)


class Checkpoint:
    """A directory of answers, open to this process alone; made where it is not there.

    The manifest is all that the answers depend on, as plain data, without the key ``settled``. A
    directory that cannot be used, or belongs to another manifest or to a running process, is a
    `ProblemError`.
    """

    def __init__(self, directory: str | os.PathLike[str], manifest: dict[str, Any]) -> None:
        self._directory = Path(directory)
        self._guard = threading.Lock()
        self._known: dict[bytes, tuple[Packed, int]] = {}
        self._new: list[tuple[bytes, Answer]] = []
        self._new_bytes = 0
        self._next = 0
        self._failed = False
        self._settled: dict[str, int] = {}
        self.taken = 0
        """States whose answers were found here so far."""
        self._started = self._written = time.monotonic()
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            self._refuse_others()
        except OSError as error:
            raise ProblemError(
                f"`checkpoint` must be a directory to write to; got '{directory}': {error.strerror}"
            ) from None
        self._lock = self._locked()
        try:
            self._open(manifest)
        except BaseException:
            self._lock.release()
            raise

    def _refuse_others(self) -> None:
        """Raise `ProblemError` where the directory holds something else; nothing is touched."""
        names = [path.name for path in self._directory.iterdir()]
        others = [name for name in names if name != LOCK and not name.startswith(".capsyn-")]
        if others and MANIFEST not in others:
            raise ProblemError(
                f"`checkpoint` must be an empty directory or a checkpoint; '{self._directory}' "
                f"holds '{min(others)}'"
            )

    def _locked(self) -> BaseFileLock:
        """Return the lock of the directory, held until it is released or the process ends."""
        from filelock import FileLock, Timeout  # heavy for runs without a checkpoint

        lock = FileLock(self._directory / LOCK, thread_local=False)
        try:
            lock.acquire(blocking=False)
        except Timeout:
            raise ProblemError(
                f"the checkpoint '{self._directory}' is in use by another process"
            ) from None
        except (OSError, NotImplementedError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ProblemError(
                f"the checkpoint '{self._directory}' cannot be locked: {reason}"
            ) from None
        return lock

    def _open(self, manifest: dict[str, Any]) -> None:
        self._manifest = {"format": FORMAT, "version": VERSION, **manifest}
        path = self._directory / MANIFEST
        settled = self._compare(path, self._manifest) if path.exists() else None
        if settled is None:
            self._write_manifest()
        for left in self._directory.glob(".capsyn-*"):  # of a process that was killed
            left.unlink()
        for block in sorted(self._directory.glob("block-*.safetensors")):
            number = block.stem.partition("-")[2]
            if number.isdecimal():
                self._next = max(self._next, int(number) + 1)
                self._read(block)
        self._resumed = bool(self._known)
        if self._known and settled is not None:  # else there is nothing that it should fit
            self._settled = settled

    def settle(self, name: str, value: int) -> int:
        """Return what a run began with: this value, unless what is kept here had another one.

        For what may change from run to run without changing the result, but decides which chunks
        are asked for.
        """
        with self._guard:
            if name not in self._settled:
                self._settled[name] = value
                self._write_manifest()
            return self._settled[name]

    def _write_manifest(self) -> None:
        text = json.dumps(
            {**self._manifest, "settled": self._settled},
            indent=1, sort_keys=True, allow_nan=False,
        )  # fmt: skip
        write_text(self._directory / MANIFEST, text + "\n")

    def _compare(self, path: Path, own: dict[str, Any]) -> dict[str, int]:
        """Return what is settled there; `ProblemError` unless the manifest there is our own."""
        try:
            there = json.loads(path.read_text(encoding="utf-8"))
            if not isinstance(there, dict) or there.get("format") != FORMAT:
                raise ValueError
            settled = there.pop("settled", {})
            if not isinstance(settled, dict):
                raise ValueError
            for name, value in settled.items():
                whole_number(name, value, least=1)
        except (OSError, ValueError, RecursionError, ProblemError):
            raise ProblemError(f"'{path}' is no manifest of a checkpoint, or damaged") from None
        own = json.loads(json.dumps(own))
        if own == there:
            return settled
        differences = [
            f"`{key}` is {describe(there.get(key), 40)} there, {describe(own.get(key), 40)} here"
            for key in dict.fromkeys([*own, *there])
            if own.get(key) != there.get(key)
        ]
        raise ProblemError(
            one_line(
                f"the checkpoint '{self._directory}' is of another run: {'; '.join(differences)}",
                400,
            )
        )

    def _read(self, path: Path) -> None:
        """Take the answers of a block, or remove it where it is damaged."""
        from safetensors import SafetensorError

        try:
            keys, packed = _read_block(path)
        except (
            SafetensorError,
            KeyError,
            TypeError,
            ValueError,
            AttributeError,
            RecursionError,
        ) as error:
            warn(
                f"a block of the checkpoint is damaged and removed, its states are solved again: "
                f"'{path}': {describe(str(error) or type(error).__name__)}"
            )
            path.unlink(missing_ok=True)
        except OSError as error:  # it may be whole all the same
            raise ProblemError(f"'{path}' cannot be read: {error.strerror or error}") from None
        else:
            self._known.update((key, (packed, i)) for i, key in enumerate(keys))

    def remember(self, label: Labelling) -> Remembered:
        """Return the labelling function that answers from here what is known, and keeps the rest.

        It is safe to call from threads.
        """
        return Remembered(self, label)

    def answer(self, label: Labelling, states: np.ndarray) -> Answer:
        """Return the answer of a labelling function for states, from here where it is known."""
        key = _key(states)
        with self._guard:
            packed, place = self._known.pop(key, (None, 0))  # a chunk is asked for once
            if packed is not None and packed.rows[place] == len(states):
                self.taken += len(states)
                return packed.answer(place)
        answer = label(states)
        self._keep(key, answer)
        return answer

    def _keep(self, key: bytes, answer: Answer) -> None:
        with self._guard:
            if not self._lock.is_locked:  # a thread that nobody waited for
                return
            if self._new and kind(self._new[0][1]) != kind(answer):
                self._flush()
            self._new.append((key, answer))
            self._new_bytes += sum(part.nbytes for part in parts(answer))
            now = time.monotonic()
            wait = max(INTERVAL, SHARE * (now - self._started))
            if now - self._written >= wait or self._new_bytes >= BLOCK_BYTES:
                self._flush()

    def _flush(self) -> None:
        """Write the new answers as one block; a disk that is full is no reason to stop."""
        if self._new and not self._failed:
            path = self._directory / BLOCK.format(self._next)
            new = self._new
            try:
                atomic_write(path, lambda temporary: _write_block(temporary, new))
            except (OSError, ProblemError) as error:
                self._failed = True
                warn(f"the checkpoint '{self._directory}' goes no further: {error}")
            self._next += 1
        self._new, self._new_bytes = [], 0
        self._written = time.monotonic()

    def close(self) -> None:
        """Write what is new, and let others in."""
        with self._guard:
            if self._lock.is_locked:
                self._flush()
                self._lock.release()
                if self._resumed:
                    _LOG.info("%s solves came from '%s'", f"{self.taken:,}", self._directory)

    def __enter__(self) -> Checkpoint:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


@dataclass(frozen=True)
class Remembered:
    """A labelling function whose answers a checkpoint keeps."""

    checkpoint: Checkpoint
    label: Labelling

    def __call__(self, states: np.ndarray) -> Answer:
        """Return the answer for states (B, n)."""
        return self.checkpoint.answer(self.label, states)


def _key(states: np.ndarray) -> bytes:
    hashed = hashlib.blake2b(repr(states.shape).encode(), digest_size=HASH_BYTES)
    hashed.update(np.ascontiguousarray(states, dtype=np.float64).data)
    return hashed.digest()


def _write_block(path: Path, new: list[tuple[bytes, Answer]]) -> None:
    packed = Packed.of([answer for _, answer in new])
    arrays = {f"answer{i}": column for i, column in enumerate(packed.columns)}
    arrays["keys"] = np.frombuffer(b"".join(key for key, _ in new), np.uint8).reshape(len(new), -1)
    arrays["rows"] = packed.rows
    about = json.dumps([packed.together, packed.dtypes])
    save_arrays(arrays, path, {"about": about, "sha256": digest(arrays, about)})


def _read_block(path: Path) -> tuple[list[bytes], Packed]:
    """Return the keys and answers of a block, every size checked; `ValueError` or worse."""
    from safetensors import safe_open

    with safe_open(path, framework="np") as file:
        metadata = file.metadata() or {}
        arrays = {name: file.get_tensor(name) for name in file.keys()}
    about = metadata["about"]
    if metadata["sha256"] != digest(arrays, about):
        raise ValueError("its content does not match its checksum")
    together, dtypes = json.loads(about)
    if not isinstance(dtypes, list):
        raise ValueError("its types are no list")
    keys, rows = arrays.pop("keys"), arrays.pop("rows")
    columns = tuple(arrays.pop(f"answer{i}") for i in range(len(arrays)))
    packed = Packed(rows, columns, tuple(dtypes), together)
    packed.check()
    if keys.dtype != np.uint8 or keys.shape != (len(rows), HASH_BYTES):
        raise ValueError("its keys are no hashes")
    return [key.tobytes() for key in keys], packed
