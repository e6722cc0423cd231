"""The built-in problems, against the tables of the paper and of problems.md."""

import itertools

import casadi as ca
import numpy as np
import pytest

from capsyn import Ball, Box, SsacSettings, problems
from capsyn.errors import ProblemError
from capsyn.problems import (
    building,
    cart_pendulum,
    docking,
    double_pendulum,
    double_tank,
    inverter,
    spacecraft,
)

TANK = {
    "bounds": ([0.0, 0.0], [1.0, 1.0]),
    "periodic": (False, False),
    "outside": "error",
    "default": [0.0, 0.0, 0.0],
    "horizon": 0.5,
    "partitions": (9, 9),
    "max_level": 4,
}
PENDULUM = {
    "bounds": ([0.0, -5.0], [2 * np.pi, 5.0]),
    "periodic": (True, False),
    "outside": "nearest",
    "default": [0.0],
    "horizon": 1.2,
    "settings": SsacSettings(gamma=-5.0, control_weight=0.3, sample_time=0.001),
    "partitions": (9, 9),
    "max_level": 4,
    "target": cart_pendulum.has_upright_energy,
}
HEXAGON = [
    np.round([360 * np.cos(k * np.pi / 3), 360 * np.sin(k * np.pi / 3)], 9).tolist()
    for k in range(6)
]
EXPECTED = {
    "cart-pendulum": PENDULUM | {"symbols": [[5.0], [-5.0]]},
    "cart-pendulum-4": PENDULUM | {"symbols": [[-5.0], [-2.0], [2.0], [5.0]]},
    "double-tank-a": TANK
    | {
        "symbols": [list(v) for v in itertools.product((0.0, 1.0), repeat=3)],
        "settings": SsacSettings(gamma=-10.0, sample_time=0.001),
        "target": Ball([0.8, 0.2], 0.1),
    },
    "double-tank-b": TANK
    | {
        "symbols": [[0.0, 0.2, 0.0], [0.0, 0.2, 1.0], [1.0, 0.2, 0.0], [1.0, 0.2, 1.0]],
        "settings": SsacSettings(rule="steepest", sample_time=0.001),
        "target": Ball([0.4, 0.6], 0.05),
    },
    "cart-pole": {
        "bounds": ([-2.0, -3.0, -0.6, -3.0], [2.0, 3.0, 0.6, 3.0]),
        "periodic": (False,) * 4,
        "outside": "error",
        "symbols": [[-5.0], [5.0]],
        "default": [0.0],
        "horizon": 0.1,
        "settings": SsacSettings(rule="steepest", steps=20, sample_time=0.001),
        "partitions": (4, 4, 4, 4),
        "max_level": 1,
        "leaves": "affine",
        "tail": "riccati",
        "target": None,
    },
    "planar-quadrotor": {
        "bounds": ([-2.0, -2.0, -0.6, -2.0, -2.0, -2.0], [2.0, 2.0, 0.6, 2.0, 2.0, 2.0]),
        "periodic": (False,) * 6,
        "outside": "nearest",
        "symbols": [
            [a * 9.81 / 2, b * 9.81 / 2] for a, b in itertools.product((0.5, 1.5), repeat=2)
        ],
        "default": [9.81 / 2, 9.81 / 2],
        "horizon": 0.15,
        "settings": SsacSettings(rule="steepest", steps=16, sample_time=0.001),
        "partitions": (3,) * 6,
        "max_level": 0,
        "leaves": "affine",
        "tail": "riccati",
        "target": Ball([0.0] * 6, 0.2),
    },
    "spacecraft": {
        "bounds": ([-0.6] * 6, [0.6] * 6),
        "periodic": (False,) * 6,
        "outside": "nearest",
        "symbols": [
            *([s * 0.4 * (i == axis) for i in range(3)] for axis in range(3) for s in (1, -1)),
            [0.0] * 3,
        ],
        "default": [0.0] * 3,
        "horizon": 1.2,
        "settings": SsacSettings(rule="steepest", control_weight=0.1, steps=16, sample_time=0.001),
        "partitions": (3,) * 6,
        "max_level": 0,
        "leaves": "affine",
        "tail": "riccati",
        "target": Ball([0.0] * 6, 0.05),
    },
    "double-pendulum": {
        "bounds": ([0.0, 0.0, -9.0, -18.0], [2 * np.pi, 2 * np.pi, 9.0, 18.0]),
        "periodic": (True, True, False, False),
        "outside": "nearest",
        "symbols": [[-5.0], [0.0], [5.0]],
        "default": [0.0],
        "horizon": 0.5,
        "settings": SsacSettings(rule="steepest", control_weight=1.0, steps=48, sample_time=0.001),
        "partitions": (5, 6, 5, 6),
        "max_level": 1,
        "leaves": "affine",
        "target": double_pendulum.has_upright_energy,
    },
    "boost-converter": {
        "bounds": ([0.0, 0.0], [12.0, 60.0]),
        "periodic": (False, False),
        "outside": "nearest",
        "symbols": [[0.0], [1.0]],
        "default": [0.5],
        "horizon": 1e-3,
        "settings": SsacSettings(
            rule="steepest", steps=16, sample_time=5e-6, initial_duration=1e-4
        ),
        "partitions": (9, 9),
        "max_level": 4,
        "target": Box([3.5, 39.0], [4.5, 41.0], names=["current", "voltage"]),
    },
    "inverter": {
        "bounds": ([-20.0, -20.0, 0.0], [20.0, 20.0, 2 * np.pi]),
        "periodic": (False, False, True),
        "exogenous": {"speed": (0.0, 400.0), "current": (-15.0, 15.0)},
        "outside": "nearest",
        "symbols": [[0.0, 0.0], *HEXAGON, [0.0, 0.0]],
        "default": [0.0, 0.0],
        "horizon": 50e-6,
        "settings": SsacSettings(rule="steepest", control_weight=0.5, steps=1, sample_time=50e-6),
        "partitions": (1, 1, 60, 1, 4),
        "max_level": 0,
        "leaves": "affine",
        "target": None,
    },
    "building": {
        "bounds": ([19.0, 21.0], [27.0, 27.0]),
        "periodic": (False, False),
        "exogenous": {"setpoint": (20.0, 25.0), "outdoor": (26.0, 38.0)},
        "outside": "nearest",
        "symbols": [list(v) for v in itertools.product((0.0, 1.0, 2.0), (0.0, 1.0))],
        "default": building.holding,
        "horizon": 10.0,
        "settings": SsacSettings(rule="steepest", steps=8, sample_time=1.0),
        "partitions": (8, 8, 5, 2),
        "max_level": 0,
        "leaves": "affine",
        "target": building.is_comfortable,
    },
    "docking": {
        "bounds": (
            [-1.6, -1.6, -np.pi, -0.15, -0.15, -0.25],
            [1.6, 1.6, np.pi, 0.15, 0.15, 0.25],
        ),
        "periodic": (False, False, True, False, False, False),
        "exogenous": {"wait": (0.0, 1.0)},
        "outside": "nearest",
        "symbols": [list(map(float, flags)) for flags in docking.thrusters()],
        "default": [0.0] * 8,
        "horizon": 8.0,
        "settings": SsacSettings(rule="steepest", control_weight=0.25, steps=16, sample_time=0.05),
        "partitions": (1, 1, 24, 1, 1, 12, 4),
        "max_level": 0,
        "leaves": "affine",
        "target": docking.has_arrived,
    },
    "quadrotor": {
        "bounds": (
            [-2.0] * 6 + [-0.5] * 3 + [-2.0] * 3,
            [2.0] * 6 + [0.5] * 3 + [2.0] * 3,
        ),
        "periodic": (False,) * 12,
        "outside": "nearest",
        "symbols": [[k * 9.81 / 4 for k in row] for row in itertools.product((0.5, 1.5), repeat=4)],
        "default": [9.81 / 4] * 4,
        "horizon": 0.2,
        "settings": SsacSettings(rule="steepest", steps=8, sample_time=0.002),
        "partitions": (1,) * 12,
        "max_level": 0,
        "leaves": "affine",
        "tail": "riccati:2",
        "target": Ball([0.0] * 3, 0.3, names=["x", "y", "z"]),
    },
}


