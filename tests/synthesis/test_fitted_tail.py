"""Fitted tails: against answers that are known, what they bring, and what has none."""

import dataclasses
import json

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

import capsyn
from capsyn import problems
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.improvement.quadratic_fit import Starts, fitted, squares
from capsyn.improvement.refits import cheaper, system_of
from capsyn.modelling.tails.riccati import goal_of
from capsyn.modelling.tails.tail import Tail
from capsyn.modelling.transcription import casadi_from_program, transcribe
from support.processes.command_line import capsyn as command

WEIGHT = 0.5
RATES = np.array([[0.0, 1.0], [1.0, -0.3]]), np.array([[0.0], [1.0]])


def leaning(**changes):
    """Return a linear system that falls unless held, by many pushes whose squares cost."""

    def dynamics(x, u):
        return ca.mtimes(RATES[0], x) + ca.mtimes(RATES[1], u)

    settings = {
        "name": "leaning",
        "dynamics": dynamics,
        "domain": capsyn.Box([-0.25, -0.25], [0.25, 0.25], names=["lean", "speed"]),
        "alphabet": np.linspace(-3.0, 3.0, 21),
        "default": 0.0,
        "horizon": 0.2,
        "running_cost": lambda x: 2 * x[0] ** 2 + 0.5 * x[1] ** 2,
        "outside": "nearest",
        "settings": capsyn.SsacSettings(
            rule="steepest", control_weight=WEIGHT, sample_time=0.02, steps=8
        ),
        "partitions": 5,
        "max_level": 2,
    }
    return capsyn.Problem(**settings | changes)


@pytest.fixture(scope="module")
def problem():
    return leaning()


@pytest.fixture(scope="module")
def tail(problem):
    return capsyn.fitted_tail(problem, 2, loops=150)


@pytest.mark.filterwarnings("ignore::capsyn.errors.CapsynWarning")
def test_of_the_loops_of_a_regulator_it_is_nearly_the_regulators():
    exact = solve_continuous_are(*RATES, np.diag([2, 0.5]), [[WEIGHT]])
    fine = leaning(horizon=0.05, alphabet=np.linspace(-3, 3, 121), max_level=5).replace(
        tail=lambda x: ca.bilin(ca.DM(exact), x, x)
    )
    found = capsyn.fitted_tail(capsyn.synthesize(fine), 1, goal=[0, 0], duration=6.0)
    np.testing.assert_allclose(found.matrix, exact, rtol=0.15)
    assert found.horizon == fine.horizon and found.effort is None
    assert found.text.startswith("fitted tail: goal (") and "\n" not in found.text


def test_synthesize_finds_it_and_the_file_keeps_it(problem, tmp_path):
    policy = capsyn.synthesize(problem.replace(tail="fit"))
    policy.save(tmp_path / "leaning.cap")
    kept = capsyn.Policy.load(tmp_path / "leaning.cap")
    states = problem.domain.sample(50, 1)
    values = kept.model.terminal_cost.evaluate(states.T)[0][0]
    np.testing.assert_allclose(values, policy.model.terminal_cost.evaluate(states.T)[0][0])
    costs = [
        capsyn.simulate(each, states, 6.0, model=problem).costs[:, -1].mean()
        for each in (policy, capsyn.synthesize(problem))
    ]
    assert costs[0] < 0.1 * costs[1]


def test_neither_threads_nor_units_change_it(problem, tail):
    one = capsyn.fitted_tail(problem, 2, loops=150, threads=1)
    assert np.array_equal(one.matrix, tail.matrix)
    scaled = leaning(
        dynamics=lambda x, u: 1e-3 * ca.mtimes(RATES[0], 1e3 * x) + 1e-3 * ca.mtimes(RATES[1], u),
        domain=capsyn.Box([-0.25e-3, -0.25e-3], [0.25e-3, 0.25e-3]),
        running_cost=lambda x: 7e6 * (2 * x[0] ** 2 + 0.5 * x[1] ** 2),
        settings=dataclasses.replace(problem.settings, control_weight=7 * WEIGHT),
    )
    found = capsyn.fitted_tail(scaled, 2, loops=150)
    np.testing.assert_allclose(found.matrix, 7e6 * tail.matrix, rtol=0.02)


