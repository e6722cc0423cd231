"""Target ``c``: C99 without memory management, input, output or library calls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from capsyn.errors import ProblemError, warn
from capsyn.exports.c.code import Code
from capsyn.exports.c.header import cmake, example, header
from capsyn.exports.c.notes import heavy_tables, remarks
from capsyn.exports.c.readings.counts import READINGS, golden_counts
from capsyn.exports.c.readings.single import decide_single
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.source import source
from capsyn.exports.feature_texts import features_of
from capsyn.exports.golden import Golden
from capsyn.exports.plan import Files, Plan
from capsyn.exports.target import Exported, Target
from capsyn.validation import finite_number, one_of

STYLES = ("table", "nested", "grid")
ARITHMETICS = ("lattice", "double", "float")


@dataclass(frozen=True)
class Options:
    """Options of target ``c``.

    Parameters
    ----------
    style : "table", "nested" or "grid"
        A stream of bits (smallest), nested conditions, or a dense table of labels (fastest; up to
        65,536 cells).
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

    style: str = "table"
    arithmetic: str = "lattice"
    readings: str = "real"
    name: str | None = None
    tick: float = 1e-6


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return a header, a source, a snippet for CMake and an example."""
    style, arithmetic, readings = options.style, options.arithmetic, options.readings
    one_of("style", style, list(STYLES))
    one_of("arithmetic", arithmetic, list(ARITHMETICS))
    one_of("readings", readings, list(READINGS))
    if readings != "real" and arithmetic != "lattice":
        raise ProblemError(f"`readings` {readings} needs `arithmetic` lattice; got {arithmetic}")
    if features_of(plan.tree.cells) and arithmetic != "lattice":
        raise ProblemError(
            f"`arithmetic` must be lattice for a tree with features; got {arithmetic}"
        )
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
    return Exported(files, code.renamed, remarks(code), code.changed, vectors)


def measure(files: Files) -> dict[str, Any]:
    """Return what the code takes, by processor; see `sizes`."""
    (header,) = (name for name in files if name.endswith(".h"))
    return {**sizes(files, header.removesuffix(".h"))}


TARGET = Target(export, Options, features=True, measure=measure)
