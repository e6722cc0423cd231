"""What follows the symbol in force, in C: a small table behind the number that a leaf has."""

from __future__ import annotations

import dataclasses
import functools
import textwrap
from dataclasses import dataclass

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.exports.c.language import Part, constants, place_type, search
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
    def kept(self) -> Kept | None:
        """The table by what rows keep; None where a plain table takes fewer bytes."""
        found = Kept.of(self.table)
        return found if found.bytes + KEPT_CODE < self.table.size * _entry(self.table) else None

    @property
    def bytes(self) -> int:
        """Bytes that it takes."""
        return self.table.size * _entry(self.table) if self.kept is None else self.kept.bytes

    def follows(self, prefix: str) -> Part:
        """Return the function ``<prefix>_follows(row, before)``, with its tables."""
        if self.kept is not None:
            body, reads = self.kept.body(prefix)
        else:
            body, kind = _declared(f"{prefix}_rows", self.table, _entry(self.table) == 1)
            at, reads = place_type(self.table.size), {kind}
            body += f"""\
    const {at} place = ({at})((({at})row * {self.labels}u) + ({at})before);
    return (int16_t)CAPSYN_{kind}(&{prefix}_rows[place]);
"""
        text = f"""{self._limit()}
/* Return the symbol that follows the one before in a row. */
static int16_t {prefix}_follows(int16_t row, int16_t before)
{{
{body}}}
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


@dataclass(frozen=True, eq=False)
class Kept:
    """A table (K, N + 1) by the labels in force that stay, and the one that all others go to.

    But at `places` (E,) of the table, ascending, there are `others` (E,).
    """

    most: np.ndarray  # (K,): the label that others go to
    stays: np.ndarray  # (K, N + 1) bool
    places: np.ndarray
    others: np.ndarray

    @staticmethod
    def of(table: np.ndarray) -> Kept:
        """Return the form of a table."""
        count = table.shape[1]
        stays = table == np.arange(count)
        goes = (row[row != np.arange(count)] for row in table)
        most = np.array([np.bincount(some).argmax() if len(some) else 0 for some in goes])
        places = np.flatnonzero(~stays & (table != most[:, None]))
        return Kept(most, stays, places, table.ravel()[places])

    @property
    def bytes(self) -> int:
        """Bytes of its tables."""
        entry, (rows, count) = _entry(self.stays), self.stays.shape
        return rows * (entry + -(-count // 8)) + len(self.places) * (4 + entry)

    def body(self, prefix: str) -> tuple[str, set[str]]:
        """Return the body of the function that looks it up, and what it reads from tables."""
        bits, count = np.packbits(self.stays, axis=1, bitorder="little"), self.stays.shape[1]
        at, narrow = place_type(bits.size), _entry(self.stays) == 1
        tables, kind = _declared(f"{prefix}_rows", self.most, narrow)
        tables += constants(f"{prefix}_kept", "uint8_t", bits.ravel().tolist())
        other, reads = f"symbol = (int16_t)CAPSYN_{kind}(&{prefix}_rows[row]);\n", {"BYTE", kind}
        if len(self.places):
            tables += constants(f"{prefix}_places", "uint32_t", self.places.tolist())
            tables += _declared(f"{prefix}_others", self.others, narrow)[0]
            reads.add("UINT32")
            reached = f"pair >= CAPSYN_UINT32(&{prefix}_places[middle])"
            found = textwrap.dedent(search("int16_t", str(len(self.places)), reached))
            other = f"""\
const uint32_t pair = ((uint32_t)row * {count}u) + (uint32_t)before;
{found}
{other}if (pair == CAPSYN_UINT32(&{prefix}_places[low])) {{
    symbol = (int16_t)CAPSYN_{kind}(&{prefix}_others[low]);
}}
"""
        text = f"""\
{tables}    const {at} place = ({at})((({at})row * {bits.shape[1]}u) + (({at})before / 8u));
    const uint16_t kept = (uint16_t)CAPSYN_BYTE(&{prefix}_kept[place]);
    int16_t symbol = before;
    if (((kept >> ((uint16_t)before % 8u)) & 1u) == 0u) {{
{textwrap.indent(other, "        ")}    }}
    return symbol;
"""
        return text, reads


def _entry(table: np.ndarray) -> int:
    """Return the bytes of a label of a table (K, N + 1)."""
    return 1 if table.shape[1] <= 256 else 2


def _declared(name: str, labels: np.ndarray, narrow: bool) -> tuple[str, str]:
    """Return the definition of a table of labels, and what reads an entry."""
    integer, kind = ("uint8_t", "BYTE") if narrow else ("int16_t", "INT16")
    return constants(name, integer, labels.ravel().tolist()), kind


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
