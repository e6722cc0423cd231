"""The command line: exit codes, one-line errors, JSON, nothing half-written."""

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from capsyn import Policy
from support.processes.command_line import BOAT, capsyn, error_of, run_apart, run_here


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "pendulum.cap"
    capsyn("synth", "cart-pendulum", "-o", path)
    return path


def test_list_names_every_problem():
    rows = json.loads(capsyn("list", "--json")[0])
    assert [row["name"] for row in rows] == [
        "cart-pendulum",
        "cart-pendulum-4",
        "double-tank-a",
        "double-tank-b",
        "cart-pole",
        "planar-quadrotor",
        "spacecraft",
        "double-pendulum",
        "boost-converter",
        "inverter",
        "building",
        "docking",
        "quadrotor",
    ]
    assert [row["leaves"] for row in rows[-5:-1]] == ["constant", "affine", "affine", "affine"]
    assert "cart-pole" in capsyn("list")[0]


def test_synth_writes_a_policy_and_says_nothing_on_stderr_when_piped(tmp_path):
    out, err = capsyn("synth", "cart-pendulum", cwd=tmp_path, run=run_apart)
    assert err == ""
    assert "9,092" in out and "wrote cart-pendulum.cap" in out
    assert Policy.load(tmp_path / "cart-pendulum.cap").cells.leaf_count == 4158


def test_synth_takes_overrides(tmp_path):
    options = "--max-level 1 --partitions 3,4 --rule steepest --control-weight 0 --steps 12"
    more = "--outside error --min-dwell 0.05 --test-points vertices+random:2 --seed 3 --json"
    more += " --leaves affine --refine adaptive --leaf-error 0.1"
    out, _ = capsyn(
        "synth", "cart-pendulum", "-o", "p.cap", *options.split(), *more.split(), cwd=tmp_path
    )
    data, policy = json.loads(out), Policy.load(tmp_path / "p.cap")
    assert data["file"] == "p.cap" and data["statistics"] == policy.statistics
    assert policy.cells.partitions == (3, 4) and data["max_level"] == 1
    assert policy.settings.rule == "steepest" and policy.settings.steps == 12
    assert policy.settings.control_weight == 0 and policy.min_dwell == 0.05
    assert policy.outside == "error"
    assert policy.statistics["test_points"] == "vertices+random:2"
    assert policy.statistics["leaf_error"] == 0.1
    assert policy.statistics["refine"] == "adaptive" and policy.cells.splits is not None


def test_synth_makes_the_leaves_that_the_problem_asks_for(tmp_path):
    capsyn("synth", "building", "-o", "own.cap", cwd=tmp_path)
    coarse = "--leaves constant --partitions 2 --max-level 0".split()
    capsyn("synth", "building", "-o", "constant.cap", *coarse, cwd=tmp_path)
    own, constant = (Policy.load(tmp_path / f"{name}.cap") for name in ("own", "constant"))
    assert own.cells.affine is not None and own.cells.leaf_count == 640
    assert constant.cells.affine is None and constant.cells.leaf_count == 16


def test_synth_alpha_d_replaces_the_problems_gamma(tmp_path):
    capsyn(
        "synth", "cart-pendulum", "-o", "p.cap", "--alpha-d", "-7", "--max-level", 0, cwd=tmp_path
    )
    assert Policy.load(tmp_path / "p.cap").settings.alpha_d == -7


def test_synth_finds_problems_in_files_and_modules(tmp_path):
    (tmp_path / "boat.py").write_text(BOAT + "other = problem.replace(name='other')\n")
    for text, name in (("boat.py", "boat"), ("boat.py:other", "other"), ("boat:other", "other")):
        capsyn("synth", text, "-o", "p.cap", "--max-level", 1, cwd=tmp_path)
        assert Policy.load(tmp_path / "p.cap").name == name


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["synth", "cart-pendlum"], ["cart-pendlum", "did you mean 'cart-pendulum'"]),
        (["synth", "nothing.py"], ["there is no file 'nothing.py'"]),
        (["synth", "boat.py:nobody"], ["capsyn.Problem named 'nobody'"]),
        (["synth", "broken.py"], ["broken.py", "ZeroDivisionError"]),
        (["synth", "no.such.module:problem"], ["no.such.module", "ModuleNotFoundError"]),
        (["synth", "cart-pendulum", "-o", "none/p.cap"], ["none/p.cap", "No such file"]),
        (["synth", "cart-pendulum", "-o", "."], ["is a directory"]),
        (["synth", "cart-pendulum", "--max-level", "13"], ["`max_level`", "GB", "fits"]),
        (["synth", "cart-pendulum", "--max-level", "x"], ["--max-level", "x"]),
        (["synth", "cart-pendulum", "--gamma", "3"], ["`gamma`", "3"]),
        (["synth", "cart-pendulum", "--rule", "best"], ["`rule`", "'schedule'", "'best'"]),
        (["synth", "cart-pendulum", "--partitions", "3,x"], ["--partitions", "3,x"]),
        (["synth", "cart-pendulum", "--partitions", "3,3,3"], ["`partitions`", "[3, 3, 3]"]),
        (["synth", "cart-pendulum", "--outside", "left"], ["`outside`", "'left'"]),
        (["synth", "cart-pendulum", "--backend", "gpu"], ["`backend`", "'gpu'"]),
        (["synth", "cart-pendulum", "--threads", "0"], ["`threads`", "0"]),
        (["synth", "cart-pendulum", "--test-points", "corners"], ["`test_points`", "corners"]),
        (["synth"], ["PROBLEM"]),
        (["fly"], ["fly"]),
        (["info", "nothing.cap"], ["there is no file 'nothing.cap'"]),
        (["info", "boat.py"], ["boat.py", "no policy"]),
        (["plot", "nothing.cap", "-o", "p.bmp"], [".png", "p.bmp"]),
    ],
)
def test_errors_are_one_line_and_exit_2(tmp_path, arguments, words):
    (tmp_path / "boat.py").write_text(BOAT)
    (tmp_path / "broken.py").write_text("1 / 0\n")
    message = error_of(*arguments, cwd=tmp_path)
    assert all(word in message for word in words), message
    assert sorted(os.listdir(tmp_path)) == ["boat.py", "broken.py"]


