"""Affine leaves: cells whose symbol is that of the largest of a few affine rows, in integers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsyn.cells.masks import singles
from capsyn.errors import PolicyFormatError
from capsyn.validation import keep_read_only

LARGEST_SUM = 2**30 - 1
"""Most that a row may come to anywhere on the lattice; differences of rows fit 32 bits."""
LARGEST_SLOPE = 2**15 - 1
ROW_ARRAYS = {
    "row_starts": np.int32,
    "row_symbols": np.int32,
    "row_constants": np.int32,
    "row_slopes": np.int16,
}
"""The tables as files and kernels call them."""


@dataclass(frozen=True, eq=False)
class AffineLeaves:
    """Tables of rows, one after the other; a leaf's rows ascend by symbol.

    At lattice steps ``z`` a leaf has the symbol of the row with the largest ``constant + slopes @
    z``, of equals that of the lowest symbol. Rows of leaf ``first + a`` are ``starts[a] .. starts[a
    + 1] - 1``, at least two. ``|constant| + |slopes| @ counts`` is at most `LARGEST_SUM`.
    """

    first: int  # leaf number N + 1 of the first: lower ones are symbols and the default
    starts: np.ndarray  # (A + 1,) int32
    symbols: np.ndarray  # (R,) int32: of the rows, N for the default
    constants: np.ndarray  # (R,) int32: values at the lattice's lower corner
    slopes: np.ndarray  # (R, n) int16: change per lattice step

    def __post_init__(self) -> None:
        keep_read_only(self, "starts", "symbols", "constants", "slopes")

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the tables by the names of `ROW_ARRAYS`."""
        return {name: getattr(self, name.removeprefix("row_")) for name in ROW_ARRAYS}

    def __len__(self) -> int:
        return max(0, len(self.starts) - 1)

    @staticmethod
    def of(
        first: int, rows: np.ndarray, symbols: np.ndarray, constants: np.ndarray, slopes: np.ndarray
    ) -> AffineLeaves:
        """Return the leaves with so many `rows` (A,) each."""
        starts = np.concatenate([[0], np.cumsum(rows)]).astype(np.int32)
        return AffineLeaves(first, starts, symbols, constants, slopes)

    def labels(self, leaves: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return the symbols (B,) int32 of affine leaf numbers (B,) at lattice steps (B, n)."""
        return self._largest(leaves, steps)[0]

    def rises(self, leaves: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return how often (B,) a row beats all before it, of affine leaf numbers (B,) at steps."""
        return self._largest(leaves, steps)[1]

    def _largest(self, leaves: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the symbols (B,) of the largest rows, and how often one beat those before."""
        places = np.asarray(leaves) - self.first
        start, rows = self.starts[places], np.diff(self.starts)[places]
        labels, rises = self.symbols[start], np.zeros(len(start), dtype=np.int32)
        best = self._values(start, steps)
        for k in range(1, int(rows.max(initial=0))):
            here = np.flatnonzero(rows > k)
            row = start[here] + k
            values = self._values(row, steps[here])
            better = values > best[here]
            labels[here[better]], best[here[better]] = self.symbols[row[better]], values[better]
            rises[here[better]] += 1
        return labels, rises

    def _values(self, rows: np.ndarray, steps: np.ndarray) -> np.ndarray:
        values = self.constants[rows].astype(np.int64)
        for i in range(steps.shape[1]):
            values += self.slopes[rows, i] * steps[:, i].astype(np.int64, copy=False)
        return values

    def masks(self, label_count: int) -> np.ndarray:
        """Return the sets (A, W) of so many symbols that the leaves' rows have, as bit masks."""
        bits = singles(self.symbols, label_count)
        return np.bitwise_or.reduceat(bits, self.starts[:-1]) if len(self) else bits

    def check(self, counts: tuple[int, ...], label_count: int) -> None:
        """Raise `PolicyFormatError` unless the tables fit each other, a lattice and the labels."""
        rows, starts = len(self.symbols), self.starts.astype(np.int64)
        if self.first != label_count:
            raise PolicyFormatError(f"affine leaves must begin with {label_count}")
        if len(starts) < 2 or starts[0] or starts[-1] != rows or (np.diff(starts) < 2).any():
            raise PolicyFormatError("the rows of affine leaves are not two or more for each")
        if len(self.constants) != rows or self.slopes.shape != (rows, len(counts)):
            raise PolicyFormatError("the tables of affine leaves differ in length")
        if (self.symbols < 0).any() or (self.symbols >= label_count).any():
            raise PolicyFormatError("a row of an affine leaf has an unknown symbol")
        inside = np.ones(rows, dtype=bool)
        inside[starts[:-1]] = False
        if (np.diff(self.symbols)[inside[1:]] <= 0).any():
            raise PolicyFormatError("the rows of an affine leaf do not ascend by symbol")
        sums = np.abs(self.slopes.astype(np.float64)) @ np.array(counts, dtype=np.float64)
        sums += np.abs(self.constants.astype(np.float64))
        if (sums > LARGEST_SUM).any():
            raise PolicyFormatError("a row of an affine leaf has sums beyond 31 bits")
