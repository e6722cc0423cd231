"""A module that remembers: transitions, the symbol in force, and clocks of symbols and inputs.

Around the core, which tells what follows a symbol in force at a state, is a module without such an
input: it has the symbol in force, and counts the clocks of all least times.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal

from capsyn.errors import ProblemError
from capsyn.exports.plan import OUTSIDE, Plan
from capsyn.exports.structured_text.memory import held_inputs, input_levels, row_cases, used_rows
from capsyn.exports.text import broken
from capsyn.exports.verilog.module import Module
from capsyn.exports.verilog.ports import width_of
from capsyn.exports.verilog.words import comment
from capsyn.modelling.time_unit import PER_SECOND

UNITS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
"""Units that times are told in, and how many of each a second has."""


@dataclass(frozen=True)
class Levels:
    """Values that labels give held inputs, and the others together, as one number of some bits.

    `codes` (N + 1) are these numbers, `places` where in them the columns of `input_levels` lie, the
    first at the highest bits.
    """

    bits: int
    codes: list[int]
    places: list[str]

    @staticmethod
    def of(plan: Plan) -> Levels:
        """Return those of a plan."""
        codes, bits = [0] * plan.labels, 0
        places: list[str] = []
        for column in input_levels(plan).T[::-1].tolist():
            width = width_of(max(column))
            codes = [code + (value << bits) for code, value in zip(codes, column)]
            places.insert(0, f"[{bits + width - 1}:{bits}]")
            bits += width
        return Levels(bits, codes, places)


def clocks(module: Module, times: dict[str, tuple[str, float]]) -> list[str]:
    """Return the parameters of a clock and of times, each what it is and how long [time unit]."""
    unit, parameters = module.plan.policy.time_unit, []
    over, under = PER_SECOND[unit]
    for name, (what, time) in times.items():
        said = Decimal(f"{time:.12g}")
        exact = said * over / under  # in seconds; 0.1 * 3 is 0.3
        fits = ((label, k) for label, k in UNITS.items() if exact * k == int(exact * k))
        label, parts = next(fits, ("ns", UNITS["ns"]))
        amount = math.ceil(exact * parts)
        if amount * module.clock // parts >= 2**63:
            option = {"DWELL": "dwell", "HOLD_OFF": "hold_off"}.get(name[: -len("_CYCLES")], "hold")
            raise ProblemError(
                f"`{option}` must be less than 2^63 clocks of {module.clock} Hz; got {said} {unit}"
            )
        seconds, rest = (f"64'd{k}" for k in divmod(amount, parts))
        one = f"64'd{parts}"  # products of remainders only, so that 64 bits hold them
        about = comment([f"at least {amount} {label} {what}, in whole clocks"])
        lines = [
            *(f"    {line}" for line in about),
            f"    parameter [63:0] {name} =",
            f"        CLOCK_HZ * {seconds} + CLOCK_HZ / {one} * {rest}",
            f"        + (CLOCK_HZ % {one} * {rest} + 64'd{parts - 1}) / {one}",
        ]
        parameters.append("\n".join(lines))
    text = ",\n".join([f"    parameter [63:0] CLOCK_HZ = 64'd{module.clock}", *parameters])
    return text.splitlines()


def port_list(module: Module, clocked: bool, in_force: bool) -> list[str]:
    """Return the ports of a module, with or without a clock and the symbol in force."""
    ports = []
    if clocked:
        ports += [f"    input wire {text}" for text in ("clk", "rst", "valid_in")]
    sign = " signed" if module.ports else ""
    for text, width in zip(module.inputs, module.widths):
        ports.append(f"    input wire{sign} [{width - 1}:0] {text}")
    ports += [f"    input wire [{module.symbol_bits - 1}:0] in_force"] * in_force
    ports += ["    output wire valid_out"] * clocked
    ports.append(f"    output wire [{module.symbol_bits - 1}:0] symbol")
    ports += ["    output wire outside"] * module.tells
    return ["(", *(p + "," for p in ports[:-1]), ports[-1], ");"]


def followed(module: Module) -> tuple[str, list[str]]:
    """Return the name of what follows the symbol in force in the row ``decided``, and its lines."""
    plan, bits = module.plan, module.symbol_bits
    used = used_rows(plan, module.tree)
    if not used:
        lines = ["    wire unused_in_force = &{1'b0, in_force};"]
        if module.row_bits == bits:
            return "decided", lines
    else:
        lines = []
    lines += [f"    reg [{bits - 1}:0] follows;", "    always @* begin", "        case (decided)"]
    for k in used:
        base, cases = row_cases(plan.transitions[k].tolist())
        lines += [f"            {module.row_bits}'d{k}:", "                case (in_force)"]
        for text, labels in cases.items():
            follows = text if text == "in_force" else _label(module, int(text))
            before = ", ".join(_label(module, j) for j in labels)
            lines += broken(f"                    {before}: follows = {follows};")
        lines.append(f"                    default: follows = {_label(module, base)};")
        lines.append("                endcase")
    part = "" if module.row_bits == bits else f"[{bits - 1}:0]"
    lines += [f"            default: follows = decided{part};", "        endcase", "    end"]
    return "follows", lines


def times(plan: Plan) -> dict[str, tuple[str, float]]:
    """Return the parameters of least times, each what it is and how long [time unit]."""
    rules, found = plan.policy.rules, {}
    holds = rules.holds.tolist()
    if len(set(holds)) == 1:
        found = {"DWELL_CYCLES": ("between switches", holds[0])} if holds[0] else {}
    else:
        for time in dict.fromkeys(filter(None, holds)):
            labels = [k for k, other in enumerate(holds) if other == time]
            names = ", ".join(plan.symbol_names[k] for k in labels)
            found[hold_name(plan, labels[0])] = (f"once entered: {names}", time)
    for i in held_inputs(plan):
        name = plan.policy.alphabet.inputs[i]
        found[f"INPUT_{i}_CYCLES"] = (f"once it has changed: {name}", float(rules.input_holds[i]))
    if plan.hold_off:
        found["HOLD_OFF_CYCLES"] = ("of the safe symbol at the start", plan.hold_off)
    return found


def hold_name(plan: Plan, label: int) -> str:
    """Return the parameter of the least time of a symbol that has one."""
    holds = plan.policy.rules.holds.tolist()
    if len(set(holds)) == 1:
        return "DWELL_CYCLES"
    return f"HOLD_{holds.index(holds[label])}_CYCLES"


def shell(module: Module, about: Sequence[str]) -> list[str]:
    """Return the lines of the module around the core; `about` tells of the golden sequences."""
    plan, found = module.plan, times(module.plan)
    latency = (module.stages + 1 if module.stages else 0) + 1
    lines = comment([
        *plan.header,
        "",
        f"Keeps the symbol in force, and counts clocks; {module.core} tells what follows it.",
        f"Latency {latency} clocks; one state a clock.",
        *about,
    ])  # fmt: skip
    lines += ["`default_nettype none", "", f"module {module.name}"]
    lines += ["#(", *clocks(module, found), ")"] if found else []
    lines += [*port_list(module, True, False), *_state(module), *_core(module)]
    lines += [*_asked(module), *_registers(module), "endmodule", "", "`default_nettype wire"]
    return lines


def _label(module: Module, label: int) -> str:
    return f"{module.symbol_bits}'d{label}"


def _counters(plan: Plan) -> dict[str, str]:
    """Return the counters, each with what it counts from."""
    names = plan.policy.alphabet.inputs
    found = {"held": "the last switch"} if plan.policy.rules.holds.any() else {}
    found |= {f"held_{i}": f"the last change of input {names[i]}" for i in held_inputs(plan)}
    return found | ({"since": "the first decision"} if plan.hold_off else {})


def _state(module: Module) -> list[str]:
    lines = [f"    reg [{module.symbol_bits - 1}:0] symbol_held;"]
    lines += ["    reg outside_held;"] * module.tells + ["    reg valid_held;", "    reg started;"]
    for name, what in _counters(module.plan).items():
        lines += [f"    {line}" for line in comment([f"clocks since {what}"])]
        lines.append(f"    reg [63:0] {name};")
    return lines


def _core(module: Module) -> list[str]:
    """Return the core, and its answer to the symbol in force."""
    top = module.symbol_bits - 1
    clocked = ("clk", "rst", "valid_in") * module.clocked
    wires = [(name, name) for name in (*clocked, *module.inputs, "in_force")]
    wires += [("valid_out", "valid_end")] * module.clocked + [("symbol", "wanted")]
    wires += [("outside", "outside_end")] * module.tells
    valid = ";" if module.clocked else " = valid_in;"
    default = _label(module, module.plan.default)
    return [
        f"    wire [{top}:0] in_force = started ? symbol_held : {default};",
        f"    wire [{top}:0] wanted;",
        *["    wire outside_end;"] * module.tells,
        f"    wire valid_end{valid}",
        f"    {module.core} core (",
        *",\n".join(f"        .{port}({name})" for port, name in wires).splitlines(),
        "    );",
    ]


def _table(module: Module, name: str, values: list[int], width: int) -> list[str]:
    """Return a function of a label."""
    lines = [f"    function [{width - 1}:0] {name};"]
    lines += [f"        input [{module.symbol_bits - 1}:0] label;", "        case (label)"]
    cases: dict[int, list[str]] = {}
    for k, value in enumerate(values[:-1]):
        if value != values[-1]:
            cases.setdefault(value, []).append(_label(module, k))
    for value, labels in cases.items():
        lines += broken(f"            {', '.join(labels)}: {name} = {width}'d{value};")
    lines.append(f"            default: {name} = {width}'d{values[-1]};")
    return [*lines, "        endcase", "    endfunction"]


def _asked(module: Module) -> list[str]:
    """Return what is taken: the symbol that is asked for, that in force, or one between them."""
    plan, top = module.plan, module.symbol_bits - 1
    asked = "wanted"
    if plan.hold_off:
        asked = f"since < HOLD_OFF_CYCLES ? {_label(module, plan.safe)} : wanted"
    lines, kinds, ways = [f"    wire [{top}:0] asked = {asked};"], ("asked", "symbol_held"), []
    kind = "{}"
    if plan.same_control and plan.waits:
        lines = _table(module, "kind", plan.first_alike, module.symbol_bits) + lines
        kind = "kind({})"
    free = ["!started", f"{kind.format(kinds[0])} == {kind.format(kinds[1])}"]
    if module.tells and OUTSIDE in plan.at_once:
        free.append("outside_end")
    holds = plan.policy.rules.holds
    if holds.any():
        values = [hold_name(plan, k) if t else "64'd0" for k, t in enumerate(holds.tolist())]
        lines += _least(module, values)
        ways.append("held < least ? symbol_held :")
    levels, last = Levels.of(plan), "asked"
    if held_inputs(plan):
        last = "mixed"
        lines += _mixed(module, levels)
        ways += ["level_mixed == level_asked ? asked :", "level_mixed == level_now ? symbol_held :"]
    lines.append(f"    wire [{top}:0] taken =")
    if ways:
        lines += broken(f"        {' || '.join(f'({test})' for test in free)} ? asked :")
    lines += [*(f"        {way}" for way in ways), f"        {last};"]
    if held := held_inputs(plan):
        lines.append(f"    wire [{levels.bits - 1}:0] level_taken = level(taken);")
        for place in levels.places[len(held) :]:
            unused = f"level_now{place}, level_taken{place}"
            lines.append(f"    wire unused_levels = &{{1'b0, {unused}}};")
    if holds.any():
        lines.append(
            f"    wire switches = !started || {kind.format('taken')} != "
            f"{kind.format('symbol_held')};"
        )
    return lines


def _least(module: Module, values: list[str]) -> list[str]:
    """Return how many clocks the symbol in force is held at least."""
    if len(set(values)) == 1:
        return [f"    wire [63:0] least = {values[0]};"]
    lines = ["    reg [63:0] least;", "    always @* begin", "        case (symbol_held)"]
    for value in dict.fromkeys(values):
        labels = [_label(module, k) for k, other in enumerate(values) if other == value]
        if value != "64'd0":
            lines += broken(f"            {', '.join(labels)}: least = {value};")
    return [*lines, "            default: least = 64'd0;", "        endcase", "    end"]


def _mixed(module: Module, levels: Levels) -> list[str]:
    """Return the symbol that gives inputs that are yet held their values, the others new ones."""
    plan, top, total = module.plan, module.symbol_bits - 1, levels.bits
    lines = _table(module, "level", levels.codes, total)
    for name, label in (("now", "symbol_held"), ("asked", "asked")):
        lines.append(f"    wire [{total - 1}:0] level_{name} = level({label});")
    parts = [f"        level_asked{place}" for place in levels.places]
    for k, i in enumerate(held_inputs(plan)):
        lines.append(f"    wire locked_{i} = held_{i} < INPUT_{i}_CYCLES;")
        parts[k] = f"        locked_{i} ? level_now{levels.places[k]} :{parts[k][7:]}"
    lines += [
        f"    wire [{total - 1}:0] level_mixed = {{",
        *",\n".join(parts).splitlines(),
        "    };",
    ]
    lines += [f"    reg [{top}:0] mixed;", "    always @* begin", "        case (level_mixed)"]
    for code in dict.fromkeys(levels.codes[:-1]):
        symbols = [k for k in range(plan.default) if levels.codes[k] == code]
        lines += _first(module, f"            {total}'d{code}: ", symbols)
    return [*lines, "            default: mixed = symbol_held;", "        endcase", "    end"]


def _first(module: Module, before: str, symbols: list[int]) -> list[str]:
    """Return the choice of the first of some symbols that the one in force may go to."""
    text, left = before + "mixed =", set(range(module.plan.labels))
    for k in symbols:
        barred = left & {j for j, after in module.plan.forbidden if after == k}
        if not barred:
            return broken(f"{text} {_label(module, k)};")
        if barred < left:
            tests = " || ".join(f"symbol_held == {_label(module, j)}" for j in sorted(barred))
            text += f" !({tests}) ? {_label(module, k)} :"
            left = barred
    return broken(f"{text} symbol_held;")


def _registers(module: Module) -> list[str]:
    plan, counters = module.plan, _counters(module.plan)
    counted, restarts = [], []
    for name in counters:
        if name == "since":
            counted.append(
                "            if (started && since < HOLD_OFF_CYCLES) since <= since + 64'd1;"
            )
            restarts.append("                if (!started) since <= 64'd1;")
            continue
        counted.append(f"            if (!(&{name})) {name} <= {name} + 64'd1;")
        if name == "held":
            restarts.append("                if (switches) held <= 64'd1;")
    for i, place in zip(held_inputs(plan), Levels.of(plan).places):
        changes = f"level_taken{place} != level_now{place}"
        restarts.append(f"                if (!started || {changes}) held_{i} <= 64'd1;")
    return [
        "    always @(posedge clk) begin",
        "        valid_held <= valid_end && !rst;",
        "        if (rst) begin",
        f"            symbol_held <= {_label(module, plan.safe)};",
        *["            outside_held <= 1'b0;"] * module.tells,
        "            started <= 1'b0;",
        *(f"            {name} <= 64'd0;" for name in counters),
        "        end else begin",
        *["            outside_held <= outside_end;"] * module.tells,
        *counted,
        "            if (valid_end) begin",
        "                started <= 1'b1;",
        "                symbol_held <= taken;",
        *restarts,
        "            end",
        "        end",
        "    end",
        "    assign symbol = symbol_held;",
        *["    assign outside = outside_held;"] * module.tells,
        "    assign valid_out = valid_held;",
    ]
