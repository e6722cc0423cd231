"""The block itself: what it declares, and what it decides at a call."""

from __future__ import annotations

import textwrap

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, with_unit
from capsyn.exports.structured_text.block import TABLES, Block
from capsyn.exports.structured_text.cells import cell_arrays, cell_variables, cell_walk
from capsyn.exports.structured_text.lines import condition, declared, real
from capsyn.exports.text import WIDTH, broken

SHORT = 32767
"""Largest INT; tables with larger numbers are of DINT, which is twice the size."""
LARGEST = 1.7976931348623157e308
"""Largest finite LREAL."""


def declarations(block: Block) -> list[str]:
    """Return the head of the block with all variables."""
    plan, domain = block.plan, block.plan.policy.domain
    alphabet, raw = plan.policy.alphabet, _raw(block)
    lines = [f"FUNCTION_BLOCK {block.name}", "VAR_INPUT"]
    for i, reading in enumerate(block.readings):
        is_state = with_unit(domain.names[i], domain.units[i])
        if raw[i]:
            scale, offset = float(plan.scale[i]), float(plan.offset[i])
            is_state = f"reading of {is_state} = reading * {scale!r} + {offset!r}"
        lines += declared(f"{reading} : LREAL;", is_state)
    if plan.dwell > 0:
        lines += declared("cycle : LREAL;", "time since the call before [s]")
    lines += ["END_VAR", "VAR_OUTPUT"]
    lines += declared("symbol : INT;", f"0 to {plan.default}, see the head of the file")
    lines += declared("status : INT;", "0 in the domain, 1 outside, 2 not finite")
    for k, control in enumerate(block.controls):
        lines += declared(f"{control} : LREAL;", with_unit(alphabet.inputs[k], alphabet.units[k]))
    lines.append("END_VAR")
    if block.table:
        lines += ["VAR CONSTANT", *_tables(block), "END_VAR"]
    lines.append("VAR")
    lines += [f"    {state} : LREAL;" for state in block.states]
    if isinstance(plan.cells, CellTree):
        lines += cell_variables(plan.cells)
    elif block.table:
        lines.append(f"    z : ARRAY[0..{plan.n - 1}] OF DINT;")
        lines += [f"    {text} : DINT;" for text in ("node", "axis", "value")]
        if plan.cells.has_planes:
            lines.append("    i : DINT;")
    else:
        lines += [f"    {step} : DINT;" for step in block.steps]
    lines.append("    wanted : INT;")
    if plan.dwell > 0:
        lines += declared("started : BOOL := FALSE;", "whether there was a call")
        lines += declared("elapsed : LREAL := 0.0;", "time since the last switch [s]")
    return [*lines, "END_VAR"]


def _raw(block: Block) -> list[bool]:
    return ((block.plan.scale != 1) | (block.plan.offset != 0)).tolist()


def _arrays(block: Block) -> dict[str, np.ndarray]:
    tree = block.plan.cells
    if isinstance(tree, CellTree):
        return cell_arrays(tree)
    arrays = [tree.split, tree.threshold, tree.second]
    return dict(zip(TABLES, arrays + [tree.planes.ravel()] * bool(len(tree.planes))))


def notes(block: Block) -> tuple[str, ...]:
    """Return what a user must be told."""
    arrays = _arrays(block) if block.table else {}
    wide = [name for name, values in arrays.items() if _wide(values)]
    return (f"tables of 32-bit numbers (DINT): {', '.join(wide)}",) if wide else ()


def _tables(block: Block) -> list[str]:
    lines = []
    for name, values in _arrays(block).items():
        wide = _wide(values)
        kind = "DINT" if wide else "INT"
        if wide:
            lines.append("    (* numbers beyond 16 bits *)")
        lines.append(f"    {name} : ARRAY[0..{len(values) - 1}] OF {kind} := [")
        text = ", ".join(map(str, values.tolist()))
        lines += textwrap.wrap(text, WIDTH - 8, initial_indent=" " * 8, subsequent_indent=" " * 8)
        lines[-1] += "];"
    return lines


