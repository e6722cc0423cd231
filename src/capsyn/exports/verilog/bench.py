"""A test bench that runs the golden vectors through a module and checks it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from capsyn.exports.golden import Golden, decide
from capsyn.exports.plan import NOT_FINITE, OK
from capsyn.exports.sequence import Sequence, golden_sequence, run
from capsyn.exports.verilog.memory import times
from capsyn.exports.verilog.module import Module
from capsyn.exports.verilog.ports import port_numbers, quantised_readings
from capsyn.exports.verilog.words import comment
from capsyn.simulation.closed_loop import SLACK

PLAIN = """\
    initial begin
        load;
        while (sent < COUNT) begin
            send;
            #1 check;
        end
        finish;
    end"""
"""What runs a module without a clock."""
CLOCKED = """\
    initial begin
        load;
        clk = 1'b0;
        rst = 1'b1;
        valid_in = 1'b0;
        #20 rst = 1'b0;
        #2000000000 finish;
    end
    always #5 clk = ~clk;
    always @(negedge clk) if (!rst) begin
        if (valid_out) check;
        valid_in = (sent < COUNT) && (sent % 8 != 7 || !valid_in); // with gaps
        if (valid_in) send;
        if (seen == COUNT) finish;
    end"""
"""What runs a module with one."""
SEQUENCES = """\
    initial begin
        load;
        clk = 1'b0;
        rst = 1'b1;
        valid_in = 1'b0;
        #2000000000 finish;
    end
    always #5 clk = ~clk;
    always @(negedge clk) begin
        if (valid_out && !rst) check;
        valid_in = 1'b0;
        if (sent < COUNT) begin
            vector = vectors[sent];
            if (rst || !vector[BITS - 1]) begin
                rst = 1'b0;
                send;
                valid_in = 1'b1;
            end else if (seen == sent) rst = 1'b1; // a new start, once all is told
        end
        if (seen == COUNT) finish;
    end"""
"""What runs sequences, a step a clock, with new starts between them."""
FRAME = """\
    task load;
        begin
            $readmemh(VECTORS, vectors);
            sent = 0;
            seen = 0;
            wrong = 0;
            if (^vectors[COUNT - 1] === 1'bx) begin
                $display("FAIL: no vectors in %0s; run where it lies", VECTORS);
                $finish;
            end
        end
    endtask
    task finish;
        begin
            if (wrong == 0 && seen == COUNT) $display("PASS: %0d vectors", seen);
            else $display("FAIL: %0d wrong of %0d, %0d seen", wrong, COUNT, seen);
            $finish;
        end
    endtask"""
"""What begins and ends every run."""


def bench(module: Module, golden: Golden) -> tuple[bytes, bytes, list[str], Golden | None]:
    """Return a test bench, its vectors in hexadecimal numbers, what to tell of these, and them.

    The last are the golden vectors at the readings of fixed-point ports; None for lattice steps.

    A line holds, from the highest bits on, the inputs in order, the symbol in force, for a core,
    whether the state is outside (for fixed-point ports or a policy with gaps), and the symbol.
    States that are not finite are left out.
    """
    plan, ports = module.plan, module.ports
    used = (golden.statuses != NOT_FINITE) & np.isfinite(golden.readings).all(axis=1)
    about = [f"Golden vectors: {int(used.sum())}; {int((~used).sum())} not finite, left out."]
    if ports is None:
        columns = golden.steps[used]
        labels = plan.tree.cells.labels(columns)
        now = None if golden.in_force is None else golden.in_force[used]
        labels = labels if now is None else plan.transitions[labels, now]
        beyond = int((golden.statuses[used] != OK).sum())
        about[0] += f" Of {beyond} outside the domain, the nearest steps were taken."
        outside, at_ports = labels == plan.gap, None
        labels = np.where(outside, plan.safe, labels)
    else:
        readings = golden.readings[used]
        columns = port_numbers(ports, readings)
        at_ports = decide(plan, quantised_readings(plan, ports, columns))
        labels, outside, now = at_ports.labels, at_ports.statuses != OK, at_ports.in_force
        room = np.array([2.0**-port.fraction for port in ports])
        least = np.array([port.least for port in ports]) * room
        most = np.array([port.most for port in ports]) * room
        beyond = int(((readings < least) | (readings > most)).any(axis=1).sum())
        about[0] += f" {beyond} beyond a port, saturated."
    if module.has_state and now is None:
        now = np.full(len(columns), plan.default)
    words, bits = _words(module, columns, [(now, module.symbol_bits)], outside, labels)
    text = _text(module, len(words), bits)
    made = _files([*plan.header, *about], words, bits, text)
    return *made, about, at_ports


def sequence_bench(module: Module) -> tuple[bytes, bytes, list[str], Sequence | None]:
    """Return likewise a test bench that runs the golden sequences, a step a clock.

    A line holds whether it is a new start, in its highest bit, the inputs, whether the state is
    outside, and the symbol that is then in force. States that are not finite are others.
    """
    plan, ports = module.plan, module.ports
    found, domain = golden_sequence(plan), module.plan.policy.space
    states = plan.states(found.readings)
    states = np.where(np.isfinite(states), states, domain.lower)
    unfolded = dataclasses.replace(plan, scale=np.ones(plan.n), offset=np.zeros(plan.n))
    if ports is None:
        states = np.clip(states, domain.lower, domain.upper)
        expected, at_ports = run(unfolded, states, found.period), None
        columns = domain.locate(states.reshape(-1, plan.n), plan.counts)
    else:
        readings = ((states - plan.offset) / plan.scale).reshape(-1, plan.n)
        columns = port_numbers(ports, readings)
        readings = quantised_readings(plan, ports, columns).reshape(states.shape)
        expected = at_ports = run(plan, readings, found.period)
    runs, steps = expected.labels.shape
    first = np.tile(np.arange(steps) == 0, runs).astype(int)
    outside = expected.statuses.ravel() != OK
    words, bits = _words(module, columns, [], outside, expected.labels.ravel())
    words, bits = words + (first.astype(object) << bits), bits + 1
    cycles = {
        name: max(0, math.ceil(time / found.period - SLACK))
        for name, (_, time) in times(plan).items()
    }
    about = [f"Golden sequences: {runs} of {steps} steps, a clock each."]
    text = _text(module, len(words), bits, cycles)
    return *_files([*plan.header, *about], words, bits, text), about, at_ports


def _words(
    module: Module,
    columns: np.ndarray,
    more: list[tuple[np.ndarray | None, int]],
    outside: np.ndarray,
    labels: np.ndarray,
) -> tuple[np.ndarray, int]:
    """Return vectors (K,) as whole numbers, and their bits: inputs, more numbers, answers."""
    parts = [(columns[:, i], width) for i, width in enumerate(module.widths)]
    parts += [(values, width) for values, width in more if values is not None]
    parts += [(outside.astype(int), 1)] * module.tells + [(labels, module.symbol_bits)]
    words = np.zeros(len(columns), dtype=object)
    for values, width in parts:
        words = (words << width) + (values.astype(object) & (2**width - 1))
    return words, sum(width for _, width in parts)


def _files(about: list[str], words: np.ndarray, bits: int, text: list[str]) -> tuple[bytes, bytes]:
    """Return a test bench, and its vectors in hexadecimal numbers, each after remarks."""
    head = comment(about)
    digits = (bits + 3) // 4
    vectors = "\n".join([*head, *(f"{word:0{digits}x}" for word in words.tolist())]) + "\n"
    return ("\n".join([*head, *text]) + "\n").encode("ascii"), vectors.encode("ascii")


def _text(module: Module, count: int, bits: int, cycles: dict[str, int] | None = None) -> list[str]:
    """Return the test bench for some vectors of a number of bits.

    The module under test has no dwell time, which is no matter of one state, unless there are
    `cycles` of its parameters: then vectors are sequences.
    """
    names = [f"in_{i}" for i in range(module.plan.n)]
    answer_bits, symbol_bits = module.symbol_bits + module.tells, module.symbol_bits
    now = cycles is None and module.has_state
    clocked = module.clocked or cycles is not None
    clocks = ("clk", "rst", "valid_in", "valid_out") * clocked
    answers = ("in_force",) * now + ("symbol", "outside")[: 1 + module.tells]
    wires = [*zip((*clocks, *module.inputs, *answers), (*clocks, *names, *answers))]
    connected = ",\n".join(f"        .{port}({name})" for port, name in wires)
    answer = "{outside, symbol}" if module.tells else "symbol"
    signals = [
        *(f"    reg [{width - 1}:0] {name};" for name, width in zip(names, module.widths)),
        *[f"    reg [{symbol_bits - 1}:0] in_force;"] * now,
        f"    wire [{symbol_bits - 1}:0] symbol;",
        *["    wire outside;"] * module.tells,
        f"    reg [{answer_bits - 1}:0] expected;",
        *["    reg clk, rst, valid_in;", "    wire valid_out;"] * clocked,
    ]
    declared = "\n".join(signals)
    end, driver = "", CLOCKED if clocked else PLAIN
    if cycles is not None:
        end, driver = "_sequence", SEQUENCES.replace("BITS", str(bits))
    sent = answer_bits + sum(module.widths) + symbol_bits * now
    place = f"[{answer_bits + symbol_bits - 1}:{answer_bits}]"
    put = f"\n            in_force = vector{place};\n            #1;" * now
    return f"""\
module {module.name}{end}_tb;
    parameter VECTORS = "{module.name}{end}.mem";
    localparam COUNT = {count};
    reg [{bits - 1}:0] vectors [0:COUNT - 1];
    reg [{bits - 1}:0] vector;
{declared}
    integer sent, seen, wrong;
    {_under_test(module, cycles)} dut (
{connected}
    );
    task check;
        begin
            vector = vectors[seen];{put}
            expected = vector[{answer_bits - 1}:0];
            if ({answer} !== expected || ^expected === 1'bx) begin
                wrong = wrong + 1;
                if (wrong <= 10)
                    $display("vector %0d (%h): got %b, expected %b",
                        seen, vector, {answer}, expected);
            end
            seen = seen + 1;
        end
    endtask
    task send;
        begin
            vector = vectors[sent];
            {{{", ".join(names)}}} = vector[{sent - 1}:{answer_bits + symbol_bits * now}];
            sent = sent + 1;
        end
    endtask
{driver}
{FRAME}
endmodule""".splitlines()


def _under_test(module: Module, cycles: dict[str, int] | None) -> str:
    """Return what is tested, with its parameters."""
    if cycles is None:
        return module.core + " #(.DWELL_CYCLES(64'd0))" * module.dwell
    given = ",\n".join(f"        .{name}(64'd{value})" for name, value in cycles.items())
    return f"{module.name} #(\n{given}\n    )" if given else module.name
