"""capsyn certify and check: what they ask for, print, write and keep, with proofs made by hand."""

import json
import shlex
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from capsyn import Ball, Box, Policy, problems, synthesize
from capsyn.certification.certificate import Certificate
from capsyn.errors import CertificateError
from capsyn.policies.report import report
from support.processes.command_line import capsyn
from support.proofs.certificates import by_hand, complete

FUNCTIONS = (
    "def high(x):\n    return x[1] >= 0.95\n\ndef plant(x, u, p):\n    return [x[1], u[0]]\n"
)
"""A file of the user's own."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certify")
    synthesize(problems.plain("double-tank-b"), max_level=2).save(folder / "tank.cap")
    (folder / "f.py").write_text(FUNCTIONS)
    return folder


@pytest.fixture
def run(folder, monkeypatch):
    """Return what runs a command line in the folder and returns (stdout, stderr)."""
    monkeypatch.chdir(folder)
    return capsyn


@pytest.fixture
def proving(monkeypatch):
    """Return a function that says which certificate is found, and the list of what was asked."""
    asked = []

    def find(make=by_hand, **changes):
        def certify(policy, **given):
            asked.append(given)
            return make(policy.domain, (20, 20), **changes)

        monkeypatch.setattr("capsyn.certification.certify.certify", certify)
        return asked

    return find


def test_it_prints_what_is_proved_refuted_and_open(run, proving):
    proving(conditions={"noise": 0.002, "avoid": "x1 in [0, 0.01]"})
    out, err = run("certify", "tank.cap", "--rate", "1000")
    lines = out.splitlines()
    assert err == "" and lines[0].startswith("certificate  81.25% of the starts arrive in the")
    assert lines[1:6] == [
        "from         the middle",
        "to           a ball",
        "avoiding     x1 in [0, 0.01]",
        "by           rate 1000, noise 0.002",
        "proof        boxes on 20 x 20 cells, in 0.7 s",
    ]
    start = by_hand(Policy.load("tank.cap").domain, (20, 20)).refuted[0]
    assert lines[6] == f"refuted      from ({start[0]:g}, {start[1]:g}) it stands still"
    assert lines[7].startswith("again        capsyn simulate tank.cap --x0 ")
    assert len(lines) == 8


def test_the_command_that_is_told_simulates_the_refuted_start(run, proving):
    proving()
    options = [
        "--rate",
        "200",
        "--delay",
        "0.01",
        "--target",
        "x1=0.5,x2=0.5",
        "--tolerance",
        "0.1",
    ]
    out, _ = run("certify", "tank.cap", *options, "--json")
    (refuted,) = json.loads(out)["refuted"]
    words = shlex.split(refuted["replay"])
    again = json.loads(run(*words[1:], "--duration", "0.1", "--json")[0])
    assert again["initial"] == refuted["state"]
    assert words[words.index("--rate") + 1] == "200.0"
    assert words[words.index("--delay") + 1] == "0.01" and "--tolerance" in words


def test_ranges_are_replayed_at_their_middle(run, proving):
    proving()
    options = ["--model", "f.py:plant", "--parameter", "k=1:3", "--parameter", "m=4"]
    (refuted,) = json.loads(run("certify", "tank.cap", *options, "--json")[0])["refuted"]
    assert "--parameter k=2.0 --parameter m=4.0 --model f.py:plant" in refuted["replay"]


def test_replays_of_the_proof_itself_are_kept_and_five_are_printed(run, proving):
    lines = tuple(f"capsyn simulate {k}" for k in range(7))
    many = {"refuted": np.full((7, 2), 0.3), "failures": ("goes round",) * 7, "replays": lines}
    proving(**many)
    out, _ = run("certify", "tank.cap")
    assert out.count("it goes round") == 5 and "again        capsyn simulate 4" in out
    assert "and 2 more, which --json tells" in out
    found = json.loads(run("certify", "tank.cap", "--json")[0])["refuted"]
    assert [start["replay"] for start in found] == list(lines)


def test_a_proof_that_was_stopped_is_told(run, proving):
    proving(complete, stopped=True, open=0.5)
    out, _ = run("certify", "tank.cap")
    assert "; stopped before its end" in out.splitlines()[0]


def test_json_has_the_keys_of_the_certificate(run, proving):
    proving()
    data = json.loads(run("certify", "tank.cap", "--json")[0])
    domain = Policy.load("tank.cap").domain
    wanted = by_hand(domain, (20, 20)).to_json()
    assert set(data) == {*wanted, "missed"} and data["missed"] == []
    assert {key: data[key] for key in wanted if key != "refuted"} == {
        key: value for key, value in wanted.items() if key != "refuted"
    }


def test_options_mean_arguments(run, proving):
    asked = proving()
    run(
        "certify", "tank.cap", "--initial", "x1=0.1:0.9,x2=0.1:0.9", "--target", "x1=0.5,x2=0.5",
        "--tolerance", "0.05", "--avoid", "x2=0.95:1", "--rate", "1000", "--delay", "0.002",
        "--noise", "0.001,0.002", "--parameter", "k=0.8:1.2", "--parameter", "m=3",
        "--model", "f.py:plant", "--min-dwell", "0.01", "--counts", "40,60", "--seconds", "3",
        "--seed", "4", "--threads", "1",
    )  # fmt: skip
    (given,) = asked
    initial, target, avoid = (given.pop(name) for name in ("initial", "target", "avoid"))
    assert initial == Box([0.1, 0.1], [0.9, 0.9], names=["x1", "x2"])
    assert isinstance(target, Ball) and (target.radius, target.names) == (0.05, ("x1", "x2"))
    assert avoid == Box([0.95], [1], names=["x2"])
    assert given.pop("model").__name__ == "plant"
    assert given == {
        "rate": 1000.0, "delay": 0.002, "noise": [0.001, 0.002], "min_dwell": 0.01,
        "parameters": {"k": (0.8, 1.2), "m": 3.0}, "counts": [40, 60], "seconds": 3.0, "seed": 4,
        "threads": 1,
    }  # fmt: skip


def test_what_is_not_asked_is_left_to_the_proof(run, proving):
    asked = proving()
    run("certify", "tank.cap")
    run("certify", "tank.cap", "--avoid", "f.py:high", "--counts", "40", "--exogenous", "w=0:1")
    assert asked[0].pop("target") == Policy.load("tank.cap").target
    assert asked[0] == {"seed": 0, "parameters": {}}
    assert asked[1]["avoid"].__name__ == "high" and asked[1]["counts"] == 40
    assert asked[1]["exogenous"] == {"w": (0.0, 1.0)}


def test_the_picture_and_the_proof_are_written(run, proving, folder, monkeypatch):
    proving()

    def save(self, path):
        (folder / path).write_text(self.method)

    monkeypatch.setattr(Certificate, "save", save, raising=False)
    out, _ = run("certify", "tank.cap", "-o", "proved.png", "--certificate", "tank.proof")
    assert out.splitlines()[-1] == "wrote proved.png and tank.proof"
    assert (folder / "proved.png").read_bytes()[:4] == b"\x89PNG"
    assert (folder / "tank.proof").read_text() == "boxes"


def test_it_is_kept_in_the_file_and_told_by_info(run, proving, folder):
    proving()
    (folder / "kept.cap").write_bytes((folder / "tank.cap").read_bytes())
    run("certify", "kept.cap", "--save")
    kept = Policy.load(folder / "kept.cap")
    found = report(kept)["evidence"]["certificate"]
    made = by_hand(kept.domain, (20, 20)).evidence()
    assert found["map"] == made["map"] and found["arrival"] == made["arrival"]
    out, _ = run("info", "kept.cap", "--quick")
    assert "certificate  81.25% of the starts arrive" in out
    assert Policy.load(folder / "tank.cap").evidence == {}


@pytest.mark.parametrize(("name", "share"), [("arrival", 0.8125), ("staying", 0.5)])
def test_requirements_that_are_not_met_are_the_exit_status(run, proving, name, share):
    proving(staying=0.5)
    run("certify", "tank.cap", f"--require-{name}", share)
    out, err = run("certify", "tank.cap", f"--require-{name}", "0.9", "--json", code=1)
    missed = f"--require-{name} 0.9 is not met: {share:g}"
    assert err == f"{missed}\n" and json.loads(out)["missed"] == [missed]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--require-arrival", "1.5"], "--require-arrival must be between 0 and 1; got 1.5"),
        (["--require-staying", "-1"], "--require-staying must be between 0 and 1; got -1"),
        (["-o", "far.txt"], "a picture must end in .png"),
        (["-o", "nowhere/far.png"], "nowhere"),
        (["--certificate", "nowhere/a.proof"], "nowhere"),
        (["--delay", "0:1"], "--delay must be one value here; ranges are for verify"),
        (["--noise", "0:1"], "--noise must be a bound E, or one of each state"),
        (["--noise", "much"], "`--noise` must be a number; got 'much'"),
        (["--initial", "y=0:1"], "--initial must name states among x1, x2; got 'y'"),
        (["--initial", "x1=0:1:2"], "--initial must be NAME=LOW:HIGH or NAME=VALUE"),
        (["--avoid", "x1=0.5"], "--avoid must be NAME=LOW:HIGH"),
        (["--counts", "many"], "--counts must be whole numbers"),
        (["--parameter", "k"], "--parameter must be NAME=VALUE"),
        (["--parameter", "k=2:1"], "`k` must be a value or a range LOW:HIGH; got '2:1'"),
        (["--exogenous", "w=1:0"], "`exogenous w` must be a value or a range LOW:HIGH"),
    ],
)
def test_bad_options_are_one_line_before_work(run, proving, words, message):
    asked = proving()
    out, err = run("certify", "tank.cap", *words, code=2)
    assert out == "" and err.startswith("error: ") and err.count("\n") == 1 and message in err
    assert asked == []


def test_help_says_that_noise_is_a_bound(run):
    assert "no standard deviation" in " ".join(run("certify", "--help")[0].split())


@pytest.fixture
def checking(monkeypatch):
    """Return a function that says what the checker finds, and the list of what was asked."""
    asked = []

    def find(answer):
        def check(path, policy):
            asked.append((path, policy.name))
            if isinstance(answer, Exception):
                raise answer
            return answer

        monkeypatch.setitem(sys.modules, "capsyn.certification.check", SimpleNamespace(check=check))
        return asked

    return find


def test_a_proof_that_holds(run, checking):
    asked = checking(SimpleNamespace(cells=20736, seconds=1.234))
    out, _ = run("check", "tank.proof", "tank.cap")
    assert out == "certificate  holds for tank.cap: 20,736 cells checked in 1.23 s\n"
    data = json.loads(run("check", "tank.proof", "tank.cap", "--json")[0])
    assert data == {"holds": True, "cells": 20736, "seconds": 1.234}
    assert asked == [("tank.proof", "double-tank-b")] * 2


def test_a_proof_that_is_refused(run, checking):
    checking(CertificateError("cell 17: its image\nis not in cell 18"))
    out, err = run("check", "tank.proof", "tank.cap", code=1)
    assert (out, err) == ("", "refused: cell 17: its image is not in cell 18\n")
    out, _ = run("check", "tank.proof", "tank.cap", "--json", code=1)
    assert json.loads(out) == {"holds": False, "reason": "cell 17: its image is not in cell 18"}
