"""The command ``capsyn tune``, and what ``capsyn synth`` makes of its settings."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time

import pytest

from capsyn import Policy
from support.problems.block import TEXT
from support.processes.command_line import capsyn, error_of

QUICK = "--rate 10 --duration 8 --starts 40 --fresh 100 --success 0.95 --least effort".split()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "block.py").write_text(TEXT)
    return tmp_path


def test_it_prints_the_front_and_writes_settings_that_synth_takes(folder):
    out, err = capsyn("tune", "block.py", *QUICK, "--trials", "6", cwd=folder)
    assert err == "" and "mean effort" in out and "*" in out
    assert "goal         success >= 0.95, then least effort" in out
    assert "100 starts that no trial saw" in out and "with 95 % confidence" in out
    end = "wrote block-tuned.json; capsyn synth block.py --settings block-tuned.json makes the"
    assert end in out.splitlines()[-1]
    settings = json.loads((folder / "block-tuned.json").read_text())["settings"]
    capsyn("synth", "block.py", "--settings", "block-tuned.json", cwd=folder)
    policy = Policy.load(folder / "block.cap")
    assert policy.horizon == settings["horizon"]
    assert policy.settings.control_weight == settings["effort"]


def test_json_of_a_built_in_problem_and_of_functions(folder):
    (folder / "mine.py").write_text("def fuel(u):\n    return abs(u[0])\n")
    options = "--free price=0.1%:3% --free rule=schedule,steepest --least effort".split()
    options += "--trials 2 --starts 20 --fresh 20 --duration 1 --rate 50 --json".split()
    options += ["--effort", "mine.py:fuel", "--initial", "x1=0.4:0.5", "-o", "best.json"]
    data = json.loads(capsyn("tune", "double-tank-a", *options, cwd=folder)[0])
    assert data["file"] == "best.json" and set(data["settings"]) == {"price", "rule"}
    assert data["settings"]["price"].endswith("%") and data["figures"]["starts"] == 20
    assert 0 <= data["figures"]["effort"] <= 1.0
    capsyn("synth", "double-tank-a", "--settings", "best.json", "-o", "a.cap", cwd=folder)
    assert Policy.load(folder / "a.cap").settings.rule == data["settings"]["rule"]


def test_a_goal_that_nothing_meets_fails_and_says_what_to_free(folder):
    options = "--success 0.9 --trials 2 --starts 20 --fresh 20 --rate 10 --duration 1".split()
    out, err = capsyn("tune", "block.py", *options, cwd=folder, code=1)
    assert "wrote block-tuned.json" in out and len(err.splitlines()) == 1
    assert err.startswith("no settings meet the goal success >= 0.9, then least cost; the best has")
    assert "give the problem a tail" in err


def test_errors_are_one_line(folder):
    assert "there is no goal" in error_of("tune", "block.py", cwd=folder)
    said = error_of("synth", "block.py", cwd=folder)
    assert "'block.py' has free settings (horizon, effort): give them with --settings" in said
    goal = ("--least", "cost")
    assert "nothing is free" in error_of("tune", "cart-pole", *goal, cwd=folder)
    said = error_of("tune", "cart-pole", *goal, "--free", "mass=1:2", cwd=folder)
    assert "no setting 'mass' to be free; known are tail, horizon" in said
    said = error_of("tune", "cart-pole", *goal, "--free", "horizon=2:1", cwd=folder)
    assert "low < high" in said
    assert "v2" in error_of("tune", "block.py", *goal, "--initial", "v2=0:1", cwd=folder)
    (folder / "bad.json").write_text('{"settings": 3}')
    for name in ("bad.json", "block.py"):
        said = error_of("synth", "block.py", "--settings", name, cwd=folder)
        assert f"'{name}' must be settings as capsyn tune writes them" in said
    said = error_of("synth", "block.py", "--settings", "none.json", cwd=folder)
    assert "cannot read the settings 'none.json'" in said


def finished(path):
    """Return how many trials of a study have ended, or 0 where there is none yet."""
    try:
        with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as base:
            ended = "select count(*) from trials where state in ('COMPLETE', 'PRUNED')"
            return base.execute(ended).fetchone()[0]
    except sqlite3.OperationalError:
        return 0


def test_a_killed_study_goes_on_and_two_processes_share_one(folder):
    words = [sys.executable, "-m", "capsyn", "tune", "block.py", *QUICK, "--storage", "study.db"]
    command = [*words, "--threads", "1", "--json"]
    run = subprocess.Popen(
        [*command, "--trials", "1000"], cwd=folder, start_new_session=True, stdout=subprocess.PIPE
    )
    deadline = time.monotonic() + 120
    while finished(folder / "study.db") < 2 and time.monotonic() < deadline:
        assert run.poll() is None
        time.sleep(0.05)
    os.kill(run.pid, signal.SIGKILL)
    run.communicate()
    kept = finished(folder / "study.db")
    assert kept >= 2
    again = ["tune", "block.py", *QUICK, "--threads", "1", "--json", "--trials", str(kept + 1)]
    alone, resumed = (
        json.loads(capsyn(*again, *more, cwd=folder)[0]) for more in ([], ["--storage", "study.db"])
    )
    assert resumed == alone  # the trial that was under way is in its place
    kept += 1
    more = [*command, "--trials", str(kept + 2)]
    both = [
        subprocess.Popen([*more, "-o", f"{k}.json"], cwd=folder, stdout=subprocess.PIPE, text=True)
        for k in range(2)
    ]
    for one in both:
        data = json.loads(one.communicate(timeout=120)[0])
        assert one.returncode in (0, 1) and kept + 2 <= len(data["tried"]) <= kept + 3
        numbers = [trial["number"] for trial in data["tried"]]
        assert numbers == sorted(set(numbers))
