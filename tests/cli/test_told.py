"""simulate and verify with exogenous inputs: values, steps, files, ranges, and what is refused."""

import json
import shlex

import numpy as np
import pytest

from capsyn import (
    Box,
    Policy,
    Switching,
    Uniform,
    monte_carlo,
    problems,
    simulate,
    synthesize,
    tracking,
)
from support.processes.command_line import capsyn, error_of
from support.told import ROOMS

LOOP = "--duration 120 --rate 1"
STEPS = "--exogenous setpoint=0:20.5,60.5:22 --exogenous outdoor=30"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("told")
    policy = synthesize(ROOMS)
    policy.save(folder / "rooms.cap")
    policy.at([22, 30]).save(folder / "fixed.cap")
    return folder


@pytest.fixture
def run(folder, monkeypatch):
    """Return what runs a line in the folder and returns what it prints."""
    monkeypatch.chdir(folder)
    return lambda line, **options: capsyn(*shlex.split(line), **options)[0]


@pytest.fixture
def policy(folder):
    return Policy.load(folder / "rooms.cap")


def test_simulate_tells_values_and_steps(run, policy, folder):
    line = f"simulate rooms.cap --x0 26,25 {LOOP} {STEPS} --track T1=setpoint --track T2=24.5"
    row = json.loads(run(f"{line} --json -o t.csv"))
    told = {"setpoint": {0: 20.5, 60.5: 22}, "outdoor": 30}
    wanted = simulate(policy, [26, 25], 120, 1.0, exogenous=told)
    found = {"T1 - setpoint": tracking(wanted, "T1", "setpoint"), "T2 - 24.5": None}
    found["T2 - 24.5"] = tracking(wanted, "T2", 24.5)
    figures = {
        key: {name: value[0] for name, value in one.to_json().items()} for key, one in found.items()
    }
    assert row == wanted.summary()[0] | {"tracking": figures}
    header, *rows = (folder / "t.csv").read_text().splitlines()
    assert header == "time,T1,T2,setpoint,outdoor,cost,symbol,u1,u2"
    setpoints = [float(text.split(",")[3]) for text in rows]
    assert setpoints == [20.5] * 61 + [22.0] * 60  # taken over at the next sample
    wide = tracking(wanted, "T1", "setpoint", 1.5).settling
    assert f", settled within {wide:.4g} min (to 1.5)\n" in run(f"{line} --band 1.5")
    assert "not settled (to 2% of the largest step)\n" in run(line)
    rms = f"{found['T1 - setpoint'].rms:.4g}"
    assert f"\n  T1 - setpoint: rms {rms}, bias " in run(line)


def test_steps_come_from_a_file_beside_values(run, folder):
    (folder / "steps.csv").write_text("time,setpoint\n0,20.5\n60.5,22\n")
    line = f"simulate rooms.cap --x0 26,25 --x0 20,27 {LOOP} --json"
    steps = json.loads(run(f"{line} {STEPS}"))
    assert len(steps) == 2
    assert json.loads(run(f"{line} --exogenous steps.csv --exogenous outdoor=30")) == steps
    (folder / "both.csv").write_text("time,outdoor,setpoint\n0,30,20.5\n60.5,,22\n")
    assert json.loads(run(f"{line} --exogenous both.csv")) == steps


def test_one_step_is_a_step_in_simulate_and_a_range_in_verify(run, policy):
    line = f"{LOOP} --exogenous outdoor=30 --exogenous setpoint=21:24 --json"
    row = json.loads(run(f"simulate rooms.cap --x0 26,25 {line}"))
    told = {"setpoint": {21: 24}, "outdoor": 30}
    assert row == simulate(policy, [26, 25], 120, 1.0, exogenous=told).summary()[0]
    data = json.loads(run(f"verify rooms.cap --monte-carlo 20 --target T1=20:25 {line}"))
    said = data["monte_carlo"]["conditions"]["exogenous"]
    assert said == {"setpoint": {"low": 21.0, "high": 24.0}, "outdoor": 30.0}


