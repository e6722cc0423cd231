"""Plants: which model, which dimensions, how exactly it is integrated."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

from capsyn import Box, online_controller, problems, simulate, synthesize
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.simulation import plant as plants
from capsyn.simulation.plant import ACCURACY, COST_ACCURACY, choose_substeps, plant_of
from support.closed_loops import integrate, linear_problem, relay, relay_problem, tank_interior

NO_P = np.zeros((0, 1))


def one(plant, x, u, duration, substeps, push=None, p=NO_P):
    """Return the state and the cost of one trial after a duration."""
    x = np.asarray(x, dtype=float)[:, None]
    push = np.zeros_like(x) if push is None else np.asarray(push, dtype=float)[:, None]
    state, cost = plant.advance(
        x, np.zeros(1), np.asarray(u, dtype=float)[:, None], p, push, np.array([duration]), substeps
    )
    return state[:, 0], cost[0]


def test_the_plant_is_the_model_of_the_controller_or_another():
    tank = problems.plain("double-tank-a")
    other = tank.replace(
        dynamics=lambda x, u: [x[1] + u[0], u[1] * u[2]], running_cost=lambda x: 7 * x[0]
    )
    controller = online_controller(tank, backend="numpy", settings=tank_interior().settings)
    x, u = np.array([[0.3], [0.4]]), np.array([[1.0], [2.0], [3.0]])
    own = plant_of(controller)
    assert own.dynamics == controller.model.dynamics and (own.n, own.m) == (2, 3)
    assert own.domain == tank.domain and own.parameters == ()
    plant = plant_of(controller, other)
    assert plant.rates(x, u, NO_P)[:, 0].tolist() == [1.4, 6.0]
    assert plant.running_cost.evaluate(x)[0][0] == pytest.approx(2.1)


def test_a_function_as_plant_keeps_costs_and_names_of_the_controller():
    policy = relay()
    plant = plant_of(policy, lambda x, u: [3 * u[0] + x[0]])
    assert plant.rates(np.array([[0.5]]), np.array([[2.0]]), NO_P).tolist() == [[6.5]]
    assert plant.running_cost == policy.model.running_cost and plant.domain == policy.domain
    assert plant.terminal_cost == policy.model.terminal_cost
    plant = plant_of(policy, lambda x, u, p: [p[0] * u[0] + p[1]], ["gain", "drift"])
    assert plant.parameters == ("gain", "drift")
    found = plant.rates(np.zeros((1, 2)), np.ones((1, 2)), np.array([[2.0, 3.0], [0.5, 0.0]]))
    assert found.tolist() == [[2.5, 3.0]]


def test_a_policy_is_a_plant():
    policy = relay(name="other")
    assert plant_of(relay(), policy).dynamics == policy.model.dynamics
    assert plant_of(lambda t, x: x, policy).dynamics == policy.model.dynamics


BARE = relay(model=None)
REFUSED = [
    (BARE, {}, "`model` must be a Problem, or a Policy with a model, for a controller without one"),
    (
        lambda t, x: x,
        {"model": lambda x, u: [u[0]]},
        "`model` must be a Problem, or a Policy with a model, for a controller without one",
    ),
    (relay(), {"model": 3}, "`model` must be a Problem, a Policy with a model or a function"),
    (relay(), {"model": BARE}, "`model` must be a Problem, a Policy with a model or a function"),
    (
        relay(),
        {"parameters": ["k"]},
        "`parameters` need a `model` that is a function of x, u and p",
    ),
    (
        relay(),
        {"parameters": ["k"], "model": relay_problem()},
        "`parameters` need a `model` that is a function of x, u and p; got Problem(",
    ),
    (
        relay(),
        {"model": problems.plain("cart-pendulum")},
        "`model` must have 1 state(s) and 1 input(s) like the controller; got 2 state(s)",
    ),
]


@pytest.mark.parametrize(("controller", "options", "message"), REFUSED)
def test_refusals(controller, options, message):
    with pytest.raises(ProblemError) as caught:
        plant_of(controller, **options)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "function",
    [lambda x, u: [u[0], 1.0], lambda x, u: x[4], lambda x: [x[0]], lambda x, u: [ca.SX.sym("a")]],
)
def test_a_function_that_is_no_plant_is_named(function):
    with pytest.raises(ProblemError, match="`model` ") as caught:
        plant_of(relay(), function)
    assert "\n" not in str(caught.value)


def test_the_integration_is_of_fourth_order():
    problem = problems.plain("cart-pendulum").replace(running_cost=lambda x: ca.sin(x[0]))
    plant = plant_of(online_controller(problem, backend="numpy"))
    push = np.array([0.1, -0.3])
    wanted, cost = integrate(problem, np.array([1, 2.0]), [(0, np.array([5.0]))], 0, 0.8, push)
    errors = []
    for substeps in (8, 16, 32):
        state, found = one(plant, [1, 2], [5], 0.8, substeps, push)
        errors.append(max(*np.abs(state - wanted), abs(found - cost)))
    assert 1e-9 < errors[2] < errors[1] / 12 < errors[0] / 144


def test_no_time_changes_nothing():
    plant = plant_of(online_controller(linear_problem(), backend="numpy"))
    x = np.array([0.1, -0.7, 3.0])
    state, cost = one(plant, x, [1, 2, 3], 0.0, 3, [5, 5, 5])
    assert np.array_equal(state, x) and cost == 0.0


def test_trials_have_durations_and_pushes_of_their_own():
    plant = plant_of(online_controller(linear_problem(), backend="numpy"))
    rng = np.random.default_rng(0)
    x, u, push = rng.normal(size=(3, 3, 5))
    time = rng.uniform(0, 1, 5)
    states, costs = plant.advance(x, np.ones(5), u, NO_P, push, time, 4)
    for k in range(5):
        state, cost = one(plant, x[:, k], u[:, k], time[k], 4, push[:, k])
        assert np.array_equal(states[:, k], state) and costs[k] == pytest.approx(1 + cost)


@pytest.mark.parametrize("period", [0.01, 0.1, 0.5])
def test_the_steps_are_the_fewest_that_are_exact_enough(period):
    problem = problems.plain("cart-pendulum")
    plant = plant_of(online_controller(problem, backend="numpy"))
    controls = np.array([[5.0], [-5.0], [0.0]])
    substeps = choose_substeps(plant, controls, NO_P, period)

    def error(substeps):
        states = problem.domain.sample(300, 7).T
        push, time = np.zeros_like(states), np.full(300, period)
        u = controls[np.arange(300) % 3].T
        (x, cost), (exact, paid) = (
            plant.advance(states, np.zeros(300), u, NO_P, push, time, count)
            for count in (substeps, 8 * substeps)
        )
        off = np.abs(x - exact) / problem.domain.widths[:, None]
        paid_off = np.abs(cost - paid) / max(paid.mean(), 1e-300) * period / COST_ACCURACY
        return np.percentile(np.maximum(off.max(axis=0), paid_off), 95)

    assert error(substeps) <= 1.2 * ACCURACY * period
    assert substeps == 1 or error(substeps // 2) > 0.5 * ACCURACY * period
    assert substeps & (substeps - 1) == 0


def test_the_steps_are_chosen_for_every_control_and_parameter():
    policy = relay()
    plant = plant_of(policy, lambda x, u, p: [ca.sin(p[0] * u[0] * x[0])], ["k"])
    slow = choose_substeps(plant, np.array([[1.0]]), np.array([[1.0]]), 0.1)
    fast = choose_substeps(plant, np.array([[1.0]]), np.array([[30.0]]), 0.1)
    some = choose_substeps(plant, np.array([[1.0]]), np.array([[1.0, 30.0]]), 0.1)
    idle = choose_substeps(plant, np.array([[0.0]]), np.array([[30.0]]), 0.1)
    both = choose_substeps(plant, np.array([[0.0], [1.0]]), np.array([[30.0]]), 0.1)
    assert idle == 1 < slow < fast == some == both


def test_a_switch_in_the_dynamics_warns(monkeypatch):
    monkeypatch.setattr(plants, "LADDER", plants.LADDER[:6])
    problem = relay_problem(dynamics=lambda x, u: [ca.if_else(x[0] > 0.1, -3.0, 7 + u[0])])
    plant = plant_of(online_controller(problem, backend="numpy"))
    with pytest.warns(CapsynWarning, match="the closed loop is integrated with .* give `substeps`"):
        substeps = choose_substeps(plant, np.array([[1.0]]), NO_P, 0.5)
    assert 1 <= substeps <= 64


def test_steps_that_are_too_long_for_a_stiff_plant_are_not_taken():
    problem = relay_problem(
        dynamics=lambda x, u: [-(x[0] ** 3)], domain=Box([-60], [60], names=["x"])
    )
    plant = plant_of(online_controller(problem, backend="numpy"))
    substeps = choose_substeps(plant, np.zeros((1, 1)), NO_P, 0.01)
    x = problem.domain.sample(200, 3)
    wanted = x / np.sqrt(1 + 2 * 0.01 * x**2)
    found, _ = plant.advance(
        x.T, np.zeros(200), np.zeros((1, 200)), NO_P, 0 * x.T, np.full(200, 0.01), substeps
    )
    assert np.percentile(np.abs(found.T - wanted), 95) < 1.2e-9
    x, _ = one(plant, [60.0], [0.0], 0.01, 1)
    assert not abs(x[0]) < 60, "one step explodes"


def test_the_best_steps_are_taken_where_the_error_stops_falling():
    ends = {1: 0.0, 2: 1e-3} | {1 << k: (1 + 0.01 * k * k) * 1e-3 for k in range(2, 9)}

    class Rough(plants.Plant):
        def advance(self, x, cost, u, p, push, duration, substeps):
            return x + 2 * ends[substeps], cost

    plant = plant_of(relay())
    rough = Rough(**vars(plant))
    with pytest.warns(CapsynWarning, match="integrated with 2 steps per sample, to 4e-05 widths"):
        assert choose_substeps(rough, np.zeros((1, 1)), NO_P, 0.1) == 2


@pytest.mark.parametrize(
    ("cost", "exact"),
    [
        (lambda x: 1 - ca.cos(20 * np.pi * x[0]), 1.0),
        (lambda x: ca.sin(7 * np.pi * x[0]) ** 2, 0.5),
        (lambda x: ca.fabs(x[0] - 0.5), 0.25),
    ],
)
def test_steps_resolve_the_cost_that_a_loop_gathers(cost, exact):
    problem = relay_problem(
        dynamics=lambda x, u: [u[0]],
        domain=Box([0], [1]),
        alphabet=[1.0],
        default=1.0,
        running_cost=cost,
    )
    run = simulate(synthesize(problem, max_level=0, outside="nearest"), [0.0], 1.0, rate=10.0)
    assert run.cost == pytest.approx(exact, abs=1e-6)


def test_kinks_do_not_drive_the_steps_of_a_loop():
    problem = relay_problem(
        dynamics=lambda x, u: [x[1], -ca.fmax(x[0], 0) + ca.fmin(x[0] + 0.4, 0) + u[0]],
        domain=Box([-3, -2], [3, 2]),
        alphabet=[-1.0, 1.0],
        default=0.0,
        running_cost=lambda x: x[0] ** 2,
    )
    plant = plant_of(online_controller(problem, backend="numpy"))
    assert choose_substeps(plant, np.array([[-1.0], [1.0]]), NO_P, 0.5) <= 64


def test_states_that_escape_do_not_matter_for_the_steps():
    problem = relay_problem(dynamics=lambda x, u: [x[0] ** 2], domain=Box([-1], [60], names=["x"]))
    plant = plant_of(online_controller(problem, backend="numpy"))
    fine = dataclasses.replace(plant, domain=Box([-1], [2], names=["x"]))
    few = choose_substeps(fine, np.zeros((1, 1)), NO_P, 0.02)
    assert 1 <= few <= choose_substeps(plant, np.zeros((1, 1)), NO_P, 0.01) <= 4096


def test_a_model_that_takes_more_parameters_is_told_so():
    def plant(x, u, p):
        return [p[0] * x[1], p[1] * u[0]]

    with pytest.raises(ProblemError) as caught:
        plant_of(online_controller(problems.plain("cart-pendulum")), plant, ("gain",))
    text = str(caught.value)
    assert "an index is out of range; it may take more parameters (`parameters`, --para" in text
    assert "\n" not in text


def test_roots_keep_to_their_range_once_in_loops_and_not_in_proofs():
    problem = relay_problem(dynamics=lambda x, u: [u[0] - ca.sqrt(x[0])], domain=Box([0], [1]))
    plant = plant_of(online_controller(problem, backend="numpy"))
    again = dataclasses.replace(dataclasses.replace(plant, time_unit="h"), time_unit="s")
    assert again.in_loops == plant.in_loops and plant.in_loops[0] != plant.dynamics
    one_state, none = np.array([[-1e-7]]), np.zeros((0, 1))
    assert plant.rates(one_state, np.zeros((1, 1)), none) == 0.0
    assert np.isnan(plant.dynamics.evaluate(one_state, np.zeros((1, 1)))[0]).all()