def test_query_answers_like_the_policy(pendulum):
    policy = Policy.load(pendulum)
    for state in ([3.1, -0.5], [0.2, 1.0], [-1.0, -9.0]):
        data = json.loads(capsyn("query", pendulum, *state, "--json")[0])
        assert data["symbol"] == policy(state)
        assert data["control"] == policy.control(state).tolist()
        assert data["name"] in capsyn("query", pendulum, *state)[0]


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (["1"], ["2 number(s)", "theta, omega", "got 1"]),
        (["1", "2", "3"], ["2 number(s)", "got 3"]),
        (["1", "nan"], ["must be finite"]),
        (["1", "inf"], ["must be finite"]),
        (["1", "fast"], ["`omega`", "'fast'"]),
        (["1", "9", "--outside", "error"], ["domain", "(1, 9)"]),
    ],
)
def test_query_refuses_what_is_no_state(pendulum, state, words):
    message = error_of("query", pendulum, *state)
    assert all(word in message for word in words), message


def test_info_says_the_same_as_synth(pendulum, tmp_path):
    out, _ = capsyn("synth", "cart-pendulum", "-o", "p.cap", cwd=tmp_path)
    assert out.startswith(capsyn("info", pendulum, "--quick")[0])
    data = json.loads(capsyn("info", pendulum, "--json")[0])
    assert data["cells"] == 4158 and data["hints"] == []
    np.testing.assert_allclose([s["volume_share"] for s in data["symbols"]], [0.5, 0.5], atol=1e-3)


def test_plot_writes_pictures(tmp_path):
    pendulum = tmp_path / "pendulum.cap"
    capsyn("synth", "cart-pendulum", "--max-level", 1, "-o", pendulum)
    for kind, magic in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")):
        path = tmp_path / f"p.{kind}"
        capsyn("plot", pendulum, "-o", path)
        first = path.read_bytes()
        assert first.startswith(magic)
        capsyn("plot", pendulum, "-o", path)
        assert path.read_bytes() == first, f"{kind} differs from run to run"


def test_bench_prints_the_six_cases():
    rows = json.loads(capsyn("bench", "--json")[0])
    assert [row["paper_solves"] for row in rows] == [3428, 8981, 7621, 17125, 3965, 9474]
    assert [row["worst_case"] for row in rows] == [41842, 41842, 41842, 166546, 41842, 166546]
    assert rows[0]["solves"] <= 4700


def test_version():
    from capsyn.version import __version__

    for run in (run_apart, run_here):
        assert capsyn("--version", run=run)[0] == f"capsyn {__version__}\n"


def test_a_compiler_that_builds_nothing_is_no_compiler(tmp_path):
    environment = {"CC": "true", "CAPSYN_CACHE_DIR": str(tmp_path / "cache")}
    _, err = capsyn(
        "synth", "cart-pendulum", "-o", "p.cap", cwd=tmp_path, run=run_apart, **environment
    )
    assert err.startswith("warning: solving with NumPy") and err.count("\n") == 1
    assert Policy.load(tmp_path / "p.cap").cells.leaf_count == 4158


def test_a_safe_symbol_is_taken_by_name_before_index(tmp_path, pendulum):
    for outside, index in (("5", 0), ("-5", 1), ("0", 0), ("1", 1)):
        data = json.loads(capsyn("query", pendulum, 1, 9, f"--outside={outside}", "--json")[0])
        assert data["symbol"] == index


