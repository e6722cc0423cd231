"""Riccati tails: against solutions by hand, their derivatives, their goals, and what is refused."""

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

import capsyn
from capsyn import problems
from capsyn.errors import ProblemError
from capsyn.modelling.tails.tail import Tail
from capsyn.modelling.transcription import transcribe
from capsyn.sources.finite_control_set import finite_control_set


def double_integrator(**changes):
    """Return a mass on a line by pushes of 1 and -1, whose place alone costs."""
    settings = {
        "name": "mass",
        "dynamics": lambda x, u: [x[1], u[0]],
        "domain": capsyn.Box([-2, -3], [2, 3], names=["place", "speed"]),
        "alphabet": [-1.0, 1.0],
        "default": 0.0,
        "horizon": 0.5,
        "running_cost": lambda x: x[0] ** 2,
    }
    return capsyn.Problem(**settings | changes)


def by_hand(r):
    """Return P of the double integrator with l = x1^2 + r u^2."""
    return np.sqrt([[2 * np.sqrt(r), r], [r, 2 * np.sqrt(r) * r]])


@pytest.mark.parametrize("effort", [0.3, 1.0, 20.0])
def test_the_double_integrator_is_solved_by_hand(effort):
    tail = capsyn.riccati_tail(double_integrator(), effort)
    r = effort * 2.0**2 / 10
    np.testing.assert_allclose(tail.matrix, by_hand(r), rtol=1e-9)
    np.testing.assert_allclose(tail.goal, 0, atol=1e-9)
    np.testing.assert_allclose(tail.control, 0, atol=1e-9)
    x = np.array([0.7, -1.1])
    np.testing.assert_allclose(tail(x), x @ by_hand(r) @ x, rtol=1e-9)
    pole = r**-0.25  # the closed loop's, both of this size
    assert tail.horizon == pytest.approx(0.5 / pole, rel=0.05)
    assert f"effort {effort:g}" in tail.text and "\n" not in tail.text


def test_units_of_inputs_and_of_the_cost_change_nothing_but_the_unit_of_v():
    tail = capsyn.riccati_tail(double_integrator())
    other = double_integrator(
        dynamics=lambda x, u: [x[1], u[0] / 1000],
        alphabet=[-1000.0, 1000.0],
        running_cost=lambda x: 7 * x[0] ** 2,
    )
    scaled = capsyn.riccati_tail(other)
    np.testing.assert_allclose(scaled.matrix, 7 * tail.matrix, rtol=1e-9)
    assert scaled.horizon == tail.horizon


def test_it_is_that_of_a_regulator_whose_inputs_are_weighed_by_their_distance():
    problem = problems.get("planar-quadrotor")
    z, u = ca.SX.sym("z", 6), ca.SX.sym("u", 2)
    rates = ca.vertcat(*problem.dynamics(z, u))
    at = ca.Function("at", [z, u], [ca.jacobian(rates, z), ca.jacobian(rates, u)])
    a, b = map(np.array, at(np.zeros(6), problem.default))
    q, half = np.diag([1, 1, 2, 0.3, 0.3, 0.2]), problem.domain.widths / 2
    distance = np.ptp(problem.alphabet.values) / 2
    found, r = capsyn.riccati_tail(problem, 0.6).matrix, 0.6 * half @ q @ half / 10 / distance**2
    expected = solve_continuous_are(a, b, q, r * np.eye(2))
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


def test_on_a_periodic_axis_it_is_smooth_periodic_and_least_at_the_goal():
    matrix = np.array([[2.0, 0.3], [0.3, 0.5]])
    tail = Tail(matrix, np.array([3.0, 0.2]), np.zeros(1), 1.0, 0.1, np.array([2 * np.pi, 0.0]))
    x = ca.SX.sym("x", 2)
    value = ca.Function("v", [x], [tail(x), ca.gradient(tail(x), x), ca.hessian(tail(x), x)[0]])
    at_goal = value([3.0, 0.2])
    assert float(at_goal[0]) == 0
    np.testing.assert_allclose(np.array(at_goal[1]).ravel(), 0, atol=1e-12)
    np.testing.assert_allclose(at_goal[2], 2 * matrix, atol=1e-9)
    states = np.random.default_rng(0).uniform([0, -3], [2 * np.pi, 3], (200, 2))
    values = np.array([float(value(state)[0]) for state in states])
    again = np.array([float(value(state + [2 * np.pi, 0])[0]) for state in states])
    np.testing.assert_allclose(again, values, atol=1e-9)
    assert (values > 0).all()
    step = 1e-6
    for state in states[:20]:
        slopes = [
            float(value(state + step * e)[0] - value(state - step * e)[0]) / (2 * step)
            for e in np.eye(2)
        ]
        np.testing.assert_allclose(np.array(value(state)[1]).ravel(), slopes, atol=1e-6)


