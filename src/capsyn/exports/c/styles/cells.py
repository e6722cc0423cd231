"""C style ``cells``: the cells as they are, a grid of trees whose leaves may have affine rows.

A step goes down from its cell of the root grid to a leaf. That has a symbol, or rows: the symbol is
that of the largest row, of equals the lowest. Where differences of slopes fit 16 bits the first row
of a leaf is taken from all, becomes 0 throughout and is left out, but where changes of the symbol
have prices. Leaves of equal rows share them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from capsyn.cells.affine_leaves import LARGEST_SLOPE, LARGEST_SUM, AffineLeaves
from capsyn.cells.boxes import ragged
from capsyn.cells.cell_tree import CellTree
from capsyn.exports.c.language import WIDTH, Part, z_type
from capsyn.exports.c.styles.nested import nearest

TYPES = {"uint8": "BYTE", "int8": "INT8", "int16": "INT16", "int32": "INT32"}
"""What reads table entries of a type, the narrowest first."""
LEAST = -LARGEST_SUM - 1
"""Less than any row comes to."""
LEAST_PRICED = 2 * LEAST + 1
"""Less than any row and its price come to."""
AVR_TABLE, AVR_MEMORY = (1 << 15) - 1, 1 << 16
"""Bytes of a table, and of program memory, that an AVR reaches with 16 bits."""


@dataclass(frozen=True, eq=False)
class Table:
    """Whole numbers in the narrowest entries that hold them."""

    name: str
    values: np.ndarray

    @property
    def type(self) -> np.dtype:
        """Type of its entries."""
        low, high = int(self.values.min()), int(self.values.max())
        types = map(np.dtype, TYPES)
        return next(t for t in types if np.iinfo(t).min <= low and high <= np.iinfo(t).max)

    @property
    def kind(self) -> str:
        """What reads an entry."""
        return TYPES[self.type.name]

    @property
    def bytes(self) -> int:
        """Bytes that it takes."""
        return self.type.itemsize * len(self.values)

    def declaration(self) -> str:
        """Return its definition within a function."""
        width = 1 + max(len(str(int(self.values.min()))), len(str(int(self.values.max()))))
        per, texts = (WIDTH - 8) // width, list(map(str, self.values.tolist()))
        lines = [",".join(texts[k : k + per]) for k in range(0, len(texts), per)]
        entries = ",\n        ".join(lines)
        return (
            f"    static const {self.type.name}_t {self.name}[{len(texts)}] CAPSYN_ROM = {{\n"
            f"        {entries}\n    }};\n"
        )

    def read(self, place: str) -> str:
        """Return the expression of an entry."""
        return f"CAPSYN_{self.kind}(&{self.name}[{place}])"


@dataclass(frozen=True, eq=False)
class Tables:
    """All tables: of cells, and of rows where leaves are affine."""

    cells: dict[str, Table]
    rows: dict[str, Table]

    @staticmethod
    def of(cells: CellTree, prefix: str) -> Tables:
        """Return the tables of cells."""
        entries, rows = cells.entries, dict[str, np.ndarray]()
        if cells.affine is not None:
            numbers, rows = (_priced_rows if cells.priced else _rows)(cells.affine)
            leaf = -1 - entries - cells.affine.first
            entries = np.where(leaf < 0, entries, -1 - cells.affine.first - numbers[leaf.clip(0)])
        arrays = {"entries": entries}
        if cells.splits is not None:
            arrays["splits"] = cells.splits
        made = ({k: Table(f"{prefix}_{k}", v) for k, v in some.items()} for some in (arrays, rows))
        return Tables(*made)

    @property
    def all(self) -> list[Table]:
        """Every table."""
        return [*self.cells.values(), *self.rows.values()]

    @property
    def bytes(self) -> int:
        """Bytes that they take."""
        return sum(table.bytes for table in self.all)

    @property
    def kinds(self) -> frozenset[str]:
        """What reads their entries."""
        return frozenset(table.kind for table in self.all)


def _rows(affine: AffineLeaves) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return new numbers (A,) of affine leaves, and the arrays of their rows.

    ``lowest`` is the symbol of a leaf's first row, which is left out where it is 0 throughout.
    """
    first, counts = affine.starts[:-1], np.diff(affine.starts)
    leaf, number = ragged(counts)
    slopes = affine.slopes.astype(np.int32) - affine.slopes[first][leaf]
    fits = np.logical_and.reduceat((np.abs(slopes) <= LARGEST_SLOPE).all(axis=1), first)
    slopes = np.where(fits[leaf][:, None], slopes, affine.slopes)
    constants = affine.constants - np.where(fits, affine.constants[first], 0)[leaf]
    numbers, chosen = _distinct(np.column_stack([affine.symbols, constants, slopes]), affine.starts)
    kept = np.isin(leaf, chosen) & ((number > 0) | ~fits[leaf])
    return numbers, {
        "lowest": affine.symbols[first][chosen],
        "starts": np.concatenate([[0], np.cumsum((counts - fits)[chosen])]),
        "symbols": affine.symbols[kept],
        "constants": constants[kept],
        "slopes": slopes[kept].ravel(),
    }


