"""The constants of a policy, for targets that walk through its cells or its tree."""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, Plan
from capsyn.exports.text import spoken


def constants(plan: Plan) -> list[tuple[str, Any, str]]:
    """Return names, values and remarks; remarks of a pair of constants stand at the first."""
    policy = plan.policy
    domain, alphabet = policy.space, policy.alphabet
    asked, first = "a decision" if policy.remembers else "decide", "A state is"
    told: list[tuple[str, Any, str]] = []
    if policy.exogenous is not None:
        about = "Names of the exogenous inputs, which come after the states."
        told = [("EXOGENOUS", policy.exogenous.names, about)]
        first = "States and exogenous inputs are"
    return [
        ("STATES", policy.domain.names, "Names of the states."),
        *told,
        ("UNITS", domain.units, "Their units."),
        ("LOWER", domain.lower.tolist(), "Bounds of the domain."),
        ("UPPER", domain.upper.tolist(), ""),
        ("PERIODIC", domain.periodic, "Whether the upper bound is the same point as the lower."),
        ("SCALE", plan.scale.tolist(), f"{first} what {asked} gets * SCALE + OFFSET."),
        ("OFFSET", plan.offset.tolist(), ""),
        ("COUNTS", plan.counts, "Lattice steps along each axis."),
        ("INPUTS", alphabet.inputs, "Names of the inputs."),
        ("INPUT_UNITS", alphabet.units, "Their units."),
        ("SYMBOLS", plan.symbol_names, "Names of the symbols, the default control last."),
        ("CONTROLS", policy.controls.tolist(), "Their control vectors."),
        ("DEFAULT", plan.default, "The symbol of the default control."),
        ("SAFE", plan.safe, spoken(policy, "The symbol of states that have no other.")),
        (
            "NEAREST",
            plan.nearest,
            spoken(policy, "Whether a state outside has the symbol of the nearest step."),
        ),
        ("GAP", plan.gap, "The label of steps that are outside; -1: none."),
        ("TIME_UNIT", policy.time_unit, "Unit of all times."),
        *_times(plan),
        ("OK", OK, spoken(policy, "Statuses of a state: in the domain, outside, or not finite.")),
        ("OUTSIDE", OUTSIDE, ""),
        ("NOT_FINITE", NOT_FINITE, ""),
        (
            "AT_ONCE",
            plan.at_once,
            f"Those whose symbol does not wait{'' if plan.has_state else ' for MIN_DWELL'}.",
        ),
    ]


def _times(plan: Plan) -> list[tuple[str, Any, str]]:
    """Return what changes of symbols wait for, likewise."""
    rules, unit = plan.policy.rules, plan.policy.time_unit
    if not plan.has_state:
        return [("MIN_DWELL", plan.dwell, f"Least time between switches [{unit}].")]
    return [
        ("HOLDS", rules.holds.tolist(), f"How long each symbol is held once entered [{unit}]."),
        (
            "INPUT_HOLDS",
            rules.input_holds.tolist(),
            f"How long each input is held once it has changed [{unit}].",
        ),
        ("HOLD_OFF", plan.hold_off, f"How long SAFE is in force after the start [{unit}]."),
        ("KINDS", rules.kinds.tolist(), "Of each a number: between symbols of one is no switch."),
        ("FORBIDDEN", plan.forbidden, "Transitions that are not taken, from and to."),
    ]


def tables(plan: Plan) -> list[tuple[str, Any, str]]:
    """Return the arrays of the tree, or of the cells, likewise; where T depends on it, T first."""
    tree, rows = plan.cells, []
    if plan.policy.remembers:
        about = "Of each number of a leaf, the symbol that follows each symbol in force."
        rows = [("TRANSITIONS", plan.transitions.tolist(), about)]
    if isinstance(tree, CellTree):
        return rows + [(k, v.tolist(), note) for k, v, note in cell_tables(tree)]
    return [
        *rows,
        (
            "SPLIT",
            tree.split.tolist(),
            spoken(plan.policy, "What a node compares: a state, then PLANES; -1: a leaf."),
        ),
        (
            "THRESHOLD",
            tree.threshold.tolist(),
            f"From where it goes to SECOND; a leaf's {'number' if rows else 'symbol'}.",
        ),
        ("SECOND", tree.second.tolist(), "Its second child; the first is the next node."),
        ("PLANES", tree.planes.tolist(), "Coefficients of the steps."),
    ]


def cell_tables(cells: CellTree) -> list[tuple[str, np.ndarray, str]]:
    """Return the arrays of cells likewise; of constant leaves without rows.

    Those of prices are there where leaves have them.
    """
    none = np.zeros(0, dtype=np.int32)
    splits = none if cells.splits is None else cells.splits
    rows = {} if cells.affine is None else cells.affine.arrays()
    beyond = "beyond DEFAULT; leaves up to it are symbols"
    if cells.priced:
        beyond = "whose number is beyond those of TRANSITIONS"
    tables = [
        ("PARTITIONS", np.array(cells.partitions), "Cells of the root grid along each axis."),
        ("ROOT_SIZES", cells.sizes(0), "Their steps along each axis."),
        ("REFINEMENT", np.array(cells.refinement), "Parts of a split cell along each axis."),
        ("ENTRIES", cells.entries, "Of each cell the place of its parts, or -1 less its leaf."),
        ("SPLITS", splits, "Bits of the axes that each is split along; without any: all axes."),
        ("ROW_STARTS", none, f"First row of each leaf {beyond}."),
        ("ROW_SYMBOLS", none, "Symbols of rows."),
        (
            "ROW_CONSTANTS",
            none,
            "Their values at step 0: the largest row of a leaf has its symbol.",
        ),
        (
            "ROW_SLOPES",
            none,
            "What they gain at each step, along each axis; one row after another.",
        ),
    ]
    if cells.priced:
        about = (
            "Of each symbol in force, one after another, how often the next one costs it; -1: no."
        )
        tables += [
            ("ROW_PRICES", none, "Of each such leaf what is taken off the rows for a switch."),
            ("ROW_RATIOS", none, about),
        ]
    return [(name, rows.get(name.lower(), array).ravel(), note) for name, array, note in tables]
