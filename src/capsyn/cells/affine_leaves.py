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
MOST_RATIO = 2**15 - 1
"""Largest whole number that stands for a price, relative to the others."""
ROW_ARRAYS = {
    "row_starts": np.int32,
    "row_symbols": np.int32,
    "row_constants": np.int32,
    "row_slopes": np.int16,
}
"""The tables as files and kernels call them."""
PRICE_ARRAYS = {"row_prices": np.int32, "row_ratios": np.int16}
"""Those of leaves with prices on switching."""


@dataclass(frozen=True, eq=False)
class PriceRatios:
    """Prices on switching as whole numbers: a price is its ratio times a unit."""

    ratios: np.ndarray  # (N + 1, N + 1) int16: from each label to each, -1 where it is forbidden
    unit: float  # what a ratio of 1 stands for [cost / time unit]

    @staticmethod
    def of(prices: np.ndarray) -> PriceRatios:
        """Return the ratios of prices (N + 1, N + 1), infinite where a transition is forbidden.

        They are exact where all are whole multiples of the least, and no more than `MOST_RATIO`;
        else rounded to shares of the largest.
        """
        finite = np.isfinite(prices)
        known = np.where(finite, prices, 0.0)
        some = known[known > 0]
        unit = 1.0
        if some.size:
            multiples = known / some.min()
            exact = np.abs(multiples - np.rint(multiples)).max() < 1e-9
            whole = exact and multiples.max() <= MOST_RATIO
            unit = float(some.min() if whole else some.max() / MOST_RATIO)
        whole = np.maximum(np.rint(known / unit), known > 0)  # no price becomes none
        ratios = np.where(finite, whole, -1)
        return PriceRatios(ratios.astype(np.int16), unit if some.size else 0.0)


@dataclass(frozen=True, eq=False)
class AffineLeaves:
    """Tables of rows, one after the other; a leaf's rows ascend by symbol.

    At lattice steps ``z`` a leaf has the symbol of the row with the largest ``constant + slopes @
    z``, of equals that of the lowest symbol. Rows of leaf ``first + a`` are ``starts[a] .. starts[a
    + 1] - 1``, at least two. ``|constant| + |slopes| @ counts`` is at most `LARGEST_SUM`.

    With prices on switching, a row counts less by ``prices[a] * ratios[j, symbol]`` while j is in
    force, at most `LARGEST_SUM`; of equals j comes first. A ratio of -1 forbids; where all rows are
    forbidden, j stays.
    """

    first: int  # leaf number of the first: lower ones are rows, of labels or of transitions
    starts: np.ndarray  # (A + 1,) int32
    symbols: np.ndarray  # (R,) int32: of the rows, N for the default
    constants: np.ndarray  # (R,) int32: values at the lattice's lower corner
    slopes: np.ndarray  # (R, n) int16: change per lattice step
    prices: np.ndarray | None = None  # (A,) int32: what a ratio of 1 takes off
    ratios: np.ndarray | None = None  # (N + 1, N + 1) int16: from each label to each, or -1

    def __post_init__(self) -> None:
        keep_read_only(self, "starts", "symbols", "constants", "slopes", "prices", "ratios")

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the tables by the names of `ROW_ARRAYS`, and of `PRICE_ARRAYS` if there are."""
        tables = {name: getattr(self, name.removeprefix("row_")) for name in ROW_ARRAYS}
        if self.prices is not None and self.ratios is not None:
            tables |= {"row_prices": self.prices, "row_ratios": self.ratios}
        return tables

    def __len__(self) -> int:
        return max(0, len(self.starts) - 1)

    @staticmethod
    def of(
        first: int,
        rows: np.ndarray,
        symbols: np.ndarray,
        constants: np.ndarray,
        slopes: np.ndarray,
        prices: np.ndarray | None = None,
        ratios: np.ndarray | None = None,
    ) -> AffineLeaves:
        """Return the leaves with so many `rows` (A,) each."""
        starts = np.concatenate([[0], np.cumsum(rows)]).astype(np.int32)
        return AffineLeaves(first, starts, symbols, constants, slopes, prices, ratios)

    def labels(
        self, leaves: np.ndarray, steps: np.ndarray, in_force: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the symbols (B,) int32 of affine leaf numbers (B,) at lattice steps (B, n).

        `in_force` (B,) are the labels in force, by default the default's.
        """
        if self.ratios is None:
            return self._largest(leaves, steps)[0]
        now = np.full(len(steps), len(self.ratios) - 1) if in_force is None else in_force
        return self._least_priced(np.asarray(leaves) - self.first, steps, now)

    def rises(self, leaves: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return how often (B,) a row beats all before it, of affine leaf numbers (B,) at steps.

        That is where no label is in force that has a price.
        """
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

    def _least_priced(self, places: np.ndarray, steps: np.ndarray, now: np.ndarray) -> np.ndarray:
        """Return what follows the labels `now` (B,) at steps (B, n) of leaves (B,)."""
        assert self.prices is not None and self.ratios is not None
        start, rows = self.starts[places], np.diff(self.starts)[places]
        labels, best = now.astype(np.int32), np.full(len(now), np.iinfo(np.int64).min)
        for k in range(int(rows.max(initial=0))):
            here = np.flatnonzero(rows > k)
            row, before = start[here] + k, now[here]
            symbol = self.symbols[row]
            ratio = self.ratios[before, symbol].astype(np.int64)
            values = self._values(row, steps[here]) - self.prices[places[here]] * ratio
            better = (values > best[here]) | ((values == best[here]) & (symbol == before))
            better &= ratio >= 0
            labels[here[better]], best[here[better]] = symbol[better], values[better]
        return labels

    def _values(self, rows: np.ndarray, steps: np.ndarray) -> np.ndarray:
        values = self.constants[rows].astype(np.int64)
        for i in range(steps.shape[1]):
            values += self.slopes[rows, i] * steps[:, i].astype(np.int64, copy=False)
        return values

    def masks(self, label_count: int) -> np.ndarray:
        """Return the sets (A, W) of so many symbols that the leaves' rows have, as bit masks."""
        bits = singles(self.symbols, label_count)
        return np.bitwise_or.reduceat(bits, self.starts[:-1]) if len(self) else bits

    def check(self, counts: tuple[int, ...], first: int, label_count: int) -> None:
        """Raise `PolicyFormatError` unless the tables fit each other, a lattice and the labels.

        The first leaf has the number `first`.
        """
        rows, starts = len(self.symbols), self.starts.astype(np.int64)
        if self.first != first:
            raise PolicyFormatError(f"affine leaves must begin with {first}")
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
        if self.prices is not None and self.ratios is not None:
            _check_prices(self.prices, self.ratios, len(self), label_count)


def _check_prices(prices: np.ndarray, ratios: np.ndarray, leaves: int, label_count: int) -> None:
    """Raise `PolicyFormatError` unless prices fit so many leaves, and ratios the labels."""
    if len(prices) != leaves or ratios.shape != (label_count, label_count):
        raise PolicyFormatError("the prices of affine leaves differ in number from these")
    if (ratios < -1).any() or (ratios > MOST_RATIO).any() or np.diagonal(ratios).any():
        raise PolicyFormatError("a ratio of prices is out of range")
    if (prices < 0).any() or (
        prices.astype(np.int64) * max(1, int(ratios.max())) > LARGEST_SUM
    ).any():
        raise PolicyFormatError("a price of an affine leaf is beyond 31 bits")
