"""Readings that do not wait for the dwell time, in exports: exact times of switches."""

import dataclasses
import functools
import json
import subprocess

import pytest

from capsyn.errors import ProblemError
from capsyn.exports.export import export
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import NOT_FINITE, OUTSIDE, Plan
from capsyn.exports.verilog.target import TARGET as verilog
from support.at_once import NAN, RATE, STORIES
from support.exports.policies import NODE, made_by, module, read
from support.exports.verilog import run

stories = pytest.mark.parametrize("story", STORIES, ids=lambda story: story.name)


def labels(story):
    """Return the symbols of a story as exports number them."""
    return [symbol % 4 for symbol in story.symbols]


@stories
def test_python(story, tmp_path):
    made = module(made_by(story.policy, "python", tmp_path))
    assert made.TIME_UNIT == "min" and made.AT_ONCE == ((1, 2) if story.at_once else (2,))
    controller = made.Controller()
    found = [controller.step([x], k / RATE)[0] for k, x in enumerate(story.readings)]
    assert found == labels(story)


@stories
def test_javascript(story, tmp_path):
    if not NODE:
        pytest.skip("needs node: apt-get install nodejs")
    path = made_by(story.policy, "javascript", tmp_path)
    readings = [str(x).replace("inf", "Infinity").replace("nan", "NaN") for x in story.readings]
    code = (
        f"const m = await import({json.dumps(str(path))}); const c = new m.Controller();"
        f"const x = [{', '.join(readings)}];"
        f"console.log(JSON.stringify(x.map((v, k) => c.step([v], k / {RATE})[0])));"
    )
    (tmp_path / "story.mjs").write_text(code)
    out = subprocess.run([NODE, tmp_path / "story.mjs"], capture_output=True, text=True, check=True)
    assert json.loads(out.stdout) == labels(story)


@stories
def test_json_says_the_rule(story, tmp_path):
    data = json.loads(made_by(story.policy, "json", tmp_path).read_text())
    assert data["time_unit"] == "min"
    controls, found, since = [s["control"] for s in data["symbols"]], [], None
    for k, x in enumerate(story.readings):  # as the texts under "dwell" say
        symbol, status = read(data, [x])
        if since is None:
            now, since = symbol, k
        elif controls[symbol] == controls[now]:
            now = symbol
        elif status in data["at_once"] or k - since >= data["min_dwell"] * RATE:
            now, since = symbol, k
        found.append(now)
    assert found == labels(story)


@stories
def test_fmu_by_seconds(story, tmp_path):
    fmpy = pytest.importorskip("fmpy")
    from fmpy.fmi2 import FMU2Slave

    path = export(story.policy, "fmu", tmp_path)[0]
    about = fmpy.read_model_description(path)
    unit = FMU2Slave(
        guid=about.guid,
        unzipDirectory=fmpy.extract(path, tmp_path / "unit"),
        modelIdentifier=about.coSimulation.modelIdentifier,
        instanceName="unit",
    )
    unit.instantiate()
    unit.setupExperiment(startTime=0.0)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    found = []
    for k, x in enumerate(story.readings):
        unit.setReal([0], [x])
        unit.doStep(float(k), 1.0)  # time of FMI is in seconds, and so is a reading
        found += unit.getInteger([0])
    unit.terminate()
    unit.freeInstance()
    assert found == labels(story)


BENCH = """
module story_tb;
    reg clk = 1'b0, rst = 1'b1, valid_in = 1'b0;
    reg [{top}:0] readings [0:{last}];
    reg signed [{top}:0] x;
    wire valid_out, outside;
    wire [1:0] symbol;
    integer k = 0;
    relay dut (.clk(clk), .rst(rst), .valid_in(valid_in), .x(x), .valid_out(valid_out),
        .symbol(symbol), .outside(outside));
    always #5 clk = ~clk;
    initial begin $readmemh("readings.mem", readings); #22 rst = 1'b0; end
    always @(negedge clk) if (!rst) begin
        if (valid_out) $display("%0d", symbol);
        valid_in = k <= {last};
        if (valid_in) x = readings[k];
        k = k + 1;
        if (k > {last} + 20) $finish;
    end
endmodule
"""
FINITE = [story for story in STORIES if NAN not in story.readings and story.name[0] != "i"]


@pytest.mark.parametrize("pipeline", [False, 1])
@pytest.mark.parametrize("story", FINITE, ids=lambda story: story.name)
def test_verilog_by_clocks(story, pipeline, tmp_path):
    plan = Plan.of(story.policy)
    options = {"inputs": "fixed", "bits": 16, "fraction": 8, "clock_hz": 1, "pipeline": pipeline}
    files = verilog.files(plan, golden_vectors(plan), **options).files
    (tmp_path / "relay.v").write_bytes(files["relay.v"])
    bench = BENCH.format(top=15, last=len(story.readings) - 1)
    (tmp_path / "story_tb.v").write_text(bench)
    numbers = (f"{round(x * 256) % 2**16:x}" for x in story.readings)
    (tmp_path / "readings.mem").write_text("\n".join(numbers))
    run(tmp_path, "iverilog", "-g2005", "-o", "story.vvp", "relay.v", "story_tb.v")
    assert list(map(int, run(tmp_path, "vvp", "-n", "story.vvp").split())) == labels(story)
    assert run(tmp_path, "verilator", "--lint-only", "-Wall", "relay.v") == ""


def test_a_clock_of_other_units_of_time(tmp_path):
    def cycles(unit, dwell):
        policy = dataclasses.replace(STORIES[0].policy, time_unit=unit)
        plan = Plan.of(policy, dwell=dwell)
        text = verilog.files(plan, golden_vectors(plan), clock_hz=1000).files["relay.v"].decode()
        return next(line.strip() for line in text.splitlines() if "between switches, in" in line)

    assert cycles("min", 5.0) == "// at least 300 s between switches, in whole clocks"
    assert cycles("h", 0.1) == "// at least 360 s between switches, in whole clocks"
    assert cycles("ms", 2.5) == "// at least 2500 us between switches, in whole clocks"
    assert cycles("us", 2.5) == "// at least 2500 ns between switches, in whole clocks"
    assert cycles("ns", 2.5) == "// at least 3 ns between switches, in whole clocks"
    with pytest.raises(ProblemError, match=r"clocks of 1000 Hz; got 1E\+14 d"):
        cycles("d", 1e14)


def test_a_plan_takes_the_rule_of_the_policy_unless_told():
    waits, at_once = STORIES[2].policy, STORIES[3].policy
    plan = functools.partial(Plan.of, dwell=1.0)
    assert plan(waits).at_once == plan(at_once, outside_at_once=False).at_once == (NOT_FINITE,)
    assert plan(at_once).at_once == plan(waits, outside_at_once=True).at_once
    assert plan(at_once).at_once == (OUTSIDE, NOT_FINITE)
    said = "The symbol of a state outside does not wait for that"
    assert said in plan(at_once).header and said not in plan(waits).header
    with pytest.raises(ProblemError, match="`outside_at_once` must be True or False; got 1"):
        Plan.of(waits, outside_at_once=1)
