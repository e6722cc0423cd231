"""Policies in Gymnasium's environments, and problems as environments."""

import subprocess
import sys
import warnings

import casadi as ca
import numpy as np
import pytest

from capsyn import Alphabet, Box, Problem, problems, simulate, subdivide, synthesize
from capsyn.errors import OutsideDomainError, ProblemError

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.utils.env_checker import check_env  # noqa: E402

from capsyn.integrations.gymnasium import (  # noqa: E402
    WORST_REWARD,
    Evaluation,
    environment,
    evaluate,
    player,
)
from support.closed_loops import two_inputs  # noqa: E402


class Counter(gymnasium.Env):
    """Pays the action that it gets, in episodes of three steps."""

    metadata = {"render_modes": []}

    def __init__(self, actions, observations=None):
        self.action_space = actions
        self.observation_space = observations or gymnasium.spaces.Box(-1.0, 1.0, (2,))
        self.seeds, self.seen = [], []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.seeds.append(seed)
        self.left = 3
        return self.observation(), {}

    def observation(self):
        return self.np_random.uniform(-1, 1, 2).astype(np.float32)

    def step(self, action):
        assert self.action_space.contains(action)
        self.seen.append(action)
        self.left -= 1
        return self.observation(), float(np.sum(action)), self.left == 0, False, {}


def sign_policy(values=(0, 1), **options):
    box = Box([-1, -1], [1, 1])
    alphabet = Alphabet(list(values))
    return subdivide(lambda x: (x[:, 0] > 0).astype(int), box, alphabet, partitions=8, **options)


@pytest.mark.parametrize("name", problems.names())
def test_every_problem_passes_the_checker(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(environment(problems.plain(name)), skip_render_check=True)


def test_an_environment_moves_as_a_simulation_does():
    problem = problems.plain("cart-pendulum")
    env = environment(problem, rate=100.0, duration=0.5)
    policy = synthesize(problem, max_level=2)
    run = simulate(policy, [3.0, 0.2], 0.5, 100.0, substeps=env._substeps)
    observed, info = env.reset(options={"state": [3.0, 0.2]})
    total = 0.0
    for k in range(50):
        np.testing.assert_allclose(info["state"], run.states[k], rtol=1e-12)
        observed, reward, terminated, truncated, info = env.step(int(policy(observed)))
        total += reward
        assert terminated is False and truncated is (k == 49)
    np.testing.assert_allclose(total, -run.cost, rtol=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.024])
def test_a_policy_that_remembers_acts_as_in_a_simulation(delay):
    problem = two_inputs(delay=delay)
    policy = synthesize(problem)
    env = environment(problem, rate=100.0, duration=2.0)
    run = simulate(policy, [0.5, 1.0], 2.0, 100.0, substeps=env._substeps)
    act = player(policy, env)
    for _ in range(2):
        act.reset()
        _, info = env.reset(options={"state": [0.5, 1.0]})
        total = 0.0
        for k in range(200):
            np.testing.assert_allclose(info["state"], run.states[k], rtol=1e-9, atol=1e-12)
            action = act(info["state"])
            assert action == run.symbols[k]
            _, reward, _, _, info = env.step(action)
            total += reward
        np.testing.assert_allclose(total, -run.cost, rtol=1e-9)
    assert run.switches > 5
    plain = Counter(gymnasium.spaces.Discrete(4))
    with pytest.raises(ProblemError, match="`period` must be given, the time of a step"):
        evaluate(policy, plain, 1)
    evaluate(policy, plain, 3, period=0.05)


def test_observations_stay_in_the_space_and_leaving_may_end():
    problem = problems.plain("cart-pendulum")
    env = environment(problem, rate=10.0)
    for start in ([1.57, 5.0], [1.57, 7.0], [-9.0, -5.0]):
        observed, info = env.reset(options={"state": start})
        for _ in range(20):
            assert env.observation_space.contains(observed)
            observed, _, terminated, _, info = env.step(1)
            assert not terminated  # the rule is nearest
    strict = environment(problem.replace(outside="error"), rate=10.0)
    strict.reset(options={"state": [3.5, 4.99]})
    ended = [strict.step(0)[2] for _ in range(20)]
    assert any(ended)


def test_episodes_may_end_in_the_target():
    problem = problems.plain("double-tank-b")
    assert problem.target is not None
    env = environment(problem, rate=100.0, stop_at_target=True)
    env.reset(options={"state": problem.target.center})
    assert env.step(0)[2] is True


def test_seeds_give_the_same_episodes():
    env = environment(problems.plain("double-tank-a"), rate=20.0, duration=0.5)
    policy = synthesize(problems.plain("double-tank-a"), max_level=1, outside="nearest")
    one, two = evaluate(policy, env, 5, seed=3), evaluate(policy, env, 8, seed=3)
    assert np.array_equal(one.returns, two.returns[:5])
    assert len(set(two.returns)) == 8
    assert not np.array_equal(one.returns, evaluate(policy, env, 5, seed=4).returns)
    assert one.lengths.tolist() == [10] * 5 and not one.terminated.any()