def test_it_goes_on_from_a_policy_whose_goal_is_found_in_its_model(problem, tail):
    policy = capsyn.synthesize(problem.replace(tail=tail))
    with pytest.warns(
        CapsynWarning, match="cost more than those of the policy that the fits began"
    ):
        again = capsyn.fitted_tail(policy, 1, duration=6.0)
    np.testing.assert_allclose(again.matrix, tail.matrix, rtol=0.3)
    np.testing.assert_allclose(goal_of(system_of(policy), None), 0, atol=1e-6)


@pytest.mark.filterwarnings("ignore::capsyn.errors.CapsynWarning")
def test_the_goal_moves_with_exogenous_inputs(problem, tail):
    told = leaning(
        dynamics=lambda x, u, w: problem.dynamics(ca.vertcat(x[0] - w[0], x[1]), u),
        running_cost=lambda x, w: problem.running_cost([x[0] - w[0], x[1]]),
        exogenous=capsyn.Box([-0.05], [0.05], names=["place"]),
        max_level=2,
    )
    found = capsyn.fitted_tail(told, 1, loops=200)
    np.testing.assert_allclose(found.goal([0.03]), [0.03, 0], atol=1e-6)
    np.testing.assert_allclose(found.matrix, tail.matrix, rtol=0.5)


def test_a_fit_is_exact_where_costs_are_those_of_a_tail():
    matrix, goal = np.array([[2.0, 0.3], [0.3, 0.5]]), np.array([3.0, 0.2])
    domain = capsyn.Box([0, -3], [2 * np.pi, 3], periodic=[True, False])
    made = Tail(matrix, goal, np.zeros(1), None, 0.1, domain.periods)
    blank = dataclasses.replace(made, matrix=np.zeros((2, 2)))
    starts = Starts(domain, None, domain, blank, None)
    z = starts.draw(200, 0)
    assert (np.abs(starts.offsets(z)[:, 0]) <= np.pi).all()
    values, times = np.array([made(state) for state in z]), np.linspace(0.5, 1.0, 200)
    columns = squares(z - goal, domain.periods)
    np.testing.assert_allclose((columns * matrix).sum(axis=(1, 2)), values, rtol=1e-12)
    found = fitted(starts, z, values + 0.3 * times, times, 0.2)
    np.testing.assert_allclose(found.matrix, matrix, rtol=1e-9)
    indefinite = (columns * np.diag([1.0, -1.0])).sum(axis=(1, 2)) + 20
    left = np.linalg.eigvalsh(fitted(starts, z, indefinite, times, 0.2).matrix)
    assert left[0] >= 0 and left[1] > 0
    assert fitted(starts, z, np.full(200, np.inf), times, 0.2) is None
    assert fitted(starts, z, np.zeros(200), times, 0.2) is None


def test_costs_are_compared_start_by_start():
    assert cheaper(np.array([1.0, 1.0, 1e9]), np.array([9.0, 9.0, 1.0]))
    assert not cheaper(np.array([1.0, np.inf]), np.array([1.5, 2.0]))
    assert cheaper(np.array([1.0, 2.0]), np.array([1.0, np.inf]))
    assert not cheaper(np.array([1.0, 0.0]), np.array([1.0, 0.0]))


@pytest.mark.parametrize("name", ["boost-converter", "docking", "quadrotor", "double-pendulum"])
def test_programs_become_casadi_again(name):
    program = transcribe(problems.plain(name)).dynamics
    function = casadi_from_program(program)
    random = np.random.default_rng(0)
    inputs = [random.uniform(0.1, 1.0, (size, 20)) for _, size in program.inputs]
    np.testing.assert_allclose(function(*inputs), program.evaluate(*inputs)[0], rtol=1e-12)


