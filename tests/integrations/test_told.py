"""Exogenous inputs in environments of Gymnasium and systems of python-control."""

import warnings

import casadi as ca
import numpy as np
import pytest

from capsyn import Box, Problem, simulate, synthesize
from capsyn.errors import ProblemError
from capsyn.integrations.stepping import stepper

gymnasium = pytest.importorskip("gymnasium")
control = pytest.importorskip("control")
from gymnasium.utils.env_checker import check_env  # noqa: E402

from capsyn.integrations.control import plant_system, policy_system  # noqa: E402
from capsyn.integrations.gymnasium import environment, evaluate, player  # noqa: E402


def room(**options):
    """Return a room whose temperature a heater brings to a setpoint, beside a cold outdoors."""
    return Problem(
        "room",
        lambda x, u, w: [0.5 * (w[1] - x[0]) + 20 * u[0], x[0] - w[0]],
        Box([10.0, -50.0], [30.0, 50.0], names=["T", "error"]),
        [0.0, 0.5, 1.0],
        0.5,
        1.0,
        running_cost=lambda x, w: (x[0] - w[0]) ** 2,
        terminal_cost=lambda x, w: 0.1 * (x[0] - w[0]) ** 2,
        target=lambda x, w: ca.fabs(x[0] - w[0]) < 0.5,
        exogenous=Box([18.0, -5.0], [24.0, 15.0], names=["setpoint", "outdoor"]),
        partitions=4,
        max_level=1,
        **{"outside": "nearest", **options},
    )


@pytest.fixture(scope="module")
def policy():
    return synthesize(room())


def test_an_environment_that_is_told_passes_the_checker():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(environment(room()), skip_render_check=True)


def test_readings_are_observed_and_exogenous_inputs_stay_in_an_episode():
    env = environment(room(), rate=10.0, duration=2.0)
    assert env.observation_space.shape == (4,)
    np.testing.assert_array_equal(env.observation_space.low, [10, -50, 18, -5])
    drawn = []
    for seed in range(200):
        seen, info = env.reset(seed=seed)
        np.testing.assert_array_equal(seen, [*info["state"], *info["exogenous"]])
        drawn.append(info["exogenous"])
        over = False
        while not over:
            seen, _, _, over, info = env.step(2)
            np.testing.assert_array_equal(seen[2:], drawn[-1])
            np.testing.assert_array_equal(info["exogenous"], drawn[-1])
    shares = (np.array(drawn) - [18, -5]) / [6, 20]
    assert (0 <= shares).all() and (shares < 1).all()
    np.testing.assert_allclose(shares.mean(axis=0), 0.5, atol=0.06)
    np.testing.assert_array_equal(env.reset(seed=7)[1]["exogenous"], drawn[7])


def test_options_fix_what_is_drawn():
    env = environment(room())
    free, _ = env.reset(seed=3)
    for given in ([21.0, 4.0], {"outdoor": 4.0, "setpoint": 21.0}):
        seen, _ = env.reset(seed=3, options={"exogenous": given})
        np.testing.assert_array_equal(seen, [*free[:2], 21, 4])
        seen, _ = env.reset(options={"exogenous": given, "state": [20.0, 1.0]})
        np.testing.assert_array_equal(seen, [20, 1, 21, 4])
    for given, message in (
        ([21.0, 40.0], r"one of each: setpoint in \[18, 24\], outdoor in \[-5, 15\]"),
        ([21.0], "shape"),
        ({"setpoint": 21.0}, "must give setpoint, outdoor"),
        ([21.0, np.nan], "one of each"),
    ):
        with pytest.raises(ProblemError, match=message):
            env.reset(options={"exogenous": given})
    alone = environment(Problem("x", lambda x, u: [u[0]], Box([0.0], [1.0]), [0.0, 1.0], 0.0, 1.0,
                                running_cost=lambda x: x[0]))  # fmt: skip
    with pytest.raises(ProblemError, match="must be left out"):
        alone.reset(options={"exogenous": [1.0]})