def _priced_rows(affine: AffineLeaves) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return new numbers (A,) of affine leaves, and the arrays of their rows and their prices."""
    assert affine.prices is not None and affine.ratios is not None
    counts = np.diff(affine.starts)
    leaf, _ = ragged(counts)
    columns = [affine.prices[leaf], affine.symbols, affine.constants, affine.slopes]
    numbers, chosen = _distinct(np.column_stack(columns), affine.starts)
    kept = np.isin(leaf, chosen)
    return numbers, {
        "prices": affine.prices[chosen],
        "ratios": affine.ratios.ravel(),
        "starts": np.concatenate([[0], np.cumsum(counts[chosen])]),
        "symbols": affine.symbols[kept],
        "constants": affine.constants[kept],
        "slopes": affine.slopes[kept].ravel(),
    }


def _distinct(rows: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers (A,) of leaves, the same for the same rows, and the first leaf of each."""
    known: dict[bytes, int] = {}
    numbers = np.empty(len(starts) - 1, dtype=np.int64)
    for a, (start, end) in enumerate(zip(starts[:-1].tolist(), starts[1:].tolist())):
        numbers[a] = known.setdefault(rows[start:end].tobytes(), len(known))
    return numbers, np.unique(numbers, return_index=True)[1]


def cells_bytes(cells: CellTree) -> int:
    """Return the bytes of the tables of cells."""
    return Tables.of(cells, "").bytes


def cells_style(
    cells: CellTree, prefix: str, opening: str, public: bool, remembers: bool = False
) -> Part:
    """Return the function ``opening(z)`` that gives the label of lattice steps, with its tables.

    Of a `public` function steps may be beyond the lattice. Leaves of what `remembers` are rows: the
    function gives these or, where some leaves are affine, as ``opening(before, z)`` the label that
    follows the one before.
    """
    tables, z = Tables.of(cells, prefix), z_type(cells.counts)
    text = _limit(tables) + _leaf(cells, tables, prefix)
    follows = remembers and cells.affine is not None
    argument = "int16_t before, " * follows + f"const {z} z[{cells.n}]"
    inner = f"static int16_t {prefix}_within({argument})" if public else opening
    leaf = f"{tables.cells['entries'].type.name}_t"
    if cells.affine is None:
        text += f"""
{inner}
{{
    return (int16_t)(-1 - {prefix}_leaf(z));
}}
"""
    else:
        text += (_least_priced if cells.priced else _largest)(cells, tables, prefix)
        constant = "leaf" if leaf == "int16_t" else "(int16_t)leaf"
        declared, otherwise = f"int16_t symbol = {constant};", ""
        if follows:
            declared = "int16_t symbol;"
            otherwise = f" else {{\n        symbol = {prefix}_follows({constant}, before);\n    }}"
        text += f"""
{inner}
{{
    const {leaf} leaf = ({leaf})(-1 - {prefix}_leaf(z));
    {declared}
    if (leaf >= {cells.affine.first}) {{
        const {leaf} number = ({leaf})(leaf - {cells.affine.first});
        symbol = {prefix}_largest({"before, " * cells.priced}z, ({_index(tables)})number);
    }}{otherwise}
    return symbol;
}}
"""
    if public:
        text += nearest(cells, prefix, opening, "before, " * follows)
    return Part(text, tables.kinds)


def _index(tables: Tables) -> str:
    """Return the type of places in the tables."""
    most = max(len(table.values) for table in tables.all)
    return "uint16_t" if most < 1 << 16 else "uint32_t"


def _limit(tables: Tables) -> str:
    if max(table.bytes for table in tables.all) <= AVR_TABLE and tables.bytes <= AVR_MEMORY:
        return ""
    return f"""
#if defined(__AVR__)
#error "tables of {tables.bytes} bytes: an AVR reaches {AVR_MEMORY}, and {AVR_TABLE} of one table"
#endif
"""


