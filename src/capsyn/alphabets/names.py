"""Names of symbols: which of a problem's own symbols others are, and names made of values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capsyn.modelling.alphabet import Alphabet

SHORT = 6
"""Digits of a number in a name, where they tell candidates apart."""


def own_symbols(own: Alphabet, values: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return which of a problem's own symbols each of K is by its value (K, m), -1 for none.

    Of several with that value it is the one of the same name, else the first.
    """
    places: dict[tuple[float, ...], int] = {}
    for k, value in reversed(list(enumerate(map(tuple, own.values.tolist())))):
        places[value] = k
    found = [places.get(value, -1) for value in map(tuple, values.tolist())]
    for k, name in enumerate(names):
        if name in own.names:
            same = own.names.index(name)
            if (own.values[same] == values[k]).all():
                found[k] = same
    return np.array(found, dtype=np.int64)


def value_names(values: np.ndarray) -> list[str]:
    """Return names of distinct control vectors (K, m), short where that tells them apart."""
    for text in (lambda v: f"{v:.{SHORT}g}", lambda v: repr(v).removesuffix(".0")):
        parts = [[text(v) for v in row] for row in values.tolist()]
        names = [row[0] if len(row) == 1 else f"({', '.join(row)})" for row in parts]
        if len(set(names)) == len(names):
            break
    return names


def with_own_names(own: Alphabet, values: np.ndarray, names: Sequence[str]) -> list[str]:
    """Return names of candidates, a problem's own for its own symbols, no name twice."""
    of = own_symbols(own, values, names)
    found = [own.names[i] if i >= 0 else "" for i in of]
    used = set(found)
    for k, given in enumerate(names):
        if not found[k]:
            name, again = given, 2
            while name in used:
                name, again = f"{given} ({again})", again + 1
            found[k] = name
            used.add(name)
    return found
