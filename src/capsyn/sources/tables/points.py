"""The table of states and sets of symbols: where they are on the grid, and what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Box
from capsyn.sources.table import Table, check_points
from capsyn.sources.tables.axes import grid_of
from capsyn.sources.text import naming
from capsyn.validation import one_line

MISSING = ("auto", "error", "outside")
"""What a grid point without a state is."""
MOST_WHOLE = 1 << 53
"""Whole numbers up to which a float is exact."""


@dataclass(frozen=True)
class Points:
    """States of a file, and the symbols that are allowed at each.

    Parameters
    ----------
    path : str
        The file, for errors.
    names, units : lists of str
        Of the states.
    states : (B, n)
        A state may come several times: for each of its symbols.
    lines : (B,) ints
        Where they are in the file.
    bits : (B,) uint64
        Their symbols, as bit masks; 0 for none.
    what : str
        What `lines` are, for errors.
    """

    path: str
    names: Sequence[str] | None
    units: Sequence[str] | None
    states: np.ndarray
    lines: np.ndarray
    bits: np.ndarray
    what: str = "line"

    @property
    def called(self) -> list[str]:
        """What errors call the states."""
        names = Box.unnamed(self.states.shape[1]) if self.names is None else self.names
        return [one_line(name, 100) for name in names]

    def _fail(self, row: int, wanted: str, got: str) -> NoReturn:
        raise ProblemError(
            f"'{self.path}', {self.what} {self.lines[row]}: expected {wanted}; got {got}"
        )

    def table(self, alphabet: Alphabet, missing: str = "auto") -> Table:
        """Return the table of states on a uniform grid that is found from their values.

        A point without a state is an error, or with `missing` ``"outside"`` a gap; with ``"auto"``
        it is a gap unless all points of a value of an axis are.
        """
        first, step, places = grid_of(self.path, self.called, self.states, self.lines, missing)
        table = self._placed(first, step, places, alphabet, missing)
        if missing == "auto" and places.shape[1] > 1 and len(places) < table.masks.size:
            flat = np.ravel_multi_index(tuple(places.T), table.counts)
            others = len(np.unique(flat // table.counts[-1]))
            if others > 1 and others == len(np.unique(flat)):
                *rest, last = self.called
                beside = one_line(", ".join(rest))
                raise ProblemError(
                    f"'{self.path}' has one value of '{last}' for each of {beside}: if it "
                    "is an input, `inputs` (--inputs) must name it; if it is a state, "
                    'missing="outside" (--missing outside) takes the other points as outside'
                )
        return table

    def whole_table(self, alphabet: Alphabet) -> Table:
        """Return the table of states that are whole numbers: its steps are 1, the rest gaps."""
        wrong = np.argwhere((self.states != np.rint(self.states)) | (abs(self.states) > MOST_WHOLE))
        if len(wrong):
            row, axis = wrong[0]
            wanted = f"a whole number for '{self.called[axis]}'"
            self._fail(row, wanted, repr(float(self.states[row, axis])))
        first = self.states.min(axis=0)
        places = (self.states - first).astype(np.int64)
        return self._placed(first, np.ones(len(first)), places, alphabet, "outside")

    def _placed(
        self, first: Any, step: Any, places: np.ndarray, alphabet: Alphabet, missing: str
    ) -> Table:
        counts = tuple((places.max(axis=0) + 1).tolist())
        with naming(self.path):
            check_points(counts)
        flat = np.ravel_multi_index(tuple(places.T), counts)
        total = int(np.prod(counts))
        masks = np.zeros(total, dtype=np.uint64)
        np.bitwise_or.at(masks, flat, self.bits)
        there = np.zeros(total, dtype=bool)
        there[flat] = True
        unsure = np.flatnonzero((self.bits == 0) & (masks[flat] != 0))
        if len(unsure):
            row = unsure[0]
            other = np.flatnonzero((flat == flat[row]) & (self.bits != 0))[0]
            again = f"{self.what} {self.lines[other]}"
            self._fail(row, f"a symbol, as for the same state in {again}", "none")
        if missing == "error" and not there.all():
            where = np.array(np.unravel_index(np.flatnonzero(~there)[0], counts))
            state = ", ".join(f"{v:.6g}" for v in first + step * where)
            raise ProblemError(
                f"'{self.path}' must have a row for each point of its grid of "
                f"{' x '.join(map(str, counts))}; {total - int(there.sum())} are missing, the "
                f'first at ({state}) (missing="outside", or --missing outside, takes them as '
                "outside)"
            )
        with naming(self.path):
            return Table(first, step, masks.reshape(counts), alphabet, self.names, self.units)
