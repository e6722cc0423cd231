"""Synthesizable Verilog-2005: a module for an FPGA, with a test bench that checks itself."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal

from capsyn.errors import ProblemError
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name, identifiers, renamed
from capsyn.exports.long_lines import broken
from capsyn.exports.plan import Plan
from capsyn.exports.target import Exported, Target
from capsyn.exports.verilog.bench import Interface, bench
from capsyn.exports.verilog.ports import Port, changed_share, fixed_ports, fold, width_of
from capsyn.exports.verilog.tree import TreeCircuit
from capsyn.exports.verilog.words import KEYWORDS, comment, signed
from capsyn.validation import describe, finite_number, one_of, whole_number

STAGE_LEVELS = 4
"""Levels of the tree in a stage of the pipeline, by default."""
MOST_LEVELS = 16
"""Most levels in a stage."""
LONGEST_NAME = 32
"""Most characters of a name that are kept."""
UNITS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
FIXED = frozenset(
    "clk rst valid_in valid_out symbol outside wanted held started CLOCK_HZ DWELL_CYCLES changes "
    "symbol_held outside_held valid_held decided outside_now outside_end outside_then valid_end "
    "valid_then".split()
)
"""Names that are the module's own."""


@dataclass(frozen=True)
class Options:
    """Options of target ``verilog``.

    Parameters
    ----------
    inputs : "lattice" or "fixed"
        Lattice steps, unsigned, of states in the domain; or readings in signed fixed point.
    pipeline : bool or int
        Stages that the tree is cut into, with registers between them; True for 4 levels a stage.
        A new state is taken at every clock. Default: a circuit without a clock, unless there is a
        minimum dwell time.
    bits, fraction : int, or one a state, optional
        Of fixed-point ports: width, and bits behind the point. Default: a lattice step is 64 units
        of the last place or more, and there is room beyond the bounds.
    clock_hz : float
        Default of the parameter ``CLOCK_HZ``, which the minimum dwell time is counted with.
    name : str, optional
        Name of the module. Default: that of the policy.
    """

    inputs: str = "lattice"
    pipeline: bool | int = False
    bits: int | Sequence[int | None] | None = None
    fraction: int | Sequence[int | None] | None = None
    clock_hz: float = 50e6
    name: str | None = None

    def ports(self, plan: Plan) -> tuple[Port, ...] | None:
        """Return the fixed-point ports; None for inputs lattice."""
        if self.inputs == "fixed":
            bits = _per_state("bits", self.bits, plan.n, 2)
            return fixed_ports(plan, bits, _per_state("fraction", self.fraction, plan.n, 0))
        if self.bits is not None or self.fraction is not None:
            raise ProblemError("`bits` and `fraction` must be given for inputs fixed only")
        return None


