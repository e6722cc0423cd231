"""What a discrete-time problem cannot be, and what cannot be asked of it: each in one line."""

import dataclasses

import pytest

import capsyn
from capsyn import SsacSettings, simulate, synthesize
from capsyn.automata.switching import known_switching
from capsyn.errors import ProblemError
from capsyn.sources.finite_control_set import finite_control_set
from capsyn.verification.lyapunov import lyapunov_grid
from support.models.maps import stock


@pytest.fixture(scope="module")
def policy():
    return synthesize(stock(max_level=1))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sample_time": None}, "`sample_time` must be given for a `discrete` problem"),
        ({"sample_time": -1}, "`sample_time` must be"),
        ({"discrete": 1}, "`discrete` must be"),
        ({"horizon": 2.5}, "`horizon` must be a whole number of samples"),
        ({"horizon": 0}, "`horizon` must be"),
        ({"horizon": None}, "`horizon` must be"),
        ({"delay": 0.7}, "`delay` must be a whole number of samples of 0.5"),
        ({"settings": SsacSettings(steps=12)}, "`steps` must be left out"),
        ({"dynamics": lambda x, u: [x[0], x[0]]}, "`dynamics` must return 1 component"),
    ],
)
def test_what_a_map_must_say(changes, message):
    with pytest.raises(ProblemError, match=message) as caught:
        stock(**changes)
    assert "\n" not in str(caught.value)


def test_a_policy_of_a_map_needs_no_settings(policy):
    bare = dataclasses.replace(policy, settings=None)
    assert bare.settings is None and bare.horizon == policy.horizon


def test_rates_have_no_sensitivity_of_a_sample():
    exact = SsacSettings(sensitivity="exact")
    with pytest.raises(ProblemError, match="`sensitivity` must be left out"):
        stock(discrete=False, settings=exact)
    with pytest.raises(ProblemError, match="`sensitivity` must be one of"):
        SsacSettings(sensitivity="second order")
    assert "sensitivity" not in SsacSettings().to_json() and "sensitivity" in exact.to_json()


def test_the_sample_time_of_a_problem_is_that_of_its_settings():
    rates = stock(discrete=False, sample_time=0.25)
    assert rates.settings.sample_time == 0.25
    again = stock().replace(settings=SsacSettings(rule="steepest"))
    assert (again.settings.sample_time, again.settings.rule) == (0.5, "steepest")
    assert stock().replace(sample_time=1.0).settings.sample_time == 1.0


def ask_lyapunov(policy):
    capsyn.lyapunov(policy, lambda x: x[0] ** 2)


def ask_grid(policy):
    lyapunov_grid(policy, lambda x: x[0] ** 2, 0.1)


def ask_proof(policy):
    capsyn.certify(policy)


def ask_online(policy):
    capsyn.online_controller(policy)


def ask_limits(policy):
    synthesize(stock(limits=lambda x: [x[0] - 1.2]), keep_limits=True)


def ask_rate(policy):
    simulate(policy, [0.1], 5, 3)


def ask_substeps(policy):
    simulate(policy, [0.1], 5, substeps=1)


def ask_improve(policy):
    capsyn.improve(policy, rate=100.0)


def ask_optimum(policy):
    capsyn.optimum(policy, 5.0, rate=4.0)


def ask_steps(policy):
    finite_control_set(stock(), 2, steps=2)


def ask_sample_time(policy):
    finite_control_set(stock(), 2, sample_time=1.0)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (ask_lyapunov, "`policy` must have dynamics that are rates, not the map"),
        (ask_grid, "`policy` must have dynamics that are rates, not the map"),
        (ask_proof, "`policy` must have dynamics that are rates, not the map"),
        (ask_online, "`source` must have dynamics that are rates, not the map"),
        (ask_limits, "`keep_limits` must have dynamics that are rates, not the map"),
        (ask_rate, "`rate` must be 2, or left out"),
        (ask_substeps, "`substeps` must be left out"),
        (ask_improve, "`rate` must be 2, or left out"),
        (ask_optimum, "`rate` must be 2, or left out"),
        (ask_steps, "`steps` must be 1 for a map"),
        (ask_sample_time, "`sample_time` must be left out, or be 0.5"),
    ],
)
def test_what_needs_rates_refuses_a_map(policy, ask, message):
    with pytest.raises(ProblemError, match=message) as caught:
        ask(policy)
    assert "\n" not in str(caught.value)


def test_a_map_jumps_over_faces_so_its_automaton_excludes_nothing(policy):
    assert known_switching(policy) is None
    edges = capsyn.Automaton.of(policy).to_json()["edges"]
    others = [edge for edge in edges if edge["source"] != edge["target"]]
    assert others and all(edge["possible"] is None for edge in others)


def test_a_policy_without_its_model_is_no_map(policy):
    plain = dataclasses.replace(policy, model=None)
    assert policy.discrete and not plain.discrete
    assert simulate(plain, [0.1], 5, model=stock()).states.shape == (11, 1)