@pytest.mark.parametrize("delay", [0.0, 0.25])
def test_an_episode_is_a_simulation(delay):
    problem = room(delay=delay)
    policy = synthesize(problem)
    env = environment(problem, rate=10.0, duration=3.0)
    act = player(policy, env)
    w = [22.5, 3.0]
    seen, _ = env.reset(options={"state": [14.0, 0.0], "exogenous": w})
    states, total, over = [seen[:2]], 0.0, False
    while not over:
        seen, reward, _, over, info = env.step(act(seen))
        states.append(info["state"])
        total += reward
    run = simulate(policy, [14.0, 0.0], 3.0, 10.0, exogenous=w)
    np.testing.assert_allclose(states, run.states, rtol=1e-9, atol=1e-9)
    assert -total == pytest.approx(float(run.cost), rel=1e-9)


def test_an_episode_ends_by_its_own_target_and_where_the_state_is_lost():
    env = environment(room(outside="error"), rate=10.0, duration=50.0, stop_at_target=True)
    env.reset(options={"state": [20.0, 0.0], "exogenous": [21.0, 10.0]})
    temperatures = []
    for _ in range(500):
        _, _, terminated, _, info = env.step(2)
        temperatures.append(info["state"][0])
        if terminated:
            break
    assert terminated and abs(temperatures[-1] - 21) < 0.5
    assert all(abs(T - 21) >= 0.5 for T in temperatures[:-1])
    env.reset(options={"state": [29.0, 0.0], "exogenous": [21.0, 10.0]})
    steps = iter(lambda: env.step(2)[2], True)
    assert len(list(steps)) < 10 and env.step(2)[4]["state"][0] > 30


def test_evaluation_draws_exogenous_inputs_for_each_episode(policy):
    env = environment(policy_problem := room(), rate=10.0, duration=3.0)
    seen = []
    found = evaluate(policy, env, 20, 1, observation=lambda z: seen.append(z[2:]) or z)
    assert len(np.unique(seen, axis=0)) == 20 and found.lengths.tolist() == [30] * 20
    again = evaluate(policy, environment(policy_problem, rate=10.0, duration=3.0), 20, 1)
    np.testing.assert_array_equal(found.returns, again.returns)
    with pytest.raises(ProblemError, match="not 4 numbers"):
        player(policy, environment(alone := policy_problem_of_two()))
    assert alone.exogenous is None


def policy_problem_of_two():
    box = Box([-1.0, -1.0], [1.0, 1.0])
    return Problem("two", lambda x, u: [x[1], u[0]], box, [-1.0, 1.0], 0.0, 1.0,
                   running_cost=lambda x: ca.sumsqr(x))  # fmt: skip


def test_a_step_takes_a_reading(policy):
    step = stepper(policy, 0.1)
    reading = [15.0, 0.0, 23.0, 0.0]
    symbol, memory = step(reading, np.zeros(3))
    assert symbol == policy(reading[:2], reading[2:]) and memory[0] == 1 + symbol


@pytest.mark.parametrize("of_policy", [False, True])
def test_exogenous_inputs_are_inputs_of_both_blocks(policy, of_policy):
    plant = plant_system(policy if of_policy else room(), 0.1)
    block = policy_system(policy, 0.1)
    assert plant.input_labels == ["u1", "setpoint", "outdoor"]
    assert plant.output_labels == plant.state_labels == ["T", "error"]
    assert block.input_labels == ["T", "error", "setpoint", "outdoor"]
    told = ["setpoint", "outdoor"]
    loop = control.interconnect([plant, block], inputs=told, outputs=["T", "error", "u1"])
    times = np.arange(41) * 0.1
    steps = np.where(times < 2, 20.0, 23.0)
    inputs = np.stack([steps, np.full(41, 5.0)])
    found = control.input_output_response(loop, times, inputs, [16.0, 0.0])
    run = simulate(
        policy, [16.0, 0.0], 4.0, 10.0, exogenous=lambda t: [20.0 if t < 2 else 23.0, 5.0]
    )
    np.testing.assert_allclose(found.outputs[:2].T, run.states, rtol=1e-7, atol=1e-7)
    np.testing.assert_array_equal(found.outputs[2, :-1], run.controls[:, 0])


def test_a_plant_in_continuous_time_has_its_own_dynamics():
    plant = plant_system(room())
    rates = plant.dynamics(0.0, [20.0, 1.0], [0.5, 22.0, 4.0])
    np.testing.assert_allclose(rates, [0.5 * (4 - 20) + 10, -2.0])
