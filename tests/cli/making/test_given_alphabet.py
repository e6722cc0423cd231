"""Alphabets that ``capsyn synth --alphabet`` takes, and what the policy then says of them."""

from __future__ import annotations

import json

import pytest

from capsyn import Policy
from capsyn.errors import PolicyFormatError
from capsyn.explorer.facts import facts
from capsyn.policies.report import report
from support.problems.study import motor_study
from support.processes.command_line import BOAT, capsyn, error_of


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "boat.py").write_text(BOAT + "mine = [-2, 0, 2, 3]\nnothing = 3\n")
    motor_study().save(tmp_path / "chosen.json")
    return tmp_path


def synth(folder, text, code=0):
    small = ("--max-level", "1", "--partitions", "3", "-o", "boat.cap")
    return capsyn("synth", "boat.py", "--alphabet", text, *small, cwd=folder, code=code)


def test_the_alphabet_of_a_study_goes_with_its_table_wherever_the_policy_goes(folder):
    out, err = synth(folder, "chosen.json")
    assert err == (
        "warning: the alphabet in 'chosen.json' was chosen for problem 'motor', not 'boat'\n"
    )
    policy = Policy.load(folder / "boat.cap")
    assert policy.alphabet == motor_study().alphabet
    assert policy.statistics["alphabet"] == motor_study().summary()
    told = "chosen for motor from 21 candidates: the least cost + 0.02 time of 1,234 alphabets"
    for text in (out, capsyn("info", "boat.cap", "--quick", cwd=folder)[0]):
        assert told in text and "random" in text and "535 .. 575" in text
    data = json.loads(capsyn("info", "boat.cap", "--quick", "--json", cwd=folder)[0])
    assert data["statistics"]["alphabet"]["rows"][2]["objective"] == 555.0
    section = facts(report(policy))[-1]
    assert section["title"] == "Choice of the alphabet" and told in section["rows"][0][1]
    assert section["table"][0][:4] == ["kind", "symbols", "best", "objective"]
    assert len(section["table"]) == 1 + len(motor_study().table)


def test_symbols_of_python_are_taken_too_and_nothing_is_told_of_them(folder):
    _, err = synth(folder, "boat.py:mine")
    policy = Policy.load(folder / "boat.cap")
    assert err == "" and policy.alphabet.values[:, 0].tolist() == [-2, 0, 2, 3]
    assert policy.alphabet.inputs == ("u1",) and "alphabet" not in policy.statistics


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("boat.py", "symbols must be given as FILE.py:NAME; got 'boat.py'"),
        ("boat.py:none", "'boat.py' must hold symbols named 'none'"),
        ("boat.py:nothing", "`alphabet` must have shape (N, m); got ()"),
        ("none.json", "cannot read the alphabet 'none.json': No such file"),
        ("bad.json", "'bad.json' must be a study as capsyn alphabet writes it: it is no JSON"),
        ("other.json", "`alphabet` must have the inputs of the problem (u1); got v"),
    ],
)
def test_what_is_no_alphabet_is_told_in_one_line(folder, text, message):
    (folder / "bad.json").write_text("u = 1")
    data = motor_study().to_json() | {"table": [], "problem": "boat"}
    for name in ("alphabet", "candidates"):
        data[name] = data[name] | {"inputs": ["v"]}
    (folder / "other.json").write_text(json.dumps(data))
    assert message in error_of("synth", "boat.py", "--alphabet", text, cwd=folder)


def test_a_policy_that_says_something_else_of_its_alphabet_is_damaged(folder):
    synth(folder, "chosen.json")
    policy = Policy.load(folder / "boat.cap")
    policy.statistics["alphabet"]["rows"][0]["cells"] = "<b>many</b>"
    policy.save(folder / "boat.cap")
    with pytest.raises(PolicyFormatError, match="its statistic 'alphabet' is of another kind"):
        Policy.load(folder / "boat.cap")
