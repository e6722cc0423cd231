"""The minimum dwell time in C: a state of a few bytes between decisions."""

from __future__ import annotations

import math

from capsyn.errors import ProblemError
from capsyn.exports.c.code import Code
from capsyn.exports.c.language import Part, rows


def declarations(code: Code) -> str:
    """Return what the header says of the state and its functions, but for ``_step``.

    The dwell time is in the least whole ticks, by the rule of capsyn's closed loop.
    """
    prefix, dwell, tick = code.prefix, code.plan.dwell, code.tick
    ticks = dwell / tick - 1e-9
    if ticks > (1 << 32) - 1:
        least = dwell / ((1 << 32) - 1)
        raise ProblemError(f"`tick` must be at least {least!r} s; got {tick!r}")
    return f"""
#define {prefix.upper()}_DWELL {max(1, math.ceil(ticks))}uL /* ticks of {tick!r} s: {dwell!r} s */

/* Between decisions; the caller has one for each plant. */
typedef struct {{
    uint32_t since; /* tick of the last change */
    int16_t symbol; /* in force */
    uint8_t phase;  /* 0: none yet, 1: must hold, 2: may change */
}} {prefix}_state;

/* Forget all symbols: the next one is taken at once. */
void {prefix}_init({prefix}_state *state);

/*
 * Return the symbol in force when `symbol` is wanted at tick `now`: another control is taken only
 * when the one before was held for at least {prefix.upper()}_DWELL ticks. Ticks may wrap around to
 * 0 after 2^32 - 1; call it at least once in so many.
 */
int16_t {prefix}_hold({prefix}_state *state, int16_t symbol, uint32_t now);
"""


def functions(code: Code) -> Part:
    """Return ``_init`` and ``_hold``."""
    plan, prefix = code.plan, code.prefix
    classes = list(range(plan.labels))
    same, table, reads = "symbol == state->symbol", "", set()
    if plan.same_control:
        classes[plan.default] = min(plan.same_control[0])
        kind, integer = ("BYTE", "uint8_t") if plan.labels <= 256 else ("INT16", "int16_t")
        entries = rows([f"{k}u" if kind == "BYTE" else str(k) for k in classes])
        table = (
            f"    /* symbols of the same number have the same control */\n"
            f"    static const {integer} {prefix}_same[{plan.labels}] CAPSYN_ROM = {{\n{entries}\n"
            "    };\n"
        )
        read = f"CAPSYN_{kind}(&{prefix}_same[{{}}])"
        same = f"{read.format('symbol')} == {read.format('state->symbol')}"
        reads = {kind}
    text = f"""
void {prefix}_init({prefix}_state *state)
{{
    state->since = 0u;
    state->symbol = 0;
    state->phase = 0u;
}}

int16_t {prefix}_hold({prefix}_state *state, int16_t symbol, uint32_t now)
{{
{table}    const bool same = {same};
    if ((state->phase == 1u) && ((uint32_t)(now - state->since) >= {prefix.upper()}_DWELL)) {{
        state->phase = 2u;
    }}
    if ((state->phase == 0u) || ((state->phase == 2u) && (!same))) {{
        state->symbol = symbol;
        state->since = now;
        state->phase = 1u;
    }} else if (same) {{
        state->symbol = symbol;
    }} else {{
        /* the one before is held */
    }}
    return state->symbol;
}}
"""
    return Part(text, frozenset(reads))
