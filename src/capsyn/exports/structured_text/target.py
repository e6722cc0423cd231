"""IEC 61131-3 Structured Text: a function block for a PLC."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.errors import ProblemError
from capsyn.exports.c.readings.counts import golden_counts, limit_of
from capsyn.exports.c.readings.single import (
    SAMPLES,
    check_single_precision,
    decide_single,
    share_changed,
)
from capsyn.exports.golden import Golden
from capsyn.exports.plan import Files, Plan
from capsyn.exports.sequence import Sequence, golden_sequence, run
from capsyn.exports.structured_text.block import Block
from capsyn.exports.structured_text.dialects.plcopen import project
from capsyn.exports.structured_text.dialects.siemens import scl
from capsyn.exports.structured_text.functions import functions
from capsyn.exports.structured_text.lines import comment
from capsyn.exports.structured_text.memory import row_function
from capsyn.exports.structured_text.pou import renamed_unit, text
from capsyn.exports.structured_text.source import block_unit, next_units, notes
from capsyn.exports.structured_text.steps import tables
from capsyn.exports.target import Exported, Target
from capsyn.validation import one_of

LEAST, MOST = 1.2e-38, 3.4e38
"""Sizes of literals that every compiler takes: MATIEC refuses those that no REAL holds."""
MOST_FACES = 1 << 16
"""Most faces in tables for cells, or a tree with oblique splits: 256 kB of REAL or DINT."""


@dataclass(frozen=True)
class Options:
    """Options of target ``structured-text``.

    Parameters
    ----------
    style : "nested", "table" or "cells", optional
        The tree as IF statements in functions, or as arrays that a loop walks through; or the
        cells of the policy, with the rows of affine leaves. Default: cells of affine leaves, else
        nested.
    real : "LREAL" or "REAL"
        Type of numbers; REAL, single precision, for PLCs without LREAL. The symbol then is the
        policy's at the REAL state.
    readings : "real", "INT" or "DINT"
        What inputs are: numbers of the type above, or counts of a sensor, whole numbers of 16 or
        32 bits, of which the state is ``count * scale + offset``, as for target ``c``. The steps
        of counts are looked up in tables, without floating point.
    dialect : "iec" or "siemens"
        IEC 61131-3 edition 2, as a text and as PLCopen XML; or SCL for TIA Portal.
    name : str, optional
        Name of the block. Default: that of the policy.
    """

    style: str | None = None
    real: str = "LREAL"
    readings: str = "real"
    dialect: str = "iec"
    name: str | None = None


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return a function block and the functions that it calls, as one file, and as PLCopen XML.

    The inputs are readings, the outputs the symbol, the status (0 in the domain, 1 outside, 2 not
    finite) and the controls. With a minimum dwell time there is one more input ``cycle``, the TIME
    since the call before.
    """
    style = options.style or ("cells" if plan.as_cells else "nested")
    one_of("style", style, ["nested", "table", "cells"])
    if style == "cells" and not isinstance(plan.policy.cells, CellTree):
        raise ProblemError(f"`style` cells is for policies of cells; got {plan.policy!r}")
    options, plan = dataclasses.replace(options, style=style), plan.written(style == "cells")
    one_of("real", options.real, ["LREAL", "REAL"])
    one_of("readings", options.readings, ["real", "INT", "DINT"])
    one_of("dialect", options.dialect, ["iec", "siemens"])
    single = options.real == "REAL" and options.readings == "real"
    _check(plan, options, single)
    block = Block.of(plan, style, options.real, options.readings, options.name)
    _check_tables(block)
    changed, vectors = None, None
    if single:
        changed, vectors = share_changed(plan), decide_single(plan, golden.readings)
    elif block.axes:
        vectors = golden_counts(plan, block.axes, options.readings)
    files = _files(block, options, _header(block, options, changed))
    return Exported(
        files,
        block.renamed,
        notes(block),
        changed,
        vectors,
        plan=plan,
        chosen={"style": style},
        sequence=_sequence(block, single) if plan.has_state else None,
    )


