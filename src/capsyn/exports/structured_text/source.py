"""The block itself: what it declares, and what it decides at a call."""

from __future__ import annotations

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, with_unit
from capsyn.exports.structured_text.block import Block
from capsyn.exports.structured_text.cells import PLACES, cell_arrays, cell_numbers, cell_walk
from capsyn.exports.structured_text.cuts import listed
from capsyn.exports.structured_text.functions import called
from capsyn.exports.structured_text.hold import hold
from capsyn.exports.structured_text.lines import comment, condition, indented
from capsyn.exports.structured_text.pou import SHORT, Pou, Variable, element, table
from capsyn.exports.structured_text.steps import bounds, copied, states, steps, tables
from capsyn.exports.text import WIDTH, broken


def block_unit(block: Block, siemens: bool) -> Pou:
    """Return the function block."""
    about = tuple(listed(block)) if block.table and isinstance(block.tree, SplitTree) else ()
    return Pou(
        block.name,
        "",
        about,
        tuple(_inputs(block)),
        tuple(_outputs(block)),
        tuple(_inner(block)),
        tuple(_body(block, siemens)),
    )


def notes(block: Block) -> tuple[str, ...]:
    """Return what a user must be told."""
    arrays = [*tables(block).values(), *(_arrays(block).values() if block.table else ())]
    wide = [array.name for array in arrays if array.kind == "DINT"]
    lines = [f"tables of 32-bit numbers (DINT): {', '.join(wide)}"] if wide else []
    for i, axis in enumerate(block.axes):
        if axis.missed:
            name = block.plan.policy.domain.names[i]
            steps_of = len(axis.changes) + 1
            lines.append(
                f"counts are coarse: {axis.missed} of {steps_of} steps of '{name}' never occur"
            )
    return tuple(lines)


def _inputs(block: Block) -> list[Variable]:
    plan, domain, made = block.plan, block.plan.policy.domain, []
    for i, reading in enumerate(block.readings):
        about = with_unit(domain.names[i], domain.units[i])
        if block.raw[i] or block.axes:
            scale, offset = float(plan.scale[i]), float(plan.offset[i])
            about = f"reading of {about} = reading * {scale!r} + {offset!r}"
        made.append(Variable(reading, block.reading, about))
    if plan.dwell > 0:
        made.append(Variable("cycle", "TIME", "time since the call before"))
    return made


def _outputs(block: Block) -> list[Variable]:
    plan, alphabet = block.plan, block.plan.policy.alphabet
    lost = "" if block.axes else ", 2 not finite"
    controls = zip(block.controls, map(with_unit, alphabet.inputs, alphabet.units))
    return [
        Variable("symbol", "INT", f"0 to {plan.default}, see the head of the file"),
        Variable("status", "INT", f"0 in the domain, 1 outside{lost}"),
        *(Variable(name, block.real, about) for name, about in controls),
    ]


def _inner(block: Block) -> list[Variable]:
    kind = "DINT" if block.axes else block.real
    made = [Variable(block.states[i], kind) for i in copied(block)]
    if block.table:
        made += _arrays(block).values()
    looked_up = tables(block)
    made += looked_up.values()
    whole = ["first", "last", "middle"] if looked_up else []
    if block.table:
        made.append(Variable("z", "DINT", size=block.plan.n))
        if isinstance(block.tree, CellTree):
            made += (Variable(name, "DINT", size=block.plan.n) for name in PLACES)
            whole += cell_numbers(block.tree)
        else:
            whole += ["node", "axis", "value", *["i"] * block.tree.has_planes]
    else:
        whole += [block.steps[i] for i in block.used]
    made += [Variable(name, "DINT") for name in dict.fromkeys(whole)]
    made.append(Variable("wanted", "INT"))
    if block.plan.dwell > 0:
        made.append(Variable("started", "BOOL", "whether there was a call", "FALSE"))
        made.append(Variable("rest", "TIME", "time until another control may be taken", "T#0ms"))
    return made