def test_symbols_become_discrete_actions():
    env = Counter(gymnasium.spaces.Discrete(3, start=5))
    found = evaluate(sign_policy(), env, 40, seed=1)
    assert set(env.seen) == {5, 6} and len(env.seen) == 120 and found.terminated.all()
    assert len(set(env.seeds)) == 40
    env = Counter(gymnasium.spaces.Discrete(3))
    evaluate(sign_policy(), env, 10, actions=[2, 0])
    assert set(env.seen) == {0, 2}


def test_controls_become_continuous_actions():
    env = Counter(gymnasium.spaces.Box(-2.0, 2.0, (1,)))
    found = evaluate(sign_policy([-2, 1.5]), env, 20)
    assert {float(a[0]) for a in env.seen} == {-2.0, 1.5}
    np.testing.assert_allclose(found.returns.sum(), np.sum(env.seen))


def test_observations_may_be_mapped():
    env = Counter(gymnasium.spaces.Discrete(2))
    act = player(sign_policy(), env, observation=lambda o: [-o[0], o[1]])
    assert act([0.5, 0]) == 0 and act([-0.5, 0]) == 1


def test_the_rule_outside_holds():
    env = Counter(gymnasium.spaces.Discrete(2))
    with pytest.raises(OutsideDomainError):
        player(sign_policy(), env)([3.0, 0.0])
    assert player(sign_policy(outside="nearest"), env)([3.0, 0.0]) == 1
    assert player(sign_policy(outside=0), env)([3.0, 0.0]) == 0
    lost = player(sign_policy(outside=-1), env)
    with pytest.raises(ProblemError, match=r"an entry for the default control.*\[3.0, 0.0\]"):
        lost([3.0, 0.0])
    assert player(sign_policy(outside=-1), env, actions=[1, 1, 0])([3.0, 0.0]) == 0


def test_without_a_compiler_policies_play_the_same(monkeypatch):
    env = Counter(gymnasium.spaces.Discrete(2))
    one = evaluate(sign_policy(), env, 10).returns
    monkeypatch.setenv("CC", "no-such-compiler")
    assert np.array_equal(evaluate(sign_policy(), env, 10).returns, one)


def test_the_interval_is_students():
    found = Evaluation(np.array([1.0, 2.0, 4.0]), np.ones(3), np.ones(3, bool))
    low, high = found.interval
    np.testing.assert_allclose([low, high], 7 / 3 + np.array([-1, 1]) * 4.302653 * 0.8819171, 1e-5)
    assert "mean return 2.33333, -1.46" in repr(found) and found.to_json()["low"] == low
    one = Evaluation(np.ones(1), np.ones(1), np.ones(1, bool))
    assert one.interval == (-np.inf, np.inf) and one.to_json()["low"] is None


