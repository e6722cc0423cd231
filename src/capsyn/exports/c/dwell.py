"""The minimum dwell time in C: a state of a few bytes between decisions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from capsyn.errors import ProblemError
from capsyn.exports.c.code import Code
from capsyn.exports.c.language import Part, comment, rows, with_called
from capsyn.exports.plan import NOT_FINITE, OUTSIDE
from capsyn.modelling.time_unit import to_seconds


@dataclass(frozen=True)
class Same:
    """How it is told that between two symbols is no switch: a call by `name`; none: they differ."""

    name: str
    function: Part

    def of(self, one: str, other: str) -> str:
        """Return the condition."""
        return f"{self.name}({one}, {other})" if self.name else f"{one} == {other}"

    def differ(self, one: str, other: str) -> str:
        """Return the opposite condition."""
        return f"!{self.of(one, other)}" if self.name else f"{one} != {other}"


def declarations(code: Code) -> str:
    """Return what the header says of the state and its functions, but for ``_step``.

    The dwell time is in the least whole ticks, by the rule of capsyn's closed loop.
    """
    prefix, plan, tick = code.prefix, code.plan, code.tick
    (ticks,) = ticks_of(code, [plan.dwell], "the dwell time")
    told = _told(code, plan.dwell)
    take = "Take `symbol` at tick `now`, whatever is held, and return it: it is held anew, unless "
    take += "the symbol in force has the same control."
    if names := at_once(code):
        take += f" {prefix}_step does so where the status is {' or '.join(names)}."
    return f"""
#define {prefix.upper()}_DWELL {ticks}uL /* ticks of {tick!r} s: {told} */

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


def ticks_of(code: Code, times: Sequence[float], shortest: str) -> list[int]:
    """Return the least whole ticks of some times [time unit], 0 for none.

    Raises
    ------
    ProblemError
        The tick is longer than the `shortest` time, or too short for the longest.
    """
    unit, tick = code.plan.policy.time_unit, code.tick
    seconds = [to_seconds(time, unit) for time in times]
    some = [s for s in seconds if s > 0]
    if some and not tick <= min(some) <= max(some) <= tick * ((1 << 32) - 1):
        least = 10.0 ** math.ceil(math.log10(max(some) / ((1 << 32) - 1)))
        told = _told(code, min(time for time in times if time > 0))
        raise ProblemError(
            f"`tick` must be {least:g} s or more, and at most {shortest}, {told}; got {tick:g}"
        )
    # the quotient is rounded
    return [max(int(s > 0), math.ceil(s / tick * (1 - 1e-12))) for s in seconds]


def _told(code: Code, time: float) -> str:
    """Return a time [time unit] as text, in seconds."""
    unit = code.plan.policy.time_unit
    seconds = f"{to_seconds(time, unit)!r} s"
    return seconds if unit == "s" else f"{time!r} {unit} = {seconds}"


def step(code: Code) -> str:
    """Return ``_step``, which waits for no status whose symbol is to be taken at once."""
    p = code.prefix
    return f"""
int16_t {p}_step({p}_state *state, const {p}_reading x[{code.plan.n}],
    uint32_t now, {p}_status *status)
{{
    const int16_t symbol = {p}_decide(x, status);
{step_body(code)}}}
"""


def step_body(code: Code) -> str:
    """Return what ``_step`` does with a symbol that is wanted."""
    p, names = code.prefix, at_once(code)
    tests = [f"*status == {name}" for name in names]
    taken = tests[0] if len(tests) == 1 else " || ".join(f"({test})" for test in tests)
    text = f"    return {p}_hold(state, symbol, now);\n"
    if taken:
        text = f"""\
    int16_t taken;
    if ({taken}) {{
        taken = {p}_take(state, symbol, now);
    }} else {{
        taken = {p}_hold(state, symbol, now);
    }}
    return taken;
"""
    return text


def at_once(code: Code) -> list[str]:
    """Return names of the statuses that do not wait; counts are always finite."""
    names = {OUTSIDE: "OUTSIDE", NOT_FINITE: "NOT_FINITE"}
    some = [s for s in code.plan.at_once if not (code.axes and s == NOT_FINITE)]
    return [f"{code.prefix.upper()}_{names[s]}" for s in some]


def functions(code: Code) -> Part:
    """Return ``_init``, ``_hold`` and ``_take``."""
    prefix, upper = code.prefix, code.prefix.upper()
    same = same_symbols(code)
    wanted = same.of("symbol", "state->symbol")
    text = f"""
void {prefix}_init({prefix}_state *state)
{{
    state->since = 0u;
    state->symbol = 0;
    state->phase = 0u;
}}

int16_t {prefix}_hold({prefix}_state *state, int16_t symbol, uint32_t now)
{{
    const bool same = {wanted};
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
    const bool same = {wanted};
    if (!same) {{
        state->phase = 0u; /* nothing is held */
    }}
    return {prefix}_hold(state, symbol, now);
}}
"""
    return Part(with_called([same.function.text], text), same.function.reads)


def same_symbols(code: Code) -> Same:
    """Return how it is told that between symbols is no switch."""
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
        return Same(f"{prefix}_same", Part(function, frozenset({kind})))
    return Same("", Part(function))