def _per_state(name: str, value: object, n: int, least: int) -> tuple[int | None, ...]:
    values = list(value) if isinstance(value, (list, tuple)) else [value] * n
    if len(values) != n:
        raise ProblemError(f"`{name}` must be one number or {n}; got {describe(value)}")
    return tuple(None if v is None else whole_number(name, v, least=least, most=64) for v in values)


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return a module, its test bench and the golden vectors that this reads."""
    one_of("inputs", options.inputs, ["lattice", "fixed"])
    ports = options.ports(plan)
    clock = math.ceil(finite_number("clock_hz", options.clock_hz, above=0.0))
    module = _Module(plan, ports, options.pipeline, clock, options.name)
    test_bench, vectors, about, at_ports = bench(module.interface, golden)
    text = "\n".join(module.lines(about)) + "\n"
    files = {
        f"{module.name}.v": text.encode("ascii"),
        f"{module.name}_tb.v": test_bench,
        f"{module.name}.mem": vectors,
    }
    return Exported(files, module.renamed, changed=module.changed, golden=at_ports)


TARGET = Target(export, Options)


class _Module:
    def __init__(
        self,
        plan: Plan,
        ports: tuple[Port, ...] | None,
        pipeline: bool | int,
        clock: int,
        name: str | None,
    ) -> None:
        self.plan, self.ports, self.clock = plan, ports, clock
        self.tree, domain = plan.tree.cells, plan.policy.domain
        file_name(name, plan.policy.name)
        given = plan.policy.name if name is None else name
        self.name = identifiers([given[:LONGEST_NAME]], {*KEYWORDS, *FIXED})[0]
        end = "" if ports else "_step"
        own = {self.name, f"{self.name}_tb", *FIXED}
        names = [text[:LONGEST_NAME] + end for text in domain.names]
        own |= {text for text in names if _is_inner(text)}
        self.inputs = identifiers(names, {*KEYWORDS, *own})
        ports_of = zip(domain.names, names, self.inputs)
        changed = {name: port for name, wanted, port in ports_of if port != wanted}
        self.renamed = renamed([given], [self.name]) | changed
        self.symbol_bits = width_of(plan.labels - 1)
        # of fixed-point ports the numbers themselves are compared, unless sums need steps
        self.direct = ports is not None and not len(self.tree.planes)
        if ports is None:
            self.widths = [width_of(count - 1) for count in self.tree.counts]
        else:
            self.widths = [port.bits for port in ports]
        steps = [width_of(count - 1) for count in self.tree.counts]
        self.inner_widths = self.widths if self.direct else steps
        self.stages = self._stages(pipeline)
        depth = max(1, self.tree.depth)
        self.levels = math.ceil(depth / self.stages) if self.stages else depth
        self.stages = math.ceil(depth / self.levels) if self.stages else 0
        self.dwell = plan.dwell > 0
        self.tells = ports is not None or plan.policy.gaps  # whether a state is outside
        self.clocked = self.stages > 0 or self.dwell
        self.latency = (self.stages + 1 if self.stages else 0) + self.dwell

    @property
    def interface(self) -> Interface:
        return Interface(
            self.plan, self.ports, self.name, self.inputs,
            self.widths, self.symbol_bits, self.clocked, self.dwell,
        )  # fmt: skip

    @functools.cached_property
    def changed(self) -> float | None:
        """Share of states whose symbol the rounding of the ports changes; None without any."""
        return changed_share(self.plan, self.ports) if self.ports else None

    def _stages(self, pipeline: bool | int) -> int:
        depth = max(1, self.tree.depth)
        if pipeline is True:
            return math.ceil(depth / STAGE_LEVELS)
        stages = 0 if pipeline is False else whole_number("pipeline", pipeline, least=1, most=1000)
        if stages and depth > MOST_LEVELS * stages:
            least = math.ceil(depth / MOST_LEVELS)
            raise ProblemError(
                f"`pipeline` must be {least} stages at least for a tree of {depth} levels; "
                f"got {stages}"
            )
        return stages

    def lines(self, about: Sequence[str]) -> list[str]:
        """Return the module's text; `about` tells of the golden vectors."""
        used = sorted(
            {int(s) for s in self.tree.split if 0 <= s < self.plan.n}
            | {i for row in self.tree.planes for i in range(self.plan.n) if row[i]}
        )
        found = comment([*self.plan.header, "", *self._about(), *about])
        found += ["`default_nettype none", "", *self._interface()]
        for i in range(self.plan.n):
            if i in used:
                found += self._front(i)
            elif self.ports is None or self.plan.policy.domain.periodic[i]:
                found.append(f"    wire unused_{i} = &{{1'b0, {self.inputs[i]}}};")
        if self.ports:
            found += self._outside()
        circuit = TreeCircuit(
            self.plan, self.ports, self.direct, self.inner_widths,
            self.symbol_bits, self.stages, self.levels, self.clocked,
        )  # fmt: skip
        found += circuit.pipelined(used) if self.stages else circuit.combinational()
        found += self._end()
        return [*found, "endmodule", "", "`default_nettype wire"]

    def _about(self) -> Iterator[str]:
        """Yield what the ports mean."""
        plan, domain = self.plan, self.plan.policy.domain
        if self.renamed:
            yield from (f"Renamed: {old!r} is {new}" for old, new in self.renamed.items())
        if self.ports is None:
            yield "Inputs: lattice steps of states in the domain, from 0 on; no others. State x has"
            yield "step k exactly when face(k) <= x < face(k + 1), where face(k) is"
            yield "lower + (upper - lower) * (k / count) in double precision; the last step has the"
            yield "upper bound as well, unless the state is periodic."
            for i, count in enumerate(self.tree.counts):
                yield f"{self.inputs[i]}: {count} steps of {domain.names[i]}"
        else:
            yield "Inputs: readings in signed fixed point: v stands for v / 2^fraction, rounded"
            yield "to the nearest, up at ties, and saturated. The symbol is the policy's at the"
            yield "state of that reading, exactly."
            for i, port in enumerate(self.ports):
                unit = f" {domain.units[i]}" if domain.units[i] and not plan.folded else ""
                yield (
                    f"{self.inputs[i]}: {port.bits} bits, fraction {port.fraction}, one unit is "
                    f"{2.0**-port.fraction!r}{unit}; a lattice step is "
                    f"{port.step:.1f} units; domain {self._bounds(port)}"
                )
                if domain.periodic[i]:
                    yield f"  beyond, whole turns of {port.turn} units are taken away"
            yield f"Share of random states whose symbol the rounding changes: {self.changed!r}"
        if not self.clocked:
            yield "A circuit without a clock or registers."
        else:
            yield f"Latency {self.latency} clocks; one state a clock."

    def _bounds(self, port: Port) -> str:
        first, last = port.first, port.last
        return f"{-1 - last} to {-1 - first}" if port.negative else f"{first} to {last}"

    def _interface(self) -> list[str]:
        found = [f"module {self.name}"]
        if self.dwell:
            exact = Decimal(f"{self.plan.dwell:.12g}")  # 0.1 * 3 is 0.3
            units = [k for k in UNITS.values() if exact * k == int(exact * k)]
            unit = units[0] if units else UNITS["ns"]
            amount = math.ceil(exact * unit)
            label = next(k for k, v in UNITS.items() if v == unit)
            if amount * self.clock // unit >= 2**63:
                raise ProblemError(
                    f"`dwell` must be less than 2^63 clocks of {self.clock} Hz; got {exact} s"
                )
            found += ["#(", f"    parameter [63:0] CLOCK_HZ = 64'd{self.clock},"]
            found.append(f"    // at least {amount} {label} between switches, in whole clocks")
            seconds, rest = (f"64'd{k}" for k in divmod(amount, unit))
            one = f"64'd{unit}"  # products of remainders only, so that 64 bits hold them
            found += [
                "    parameter [63:0] DWELL_CYCLES =",
                f"        CLOCK_HZ * {seconds} + CLOCK_HZ / {one} * {rest}",
                f"        + (CLOCK_HZ % {one} * {rest} + 64'd{unit - 1}) / {one}",
                ")",
            ]
        found.append("(")
        ports = []
        if self.clocked:
            ports += [f"    input wire {text}" for text in ("clk", "rst", "valid_in")]
        sign = " signed" if self.ports else ""
        for text, width in zip(self.inputs, self.widths):
            ports.append(f"    input wire{sign} [{width - 1}:0] {text}")
        ports += ["    output wire valid_out"] * self.clocked
        ports.append(f"    output wire [{self.symbol_bits - 1}:0] symbol")
        ports += ["    output wire outside"] * self.tells
        return [*found, *(p + "," for p in ports[:-1]), ports[-1], ");"]

    def _front(self, i: int) -> list[str]:
        """Return wire ``z<i>``: what the tree compares of a state."""
        width, source = self.inner_widths[i], self.inputs[i]
        if self.ports is None:
            return [f"    wire [{width - 1}:0] z{i} = {source};"]
        port, periodic = self.ports[i], self.plan.policy.domain.periodic[i]
        kind = f"    wire signed [{port.bits - 1}:0]"
        value = f"~{source}" if port.negative else source
        found = [f"{kind} v{i} = {value};"]
        turned = f"z{i}" if self.direct else f"w{i}"
        if periodic:
            rows: list[str] = []
            lows: list[str] = []
            start, k = port.first + port.turn, 1
            while start <= port.most:
                rows.insert(0, f"v{i} >= {signed(start, port.bits)} ? v{i} - {_turns(k, port)} :")
                start, k = start + port.turn, k + 1
            start, k = port.first, 1
            while start > port.least:
                lows.insert(0, f"v{i} < {signed(start, port.bits)} ? v{i} + {_turns(k, port)} :")
                start, k = start - port.turn, k + 1
            rows = [f"        {row}" for row in [*rows, *lows, f"v{i};"]]
            found += [f"{kind} {turned} =", *rows]
        else:
            found.append(f"{kind} {turned} = v{i};")
        return found if self.direct else found + self._product(i, port, periodic)

    def _product(self, i: int, port: Port, periodic: bool) -> list[str]:
        """Return the step as ``(w * M + A) >> S``, proved at every number when exported."""
        factor, addend, shift = fold(port, self.plan.policy.domain.names[i], periodic)
        width = self.inner_widths[i]
        top = max(factor * max(map(abs, port.ends(periodic))), abs(addend), factor)
        bits = max(width_of(2 * top + 2), shift + width, port.bits) + 1
        kind = f"    wire signed [{bits - 1}:0]"
        found, value = [], f"w{i}"
        if not periodic:  # the nearest step
            value, first, last = f"c{i}", *(signed(k, port.bits) for k in port.ends(periodic))
            found.append(f"    wire signed [{port.bits - 1}:0] c{i} =")
            found += [f"        w{i} < {first} ? {first} : w{i} > {last} ? {last} : w{i};"]
        extended = f"{{{{{bits - port.bits}{{{value}[{port.bits - 1}]}}}}, {value}}}"
        product = f"{signed(factor, bits)} * $signed({extended})"
        found += broken(f"{kind} p{i} = {product} + {signed(addend, bits)};")
        rest = [f"p{i}[{bits - 1}:{shift + width}]"] + [f"p{i}[{shift - 1}:0]"] * (shift > 0)
        found.append(f"    wire unused_{i} = &{{1'b0, {', '.join(rest)}}};")
        return [*found, f"    wire [{width - 1}:0] z{i} = p{i}[{shift + width - 1}:{shift}];"]

    def _outside(self) -> list[str]:
        tests = []
        for text, port in zip(self.inputs, self.ports or ()):
            if self.plan.policy.domain.periodic[port.axis]:
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

    def _end(self) -> list[str]:
        plan, top = self.plan, self.symbol_bits - 1
        safe = f"{self.symbol_bits}'d{plan.safe}"
        wanted, outside, found = "decided", "outside_end", []
        if self.ports and not plan.nearest and not all(plan.policy.domain.periodic):
            wanted = f"outside_end ? {safe} : decided"
        if plan.policy.gaps:
            found = [f"    wire gap = decided == {self.symbol_bits}'d{plan.gap};"]
            wanted, outside = f"gap ? {safe} : {wanted}", "outside_end || gap"
            outside = outside if self.ports else "gap"
        if not self.dwell:
            found += [f"    assign symbol = {wanted};"]
            found += [f"    assign outside = {outside};"] * self.tells
            return found + ["    assign valid_out = valid_end;"] * self.clocked
        default = plan.labels - 1
        tests = ["wanted != symbol_held"]
        for k in plan.like_default:  # no switch between the two
            one, other = f"{self.symbol_bits}'d{k}", f"{self.symbol_bits}'d{default}"
            tests.append(f"!(wanted == {one} && symbol_held == {other})")
            tests.append(f"!(wanted == {other} && symbol_held == {one})")
        return [
            *found,
            f"    wire [{top}:0] wanted = {wanted};",
            f"    reg [{top}:0] symbol_held;",
            *["    reg outside_held;"] * self.tells,
            "    reg valid_held;",
            "    reg started;",
            "    reg [63:0] held; // clocks since the last switch",
            *broken(f"    wire changes = {' && '.join(f'({test})' for test in tests)};"),
            "    always @(posedge clk) begin",
            "        valid_held <= valid_end && !rst;",
            "        if (rst) begin",
            f"            symbol_held <= {safe};",
            *["            outside_held <= 1'b0;"] * self.tells,
            "            started <= 1'b0;",
            "            held <= 64'd0;",
            "        end else begin",
            *[f"            outside_held <= {outside};"] * self.tells,
            "            if (held < DWELL_CYCLES) held <= held + 64'd1;",
            "            if (valid_end) begin",
            "                started <= 1'b1;",
            "                if (!started || !changes || held >= DWELL_CYCLES)",
            "                    symbol_held <= wanted;",
            "                if (!started || (changes && held >= DWELL_CYCLES)) held <= 64'd1;",
            "            end",
            "        end",
            "    end",
            "    assign symbol = symbol_held;",
            *["    assign outside = outside_held;"] * self.tells,
            "    assign valid_out = valid_held;",
        ]


def _turns(count: int, port: Port) -> str:
    """Return the numbers of some turns; differences are right modulo two to the bits."""
    return f"{port.bits}'sh{count * port.turn % 2**port.bits:x}"


def _is_inner(text: str) -> bool:
    """Return whether a name may be one of the module's own wires."""
    return bool(re.fullmatch(r"(z|v|w|c|p|s|at|next|part|unused)_?\d+(_\d+)?", text))
