"""The state between decisions in C where more is remembered than one least time for all symbols.

That is the symbol in force and, where anything waits, how many ticks it and inputs have been held,
and how many the start is ago. The rule is that of capsyn's closed loop.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from capsyn.exports.c.code import Code
from capsyn.exports.c.dwell import at_once, same_symbols, step_body, ticks_of
from capsyn.exports.c.language import Part, comment, constants, place_type, with_called


@dataclass(frozen=True, eq=False)
class Timers:
    """Least times of a code [ticks]: of symbols (N + 1,), of inputs (m,), and after the start."""

    code: Code
    holds: list[int]
    inputs: list[int]
    off: int

    @staticmethod
    def of(code: Code) -> Timers:
        """Return those of a plan's rules."""
        rules, m = code.plan.policy.rules, code.plan.policy.alphabet.m
        times = [*rules.holds.tolist(), *rules.input_holds.tolist(), code.plan.hold_off]
        ticks = ticks_of(code, times, "the shortest least time")
        return Timers(code, ticks[: -1 - m], ticks[-1 - m : -1], ticks[-1])

    @property
    def forbid(self) -> bool:
        """Whether there are forbidden transitions."""
        return bool(self.code.plan.policy.rules.forbidden.any())

    @functools.cached_property
    def values(self) -> np.ndarray:
        """Numbers (N + 1, m) of the values that labels have on inputs, equal where these are."""
        columns = self.code.plan.policy.rules.controls.T
        return np.stack([np.unique(c, return_inverse=True)[1].ravel() for c in columns], axis=1)

    @property
    def counted(self) -> list[tuple[str, str]]:
        """Names of the fields that count ticks, and what of."""
        fields = [
            ("held", any(self.holds), "that the symbol has been in force"),
            ("age", self.off, "since the start"),
            (f"inputs[{len(self.inputs)}]", any(self.inputs), "that inputs have had their values"),
        ]
        return [(name, f"ticks {what}") for name, there, what in fields if there]

    def hold(self) -> tuple[str, Part]:
        """Return the least time of the symbol in force, and the function that looks it up."""
        p = self.code.prefix
        if len(set(self.holds)) == 1:
            return f"{self.holds[0]}uL", Part("")
        return f"{p}_least(state->symbol)", _looked_up(f"{p}_least", "int16_t symbol", self.holds)


def declarations(code: Code) -> str:
    """Return what the header says of the state and its functions, but for ``_step``."""
    timers, p = Timers.of(code), code.prefix
    fields, more, off = ["int16_t symbol; /* in force */"], "", ""
    if code.waits:
        counted = [f"uint32_t {name}; /* {what} */" for name, what in timers.counted]
        last = "uint32_t last; /* tick of the last call */"
        fields = [last, *counted, *fields, "uint8_t started; /* 0: no symbol yet */"]
        more = f"""
{comment(_told(timers))}
int16_t {p}_hold({p}_state *state, int16_t symbol, uint32_t now);

{comment([_told_of_take(code)])}
int16_t {p}_take({p}_state *state, int16_t symbol, uint32_t now);
"""
    if timers.off:
        off = " Until then the safe symbol is in force."
    lines = "".join(f"    {field}\n" for field in fields)
    return f"""
/* Between decisions; the caller has one for each plant. */
typedef struct {{
{lines}}} {p}_state;

/* Forget all symbols: the next one is taken at once.{off} */
void {p}_init({p}_state *state);
{more}"""


def _told(timers: Timers) -> list[str]:
    """Return what the header says of ``_hold``, as lines."""
    code, plan = timers.code, timers.code.plan
    text = "Return the symbol in force when `symbol` is wanted at tick `now`; of a number that is "
    text += f"no symbol, when symbol {plan.safe} is."
    if any(timers.holds):
        text += " A symbol is held for its least time once it is entered."
    if timers.forbid:
        text += " It stays where the one that is wanted must not follow it."
    if any(timers.inputs):
        text += " Inputs that are yet held keep their values and the others take theirs, if there "
        text += "is such a symbol; else the symbol in force stays."
    lines = [text]
    names = [*plan.symbol_names, *plan.policy.alphabet.inputs]
    pairs = zip(names, [*timers.holds, *timers.inputs])
    if held := ", ".join(f"{name} {ticks}" for name, ticks in pairs if ticks):
        lines.append(f"Least times in ticks of {code.tick!r} s: {held}.")
    if timers.off:
        lines.append(
            f"For {timers.off} ticks of {code.tick!r} s from the first call on, symbol {plan.safe} "
            "is in force, whatever is wanted."
        )
    lines.append(
        "These are whole times where calls come with the ticks; of a clock that runs by itself up "
        "to a tick less. Ticks may wrap around to 0 after 2^32 - 1; call it at least once in so "
        "many."
    )
    return lines