def test_the_goal_is_the_targets_centre_or_where_rest_costs_least():
    mass = double_integrator(target=capsyn.Ball([0.5], 0.1, names=["place"]))
    np.testing.assert_allclose(capsyn.riccati_tail(mass).goal, [0.5, 0], atol=1e-6)
    assert capsyn.riccati_tail(mass, goal=[-1.0, 0.0]).goal.tolist() == [-1.0, 0.0]
    tank = problems.get("double-tank-b")
    tail = capsyn.riccati_tail(tank)
    assert tail.goal.tolist() == [0.4, 0.6]
    rates = np.array(tank.functions()["dynamics"](tail.goal, tail.control)).ravel()
    np.testing.assert_allclose(rates, 0, atol=1e-7)
    assert tail.control[1] == pytest.approx(0.2) and (tail.control > 0).all()


def test_the_goal_moves_with_exogenous_inputs():
    told = double_integrator(
        dynamics=lambda x, u, w: [x[1], u[0]],
        running_cost=lambda x, w: (x[0] - w[0] - 2 * w[1]) ** 2,
        exogenous=capsyn.Box([-0.5, 0.0], [0.5, 0.2], names=["setpoint", "offset"]),
        tail="riccati",
    )
    tail = capsyn.riccati_tail(told)
    np.testing.assert_allclose(tail.goal([0.3, 0.1]), [0.5, 0.0], atol=1e-6)
    given = capsyn.riccati_tail(told, goal=lambda w: [w[0] + 2 * w[1], 0])
    np.testing.assert_allclose(given.matrix, tail.matrix, rtol=1e-6)
    value, gradient = transcribe(told).terminal_cost.evaluate(np.array([[0.9, -0.4, 0.3, 0.1]]).T)
    d = np.array([0.4, -0.4])
    assert value[0, 0] == pytest.approx(d @ tail.matrix @ d, rel=1e-5)
    np.testing.assert_allclose(gradient[:2, 0], 2 * tail.matrix @ d, rtol=1e-5)
    assert (gradient[2:] == 0).all()


def test_a_problem_takes_its_tail_in_the_place_of_its_terminal_cost(tmp_path):
    plain = double_integrator(terminal_cost=lambda x: 3 * x[0] ** 2)
    problem = plain.replace(tail="riccati:0.5", horizon=None)
    tail = capsyn.riccati_tail(plain, 0.5)
    assert problem.horizon == tail.horizon
    same = plain.replace(tail=tail, horizon=None)
    x = np.array([[0.5, 1.0], [-2.0, 0.1]])
    for made in (problem, same):
        value = transcribe(made).terminal_cost.evaluate(x.T)[0][0]
        np.testing.assert_allclose(value, [tail(state) for state in x], rtol=1e-12)
    value = transcribe(problem.replace(tail=None)).terminal_cost.evaluate(x.T)[0][0]
    np.testing.assert_allclose(value, 3 * x[:, 0] ** 2)
    own = plain.replace(tail=lambda x: x[0] ** 4)
    np.testing.assert_allclose(transcribe(own).terminal_cost.evaluate(x.T)[0][0], x[:, 0] ** 4)
    policy = capsyn.synthesize(problem, max_level=1)
    policy.save(tmp_path / "mass.cap")
    kept = capsyn.Policy.load(tmp_path / "mass.cap").model.terminal_cost
    np.testing.assert_allclose(kept.evaluate(x.T)[0][0], [tail(state) for state in x], rtol=1e-12)


def test_a_replaced_problem_has_the_tail_of_its_own_fields():
    problem = double_integrator(tail="riccati")
    x = np.array([[0.5], [1.0]])

    def value(made):
        return transcribe(made).terminal_cost.evaluate(x)[0].item()

    assert value(problem.replace(horizon=1.0)) == value(problem)
    heavier = problem.replace(running_cost=lambda x: 3 * x[0] ** 2)
    assert value(heavier) == pytest.approx(3 * value(problem))
    assert value(problem.replace(tail="riccati:9")) > 2 * value(problem)
    assert value(problem.replace(alphabet=[-2.0, 2.0])) < value(problem)
    with pytest.raises(TypeError, match="horizons"):
        problem.replace(horizons=2.0)


def test_predictive_control_of_depth_one_takes_the_tail_too():
    plain, costs = double_integrator(), []
    starts = plain.domain.sample(50, 0) / 2
    with_tail = finite_control_set(plain, 1, sample_time=0.1, tail="riccati")
    own = finite_control_set(plain.replace(tail="riccati"), 1, sample_time=0.1)
    np.testing.assert_array_equal(with_tail.costs(starts), own.costs(starts))
    deep, short = (finite_control_set(plain, depth, sample_time=0.1) for depth in (5, 1))
    for control in (with_tail, deep, short):

        def act(time, states, control=control):
            return plain.alphabet.values[control(states)]

        costs.append(capsyn.simulate(act, starts, 8.0, rate=10, model=plain).costs[:, -1].mean())
    assert costs[0] < 0.9 * costs[1] < 0.9 * costs[2]


