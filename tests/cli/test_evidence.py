"""simulate, verify and reproduce: exit codes, one-line errors, JSON, evidence kept in the file."""

import csv
import json
import shlex
from xml.etree import ElementTree

import numpy as np
import pytest

from capsyn import Box, Policy, online_controller, problems, simulate, synthesize
from capsyn.verification.monte_carlo import monte_carlo
from capsyn.verification.sentences import circumstances
from capsyn.verification.trials import Uniform
from support.processes.command_line import capsyn

FUNCTIONS = """
import casadi as ca
from capsyn.problems.cart_pendulum import energy

def V(x):
    return ca.fabs(energy(x))

def vector(x):
    return x

def upright(x):
    return ca.fabs(energy(x)) <= 4

def plant(x, u, p):
    return [x[1], (9.81 * ca.sin(x[0]) + p[0] * u[0] * ca.cos(x[0])) / 2]

def plain(x):
    return x[0]

number = 3
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evidence")
    synthesize(problems.plain("cart-pendulum"), max_level=2).save(folder / "pendulum.cap")
    synthesize(problems.plain("double-tank-a"), max_level=3).save(folder / "tank.cap")
    (folder / "f.py").write_text(FUNCTIONS)
    return folder


@pytest.fixture
def run(folder, monkeypatch):
    """Return what runs a command line in the folder and returns (stdout, stderr)."""
    monkeypatch.chdir(folder)
    return capsyn


def test_simulate_prints_and_writes_what_the_function_returns(run, folder):
    policy = Policy.load(folder / "pendulum.cap")
    options = ["--x0", "3.1,-0.5", "--duration", "0.5", "--rate", "100"]
    data = json.loads(run("simulate", "pendulum.cap", *options, "--json", "-o", "t.csv")[0])
    wanted = simulate(policy, [3.1, -0.5], 0.5, 100.0)
    assert data == wanted.summary()[0]
    with open(folder / "t.csv") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time", "theta", "omega", "cost", "symbol", "acceleration"]
    assert np.array_equal([[float(v) for v in row[1:3]] for row in rows[1:]], wanted.states)
    assert run("simulate", "pendulum.cap", *options)[0].startswith("from (3.1, -0.5) to (")


def test_simulate_writes_json_and_pictures(run, folder):
    many = ["--x0", "3.1,0", "--x0", "-1,2", "--duration", "0.2", "--rate", "50"]
    assert len(json.loads(run("simulate", "pendulum.cap", *many, "--json")[0])) == 2
    run("simulate", "pendulum.cap", *many, "-o", "t.json")
    assert np.shape(json.loads((folder / "t.json").read_text())["states"]) == (2, 11, 2)
    run("simulate", "pendulum.cap", *many, "-o", "t.svg")
    ElementTree.parse(folder / "t.svg")


def test_simulate_takes_every_circumstance(run, folder):
    policy = Policy.load(folder / "tank.cap")
    out, _ = run(
        *"simulate tank.cap --x0 0.2,0.3 --duration 1 --rate 200 --noise 0.01,0.02 --delay 0.012 "
        "--disturbance 0.1,-0.1 --min-dwell 0.02 --outside 3 --target x1=0.3:0.5 "
        "--stop-at-target --seed 5 --json".split()
    )
    wanted = simulate(
        policy,
        [0.2, 0.3],
        1.0,
        200.0,
        noise=[0.01, 0.02],
        delay=0.012,
        disturbance=[0.1, -0.1],
        min_dwell=0.02,
        outside=3,
        target=Box([0.3], [0.5], names=["x1"]),
        stop_at_target=True,
        seed=5,
    )
    assert json.loads(out) == wanted.summary()[0] and wanted.ended == "target"


@pytest.mark.parametrize(
    "drawn",
    [
        "--model f.py:plant --parameter gain=0.2:1 --delay 0:0.05",
        "--disturbance=-0.1,0:0.2,0.1 --min-dwell 0.1 --hold 0.1 --outside nearest",
    ],
)
def test_the_line_that_verify_prints_repeats_a_failing_trial(run, folder, drawn):
    options = f"verify pendulum.cap --monte-carlo 5 --duration 0.5 --rate 50 {drawn} --seed 4"
    out, _ = run(*options.split())
    trials = json.loads(run(*options.split(), "--json")[0])["monte_carlo"]["failing_trials"]
    (line,) = (line for line in out.splitlines() if line.startswith("again"))
    told, _, command = line.partition(": capsyn ")
    assert told.endswith("the first of them")
    again = json.loads(run(*shlex.split(command), "--json")[0])
    policy = Policy.load(folder / "pendulum.cap")
    ranges = {
        "gain": {"parameters": {"gain": Uniform(0.2, 1)}, "delay": Uniform(0, 0.05)},
        "hold": {"disturbance": Uniform([-0.1, 0], [0.2, 0.1]), "min_dwell": 0.1, "hold": 0.1},
    }["gain" if "gain" in drawn else "hold"]
    model = half_as_strong if "gain" in drawn else None
    found = monte_carlo(policy, 5, duration=0.5, rate=50.0, seed=4, model=model, **ranges)
    first = int(np.flatnonzero(~found.success)[0])
    assert trials[0]["trial"] == first and again["initial"] == found.initial[first].tolist()
    assert again["final"] == pytest.approx(found.final[first].tolist(), rel=1e-9)
    assert trials[0]["delay"] == found.delays[first]
    said = next(line for line in out.splitlines() if line.startswith("failed from"))
    if "gain" in drawn:
        assert f"with gain {found.parameters['gain'][first]:.6g}, delay" in said
    else:
        assert f"with disturbance ({found.disturbances[first][0]:g}, " in said


def test_noise_is_not_repeated(run):
    options = "verify pendulum.cap --monte-carlo 3 --duration 0.2 --rate 50 --noise 0:0.1"
    out, _ = run(*options.split())
    assert "with noise (0." in out and "but for its noise, which is drawn anew: capsyn sim" in out
    assert "--noise 0." in out


def test_simulate_online_and_another_plant(run, folder):
    policy = Policy.load(folder / "pendulum.cap")
    start, to = "simulate pendulum.cap --x0 2,1 --duration 0.3 --rate 50 --json", ([2, 1], 0.3, 50)
    for more, controller, options in (
        ("--online ssac", online_controller(policy), {}),
        ("--online sac", online_controller(policy, "sac"), {}),
        ("--online ssac --background", online_controller(policy, default=policy), {}),
        ("--model cart-pendulum-4", policy, {"model": problems.plain("cart-pendulum-4")}),
        (
            "--model f.py:plant --parameter gain=0.5",
            policy,
            {"model": half_as_strong, "parameters": {"gain": 0.5}},
        ),
    ):
        found = json.loads(run(*start.split(), *more.split())[0])
        assert found == simulate(controller, *to, **options).summary()[0]


def half_as_strong(x, u, p):
    return [x[1], (9.81 * np.sin(x[0]) + p[0] * u[0] * np.cos(x[0])) / 2]


def test_a_start_is_drawn_where_none_is_given(run, folder):
    data = json.loads(run(*"simulate tank.cap --duration 0.01 --seed 3 --json".split())[0])
    assert data["initial"] == Policy.load(folder / "tank.cap").domain.sample(1, 3)[0].tolist()


def test_verify_gives_the_figures_of_every_kind(run, folder):
    policy = Policy.load(folder / "pendulum.cap")
    out, _ = run(
        *"verify pendulum.cap --monte-carlo 40 --duration 4 --rate 200 --within 3 --hold 0.5 "
        "--initial omega=-1:1 --target f.py:upright --noise 0:0.01 --delay 0.01 --seed 2 "
        "--lyapunov f.py:V --depth 4 --grid 0.1 --agreement 500 --json".split()
    )
    data = json.loads(out)
    assert set(data) == {"monte_carlo", "lyapunov", "agreement", "missed"} and data["missed"] == []
    assert data["monte_carlo"]["trials"] == 40
    assert data["monte_carlo"]["conditions"]["noise"] == {"low": 0.0, "high": 0.01}
    grid = data["lyapunov"]["grid"]
    assert sum(grid["counts"].values()) == np.prod(grid["states"])
    assert data["agreement"]["states"] == 500
    assert policy.evidence == {}


def test_verify_without_a_kind_does_what_the_file_allows(run):
    data = json.loads(run("verify", "tank.cap", "--json")[0])
    assert data["monte_carlo"]["trials"] == 1000 and data["agreement"]["states"] == 100_000


def test_a_requirement_that_is_missed_is_exit_status_1(run):
    short = "verify tank.cap --monte-carlo 50 --duration 0.05 --rate 100".split()
    out, err = run(*short, "--require-success", "0.9", code=1)
    assert "of 50 trials succeed" in out and err.startswith("--require-success 0.9 is not met: 0.")
    data = json.loads(run(*short, "--require-success", "0.9", "--json", code=1)[0])
    assert len(data["missed"]) == 1
    run(*short, "--require-success", data["monte_carlo"]["success_rate"])  # just met
    run("verify", "tank.cap", "--agreement", 200, "--require-agreement", "1", code=1)


def test_evidence_is_kept_in_the_file_and_told_by_info(run, folder):
    before = Policy.load(folder / "tank.cap")
    run(*"verify tank.cap --monte-carlo 20 --duration 1 --rate 100 --save".split())
    run(*"verify tank.cap --agreement 100 --save".split())
    after = Policy.load(folder / "tank.cap")
    assert set(after.evidence) == {"sha256", "monte_carlo", "agreement"}
    assert after.evidence["monte_carlo"]["trials"] == 20
    assert (after.cells.entries == before.cells.entries).all()
    out = run("info", "tank.cap")[0]
    lines = out[out.index("\nmonte carlo  ") :].splitlines()[1:]
    assert lines[1].endswith(", within 1 s") and lines[2].endswith("rate 100")
    assert lines[3].startswith("agreement    ")  # what trials were about stands with them


WRONG = [
    ("verify tank.cap --monte-carlo 0", "`trials` must be"),
    ("verify tank.cap --monte-carlo 5 --rate 0", "`rate` must be"),
    ("verify tank.cap --monte-carlo 5 --rate -1", "`rate` must be"),
    ("verify tank.cap --monte-carlo 5 --hold 30", "`hold` must be"),
    ("verify tank.cap --monte-carlo 5 --noise -1", "`noise` must be"),
    ("verify tank.cap --monte-carlo 5 --noise x", "`--noise` must be a number"),
    ("verify tank.cap --monte-carlo 5 --delay 2:1", "`delay` must have low <= high"),
    ("verify tank.cap --monte-carlo 5 --target x1=2:3", "`target` must meet the domain"),
    ("verify tank.cap --monte-carlo 5 --target y=2:3", "--target must name states among x1, x2"),
    ("verify tank.cap --monte-carlo 5 --target x1=0.5", "--target must be NAME=LOW:HIGH"),
    ("verify tank.cap --monte-carlo 5 --target f.py:number", "must hold a function"),
    ("verify tank.cap --monte-carlo 5 --initial x1", "--initial must be NAME=VALUE"),
    ("verify tank.cap --monte-carlo 5 --model cart-pendulum", "`model` must have 2 state"),
    ("verify tank.cap --monte-carlo 5 --parameter a=1", "`parameters` need a `model`"),
    ("verify tank.cap --monte-carlo 5 --online mpc", "`method` must be one of"),
    ("verify tank.cap --monte-carlo 5 --background", "--background needs --online"),
    ("verify tank.cap --monte-carlo 5 --confidence 1", "`confidence` must be"),
    (
        "verify pendulum.cap --monte-carlo 5 --tolerance 1",
        "`tolerance` must be given with a target that is a ball",
    ),
    ("verify tank.cap --monte-carlo 5 --target x1=2:3 --tolerance 1", "--target must be NAME=LOW"),
    ("verify tank.cap --monte-carlo 5 --within 50", "`within` must be at most"),
    ("verify tank.cap --monte-carlo 5 --noise 0:1:2", "--noise must be a value or a range"),
    ("verify tank.cap --monte-carlo 5 --online ssac --save", "--save keeps evidence of the policy"),
    ("verify tank.cap --agreement 5 --noise 1", "--noise needs --monte-carlo"),
    ("verify tank.cap --agreement 5 --model f.py:plant", "--model needs --monte-carlo"),
    ("verify tank.cap --agreement 5 --outside-at-once", "--outside-at-once needs --monte-carlo"),
    ("verify tank.cap --agreement 5 --background", "--background needs --monte-carlo"),
    ("verify tank.cap --agreement 5 --depth 3", "--depth needs --lyapunov"),
    ("verify tank.cap --monte-carlo 5 --target f.py:plain", "`target` must return a condition"),
    ("verify pendulum.cap --lyapunov f.py:vector", "`V` must return a scalar"),
    ("verify pendulum.cap --lyapunov f.py", "a function must be given as FILE.py:NAME"),
    ("verify pendulum.cap --lyapunov none.py:V", "there is no file 'none.py'"),
    ("verify pendulum.cap --lyapunov f.py:V --depth -1", "`depth` must be"),
    ("verify pendulum.cap --lyapunov f.py:V --grid 0", "`spacing` must be"),
    ("verify pendulum.cap --grid 0.1 --agreement 5", "--grid needs --lyapunov"),
    ("verify pendulum.cap --agreement 0", "`states` must be"),
    ("verify pendulum.cap --agreement 5 --require-success 1", "--require-success needs"),
    ("verify pendulum.cap --agreement 5 --require-agreement 2", "must be between 0 and 1"),
    ("simulate tank.cap --x0 1", "--x0 must be 2 number(s) (x1, x2)"),
    ("simulate tank.cap --x0 1,2 --x0 1", "--x0 must be 2 number(s)"),
    ("simulate tank.cap --x0 1,nan", "`x0` must be finite"),
    ("simulate tank.cap --duration 0", "`duration` must be"),
    ("simulate tank.cap --duration 1e9 --rate 1e9", "`duration` times `rate`"),
    ("simulate tank.cap -o t.xls", "the output must end in .csv, .json, .png"),
    ("simulate tank.cap -o none/t.csv", "cannot write the output"),
    ("simulate tank.cap --noise 0:1", "--noise must be one value"),
    ("simulate tank.cap --seed -1", "`--seed` must be"),
    ("reproduce -o f.py", "cannot make the directory"),
    ("reproduce -o out --trials 0", "`trials` must be"),
]


@pytest.mark.parametrize(("line", "reason"), WRONG)
def test_wrong_input_is_one_line(run, line, reason):
    out, err = run(*line.split(), code=2)
    assert out == "" and err.startswith("error: ") and err.count("\n") == 1 and reason in err


def test_trials_start_at_the_value_that_is_fixed(run):
    rows = [
        json.loads(run("verify", "tank.cap", "--monte-carlo", "5", "--initial", text, "--json")[0])
        for text in ("x1=0:0", "x1=0", "x1=0,x2=0.2:0.4")
    ]
    conditions = [row["monte_carlo"]["conditions"]["initial"] for row in rows]
    assert conditions == ["x1 = 0", "x1 = 0", "x1 = 0, x2 in [0.2, 0.4]"]
    starts = monte_carlo(Policy.load("tank.cap"), 5, initial=Box([0], [0], names=["x1"])).initial
    assert (starts[:, 0] == 0).all() and len(set(starts[:, 1])) == 5


def test_reproduce_writes_every_figure_and_a_table_of_the_numbers(run, folder):
    out, _ = run("reproduce", "-o", "paper", "--trials", "10")
    names = {path.name for path in (folder / "paper").iterdir()}
    figures = "figure-3 figure-4a figure-4b figure-5 figure-6a figure-6b dwell-time".split()
    policies = "cart-pendulum cart-pendulum-4 double-tank-a double-tank-b".split()
    assert names == {
        "results.md",
        *(f"{name}.{ending}" for name in figures for ending in ("pdf", "png")),
        *(f"{name}.cap" for name in policies),
    }
    assert all(f"wrote paper/{name}" in out for name in names)
    table = (folder / "paper" / "results.md").read_text()
    rows = [line for line in table.splitlines() if line.startswith("|")]
    assert all(row.replace("\\|", "").count("|") == 5 for row in rows)
    for paper in ("3,428", "8,981", "7,621", "17,125", "3,965", "9,474", "41,842", "166,546"):
        assert paper in table
    policy = Policy.load(folder / "paper" / "double-tank-b.cap")
    row = next(row for row in rows if "case B" in row and "the built-in" in row)
    start = Box([0.1, 0.1], [0.9, 0.9])
    found = monte_carlo(policy, 10, initial=start)
    assert f"| {found.success.sum()} of 10 (" in row


def test_circumstances_are_told_shortly_and_whatever_a_file_says():
    conditions = {"rate": 6.0, "min_dwell": 1 / 3, "delay": 0.0, "noise": {"low": 0.1, "high": 1.0}}
    assert circumstances(conditions) == "rate 6, min dwell 0.333333, noise 0.1 to 1"
    assert circumstances({"noise": {"low": "x", "high": None}}) == "noise x to None"
