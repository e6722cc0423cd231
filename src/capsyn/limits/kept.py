"""The states from which a policy keeps its limits: what it says of itself, as cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.cut import cut
from capsyn.cells.masks import word_count
from capsyn.errors import PolicyFormatError
from capsyn.modelling.domain import Box
from capsyn.modelling.grid import Grid
from capsyn.validation import finite_number, keep, read_only

KEPT_ARRAYS = {"kept_entries": np.int32, "kept_rows": np.uint8}
"""The arrays as files call them."""


@dataclass(frozen=True, eq=False)
class Kept:
    """The set of states, of cells, from which the sampled loop of a policy keeps its limits.

    A state on a face of cells belongs to the upper one, as everywhere; see `Box`.
    """

    cells: CellTree  # leaf numbers are those of rows
    rows: np.ndarray  # (K, 1) bool, or (K, N + 1): kept while each label is in force
    sample_time: float  # of the loop [time unit]
    parameters: Mapping[str, tuple[float, float]]  # ranges of what is not known of the plant

    def __post_init__(self) -> None:
        keep(self, rows=read_only(np.asarray(self.rows, dtype=bool)))

    @staticmethod
    def of(entries: np.ndarray, grid: Grid, rows: np.ndarray, **said: Any) -> Kept:
        """Return the set of leaf entries (M,) of a grid, whose leaf numbers are those of `rows`."""
        none = np.zeros((0, 1, word_count(len(rows))), dtype=np.uint64)
        cells = CellTree(grid, entries.astype(np.int32), np.zeros(0, dtype=np.int32), none)
        return Kept(cells, rows, **said)

    def at(self, exogenous: np.ndarray, told: Box) -> Kept:
        """Return the set of the states alone while exogenous inputs (k,) stay, of their box."""
        steps = told.locate(exogenous[None], self.cells.counts[-told.n :])[0]
        cells = cut(self.cells, steps)
        assert isinstance(cells, CellTree)
        return Kept(cells, self.rows, self.sample_time, self.parameters)

    def holds(self, numbers: np.ndarray, in_force: np.ndarray | None) -> np.ndarray:
        """Return whether limits are kept (B,) in leaves of these numbers (B,), negative outside.

        `in_force` (B,) are the labels in force, by default the default's.
        """
        last = self.rows.shape[1] - 1
        now = last if in_force is None or not last else in_force
        return np.asarray((numbers >= 0) & self.rows[np.maximum(numbers, 0), now])

    def to_json(self) -> dict[str, Any]:
        """Return what a file says of the set beside its arrays, as plain data."""
        ranges = {name: list(ends) for name, ends in self.parameters.items()}
        return self.cells.structure() | {"sample_time": self.sample_time, "parameters": ranges}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by their names in a file."""
        return {"kept_entries": self.cells.entries, "kept_rows": self.rows.astype(np.uint8)}

    @staticmethod
    def from_file(data: Any, arrays: Mapping[str, np.ndarray], labels: int, space: Box) -> Kept:
        """Return the set that a file has, of so many labels, N + 1, and in a space.

        `PolicyFormatError` where there is none.
        """
        keys = {"partitions", "refinement", "max_level", "sample_time", "parameters"}
        if not isinstance(data, dict) or set(data) != keys:
            raise PolicyFormatError("what it says of kept limits is of another kind")
        grid = Grid.of(data["partitions"], data["refinement"], data["max_level"], space.n)
        rows, ranges = arrays["kept_rows"], data["parameters"]
        if not len(rows) or rows.shape[1] not in (1, labels) or (rows > 1).any():
            raise PolicyFormatError("its rows of kept limits are none of its symbols")
        if not isinstance(ranges, dict):
            raise PolicyFormatError("what it says of kept limits is of another kind")
        numbers = {
            name: (finite_number(name, low), finite_number(name, high))
            for name, (low, high) in ranges.items()
        }
        time = finite_number("sample_time", data["sample_time"], above=0.0)
        kept = Kept.of(arrays["kept_entries"], grid, rows, sample_time=time, parameters=numbers)
        space.check_resolution(grid.counts)
        kept.cells.check(len(rows))
        return kept
