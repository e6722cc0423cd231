"""Target ``c``: C99 without memory management, input, output or, but of features, library calls."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import FeatureTree
from capsyn.errors import ProblemError, warn
from capsyn.exports.c.code import Code
from capsyn.exports.c.notes import heavy_tables, remarks
from capsyn.exports.c.packages import PACKAGES, packaged
from capsyn.exports.c.readings.counts import READINGS, golden_counts, sequence_counts
from capsyn.exports.c.readings.single import decide_single, sequence_single
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.styles.cells import cells_bytes
from capsyn.exports.c.styles.stream import stream, table_bytes
from capsyn.exports.c.timing.slowest import slowest
from capsyn.exports.golden import Golden
from capsyn.exports.plan import Plan, tree_within
from capsyn.exports.sequence import Sequence
from capsyn.exports.target import Exported, Target
from capsyn.validation import finite_number, one_of, true_or_false

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
        affine leaves. The stream is that of the tree or of an ordered decision diagram, which has
        equal subtrees once; of one half where the symbols of the other follow by reflection:
        whatever takes fewest bytes. Default: table, but cells for affine leaves where these take
        fewer bytes.
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
        Unit of the time that least times are measured in [s], whatever the policy's unit of time;
        at most the shortest of them. By default a microsecond.
    package : "cmake" or "arduino"
        How the files are laid out: header and source with a project of CMake, or an Arduino
        library, a folder of the export's name for the sketchbook's ``libraries``.
    cycles : bool
        Whether ``measured.json`` says how long a decision takes at most, ``worst``: cycles of an
        AVR and instructions of a Cortex-M3, where their compilers and emulators are installed.
        Not for trees with features.
    """

    style: str | None = None
    arithmetic: str = "lattice"
    readings: str = "real"
    name: str | None = None
    tick: float = 1e-6
    package: str = "cmake"
    cycles: bool = False


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return a header, a source, an example, and what packages them."""
    arithmetic, readings = options.arithmetic, options.readings
    options = dataclasses.replace(options, style=_style(plan, options.style))
    plan = plan.written(options.style == "cells")
    one_of("arithmetic", arithmetic, list(ARITHMETICS))
    one_of("readings", readings, list(READINGS))
    one_of("package", options.package, list(PACKAGES))
    if readings != "real" and arithmetic != "lattice":
        raise ProblemError(f"`readings` {readings} needs `arithmetic` lattice; got {arithmetic}")
    finite_number("tick", options.tick, above=0.0)
    true_or_false("cycles", options.cycles)
    if isinstance(plan.policy.cells, FeatureTree):
        _check_features(options)
    if plan.labels > 1 << 15:
        raise ProblemError(f"target c has 16-bit symbols; the policy has {plan.labels}")
    code = _code(plan, options)
    if code.memory is not None and len(code.memory.table) > 1 << 15:
        raise ProblemError(
            f"target c has 16-bit rows; the policy has {len(code.memory.table):,} of them"
        )
    vectors, sequence = _vectors(code, golden)
    if code.axes and (heavy := heavy_tables(code)):
        warn(heavy)
    files, chosen = packaged(code, options.package), {"style": options.style}
    return Exported(
        files,
        code.renamed,
        remarks(code),
        code.changed,
        vectors,
        _written(code),
        f"{code.prefix}/extras/" if options.package == "arduino" else "",
        plan,
        chosen,
        sequence,
    )


def _vectors(code: Code, golden: Golden) -> tuple[Golden | None, Sequence | None]:
    """Return golden vectors and sequences where readings are other numbers than a plan's."""
    plan, has_state = code.plan, code.plan.has_state
    if code.axes:
        sequence = sequence_counts(plan, code.axes, code.readings) if has_state else None
        return golden_counts(plan, code.axes, code.readings), sequence
    if code.arithmetic == "float":
        return decide_single(plan, golden.readings), sequence_single(plan) if has_state else None
    return None, None


def _written(code: Code) -> dict[str, Any] | None:
    """Return how the tree is written, and the rows of transitions, where there are any."""
    written, tree, memory = {}, code.tree, code.memory
    if code.style == "table":
        tree = tree.ranked if isinstance(tree, FeatureTree) else tree
        written = stream(tree, memory is not None).figures
    if memory is not None:
        written |= {"rows": len(memory.table), "row_bytes": memory.bytes}
    return written or None


def _check_features(options: Options) -> None:
    """Raise unless the options can be had for a tree with features."""
    if options.arithmetic != "lattice":
        raise ProblemError(
            f"`arithmetic` must be lattice for a tree with features; got {options.arithmetic}"
        )
    if options.cycles:
        raise ProblemError(
            "`cycles` must be false for a tree with features, whose functions are not timed; "
            "got true"
        )


def _style(plan: Plan, style: str | None) -> str:
    """Return the style that is asked for, or that of the fewest bytes."""
    cells = plan.policy.cells
    if cells.priced:
        if style not in (None, "cells"):
            raise ProblemError(
                f"`style` must be cells for affine leaves with prices on switching; got {style}"
            )
        return "cells"
    if style is not None:
        one_of("style", style, list(STYLES))
        if style == "cells" and not isinstance(cells, CellTree):
            raise ProblemError(f"`style` cells is for policies of cells; got {plan.policy!r}")
        return style
    if isinstance(cells, CellTree) and cells.affine is not None:
        size = cells_bytes(cells)
        tree = tree_within(plan.source, size // BYTES_A_NODE)
        if tree is None or table_bytes(tree.cells) > size:
            return "cells"
    return "table"


def written_bytes(plan: Plan) -> int:
    """Return the bytes of the tables that the files of a policy have by default."""
    style = _style(plan, None)
    code = _code(plan.written(style == "cells"), Options(style=style))
    rows = 0 if code.memory is None else code.memory.bytes
    if isinstance(code.tree, CellTree):
        return rows + cells_bytes(code.tree)
    tree = code.tree.ranked if isinstance(code.tree, FeatureTree) else code.tree
    return rows + (table_bytes(tree, code.memory is not None) if tree.depth else 0)


def measure(plan: Plan, golden: Golden, exported: Exported, options: Options) -> dict[str, Any]:
    """Return what the code takes, by processor; see `sizes`, and ``worst``: see `slowest`."""
    own = (".h", ".c")
    files = {Path(n).name: text for n, text in exported.files.items() if Path(n).suffix in own}
    code = _code(plan, options)
    measured: dict[str, Any] = {**sizes(files, code.prefix)}
    if options.cycles:
        measured["worst"] = slowest(code, files, golden)
    return measured


def _code(plan: Plan, options: Options) -> Code:
    o = options
    assert o.style is not None
    return Code.of(plan, o.style, o.arithmetic, o.readings, o.name, float(o.tick))


TARGET = Target(export, Options, features=True, remembers=True, measure=measure)
