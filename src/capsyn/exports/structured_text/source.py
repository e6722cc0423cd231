"""The block itself: what it declares, and what it decides at a call."""

from __future__ import annotations

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE
from capsyn.exports.structured_text.block import Block
from capsyn.exports.structured_text.cells import PLACES, cell_arrays, cell_numbers, cell_walk
from capsyn.exports.structured_text.cuts import listed
from capsyn.exports.structured_text.functions import called
from capsyn.exports.structured_text.hold import hold, waiting
from capsyn.exports.structured_text.lines import comment, condition, indented
from capsyn.exports.structured_text.memory import followed, row_table
from capsyn.exports.structured_text.pou import SHORT, Pou, Variable, element, table
from capsyn.exports.structured_text.steps import bounds, copied, states, steps, tables
from capsyn.exports.text import WIDTH, broken, kind, spoken, with_unit


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


def next_units(block: Block) -> list[Pou]:
    """Return what gives the symbol that follows one in force, where the block remembers.

    A function; where there are tables, or prices, which no function of edition 2 has, a function
    block, which keeps nothing from call to call.
    """
    plan = block.plan
    if not plan.has_state:
        return []
    name, now = block.calls["next"], "now" if plan.policy.remembers else ""
    inputs = [Variable("in_force", "INT", f"symbol in force; at first the default, {plan.default}")]
    inputs += _readings(block)
    inner, body = _walked(block), []
    if now:
        inner.append(Variable("now", "INT"))
        body = ["now := in_force;", f"IF (now < 0) OR (now > {plan.default}) THEN"]
        body += [f"    now := {plan.default};", "END_IF;"]
    told = "The symbol that follows one in force at a state; nothing is kept from call to call."
    about = (spoken(plan.policy, told),)
    is_block = block.table or bool(tables(block))
    if is_block:
        outputs, result = _told(block), ""
        body += [*_decided(block, now), "symbol := wanted;"]
        inner.append(Variable("wanted", "INT"))
    else:
        outputs, result = [], "INT"
        tells = not plan.nearest and bool(bounds(block))
        inner += [Variable("status", "INT")] * tells + [Variable("wanted", "INT")]
        body += [*_decided(block, now, tells), f"{name} := wanted;"]
    return [Pou(name, result, about, tuple(inputs), tuple(outputs), tuple(inner), tuple(body))]


def notes(block: Block) -> tuple[str, ...]:
    """Return what a user must be told."""
    arrays = [*tables(block).values(), *(_arrays(block).values() if block.table else ())]
    wide = [array.name for array in arrays if array.kind == "DINT"]
    lines = [f"tables of 32-bit numbers (DINT): {', '.join(wide)}"] if wide else []
    for i, axis in enumerate(block.axes):
        if axis.missed:
            name = block.plan.policy.space.names[i]
            steps_of = len(axis.changes) + 1
            lines.append(
                f"counts are coarse: {axis.missed} of {steps_of} steps of '{name}' never occur"
            )
    return tuple(lines)


def _inputs(block: Block) -> list[Variable]:
    made = _readings(block)
    if block.plan.waits:
        made.append(Variable("cycle", "TIME", "time since the call before"))
    return made


def _readings(block: Block) -> list[Variable]:
    plan, domain, made = block.plan, block.plan.policy.space, []
    for i, reading in enumerate(block.readings):
        about, what = with_unit(domain.names[i], domain.units[i]), kind(plan.policy, i)
        about = about if what == "state" else f"{what} {about}"
        if block.raw[i] or block.axes:
            scale, offset = float(plan.scale[i]), float(plan.offset[i])
            about = f"reading of {about} = reading * {scale!r} + {offset!r}"
        made.append(Variable(reading, block.reading, about))
    return made


def _outputs(block: Block) -> list[Variable]:
    alphabet = block.plan.policy.alphabet
    controls = zip(block.controls, map(with_unit, alphabet.inputs, alphabet.units))
    return _told(block) + [Variable(name, block.real, about) for name, about in controls]


def _told(block: Block) -> list[Variable]:
    plan, lost = block.plan, "" if block.axes else ", 2 not finite"
    start = str(plan.default) if plan.policy.remembers else ""  # in force before the first call
    return [
        Variable("symbol", "INT", f"0 to {plan.default}, see the head of the file", start),
        Variable("status", "INT", f"0 in the domain, 1 outside{lost}"),
    ]


def _inner(block: Block) -> list[Variable]:
    made = [*_walked(block), Variable("wanted", "INT")]
    return made + waiting(block.plan) if block.plan.waits else made


def _walked(block: Block) -> list[Variable]:
    """Return what the way from readings to a leaf needs."""
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
    return made + row_table(block) + [Variable(name, "DINT") for name in dict.fromkeys(whole)]


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
    lines = _decided(block, "symbol")
    lines += hold(block, siemens) if plan.waits else ["symbol := wanted;"]
    lines.append("CASE symbol OF")
    for k, row in enumerate(plan.policy.controls.tolist()):
        lines += comment([plan.symbol_names[k]], 4)
        lines.append(f"    {k}:" if k + 1 < plan.labels else "ELSE")
        lines += [f"        {u} := {block.literal(v)};" for u, v in zip(block.controls, row)]
    return [*lines, "END_CASE;"]


def _decided(block: Block, now: str, tells: bool = True) -> list[str]:
    """Return what makes ``wanted`` the symbol that follows that in force, `now`.

    `tells` is whether there is a status.
    """
    plan = block.plan
    lines, known = states(block), _known(block, now, tells)
    if block.axes:
        lines += known
    else:
        finite = [f"(({state} - {state}) = 0.0)" for state in block.states]
        lines += comment(
            ["x - x is 0 of finite x, not of NaN or infinity: compile without fast mathematics."]
        )
        lines += condition("IF NOT (", finite, ") THEN")
        lines += [f"    status := {NOT_FINITE};"] * tells + [f"    wanted := {plan.safe};", "ELSE"]
        lines += [*indented(known), "END_IF;"]
    return lines


def _known(block: Block, now: str, tells: bool) -> list[str]:
    """Return what decides of a state that is finite."""
    plan, within = block.plan, bounds(block)
    lines = [f"status := {OK};"] * tells
    if within and tells:
        lines += condition("IF NOT (", within, ") THEN")
        lines += [f"    status := {OUTSIDE};", "END_IF;"]
    if plan.nearest or not within:
        return lines + _decision(block, now, tells)
    lines += [f"IF status = {OK} THEN", *indented(_decision(block, now, tells))]
    return [*lines, "ELSE", f"    wanted := {plan.safe};", "END_IF;"]


def _decision(block: Block, now: str, tells: bool) -> list[str]:
    plan, tree, lines = block.plan, block.tree, steps(block)
    if isinstance(tree, CellTree):
        lines += cell_walk(tree, _arrays(block), now)
    elif not block.used:
        lines.append(f"wanted := {tree.threshold[0]};")
    elif block.table:
        lines += _walk(tree, _arrays(block))
    else:
        lines += broken(f"wanted := {called(block, block.calls['tree'])};", WIDTH - 8)
    lines += followed(block, now)
    if plan.policy.gaps:  # the label of gaps becomes the safe symbol, and the state outside
        lines += [f"IF wanted = {plan.gap} THEN", f"    wanted := {plan.safe};"]
        lines += [*[f"    status := {OUTSIDE};"] * tells, "END_IF;"]
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
