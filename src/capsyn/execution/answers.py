"""What labelling functions answer, packed for files and for the network."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.validation import describe

Answer = Any
"""For B states: an array (B, ...), or a tuple of some."""
Labelling = Callable[[np.ndarray], Answer]
"""States (B, n) to an answer."""
DTYPES = ("uint8", "uint16", "uint32", "uint64", "int32", "int64", "float32", "float64")


def parts(answer: Answer) -> tuple[np.ndarray, ...]:
    """Return the arrays of an answer."""
    return answer if isinstance(answer, tuple) else (answer,)


def kind(answer: Answer) -> tuple[Any, ...]:
    """Return what answers that are packed together have in common."""
    return isinstance(answer, tuple), [(part.dtype, part.shape[1:]) for part in parts(answer)]


def digest(arrays: Mapping[str, np.ndarray], about: str = "") -> str:
    """Return the SHA-256 of arrays, bit by bit, and of a text."""
    hashed = hashlib.sha256(about.encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        hashed.update(f"{name}:{array.dtype.str}:{array.shape}".encode())
        hashed.update(array.data)
    return hashed.hexdigest()


@dataclass(frozen=True)
class Packed:
    """Answers of one kind, one after the other."""

    rows: np.ndarray  # (C,): states of each answer
    columns: tuple[np.ndarray, ...]  # (sum of rows, ...) each, see `_narrow`
    dtypes: tuple[str, ...]  # the types that the columns had
    together: bool  # whether an answer is a tuple

    @staticmethod
    def of(answers: Sequence[Answer]) -> Packed:
        """Return answers of one `kind`, packed."""
        columns = [np.concatenate(column) for column in zip(*map(parts, answers))]
        return Packed(
            np.array([len(parts(answer)[0]) for answer in answers], dtype=np.int64),
            tuple(np.ascontiguousarray(_narrow(column)) for column in columns),
            tuple(column.dtype.name for column in columns),
            isinstance(answers[0], tuple),
        )

    def check(self) -> None:
        """Raise `ValueError` unless sizes and types fit each other; they may come from a file."""
        if self.rows.dtype != np.int64 or self.rows.ndim != 1 or (self.rows < 0).any():
            raise ValueError("its rows are no counts")
        total = sum(self.rows.tolist())
        if not self.columns or len(self.columns) != len(self.dtypes):
            raise ValueError("it does not hold the arrays that it names")
        if not isinstance(self.together, bool) or len(self.columns) > 1 > self.together:
            raise ValueError("it does not say which arrays belong together")
        for column, dtype in zip(self.columns, self.dtypes):
            if not isinstance(dtype, str) or dtype not in DTYPES:
                raise ValueError(f"it names the type {describe(dtype)}")
            had, has = np.dtype(dtype), column.dtype
            narrowed = had.kind == has.kind == "u" and has.itemsize <= had.itemsize
            if has != had and not narrowed:
                raise ValueError(f"it holds {has} for {dtype}")
            if column.ndim < 1 or len(column) != total:
                raise ValueError("its arrays are not as long as its rows say")

    @functools.cached_property
    def _ends(self) -> np.ndarray:
        return np.concatenate([[0], np.cumsum(self.rows)])

    def answer(self, i: int) -> Answer:
        """Return one of the answers; it shares the packed memory where the type is the same."""
        start, stop = self._ends[i : i + 2]
        values = tuple(
            column[start:stop].astype(dtype, copy=False)
            for column, dtype in zip(self.columns, self.dtypes)
        )
        return values if self.together else values[0]

    def answers(self) -> list[Answer]:
        """Return the answers."""
        return [self.answer(i) for i in range(len(self.rows))]


def _narrow(array: np.ndarray) -> np.ndarray:
    """Return unsigned integers in the smallest type that holds them; other arrays as they are."""
    if array.dtype.kind != "u" or not array.size:
        return array
    return array.astype(np.min_scalar_type(int(array.max())), copy=False)
