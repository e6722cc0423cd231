"""Policies of other controllers than sSAC from the command line, compared with what made them."""

import json

import numpy as np
import pytest

from capsyn import Policy, agreement
from capsyn.cli.problem_finder import find_problem
from capsyn.sources.callables import labels_of, problem_policy
from capsyn.sources.finite_control_set import finite_control_set, source_of
from support.processes.command_line import capsyn, error_of

FILE = """
import numpy as np
import capsyn

problem = capsyn.Problem(
    name="cart", dynamics=lambda x, u: [x[1], u[0]], domain=capsyn.Box([-1, -1], [1, 1]),
    alphabet=[-1, 0, 1], default=0, horizon=0.8, running_cost=lambda x: x[0]**2 + x[1]**2,
    max_level=2, outside="nearest",
)
slow = problem.replace(delay=0.01, switching=capsyn.Switching(price=0.01))

def law(x):
    return np.where(x[:, 0] + x[:, 1] > 0, 0, 2)

class Agent:
    def predict(self, observations, deterministic=False):
        return law(observations), None

agent = Agent()
number = 3
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sources")
    (folder / "cart.py").write_text(FILE)
    return folder


@pytest.fixture
def run(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return capsyn


@pytest.mark.parametrize("name", ["problem", "slow"])
def test_predictive_control_makes_a_policy_that_is_compared_with_it(run, name):
    options = ["--source", "fcs:2:1,4", "--sample-time", "0.05", "-o", "fcs.cap", "--json"]
    data = json.loads(run("synth", f"cart.py:{name}", *options)[0])
    assert data["source"].startswith("predictive control with a finite control set, moves of 1, 4")
    problem = find_problem(f"cart.py:{name}")
    control = finite_control_set(problem, 2, sample_time=0.05, blocks=[1, 4])
    policy, wanted = Policy.load("fcs.cap"), problem_policy(control, problem)
    assert data["sha256"] == json.loads(run("info", "fcs.cap", "--json")[0])["sha256"]
    states = problem.domain.sample(500)
    for current in (-1, 0, 2):
        assert np.array_equal(policy(states, current=current), wanted(states, current=current))
    assert policy.settings.sample_time == 0.05  # its own, by which loops run
    found = json.loads(run("verify", "fcs.cap", "--agreement", "400", "--json")[0])["agreement"]
    own = agreement(policy, 400, controller=control)
    assert found["agreeing"] == own.agreeing < 400
    again = source_of(policy)
    assert np.array_equal(again.masks(states), control.masks(states))


def test_a_tree_is_judged_by_the_controller_that_made_its_policy(run):
    run("synth", "cart.py", "--source", "fcs:1", "-o", "one.cap")
    options = ["--mode", "linear", "--states", "5000", "--agreement", "0.9", "-o", "t.cap"]
    told = json.loads(run("compress", "one.cap", *options, "--json")[0])["guarantee"]
    assert told["controller"] == "function" and told["agreeing"] >= 0.9 * 5000
    assert "agrees with its controller at" in told["text"]
    out = run("info", "t.cap", "--quick")[0]
    assert "\nsource       predictive control" in out and "\nsampled      every 0.005 s\n" in out


@pytest.mark.parametrize("name", ["law", "agent"])
def test_a_function_or_an_agent_makes_a_policy_that_is_compared_with_it(run, name):
    source = f"cart.py:{name}"
    run("synth", "cart.py", "--source", source, "-o", "law.cap")
    policy, problem = Policy.load("law.cap"), find_problem("cart.py")
    law = labels_of(lambda x: np.where(x[:, 0] + x[:, 1] > 0, 0, 2), problem.alphabet)
    assert np.array_equal(policy.cells.entries, problem_policy(law, problem).cells.entries)
    assert policy.statistics["source"] == {"function": source}
    options = ["--agreement", "500", "--source", source, "--json"]
    found = json.loads(run("verify", "law.cap", *options)[0])["agreement"]
    assert found["agreeing"] == agreement(policy, 500, controller=law).agreeing
    tree = ["--mode", "linear", "--states", "5000", "-o", "tree.cap", "--source", source, "--json"]
    told = json.loads(run("compress", "law.cap", *tree)[0])
    assert told["planes"] >= 1 and told["guarantee"]["controller"] == "function"
    assert "--source FILE.py:NAME" in error_of("verify", "law.cap", "--agreement", "9")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--source", "mpc"], "--source must be ssac, optimum[:T], fcs:DEPTH[:BLOCK,..] or FILE"),
        (["--source", "ssac:7"], "DEPTH[:BLOCK,..] or FILE.py:NAME; got 'ssac:7'"),
        (["--source", "fcs:x"], "--source fcs must be whole numbers"),
        (["--source", "fcs:1,2"], "--source fcs must have one depth"),
        (["--source", "fcs:0"], "`depth` must be a whole number >= 1"),
        (["--source", "fcs:2:1,2,3"], "`blocks` must be a whole number or 2 of them"),
        (["--source", "fcs:1:1:1"], "--source fcs must be fcs:DEPTH or fcs:DEPTH:BLOCK"),
        (["--source", "fcs:1", "--gamma", "-3"], "--source fcs takes no --gamma"),
        (["--source", "fcs:1", "--checkpoint", "c"], "--source fcs takes no --checkpoint"),
        (["--source", "cart.py:law", "--control-weight", "1"], "takes no --control-weight"),
        (["--source", "optimum", "--rule", "steepest"], "--source optimum takes no --rule"),
        (["--source", "cart.py:number"], "must hold a function or an agent named 'number'"),
        (["--source", "none.py:law"], "there is no file 'none.py'"),
    ],
)
def test_what_a_source_cannot_be_is_one_line(run, options, message):
    assert message in error_of("synth", "cart.py", *options)