def _leaf(cells: CellTree, tables: Tables, prefix: str) -> str:
    """Return the function that gives the entry of the leaf of steps."""
    z, at, entries = z_type(cells.counts), _index(tables), tables.cells["entries"]
    unsigned, entry = f"u{z}", f"{entries.type.name}_t"
    declared, body = [], []
    for i, (size, parts) in enumerate(zip(cells.sizes(0).tolist(), cells.partitions)):
        declared.append(f"    {unsigned} rest{i} = ({unsigned})z[{i}];")
        declared.append(f"    {unsigned} size{i} = {size}u;")
        if parts > 1:
            place = f"rest{i} / {size}u"
            body.append(f"    at = ({at})({f'(at * {parts}u) + ({place})' if i else place});")
            body.append(f"    rest{i} %= {size}u;")
    axes, down = "", [line for i in range(cells.n) for line in _child(cells, i, unsigned, at)]
    if cells.splits is not None:
        axes = f"        const uint16_t axes = (uint16_t){tables.cells['splits'].read('at')};\n"
    down = [f"        {line}" for line in down]
    lines = "\n".join([*declared, *body])
    steps = "\n".join(down)
    text = "".join(table.declaration() for table in tables.cells.values())
    return f"""
/* Return the entry of the leaf that holds steps: -1 less its number. */
static {entry} {prefix}_leaf(const {z} z[{cells.n}])
{{
{text}    {at} at = 0u;
    {entry} entry;
{lines}
    entry = {entries.read("at")};
    while (entry >= 0) {{
{axes}        {at} child = 0u;
{steps}
        at = ({at})(({at})entry + child);
        entry = {entries.read("at")};
    }}
    return entry;
}}
"""


def _child(cells: CellTree, i: int, unsigned: str, at: str) -> Iterator[str]:
    """Yield what goes on to the part of a cell along an axis."""
    parts = cells.refinement[i]
    lines = [f"size{i} /= {parts}u;"]
    if parts == 2:
        lines += [
            f"child = ({at})(child * 2u);",
            f"if (rest{i} >= size{i}) {{",
            f"    rest{i} = ({unsigned})(rest{i} - size{i});",
            "    ++child;",
            "}",
        ]
    else:
        lines.append(f"child = ({at})((child * {parts}u) + (rest{i} / size{i}));")
        lines.append(f"rest{i} %= size{i};")
    if cells.splits is None:
        yield from lines
    else:
        yield f"if ((axes & {1 << i}u) != 0u) {{"
        yield from (f"    {line}" for line in lines)
        yield "}"


def _largest(cells: CellTree, tables: Tables, prefix: str) -> str:
    """Return the function that gives the symbol of an affine leaf."""
    index, rows = _index(tables), tables.rows
    text = "".join(table.declaration() for table in rows.values())
    return f"""
/*
 * Return the symbol of the largest row of a leaf, of equals the lowest. The row of the leaf's
 * lowest symbol is 0 unless it is there.
 */
static int16_t {prefix}_largest(const {z_type(cells.counts)} z[{cells.n}], {index} leaf)
{{
{text}    const {index} end = ({index}){rows["starts"].read("leaf + 1u")};
    {index} row = ({index}){rows["starts"].read("leaf")};
    {index} place = ({index})(row * {cells.n}u);
    int16_t symbol = (int16_t){rows["lowest"].read("leaf")};
    int32_t most = 0;
    if ((int16_t){rows["symbols"].read("row")} == symbol) {{
        most = {LEAST};
    }}
    while (row < end) {{
        int32_t value = (int32_t){rows["constants"].read("row")};
        uint16_t i;
        for (i = 0u; i < {cells.n}u; ++i) {{
            value += (int32_t){rows["slopes"].read("place")} * (int32_t)z[i];
            ++place;
        }}
        if (value > most) {{
            most = value;
            symbol = (int16_t){rows["symbols"].read("row")};
        }}
        ++row;
    }}
    return symbol;
}}
"""


def _least_priced(cells: CellTree, tables: Tables, prefix: str) -> str:
    """Return the function that gives the symbol which follows another in an affine leaf."""
    assert cells.affine is not None and cells.affine.ratios is not None
    index, rows, labels = _index(tables), tables.rows, len(cells.affine.ratios)
    text = "".join(table.declaration() for table in rows.values())
    return f"""
/*
 * Return the symbol of the row of a leaf that is largest less the price of what follows the symbol
 * before: of equals that itself comes first, else the lowest. It stays where no row may follow.
 */
static int16_t {prefix}_largest(int16_t before, const {z_type(cells.counts)} z[{cells.n}],
    {index} leaf)
{{
{text}    const {index} end = ({index}){rows["starts"].read("leaf + 1u")};
    const int32_t price = (int32_t){rows["prices"].read("leaf")};
    {index} row = ({index}){rows["starts"].read("leaf")};
    {index} place = ({index})(row * {cells.n}u);
    int16_t symbol = before;
    int32_t most = {LEAST_PRICED};
    while (row < end) {{
        const int16_t other = (int16_t){rows["symbols"].read("row")};
        const {index} pair = ({index})((({index})before * {labels}u) + ({index})other);
        const int32_t ratio = (int32_t){rows["ratios"].read("pair")};
        int32_t value = (int32_t){rows["constants"].read("row")} - (price * ratio);
        uint16_t i;
        for (i = 0u; i < {cells.n}u; ++i) {{
            value += (int32_t){rows["slopes"].read("place")} * (int32_t)z[i];
            ++place;
        }}
        if ((ratio >= 0) && ((value > most) || ((value == most) && (other == before)))) {{
            most = value;
            symbol = other;
        }}
        ++row;
    }}
    return symbol;
}}
"""
