"""What the C header of an export says to its reader."""

from __future__ import annotations

from capsyn.exports.c_counts import CountAxis
from capsyn.exports.c_language import z_type
from capsyn.exports.c_quantiser import share_changed_by_single_precision
from capsyn.exports.identifiers import identifiers
from capsyn.exports.plan import Plan


def notes(
    plan: Plan, arithmetic: str, axes: list[CountAxis], prefix: str, wanted: str
) -> list[str]:
    """Return what a user must know, as lines."""
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
        share = share_changed_by_single_precision(plan)
        lines.append(
            "Single precision: the symbol is the policy's at the float state. Rounding states "
            f"to floats changed the symbol of {share:.3%} of 20,000 random states. A periodic "
            "state beyond its bounds is brought back in single precision."
        )
    for i, axis in enumerate(axes):
        line = f"Readings are counts r; the step of axis {i} is {axis.text}."
        if axis.turn:
            line += f" A turn is {axis.turn} counts; those of other turns are brought into one."
        if axis.missed:
            line += (
                f" Counts are coarse: {axis.missed} of {len(axis.changes) + 1} steps never occur."
            )
        lines.append(line)
    lines.append(
        "Status: OUTSIDE of the domain, or NOT_FINITE, or OK. Symbols outside are those above."
    )
    if prefix != wanted:
        lines.append(f"Name '{wanted}' became {prefix}.")
    lines.append(
        "MISRA C:2012: deviations, of the category advisory only: 2.4 (symbols are for "
        "callers), 8.7 (callers may call every function of this file)."
    )
    names = identifiers(plan.symbol_names, fold=True)
    for k, name in enumerate(names):
        if name != plan.symbol_names[k]:
            lines.append(f"Symbol '{plan.symbol_names[k]}' became {name.upper()}.")
    return lines
