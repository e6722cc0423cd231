"""C style ``grid``: the label of every lattice cell in a dense table."""

from __future__ import annotations

import math

import numpy as np

from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.errors import ProblemError
from capsyn.exports.c.language import Part, byte_rows, z_type

MOST_CELLS = 1 << 16
"""Cells of a grid at most."""


def grid(tree: SplitTree, prefix: str, opening: str) -> Part:
    """Return the function ``opening(z)`` that gives the label of lattice steps, with its table.

    Raises
    ------
    ProblemError
        More than `MOST_CELLS` cells, or more than 256 labels in use.
    """
    cells = math.prod(tree.counts)
    used = int(tree.threshold[tree.split == LEAF].max())
    if cells > MOST_CELLS or used > 255:
        raise ProblemError(
            f"`style` grid is for at most {MOST_CELLS:,} cells and 256 labels; the lattice has "
            f"{cells:,} and the tree {used + 1}: take table or nested"
        )
    bits = next(b for b in (1, 2, 4, 8) if used < 1 << b)
    per = 8 // bits
    steps = np.stack(np.unravel_index(np.arange(cells), tree.counts), axis=1)
    labels = tree.labels(steps).astype(np.int64)
    packed = np.pad(labels, (0, -cells % per)).reshape(-1, per) << (bits * np.arange(per))
    data = packed.sum(axis=1).tolist()
    lines = ["    uint32_t cell = 0u;"]
    for i, count in enumerate(tree.counts):
        if i and count > 1:
            lines.append(f"    cell *= {count}u;")
        lines += [
            f"    if (z[{i}] >= {count}) {{",
            f"        cell += {count - 1}u;",
            f"    }} else if (z[{i}] > 0) {{",
            f"        cell += (u{z_type(tree.counts)})z[{i}];",
            "    } else {",
            "        /* the first step */",
            "    }",
        ]
    place, label = "cell", "byte"
    if per > 1:
        place = f"cell / {per}u"
        label = f"(byte >> ((cell % {per}u) * {bits}u)) & {(1 << bits) - 1}u"
    lines.append(f"    byte = (uint32_t)CAPSYN_BYTE(&{prefix}_cells[{place}]);")
    body = "\n".join(lines)
    return Part(
        f"""
{opening}
{{
    static const uint8_t {prefix}_cells[{len(data)}] CAPSYN_ROM = {{
{byte_rows(data)}
    }};
    uint32_t byte;
    uint16_t label;
{body}
    label = (uint16_t)({label});
    return (int16_t)label;
}}
""",
        frozenset({"BYTE"}),
    )