@pytest.mark.parametrize(
    "told",
    [
        "--exogenous setpoint=21:24",
        "--exogenous setpoint=0:21,10.000001:24,50.25:21.5",
        "--exogenous steps.csv --exogenous outdoor=31:36 --hold 20 --track T2=25",
        "",
    ],
)
def test_the_line_that_verify_prints_repeats_a_failing_trial(run, policy, folder, told):
    (folder / "steps.csv").write_text("time,setpoint\n0,21\n10.000001,24\n50.25,21.5\n")
    line = f"verify rooms.cap --monte-carlo 30 --target T1=21:22 {LOOP} --seed 3 {told}"
    out = run(f"{line} --track T1=setpoint")
    data = json.loads(run(f"{line} --track T1=setpoint --json"))["monte_carlo"]
    trial = data["failing_trials"][0]
    (again,) = (text for text in out.splitlines() if text.startswith("again"))
    command = again.partition(": capsyn ")[2]
    row = json.loads(run(f"{command} --json"))
    steps = {"0": 21.0, "10.000001": 24.0, "50.25": 21.5}
    if "0:21" in told or "csv" in told:
        assert trial["exogenous"]["setpoint"] == steps
    ranges = {"setpoint": Uniform(21, 24)} if "21:24" in told else {}
    if steps in trial["exogenous"].values():
        ranges["setpoint"] = {float(t): v for t, v in steps.items()}
    if "outdoor" in told:
        ranges["outdoor"] = Uniform(31, 36)
    found = monte_carlo(
        policy,
        30,
        duration=120.0,
        rate=1.0,
        seed=3,
        target=Box([21], [22], names=["T1"]),
        hold=20.0 if "hold" in told else 0.0,
        exogenous=ranges,
        track={"T1": "setpoint"},
    )
    k = trial["trial"]
    assert k == np.flatnonzero(~found.success)[0]
    assert row["initial"] == found.initial[k].tolist()
    assert row["final"] == pytest.approx(found.final[k].tolist(), rel=1e-12)
    assert row["switches"] == found.switches[k]
    (figures,) = found.tracking.values()
    assert row["tracking"]["T1 - setpoint"]["rms"] == pytest.approx(figures.rms[k], rel=1e-12)
    failed = [text for text in out.splitlines() if text.startswith("failed from ")]
    unsettled = f"{np.isnan(figures.settling).sum()} trials had not settled when they ended"
    ends = "\n" if "hold" in told else " (without --hold, where they arrive)\n"
    assert unsettled + ends in out
    assert failed and all(" with setpoint " in text and ", outdoor " in text for text in failed)
    assert "\ntracking     T1 - setpoint, rms: min " in out and "\n             bias: min " in out