def _sequence(block: Block, single: bool) -> Sequence | None:
    """Return golden sequences of readings as the block has them; None: those of the plan."""
    if not (single or block.axes):
        return None
    plan = block.plan
    found = golden_sequence(plan)
    if block.axes:
        limit = limit_of(block.reading)
        readings = np.clip(np.rint(np.nan_to_num(found.readings)), -limit, limit - 1)
        in_turn = readings.copy()
        for i, axis in enumerate(block.axes):
            if axis.turn:  # exactly, where the state would be rounded
                turned = -1 - readings[..., i] if axis.falling else readings[..., i]
                turned = axis.inside[0] + (turned - axis.inside[0]) % axis.turn
                in_turn[..., i] = -1 - turned if axis.falling else turned
        expected = run(plan, in_turn, found.period)
    else:
        golden = decide_single(plan, found.readings.reshape(-1, plan.n))
        readings = golden.readings.reshape(found.readings.shape)
        unfolded = dataclasses.replace(plan, scale=np.ones(plan.n), offset=np.zeros(plan.n))
        expected = run(unfolded, golden.states.reshape(readings.shape), found.period)
    return dataclasses.replace(expected, readings=readings)


def _check(plan: Plan, options: Options, single: bool) -> None:
    """Raise `ProblemError` where numbers cannot be written, or be told apart."""
    domain = plan.policy.space
    parts = {"controls": plan.policy.controls}
    if options.readings == "real":
        ends = np.column_stack([domain.lower, domain.upper])
        bounds = {f"bounds of axis '{name}'": row for name, row in zip(domain.names, ends)}
        parts |= {"`scale`": plan.scale, "`offset`": plan.offset} | bounds
    for name, values in parts.items():
        size = np.abs(values)
        wrong = (size > MOST) | ((size < LEAST) & (size > 0))
        if wrong.any():
            raise ProblemError(
                f"target structured-text needs {name} between {LEAST} and {MOST} in size, or 0; "
                f"got {float(values[wrong][0])!r}"
            )
    if single:
        check_single_precision(plan, plan.cells, "`real` REAL", "LREAL")
    if (rows := len(plan.transitions)) > 1 << 15:
        what = "rows of transitions" if rows > plan.labels else "symbols"
        raise ProblemError(f"target structured-text has INT {what}; the policy has {rows}")


def _check_tables(block: Block) -> None:
    """Raise `ProblemError` where tables are too large, or a turn is no DINT."""
    total = sum(array.size for array in tables(block).values())
    cells = isinstance(block.tree, CellTree)
    if (cells or block.tree.has_planes) and total > MOST_FACES:
        what, other = (
            (f"`readings` {block.reading}", "real") if block.axes else ("`real` REAL", "LREAL")
        )
        of = "cells" if cells else "a tree with oblique splits"
        raise ProblemError(
            f"{what} tabulates all {total:,} faces of {of}; more than {MOST_FACES:,} are too many: "
            f"take {other}, or a coarser policy"
        )
    for name, axis in zip(block.plan.policy.space.names, block.axes):
        if axis.turn > (1 << 31) - 1:
            raise ProblemError(
                f"`scale` must make a turn of the periodic axis '{name}' fewer counts than 2^31"
            )


def _header(block: Block, options: Options, changed: float | None) -> list[str]:
    lines = [*block.plan.header]
    lines.append(
        f"Target structured-text: {options.style}, numbers {options.real}, readings "
        f"{options.readings}, dialect {options.dialect}."
    )
    for name, axis in zip(block.plan.policy.space.names, block.axes):
        if axis.turn:
            lines.append(f"A turn of '{name}' is {axis.turn} counts; others are brought into one.")
    if changed is not None:
        lines.append(
            "Single precision (REAL): the symbol is the policy's at the REAL state. Rounding "
            f"changed the symbol or the status of {changed:.3%} of {SAMPLES:,} random states."
        )
    return lines + [f"Renamed: {old!r} is {new}" for old, new in block.renamed.items()]


def _files(block: Block, options: Options, header: list[str]) -> Files:
    siemens = options.dialect == "siemens"
    units = [*functions(block), *row_function(block), *next_units(block)]
    units.append(block_unit(block, siemens))
    units = [renamed_unit(unit, block.yielding) for unit in units]
    names = [unit.name for unit in units]
    lines: list[str] = [] if siemens else list(comment(header))
    for unit in units:
        own = header if unit.name == block.name else []
        lines += ["", *(scl(unit, names, block.real, own) if siemens else text(unit))]
    source = ("\n".join(lines).lstrip() + "\n").encode("ascii")
    if siemens:
        return {f"{block.name}.scl": source}
    return {f"{block.name}.st": source, f"{block.name}.xml": project(block.name, header, units)}


TARGET = Target(export, Options, remembers=True)
