"""Orbits of candidates under the symmetries of problems that have some, and of others."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from capsyn import Ball, Box, Problem, SsacSettings, problems
from capsyn.alphabets.candidates import actuator_combinations, without_dominated
from capsyn.alphabets.gains import candidate_gradients
from capsyn.alphabets.symmetries import orbits, symmetries

PUSHES = np.vstack([np.eye(3), -np.eye(3), np.zeros((1, 3))])
"""One unit along each axis, back along each, and none."""


def cube(m=3, **changes) -> Problem:
    """Return a problem of `m` points on lines, which are alike."""
    options = {
        "name": "cube",
        "dynamics": lambda x, u: [*(x[m + i] for i in range(m)), *(u[i] for i in range(m))],
        "domain": Box([-1] * 2 * m, [1] * 2 * m),
        "alphabet": np.eye(m),
        "default": np.zeros(m),
        "horizon": 0.5,
        "running_cost": lambda x: sum(x[i] ** 2 for i in range(m)),
        "terminal_cost": lambda x: sum(x[m + i] ** 2 for i in range(m)),
        "settings": SsacSettings(control_weight=0.1, steps=8),
    }
    return Problem(**options | changes)


def test_the_axes_of_a_cube_are_one_orbit():
    assert len(symmetries(cube(), PUSHES)[0]) == 48
    assert orbits(cube(), PUSHES) == [(0, 1, 2, 3, 4, 5), (6,)]
    fewer = PUSHES[[0, 1, 3, 6]]
    assert orbits(cube(), fewer) == [(0, 2), (1,), (3,)], "no way for the second to come back"


def test_of_too_many_maps_the_simplest_tell_the_orbits(monkeypatch):
    monkeypatch.setattr("capsyn.alphabets.symmetries.MOST_WORK", 2 * PUSHES.size * 12)
    assert len(symmetries(cube(), PUSHES)[0]) == 12
    assert orbits(cube(), PUSHES) == [(0, 1, 2, 3, 4, 5), (6,)]


def heavier(x, u):
    """Return the rates of the points of a cube, of which the last is heavier."""
    return [x[3], x[4], x[5], u[0], u[1], 0.5 * u[2]]


BROKEN = {
    "dynamics": ({"dynamics": heavier}, [(0, 1, 3, 4), (2, 5), (6,)]),
    "cost": (
        {"running_cost": lambda x: x[0] ** 2 + x[1] ** 2 + 1.01 * x[2] ** 2},
        [(0, 1, 3, 4), (2, 5), (6,)],
    ),
    "terminal cost": (
        {"terminal_cost": lambda x: x[3] ** 2 + (x[4] - 0.1) ** 2 + x[5] ** 2},
        [(0, 2, 3, 5), (1,), (4,), (6,)],
    ),
    "domain": (
        {"domain": Box([-1] * 6, [1] * 5 + [2])},
        [(0, 1, 3, 4), (2,), (5,), (6,)],
    ),
    "target": (
        {"target": Ball([0, 0.1, 0, 0, 0, 0], 0.2)},
        [(0, 2, 3, 5), (1,), (4,), (6,)],
    ),
    "target of some states": (
        {"target": Ball([0.0], 0.2, names=["x1"])},
        [(0, 3), (1, 2, 4, 5), (6,)],
    ),
    "target as a function": (
        {"target": lambda x: ca.logic_and(x[0] ** 2 < 0.01, x[1] < 0.1)},
        [(0, 3), (1,), (2, 5), (4,), (6,)],
    ),
    "limits": (
        {"limits": lambda x: [x[0] - 0.5, -0.5 - x[0], x[1] - 0.5]},
        [(0, 3), (1,), (2, 5), (4,), (6,)],
    ),
    "default": ({"default": [0.0, 0.0, 0.3]}, [(0, 1, 3, 4), (2,), (5,), (6,)]),
    "law": (
        {"default": lambda x: [-x[3], -x[4], -0.9 * x[5]]},
        [(0, 1, 3, 4), (2, 5), (6,)],
    ),
    "effort": (
        {"settings": SsacSettings(control_weight=np.diag([1.0, 2.0, 1.0]))},
        [(0, 2, 3, 5), (1, 4), (6,)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", BROKEN)
def test_what_tells_the_axes_apart_splits_their_orbit(what):
    changes, expected = BROKEN[what]
    assert orbits(cube(**changes), PUSHES) == expected


def test_a_pendulum_is_mirrored_about_the_middle_of_its_circle():
    problem = problems.plain("cart-pendulum")
    levels = np.linspace(-5, 5, 11)[:, None]
    assert orbits(problem, levels) == [(k, 10 - k) for k in range(5)] + [(5,)]


def test_docking_turns_by_quarters_and_is_mirrored():
    free = problems.get("docking")
    problem = free.replace(
        exogenous=None,
        partitions=1,
        dynamics=lambda x, u: free.dynamics(x, u, [0.0]),
        running_cost=lambda x: free.running_cost(x, [0.0]),
        target=lambda x: free.target(x, [0.0]),
    )
    found = actuator_combinations(problem, 4)
    values = found.values[without_dominated(problem, found)[0]]
    groups = orbits(problem, values)
    assert sorted(k for group in groups for k in group) == list(range(65))
    assert groups[:2] == [(0,), tuple(range(1, 9))] and max(map(len, groups)) == 8
    assert all(len({values[k].sum() for k in group}) == 1 for group in groups)
    told = orbits(free, values)
    assert told[:5] == [(0,), (1, 2), (3, 4), (5, 7), (6, 8)], "a port to wait at tells ahead"


@pytest.mark.parametrize("name", ["cart-pole", "docking", "quadrotor"])
def test_gradients_at_an_image_are_those_of_the_images(name):
    problem = problems.plain(name)
    values, states = problem.alphabet.values, problem.space.sample(20)
    maps, images = symmetries(problem, values)
    assert len(maps) >= 2 and images.tolist()[0] == list(range(len(values)))
    own = candidate_gradients(problem, values, states, "numpy")
    for readings, image in zip(np.moveaxis(maps.images(states.T), 1, 0), images):
        moved = candidate_gradients(problem, values, readings.T, "numpy")
        np.testing.assert_allclose(moved[:, image], own, atol=1e-7 * np.abs(own).max())


def follow(**changes) -> Problem:
    """Return a problem of a state that follows an exogenous input."""
    options = {
        "name": "follow",
        "dynamics": lambda x, u, w: [u[0] - x[0]],
        "domain": Box([-1], [1]),
        "exogenous": Box([-0.5], [0.5], names=["goal"]),
        "alphabet": [-1.0, 0.0, 1.0],
        "default": 0.0,
        "horizon": 0.5,
        "running_cost": lambda x, w: (x[0] - w[0]) ** 2,
    }
    return Problem(**options | changes)


def test_exogenous_inputs_are_mirrored_with_the_states():
    levels = np.array([[-1.0], [0.0], [1.0]])
    assert orbits(follow(), levels) == [(0, 2), (1,)]
    uneven = follow(exogenous=Box([-0.5], [0.75], names=["goal"]))
    assert orbits(uneven, levels) == [(0,), (1,), (2,)]


def test_a_map_is_mirrored_about_a_middle_that_is_not_zero():
    problem = Problem(
        name="tank",
        dynamics=lambda x, u: [x[0] + 0.1 * (u[0] - 1) * (1 + (x[0] - 3) ** 2)],
        domain=Box([2], [4]),
        alphabet=[0.0, 2.0],
        default=1.0,
        horizon=3,
        running_cost=lambda x: (x[0] - 3) ** 2,
        discrete=True,
        sample_time=0.1,
    )
    assert orbits(problem, np.array([[0.0], [0.5], [1.5], [2.0]])) == [(0, 3), (1, 2)]


def test_readings_where_rates_are_not_finite_say_nothing():
    problem = cube(2, dynamics=lambda x, u: [x[2], ca.sqrt(x[3]), u[0], u[1]])
    values = np.vstack([np.eye(2), -np.eye(2)])
    assert orbits(problem, values) == [(0, 2), (1,), (3,)]
    nowhere = cube(2, dynamics=lambda x, u: [x[2], x[3], ca.sqrt(-1 - x[0] ** 2), u[1]])
    assert orbits(nowhere, values) == [(0,), (1,), (2,), (3,)]
