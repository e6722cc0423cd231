"""Closed loops, trials, pages and files of discrete-time problems."""

import dataclasses

import numpy as np
import pytest

import capsyn
from capsyn import Box, Policy, Switching, simulate, synthesize
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.explorer.formulas import formulas
from capsyn.sources.callables import problem_policy
from capsyn.sources.finite_control_set import finite_control_set
from support.explorer.node import BEGIN, node
from support.models.maps import grown, stock, stock_costs, turned, turning, turning_cost
from support.policy_files import at, refuse, rewrite, set_version

BACKENDS = ("c", "numpy")


@pytest.fixture(scope="module")
def policy():
    return synthesize(stock(max_level=7))


@pytest.fixture(scope="module")
def motor():
    return synthesize(turning())


def test_a_policy_of_a_map_is_the_best_sequence_almost_everywhere(policy):
    x = np.linspace(0.05, 1.4, 5001)
    assert (policy(x[:, None]) == stock_costs(x).argmin(axis=1)).mean() > 0.999
    made = problem_policy(finite_control_set(stock(), 4), stock(max_level=7))
    assert made.discrete and made.settings.sample_time == 0.5
    assert (made(x[:, None]) == policy(x[:, None])).mean() > 0.999
    figures = capsyn.agreement(policy, 20_000)
    assert figures.share > 0.999


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_loop_iterates_the_map(policy, backend):
    trajectory = simulate(policy, [[0.1], [1.3]], 10, backend=backend)
    x, cost = np.array([0.1, 1.3]), 0.0
    for k in range(20):
        np.testing.assert_allclose(trajectory.states[:, k, 0], x, rtol=1e-14)
        np.testing.assert_allclose(trajectory.costs[:, k], cost, rtol=1e-13)
        cost = cost + (x - 0.7) ** 2
        x = grown(x, policy.controls[policy(x[:, None])][:, 0])
    np.testing.assert_array_equal(trajectory.times, np.arange(21) / 2)
    np.testing.assert_allclose(trajectory.cost, cost + (x - 0.7) ** 2, rtol=1e-13)


@pytest.mark.parametrize("backend", BACKENDS)
def test_delay_disturbance_and_least_times_are_in_samples(policy, backend):
    switching = Switching(hold={"0": 1.0})
    own = dataclasses.replace(policy, switching=switching)
    trajectory = simulate(own, [0.1], 10, delay=1.0, disturbance=[0.01], backend=backend)
    x, wanted, now, held = 0.1, [], -1, 0
    for k in range(20):
        assert trajectory.states[k, 0] == pytest.approx(x, rel=1e-13)
        best = int(policy([x]))
        if now < 0 or (best != now and held >= (2 if now == 0 else 0)):
            now, held = best, 0
        held += 1
        wanted.append(now)
        u = policy.controls[wanted[k - 2]][0] if k >= 2 else 0.5
        x = grown(x, u) + 0.01
    np.testing.assert_array_equal(trajectory.symbols, wanted)


@pytest.mark.parametrize("backend", BACKENDS)
def test_angles_wrap_after_the_map_and_inputs_are_told(motor, backend):
    told = {"load": {0: 0.05, 1: -0.05}}
    trajectory = simulate(motor, [0.95, 2.0], 4, exogenous=told, backend=backend)
    z, cost = np.array([[0.95], [2.0], [0.05]]), 0.0
    for k in range(40):
        z[2] = 0.05 if k < 10 else -0.05
        np.testing.assert_allclose(trajectory.states[k], z[:2, 0], rtol=1e-12, atol=1e-13)
        u = motor.controls[motor(z.T, outside="nearest")][:, 0]
        cost, z = cost + turning_cost(z), turned(z, u)
    assert trajectory.costs[-1] == pytest.approx(float(cost[0]), rel=1e-12)
    assert np.abs(trajectory.states[:, 0]).max() > 1  # it went around


def test_another_plant_is_a_map_or_rates_as_it_says(policy):
    def weaker(x, u, p):
        return [x[0] + 0.5 * (p[0] * x[0] * (1 - x[0]) - u[0] * x[0])]

    own = simulate(policy, [0.1], 5, model=weaker, parameters={"growth": 2.2})
    np.testing.assert_array_equal(own.states, simulate(policy, [0.1], 5).states)
    rates = stock(
        dynamics=lambda x, u: [2.2 * x[0] * (1 - x[0]) - u[0] * x[0]],
        discrete=False,
        sample_time=None,
    )
    smooth = simulate(policy, [0.1], 5, model=rates)
    assert len(smooth.times) == 11 and not np.allclose(smooth.states, own.states)
    with pytest.raises(ProblemError, match="`rate` must be 2, or left out: the model is a map"):
        simulate(synthesize(rates), [0.1], 5, 100, model=stock())
    calls = simulate(lambda t, x: np.full((len(x), 1), 0.5), [0.1], 2, model=stock())
    assert calls.states[-1, 0] == grown(grown(grown(grown(0.1, 0.5), 0.5), 0.5), 0.5)


