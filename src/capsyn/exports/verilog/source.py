"""The text of a module: its ports, what the tree compares, the tree, and what it decides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from capsyn.exports.plan import OUTSIDE
from capsyn.exports.text import broken, kind
from capsyn.exports.verilog.memory import clocks, followed, port_list
from capsyn.exports.verilog.module import Module
from capsyn.exports.verilog.ports import Port, fold, width_of
from capsyn.exports.verilog.tree import combinational, pipelined
from capsyn.exports.verilog.words import comment, signed


def source(module: Module, about: Sequence[str]) -> list[str]:
    """Return the lines of the module; `about` tells of the golden vectors."""
    used = sorted(
        {int(s) for s in module.tree.split if 0 <= s < module.plan.n}
        | {i for row in module.tree.planes for i in range(module.plan.n) if row[i]}
    )
    lines = comment([*module.plan.header, "", *_about(module), *about])
    lines += ["`default_nettype none", "", *_interface(module)]
    for i in range(module.plan.n):
        if i in used:
            lines += _front(module, i)
        elif module.ports is None or module.plan.policy.space.periodic[i]:
            lines.append(f"    wire unused_{i} = &{{1'b0, {module.inputs[i]}}};")
    if module.ports:
        lines += _outside(module)
    lines += pipelined(module, used) if module.stages else combinational(module)
    lines += _end(module)
    return [*lines, "endmodule", "", "`default_nettype wire"]


def _about(module: Module) -> Iterator[str]:
    plan, domain = module.plan, module.plan.policy.space
    kinds = [kind(plan.policy, i) for i in range(plan.n)]
    if module.renamed:
        yield from (f"Renamed: {old!r} is {new}" for old, new in module.renamed.items())
    if module.ports is None:
        yield "Inputs: lattice steps of states in the domain, from 0 on; no others. State x has"
        yield "step k exactly when face(k) <= x < face(k + 1), where face(k) is"
        yield "lower + (upper - lower) * (k / count) in double precision; the last step has the"
        yield "upper bound as well, unless the state is periodic."
        for i, count in enumerate(module.tree.counts):
            what = "" if kinds[i] == "state" else f"{kinds[i]} "
            yield f"{module.inputs[i]}: {count} steps of {what}{domain.names[i]}"
    else:
        yield "Inputs: readings in signed fixed point: v stands for v / 2^fraction, rounded"
        yield "to the nearest, up at ties, and saturated. The symbol is the policy's at the"
        yield "state of that reading, exactly."
        for i, port in enumerate(module.ports):
            unit = f" {domain.units[i]}" if domain.units[i] and not plan.folded else ""
            what = "" if kinds[i] == "state" else f"{kinds[i]}, "
            yield (
                f"{module.inputs[i]}: {what}{port.bits} bits, fraction {port.fraction}, one unit "
                f"is {2.0**-port.fraction!r}{unit}; a lattice step is "
                f"{port.step:.1f} units; domain {_bounds(module, port)}"
            )
            if domain.periodic[i]:
                yield f"  beyond, whole turns of {port.turn} units are taken away"
        yield f"Share of random states whose symbol the rounding changes: {module.changed!r}"
    if module.has_state:
        yield f"Symbol {plan.default} is in force at first; in_force is read when the answer comes."
    if not module.clocked:
        yield "A circuit without a clock or registers."
    else:
        latency = (module.stages + 1 if module.stages else 0) + module.dwell
        yield f"Latency {latency} clocks; one state a clock."


def _bounds(module: Module, port: Port) -> str:
    first, last = port.first, port.last
    return f"{-1 - last} to {-1 - first}" if port.negative else f"{first} to {last}"


def _interface(module: Module) -> list[str]:
    lines = [f"module {module.core}"]
    if module.dwell:
        lines += ["#(", *clocks(module, {"DWELL_CYCLES": ("between switches", module.plan.dwell)})]
        lines.append(")")
    return [*lines, *port_list(module, module.clocked, module.has_state)]


def _front(module: Module, i: int) -> list[str]:
    """Return wire ``z<i>``: what the tree compares of a state."""
    width, source = module.inner_widths[i], module.inputs[i]
    if module.ports is None:
        return [f"    wire [{width - 1}:0] z{i} = {source};"]
    port, periodic = module.ports[i], module.plan.policy.space.periodic[i]
    kind = f"    wire signed [{port.bits - 1}:0]"
    value = f"~{source}" if port.negative else source
    lines = [f"{kind} v{i} = {value};"]
    turned = f"z{i}" if module.direct else f"w{i}"
    if periodic:
        ends = (
            (">=", "-", range(port.first + port.turn, port.most + 1, port.turn)),
            ("<", "+", range(port.first, port.least, -port.turn)),
        )
        lines.append(f"{kind} {turned} =")
        for test, sign, starts in ends:  # the farthest turns first
            for k in range(len(starts), 0, -1):
                far = f"v{i} {test} {signed(starts[k - 1], port.bits)}"
                lines.append(f"        {far} ? v{i} {sign} {_turns(k, port)} :")
        lines.append(f"        v{i};")
    else:
        lines.append(f"{kind} {turned} = v{i};")
    return lines if module.direct else lines + _product(module, i, port, periodic)


def _product(module: Module, i: int, port: Port, periodic: bool) -> list[str]:
    """Return the step as ``(w * M + A) >> S``, proved at every number when exported."""
    factor, addend, shift = fold(port, module.plan.policy.space.names[i], periodic)
    width = module.inner_widths[i]
    top = max(factor * max(map(abs, port.ends(periodic))), abs(addend), factor)
    bits = max(width_of(2 * top + 2), shift + width, port.bits) + 1
    kind = f"    wire signed [{bits - 1}:0]"
    lines, value = [], f"w{i}"
    if not periodic:  # the nearest step
        value, first, last = f"c{i}", *(signed(k, port.bits) for k in port.ends(periodic))
        lines.append(f"    wire signed [{port.bits - 1}:0] c{i} =")
        lines += [f"        w{i} < {first} ? {first} : w{i} > {last} ? {last} : w{i};"]
    extended = f"{{{{{bits - port.bits}{{{value}[{port.bits - 1}]}}}}, {value}}}"
    product = f"{signed(factor, bits)} * $signed({extended})"
    lines += broken(f"{kind} p{i} = {product} + {signed(addend, bits)};")
    rest = [f"p{i}[{bits - 1}:{shift + width}]"] + [f"p{i}[{shift - 1}:0]"] * (shift > 0)
    lines.append(f"    wire unused_{i} = &{{1'b0, {', '.join(rest)}}};")
    return [*lines, f"    wire [{width - 1}:0] z{i} = p{i}[{shift + width - 1}:{shift}];"]


def _outside(module: Module) -> list[str]:
    tests = []
    for text, port in zip(module.inputs, module.ports or ()):
        if module.plan.policy.space.periodic[port.axis]:
            continue
        value = f"~{text}" if port.negative else text
        if port.first > port.least:
            tests.append(f"$signed({value}) < {signed(port.first, port.bits)}")
        if port.last < port.most:
            tests.append(f"$signed({value}) > {signed(port.last, port.bits)}")
        if not port.least < port.first and not port.last < port.most:
            tests.append(f"&{{1'b0, {text}}}")
    parts = [f"({test})" for test in tests] or ["1'b0"]
    return broken(f"    wire outside_now = {' || '.join(parts)};")


def _end(module: Module) -> list[str]:
    plan, top = module.plan, module.symbol_bits - 1
    safe = f"{module.symbol_bits}'d{plan.safe}"
    lines: list[str] = []
    wanted, outside = "decided", "outside_end"
    if module.has_state:
        wanted, lines = followed(module)
    label = wanted
    if module.ports and not plan.nearest and not all(plan.policy.space.periodic):
        wanted = f"outside_end ? {safe} : {label}"
    if plan.policy.gaps:
        lines.append(f"    wire gap = {label} == {module.symbol_bits}'d{plan.gap};")
        wanted, outside = f"gap ? {safe} : {wanted}", "outside_end || gap"
        outside = outside if module.ports else "gap"
    if not module.dwell:
        lines += [f"    assign symbol = {wanted};"]
        lines += [f"    assign outside = {outside};"] * module.tells
        return lines + ["    assign valid_out = valid_end;"] * module.clocked
    free = "held >= DWELL_CYCLES"
    if module.tells and OUTSIDE in plan.at_once:
        free = f"({free} || {outside})"
    tests = ["wanted != symbol_held"]
    for k, j in plan.same_control:
        one, other = f"{module.symbol_bits}'d{k}", f"{module.symbol_bits}'d{j}"
        tests.append(f"!(wanted == {one} && symbol_held == {other})")
    return [
        *lines,
        f"    wire [{top}:0] wanted = {wanted};",
        f"    reg [{top}:0] symbol_held;",
        *["    reg outside_held;"] * module.tells,
        "    reg valid_held;",
        "    reg started;",
        "    reg [63:0] held; // clocks since the last switch",
        *broken(f"    wire changes = {' && '.join(f'({test})' for test in tests)};"),
        "    always @(posedge clk) begin",
        "        valid_held <= valid_end && !rst;",
        "        if (rst) begin",
        f"            symbol_held <= {safe};",
        *["            outside_held <= 1'b0;"] * module.tells,
        "            started <= 1'b0;",
        "            held <= 64'd0;",
        "        end else begin",
        *[f"            outside_held <= {outside};"] * module.tells,
        "            if (held < DWELL_CYCLES) held <= held + 64'd1;",
        "            if (valid_end) begin",
        "                started <= 1'b1;",
        f"                if (!started || !changes || {free})",
        "                    symbol_held <= wanted;",
        f"                if (!started || (changes && {free})) held <= 64'd1;",
        "            end",
        "        end",
        "    end",
        "    assign symbol = symbol_held;",
        *["    assign outside = outside_held;"] * module.tells,
        "    assign valid_out = valid_held;",
    ]


def _turns(count: int, port: Port) -> str:
    """Return the numbers of some turns; differences are right modulo two to the bits."""
    return f"{port.bits}'sh{count * port.turn % 2**port.bits:x}"