def _told_of_take(code: Code) -> str:
    take = "Take `symbol` at tick `now`, whatever is held, and return it: it is held anew, unless "
    take += "between it and the symbol in force is no switch."
    if names := at_once(code):
        take += f" {code.prefix}_step does so where the status is {' or '.join(names)}."
    return take


def step(code: Code) -> str:
    """Return ``_step``, which waits for no status whose symbol is to be taken at once."""
    p = code.prefix
    asked = f"{p}_{code.asked}({'state->symbol, ' * (code.memory is not None)}x, status)"
    body = f"    state->symbol = {asked};\n    return state->symbol;\n"
    if code.waits:
        body = f"    const int16_t symbol = {asked};\n{step_body(code)}"
    return f"""
{step_opening(code)}
{{
{body}}}
"""


def step_opening(code: Code) -> str:
    """Return how ``_step`` is declared."""
    p, now = code.prefix, "uint32_t now, " * code.waits
    opening = f"int16_t {p}_step({p}_state *state, const {p}_reading x[{code.plan.n}],"
    return f"{opening}\n    {now}{p}_status *status)"


def functions(code: Code) -> Part:
    """Return ``_init`` and, where anything is held, ``_take`` and ``_hold``."""
    timers, p = Timers.of(code), code.prefix
    if not code.waits:
        return Part(_init(timers))
    same = same_symbols(code)
    body = f"""{_init(timers)}
int16_t {p}_take({p}_state *state, int16_t symbol, uint32_t now)
{{
    return {p}_enter(state, {p}_wanted(state, symbol, now));
}}

int16_t {p}_hold({p}_state *state, int16_t symbol, uint32_t now)
{{
    const int16_t wanted = {p}_wanted(state, symbol, now);
    int16_t taken = wanted;
    if ((state->started != 0u) && ({same.differ("wanted", "state->symbol")})) {{
{_permitted(timers)}    }}
    return {p}_enter(state, taken);
}}
"""
    callees = [_value(timers), _forbids(timers), same.function, timers.hold()[1]]
    if any(timers.inputs):
        callees.append(_looked_up(f"{p}_input_least", "uint16_t input", timers.inputs))
    callees += [_fits(timers), _mixed(timers), _longer(timers), _wanted(timers), _enter(timers)]
    reads = frozenset[str]()
    for part in reversed([callee for callee in callees if callee.text]):
        longer = with_called([part.text], body)
        reads, body = reads | (part.reads if longer != body else frozenset()), longer
    return Part(body, reads)


def _looked_up(name: str, argument: str, ticks: list[int]) -> Part:
    """Return a function that looks a least time up."""
    index = argument.split()[1]
    return Part(
        f"""
/* Return a least time. */
static uint32_t {name}({argument})
{{
{constants(f"{name}_times", "uint32_t", ticks)}\
    return CAPSYN_UINT32(&{name}_times[{index}]);
}}
""",
        frozenset({"UINT32"}),
    )


def _permitted(timers: Timers) -> str:
    """Return the statements that take what may follow the symbol in force, another being wanted."""
    p = timers.code.prefix
    stays = [f"state->held < {timers.hold()[0]}"] * any(timers.holds)
    stays += [f"{p}_forbids(state->symbol, wanted)"] * timers.forbid
    mixed = f"taken = {p}_mixed(state, wanted);"
    if not stays:
        return f"        {mixed}\n" if any(timers.inputs) else "        /* the start is over */\n"
    stay = stays[0] if len(stays) == 1 else f"({stays[0]}) || {stays[1]}"
    otherwise = f" else {{\n            {mixed}\n        }}" if any(timers.inputs) else ""
    return f"        if ({stay}) {{\n            taken = state->symbol;\n        }}{otherwise}\n"


def _init(timers: Timers) -> str:
    code, p = timers.code, timers.code.prefix
    lines = [f"state->{name} = 0u;" for name, _ in timers.counted if "[" not in name]
    if code.waits:
        lines = ["state->last = 0u;", *lines, "state->started = 0u;"]
    lines.append(f"state->symbol = {code.plan.safe if timers.off else code.plan.default};")
    body = "".join(f"    {line}\n" for line in lines)
    index, loop = _each_input(timers, ["state->inputs[i] = 0u;"])
    return f"\nvoid {p}_init({p}_state *state)\n{{\n{index}{body}{loop}}}\n"


def _each_input(timers: Timers, lines: list[str]) -> tuple[str, str]:
    """Return the declaration and the loop that do lines for each input; nothing without holds."""
    if not any(timers.inputs):
        return "", ""
    body = "".join(f"        {line}\n" for line in lines)
    loop = f"    for (i = 0u; i < {len(timers.inputs)}u; ++i) {{\n{body}    }}\n"
    return "    uint16_t i;\n", loop


def _longer(timers: Timers) -> Part:
    return Part(f"""
/* Return ticks and those that have passed since, at most 2^32 - 1. */
static uint32_t {timers.code.prefix}_longer(uint32_t ticks, uint32_t passed)
{{
    const uint32_t most = UINT32_MAX;
    uint32_t longer = most;
    if (passed < (most - ticks)) {{
        longer = ticks + passed;
    }}
    return longer;
}}
""")