def body(block: Block) -> list[str]:
    """Return the statements of the block."""
    plan, domain, lines = block.plan, block.plan.policy.domain, []
    for i, (state, reading) in enumerate(zip(block.states, block.readings)):
        lines.append(f"{state} := {reading};")
        if _raw(block)[i]:
            lines.append(f"{state} := {state} * ({real(plan.scale[i])});")
            lines.append(f"{state} := {state} + ({real(plan.offset[i])});")
    bounds = [
        f"({state} >= {real(domain.lower[i])}) AND ({state} <= {real(domain.upper[i])})"
        for i, state in enumerate(block.states)
        if not domain.periodic[i]
    ]
    limit = real(LARGEST)
    finite = [f"({state} >= -{limit}) AND ({state} <= {limit})" for state in block.states]
    lines += ["(* a comparison with NaN is false *)"]
    lines += condition("IF NOT (", finite, ") THEN")
    lines += [f"    status := {NOT_FINITE};", f"    wanted := {plan.safe};", "ELSE"]
    lines.append(f"    status := {OK};")
    if bounds:
        lines += condition("    IF NOT (", bounds, ") THEN")
        lines += [f"        status := {OUTSIDE};", "    END_IF;"]
    if plan.nearest or not bounds:
        lines += ["    " + line for line in _decision(block)]
    else:
        lines += [f"    IF status = {OK} THEN"]
        lines += ["        " + line for line in _decision(block)]
        lines += ["    ELSE", f"        wanted := {plan.safe};", "    END_IF;"]
    lines.append("END_IF;")
    lines += _dwelling(block) if plan.dwell > 0 else ["symbol := wanted;"]
    lines.append("CASE symbol OF")
    for k, row in enumerate(plan.policy.controls.tolist()):
        lines.append(f"    {k}:" if k + 1 < plan.labels else "ELSE")
        lines += [f"        {u} := {real(v)};" for u, v in zip(block.controls, row)]
    return [*lines, "END_CASE;"]


def _decision(block: Block) -> list[str]:
    domain, tree, lines = block.plan.policy.domain, block.plan.cells, []
    for i, (state, count) in enumerate(zip(block.states, tree.counts)):
        box = f"low := {real(domain.lower[i])}, high := {real(domain.upper[i])}"
        if domain.periodic[i]:
            lines.append(f"{state} := {block.calls['wrap']}(x := {state}, {box});")
        step = f"z[{i}]" if block.table else block.steps[i]
        lines.append(f"{step} := {block.calls['step']}(x := {state}, {box}, count := {count});")
    lines = [part for line in lines for part in broken(line, WIDTH - 8)]
    if not block.table:
        call = f"wanted := {block.calls['tree']}({', '.join(block.steps)});"
        return [*lines, *broken(call, WIDTH - 8), *_gap(block)]
    if isinstance(tree, CellTree):
        return [*lines, *cell_walk(tree), *_gap(block)]
    lines += ["node := 0;", "axis := splits[0];", "WHILE axis >= 0 DO"]
    if len(tree.planes):
        lines += [f"    IF axis < {tree.n} THEN", "        value := z[axis];", "    ELSE"]
        lines += ["        value := 0;", f"        FOR i := 0 TO {tree.n - 1} DO"]
        lines.append(
            f"            value := value + planes[(axis - {tree.n}) * {tree.n} + i] * z[i];"
        )
        lines += ["        END_FOR;", "    END_IF;"]
    else:
        lines.append("    value := z[axis];")
    lines += ["    IF value >= thresholds[node] THEN", "        node := seconds[node];"]
    lines += ["    ELSE", "        node := node + 1;", "    END_IF;"]
    wide = tree.threshold.max() > SHORT
    label = "DINT_TO_INT(thresholds[node])" if wide else "thresholds[node]"
    lines += ["    axis := splits[node];", "END_WHILE;", f"wanted := {label};"]
    return lines + _gap(block)


def _gap(block: Block) -> list[str]:
    """Return what makes the label of gaps the safe symbol, and the state outside."""
    if not block.plan.policy.gaps:
        return []
    test = f"IF wanted = {block.plan.gap} THEN"
    outside = [f"    wanted := {block.plan.safe};", f"    status := {OUTSIDE};"]
    return [test, *outside, "END_IF;"]


def _dwelling(block: Block) -> list[str]:
    """Return the rule of the closed loop for the minimum dwell time."""
    plan = block.plan
    lines = [
        f"(* A control is held for {plan.dwell!r} s at least, rounded up to whole calls, *)",
        "(* whatever the status; a millionth of a call is forgiven for rounding. *)",
        "IF NOT started THEN",
        "    started := TRUE;",
        "    elapsed := 0.0;",
        "    symbol := wanted;",
        "ELSE",
        "    IF cycle > 0.0 THEN",
        "        elapsed := elapsed + cycle;",
        "    END_IF;",
    ]
    if plan.same_control:
        pairs = (f"((wanted = {k}) AND (symbol = {j}))" for k, j in plan.same_control)
        lines += condition("    IF", pairs, "THEN", "OR")
        lines += ["        symbol := wanted;", "    END_IF;"]
    limit = f"{real(plan.dwell)} - 1.0E-6 * cycle"
    lines.append(f"    IF (wanted <> symbol) AND (elapsed >= {limit}) THEN")
    return [
        *lines,
        "        symbol := wanted;",
        "        elapsed := 0.0;",
        "    END_IF;",
        "END_IF;",
    ]


def _wide(values: np.ndarray) -> bool:
    return bool(np.abs(values.astype(np.int64)).max() > SHORT)
