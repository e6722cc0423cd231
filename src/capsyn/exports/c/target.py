"""Target ``c``: C99 without memory management, input, output or library calls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from capsyn.cells.cell_tree import CellTree
from capsyn.errors import ProblemError, warn
from capsyn.exports.c.code import Code
from capsyn.exports.c.header import cmake, example, header
from capsyn.exports.c.notes import heavy_tables, remarks
from capsyn.exports.c.readings.counts import READINGS, golden_counts
from capsyn.exports.c.readings.single import decide_single
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.source import source
from capsyn.exports.c.styles.cells import cells_bytes
from capsyn.exports.c.styles.table import table_bytes
from capsyn.exports.golden import Golden
from capsyn.exports.plan import Files, Plan, tree_within
from capsyn.exports.target import Exported, Target
from capsyn.validation import finite_number, one_of

STYLES = ("table", "nested", "grid", "cells")
BYTES_A_NODE = 3
"""Fewer bytes than a node of a tree with oblique splits takes in style table."""
ARITHMETICS = ("lattice", "double", "float")


@dataclass(frozen=True)
class Options:
    """Options of target ``c``.

    Parameters
    ----------
    style : "table", "nested", "grid" or "cells", optional
        The tree as a stream of bits (smallest), as nested conditions, or as a dense table of labels
        (fastest; up to 65,536 cells); or the cells of the policy as they are, with the rows of
        affine leaves. Default: table, but cells for affine leaves where these take fewer bytes.
    arithmetic : "lattice", "double" or "float"
        What a decision is made on: lattice steps, which a function gives for states in double
        precision; states in double precision; or in single precision.
    readings : "real", "int16" or "int32"
        What functions take: real numbers, or counts of a sensor, whole numbers of 16 or 32 bits.
        Scale and offset then go into a multiplication and a shift of whole numbers, a short list
        of counts or a table of the counts at which the step changes (a `CapsynWarning` says where
        tables take more than the tree), and nothing needs floating point. At every count of the
        integer the symbol is that of the state ``count * scale + offset``; on a
        periodic axis, where a turn must be a whole number of counts (within 0.001), that of the
        count in the turn that begins at the lower bound. The integer must reach the first and the
        last step of every axis. Counts may be coarser than steps, but not than a whole axis; the
        header says how many steps no count gives. Needs ``arithmetic`` lattice.
    name : str, optional
        What files and functions are called, made an identifier. Default: the policy's name.
    tick : float
        Unit of the time that a dwell time is measured in [s].
    """

    style: str | None = None
    arithmetic: str = "lattice"
    readings: str = "real"
    name: str | None = None
    tick: float = 1e-6


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return a header, a source, a snippet for CMake and an example."""
    arithmetic, readings = options.arithmetic, options.readings
    style = _style(plan, options.style)
    plan = plan.written(style == "cells")
    one_of("arithmetic", arithmetic, list(ARITHMETICS))
    one_of("readings", readings, list(READINGS))
    if readings != "real" and arithmetic != "lattice":
        raise ProblemError(f"`readings` {readings} needs `arithmetic` lattice; got {arithmetic}")
    tick = finite_number("tick", options.tick, above=0.0)
    if plan.labels > 1 << 15:
        raise ProblemError(f"target c has 16-bit symbols; the policy has {plan.labels}")
    code = Code.of(plan, style, arithmetic, readings, options.name, tick)
    files = {
        f"{code.prefix}.h": header(code).encode(),
        f"{code.prefix}.c": source(code).encode(),
        "example.c": example(code).encode(),
        "CMakeLists.txt": cmake(code).encode(),
    }
    vectors = decide_single(plan, golden.readings) if arithmetic == "float" else None
    if code.axes:
        vectors = golden_counts(plan, code.axes, readings)
        if heavy := heavy_tables(code):
            warn(heavy)
    return Exported(
        files, code.renamed, remarks(code), code.changed, vectors, plan, {"style": style}
    )


def _style(plan: Plan, style: str | None) -> str:
    """Return the style that is asked for, or that of the fewest bytes."""
    cells = plan.policy.cells
    if style is not None:
        one_of("style", style, list(STYLES))
        if style == "cells" and not isinstance(cells, CellTree):
            raise ProblemError(f"`style` cells is for policies of cells; got {plan.policy!r}")
        return style
    if isinstance(cells, CellTree) and cells.affine is not None:
        size = cells_bytes(cells)
        tree = tree_within(plan.policy, size // BYTES_A_NODE)
        if tree is None or table_bytes(tree.cells) > size:
            return "cells"
    return "table"


def measure(files: Files) -> dict[str, Any]:
    """Return what the code takes, by processor; see `sizes`."""
    (header,) = (name for name in files if name.endswith(".h"))
    return {**sizes(files, header.removesuffix(".h"))}


TARGET = Target(export, Options, measure=measure)
