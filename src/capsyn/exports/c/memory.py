"""What follows the symbol in force, in C: a small table behind the number that a leaf has."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.exports.c.language import Part, constants, place_type
from capsyn.policies.policy import Policy

KEPT_CODE = 32
"""About what code of kept sets takes more than that of a plain table [bytes]."""
AVR_TABLE = (1 << 15) - 1
"""Bytes of a table that an AVR reaches."""


@dataclass(frozen=True, eq=False)
class Memory:
    """Cells or a tree whose leaf numbers are rows of a `table` (K, N + 1), only those in use.

    Rows are in lexicographic order, so that where a mirror reverses symbols it reverses rows.
    """

    cells: CellTree | SplitTree
    table: np.ndarray

    @property
    def labels(self) -> int:
        """Number of labels, N + 1."""
        return self.table.shape[1]

    @functools.cached_property
    def kept(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The table as the label (K,) of each row, and where that in force stays (K, N + 1).

        None where there are rows of three labels, or where a plain table takes fewer bytes.
        """
        stays = self.table == np.arange(self.labels)
        best = np.where(stays, -1, self.table).max(axis=1)
        best = np.where(best < 0, self.table[:, -1], best)
        if not (stays | (self.table == best[:, None])).all():
            return None
        size = len(best) * (self._entry + -(-self.labels // 8)) + KEPT_CODE
        return (best, stays) if size < self.table.size * self._entry else None

    @property
    def _entry(self) -> int:
        """Bytes of a label."""
        return 1 if self.labels <= 256 else 2

    @property
    def bytes(self) -> int:
        """Bytes that it takes."""
        if self.kept is None:
            return self.table.size * self._entry
        return len(self.table) * (self._entry + -(-self.labels // 8))

    def follows(self, prefix: str) -> Part:
        """Return the function ``<prefix>_follows(row, before)``, with its tables."""
        integer, kind = ("uint8_t", "BYTE") if self._entry == 1 else ("int16_t", "INT16")
        values = self.table if self.kept is None else self.kept[0]
        tables, reads = constants(f"{prefix}_rows", integer, values.ravel().tolist()), {kind}
        if self.kept is None:
            at = place_type(values.size)
            body = f"""\
    const {at} place = ({at})((({at})row * {self.labels}u) + ({at})before);
    return (int16_t)CAPSYN_{kind}(&{prefix}_rows[place]);
"""
        else:
            bits = np.packbits(self.kept[1], axis=1, bitorder="little")
            tables += constants(f"{prefix}_kept", "uint8_t", bits.ravel().tolist())
            at, reads = place_type(bits.size), reads | {"BYTE"}
            body = f"""\
    const {at} place = ({at})((({at})row * {bits.shape[1]}u) + (({at})before / 8u));
    const uint16_t kept = (uint16_t)CAPSYN_BYTE(&{prefix}_kept[place]);
    int16_t symbol = before;
    if (((kept >> ((uint16_t)before % 8u)) & 1u) == 0u) {{
        symbol = (int16_t)CAPSYN_{kind}(&{prefix}_rows[row]);
    }}
    return symbol;
"""
        text = f"""{self._limit()}
/* Return the symbol that follows the one before in a row. */
static int16_t {prefix}_follows(int16_t row, int16_t before)
{{
{tables}{body}}}
"""
        return Part(text, frozenset(reads))

    def _limit(self) -> str:
        if self.bytes <= AVR_TABLE:
            return ""
        return f"""
#if defined(__AVR__)
#error "tables of {self.bytes} bytes: an AVR reaches {AVR_TABLE} of one table"
#endif
"""


@functools.lru_cache(maxsize=1)
def memory_of(source: Policy) -> Memory:
    """Return what a policy remembers, or a tree."""
    cells, table = source.cells, source.transitions
    numbers = cells.constant_leaves(len(table))
    used = np.unique(numbers) if len(numbers) else np.zeros(1, dtype=np.int64)
    used = used[np.lexsort(table[used].T[::-1])]
    places = np.zeros(len(table), dtype=np.int32)
    places[used] = np.arange(len(used))
    if isinstance(cells, SplitTree):
        leaf = cells.split == LEAF
        threshold = np.where(leaf, places[np.where(leaf, cells.threshold, 0)], cells.threshold)
        return Memory(dataclasses.replace(cells, threshold=threshold), table[used])
    leaves = -1 - cells.entries
    constant = (leaves >= 0) & (leaves < len(table))
    fewer = len(used) - len(table)
    moved = np.where(constant, places[np.where(constant, leaves, 0)], leaves + fewer)
    entries = np.where(leaves >= 0, -1 - moved, cells.entries).astype(np.int32)
    affine = cells.affine
    if affine is not None:
        affine = dataclasses.replace(affine, first=len(used))
    return Memory(dataclasses.replace(cells, entries=entries, affine=affine), table[used])
