"""The quantiser of integer readings in C: from counts to places on an axis, and on to steps."""

from __future__ import annotations

import numpy as np

from capsyn.exports.c.code import Code
from capsyn.exports.c.language import Part, rows, search, with_called
from capsyn.exports.c.readings.counts import CountAxis, limit_of

MOST_IN_LINE = 70
"""Characters of a function's name and arguments that stay in one line."""
_FORMS = ((False, False), (False, True), (True, False), (True, True))
"""Lines by whether their sums are wide and their ends held, in the order of their functions."""


def counts_quantiser(code: Code, opening: str) -> Part:
    """Return the function ``opening(x, z)``, x being counts, with what it needs."""
    prefix, integer, axes = code.prefix, code.integer, code.axes
    limit = limit_of(code.readings)
    tables = {name: table for i, axis in enumerate(axes) for name, table in _tables(i, axis)}
    wide = any(not -(1 << 15) <= entry < 1 << 15 for table in tables.values() for entry in table)
    kind = "INT32" if wide else "INT16"
    functions = _to_places(prefix)
    functions += [_line_step(prefix, integer, *form) for form in _FORMS]
    functions += [_listed(prefix, integer, kind), _table_step(prefix, integer, kind)]
    declared, body = [], []
    for name, entries in tables.items():
        declared.append(
            f"    static const {kind.lower()}_t {name}[{len(entries)}] CAPSYN_ROM = {{\n"
            f"{rows(list(map(_literal, entries)))}\n    }};"
        )
    for i, axis in enumerate(axes):
        around = "-1 - " if axis.falling else ""
        declared.append(f"    const int32_t r{i} = {around}(int32_t)x[{i}];")
        least, most = axis.inside
        beyond = [f"(r{i} < {_literal(least)})"] * (least > -limit)
        beyond += [f"(r{i} > {_literal(most)})"] * (most < limit - 1)
        if beyond and not axis.turn:
            body.append(f"    if ({' || '.join(beyond)}) {{")
            body += [f"        status = {prefix.upper()}_OUTSIDE;", "    }"]
        place = _place_of(prefix, i, axis)
        if axis.line and axis.line.listed:  # asked more than once
            declared.append(f"    const int32_t p{i} = {place};")
            place = f"p{i}"
        step = _step(prefix, i, axis, place, integer)
        if step == "0":
            declared[-1] += f"\n    (void)r{i};" if axis.turn or not beyond else ""
        body.append(f"    z[{i}] = {step};")
    declared.append(f"    {prefix}_status status = {prefix.upper()}_OK;")
    function = "\n".join([*declared, *body, "    return status;"])
    text = with_called(functions, f"\n{opening}\n{{\n{function}\n}}\n")
    return Part(text, frozenset([kind] if tables else []))


def _tables(i: int, axis: CountAxis) -> list[tuple[str, list[int]]]:
    if axis.line is None:
        tables = [(f"counts{i}", axis.changes)]
    else:
        tables = [(f"less{i}", np.array(axis.line.less)), (f"more{i}", np.array(axis.line.more))]
    return [(name, (places + axis.begin).tolist()) for name, places in tables if len(places)]


def _literal(value: int) -> str:
    return str(value) if value > -(1 << 31) else f"({value + 1} - 1)"


def _place_of(prefix: str, i: int, axis: CountAxis) -> str:
    if axis.turn & (axis.turn - 1):
        return f"{prefix}_turned(r{i}, {axis.first}, {axis.turn})"
    if axis.turn:
        return f"{prefix}_masked(r{i}, {axis.first}uL, {axis.turn - 1}uL)"
    if axis.line is None:
        return f"r{i}"
    return f"{prefix}_place(r{i}, {_literal(axis.first)}, {_literal(axis.first + axis.top)})"