def test_names_are_those_of_the_issues():
    assert problems.names() == list(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_parameters(name):
    problem = problems.get(name)
    told = problem.exogenous
    assert {
        "leaves": problem.leaves,
        "tail": problem.tail,
        "exogenous": told and dict(zip(told.names, zip(told.lower, told.upper))),
        "bounds": (problem.domain.lower.tolist(), problem.domain.upper.tolist()),
        "periodic": problem.domain.periodic,
        "outside": problem.outside,
        "symbols": problem.alphabet.values.tolist(),
        "default": problem.default if problem.has_law else problem.default.tolist(),
        "horizon": problem.horizon,
        "settings": problem.settings,
        "partitions": problem.partitions,
        "max_level": problem.max_level,
        "target": problem.target,
    } == {"leaves": "constant", "tail": None, "exogenous": None} | EXPECTED[name]
    assert problem.name == name and problem.refinement == (2,) * problem.space.n
    assert problem.description and "\n" not in problem.description
    assert all(problem.space.units) and all(problem.space.names)


def values(name, state, control):
    """Return the rates, the running and the terminal cost of a built-in problem at a reading.

    The terminal cost is that of the problem without a tail.
    """
    functions = problems.plain(name).functions()
    rates = np.array(functions["dynamics"](state, control)).ravel()
    costs = (float(functions[f"{kind}_cost"](state)) for kind in ("running", "terminal"))
    return rates, *costs


@pytest.mark.parametrize("name", ["cart-pendulum", "cart-pendulum-4"])
def test_pendulum_is_equations_11_and_12(name):
    theta, omega, u = 0.7, -1.3, 2.0
    rates, running, terminal = values(name, [theta, omega], u)
    assert np.allclose(rates, [omega, 9.81 / 2 * np.sin(theta) + u / 2 * np.cos(theta)])
    energy = 0.5 * 2**2 * omega**2 + 9.81 * 2 * (np.cos(theta) - 1)
    assert running == 0.0 and np.isclose(terminal, 0.5 * energy**2)
    assert float(cart_pendulum.energy([0.0, 0.0])) == 0.0  # upright, at rest


@pytest.mark.parametrize(
    ("name", "goal"), [("double-tank-a", (0.8, 0.2)), ("double-tank-b", (0.4, 0.6))]
)
@pytest.mark.parametrize("state", [(0.7, 0.3), (0.4, 0.6), (0.2, 0.5)])
def test_tanks_are_equations_13_and_14(name, goal, state):
    x1, x2 = state
    rates, running, terminal = values(name, state, [1.0, 0.2, 0.6])
    between = 0.2 * np.sqrt(x1 - x2 + 0.5 if x2 > 0.5 else x1)
    assert np.allclose(rates, [1.0 - between, between - 0.6 * np.sqrt(x2)], rtol=1e-9)
    distance = (x1 - goal[0]) ** 2 + (x2 - goal[1]) ** 2
    assert np.isclose(running, distance) and np.isclose(terminal, 100 * distance)


def test_tank_rates_are_continuous_at_the_switch_and_flow_back():
    control = [0.0, 1.0, 0.0]
    below, above = (values("double-tank-a", [0.3, 0.5 + d], control)[0] for d in (-1e-9, 1e-9))
    assert np.allclose(below, above, atol=1e-8)
    rates = values("double-tank-a", [0.1, 0.9], control)[0]  # the lower tank stands higher
    assert np.allclose(rates, [np.sqrt(0.3), -np.sqrt(0.3)])


def test_cart_pole_is_the_model_of_problems_md():
    x, v, theta, omega = 0.3, -0.4, 0.2, 0.9
    rates, running, terminal = values("cart-pole", [x, v, theta, omega], 5.0)
    fall = (9.81 * np.sin(theta) + 5.0 * np.cos(theta)) / 2
    assert np.allclose(rates, [v, 5.0, omega, fall])
    assert np.isclose(running, x**2 + 0.5 * v**2 + 10 * theta**2 + omega**2) and terminal == 0.0


def test_quadrotor_is_the_model_of_problems_md():
    state, thrusts = [0.3, -0.4, 0.2, 0.9, -0.5, 0.7], [3.0, 6.0]
    rates, running, terminal = values("planar-quadrotor", state, thrusts)
    lift = [-9.0 * np.sin(0.2), 9.0 * np.cos(0.2) - 9.81]  # m = 1: along the tilted axis, gravity
    assert np.allclose(rates, [0.9, -0.5, 0.7, *lift, 0.25 * (3.0 - 6.0) / 0.1])
    cost = 0.3**2 + 0.4**2 + 2 * 0.2**2 + 0.3 * (0.9**2 + 0.5**2) + 0.2 * 0.7**2
    assert np.isclose(running, cost) and np.isclose(terminal, 5 * cost)
    hover = values("planar-quadrotor", np.zeros(6), [9.81 / 2, 9.81 / 2])[0]
    assert np.allclose(hover, 0.0)


def test_the_quadrotor_in_space_is_the_one_in_the_plane_where_it_stays_in_one():
    pitch, spin, (back, ahead) = 0.2, 0.7, (3.0, 2.0)  # x to the right is the plane's, mirrored
    state = np.zeros(12)
    state[[0, 2, 3, 5, 7, 10]] = 0.3, -0.4, 0.9, -0.5, pitch, spin
    rates, running, terminal = values("quadrotor", state, [ahead, 1.5, back, 1.5])
    lift = ahead + back + 3.0
    expected = np.zeros(12)
    expected[[0, 2, 7]] = 0.9, -0.5, spin
    expected[[3, 5]] = lift * np.sin(pitch), lift * np.cos(pitch) - 9.81
    expected[[10, 11]] = 0.25 * (back - ahead) / 0.01, 0.05 * (ahead + back - 3.0) / 0.02
    assert np.allclose(rates, expected) and terminal == 0.0
    weighed = 0.3**2 + 0.4**2 + 2 * pitch**2 + 0.3 * (0.9**2 + 0.5**2) + 0.2 * spin**2
    assert np.isclose(running, weighed)


def test_the_quadrotor_in_space_turns_as_a_rigid_body():
    inertia = np.array([0.01, 0.01, 0.02])
    angles, omega = np.array([[0.3, -0.2, 0.4], [0.5, -0.4, 0.2]])
    thrusts = np.array([1.0, 2.0, 3.5, 2.5])
    rates = values("quadrotor", [*np.zeros(6), *angles, *omega], thrusts)[0]

    def rotation(roll, pitch, yaw):  # from the body to the world
        turns = []
        for angle, (i, j) in ((yaw, (0, 1)), (pitch, (2, 0)), (roll, (1, 2))):
            turn = np.eye(3)
            turn[i, i] = turn[j, j] = np.cos(angle)
            turn[j, i] = np.sin(angle)
            turn[i, j] = -np.sin(angle)
            turns.append(turn)
        return turns[0] @ turns[1] @ turns[2]

    up = rotation(*angles)[:, 2]
    assert np.allclose(rates[3:6], thrusts.sum() * up - [0, 0, 9.81])
    step = 1e-6
    ends = [rotation(*(angles + sign * step * rates[6:9])) for sign in (1, -1)]
    spin = rotation(*angles).T @ (ends[0] - ends[1]) / (2 * step)  # [omega x]
    assert np.allclose([spin[2, 1], spin[0, 2], spin[1, 0]], omega, atol=1e-8)
    torque = [0.25 * (2.0 - 2.5), 0.25 * (3.5 - 1.0), 0.05 * (1.0 - 2.0 + 3.5 - 2.5)]
    assert np.allclose(inertia * rates[9:], torque - np.cross(omega, inertia * omega))


def test_plain_problems_have_no_tail_and_look_further():
    for name in problems.names():
        with_tail, plain = problems.get(name), problems.plain(name)
        assert plain.tail is None and plain.switching is None
        if name != "quadrotor":
            assert (plain.horizon > with_tail.horizon) == (with_tail.tail is not None)


def test_the_plain_double_pendulum_knows_slow_links_alone():
    problem, plain = problems.get("double-pendulum"), problems.plain("double-pendulum")
    assert plain.domain.upper[2:].tolist() == [6.0, 9.0] < problem.domain.upper[2:].tolist()
    assert plain.leaves == "constant" and plain.settings.control_weight == 0.5


def test_spacecraft_turns_as_its_attitude_says():
    inertia = np.array([1.0, 1.3, 0.8])
    sigma, omega, torque = np.array([[0.3, -0.2, 0.1], [0.5, -0.4, 0.2], [0.1, 0.0, -0.4]])
    rates, running, terminal = values("spacecraft", [*sigma, *omega], torque)

    def rotation(p):  # from the world to the body, by the cross-product matrix of p
        tilde = np.array([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
        square = p @ p
        return np.eye(3) + (8 * tilde @ tilde - 4 * (1 - square) * tilde) / (1 + square) ** 2

    step = 1e-6
    turned = (rotation(sigma + step * rates[:3]) - rotation(sigma - step * rates[:3])) / (2 * step)
    spin = turned @ rotation(sigma).T  # -[omega x]
    assert np.allclose(rotation(sigma) @ rotation(sigma).T, np.eye(3))
    assert np.allclose([spin[1, 2], spin[2, 0], spin[0, 1]], omega, atol=1e-8)
    assert np.allclose(inertia * rates[3:], torque - np.cross(omega, inertia * omega))
    assert np.isclose(running, sigma @ sigma + 0.5 * omega @ omega)
    assert np.isclose(terminal, 2 * running)


def test_spacecraft_cross_product():
    a, b = np.random.default_rng(0).normal(size=(2, 3))
    assert np.allclose(spacecraft.cross(list(a), list(b)), np.cross(a, b))


def test_double_pendulum_keeps_its_energy_but_for_the_work_of_the_shoulder():
    x = ca.SX.sym("x", 4)
    slope = ca.Function("slope", [x], [ca.gradient(double_pendulum.energy(x), x)])
    for state in np.random.default_rng(0).uniform(-3, 3, (20, 4)):
        for torque in (-5.0, 0.0, 5.0):
            rates, running, terminal = values("double-pendulum", state, [torque])
            power = float(ca.dot(slope(state), rates))
            assert np.isclose(power, torque * state[2], atol=1e-9)
            assert np.allclose(rates[:2], state[2:]) and running == 0.0
            assert np.isclose(terminal, 0.5 * float(double_pendulum.energy(state)) ** 2)
    assert float(double_pendulum.energy([0, 0, 0, 0])) == 0.0  # standing
    assert np.isclose(float(double_pendulum.energy([np.pi, 0, 0, 0])), -6 * 9.81)  # hanging


def test_boost_converter_rests_at_its_averaged_steady_state():
    rates, running, terminal = values("boost-converter", [4.0, 40.0], [0.5])
    assert np.allclose(rates, 0.0) and running == terminal == 0.0
    on, off = (values("boost-converter", [3.0, 30.0], [u])[0] for u in (1.0, 0.0))
    assert np.allclose(on, [20 / 1e-3, -30 / 20 / 100e-6])
    assert np.allclose(off, [(20 - 30) / 1e-3, (3 - 30 / 20) / 100e-6])
    stored = 0.5 * (1e-3 * 1.0**2 + 100e-6 * 10.0**2)  # J
    assert np.isclose(values("boost-converter", [3.0, 30.0], [0.0])[2], 1000 * stored)


def test_inverter_keeps_a_current_on_its_reference():
    (speed, size, angle), error = (300.0, 8.0, 0.7), np.array([0.5, -1.2])
    axis = np.array([-np.sin(angle), np.cos(angle)])
    turned = -np.array([np.cos(angle), np.sin(angle)])
    needed = 10e-3 * speed * size * turned + 0.5 * size * axis + 0.4 * speed * axis
    reading = [*(size * axis + error), angle, speed, size]
    rates, running, terminal = values("inverter", reading, needed)
    assert np.allclose(rates, [*(speed * size * turned - 0.5 / 10e-3 * error), speed, 0, 0])
    assert running == 0.0 and np.isclose(terminal, error @ error)
    legs = inverter.COMMUTATIONS
    assert legs[0].tolist() == [0, 1, 2, 1, 2, 1, 2, 3] and (legs == legs.T).all()


@pytest.mark.parametrize(("outdoor", "second"), [(26.0, None), (33.0, 25.5)])
def test_building_rests_at_its_setpoint_under_its_law(outdoor, second):
    told = np.array([23.0, outdoor])
    free = (0.002 * outdoor + 0.0025 * 23.0 + 0.004) / 0.0045  # without cold for the second room
    assert (free < 25.5) is (second is None)
    x = np.array([23.0, free if second is None else second])
    stage, valve = np.array(problems.get("building").functions()["default"]([*x, *told])).ravel()
    assert 0 < stage < 2 and (abs(valve) < 1e-9 if second is None else 0 < valve < 1)
    rates, running, terminal = values("building", [*x, *told], [stage, valve])
    assert np.allclose(rates, 0, atol=1e-12) and running == terminal == 0.0
    assert np.isclose(values("building", [24.0, 26.5, *told], [0, 0])[1], 1.0 + 10 * 1.0)


def test_docking_moves_in_axes_that_turn():
    x, w = np.array([0.7, -0.4, 0.9, 0.1, -0.05, 0.2]), 0.5
    flags = docking.thrusters()
    forces = [docking.wrench(flag) for flag in flags]
    assert len(flags) == 27 and len({tuple(force) for force in forces}) == 27
    assert max(map(sum, flags)) == 2
    spin = x[5] * np.array([[0, -1], [1, 0]])
    for flag, (ahead, left, moment) in zip(flags, forces):
        rates = values("docking", [*x, w], flag)[0]
        assert np.allclose(rates[:2] + spin @ x[:2], x[3:5])
        assert np.allclose(10 * (rates[3:5] + spin @ x[3:5]), [0.25 * ahead, 0.25 * left])
        assert np.allclose(rates[[2, 5, 6]], [x[5], 0.25 * 0.25 * moment / 0.5, 0])
    before = [-w * np.cos(x[2]), w * np.sin(x[2])]  # the port, in the axes of the satellite
    cost = values("docking", [*before, x[2], 0, 0, 0, w], flags[0])[1]
    assert np.isclose(cost, 1.2 * (1 - np.cos(x[2])))


def test_signed_root_is_odd_smooth_and_a_root():
    z = ca.SX.sym("z")
    root = double_tank.signed_root(z)
    slope = ca.gradient(root, z)
    function = ca.Function("root", [z], [root, slope, ca.gradient(slope, z)])

    def at(points):
        return np.array(function.map(len(points))(points)).reshape(3, -1)

    points = np.concatenate([[0.0], np.geomspace(1e-12, 10, 400)])
    value, first, second = at(points)
    mirrored, first_mirrored, second_mirrored = at(-points)
    assert (mirrored == -value).all()
    assert (first_mirrored == first).all() and (second_mirrored == -second).all()
    assert np.isfinite([first, second]).all()
    assert value[0] == 0.0 and np.isclose(first[0], 1e3) and second[0] == 0.0
    assert (np.diff(value) > 0).all() and (first > 0).all()
    away = points > 1e-3
    assert np.allclose(value[away], np.sqrt(points[away]), rtol=1e-6)
    assert np.allclose(first[away], 0.5 / np.sqrt(points[away]), rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("cart-pendulun", "did you mean 'cart-pendulum'?"),
        ("pendulum", "did you mean 'cart-pendulum'?"),
        ("double_tank_b", "did you mean 'double-tank-b'?"),
        ("cartpole", "did you mean 'cart-pole'?"),
        ("Cart-Pole", "did you mean 'cart-pole'?"),
        ("zzzz", "known are cart-pendulum, "),
        ("", "known are cart-pendulum, "),
    ],
)
def test_unknown_name_suggests_the_nearest(name, hint):
    with pytest.raises(ProblemError) as caught:
        problems.get(name)
    message = str(caught.value)
    assert message.startswith(f"there is no problem '{name}'; ") and hint in message
    assert "\n" not in message


# Problems of the user's own, by file or module
