import dataclasses
import math
import re

import numpy as np
import pytest

import capsyn
from capsyn import Alphabet, Box, Policy
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.errors import ProblemError
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.verilog.target import TARGET as target
from support.exports.policies import PROBLEMS, built_in
from support.exports.verilog import check, run, simulate, tool
from support.trees import GRIDS, random_policy, random_tree

KINDS = [(inputs, pipeline) for inputs in ("lattice", "fixed") for pipeline in (False, True)]


def oblique(n=3, size=40, seed=0, periodic=False):
    """Return a tree policy whose splits are planes, axes and thresholds at random."""
    rng = np.random.default_rng(seed)
    counts = (100, 64, 9)[:n]
    split, threshold, planes = [], [], []

    def grow(leaves):
        if leaves == 1:
            split.append(LEAF)
            threshold.append(int(rng.integers(4)))
            return
        if rng.random() < 0.6:
            row = rng.integers(-20, 21, n)
            split.append(n + len(planes))
            planes.append(row)
            threshold.append(int(row @ rng.integers(counts)))
        else:
            axis = int(rng.integers(n))
            split.append(axis)
            threshold.append(int(rng.integers(1, counts[axis])))
        first = int(rng.integers(1, leaves))
        grow(first)
        grow(leaves - first)

    grow(size)
    second = [0] * len(split)

    def place(node):
        if split[node] == LEAF:
            second[node] = node
            return node + 1
        second[node] = place(node + 1)
        return place(second[node])

    place(0)
    tree = SplitTree(
        counts, *(np.array(a, dtype=np.int32) for a in (split, threshold, second, planes))
    )
    tree.check(4)
    turning = [periodic] + [False] * (n - 1)
    domain = Box(-1 - rng.random(n), 1 + rng.random(n), periodic=turning)
    cells = random_tree((1,) * n, (2,) * n, 0, leaf_count=4)
    source = Policy("oblique", domain, Alphabet([1, 2, 3]), np.zeros(1), cells)
    guarantee = capsyn.compress(source).guarantee
    return capsyn.DecisionTree(
        "oblique", domain, source.alphabet, source.default, tree, guarantee=guarantee
    )