def _arrays(block: Block) -> dict[str, Variable]:
    tree = block.tree
    if isinstance(tree, CellTree):
        return {name: table(name, values) for name, values in cell_arrays(tree).items()}
    arrays = {"splits": tree.split, "thresholds": tree.threshold, "seconds": tree.second}
    if tree.has_planes:
        arrays["planes"] = tree.planes.ravel()
    return {name: table(name, values) for name, values in arrays.items()}


def _body(block: Block, siemens: bool) -> list[str]:
    plan = block.plan
    lines = states(block)
    if block.axes:
        lines += _known(block)
    else:
        finite = [f"(({state} - {state}) = 0.0)" for state in block.states]
        lines += comment(
            ["x - x is 0 of finite x, not of NaN or infinity: compile without fast mathematics."]
        )
        lines += condition("IF NOT (", finite, ") THEN")
        lines += [f"    status := {NOT_FINITE};", f"    wanted := {plan.safe};", "ELSE"]
        lines += [*indented(_known(block)), "END_IF;"]
    lines += hold(block, siemens) if plan.dwell > 0 else ["symbol := wanted;"]
    lines.append("CASE symbol OF")
    for k, row in enumerate(plan.policy.controls.tolist()):
        lines += comment([plan.symbol_names[k]], 4)
        lines.append(f"    {k}:" if k + 1 < plan.labels else "ELSE")
        lines += [f"        {u} := {block.literal(v)};" for u, v in zip(block.controls, row)]
    return [*lines, "END_CASE;"]


def _known(block: Block) -> list[str]:
    """Return what decides of a state that is finite."""
    plan, within = block.plan, bounds(block)
    lines = [f"status := {OK};"]
    if within:
        lines += condition("IF NOT (", within, ") THEN")
        lines += [f"    status := {OUTSIDE};", "END_IF;"]
    if plan.nearest or not within:
        return lines + _decision(block)
    lines += [f"IF status = {OK} THEN", *indented(_decision(block))]
    return [*lines, "ELSE", f"    wanted := {plan.safe};", "END_IF;"]


def _decision(block: Block) -> list[str]:
    plan, tree, lines = block.plan, block.tree, steps(block)
    if isinstance(tree, CellTree):
        lines += cell_walk(tree, _arrays(block))
    elif not block.used:
        lines.append(f"wanted := {tree.threshold[0]};")
    elif block.table:
        lines += _walk(tree, _arrays(block))
    else:
        lines += broken(f"wanted := {called(block, block.calls['tree'])};", WIDTH - 8)
    if plan.policy.gaps:  # the label of gaps becomes the safe symbol, and the state outside
        lines += [f"IF wanted = {plan.gap} THEN", f"    wanted := {plan.safe};"]
        lines += [f"    status := {OUTSIDE};", "END_IF;"]
    return lines


def _walk(tree: SplitTree, arrays: dict[str, Variable]) -> list[str]:
    """Return the loop through the tree as arrays."""
    axis = f"axis := {element(arrays['splits'], 'node')};"
    thresholds = arrays["thresholds"]
    lines = ["node := 0;", axis, "WHILE axis >= 0 DO"]
    if tree.has_planes:
        n, row = tree.n, f"(axis - {tree.n}) * {tree.n} + i"
        lines += [f"    IF axis < {n} THEN", "        value := z[axis];", "    ELSE"]
        lines += ["        value := 0;", f"        FOR i := 0 TO {n - 1} DO"]
        lines.append(f"            value := value + {element(arrays['planes'], row)} * z[i];")
        lines += ["        END_FOR;", "    END_IF;"]
    else:
        lines.append("    value := z[axis];")
    lines.append(f"    IF value >= {element(thresholds, 'node')} THEN")
    lines += [f"        node := {element(arrays['seconds'], 'node')};", "    ELSE"]
    lines += ["        node := node + 1;", "    END_IF;", f"    {axis}", "END_WHILE;"]
    label = "thresholds[node]"
    wide = int(np.abs(tree.threshold).max()) > SHORT
    return [*lines, f"wanted := {f'DINT_TO_INT({label})' if wide else label};"]