def test_trials_know_the_map(policy):
    result = capsyn.monte_carlo(policy, 300, duration=10.0, hold=2.0, seed=1)
    one = simulate(policy, result.initial[:5], 10.0)
    np.testing.assert_array_equal(result.final[:5], one.states[:, -1])
    assert result.success.all() and result.conditions["rate"] == 2.0
    with pytest.raises(ProblemError, match="`delay` must be a whole number of samples of 0.5"):
        capsyn.monte_carlo(policy, 10, delay=capsyn.Uniform(0.0, 1.0))


def test_a_file_says_that_it_is_a_map(policy, tmp_path):
    path = tmp_path / "p.cap"
    policy.save(path)
    loaded = Policy.load(path)
    assert loaded.discrete and loaded.model.sample_time == 0.5 and loaded.horizon == 4.0
    np.testing.assert_array_equal(
        simulate(loaded, [0.1], 5).states, simulate(policy, [0.1], 5).states
    )
    for change, message in (
        (at("model", "sample_time")(0), "sample_time"),
        (at("model", "sample_time")(0.25), "the sample time of the model's map"),
        (at("horizon")(2.5), "whole number of samples"),
        (at("settings", "steps")(7), "`steps` must be left out"),
        (set_version(12), "not those of this format version"),
    ):
        policy.save(path)
        rewrite(path, change)
        refuse(path, message)
    with pytest.raises(PolicyFormatError):
        Policy.load(path)


def test_the_page_iterates_the_map(policy, tmp_path):
    code = (
        'import { makeLookup } from "#page/policy/lookup.js";'
        'import { makeLoop } from "#page/loop/loop.js";'
        'import { model } from "./model.js";'
        + BEGIN
        + "const { policy } = input, loop = makeLoop(policy, makeLookup(policy), model);"
        "const run = options => { try { return loop.run([0.1], options) } "
        "catch (error) { return error.message } };"
        "print([loop.substeps(2), policy.horizon, run({ duration: 10, delay: 1 }),"
        " run({ rate: 3 }), run({ delay: 0.3 })]);"
    )
    substeps, horizon, run, *refused = node(tmp_path, code, policy)
    assert substeps == {"steps": 1, "resolved": True} and horizon == 2.0
    trajectory = simulate(policy, [0.1], 10, delay=1.0)
    np.testing.assert_allclose(list(run["x"]), trajectory.states[:, 0], rtol=1e-12)
    assert run["totalCost"] == pytest.approx(trajectory.cost, rel=1e-12)
    assert refused == ["a map has its own rate, and a delay of whole samples"] * 2
    shown = formulas(policy)
    assert "<mo>+</mo>" in shown["dynamics"][0] and "∑" in shown["cost"][0]


def test_better_policies_and_the_optimum_are_those_of_the_map(policy):
    x = np.linspace(0.1, 1.3, 25)
    best = capsyn.optimum(stock(), duration=2.0, starts=x[:, None])
    costs = stock_costs(x, 3).min(axis=1)  # of three samples and an end as a fourth
    np.testing.assert_allclose(best.costs, costs, atol=2e-4)
    rough = synthesize(stock(max_level=7, horizon=1, default=0.0))
    better = capsyn.improve(rough, starts=60, rounds=1, horizons=2.0).policy
    assert best.compare(better).ratio <= best.compare(rough).ratio
    assert better.discrete and better.settings.sample_time == 0.5


def test_a_tail_is_fitted_to_loops_of_a_map():
    cart = stock(
        dynamics=lambda x, u: [x[0] + 0.1 * x[1] + 0.005 * u[0], x[1] + 0.1 * u[0]],
        sample_time=0.1,
        domain=Box([-1, -1], [1, 1]),
        alphabet=[-1.0, 0.0, 1.0],
        default=0.0,
        running_cost=lambda x: x[0] ** 2 + 0.1 * x[1] ** 2,
        terminal_cost=None,
        target=None,
        tail="fit",
        horizon=5,
        max_level=2,
    )
    fitted = simulate(synthesize(cart), [0.8, 0.0], 10)
    plain = simulate(synthesize(cart.replace(tail=None)), [0.8, 0.0], 10)
    assert fitted.costs[-1] < plain.costs[-1]


def test_gymnasium_and_control_take_a_step_a_sample():
    pytest.importorskip("gymnasium")
    pytest.importorskip("control")
    from capsyn.integrations.control import plant_system
    from capsyn.integrations.gymnasium import environment

    env = environment(stock())
    env.reset(options={"state": [0.3]})
    observed, reward, *_ = env.step(2)
    assert observed[0] == grown(0.3, 1.0) and reward == pytest.approx(-((0.3 - 0.7) ** 2))
    system = plant_system(stock(), 0.5)
    assert system.dynamics(0, [0.3], [1.0])[0] == grown(0.3, 1.0)
    with pytest.raises(ProblemError, match="`dt` must be 0.5"):
        plant_system(stock(), 0.1)
    with pytest.raises(ProblemError, match="`rate` must be 2"):
        environment(stock(), rate=10.0)