def test_a_failing_trial_without_delay_is_repeated_without(run, folder):
    synthesize(ROOMS.replace(delay=3.0), max_level=0).save(folder / "late.cap")
    line = f"verify late.cap --monte-carlo 5 --target T1=18:18.01 {LOOP} --delay 0"
    assert " --delay 0" in run(line)
    assert "--delay 3.0 " in run(f"{line[:-2]} 3")


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ("", "`exogenous` must be given: setpoint, outdoor; got None"),
        ("setpoint=21", "`exogenous` must name setpoint, outdoor; 'outdoor' is missing"),
        (
            "setpoint=21 outdoor=30 T1=3",
            "`exogenous` must name setpoint, outdoor; 'T1' is no exogenous input",
        ),
        ("setpoint=warm outdoor=30", "`exogenous setpoint` must be a number; got 'warm'"),
        ("setpoint=nan outdoor=30", "`exogenous` must be finite; 'setpoint' is not"),
        ("setpoint=21,22 outdoor=30", "`exogenous setpoint` must be a number; got '21,22'"),
        ("setpoint=0:21,30 outdoor=30", "--exogenous setpoint must be TIME:VALUE,TIME:VALUE; got"),
        ("setpoint=0:21, outdoor=30", "--exogenous setpoint must be TIME:VALUE,TIME:VALUE; got"),
        ("setpoint=0:x,9:1 outdoor=30", "`exogenous setpoint` must be a number; got 'x'"),
        ("setpoint=9:21,0:22 outdoor=30", "`exogenous setpoint` must be steps (time, value), "),
        ("setpoint=0:21,0.0:22 outdoor=30", "--exogenous setpoint must have each time once; got"),
        ("setpoint=21 setpoint=22", "--exogenous must give each input once; got 'setpoint' again"),
        ("setpoint=21 s.csv", "--exogenous must give each input once; got 'setpoint' again"),
        ("setpoint", "`exogenous` cannot be read from 'setpoint': No such file"),
        ("twice.csv", "`exogenous` in 'twice.csv' must have each time once; row 4 has 0 again"),
        (
            "equal.csv",
            "`exogenous` in 'equal.csv' must have a column 'time', then one for each input, and "
            "rows; got the columns ['time', 'setpoint', 'setpoint']",
        ),
        ("back.csv", "`exogenous` in 'back.csv' must have times ascending; row 4 has 3"),
        ("none.csv", "`exogenous setpoint` must be steps (time, value), finite, times ascending; "),
        ("binary.csv", "`exogenous` cannot be read from 'binary.csv': it is no CSV text"),
        ("nul.csv", "`exogenous` "),
        ("empty.csv", "`exogenous` cannot be read from 'empty.csv': it has no header"),
        ("word.csv", "`exogenous` in 'word.csv' must have 2 numbers in row 4; got"),
    ],
)
def test_what_simulate_cannot_tell_is_one_line(folder, told, message):
    (folder / "s.csv").write_text("time,setpoint\n0,21\n")
    (folder / "twice.csv").write_text("time,setpoint\n0,21\n\n0,22\n")
    (folder / "equal.csv").write_text("time,setpoint,setpoint\n0,21,22\n")
    (folder / "binary.csv").write_bytes(b"time,\xff\n0,1\n")
    (folder / "nul.csv").write_bytes(b"time,setpoint\n0,\x00\n")
    (folder / "back.csv").write_text("time,setpoint\n0,21\n5,22\n3,22\n")
    (folder / "none.csv").write_text("time,setpoint,outdoor\n0,nan,30\n")
    (folder / "empty.csv").write_text("\n\n")
    (folder / "word.csv").write_text("time,setpoint\n\n0,21\n5,warm\n")
    more = [word for text in told.split() for word in ("--exogenous", text)]
    line = ["simulate", "rooms.cap", "--x0", "26,25", *LOOP.split(), *more, "-o", "never.csv"]
    error = error_of(*line, cwd=folder)
    assert error.startswith(f"error: {message}")
    assert not (folder / "never.csv").exists()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--exogenous setpoint=24:21", "`exogenous setpoint` must have low <= high; got"),
        ("--exogenous setpoint=21,22", "--exogenous setpoint must be one value; got '21,22'"),
        (
            "--exogenous wind=1:2",
            "`exogenous` must name setpoint, outdoor; 'wind' is no exogenous input",
        ),
        ("--exogenous setpoint=a:2", "`exogenous setpoint` must be a number; got 'a'"),
        ("--track T3=setpoint", "`state` must be one of 'T1', 'T2'; got 'T3'"),
        ("--track T1=wind", "`reference` must be one of 'setpoint', 'outdoor'; got 'wind'"),
        ("--track T1", "--track must be NAME=VALUE, once for a name; got 'T1'"),
    ],
)
def test_what_verify_cannot_tell_is_one_line(folder, line, message):
    trials = "verify rooms.cap --monte-carlo 5 --target T1=20:25".split()
    error = error_of(*trials, *LOOP.split(), *line.split(), cwd=folder)
    assert error.startswith(f"error: {message}")


@pytest.mark.parametrize(
    "command",
    ["simulate fixed.cap --x0 22,22", "verify fixed.cap --monte-carlo 3 --target T1=20:25"],
)
def test_a_policy_that_is_told_nothing_takes_no_exogenous_inputs(folder, command):
    line = [*command.split(), *LOOP.split()]
    error = error_of(*line, "--exogenous", "setpoint=22", cwd=folder)
    assert error.startswith("error: `exogenous` must be left out for a model that is told nothing")
    error = error_of(*line, "--track", "T1=setpoint", cwd=folder)
    assert error.startswith("error: `reference` must be a number, since nothing is told; got 'setp")