@pytest.mark.parametrize(
    "actions, options, words",
    [
        (gymnasium.spaces.Discrete(1), {}, "the policy has 2 symbols, the environment 1 actions"),
        (gymnasium.spaces.Discrete(3), {"actions": [0]}, "`actions` must have 2 entries, or 3"),
        (gymnasium.spaces.Discrete(3), {"actions": [0, 3]}, "the action 3 of symbol '1' is not in"),
        (gymnasium.spaces.Box(-1.0, 0.5, (1,)), {}, "of symbol '1' is not in Box"),
        (gymnasium.spaces.Box(-1.0, 1.0, (2,)), {}, "`actions` must be given: controls have 1"),
        (gymnasium.spaces.MultiBinary(2), {}, "must have Discrete or Box actions"),
        (gymnasium.spaces.Discrete(2), {"observation": 3}, "`observation` must be a function"),
        (gymnasium.spaces.Discrete(2), {"observation": lambda o: [1]},
         r"`observation` must give 2 numbers; got \[1\]"),
        (gymnasium.spaces.Discrete(2), {"observation": lambda o: None},
         "`observation` must give 2 numbers; got None"),
        (gymnasium.spaces.Discrete(2), {"observation": lambda o: "ab"},
         "`observation` must be numbers; got 'ab'"),
        (gymnasium.spaces.Discrete(2), {"observation": lambda o: [o[5], 0]},
         "`observation` failed: IndexError: "),
        (gymnasium.spaces.Discrete(2), {"actions": 3}, "`actions` must be a list of actions; got"),
        (None, {}, "`env` must have a space of actions; got None"),
        (gymnasium.spaces.Discrete(2), {"episodes": 0}, "`episodes` must be a whole number >= 1"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named(actions, options, words):
    with pytest.raises(ProblemError, match=words):
        evaluate(sign_policy(), Counter(actions), **{"episodes": 1, **options})


def test_other_bad_arguments_are_named():
    discrete = gymnasium.spaces.Discrete(2)
    wide = Counter(discrete, gymnasium.spaces.Box(-1.0, 1.0, (3,)))
    problem = problems.plain("cart-pole")
    for call, words in (
        (lambda: evaluate(3, Counter(discrete)), "`policy` must be a capsyn.Policy"),
        (lambda: evaluate(sign_policy(), 3), "`env` must be a gymnasium.Env; got 3"),
        (lambda: player(sign_policy(), "CartPole-v1"), "`env` must be a gymnasium.Env"),
        (lambda: evaluate(sign_policy(), "No-v0"),
         "`env` must be a registered environment; got 'No-v0': NameNotFound"),
        (lambda: evaluate(sign_policy(), "no_such_module:No-v0"), "ModuleNotFoundError"),
        (lambda: evaluate(sign_policy(), "a:b:c"), "`env` must be a registered environment"),
        (lambda: environment(problem, rate=1e300, duration=1e300),
         "`duration` must be at most 1,000,000,000 samples; got 1e.300 s at 1e.300 samples per"),
        (lambda: environment(problem, rate=1e-310), "`1 / rate` must be a finite number"),
        (lambda: environment(problem, substeps=10**9), "`substeps` must be .* <= 1000000"),
        (lambda: evaluate(sign_policy(), wide), "`observation` must be given where"),
        (lambda: environment(3), "`problem` must be a capsyn.Problem"),
        (lambda: environment(problem, rate=0), "`rate` must be a finite number > 0"),
        (lambda: environment(problem, duration=-1), "`duration` must be a finite number > 0"),
        (lambda: environment(problem, stop_at_target=True), "a problem without a target"),
        (lambda: environment(problem).reset(options={"state": [1]}), r"must have shape \(4,\)"),
        (lambda: environment(problem).step(2), r"`action` must be in Discrete\(2\); got 2"),
    ):  # fmt: skip
        with pytest.raises(ProblemError, match=words) as error:
            call()
        assert "\n" not in str(error.value)


class Broken(Counter):
    """Does something else where it is told to."""

    def __init__(self, **broken):
        super().__init__(gymnasium.spaces.Discrete(2))
        for name, method in broken.items():
            setattr(self, name, method)


@pytest.mark.parametrize(
    "broken, words",
    [
        ({"reset": lambda seed: np.zeros(2)[5]}, r"failed to begin the episode of seed \d+: Index"),
        ({"reset": lambda seed: np.zeros(3)}, "failed to begin the episode .*ValueError: too many"),
        ({"reset": lambda seed: (np.zeros(1), {})}, "`observation` must give 2 numbers; got a"),
        ({"reset": lambda seed: (None, {})}, "`observation` must give 2 numbers; got None"),
        ({"step": lambda action: 1 / 0}, r"failed in step 1 of the episode of seed \d+: ZeroDiv"),
        ({"step": lambda action: (np.zeros(2), None, True, False, {})}, "in step 1 .*: TypeError"),
        ({"step": lambda action: (np.zeros(2), -np.inf, True, False, {})},
         r"`env` must give finite rewards; got -inf in step 1 of the episode of seed \d+"),
        ({"step": lambda action: (np.zeros(2), np.nan, True, False, {})}, "got nan in step 1"),
    ],
)  # fmt: skip
def test_a_broken_environment_is_named_in_one_line(broken, words):
    with pytest.raises(ProblemError, match=words) as error:
        evaluate(sign_policy(outside="nearest"), Broken(**broken), 2)
    assert "\n" not in str(error.value)
    assert ("failed" in str(error.value)) == (error.value.__cause__ is not None)


@pytest.mark.parametrize("what", ["state", "cost", "end"])
def test_what_is_not_finite_ends_an_episode_with_the_worst_reward(what):
    problem = Problem(
        name="blow-up",
        dynamics=lambda x, u: [(1e308 if what == "state" else 0) * x[0] ** 3 + u[0]],
        domain=Box([-10], [10]), alphabet=Alphabet([-1, 1]), default=0.0, horizon=1.0,
        running_cost=lambda x: ca.log(x[0] + 5) if what == "cost" else x[0] ** 2,
        terminal_cost=lambda x: ca.log(x[0] + 5) if what == "end" else 0 * x[0], outside="nearest",
    )  # fmt: skip
    env = environment(problem, rate=10.0, duration=0.1 if what == "end" else 1.0, substeps=1)
    env.reset(options={"state": [-8.0]})
    observed, reward, terminated, truncated, _ = env.step(0)
    assert reward == WORST_REWARD and np.isfinite(np.float32(reward)) and (terminated or truncated)
    assert env.observation_space.contains(observed)
    env.reset(options={"state": [0.0]})
    assert env.step(0)[1] > -2 or what == "state"


@pytest.mark.parametrize("name", ["gymnasium", "control"])
def test_a_missing_extra_names_itself_in_one_line(name):
    code = f"import sys; sys.modules[{name!r}] = None\nimport capsyn.integrations.{name}"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    last = run.stderr.strip().splitlines()[-1]
    assert last.startswith("capsyn.errors.ProblemError") and f"pip install 'capsyn[{name}]'" in last
