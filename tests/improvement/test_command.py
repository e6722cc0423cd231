"""The command ``capsyn improve``."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from capsyn import Policy, problems, synthesize
from support.processes.command_line import capsyn, error_of

QUICK = ["--rate", "50", "--duration", "3", "--starts", "50", "--initial", "x1=0.1:0.9,x2=0.1:0.9"]


@pytest.fixture
def tank(tmp_path):
    synthesize(problems.plain("double-tank-a"), max_level=2).save(tmp_path / "tank.cap")
    return tmp_path


def test_it_prints_the_rounds_and_writes_the_policy(tank):
    out, err = capsyn("improve", "tank.cap", *QUICK, "--rounds", "2", "--horizons", "0.5", cwd=tank)
    assert "cost before" in out and "kept" in out and err == ""
    assert out.splitlines()[-1].endswith("wrote tank-improved.cap")
    assert "mean cost of 50 starts over 3 s at 50 / s" in out
    policy = Policy.load(tank / "tank-improved.cap")
    assert policy.statistics["improve"]["rounds"][0]["after"] > 0
    assert "0.02" in capsyn("info", "tank-improved.cap", "--json", cwd=tank)[0]


def test_json_and_a_policy_that_stays(tank):
    options = [*QUICK, "--horizons", "0.3,0.5", "-o", "best.cap", "--json"]
    data = json.loads(capsyn("improve", "tank.cap", *options, cwd=tank)[0])
    assert data["file"] == "best.cap" and data["improved"] and data["starts"] == 50
    assert data["rounds"][0]["horizon"] in (0.3, 0.5) and data["rounds"][0]["kept"]
    for _ in range(4):
        again = [*QUICK, "--horizons", "0.5", "-o", "best.cap"]
        out, _ = capsyn("improve", "best.cap", *again, cwd=tank)
        if "no round surely lowered the cost" in out:
            break
    assert "wrote the policy as it was given to best.cap" in out


def test_errors_are_one_line(tank):
    assert "`horizons` must ascend" in error_of(
        "improve", "tank.cap", "--horizons", "1,1", cwd=tank
    )
    assert "x3" in error_of("improve", "tank.cap", "--initial", "x3=0:1", cwd=tank)


SAYS_WHEN_IT_WORKS = """
import contextlib, sys
from capsyn.cli import app
from capsyn.cli.better import improve

@contextlib.contextmanager
def working(text):
    yield lambda text: print(text, flush=True)

improve.working = working
app.main()
"""


def test_an_interrupt_leaves_what_was_there(tank):
    (tank / "out.cap").write_text("precious")
    slow = ["--rate", "20000", "-o", "out.cap"]
    process = subprocess.Popen(
        [sys.executable, "-c", SAYS_WHEN_IT_WORKS, "improve", "tank.cap", *slow],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tank,
    )
    assert process.stdout.readline().startswith("round 1, horizon 0.2 s: level 0")
    began = time.perf_counter()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert time.perf_counter() - began < 2.0
    assert process.returncode == 130 and err.strip() == "interrupted"
    assert sorted(os.listdir(tank)) == ["out.cap", "tank.cap"]
    assert (tank / "out.cap").read_text() == "precious"
