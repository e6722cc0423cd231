"""The minimum dwell time in C: a state of a few bytes between decisions."""

from __future__ import annotations

import math

from capsyn.errors import ProblemError
from capsyn.exports.c.code import Code
from capsyn.exports.c.language import Part, comment, rows, with_called
from capsyn.exports.plan import NOT_FINITE, OUTSIDE


def declarations(code: Code) -> str:
    """Return what the header says of the state and its functions, but for ``_step``.

    The dwell time is in the least whole ticks, by the rule of capsyn's closed loop.
    """
    prefix, plan, tick = code.prefix, code.plan, code.tick
    dwell, unit = plan.dwell_s, plan.policy.time_unit
    told = f"{dwell!r} s" if unit == "s" else f"{plan.dwell!r} {unit} = {dwell!r} s"
    ticks = dwell / tick * (1 - 1e-12)  # the quotient is rounded
    if not tick <= dwell <= tick * ((1 << 32) - 1):
        least = 10.0 ** math.ceil(math.log10(dwell / ((1 << 32) - 1)))
        raise ProblemError(
            f"`tick` must be {least:g} s or more, and at most the dwell time, {told}; got {tick:g}"
        )
    take = "Take `symbol` at tick `now`, whatever is held, and return it: it is held anew, unless "
    take += "the symbol in force has the same control."
    if names := _at_once(code):
        take += f" {prefix}_step does so where the status is {' or '.join(names)}."
    return f"""
#define {prefix.upper()}_DWELL {max(1, math.ceil(ticks))}uL /* ticks of {tick!r} s: {told} */

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
 * when the one before was held for at least {prefix.upper()}_DWELL ticks. That is the whole time
 * where calls come with the ticks; of a clock that runs by itself up to a tick less. Ticks may wrap
 * around to 0 after 2^32 - 1; call it at least once in so many.
 */
int16_t {prefix}_hold({prefix}_state *state, int16_t symbol, uint32_t now);

{comment([take])}
int16_t {prefix}_take({prefix}_state *state, int16_t symbol, uint32_t now);
"""


def step(code: Code) -> str:
    """Return ``_step``, which waits for no status whose symbol is to be taken at once."""
    p, names = code.prefix, _at_once(code)
    tests = [f"*status == {name}" for name in names]
    at_once = tests[0] if len(tests) == 1 else " || ".join(f"({test})" for test in tests)
    text = f"    return {p}_hold(state, symbol, now);\n"
    if at_once:
        text = f"""\
    int16_t taken;
    if ({at_once}) {{
        taken = {p}_take(state, symbol, now);
    }} else {{
        taken = {p}_hold(state, symbol, now);
    }}
    return taken;
"""
    return f"""
int16_t {p}_step({p}_state *state, const {p}_reading x[{code.plan.n}],
    uint32_t now, {p}_status *status)
{{
    const int16_t symbol = {p}_decide(x, status);
{text}}}
"""


def _at_once(code: Code) -> list[str]:
    """Return names of the statuses that do not wait; counts are always finite."""
    names = {OUTSIDE: "OUTSIDE", NOT_FINITE: "NOT_FINITE"}
    some = [s for s in code.plan.at_once if not (code.axes and s == NOT_FINITE)]
    return [f"{code.prefix.upper()}_{names[s]}" for s in some]


def functions(code: Code) -> Part:
    """Return ``_init``, ``_hold`` and ``_take``."""
    prefix, upper = code.prefix, code.prefix.upper()
    same, reads, table = _same(code)
    text = f"""
void {prefix}_init({prefix}_state *state)
{{
    state->since = 0u;
    state->symbol = 0;
    state->phase = 0u;
}}

int16_t {prefix}_hold({prefix}_state *state, int16_t symbol, uint32_t now)
{{
    const bool same = {same};
    if ((state->phase == 1u) && ((uint32_t)(now - state->since) >= {upper}_DWELL)) {{
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

int16_t {prefix}_take({prefix}_state *state, int16_t symbol, uint32_t now)
{{
    const bool same = {same};
    if (!same) {{
        state->phase = 0u; /* nothing is held */
    }}
    return {prefix}_hold(state, symbol, now);
}}
"""
    return Part(with_called([table], text), frozenset(reads))


def _same(code: Code) -> tuple[str, set[str], str]:
    """Return the condition of no change, what it reads from tables, and its function."""
    plan, prefix = code.plan, code.prefix
    kind, integer = ("BYTE", "uint8_t") if plan.labels <= 256 else ("INT16", "int16_t")
    entries = rows([f"{k}u" if kind == "BYTE" else str(k) for k in plan.first_alike])
    function = f"""
/* Return whether two symbols have the same control: then they have the same number. */
static bool {prefix}_same(int16_t one, int16_t other)
{{
    static const {integer} {prefix}_classes[{plan.labels}] CAPSYN_ROM = {{
{entries}
    }};
    bool same = one == other;
    if ((one >= 0) && (one < {plan.labels}) && (other >= 0) && (other < {plan.labels})) {{
        same = CAPSYN_{kind}(&{prefix}_classes[one]) == CAPSYN_{kind}(&{prefix}_classes[other]);
    }}
    return same;
}}
"""
    if plan.same_control:
        return f"{prefix}_same(symbol, state->symbol)", {kind}, function
    return "symbol == state->symbol", set(), function
