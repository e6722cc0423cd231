"""How far from the optimum, from the command line; policies of its symbols; its picture."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from capsyn import Policy, optimum, problems, synthesize
from capsyn.optima.optimum import Optimum
from capsyn.plots.figure import new_figure
from capsyn.plots.optimum import plot_optimum
from support.processes.command_line import capsyn


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("optimum")
    synthesize(problems.plain("double-tank-b"), max_level=2).save(folder / "tank.cap")
    return folder


@pytest.fixture
def run(folder, monkeypatch):
    """Return what runs a command line in the folder and returns (stdout, stderr)."""
    monkeypatch.chdir(folder)
    return capsyn


LOOP = ["--rate", "50", "--duration", "2", "--counts", "60"]


def test_verify_says_how_far_and_draws_and_keeps_it(run, folder):
    out, _ = run("verify", "tank.cap", "--optimum", "40", *LOOP, "--save", "-o", "far.png")
    policy = Policy.load(folder / "tank.cap")
    found = optimum(policy, 2.0, rate=50, counts=60, starts=40)
    compared = found.compare(policy)
    assert f"{compared.ratio:.4g} times the least cost" in out and "worst from" in out
    assert (folder / "far.png").read_bytes()[:4] == b"\x89PNG"
    assert policy.evidence["optimum"]["ratio"] == pytest.approx(compared.ratio)
    assert "times the least cost" in run("info", "tank.cap", "--quick")[0]


def test_verify_fails_where_too_far(run):
    arguments = ["verify", "tank.cap", "--optimum", "20", *LOOP, "--json"]
    out, err = run(*arguments, "--require-optimality", "0.9999", code=1)
    assert "--require-optimality 0.9999 is not met" in err
    data = json.loads(out)["optimum"]
    assert 0.5 < data["optimality"] < 0.9999 and data["bound"] and data["counts"] == [60, 60]
    assert not data["beaten"]
    narrow = json.loads(run(*arguments, "--initial", "x1=0.4:0.5")[0])["optimum"]
    assert 0.4 <= narrow["worst"]["start"]["x1"] <= 0.5


def test_an_optimum_that_is_beaten_is_no_bound(run, monkeypatch):
    """As that of a grid is which is too coarse, whatever its values say of its error."""
    compare = Optimum.compare

    def dearer(self, *arguments, **options):
        return compare(dataclasses.replace(self, costs=2 * self.costs), *arguments, **options)

    monkeypatch.setattr(Optimum, "compare", dearer)
    arguments = ["verify", "tank.cap", "--optimum", "20", *LOOP, "--require-optimality", "0.5"]
    out, err = run(*arguments, code=1)
    assert "the policy costs less: the grid is too coarse" in out and "is no bound" in out
    assert "--require-optimality 0.5 is not met: the optimum is no bound" in err
    data = json.loads(run(*arguments, "--json", code=1)[0])["optimum"]
    assert data["beaten"] and not data["bound"] and data["ratio_high"] < 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--monte-carlo", "9", "--counts", "9"], "--counts needs --optimum"),
        (["--agreement", "9", "--duration", "9"], "--duration needs --monte-carlo or --optimum"),
        (["--optimum", "9", "--noise", "1"], "--noise needs --monte-carlo"),
        (["--optimum", "9", "--counts", "9", "--memory", "1kB"], "`counts` 9 x 9 would take"),
        (["--optimum", "0"], "`starts` must be a whole number >= 1"),
        (["--optimum", "9", "-o", "far.txt"], "must end in .png"),
    ],
)
def test_wrong_options_are_one_line(run, options, message):
    _, err = run("verify", "tank.cap", *options, code=2)
    assert message in err and len(err.strip().splitlines()) == 1


def test_synth_makes_the_policy_of_the_optimum(run, folder):
    run("synth", "double-tank-b", "--switch-price", "none", "--source", "optimum:1",
        "--max-level", "2", "-o", "best.cap")  # fmt: skip
    best = Policy.load(folder / "best.cap")
    found = optimum(problems.plain("double-tank-b"), 1.0)
    middle = best.domain.sample(500, 1)
    assert np.mean(best(middle) == found.symbols(middle)) > 0.9
    for source, words in (("best", "must be ssac, optimum"), ("optimum:x", "must be a number")):
        assert words in run("synth", "double-tank-b", "--source", source, code=2)[1]
    _, err = run("synth", "double-tank-b", "--source", "optimum", "--gamma", "-1", code=2)
    assert "--source optimum takes no --gamma" in err


def test_the_optimum_is_sampled_at_the_time_asked_for(run, folder):
    run("synth", "double-tank-b", "--switch-price", "none", "--source", "optimum:1",
        "--sample-time", "0.05", "--max-level", "1", "-o", "slow.cap")  # fmt: skip
    slow, problem = Policy.load(folder / "slow.cap"), problems.plain("double-tank-b")
    settings = dataclasses.replace(problem.settings, sample_time=0.05)
    wanted = optimum(problem, 1.0, rate=20).policy(problem.replace(settings=settings, max_level=1))
    assert slow.settings.sample_time == 0.05
    assert np.array_equal(slow.cells.leaf_labels(), wanted.cells.leaf_labels())


def test_ranges_are_for_the_trials_beside_the_optimum(run):
    """And files of further costs are loaded once."""
    loaded = "open('loaded', 'a', encoding='utf-8').write('once')"
    Path("more.py").write_text(f"{loaded}\ndef more(x):\n    return x[0]\n", encoding="utf-8")
    out, _ = run("verify", "tank.cap", "--monte-carlo", "5", "--optimum", "5", *LOOP,
        "--target", "x2=0.3:0.5", "--noise", "0:0.01", "--cost", "more.py:more")  # fmt: skip
    assert "times the least cost" in out
    assert Path("loaded").read_text(encoding="utf-8") == "once"


def test_the_picture_has_all_starts_and_the_worst(folder):
    policy = Policy.load(folder / "tank.cap")
    compared = optimum(policy, 1.0, rate=50, counts=40, starts=30).compare(policy)
    ax = plot_optimum(compared, policy.domain, new_figure(4, 3).add_subplot())
    assert len(ax.collections[0].get_offsets()) == 30
    ring = ax.lines[-1].get_xydata()
    assert ring.tolist() == [compared.starts[compared.worst].tolist()]
