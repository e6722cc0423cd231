"""Symbols in texts: numbers of controls, names or indices of an alphabet, vectors of inputs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.sources.table import MOST_SYMBOLS
from capsyn.sources.tables.numbers import is_none, is_number, numbers, one_mark, vector
from capsyn.sources.text import fail, naming
from capsyn.validation import describe, one_line

RESERVED = {"error", "nearest", "default"}
"""Names that no symbol may have: `_` is added."""
CONTROLS = "controls that are finite numbers"


class Coder:
    """Codes of texts, each the number of the first text like it."""

    def __init__(self) -> None:
        self.codes: dict[str, int] = {}
        self.lines: list[int] = []

    def __call__(self, texts: Sequence[str], lines: Sequence[int]) -> np.ndarray:
        """Return the codes (B,) of texts, which stand in lines."""
        codes, found = self.codes, []
        for text, line in zip(texts, lines):
            code = codes.get(text)
            if code is None:
                code = codes[text] = len(codes)
                self.lines.append(line)
            found.append(code)
        return np.array(found, dtype=np.int64)

    @property
    def texts(self) -> list[str]:
        """The texts by their codes."""
        return [text.strip() for text in self.codes]


def one_input(
    path: str,
    coder: Coder,
    codes: np.ndarray,
    alphabet: Alphabet | None,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
) -> tuple[np.ndarray, Alphabet]:
    """Return the masks (B,) of symbols as text, several separated by ``|``, and the alphabet.

    `names` and `units` are those of the input.
    """
    known_names = set() if alphabet is None else set(alphabet.names)
    parts_of: list[list[str]] = []
    where: dict[str, int] = {}
    for text, line in zip(coder.texts, coder.lines):
        empty = is_none(text) and text not in known_names
        parts_of.append([] if empty else list({part.strip(): 0 for part in text.split("|")}))
        for part in parts_of[-1]:
            where.setdefault(part, line)
    if not where:
        raise ProblemError(f"'{path}' must have a symbol in some row; all of its points are gaps")
    if alphabet is None:
        known, alphabet = _own(path, where, names, units)
    else:
        known = _names_or_indices(path, where, alphabet)
    _check_count(path, alphabet)
    masks = [sum(1 << k for k in {known[part] for part in parts}) for parts in parts_of]
    return np.array(masks, dtype=np.uint64)[codes], alphabet


def named(
    path: str, coder: Coder, codes: np.ndarray, alphabet: Alphabet | None
) -> tuple[np.ndarray, Alphabet]:
    """Return the masks (B,) of names of symbols, one each, and the alphabet.

    An empty name is none. Where all are numbers, they are controls; else their controls are 0, 1,
    .., in the order of the file. An alphabet must have these names, or be in this order.
    """
    texts = coder.texts
    where = {text: line for text, line in zip(texts, coder.lines) if text}
    if not where:
        raise ProblemError(f"'{path}' must have a symbol at some state; all of them are gaps")
    if alphabet is None and all(is_number(text) for text in where):
        known, alphabet = _own(path, where, None, None)
    else:
        known, alphabet = of_names(path, list(where), alphabet)
    _check_count(path, alphabet)
    masks = [1 << known[text] if text else 0 for text in texts]
    return np.array(masks, dtype=np.uint64)[codes], alphabet


def of_names(
    path: str, names: Sequence[str], alphabet: Alphabet | None
) -> tuple[dict[str, int], Alphabet]:
    """Return which symbol each of some names is, and the alphabet; see `named`."""
    own = {name: f"{name}_" if name in RESERVED else name for name in names}
    if alphabet is None:
        with naming(path):
            alphabet = Alphabet(np.arange(len(names)), list(own.values()))
    places = {name: k for k, name in enumerate(alphabet.names)}
    if set(own.values()) <= set(places):
        return {name: places[own[name]] for name in names}, alphabet
    if len(names) == len(alphabet) and not set(own.values()) & set(places):
        return {name: k for k, name in enumerate(names)}, alphabet
    raise ProblemError(
        f"'{path}': `alphabet` (--alphabet) must have the names of the file's symbols, or be "
        f"{len(names)} in their order: {one_line(', '.join(own.values()), 120)}; got "
        f"{one_line(', '.join(alphabet.names), 120)}"
    )


def several_inputs(
    path: str,
    coders: Sequence[Coder],
    codes: np.ndarray,
    alphabet: Alphabet | None,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
) -> tuple[np.ndarray, Alphabet]:
    """Return the masks (B,) of controls, of whose inputs `codes` (B, m) are, and the alphabet.

    `names` and `units` are those of the inputs.
    """
    columns = []
    for coder in coders:
        values = numbers(coder.texts) + 0.0
        for text, line, value in zip(coder.texts, coder.lines, values):
            if not np.isfinite(value) and not is_none(text):
                fail(path, line, one_mark(text, CONTROLS), text)
        columns.append(values)
    kinds, first, back = np.unique(codes, axis=0, return_index=True, return_inverse=True)
    vectors = np.stack([column[kinds[:, i]] for i, column in enumerate(columns)], axis=1)
    none = np.isnan(vectors)
    if none.all():
        raise ProblemError(f"'{path}' must have a symbol in some row; all of its points are gaps")
    partly = np.flatnonzero(none.any(axis=1) & ~none.all(axis=1))
    if len(partly):
        i = int(partly[np.argmin(first[partly])])
        lines = [coder.lines[kinds[i, j]] for j, coder in enumerate(coders)]
        fail(path, max(lines), "a number for every input, or for none", str(vectors[i].tolist()))
    if alphabet is None:
        unique = np.unique(vectors[~none.any(axis=1)], axis=0)
        with naming(path):
            alphabet = Alphabet(unique, inputs=names, units=units)
    elif alphabet.m == len(coders) and alphabet.inputs == Alphabet(alphabet.values[:1]).inputs:
        with naming(path):  # inputs of no name have those of the file
            alphabet = dataclasses.replace(alphabet, inputs=names, units=units)
    _check_count(path, alphabet)
    rows = {tuple(vector): k for k, vector in enumerate(alphabet.values.tolist())}
    masks = np.zeros(len(kinds), dtype=np.uint64)
    for i in np.flatnonzero(~none.any(axis=1)).tolist():
        found = rows.get(tuple(vectors[i].tolist()))
        if found is None:
            raise ProblemError(
                f"'{path}' must have controls of `alphabet` (--alphabet); got "
                f"{describe(vectors[i].tolist())}"
            )
        masks[i] = np.uint64(1) << np.uint64(found)
    return masks[back.reshape(-1)], alphabet


def _check_count(path: str, alphabet: Alphabet) -> None:
    if len(alphabet) > MOST_SYMBOLS:
        raise ProblemError(
            f"'{path}': `alphabet` of a table must have at most {MOST_SYMBOLS} symbols; "
            f"got {len(alphabet)}"
        )


def _own(
    path: str, where: dict[str, int], names: Sequence[str] | None, units: Sequence[str] | None
) -> tuple[dict[str, int], Alphabet]:
    """Return the symbols that texts stand for, and their alphabet: numbers, vectors, or names.

    Controls of names are their numbers, in the order of the file.
    """
    found = dict(zip(where, (numbers(list(where)) + 0.0).tolist()))
    odd = [part for part, value in found.items() if not np.isfinite(value)]
    if odd and len(odd) < len(found):
        fail(path, where[odd[0]], one_mark(odd[0], CONTROLS), odd[0])
    vectors = {part: vector(part) for part in odd}
    if odd and len({len(v) for v in vectors.values()} - {0}) == 1 and all(vectors.values()):
        rows = sorted(set(vectors.values()))
        with naming(path):
            several = names if len(rows[0]) == 1 else None
            alphabet = Alphabet(rows, inputs=several, units=units if several else None)
        return {part: rows.index(v) for part, v in vectors.items()}, alphabet
    with naming(path):
        if odd:
            alphabet = Alphabet(np.arange(len(odd)), odd, inputs=names, units=units)
            return {part: k for k, part in enumerate(odd)}, alphabet
        values = sorted(set(found.values()))
        alphabet = Alphabet(values, inputs=names, units=units)
    return {part: values.index(value) for part, value in found.items()}, alphabet


def _names_or_indices(path: str, where: dict[str, int], alphabet: Alphabet) -> dict[str, int]:
    """Return the symbols that texts stand for, names or else indices; `where` has their lines."""
    names = {name: k for k, name in enumerate(alphabet.names)}
    indices = {str(k): k for k in range(len(alphabet))}
    named, rest = ([p for p in where if (p in names) == is_name] for is_name in (True, False))
    for part in rest:
        if part not in indices:
            wanted = f"symbols among {one_line(', '.join(alphabet.names))}, or their indices"
            fail(path, where[part], wanted, part)
    if named and rest:
        wanted = f"a symbol's name, like '{named[0]}' in line {where[named[0]]}, or indices alone"
        fail(path, where[rest[0]], wanted, rest[0])
    return indices if rest else names