def _wanted(timers: Timers) -> Part:
    code, p = timers.code, timers.code.prefix
    names = [name for name, _ in timers.counted if "[" not in name]
    counted = "".join(f"    state->{name} = {p}_longer(state->{name}, passed);\n" for name in names)
    index, loop = _each_input(timers, [f"state->inputs[i] = {p}_longer(state->inputs[i], passed);"])
    off = f" && (state->age >= {timers.off}uL)" if timers.off else ""
    return Part(f"""
/* Let the time pass, and return the symbol that is wanted then. */
static int16_t {p}_wanted({p}_state *state, int16_t symbol, uint32_t now)
{{
    const uint32_t passed = (state->started != 0u) ? (uint32_t)(now - state->last) : 0u;
    int16_t wanted = {code.plan.safe};
{index}    state->last = now;
{counted}{loop}    if ((symbol >= 0) && (symbol < {code.plan.labels}){off}) {{
        wanted = symbol;
    }}
    return wanted;
}}
""")


def _enter(timers: Timers) -> Part:
    code, p, lines = timers.code, timers.code.prefix, ""
    if any(timers.holds):
        differ = same_symbols(code).differ("symbol", "state->symbol")
        lines = f"""\
    if ((state->started == 0u) || ({differ})) {{
        state->held = 0u;
    }}
"""
    changed = [
        "if ((state->started == 0u)",
        f"    || ({p}_value(symbol, i) != {p}_value(state->symbol, i))) {{",
        "    state->inputs[i] = 0u;",
        "}",
    ]
    index, loop = _each_input(timers, changed)
    return Part(f"""
/* Put a symbol in force, and return it. */
static int16_t {p}_enter({p}_state *state, int16_t symbol)
{{
{index}{lines}{loop}    state->symbol = symbol;
    state->started = 1u;
    return symbol;
}}
""")


def _fits(timers: Timers) -> Part:
    p = timers.code.prefix
    lines = [
        f"const bool held = state->inputs[i] < {p}_input_least(i);",
        "const int16_t source = held ? state->symbol : wanted;",
        f"if ({p}_value(symbol, i) != {p}_value(source, i)) {{",
        "    fits = false;",
        "}",
    ]
    index, loop = _each_input(timers, lines)
    return Part(f"""
/* Return whether a symbol has the values of inputs that are held, and of others those wanted. */
static bool {p}_fits(const {p}_state *state, int16_t wanted, int16_t symbol)
{{
    bool fits = true;
{index}{loop}    return fits;
}}
""")


def _mixed(timers: Timers) -> Part:
    p = timers.code.prefix
    allowed = f"(!{p}_forbids(state->symbol, other)) && " * timers.forbid
    return Part(f"""
/* Return the symbol that is wanted where inputs are held, or the symbol in force. */
static int16_t {p}_mixed(const {p}_state *state, int16_t wanted)
{{
    const bool whole = {p}_fits(state, wanted, wanted);
    bool found = whole || {p}_fits(state, wanted, state->symbol);
    int16_t taken = whole ? wanted : state->symbol;
    int16_t other;
    for (other = 0; (other < {timers.code.plan.default}) && (!found); ++other) {{
        if ({allowed}{p}_fits(state, wanted, other)) {{
            found = true;
            taken = other;
        }}
    }}
    return taken;
}}
""")


def _value(timers: Timers) -> Part:
    p, values = timers.code.prefix, timers.values
    integer, kind = ("uint8_t", "BYTE") if values.max() < 1 << 8 else ("int16_t", "INT16")
    m, at = values.shape[1], place_type(values.size)
    return Part(
        f"""
/* Return the number of the value that a symbol has on an input: of equal values the same. */
static {integer} {p}_value(int16_t symbol, uint16_t input)
{{
{constants(f"{p}_values", integer, values.ravel().tolist())}\
    return CAPSYN_{kind}(&{p}_values[({at})((({at})symbol * {m}u) + input)]);
}}
""",
        frozenset({kind}),
    )


def _forbids(timers: Timers) -> Part:
    p, forbidden = timers.code.prefix, timers.code.plan.policy.rules.forbidden
    bits = np.packbits(forbidden.ravel(), bitorder="little").tolist()
    count, at = len(forbidden), place_type(forbidden.size)
    return Part(
        f"""
/* Return whether a symbol must not follow another. */
static bool {p}_forbids(int16_t before, int16_t after)
{{
{constants(f"{p}_forbidden", "uint8_t", bits)}\
    const {at} place = ({at})((({at})before * {count}u) + ({at})after);
    const uint16_t bits = (uint16_t)CAPSYN_BYTE(&{p}_forbidden[place / 8u]);
    return ((bits >> (place % 8u)) & 1u) != 0u;
}}
""",
        frozenset({"BYTE"}),
    )