def push(x, u):
    return [x[1], u[0] + 9]


@pytest.mark.parametrize(
    ("changes", "options", "line"),
    [
        ({"running_cost": None, "terminal_cost": lambda x: x[0]}, {}, "`tail` needs a `running_c"),
        (
            {"dynamics": push, "alphabet": [-3, 3]},
            {},
            "no mixture of the symbols holds any state of the domain",
        ),
        ({}, {"goal": [0.1, 0.2]}, "no mixture of the symbols holds lean = 0.1, speed = 0.2"),
        ({}, {"goal": [0.0]}, "`goal` must be a state of the domain"),
        ({"running_cost": lambda x: 0 * x[0]}, {}, "`tail` finds nothing to fit"),
        ({}, {"rounds": 0}, "`rounds` must be a whole number >= 1; got 0"),
        ({}, {"loops": 1}, "`loops` must be a whole number >= 2; got 1"),
        ({}, {"delta": 0}, "`delta` must be a finite number > 0; got 0"),
        ({}, {"rate": -1}, "`rate` must be a finite number > 0; got -1"),
        ({}, {"duration": 0}, "`duration` must be a finite number > 0; got 0"),
        ({}, {"initial": 3}, "`initial` must be a Ball or a Box; got 3"),
        ({}, {"seed": -1}, "`seed` must be a whole number >= 0; got -1"),
    ],
)
def test_what_has_no_fitted_tail_is_told_in_one_line(changes, options, line):
    with pytest.raises(ProblemError) as told:
        capsyn.fitted_tail(
            leaning(max_level=0, settings=capsyn.SsacSettings(rule="steepest"), **changes),
            **options,
        )
    assert line in str(told.value) and "\n" not in str(told.value)


def test_what_is_no_problem_or_has_no_tail_yet_is_told(problem, tail):
    with pytest.raises(ProblemError, match="`source` must be a Problem or a Policy; got 'x'"):
        capsyn.fitted_tail("x")
    policy = capsyn.synthesize(problem, max_level=0)
    with pytest.raises(ProblemError, match="`source` must carry its model, of a policy"):
        capsyn.fitted_tail(dataclasses.replace(policy, model=None))
    with pytest.raises(ProblemError, match="`source` must have no input delay"):
        capsyn.fitted_tail(dataclasses.replace(policy, delay=0.1))
    unfound = problem.replace(tail="fit")
    with pytest.raises(ProblemError, match="'fit' is found by `synthesize`; here it must be given"):
        transcribe(unfound)
    with pytest.raises(ProblemError, match="`horizon` must be"):
        problem.replace(tail="fit", horizon=None)
    with pytest.raises(ProblemError, match="`tail` needs a `running_cost`"):
        problem.replace(tail="fit", running_cost=None)


MASS = """
import capsyn

problem = capsyn.Problem(
    name="mass",
    dynamics=lambda x, u: [x[1], u[0]],
    domain=capsyn.Box([-1, -1], [1, 1]),
    alphabet=[-1, 1],
    default=0,
    horizon=0.3,
    running_cost=lambda x: x[0] ** 2,
    outside="nearest",
    settings=capsyn.SsacSettings(rule="steepest", sample_time=0.05),
    partitions=3,
    max_level=2,
)
"""


def test_the_command_line_has_it(tmp_path):
    (tmp_path / "mass.py").write_text(MASS)
    path = tmp_path / "mass.cap"
    out, _ = command("synth", tmp_path / "mass.py", "--tail", "fit", "--json", "-o", path)
    assert json.loads(out)["horizon"] == 0.3
    run = capsyn.simulate(capsyn.Policy.load(path), np.array([[0.7, 0.0]]), 10.0)
    assert np.abs(run.states[0, -1]).max() < 0.15
