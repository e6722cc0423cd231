"""Least times of symbols and inputs, and a hold-off: a TIME each, that runs down."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from decimal import Decimal

from capsyn.errors import ProblemError
from capsyn.exports.plan import NOT_FINITE, Plan
from capsyn.exports.structured_text.block import Block
from capsyn.exports.structured_text.lines import comment, condition, indented, time
from capsyn.exports.structured_text.memory import held_inputs, input_levels
from capsyn.exports.structured_text.pou import Variable, table
from capsyn.modelling.time_unit import to_seconds

MOST = (1 << 31) - 1
"""Largest TIME of all tools [ms]: those that count milliseconds have 32 bits."""
ZERO = time(0)


@dataclass(frozen=True)
class Waits:
    """Least times in whole milliseconds: of symbols, of held inputs by number, of the hold-off.

    `rounded` is whether any had to be rounded up.
    """

    symbols: list[int]
    inputs: dict[int, int]
    off: int
    rounded: bool

    @staticmethod
    def of(plan: Plan) -> Waits:
        """Return those of a plan; `ProblemError` where a time is no TIME."""
        rules, unit = plan.policy.rules, plan.policy.time_unit
        hold = "hold" if plan.has_state and not plan.dwell else "dwell"
        symbols = [least(hold, to_seconds(t, unit)) for t in rules.holds.tolist()]
        inputs = {
            i: least("hold", to_seconds(float(rules.input_holds[i]), unit))
            for i in held_inputs(plan)
        }
        off = least("hold_off", to_seconds(plan.hold_off, unit))
        rounded = any(up for _, up in (*symbols, *inputs.values(), off))
        return Waits(
            [t for t, _ in symbols], {i: t for i, (t, _) in inputs.items()}, off[0], rounded
        )

    @property
    def longest(self) -> int:
        """The longest of the symbols."""
        return max(self.symbols)

    @property
    def differ(self) -> bool:
        """Whether symbols have several."""
        return len(set(self.symbols)) > 1

    @property
    def timers(self) -> dict[str, int]:
        """Variables that run down, and what they begin with once a symbol or an input changes."""
        timers = {"rest": self.longest} if self.longest else {}
        timers |= {f"rest{i}": t for i, t in self.inputs.items()}
        return timers | ({"off": self.off} if self.off else {})

    @property
    def remaining(self) -> str:
        """The variable that says how long the symbol in force is yet held; none: it is not."""
        return "remaining" if self.differ else "rest" if self.longest else ""


def least(name: str, seconds: float) -> tuple[int, bool]:
    """Return a time in whole milliseconds, and whether it had to be rounded up."""
    exact = Decimal(f"{seconds:.12g}") * 1000  # 0.1 * 3 is 0.3
    if exact > MOST:
        raise ProblemError(f"`{name}` must be at most {MOST / 1000} s in TIME; got {seconds!r} s")
    return math.ceil(exact), exact != math.ceil(exact)


def waiting(plan: Plan) -> list[Variable]:
    """Return the variables that holding needs."""
    waits = Waits.of(plan)
    about = {"rest": "time until another control may be taken", "off": "time of the hold-off"}
    for i in waits.inputs:
        about[f"rest{i}"] = f"time until {plan.policy.alphabet.inputs[i]} may change"
    made = [Variable("started", "BOOL", "whether there was a call", "FALSE")]
    made += [Variable(name, "TIME", about[name], ZERO) for name in waits.timers]
    if waits.differ:
        made.append(Variable("remaining", "TIME", "time until another symbol may be taken"))
    if waits.inputs:
        levels = input_levels(plan)
        made.append(table("levels", levels.ravel()))
        made.append(Variable("mixed", "INT", size=levels.shape[1]))
        made += [Variable(name, "DINT") for name in ("place", "own", "asked", "other")]
        made.append(Variable("same", "BOOL"))
    return made


def hold(block: Block, siemens: bool) -> list[str]:
    """Return the rule of the closed loop for least times."""
    plan, waits = block.plan, Waits.of(block.plan)
    starts = [f"{name} := {time(t)};" for name, t in waits.timers.items()]
    codes = sorted(code for code in plan.at_once if not (code == NOT_FINITE and block.axes))
    now = [f"(status = {code})" for code in codes]
    about = _about(plan, waits, codes)
    safe = [f"wanted := {plan.safe};"] * bool(waits.off)
    lines = _run_down(waits, siemens)
    if safe:
        lines += [f"IF off > {ZERO} THEN", *indented(safe), "END_IF;"]
    lines += _alike(plan)
    if waits.inputs:
        lines += _mixed(plan, waits, now)
    tests = ["wanted <> symbol"]
    if waits.remaining:
        free = " OR ".join([f"({waits.remaining} <= {ZERO})", *now])
        tests = ["(wanted <> symbol)", f"({free})" if now else free]
    lines += [f"IF {' AND '.join(tests)} THEN", *indented(_restarted(plan, waits))]
    lines += ["    symbol := wanted;"]
    if waits.longest:
        lines.append(f"    rest := {time(waits.longest)};")
    lines.append("END_IF;")
    return [
        *comment([" ".join(about)]),
        "IF NOT started THEN",
        *indented(["started := TRUE;", *safe, "symbol := wanted;", *starts]),
        "ELSE",
        *indented(lines),
        "END_IF;",
    ]


def _about(plan: Plan, waits: Waits, codes: list[int]) -> list[str]:
    """Return sentences that say what is held for how long."""
    names, inputs, about = plan.symbol_names, plan.policy.alphabet.inputs, []
    rounded = ", rounded up" * waits.rounded
    if waits.differ:
        held = ", ".join(f"{name} {time(t)}" for name, t in zip(names, waits.symbols) if t)
        about.append(f"Symbols are held once entered for at least{rounded}: {held}.")
    elif waits.longest:
        about.append(f"A control is held for {time(waits.longest)} at least{rounded}.")
    if waits.inputs:
        held = ", ".join(f"{inputs[i]} {time(t)}" for i, t in waits.inputs.items())
        about.append(f"Inputs are held once they have changed for at least{rounded}: {held}.")
    if waits.off:
        about.append(f"After the start the safe symbol is held for {time(waits.off)}{rounded}.")
    if codes:
        about.append(f"The symbol of status {' and '.join(map(str, codes))} does not wait.")
    return about


def _run_down(waits: Waits, siemens: bool) -> list[str]:
    """Return what lets time pass, and says how long the symbol in force is yet held."""
    lines = [f"IF cycle > {ZERO} THEN"]
    for name in waits.timers:
        lines += [f"    IF {name} > cycle THEN", f"        {name} := {name} - cycle;", "    ELSE"]
        lines += [f"        {name} := {ZERO};", "    END_IF;"]
    lines.append("END_IF;")
    ends = list(waits.timers)
    if waits.differ:  # the timer runs as long as the longest
        ends[0] = "remaining"
        spare = [waits.longest - t for t in waits.symbols]
        usual = Counter(spare).most_common(1)[0][0]
        lines += [f"remaining := {time(usual)};", "CASE symbol OF"]
        for k, less in enumerate(spare):
            if less != usual:
                lines += [f"    {k}:", f"        remaining := {time(less)};"]
        lines += ["END_CASE;", "IF rest > remaining THEN"]  # TIME may have no sign
        lines += ["    remaining := rest - remaining;", "ELSE"]
        lines += [f"    remaining := {ZERO};", "END_IF;"]
    if not siemens:
        lines += comment(["Where TIME is finer, less than half a millisecond is rounding."])
        for name in ends:
            lines += [f"IF {name} < T#1ms THEN", f"    IF ({name} + {name}) < T#1ms THEN"]
            lines += [f"        {name} := {ZERO};", "    END_IF;", "END_IF;"]
    return lines


def _alike(plan: Plan) -> list[str]:
    """Return what takes a symbol to which a change is no switch."""
    if not plan.same_control:
        return []
    pairs = (f"((wanted = {k}) AND (symbol = {j}))" for k, j in plan.same_control)
    return [*condition("IF (", pairs, ") THEN", "OR"), "    symbol := wanted;", "END_IF;"]


def _level(of: str, column: int | str) -> str:
    """Return the value that a label gives an input, its row of `input_levels` beginning at `of`."""
    return f"levels[{of}]" if column == 0 else f"levels[{of} + {column}]"


def _row(of: str, label: str, columns: int) -> str:
    """Return the statement that gives where the row of a label begins."""
    return f"{of} := INT_TO_DINT({label}){f' * {columns}' if columns > 1 else ''};"


def _mixed(plan: Plan, waits: Waits, now: list[str]) -> list[str]:
    """Return what lets inputs that are yet held keep their values, if there is such a symbol."""
    columns, symbols = input_levels(plan).shape[1], plan.labels - 1
    tests = ["(wanted <> symbol)", *[f"({waits.remaining} <= {ZERO})"] * bool(waits.remaining)]
    tests += [f"(NOT {test})" for test in now]
    lines = [_row("asked", "wanted", columns), "same := TRUE;"]
    lines += [f"FOR place := 0 TO {columns - 1} DO"]
    lines += [f"    mixed[place] := {_level('asked', 'place')};", "END_FOR;"]
    for k, i in enumerate(waits.inputs):
        own = _level("own", k)
        lines += [f"IF (rest{i} > {ZERO}) AND (mixed[{k}] <> {own}) THEN"]
        lines += [f"    mixed[{k}] := {own};", "    same := FALSE;", "END_IF;"]
    search = ["same := TRUE;", f"FOR place := 0 TO {columns - 1} DO"]
    found = _level(f"other * {columns}" if columns > 1 else "other", "place")
    search.append(f"    IF mixed[place] <> {found} THEN")
    search += ["        same := FALSE;", "    END_IF;", "END_FOR;"]
    pairs = [(j, k) for j, k in plan.forbidden if k < symbols]
    if pairs:
        forbidden = (f"((symbol = {j}) AND (other = {k}))" for j, k in pairs)
        search += [*condition("IF (", forbidden, ") THEN", "OR"), "    same := FALSE;", "END_IF;"]
    search += ["IF same THEN", "    wanted := DINT_TO_INT(other);", f"    other := {symbols};"]
    search += ["ELSE", "    other := other + 1;", "END_IF;"]
    lines += ["IF NOT same THEN", "    wanted := symbol;", f"    other := {symbols};"]
    differs = f"mixed[place] <> {_level('own', 'place')}"
    lines += [f"    FOR place := 0 TO {columns - 1} DO", f"        IF {differs} THEN"]
    lines += ["            other := 0;", "        END_IF;", "    END_FOR;"]
    lines += [f"    WHILE other < {symbols} DO", *indented(search, 2), "    END_WHILE;", "END_IF;"]
    told = "Held inputs keep their values; if others change at all, the first such symbol is taken."
    return [
        *comment([told]),
        _row("own", "symbol", columns),
        *condition("IF (", tests, ") THEN"),
        *indented(lines),
        "END_IF;",
    ]


def _restarted(plan: Plan, waits: Waits) -> list[str]:
    """Return what starts the times of inputs anew whose values change."""
    if not waits.inputs:
        return []
    lines = [_row("asked", "wanted", input_levels(plan).shape[1])]
    for k, (i, t) in enumerate(waits.inputs.items()):
        lines += [f"IF {_level('asked', k)} <> {_level('own', k)} THEN"]
        lines += [f"    rest{i} := {time(t)};", "END_IF;"]
    return lines