def test_links_are_followed_and_pipes_refused(tmp_path):
    (tmp_path / "real.cap").write_text("old")
    (tmp_path / "link.cap").symlink_to("real.cap")
    capsyn("synth", "cart-pendulum", "-o", "link.cap", cwd=tmp_path)
    assert (tmp_path / "link.cap").is_symlink()
    assert Policy.load(tmp_path / "real.cap").cells.leaf_count == 4158
    os.mkfifo(tmp_path / "pipe.png")
    for arguments in (["synth", "cart-pendulum"], ["plot", "link.cap"]):
        assert "a device or a pipe" in error_of(*arguments, "-o", "pipe.png", cwd=tmp_path)
    assert "is no file" in error_of("info", "pipe.png", cwd=tmp_path)


def test_json_is_json_though_the_problem_file_prints(tmp_path):
    (tmp_path / "boat.py").write_text(BOAT + "print('hello')\n")
    out, err = capsyn("synth", "boat.py", "-o", "p.cap", "--json", "--max-level", 1, cwd=tmp_path)
    assert json.loads(out)["name"] == "boat" and err == "hello\n"


def test_without_a_compiler_there_is_one_warning(tmp_path):
    own = {"cwd": tmp_path, "run": run_apart, "CC": "no-such-compiler"}
    out, err = capsyn("synth", "cart-pendulum", "-o", "p.cap", **own)
    assert err.startswith("warning: ") and err.count("\n") == 1 and "no-such-compiler" in err
    assert "9,092" in out
    _, err = capsyn("synth", "cart-pendulum", "--backend", "c", code=2, **own)
    assert err.startswith("error: no C compiler found") and err.count("\n") == 1


def test_a_terminal_gets_a_progress_bar(tmp_path):
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "capsyn", "synth", "cart-pendulum", "-o", "p.cap"],
        stdout=subprocess.DEVNULL,
        stderr=slave,
        cwd=tmp_path,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "120"},
    )
    os.close(slave)
    text = b""
    while True:
        ready, _, _ = select.select([master], [], [], 60)
        try:
            part = os.read(master, 65536) if ready else b""
        except OSError:  # the other end closed
            part = b""
        if not part:
            break
        text += part
    os.close(master)
    assert process.wait() == 0
    assert b"level 4/4" in text and b"solves" in text


RUNS = "from capsyn.cli.app import main; print('runs', flush=True); main()"


def interrupted(*arguments, cwd):
    """Return what a command says on stderr to Ctrl-C, two seconds after it has begun."""
    process = subprocess.Popen(
        [sys.executable, "-c", RUNS, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
    )
    assert process.stdout.readline() == "runs\n"
    time.sleep(2.0)
    assert process.poll() is None, f"it must still be running; {process.communicate()}"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=5)
    assert process.returncode == 130 and out == ""
    return err


def test_interrupt_leaves_what_was_there(tmp_path):
    """Ctrl-C in the middle of a long synthesis: exit 130, the old file whole, no other file."""
    path = tmp_path / "p.cap"
    path.write_text("precious")
    slow = ["--max-level", "4", "--backend", "numpy", "-o", str(path)]
    err = interrupted("synth", "cart-pole", *slow, cwd=tmp_path)
    assert err.strip() == "interrupted: --checkpoint DIR would keep what is solved for the next run"
    assert os.listdir(tmp_path) == ["p.cap"] and path.read_text() == "precious"


def test_an_interrupt_does_not_wait_for_compiled_code(tmp_path):
    """Loops that run for minutes in one call of compiled code end with the process."""
    capsyn("synth", "double-tank-a", "--max-level", "2", "-o", "tank.cap", cwd=tmp_path)
    slow = ["simulate", "tank.cap", "--duration", "50000"]
    assert interrupted(*slow, cwd=tmp_path) == "interrupted\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["synth", "cart-pendulum", "--sample-time", "0"], "(`sample_time` is --sample-time)"),
        (["synth", "cart-pendulum", "--max-level", "-1"], "(`max_level` is --max-level)"),
        (["synth", "cart-pendulum", "--gamma", "3"], "must be <= 0; got 3"),
        (["verify", "t.cap", "--monte-carlo", "0"], "(`trials` is --monte-carlo)"),
        (["verify", "t.cap", "--agreement", "0"], "(`states` is --agreement)"),
        (["compress", "t.cap", "--mode", "linear", "--states", "0"], ">= 1 and <= 10000000; got 0"),
        (["switching", "t.cap", "--trials", "0"], "must be a whole number"),
    ],
)
def test_errors_say_the_option_of_an_argument_of_another_name(arguments, words, tmp_path):
    capsyn("synth", "double-tank-a", "--max-level", "1", "-o", "t.cap", cwd=tmp_path)
    line = error_of(*arguments, cwd=tmp_path)
    assert words in line and ("(`" in words or "(`" not in line)
