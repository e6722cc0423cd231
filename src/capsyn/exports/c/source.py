"""The source of an export in C: controls, the tree, the quantiser and what decides."""

from __future__ import annotations

import re
from dataclasses import replace

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import FeatureTree
from capsyn.exports.c import dwell, timers
from capsyn.exports.c.code import Code
from capsyn.exports.c.features import feature_decision
from capsyn.exports.c.language import Part, macros, rows
from capsyn.exports.c.readings.places import counts_quantiser
from capsyn.exports.c.readings.quantiser import state_quantiser
from capsyn.exports.c.styles.cells import cells_style
from capsyn.exports.c.styles.grid import grid
from capsyn.exports.c.styles.nested import nearest, nested
from capsyn.exports.c.styles.table import table


def source(code: Code) -> str:
    """Return the source file."""
    decision, quantiser, hold = _decision(code), _quantiser(code), Part("")
    states = quantiser.text + _decide(code)
    if code.plan.has_state:
        hold = timers.functions(code)
        states += timers.step(code)
    elif code.plan.dwell:
        hold = dwell.functions(code)
        states += dwell.step(code)
    reads = decision.reads | quantiser.reads | hold.reads
    if code.guards:
        states = code.guarded(states.rstrip("\n"))
    library = "#include <math.h>\n" if code.library else ""
    return f"""{code.about("source")}
#include "{code.prefix}.h"

#include <stdbool.h>
{library}
{macros(reads)}{_control(code)}{decision.text}{hold.text}{states}"""


def _control(code: Code) -> str:
    """Return the function that gives the control of a symbol, with its table."""
    plan, m, upper = code.plan, code.plan.policy.alphabet.m, code.prefix.upper()
    entries = ["{" + ", ".join(code.literal(v) for v in row) + "}" for row in plan.policy.controls]
    return f"""
{code.real} {code.prefix}_control(int16_t symbol, uint16_t input)
{{
    static const {code.real} controls[{upper}_SYMBOLS][{upper}_INPUTS] CAPSYN_ROM = {{
{rows(entries)}
    }};
    uint16_t row = {plan.safe}u;
    {code.real} control = {code.literal(0.0)};
    if ((uint16_t)symbol < {plan.labels}u) {{
        row = (uint16_t)symbol;
    }}
    if (input < {m}u) {{
        CAPSYN_COPY(control, &controls[row][input]);
    }}
    return control;
}}
"""


def _decision(code: Code) -> Part:
    """Return the function that gives the symbol of lattice steps or of states."""
    n, p, memory = code.plan.n, code.prefix, code.memory
    argument = f"const {code.real} x[{n}]" if code.direct else f"const {code.integer} z[{n}]"
    static = "" if code.arithmetic == "lattice" else "static "
    if memory is None:
        return _of_leaf(code, f"{static}int16_t {p}_symbol({argument})", argument)
    mixed = isinstance(code.tree, CellTree) and code.tree.affine is not None
    before = "int16_t before, " * mixed
    part = _of_leaf(code, f"static int16_t {p}_row({before}{argument})", argument)
    text, follows = part.text, memory.follows(p)
    if not mixed:  # what leaves have are rows
        text = re.sub(r"\bsymbol\b", "row", text)
    places = "x" if code.direct else "z"
    taken = f"{p}_row(before, {places})" if mixed else f"{p}_follows({p}_row({places}), before)"
    text += f"""
{static}int16_t {p}_symbol(int16_t in_force, {argument})
{{
    int16_t before = {memory.labels - 1};
    if ((in_force >= 0) && (in_force < {memory.labels})) {{
        before = in_force;
    }}
    return {taken};
}}
"""
    return Part(follows.text + text, part.reads | follows.reads)


def _of_leaf(code: Code, opening: str, argument: str) -> Part:
    """Return the function ``opening`` that gives what a leaf has: a symbol, or a row."""
    p, static = code.prefix, code.arithmetic != "lattice"
    if isinstance(code.tree, CellTree):
        return cells_style(code.tree, p, opening, not static, code.memory is not None)
    if code.style == "grid":
        return grid(code.tree, p, opening)
    if isinstance(code.tree, FeatureTree):
        return feature_decision(
            code.tree, code.style, code.plan.policy.space, p, opening, code.memory is not None
        )
    public, planes = opening, not static and len(code.tree.planes)
    if planes:
        opening = f"static int16_t {p}_within({argument})"
    if code.style == "table":
        part = table(code.tree, p, opening, code.memory is not None)
    else:
        compares = code.arithmetic if code.direct else "lattice"
        part = nested(code.tree, code.plan.policy.space, p, opening, argument, compares)
    if planes:
        part = replace(part, text=part.text + nearest(code.tree, p, public))
    return part


def _quantiser(code: Code) -> Part:
    """Return the function from states to lattice steps, or to states in the period."""
    n, p = code.plan.n, code.prefix
    places = f"{code.real} y[{n}]" if code.direct else f"{code.integer} z[{n}]"
    static = "" if code.arithmetic == "lattice" else "static "
    opening = f"{static}{p}_status {p}_quantise(const {p}_reading x[{n}], {places})"
    return counts_quantiser(code, opening) if code.axes else state_quantiser(code, opening)


def _decide(code: Code) -> str:
    plan, p, upper = code.plan, code.prefix, code.prefix.upper()
    if plan.nearest:
        known = f"*status != {upper}_NOT_FINITE"
    else:
        known = f"*status == {upper}_OK"
    gap = ""
    if plan.policy.gaps:
        safe = "" if plan.safe == plan.gap else f"            symbol = {plan.safe};\n"
        gap = f"        if (symbol == {plan.gap}) {{\n{safe}"
        gap += f"            *status = {upper}_OUTSIDE;\n        }}\n"
    passed = "in_force, " * (code.memory is not None)
    return f"""
{code.decision}
{{
    {code.real if code.direct else code.integer} places[{plan.n}];
    int16_t symbol = {plan.safe};
    *status = {p}_quantise(x, places);
    if ({known}) {{
        symbol = {p}_symbol({passed}places);
{gap}    }}
    return symbol;
}}
"""
