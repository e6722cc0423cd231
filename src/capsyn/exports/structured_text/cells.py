"""Cells as arrays in Structured Text, and the loops that find the label of lattice steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from capsyn.cells.affine_leaves import LARGEST_SUM, AffineLeaves
from capsyn.cells.cell_tree import CellTree
from capsyn.exports.structured_text.pou import Variable, element

LEAST = -LARGEST_SUM - 1
"""Less than any row comes to; with prices, twice as much."""
PLACES = ("within", "size")
"""Arrays of a number for each axis: the place in a cell, and its edge lengths."""
LOCAL = (*PLACES, "child", "digit", "entry", "axes", "most", "row")
TABLES = ("entries", "splits", "starts", "symbols", "constants", "slopes")


def cell_arrays(cells: CellTree) -> dict[str, np.ndarray]:
    """Return the arrays by their names in the block."""
    arrays = {"entries": cells.entries}
    if cells.splits is not None:
        arrays["splits"] = cells.splits
    if cells.affine is not None:
        rows = cells.affine.arrays().items()
        arrays |= {name.removeprefix("row_"): array.ravel() for name, array in rows}
    return arrays


def cell_numbers(cells: CellTree) -> list[str]:
    """Return the names of the whole numbers that the loops use."""
    numbers = ["node", "child", "digit", "entry"]
    numbers += ["axes"] * (cells.splits is not None) + ["ratio"] * cells.priced
    return numbers + ["last", "most", "row", "value", "i"] * (cells.affine is not None)


def cell_walk(cells: CellTree, arrays: Mapping[str, Variable], now: str) -> list[str]:
    """Return the statements that make ``wanted`` the label of lattice steps ``z``.

    It is that of a row where the policy remembers; `now` is the symbol in force.
    """
    lines = ["node := 0;"]
    for i, (size, parts) in enumerate(zip(cells.sizes(0).tolist(), cells.partitions)):
        lines += [
            f"size[{i}] := {size};",
            f"digit := z[{i}] / {size};",
            f"within[{i}] := z[{i}] - digit * {size};",
            f"node := node * {parts} + digit;",
        ]
    entry = f"entry := {element(arrays['entries'], 'node')};"
    lines += [entry, "WHILE entry >= 0 DO", "    child := 0;"]
    if cells.splits is not None:
        lines.append(f"    axes := {element(arrays['splits'], 'node')};")
    lines += [f"    {line}" for i in range(cells.n) for line in _child(cells, i)]
    lines += ["    node := entry + child;", f"    {entry}", "END_WHILE;", "entry := -1 - entry;"]
    if cells.affine is None:
        return [*lines, "wanted := DINT_TO_INT(entry);"]
    if cells.affine.ratios is not None:
        return lines + _least_priced(arrays, cells.n, cells.affine, now)
    return lines + _largest(arrays, cells.n, cells.affine.first)


def _child(cells: CellTree, i: int) -> Iterator[str]:
    """Yield what goes on to the part of a cell along an axis."""
    parts = cells.refinement[i]
    lines = [
        f"size[{i}] := size[{i}] / {parts};",
        f"digit := within[{i}] / size[{i}];",
        f"within[{i}] := within[{i}] - digit * size[{i}];",
        f"child := child * {parts} + digit;",
    ]
    if cells.splits is None:
        yield from lines
    else:  # the lowest bit, and the others
        yield "digit := axes / 2;"
        yield "IF (axes - 2 * digit) = 1 THEN"
        yield "    axes := digit;"
        yield from (f"    {line}" for line in lines)
        yield "ELSE"
        yield "    axes := digit;"
        yield "END_IF;"


def _largest(arrays: Mapping[str, Variable], n: int, first: int) -> list[str]:
    """Return the statements that give the symbol of a leaf."""
    slope = _slope(arrays, n)
    return f"""\
IF entry < {first} THEN
    wanted := DINT_TO_INT(entry);
ELSE
    (* the symbol of the largest row, of equals the first *)
    row := {element(arrays["starts"], f"entry - {first}")};
    last := {element(arrays["starts"], f"entry - {first - 1}")};
    most := {LEAST};
    WHILE row < last DO
        value := {element(arrays["constants"], "row")};
        FOR i := 0 TO {n - 1} DO
            value := value + {slope} * z[i];
        END_FOR;
        IF value > most THEN
            most := value;
            wanted := symbols[row];
        END_IF;
        row := row + 1;
    END_WHILE;
END_IF;""".splitlines()


def _slope(arrays: Mapping[str, Variable], n: int) -> str:
    return element(arrays["slopes"], f"row * {n} + i")


def _least_priced(
    arrays: Mapping[str, Variable], n: int, affine: AffineLeaves, now: str
) -> list[str]:
    """Return the statements that give what follows a symbol in force in a leaf with prices."""
    assert affine.ratios is not None
    first, symbol = affine.first, element(arrays["symbols"], "row")
    ratio = element(arrays["ratios"], f"INT_TO_DINT({now}) * {len(affine.ratios)} + {symbol}")
    return f"""\
IF entry < {first} THEN
    wanted := DINT_TO_INT(entry);
ELSE
    (* the largest row, less the price of a switch; of equals that in force *)
    row := {element(arrays["starts"], f"entry - {first}")};
    last := {element(arrays["starts"], f"entry - {first - 1}")};
    most := {2 * LEAST + 1};
    wanted := {now};
    WHILE row < last DO
        ratio := {ratio};
        IF ratio >= 0 THEN
            value := {element(arrays["constants"], "row")};
            FOR i := 0 TO {n - 1} DO
                value := value + {_slope(arrays, n)} * z[i];
            END_FOR;
            value := value - {element(arrays["prices"], f"entry - {first}")} * ratio;
            IF (value > most) OR ((value = most) AND (symbols[row] = {now})) THEN
                most := value;
                wanted := symbols[row];
            END_IF;
        END_IF;
        row := row + 1;
    END_WHILE;
END_IF;""".splitlines()
