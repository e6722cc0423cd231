"""C functions of integer readings: from counts to places on an axis, and from places to steps."""

from __future__ import annotations

from capsyn.exports.c.language import search


def placed(prefix: str) -> str:
    """Return the function that brings counts within the places of an axis."""
    return f"""
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


def turned(prefix: str) -> str:
    """Return the function that brings counts into a turn."""
    return f"""
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


def masked(prefix: str) -> str:
    """Return the function that brings counts into a turn of 2^k counts."""
    return f"""
/* Return how far a count is behind the first, in its turn of 2^k counts. */
static int32_t {prefix}_masked(int32_t count, uint32_t first, uint32_t mask)
{{
    const uint32_t place = ((uint32_t)count - first) & mask;
    return (int32_t)place;
}}
"""


def line_name(wide: bool, held: bool) -> str:
    """Return what the function of a line is called, behind the prefix; see `Line`."""
    return f"{'wide' if wide else 'axis'}_{'held' if held else 'step'}"


def line_step(prefix: str, integer: str, wide: bool, held: bool) -> str:
    """Return the function of a line; see `capsyn.exports.c.readings.lines.Line`."""
    word = "uint64_t" if wide else "uint32_t"
    opening = f"static {integer} {prefix}_{line_name(wide, held)}(int32_t place, uint32_t factor,"
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


def listed(prefix: str, integer: str, kind: str) -> str:
    """Return the function that looks a count up in a list."""
    return f"""
/* Return 1 where a list holds a count, else 0. */
static {integer} {prefix}_axis_listed(int32_t count, const {kind.lower()}_t listed[],
    {integer} entries)
{{
{search(integer, "entries", f"count >= CAPSYN_{kind}(&listed[middle])")}
    return (count == CAPSYN_{kind}(&listed[low])) ? 1 : 0;
}}
"""


def table_step(prefix: str, integer: str, kind: str) -> str:
    """Return the function that finds a step in a table of changes."""
    return f"""
/* Return how many steps begin at a count or before it. */
static {integer} {prefix}_axis_rank(int32_t count, const {kind.lower()}_t begins[],
    {integer} steps)
{{
{search(integer, "steps", f"count >= CAPSYN_{kind}(&begins[middle - 1])")}
    return low;
}}
"""
