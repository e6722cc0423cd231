"""A test bench that runs the golden vectors through a module and checks it."""

from __future__ import annotations

import numpy as np

from capsyn.exports.golden import Golden, decide
from capsyn.exports.plan import NOT_FINITE, OK
from capsyn.exports.verilog.module import Module
from capsyn.exports.verilog.ports import port_numbers, quantised_readings
from capsyn.exports.verilog.words import comment

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

    A line holds, from the highest bits on, the inputs in order, whether the state is outside (for
    fixed-point ports or a policy with gaps), and the symbol. States that are not finite are left
    out.
    """
    plan, ports = module.plan, module.ports
    used = (golden.statuses != NOT_FINITE) & np.isfinite(golden.readings).all(axis=1)
    about = [f"Golden vectors: {int(used.sum())}; {int((~used).sum())} not finite, left out."]
    if ports is None:
        columns = golden.steps[used]
        labels = plan.tree.cells.labels(columns)
        beyond = int((golden.statuses[used] != OK).sum())
        about[0] += f" Of {beyond} outside the domain, the nearest steps were taken."
        outside, at_ports = labels == plan.gap, None
        labels = np.where(outside, plan.safe, labels)
    else:
        readings = golden.readings[used]
        columns = port_numbers(ports, readings)
        at_ports = decide(plan, quantised_readings(plan, ports, columns))
        labels, outside = at_ports.labels, at_ports.statuses != OK
        room = np.array([2.0**-port.fraction for port in ports])
        least = np.array([port.least for port in ports]) * room
        most = np.array([port.most for port in ports]) * room
        beyond = int(((readings < least) | (readings > most)).any(axis=1).sum())
        about[0] += f" {beyond} beyond a port, saturated."
    words = np.zeros(len(columns), dtype=object)
    for i, width in enumerate(module.widths):
        words = (words << width) + (columns[:, i].astype(object) & (2**width - 1))
    if module.tells:
        words = (words << 1) + outside.astype(int).astype(object)
    words = (words << module.symbol_bits) + labels.astype(object)
    bits = sum(module.widths) + module.tells + module.symbol_bits
    digits = (bits + 3) // 4
    head = comment([*plan.header, *about])
    vectors = "\n".join([*head, *(f"{word:0{digits}x}" for word in words.tolist())]) + "\n"
    text = "\n".join([*head, *_text(module, len(words), bits)]) + "\n"
    return text.encode("ascii"), vectors.encode("ascii"), about, at_ports


def _text(module: Module, count: int, bits: int) -> list[str]:
    """Return the test bench for some vectors of a number of bits.

    The module under test has no dwell time, which is no matter of one state.
    """
    names = [f"in_{i}" for i in range(module.plan.n)]
    answer_bits = module.symbol_bits + module.tells
    clocks = ("clk", "rst", "valid_in", "valid_out") * module.clocked
    answers = ("symbol", "outside")[: 1 + module.tells]
    wires = [*zip((*clocks, *module.inputs, *answers), (*clocks, *names, *answers))]
    connected = ",\n".join(f"        .{port}({name})" for port, name in wires)
    answer = "{outside, symbol}" if module.tells else "symbol"
    signals = [
        *(f"    reg [{width - 1}:0] {name};" for name, width in zip(names, module.widths)),
        f"    wire [{module.symbol_bits - 1}:0] symbol;",
        *["    wire outside;"] * module.tells,
        f"    reg [{answer_bits - 1}:0] expected;",
        *["    reg clk, rst, valid_in;", "    wire valid_out;"] * module.clocked,
    ]
    declared = "\n".join(signals)
    return f"""\
module {module.name}_tb;
    parameter VECTORS = "{module.name}.mem";
    localparam COUNT = {count};
    reg [{bits - 1}:0] vectors [0:COUNT - 1];
    reg [{bits - 1}:0] vector;
{declared}
    integer sent, seen, wrong;
    {module.name}{" #(.DWELL_CYCLES(64'd0))" if module.dwell else ""} dut (
{connected}
    );
    task check;
        begin
            vector = vectors[seen];
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
            {{{", ".join(names)}}} = vector[{bits - 1}:{answer_bits}];
            sent = sent + 1;
        end
    endtask
{CLOCKED if module.clocked else PLAIN}
{FRAME}
endmodule""".splitlines()