def _step(prefix: str, i: int, axis: CountAxis, place: str, integer: str) -> str:
    line = axis.line
    if not len(axis.changes):
        return "0"
    begin = axis.begin if line or axis.turn else 0  # a table without turns is asked of counts
    count = f"{place} {'-' if begin < 0 else '+'} {abs(begin)}" if begin else place
    if line is None:
        return f"{prefix}_axis_rank({count}, counts{i}, {len(axis.changes) + 1})"
    function = f"{prefix}_{_line_name(line.wide, line.last > 0)}"
    addend = f"{line.addend}{'uLL' if line.wide else 'uL'}"
    last = f", {line.last}" if line.last else ""
    numbers = f"{line.factor}uL, {addend}, {line.shift}u{last}"
    gap = "\n        " if len(function + place + numbers) > MOST_IN_LINE else " "
    step = f"{function}({place},{gap}{numbers})"
    for sign, name, places in (("-", "less", line.less), ("+", "more", line.more)):
        if places:
            step += f"\n        {sign} {prefix}_axis_listed({count}, {name}{i}, {len(places)})"
    return f"({integer})({step})" if line.listed else step


def _to_places(prefix: str) -> list[str]:
    """Return the functions that bring counts within the places of an axis, or into a turn."""
    place = f"""
/* Return how far a count is behind the first; of counts beyond either end those at the end. */
static int32_t {prefix}_place(int32_t count, int32_t first, int32_t last)
{{
    int32_t place = 0;
    if (count >= last) {{
        place = last - first;
    }} else if (count > first) {{
        place = count - first;
    }} else {{
        /* the first */
    }}
    return place;
}}
"""
    turned = f"""
/* Return how far a count is behind the first, in its turn. */
static int32_t {prefix}_turned(int32_t count, int32_t first, int32_t turn)
{{
    int32_t place = count % turn;
    if (place < 0) {{
        place += turn;
    }}
    place -= first;
    if (place < 0) {{
        place += turn;
    }}
    return place;
}}
"""
    masked = f"""
/* Return how far a count is behind the first, in its turn of 2^k counts. */
static int32_t {prefix}_masked(int32_t count, uint32_t first, uint32_t mask)
{{
    const uint32_t place = ((uint32_t)count - first) & mask;
    return (int32_t)place;
}}
"""
    return [place, turned, masked]


def _line_name(wide: bool, held: bool) -> str:
    """Return what the function of a line is called, behind the prefix; see `Line`."""
    return f"{'wide' if wide else 'axis'}_{'held' if held else 'step'}"


def _line_step(prefix: str, integer: str, wide: bool, held: bool) -> str:
    word = "uint64_t" if wide else "uint32_t"
    opening = f"static {integer} {prefix}_{_line_name(wide, held)}(int32_t place, uint32_t factor,"
    if not held:
        return f"""
/* Return the step of a place; the numbers were made so that it is right at every count. */
{opening} {word} addend,
    uint8_t shift)
{{
    const {word} step = ((({word})place * factor) + addend) >> shift;
    return ({integer})step;
}}
"""
    return f"""
/* Return the step of a place: of the first 0, and of no place more than the last step. */
{opening} {word} addend,
    uint8_t shift, {integer} last)
{{
    {integer} step = 0;
    if (place > 0) {{
        const uint32_t behind = (uint32_t)place - 1u;
        const {word} found = ((({word})behind * factor) + addend) >> shift;
        step = (found < ({word})last) ? ({integer})found : last;
    }}
    return step;
}}
"""


def _listed(prefix: str, integer: str, kind: str) -> str:
    return f"""
/* Return 1 where a list holds a count, else 0. */
static {integer} {prefix}_axis_listed(int32_t count, const {kind.lower()}_t listed[],
    {integer} entries)
{{
{search(integer, "entries", f"count >= CAPSYN_{kind}(&listed[middle])")}
    return (count == CAPSYN_{kind}(&listed[low])) ? 1 : 0;
}}
"""


def _table_step(prefix: str, integer: str, kind: str) -> str:
    return f"""
/* Return how many steps begin at a count or before it. */
static {integer} {prefix}_axis_rank(int32_t count, const {kind.lower()}_t begins[],
    {integer} steps)
{{
{search(integer, "steps", f"count >= CAPSYN_{kind}(&begins[middle - 1])")}
    return low;
}}
"""
