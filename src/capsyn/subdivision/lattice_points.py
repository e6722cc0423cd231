"""The lattice points that a subdivision solves, each once."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.masks import empty, or_else, several, word_count, word_type
from capsyn.errors import SynthesisError
from capsyn.modelling.domain import Box

CHUNK = 8192
"""Most states that are labelled in one call."""
WORD = 2**63 - 1
"""Most values of a word of a key."""
MERGED = 2**18
"""Solved points that are moved at a time to make room for new ones."""
NOT_FINITE_LIMIT = 0.01
"""Share of solves without a finite result that stops a synthesis."""
MANY = 1000
"""Solves that are waited for before their share is judged."""


@dataclass(frozen=True)
class Progress:
    """How far a subdivision is.

    Parameters
    ----------
    level, max_level : int
        The level being labelled, and the last one.
    cells : int
        Cells of this level.
    solved, solves : int
        Points that are solved, and all of them, of this level's test points, or of those of a
        block of its cells; later, of those of the quarter rule. Of a budget that is spent on cells
        of any level, all solves since the start, and the budget.
    total : int
        Points solved since the start.
    """

    level: int
    max_level: int
    cells: int
    solved: int
    solves: int
    total: int


class LatticePoints:
    """Solved lattice points: sorted integer keys, and sets of symbols for each.

    A set has bit `i` where symbol `i` could be best, bit N for the default; it is kept in the
    smallest unsigned type that holds N + 1 bits, or in words of 64. A point has a set for each of J
    symbols in force, of labels (B, J, W), or one, of labels (B, W). Where `scored`, the labelling
    function gives scores (B, V, S) in V variants beside its sets, and they are kept, too. With a
    `goal`, progress is reported as all solves so far of so many. A point without a finite answer
    has the default, or, of the symbols in force that `stays` (J,) names, these.

    A key numbers the points of the lattice in C order. Where 63 bits are too few, the axes are cut
    into runs whose points they do number; the key is then the bytes of these numbers, the first
    one first and each with its highest byte first, so that keys compare as tuples of numbers do.
    """

    def __init__(
        self,
        label: Callable[[np.ndarray], Any],
        domain: Box,
        lattice: tuple[int, ...],
        n_symbols: int,
        pool: ThreadPoolExecutor | None,
        progress: Callable[[Progress], None] | None,
        scored: bool = False,
        goal: int | None = None,
        in_force: int = 1,
        stays: np.ndarray | None = None,
    ) -> None:
        self._label, self._domain, self._lattice = label, domain, lattice
        self._pool, self._progress, self._goal = pool, progress, goal
        self.dtype = word_type(n_symbols + 1)
        self.shape = in_force, word_count(n_symbols + 1)
        self._default, self._stays = n_symbols, stays
        extents = [
            count if periodic else count + 1 for count, periodic in zip(lattice, domain.periodic)
        ]
        self._strides, self._word = key_strides(extents)
        self._size = math.prod(extents)
        words = self._strides.shape[1]
        wide = f"S{8 * words}"
        self._type = np.dtype(np.int64 if words == 1 else wide)
        largest: Any = 2**63 - 1 if words == 1 else b"\xff" * 8 * words
        self._keys = np.array([largest], dtype=self._type)  # so that a search ends within
        self._masks = np.zeros((1, *self.shape), dtype=self.dtype)
        self._scored, self._scores = scored, np.zeros((1, 0, 0))
        self._pending: tuple[np.ndarray, ...] | None = None
        self.count = 0
        self.indifferent = 0
        self.not_finite = 0
        self.example: list[float] | None = None
        self._first: tuple[Any, ...] | None = None  # question and key of the example
        self.seconds = 0.0

    @property
    def point_bytes(self) -> int:
        """Bytes of a solved point that is kept."""
        return self._type.itemsize + self.set_bytes

    @property
    def set_bytes(self) -> int:
        """Bytes of the sets of a point."""
        return math.prod(self.shape) * self.dtype.itemsize

    def encode(
        self, offsets: np.ndarray, corners: np.ndarray, scales: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the keys (U, M) of lattice points ``offsets (U, n) + corners (M, n)``.

        Or of ``offsets (U, n) * scales (M, n) + corners``, or ``offsets (U, M, n) + corners``.
        Periodic axes wrap.
        """
        if scales is not None:
            words = [offsets @ (scales * column).T + corners @ column for column in self._strides.T]
        else:
            if offsets.ndim == 2:
                offsets = offsets[:, None, :]
            words = [offsets @ column + corners @ column for column in self._strides.T]
        for i in np.flatnonzero(self._domain.periodic):
            along = offsets[..., i] if scales is None else np.outer(offsets[:, i], scales[:, i])
            seam = along + corners[:, i] == self._lattice[i]
            word = self._word[i]
            words[word][seam] -= self._lattice[i] * self._strides[i, word]
        if len(words) == 1:
            return words[0]
        return np.stack(words, axis=-1).astype(">i8").view(self._type)[..., 0]

    def places(self, keys: np.ndarray) -> np.ndarray:
        """Return the lattice points (K, n) of keys (K,)."""
        if self._strides.shape[1] == 1:
            words = [keys]
        else:
            parts = np.ascontiguousarray(keys).view(">i8")
            parts = parts.reshape(len(keys), self._strides.shape[1])
            words = list(parts.T.astype(np.int64))
        points = np.empty((len(keys), self._domain.n), dtype=np.int64)
        for i, word in enumerate(self._word):
            stride = self._strides[i, word]
            points[:, i] = words[word] // stride
            words[word] = words[word] - points[:, i] * stride
        return points

    def unsolved(self) -> UnsolvedKeys:
        """Return a set, empty as yet, of keys that are yet to be solved."""
        return UnsolvedKeys(self, self._keys[-1:].copy())

    def ask(self, keys: np.ndarray) -> Question:
        """Return which of the keys (K,) are new, and how to spread the answers."""
        self._merge()
        ordered, order = self._sort(keys)
        first = np.ones(len(keys), dtype=bool)
        np.not_equal(ordered[1:], ordered[:-1], out=first[1:])
        distinct = ordered[first]
        places = np.searchsorted(self._keys, distinct)
        new = self._keys[places] != distinct
        return Question(distinct, places, new, order, first)

    def _sort(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the keys in ascending order, and the places that they came from."""
        bits = len(keys).bit_length()
        if self._type != np.int64 or self._size >> (63 - bits):  # key and place do not fit 63 bits
            order = np.argsort(keys, kind="stable")
            return keys[order], order
        packed = keys << bits
        packed |= np.arange(len(keys))
        packed.sort()
        ordered = packed >> bits
        packed &= (1 << bits) - 1
        return ordered, packed

    def answer(
        self, question: Question, level: int, max_level: int, cells: int, quarter: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the sets (K, J, W) and scores (K, V, S) of a question's keys; NaN where unknown.

        Those that are new are solved.
        """
        keys = question.distinct[question.new]
        solved = self._solve(keys, level, max_level, cells, quarter)
        self._pending = (question.places[question.new], keys, *solved)
        self.count += len(keys)
        rows = np.cumsum(question.first, dtype=np.int32) - 1
        answers = []
        for kept, new in zip((self._masks, self._scores), solved):
            answer = np.empty((len(question.order), *kept.shape[1:]), dtype=kept.dtype)
            if answer.size:
                known = kept[question.places]
                known[question.new] = new
                answer[question.order] = known[rows]
            answers.append(answer)
        return answers[0], answers[1]

    def _merge(self) -> None:
        """Put the points of the last answer among the sorted ones."""
        if self._pending is not None:
            places, keys, masks, scores = self._pending
            inserted(self._keys, places, keys)
            inserted(self._masks, places, masks)
            if scores.size:
                inserted(self._scores, places, scores)
            self._pending = None

    def _solve(
        self, keys: np.ndarray, level: int, max_level: int, cells: int, quarter: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        started = time.perf_counter()
        masks = np.empty((len(keys), *self.shape), dtype=self.dtype)
        scores: dict[int, np.ndarray] = {}
        size = min(CHUNK, max(1024, -(-len(keys) // 16)))
        parts = [slice(i, i + size) for i in range(0, len(keys), size)]
        missing = np.zeros(len(keys), dtype=bool)

        def work(part: slice) -> int:
            answer = self._label(self._states(keys[part]))
            if self._scored:
                answer, scores[part.start] = answer
            sets = answer.reshape(-1, *self.shape)
            missing[part] = empty(sets).any(axis=1)
            masks[part] = sets
            return len(answer)

        done = 0
        run = self._pool.map if self._pool else map
        for count in run(work, parts):
            done += count
            if self._progress:
                total = self.count + done
                solved, solves = (done, len(keys)) if self._goal is None else (total, self._goal)
                self._progress(Progress(level, max_level, cells, solved, solves, total))
        self.seconds += time.perf_counter() - started
        if missing.any():
            masks[missing] = 0
            masks = or_else(masks, self._default, self._stays)
            self._count_missing(keys, missing, (level, quarter))
        self.indifferent += int(np.count_nonzero(several(masks).any(axis=1)))
        return masks, self._joined(scores, missing)

    def _joined(self, parts: dict[int, np.ndarray], missing: np.ndarray) -> np.ndarray:
        """Return the scores (K, V, S) of new points, from those of the parts that they begin."""
        if not parts:
            return np.zeros((len(missing), *self._scores.shape[1:]))
        scores = np.concatenate([parts[start] for start in sorted(parts)]).astype(float)
        scores[missing] = np.nan
        if not self._scores.size:
            self._scores = np.zeros((len(self._keys), *scores.shape[1:]))
        return scores

    def _count_missing(self, keys: np.ndarray, missing: np.ndarray, rank: tuple[int, bool]) -> None:
        """Count points without a finite result; the first by rank is the example."""
        self.not_finite += int(missing.sum())
        first = keys[missing][0]
        if self._first is None or (*rank, first) < self._first:
            self._first = (*rank, first)
            self.example = self._states(np.array([first], dtype=keys.dtype))[0].tolist()

    def check_finite(self, solves: int, least: int = 0) -> None:
        """Raise `SynthesisError` where too many of `solves`, or of `least`, were not finite."""
        if self.not_finite > NOT_FINITE_LIMIT * max(solves, least):
            raise SynthesisError(
                f"{self.not_finite} of {solves} solves gave no finite result, for instance at "
                f"state {self.example}"
            )

    def _states(self, keys: np.ndarray) -> np.ndarray:
        """Return the states (K, n) of keys (K,)."""
        places = self.places(keys)
        states = np.empty(places.shape)
        for i, count in enumerate(self._lattice):
            states[:, i] = self._domain.faces(i, places[:, i], count)
        return states


def key_strides(extents: Sequence[int]) -> tuple[np.ndarray, list[int]]:
    """Return what a step along each axis adds to each word of a key, (n, W), and the axes' words.

    Consecutive axes share a word as long as it has no more than `WORD` values.
    """
    word, product = [0], extents[-1]
    strides = [1]
    for extent in reversed(extents[:-1]):
        fits = product * extent <= WORD
        strides.append(product if fits else 1)
        word.append(word[-1] if fits else word[-1] + 1)
        product = product * extent if fits else extent
    words = [word[-1] - w for w in reversed(word)]
    table = np.zeros((len(extents), words[-1] + 1), dtype=np.int64)
    table[np.arange(len(extents)), words] = strides[::-1]
    return table, words


def inserted(array: np.ndarray, places: np.ndarray, values: np.ndarray) -> None:
    """Insert values (K, ...) before ascending places (K,) of an array, which grows where it is.

    Its last part goes first, so that no second array is needed; what is before the first place
    stays. Places are those of entries.
    """
    end, top = len(array), len(values)
    array.resize((end + top, *array.shape[1:]), refcheck=False)
    if array[:1].size == 1:  # of one number each NumPy keeps no index while it inserts
        array, values = array.reshape(-1), values.reshape(-1)
    while top:
        start = max(0, end - MERGED)
        low = int(np.searchsorted(places[:top], start))
        array[start + low : end + top] = np.insert(
            array[start:end], places[low:top] - start, values[low:top], axis=0
        )
        end, top = start, low


class UnsolvedKeys:
    """Distinct keys of points that are yet to be solved, each held once and no array beside them.

    `last` (1,) is larger than any key.
    """

    def __init__(self, points: LatticePoints, last: np.ndarray) -> None:
        self._points, self._keys = points, last

    def __len__(self) -> int:
        return len(self._keys) - 1

    @property
    def nbytes(self) -> int:
        """Bytes of the keys."""
        return self._keys.nbytes

    def add(self, keys: np.ndarray) -> None:
        """Put those of the keys (K,) in that are not solved."""
        question = self._points.ask(keys)
        unsolved = question.distinct[question.new]
        places = np.searchsorted(self._keys, unsolved)
        other = self._keys[places] != unsolved
        inserted(self._keys, places[other], unsolved[other])


@dataclass(frozen=True)
class Question:
    """Keys, sorted and made distinct."""

    distinct: np.ndarray  # (D,): the distinct keys, ascending
    places: np.ndarray  # (D,): where they stand, or would stand, among the points solved before
    new: np.ndarray  # (D,): whether they are yet to be solved
    order: np.ndarray  # (K,): places, among the keys asked for, in ascending order of the keys
    first: np.ndarray  # (K,): whether the key at a place of `order` differs from the one before

    @property
    def samples(self) -> np.ndarray:
        """Places (M,), among the keys that were asked for, of the first copy of each new key."""
        return self.order[self.first][self.new]
