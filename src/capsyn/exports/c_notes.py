"""What the C header of an export says to its reader."""

from __future__ import annotations

from collections.abc import Mapping

from capsyn.exports.c_counts import CountAxis
from capsyn.exports.c_language import z_type
from capsyn.exports.plan import Plan


def count_lines(axes: list[CountAxis]) -> list[tuple[CountAxis, str]]:
    """Return each axis of counts with a line about it."""
    found = []
    for i, axis in enumerate(axes):
        line = f"Readings are counts r; the step of axis {i} is {axis.text}."
        if axis.turn:
            line += f" A turn is {axis.turn} counts; those of other turns are brought into one."
        if axis.missed:
            line += (
                f" Counts are coarse: {axis.missed} of {len(axis.changes) + 1} steps never occur."
            )
        found.append((axis, line))
    return found


def notes(
    plan: Plan,
    arithmetic: str,
    axes: list[CountAxis],
    renamed: Mapping[str, str],
    changed: float | None,
) -> list[str]:
    """Return what a user must know, as lines.

    `changed` is the share of states whose symbol rounding changes.
    """
    counts = ", ".join(map(str, plan.tree.cells.counts))
    lines = [
        f"Quantisation: the axes have {counts} equal steps. Step k of an axis with C steps "
        "holds the states face(k) <= x < face(k + 1), where face(k) = lower + (upper - lower) "
        "* (k / C), rounded as written in double precision; the upper bound belongs to the "
        "last step; periodic states are brought into [lower, upper) first. The tree compares "
        "steps: its symbol is the same for all states of a step, and quantising changes the "
        "symbol of 0 % of the states.",
    ]
    if arithmetic == "lattice":
        lines.append(f"Steps are {z_type(plan.tree.cells.counts)}: 0 to C - 1 fit.")
    if arithmetic == "float":
        lines.append(
            "Single precision: the symbol is the policy's at the float state. Rounding states "
            f"to floats changed the symbol of {changed:.3%} of 20,000 random states. A periodic "
            "state beyond its bounds is brought back in single precision."
        )
    lines += [line for _, line in count_lines(axes)]
    lines.append(
        "Status: OUTSIDE of the domain, or NOT_FINITE, or OK. Symbols outside are those above."
    )
    lines.append(
        "MISRA C:2012: deviations, of the category advisory only: 2.4 (symbols are for "
        "callers), 8.7 (callers may call every function of this file)."
    )
    return lines + [f"Name '{old}' became {new}." for old, new in renamed.items()]
