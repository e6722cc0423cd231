"""What the C header of an export says to its reader."""

from __future__ import annotations

import contextlib
import dataclasses

import numpy as np

from capsyn.cells.packing import packed_bytes
from capsyn.errors import ProblemError
from capsyn.exports.c.code import Code
from capsyn.exports.c.language import z_type
from capsyn.exports.c.readings.counts import CountAxis, count_axes
from capsyn.exports.c.readings.single import SAMPLES
from capsyn.exports.feature_texts import feature_note

TOLD_COUNTS = 1024
"""Bytes of tables of counts that a user is not warned of."""
TOLD_FACES = 4096
"""Bytes of tables of faces that a user is not told of."""


def _count_lines(axes: list[CountAxis]) -> list[str]:
    lines = []
    for i, axis in enumerate(axes):
        line = f"Readings are counts r; the step of axis {i} is {axis.text}."
        if axis.table_bytes:
            line += f" It takes {axis.table_bytes:,} bytes of tables."
        if axis.turn:
            line += f" A turn is {axis.turn} counts; those of other turns are brought into one."
        if axis.missed:
            line += (
                f" Counts are coarse: {axis.missed} of {len(axis.changes) + 1} steps never occur."
            )
        lines.append(line)
    return lines


def remarks(code: Code) -> tuple[str, ...]:
    """Return what a user is told as the export is made."""
    counts, lines = code.tree.counts, _count_lines(code.axes)
    size = 4 * sum(map(len, code.faces or []))
    if size > TOLD_FACES:
        lines.append(f"tables of the faces take {size:,} bytes; arithmetic lattice has none")
    if code.integer != "int16_t":
        lines.append(f"lattice steps are of 32 bits: an axis has {max(counts):,}, beyond 16 bits")
    return tuple(lines)


def heavy_tables(code: Code) -> str | None:
    """Return a warning where tables of counts take more than the tree, else none."""
    plan, sizes = code.plan, [axis.table_bytes for axis in code.axes]
    rest = packed_bytes(plan.cells)
    if sum(sizes) <= max(rest, TOLD_COUNTS):
        return None
    i = int(np.argmax(sizes))
    name = plan.policy.space.names[i]
    why = "counts fall on faces of its lattice" if code.axes[i].line else "no line gives its steps"
    warning = f"tables of `readings` {code.readings} take {sizes[i]:,} bytes for axis '{name}'"
    warning += f" (the {plan.cells.kind}: {rest:,}), since {why}: "
    offset = plan.offset.copy()
    step = plan.policy.space.widths[i] / plan.counts[i]
    offset[i] += min(abs(plan.scale[i]), step) / 2  # between faces
    with contextlib.suppress(ProblemError):  # counts may no more reach every step
        (moved,) = count_axes(dataclasses.replace(plan, offset=offset), code.readings, [i])
        if moved.table_bytes <= sizes[i] / 2:
            warning += f"an `offset` of {float(offset[i])!r} takes {moved.table_bytes:,}; "
    return (
        f"{warning}otherwise take another `scale`, or give lattice steps to {code.prefix}_symbol(z)"
    )


def notes(code: Code) -> list[str]:
    """Return what a user must know, as lines."""
    plan, arithmetic = code.plan, code.arithmetic
    counts = ", ".join(map(str, plan.counts))
    of_steps = "Cells hold whole steps: the" if plan.as_cells else "The tree compares steps: its"
    lines = [
        f"Quantisation: the axes have {counts} equal steps. Step k of an axis with C steps "
        "holds the states face(k) <= x < face(k + 1), where face(k) = lower + (upper - lower) "
        "* (k / C), rounded as written in double precision; the upper bound belongs to the "
        "last step; periodic states are brought into [lower, upper) first. "
        f"{of_steps} symbol is the same for all states of a step, and quantising changes the "
        "symbol of 0 % of the states.",
    ]
    if code.features:
        lines.append(feature_note(code.features))
    if arithmetic == "lattice":
        lines.append(f"Steps are {z_type(plan.counts)}: 0 to C - 1 fit.")
    if arithmetic == "float":
        state, what = "the float state", "states"
        if plan.folded:
            state += ", reading * scale + offset in single precision"
            what = "readings, scale and offset"
        lines.append(
            f"Single precision: the symbol is the policy's at {state}. Rounding {what} to floats "
            f"changed the symbol or the status of {code.changed:.3%} of {SAMPLES:,} random states. "
            "A periodic state beyond its bounds is brought back in single precision."
        )
    domain = plan.policy.space
    if any(domain.periodic) and not code.axes:
        most = np.finfo(np.float32 if arithmetic == "float" else np.float64).max
        narrowest = domain.widths[list(domain.periodic)].min()
        turns = 2 * int(np.ceil(np.log2(most) - np.log2(narrowest))) + 1
        lines.append(
            "Time: a periodic state between 2^k and 2^(k + 1) periods off takes 2 k + 1 turns of "
            f"a loop, the farthest that is finite up to {turns:,}. Where time counts, bring "
            "states near first."
        )
    lines += _count_lines(code.axes)
    lines.append(
        "Status: OUTSIDE of the domain, or NOT_FINITE, or OK. Symbols outside are those above."
    )
    if plan.policy.gaps:
        gap = f"Symbol {plan.gap} of steps: no symbol, the state is OUTSIDE."
        lines.append(gap if arithmetic == "lattice" else "Gaps are OUTSIDE, too.")
    lines.append(
        "MISRA C:2012: deviations, of the category advisory only: 2.4 (symbols are for "
        "callers), 8.7 (callers may call every function of this file)."
    )
    return lines + [f"Name '{old}' became {new}." for old, new in code.renamed.items()]
