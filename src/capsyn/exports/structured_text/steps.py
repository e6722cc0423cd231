"""From readings to states or counts in a period, and on to lattice steps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from capsyn.exports.c.language import round_up
from capsyn.exports.c.readings.counts import limit_of
from capsyn.exports.structured_text.block import Block
from capsyn.exports.structured_text.lines import indented
from capsyn.exports.structured_text.pou import Variable, element, table
from capsyn.exports.text import WIDTH, broken


def tables(block: Block) -> dict[int, Variable]:
    """Return the tables of faces in which steps are looked up, by axes."""
    if block.numbers is None:
        return {}
    domain, counts = block.plan.policy.space, block.plan.counts
    made = {}
    for i in block.used:
        numbers, name = block.numbers[i], f"faces{i}"
        if block.axes:
            axis = block.axes[i]
            made[i] = table(name, axis.changes[numbers - 1] + (0 if axis.turn else axis.first))
        else:
            faces = round_up(domain.faces(i, numbers, counts[i]))
            values = tuple(block.literal(face) for face in faces)
            made[i] = Variable(name, "REAL", size=len(faces), values=values)
    return made


def copied(block: Block) -> list[int]:
    """Return the axes whose states are variables of their own."""
    needed = set(range(block.plan.n))
    if block.axes:  # counts are always finite
        needed = {i for i in needed if i in block.used or _beyond(block, i)}
    return sorted(i for i in needed if block.states[i] != block.readings[i])


def states(block: Block) -> list[str]:
    """Return what makes states, or counts that rise with the state, of readings."""
    lines = []
    for i in copied(block):
        state, reading = block.states[i], block.readings[i]
        if block.axes:
            count = f"INT_TO_DINT({reading})" if block.reading == "INT" else reading
            falling = "-1 - " if block.axes[i].falling else ""
            lines.append(f"{state} := {falling}{count};")
        elif block.raw[i]:
            scale, offset = block.literal(block.plan.scale[i]), block.literal(block.plan.offset[i])
            lines.append(f"{state} := {reading} * ({scale}) + 0.0;")  # rounded: not fused
            lines.append(f"{state} := {state} + ({offset});")
        else:
            lines.append(f"{state} := {reading};")
    return lines


def bounds(block: Block) -> list[str]:
    """Return the conditions that states in the domain meet, but for those that all do."""
    domain, found = block.plan.policy.space, []
    for i, state in enumerate(block.states):
        if block.axes:
            found += _beyond(block, i)
        elif not domain.periodic[i]:
            lower, upper = float(domain.lower[i]), float(domain.upper[i])
            if block.real == "REAL":
                lower, upper = round_up(domain.lower)[i], -round_up(-domain.upper)[i]
            parts = f"{state} >= {block.literal(lower)}", f"{state} <= {block.literal(upper)}"
            found.append(f"({parts[0]}) AND ({parts[1]})")
    return found


def _beyond(block: Block, i: int) -> list[str]:
    """Return the bounds of counts on an axis."""
    axis, state, limit = block.axes[i], block.states[i], limit_of(block.reading)
    if axis.turn:
        return []
    least, most = axis.inside
    lower = [f"({state} >= {least})"] * (least > -limit)
    return lower + [f"({state} <= {most})"] * (most < limit - 1)


def steps(block: Block) -> list[str]:
    """Return what finds the steps of states in the domain, or of the nearest."""
    looked_up, lines = tables(block), []
    for i in block.used:
        step = f"z[{i}]" if block.table else block.steps[i]
        if i in block.wraps:
            box = _box(block, i)
            lines += _cut(
                f"{block.states[i]} := {block.calls['wrap']}(x := {block.states[i]}, {box});"
            )
        if block.axes and block.axes[i].turn:
            lines += _in_turn(block.states[i], block.axes[i].first, block.axes[i].turn)
        if i in looked_up:
            lines += _search(looked_up[i], block.states[i], step)
        else:
            count, call = block.tree.counts[i], block.calls["step"]
            box = f"x := {block.states[i]}, {_box(block, i)}, count := {count}"
            lines += _cut(f"{step} := {call}({box});")
    return lines


def _box(block: Block, i: int) -> str:
    domain = block.plan.policy.space
    ends = np.array([domain.lower[i], domain.upper[i]])
    lower, upper = round_up(ends) if block.real == "REAL" else ends
    return f"lower := {block.literal(lower)}, upper := {block.literal(upper)}"


def _cut(line: str) -> list[str]:
    """Return a call, in lines that are cut between its arguments."""
    whole = broken(line.replace(" := ", "\xa0:=\xa0"), WIDTH - 8)
    return [part.replace("\xa0", " ") for part in whole]


def _in_turn(state: str, first: int, turn: int) -> Iterator[str]:
    """Yield what makes a count the place behind the first, in its turn."""
    yield f"{state} := {state} MOD {turn};"
    below = [f"IF {state} < 0 THEN", *indented([f"{state} := {state} + {turn};"]), "END_IF;"]
    yield from below
    if first:
        yield f"{state} := {state} - {first};"
        yield from below


def _search(faces: Variable, state: str, step: str) -> list[str]:
    """Return what counts the faces that a state has reached."""
    return [
        "first := 0;",
        f"last := {faces.size};",
        "WHILE first < last DO",
        "    middle := last - (last - first) / 2;",
        f"    IF {element(faces, 'middle - 1')} <= {state} THEN",
        "        first := middle;",
        "    ELSE",
        "        last := middle - 1;",
        "    END_IF;",
        "END_WHILE;",
        f"{step} := first;",
    ]