PUSH = {"dynamics": lambda x, u: [x[1], u[0] + 2]}
DRIFT = {"dynamics": lambda x, u: [x[1] + u[0], 0.1 * x[1]]}


@pytest.mark.parametrize(
    ("changes", "options", "line"),
    [
        ({}, {"effort": 0}, "`effort` must be a finite number > 0; got 0"),
        ({"running_cost": None, "terminal_cost": lambda x: x[0]}, {}, "`tail` needs a `running_c"),
        (PUSH, {}, "no mixture of the symbols holds any state of the domain"),
        (PUSH, {"goal": [0, 0]}, "no mixture of the symbols holds place = 0, speed = 0"),
        (DRIFT, {"goal": [0, 0]}, "`tail` needs a goal that the symbols stabilise: what moves"),
        ({}, {"goal": [0.0]}, "`goal` must be a state of the domain, 2 number(s); got [0.0]"),
        ({}, {"goal": [5.0, 0.0]}, "`goal` must be a state of the domain, 2 number(s); got [5.0"),
        ({}, {"goal": lambda w: w}, "`goal` must be numbers where there are no exogenous inputs"),
        (
            {"running_cost": lambda x: x[1] ** 2},
            {"goal": [0, 0]},
            "`tail` needs a running cost of all that does not decay: what moves at the goal",
        ),
        (
            {"running_cost": lambda x: -(x[0] ** 2) - x[1] ** 2},
            {"goal": [0, 0]},
            "`tail` needs a running cost that has its least value at the goal: its second deriv",
        ),
        (
            {"running_cost": lambda x: ca.sqrt(x[0]) + x[1] ** 2},
            {"goal": [0, 0]},
            "`tail` must have a goal where dynamics and running cost are smooth; derivatives there",
        ),
    ],
)
def test_what_has_no_tail_is_told_in_one_line(changes, options, line):
    with pytest.raises(ProblemError) as told:
        capsyn.riccati_tail(double_integrator(**changes), **options)
    assert line in str(told.value) and "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("tail", "line"),
    [
        ("fitted", "`tail` must be 'riccati', 'riccati:EFFORT', 'fit' or a function; got 'fitted'"),
        (3, "`tail` must be 'riccati', 'riccati:EFFORT', 'fit' or a function; got 3"),
        ("riccati:-1", "`tail` must have an effort > 0; got 'riccati:-1'"),
        ("riccati:much", "`tail` must have an effort > 0; got 'riccati:much'"),
        (lambda x: [x[0], x[1]], "`tail` must return a scalar"),
    ],
)
def test_a_problem_refuses_other_tails(tail, line):
    with pytest.raises(ProblemError) as told:
        double_integrator(tail=tail)
    assert line in str(told.value)


def test_a_horizon_is_proposed_by_riccati_tails_only():
    with pytest.raises(ProblemError, match="`horizon` must be a number > 0; got None"):
        double_integrator(horizon=None)
    with pytest.raises(ProblemError, match="`horizon` must be a number > 0; got None"):
        double_integrator(horizon=None, tail=lambda x: x[0] ** 2)


def lagging(share, goal=None):
    """Return a problem whose first state no symbol moves directly."""
    return capsyn.Problem(
        name="lag",
        dynamics=lambda x, u: [0.7 * x[1] ** 2 - x[0] ** 2 - 0.5, 3 * u[0] - x[1]],
        domain=capsyn.Box([0.1, 0], [2, 3]),
        alphabet=[0, 1],
        default=0,
        horizon=0.5,
        running_cost=lambda x: (x[0] - share) ** 2 + 0.1 * x[1] ** 2,
        target=capsyn.Ball([share], 0.1, names=["x1"]) if goal is None else None,
    )


@pytest.mark.parametrize("place", [0.7, 0.9, 1.1, 1.3])
def test_goals_that_rest_only_nearly_by_their_digits_are_held(place):
    found = capsyn.riccati_tail(lagging(place))
    rest = np.sqrt((place**2 + 0.5) / 0.7)
    assert found.goal == pytest.approx([place, rest], abs=1e-5)
    assert found.control == pytest.approx([rest / 3], abs=1e-3)
    typed = [place, float(f"{rest:.6g}")]
    assert capsyn.riccati_tail(lagging(place), goal=typed).control == pytest.approx(
        found.control, abs=1e-3
    )
    with pytest.raises(ProblemError, match="no mixture of the symbols holds"):
        capsyn.riccati_tail(lagging(place), goal=[place, rest + 0.05])
