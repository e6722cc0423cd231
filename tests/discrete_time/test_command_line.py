"""A problem file in discrete time, through the command line."""

import json

import pytest

from capsyn import Policy
from capsyn.explorer.facts import facts
from capsyn.policies.report import report
from support.processes.command_line import run_here

FILE = """import capsyn

problem = capsyn.Problem(
    name="stock",
    dynamics=lambda x, u: [x[0] + 0.5 * (2.2 * x[0] * (1 - x[0]) - u[0] * x[0])],
    discrete=True,
    sample_time=0.5,
    domain=capsyn.Box([0.05], [1.4], ["stock"]),
    alphabet=capsyn.Alphabet([0.0, 0.5, 1.0], inputs=["harvest"]),
    default=0.5,
    horizon=4,
    running_cost=lambda x: (x[0] - 0.7) ** 2,
    outside="nearest",
    time_unit="d",
)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("stock")
    (path / "stock.py").write_text(FILE, encoding="utf-8")
    made = run_here(["synth", "stock.py", "-o", "stock.cap"], path)
    assert made.returncode == 0, made.stderr
    return path


def test_all_that_is_told_says_samples(folder):
    told = run_here(["info", "stock.cap"], folder).stdout
    assert "horizon 4 samples of a discrete-time model, each 0.5 d, exact" in told
    assert json.loads(run_here(["info", "stock.cap", "--json"], folder).stdout)["discrete"] is True
    run = ["simulate", "stock.cap", "--x0", "0.1", "--duration", "5", "-o", "run.csv"]
    assert run_here(run, folder).returncode == 0
    rows = (folder / "run.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 12 and rows[2].startswith("0.5,")
    assert run_here(["explore", "stock.cap", "-o", "p.html"], folder).returncode == 0
    shown = facts(report(Policy.load(folder / "stock.cap")))
    rows = dict(next(part["rows"] for part in shown if part["title"] == "Controller"))
    assert (rows["horizon"], rows["sensitivity"]) == ("4 samples", "exact")
    assert rows["model"] == "a map, once a sample, double precision"
    assert run_here(["export", "stock.cap", "--to", "json", "-o", "out"], folder).returncode == 0
    exported = json.loads((folder / "out" / "stock.json").read_text(encoding="utf-8"))
    assert exported["discrete"] is True
    assert any("horizon 4 samples of a discrete-time model" in line for line in exported["header"])


def test_the_rule_and_other_sources_are_chosen_by_options(folder):
    first = ["synth", "stock.py", "-o", "first.cap", "--sensitivity", "first order"]
    assert run_here(first, folder).returncode == 0
    assert Policy.load(folder / "first.cap").settings.sensitivity == "first order"
    best = ["synth", "stock.py", "-o", "best.cap", "--source", "optimum:5"]
    assert run_here(best, folder).returncode == 0
    best, own = (Policy.load(folder / name) for name in ("best.cap", "stock.cap"))
    assert best.discrete and best.settings.sample_time == 0.5
    states = best.domain.sample(2000, 0)
    assert (best(states) == own(states)).mean() > 0.9


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["simulate", "stock.cap", "--x0", "0.1", "--duration", "5", "--rate", "3"], "must be 2"),
        (["verify", "stock.cap", "--monte-carlo", "9", "--rate", "3"], "must be 2"),
        (["synth", "stock.py", "-o", "q.cap", "--steps", "7"], "`steps` must be left out"),
        (["synth", "stock.py", "-o", "q.cap", "--horizon", "2.5"], "whole number of samples"),
        (["certify", "stock.cap"], "`policy` must have dynamics that are rates"),
    ],
)
def test_what_cannot_be_is_one_line(folder, words, message):
    done = run_here(words, folder)
    assert done.returncode == 2
    assert message in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not (folder / "q.cap").exists()


def test_another_sample_time_is_refused(folder):
    done = run_here(["synth", "stock.py", "--sample-time", "0.25", "-o", "no.cap"], folder)
    assert done.returncode == 2 and not (folder / "no.cap").exists()
    assert "--sample-time must be left out, or be 0.5" in done.stderr
