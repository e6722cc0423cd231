"""Every example runs, and prints what its text promises."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))
PROMISES = {
    "boat": ["after 40 s"],
    "gymnasium_pendulum": ["8303 solves", "policy: mean return -2"],
    "mountain_car": ["cells: 100 of 100 reach the flag", "tree: 100 of 100 reach the flag"],
    "evidence": ["100.0% of the trials", "online sSAC around the policy: there after 10.05 s"],
    "pendulum": ["4314 solves, 1710 cells", "99.5"],
    "ramp": [
        "belt +0.5 m/s, told: offset -0.00",
        "belt +0.5 m/s, not told: offset -0.38",
        "turns back, told: offset +0.0",
    ],
    "rotating_reference": [
        "314 rad/s, amplitude 8.0 A: rms error 0.134 A, tried out online 0.134 A",
        "157 rad/s, amplitude {0.0: 4.0, 0.04: 8.0} A: rms error 0.137 A, tried out online 0.136",
    ],
    "measured_load": ["  50 V       -0.0", "at least 26.4 V, within 0.5 V after 1.0 ms"],
    "setpoint": ["law as default: mean error at most 0.07 K", "constant default: at most 0.24 K"],
    "small": ["exact: 471 nodes", "linear: ", "coast -> ahead"],
    "thermostat": ["default 0.0, horizon 5.0 s: 22.4", "default 0.6, horizon 5.0 s: 21.0"],
}


def test_every_example_promises_something():
    assert {path.stem for path in EXAMPLES} == set(PROMISES)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(path, capsys, monkeypatch):
    monkeypatch.syspath_prepend(path.parent)
    runpy.run_path(str(path), run_name="__main__")
    out = capsys.readouterr().out
    assert all(words in out for words in PROMISES[path.stem]), out
    assert len(path.read_text().splitlines()) < 100


def test_the_boat_arrives(capsys):
    runpy.run_path(str(EXAMPLES[0]), run_name="__main__")
    positions = [
        float(line.split(": ")[1].split(" m")[0]) for line in capsys.readouterr().out.splitlines()
    ]
    assert len(positions) == 3 and max(map(abs, positions)) < 0.3