@pytest.mark.parametrize("inputs, pipeline", KINDS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_every_golden_vector_has_its_symbol(name, inputs, pipeline, tmp_path):
    text = check(tmp_path, Plan.of(built_in(name)), inputs=inputs, pipeline=pipeline)
    if inputs == "fixed":
        share = float(re.search(r"whose symbol the rounding changes: (\S+)", text)[1])
        assert share < 0.01


@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_random_policies_on_periodic_axes(grid, tmp_path):
    plan = Plan.of(random_policy(grid, periodic=True, seed=grid))
    for inputs in ("lattice", "fixed"):
        check(tmp_path, plan, inputs=inputs, pipeline=grid % 2 == 1)


def single_split(counts, threshold, lower, upper):
    """Return a tree policy of one split of the first axis."""
    split = np.array([0, LEAF, LEAF], dtype=np.int32)
    numbers = np.array([threshold, 0, 1], dtype=np.int32)
    second = np.array([2, 1, 2], dtype=np.int32)
    n = len(counts)
    tree = SplitTree(counts, split, numbers, second, np.zeros((0, n), dtype=np.int32))
    domain = Box(lower, upper)
    guarantee = capsyn.compress(built_in("double-tank-b")).guarantee
    return capsyn.DecisionTree(
        "single", domain, Alphabet([1, 2]), np.zeros(1), tree, guarantee=guarantee
    )


def test_steps_that_the_tree_does_not_tell_apart_cost_nothing(tmp_path):
    plan = Plan.of(single_split((1 << 30,), 12345, [0.0], [2.0**20]))
    assert len(check(tmp_path, plan, inputs="fixed")) < 10_000


def test_oblique_trees_whose_faces_are_numbers_of_the_port(tmp_path):
    plan = Plan.of(oblique(2, seed=3))
    domain = Box([-0.5, -4.0], [0.5, 4.0])
    tree = dataclasses.replace(plan.policy.cells, counts=(128, 64))
    policy = dataclasses.replace(plan.policy, domain=domain, cells=tree)
    check(tmp_path, Plan.of(policy), inputs="fixed")


def test_expected_symbols_of_fixed_point_ports_are_those_of_their_numbers():
    plan = Plan.of(random_policy(3, periodic=True))
    golden = golden_vectors(plan)
    assert target.files(plan, golden).golden is None
    found = target.files(plan, golden, inputs="fixed").golden
    rounded = decide(plan, found.readings)
    np.testing.assert_array_equal(found.labels, rounded.labels)
    finite = golden.statuses != 2
    assert (found.readings != golden.readings[finite]).any()
    assert (found.labels != golden.labels[finite]).any()  # beside the faces


@pytest.mark.parametrize("inputs, pipeline", KINDS)
def test_oblique_trees(inputs, pipeline, tmp_path):
    for periodic in (False, True):
        plan = Plan.of(oblique(periodic=periodic, seed=int(periodic)))
        check(tmp_path, plan, inputs=inputs, pipeline=pipeline)


def test_readings_are_scaled(tmp_path):
    for policy in (random_policy(3, periodic=True), oblique(2, periodic=True)):
        plan = Plan.of(policy, scale=[0.01, -3e-5], offset=[0.3, 1e-3])
        text = check(tmp_path, plan, inputs="fixed")
        assert "State 1 = -3e-05 * reading + 0.001" in text


def test_counts_of_a_sensor_fill_a_port(tmp_path):
    domain = Box([0.0], [2 * math.pi], periodic=[True])
    policy = Policy("encoder", domain, Alphabet([-1, 1]), np.zeros(1), random_tree((9,), (2,), 4))
    plan = Plan.of(policy, scale=2 * math.pi / 4096)
    check(tmp_path, plan, inputs="fixed", bits=13, fraction=0)


@pytest.mark.parametrize("periodic", [False, True])
def test_expected_symbols_are_the_policys_at_the_quantised_states(periodic):
    policy = random_policy(3, periodic=periodic)
    plan, domain = Plan.of(policy), policy.domain
    files = target.files(plan, golden_vectors(plan), inputs="fixed").files
    about = re.findall(r"^// x\d: (\d+) bits, fraction (\d+)", files["random.v"].decode(), re.M)
    seen = 0
    for line in files["random.mem"].decode().splitlines():
        if line.startswith("//"):
            continue
        word, state = int(line, 16), []
        symbol, outside, word = word & 3, word >> 2 & 1, word >> 3
        for bits, fraction in reversed([tuple(map(int, pair)) for pair in about]):
            value, word = word % 2**bits, word >> bits
            state.insert(0, (value - (value >> (bits - 1) << bits)) / 2**fraction)
        inside = bool(domain.contains(np.array([state]))[0])
        assert outside == (not inside)
        within = all(low <= x < high for low, x, high in zip(domain.lower, state, domain.upper))
        if within:
            assert symbol == policy(np.array(state)) % 3
            seen += 1
    assert seen > 1000


def test_outside_takes_the_nearest_or_the_safe_symbol(tmp_path):
    assert built_in("cart-pendulum").outside == "nearest"
    check(tmp_path, Plan.of(built_in("double-tank-b"), safe=1), inputs="fixed")


def test_a_single_leaf(tmp_path):
    cells = random_tree((1, 1), (2, 2), 0)
    policy = Policy("leaf", Box([0, 0], [1, 1]), Alphabet([1, 2]), np.zeros(1), cells)
    for inputs, pipeline in KINDS:
        check(tmp_path, Plan.of(policy), inputs=inputs, pipeline=pipeline)


def test_a_wrong_symbol_is_found(tmp_path):
    plan = Plan.of(built_in("double-tank-b"))
    files = target.files(plan, golden_vectors(plan)).files
    lines = files["double_tank_b.mem"].decode().splitlines()
    lines[-1] = f"{int(lines[-1], 16) ^ 1:0{len(lines[-1])}x}"
    files["double_tank_b.mem"] = ("\n".join(lines) + "\n").encode()
    assert "FAIL: 1 wrong" in simulate(tmp_path, files)
    files["double_tank_b.mem"] = b"\n"
    told = simulate(tmp_path, files)
    assert "FAIL: no vectors in double_tank_b.mem; run where it lies" in told


DWELL_BENCH = """
module dwell_tb;
    reg clk = 1'b0, rst = 1'b1, valid_in = 1'b0;
    reg [7:0] vectors [0:{last}];
    reg [5:0] step;
    wire valid_out;
    wire [1:0] symbol;
    integer k = 0;
    dwell #(.CLOCK_HZ(64'd{clock})) dut (.clk(clk), .rst(rst), .valid_in(valid_in),
        .x1_step(step), .valid_out(valid_out), .symbol(symbol));
    always #5 clk = ~clk;
    initial begin $readmemh("steps.mem", vectors); #22 rst = 1'b0; end
    always @(negedge clk) if (!rst) begin
        if (valid_out) $display("%0d", symbol);
        valid_in = k <= {last};
        if (valid_in) step = vectors[k][5:0];
        k = k + 1;
        if (k > {last} + 20) $finish;
    end
endmodule
"""


@pytest.mark.parametrize("clock", [50e6, 100e6])
@pytest.mark.parametrize("dwell", [0.1 * 3, 500 / 1.3, 86400.0, 1e6 / 3])
def test_clocks_of_long_dwell_times(clock, dwell, tmp_path):
    plan = Plan.of(random_policy(3), dwell=dwell)
    written = target.files(plan, golden_vectors(plan), clock_hz=clock, name="top").files
    written["show.v"] = (
        b"module show; wire [1:0] s; wire v; top dut(1'b0, 1'b0, 1'b0, 5'd0, 5'd0, v, s);"
        b' initial begin $display("%0d", dut.DWELL_CYCLES); $finish; end endmodule\n'
    )
    for name in ("top.v", "show.v"):
        (tmp_path / name).write_bytes(written[name])
    run(tmp_path, "iverilog", "-g2005", "-o", "show.vvp", "top.v", "show.v")
    found = int(run(tmp_path, "vvp", "-n", "show.vvp"))
    assert abs(found - dwell * clock) <= 1 + 1e-12 * dwell * clock


def test_dwell_times_beyond_the_counter():
    plan = Plan.of(random_policy(3), dwell=1e12)
    with pytest.raises(ProblemError, match="`dwell` must be less than 2.63 clocks of 50000000 Hz"):
        target.files(plan, golden_vectors(plan))


@pytest.mark.parametrize("pipeline", [False, True])
def test_dwell_time_is_that_of_the_closed_loop(pipeline, tmp_path):
    cells = random_tree((5,), (3,), 2)
    for default in (0.0, -1.0):  # a control that no symbol has, and one that a symbol has
        policy = Policy("dwell", Box([-1], [1]), Alphabet([-1, 1]), np.array([default]), cells)
        for clock, dwell in ((100, 0.07), (10, 0.25), (50, 0.02), (3, 0.1)):
            plan = Plan.of(policy, dwell=dwell)
            check(tmp_path, plan, pipeline=pipeline)
            found = decide(plan, policy.domain.sample(300, 1))
            bench = DWELL_BENCH.format(last=299, clock=clock)
            (tmp_path / "dwell_tb.v").write_text(bench)
            (tmp_path / "steps.mem").write_text("\n".join(f"{k:x}" for k in found.steps[:, 0]))
            run(tmp_path, "iverilog", "-g2005", "-o", "dwell.vvp", "dwell.v", "dwell_tb.v")
            told = [int(text) for text in run(tmp_path, "vvp", "-n", "dwell.vvp").split()]
            controls, held, symbol, expected = policy.controls[:, 0], 0, None, []
            for wanted in found.labels.tolist():
                changes = symbol is None or controls[wanted] != controls[symbol]
                take = held == 0 or not changes or held >= math.ceil(dwell * clock - 1e-9)
                held = 1 if (changes and take) or held == 0 else held + 1
                symbol = wanted if take else symbol
                expected.append(symbol)
            assert told == expected


def test_dwell_time_with_fixed_point_ports(tmp_path):
    plan = Plan.of(random_policy(3, periodic=True), dwell=0.1)
    for pipeline in (False, 2):
        check(tmp_path, plan, inputs="fixed", pipeline=pipeline)


def test_synthesis(tmp_path):
    tool("yosys")
    cells = {}
    for inputs in ("lattice", "fixed"):
        plan = Plan.of(built_in("double-tank-b"))
        files = target.files(plan, golden_vectors(plan), inputs=inputs, name="top").files
        (tmp_path / "top.v").write_bytes(files["top.v"])
        told = run(tmp_path, "yosys", "-p", "read_verilog top.v; synth_ice40 -top top; stat")
        warnings = re.findall("^.*warning.*$", told, re.M | re.I)
        assert not [text for text in warnings if not text.startswith("ABC: ")]
        cells[inputs] = int(re.findall(r"Number of cells:\s+(\d+)", told)[-1])
    print(f"cells of double-tank-b: {cells}")
    assert 0 < cells["lattice"] < 60 and 0 < cells["fixed"] < 200


def test_names_that_the_language_keeps(tmp_path):
    names = ["symbol", "reg", "z0", "logic", "ünit", "9 9"]
    n = len(names)
    policy = Policy(
        "module",
        Box(-np.ones(n), np.ones(n), names=names, units=["°C"] * n),
        Alphabet([1, 2], names=["on", "off \\"]),
        np.zeros(1),
        random_tree((1,) * n, (2,) * n, 1),
    )
    text = check(tmp_path, Plan.of(policy), inputs="fixed")
    for port in ("symbol_2", "reg_2", "z0_2", "logic_2", "unit", "n9_9"):
        assert re.search(rf"^    input wire signed \[\d+:0\] {port},$", text, re.M), port
    assert "module module_2\n" in text
    assert "// Renamed: 'reg' is reg_2" in text


def test_same_input_same_bytes_and_header():
    plan = Plan.of(built_in("double-tank-b"))
    for inputs in ("lattice", "fixed"):
        made = [target.files(plan, golden_vectors(plan), inputs=inputs).files for _ in range(2)]
        assert made[0] == made[1]
        for content in made[0].values():
            for line in plan.header:
                assert line[:60] in content.decode()


def test_bad_options():
    def files(name="double-tank-a", **options):
        plan = Plan.of(built_in(name))
        return target.files(plan, golden_vectors(plan), **options).files

    with pytest.raises(ProblemError, match="would fall together.*at least 9 bits with 8"):
        files(inputs="fixed", bits=8, fraction=6)
    with pytest.raises(ProblemError, match="`bits` and `fraction`"):
        files(bits=8)
    with pytest.raises(ProblemError, match="`pipeline` must be 3 stages at least"):
        files(pipeline=1)
    with pytest.raises(ProblemError, match="inputs"):
        files(inputs="float")
    with pytest.raises(ProblemError, match="one number or 2"):
        files(inputs="fixed", bits=[8, 8, 8])
    with pytest.raises(ProblemError, match="more than 48"):
        files(inputs="fixed", fraction=60)
