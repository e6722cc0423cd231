"""The built-in problems, against the tables of the paper and of problems.md."""

import itertools

import casadi as ca
import numpy as np
import pytest

from capsyn import Ball, SsacSettings, problems
from capsyn.errors import ProblemError
from capsyn.problems import cart_pendulum, double_tank

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
    "settings": SsacSettings(gamma=-5.0, control_weight=0.3),
    "partitions": (9, 9),
    "max_level": 4,
    "target": cart_pendulum.has_upright_energy,
}
EXPECTED = {
    "cart-pendulum": PENDULUM | {"symbols": [[5.0], [-5.0]]},
    "cart-pendulum-4": PENDULUM | {"symbols": [[-5.0], [-2.0], [2.0], [5.0]]},
    "double-tank-a": TANK
    | {
        "symbols": [list(v) for v in itertools.product((0.0, 1.0), repeat=3)],
        "settings": SsacSettings(gamma=-10.0),
        "target": Ball([0.8, 0.2], 0.1),
    },
    "double-tank-b": TANK
    | {
        "symbols": [[0.0, 0.2, 0.0], [0.0, 0.2, 1.0], [1.0, 0.2, 0.0], [1.0, 0.2, 1.0]],
        "settings": SsacSettings(rule="steepest"),
        "target": Ball([0.4, 0.6], 0.05),
    },
    "cart-pole": {
        "bounds": ([-2.0, -3.0, -0.6, -3.0], [2.0, 3.0, 0.6, 3.0]),
        "periodic": (False,) * 4,
        "outside": "error",
        "symbols": [[-5.0], [5.0]],
        "default": [0.0],
        "horizon": 0.6,
        "settings": SsacSettings(rule="steepest", steps=20),
        "partitions": (4, 4, 4, 4),
        "max_level": 2,
        "target": None,
    },
}


def test_names_are_the_five_problems_of_the_issue():
    assert problems.names() == list(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_parameters(name):
    problem = problems.get(name)
    assert {
        "bounds": (problem.domain.lower.tolist(), problem.domain.upper.tolist()),
        "periodic": problem.domain.periodic,
        "outside": problem.outside,
        "symbols": problem.alphabet.values.tolist(),
        "default": problem.default.tolist(),
        "horizon": problem.horizon,
        "settings": problem.settings,
        "partitions": problem.partitions,
        "max_level": problem.max_level,
        "target": problem.target,
    } == EXPECTED[name]
    assert problem.name == name and problem.refinement == (2,) * problem.domain.n
    assert problem.description and "\n" not in problem.description
    assert all(problem.domain.units) and all(problem.domain.names)


def values(name, state, control):
    """Return the rates, the running and the terminal cost of a built-in problem."""
    functions = problems.get(name).functions()
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