def test_tracking_of_names_that_are_none_writes_nothing(folder):
    line = f"simulate rooms.cap --x0 26,25 {LOOP} {STEPS} --track T1=wind -o never.png"
    assert "`reference` must be one of" in error_of(*line.split(), cwd=folder)
    assert not (folder / "never.png").exists()


def test_simulate_says_how_it_read_exogenous_inputs(run, folder):
    line = f"simulate rooms.cap --x0 26,25 --x0 22,22 {LOOP} --exogenous"
    out = run(f"{line} setpoint=21:24 --exogenous outdoor=30").splitlines()
    assert out[:2] == ["setpoint: 24 from 21 min", "outdoor: 30 throughout"]
    assert len(out) == 4 and all(text.startswith("from (") for text in out[2:])
    rows = [f"{t},{20 + t / 10},{30 + t / 10}\n" for t in range(12)]
    (folder / "many.csv").write_text("time,setpoint,outdoor\n" + "".join(rows))
    first = ", ".join(f"{20 + t / 10:g} from {t} min" for t in range(5))
    wanted = f"setpoint: {first}, .., 21.1 from 11 min (12 steps)"
    assert run(f"{line} many.csv").splitlines()[0] == wanted


def test_info_says_why_there_is_no_exact_tree(folder):
    priced = ROOMS.replace(switching=Switching(price="3%"))
    policy = synthesize(priced, leaves="affine", max_level=0)
    policy.save(folder / "priced.cap")
    assert policy.cells.priced
    (line,) = (
        text for text in capsyn("info", folder / "priced.cap")[0].splitlines() if "exact tr" in text
    )
    assert line.split("tree")[1].strip().startswith("none, since affine leaves have prices: an exp")


def test_query_says_what_is_outside(run):
    assert "outside" not in run("query rooms.cap 26 25 22 30")
    out = run("query rooms.cap 26 29 22 50")
    left = "T2 = 29 is not in [18, 28], outdoor = 50 is not in [20, 38]"
    assert out.splitlines()[1:] == [f"outside: {left}"]
    assert json.loads(run("query rooms.cap 26 29 22 50 --json"))["outside"] == left


def test_at_writes_the_policy_that_is_left(run, policy, folder):
    out = run("at rooms.cap -o warm.cap --exogenous outdoor=30 --exogenous setpoint=21.5")
    fixed, wanted = Policy.load(folder / "warm.cap"), policy.at([21.5, 30])
    assert out == f"wrote warm.cap: {wanted!r}\n"
    states = policy.domain.sample(200)
    np.testing.assert_array_equal(fixed(states), policy(states, [21.5, 30]))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("rooms.cap --exogenous outdoor=30", "`exogenous` must give setpoint, outdoor; got outd"),
        ("rooms.cap --exogenous 30", "--exogenous must be NAME=VALUE, once for a name; got '30'"),
        (
            "rooms.cap --exogenous outdoor=30 --exogenous setpoint=40",
            "`exogenous` must be one of each: setpoint in [20, 25], outdoor in [20, 38]; got",
        ),
        ("fixed.cap --exogenous outdoor=30", "`exogenous` must be left out: the policy is"),
    ],
)
def test_what_a_policy_cannot_be_fixed_at_is_one_line(folder, line, message):
    error = error_of("at", *line.split(), "-o", "no.cap", cwd=folder)
    assert error.startswith(f"error: {message}") and not (folder / "no.cap").exists()


def test_list_names_exogenous_inputs():
    rows = {row["name"]: row for row in json.loads(capsyn("list", "--json")[0])}
    told = {name: problems.get(name).exogenous for name in problems.names()}
    assert {name: row["exogenous"] for name, row in rows.items()} == {
        name: [] if box is None else list(box.names) for name, box in told.items()
    }
    assert rows["docking"]["exogenous"] == ["wait"] and rows["docking"]["states"] == 6
    lines = {line.split()[0]: line for line in capsyn("list")[0].splitlines() if line.strip()}
    assert " wait " in lines["docking"]
