"""Targets: what is inside, on which axes, and what is refused."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from capsyn import Ball, Box, problems
from capsyn.errors import ProblemError
from capsyn.modelling.targets import (
    INSIDE,
    check_target,
    describe_target,
    target_axes,
    target_program,
)
from capsyn.modelling.transcription import transcribe_target, user_program
from support.lanes import run_lanes

TURN = 2 * math.pi
ROOM = Box(
    [-1, 0, -5], [1, TURN, 5], names=["place", "angle", "speed"], periodic=[False, True, False]
)


def inside(target, domain, states):
    """Return whether states (B, n) are in a target, by NumPy and compiled, which must agree."""
    program = target_program(target, domain)
    (rows,) = program.evaluate(np.asarray(states, dtype=float).T)
    (lanes,) = run_lanes(program, np.asarray(states, dtype=float).T)
    found = np.broadcast_to(rows, lanes.shape)
    assert np.array_equal(found, lanes) and set(np.unique(found)) <= {0.0, 1.0}
    return found[0] != 0


def short_way(difference, width):
    """Return how far apart two points of a circle are."""
    return np.abs((difference + width / 2) % width - width / 2)


@pytest.mark.parametrize("center", [(0.2, 0.3, 1.0), (-0.5, TURN - 0.2, 0.0), (0, 5 * TURN, 0)])
def test_a_ball_reaches_across_the_seam(center):
    ball = Ball(center, 0.8)
    states = Box([-2, -2 * TURN, -6], [2, 3 * TURN, 6]).sample(4000, 1)
    states = np.vstack([states, np.asarray(center) + Box([-1] * 3, [1] * 3).sample(2000, 2)])
    off = states - center
    off[:, 1] = short_way(off[:, 1], TURN)
    distance = np.linalg.norm(off, axis=1)
    clear = np.abs(distance - 0.8) > 1e-9
    wanted = distance <= 0.8
    assert np.array_equal(inside(ball, ROOM, states)[clear], wanted[clear])
    assert 100 < wanted.sum() < 5000


def test_a_box_reaches_across_the_seam_and_has_its_faces():
    target = Box([-0.5, TURN - 0.25, -1], [0.5, TURN + 0.25, 2])
    states = [
        [0, 0, 0],
        [0, TURN, 0],
        [0, 0.2, 0],
        [0, TURN - 0.2, 0],
        [0, 0.3, 0],
        [0, TURN - 0.3, 0],
        [0.5, 0, 2],
        [-0.5, 0, -1],
        [np.nextafter(0.5, 1), 0, 0],
        [np.nextafter(-0.5, -1), 0, 0],
        [0, 0, np.nextafter(2, 3)],
        [0, 0, np.nextafter(-1, -2)],
    ]
    assert (
        inside(target, ROOM, states).tolist() == [True] * 4 + [False] * 2 + [True] * 2 + [False] * 4
    )


def test_a_box_as_wide_as_a_turn_or_wider_holds_every_angle():
    states = Box([0, -9, 0], [1, 9, 1]).sample(500)
    assert inside(Box([-1, 1, -5], [1, 1 + 2 * TURN, 5]), ROOM, states).all()


def test_the_boundary_of_a_ball_is_inside():
    line = Box([-4], [4])
    edge = [[1.0], [np.nextafter(1, 2)], [-1.0], [0.0], [np.nan], [np.inf], [-np.inf]]
    assert inside(Ball([0], 1), line, edge).tolist() == [True, False, True, True] + [False] * 3
    assert inside(Box([-1], [1]), line, edge).tolist() == [True, False, True, True] + [False] * 3


def test_names_choose_the_axes():
    ball = Ball([1.0, 0.1], 0.5, names=["speed", "angle"])
    assert target_axes(ball, ROOM) == [2, 1]
    states = [[99, 0.1, 1.0], [99, TURN + 0.1, 1.3], [0, 1.0, 0.1], [0, 0.1, 1.6]]
    assert inside(ball, ROOM, states).tolist() == [True, True, False, False]
    box = Box([-0.2], [0.2], names=["angle"])
    assert target_axes(box, ROOM) == [1]
    assert inside(box, ROOM, [[9, -0.1, 9], [0, 0.3, 0], [0, TURN - 0.1, 0]]).tolist() == [
        True,
        False,
        True,
    ]
    assert target_axes(Ball([0, 0, 0], 1), ROOM) == [0, 1, 2]
    assert target_axes(Box([0, 0, 0], [1, 1, 1]), ROOM) == [0, 1, 2]


def test_none_has_no_inside_and_a_condition_is_itself():
    assert not inside(None, ROOM, ROOM.sample(100)).any()
    program = user_program("target", lambda x: x[0] > x[2], (("x", 3),), INSIDE)
    assert target_program(program, ROOM) is program
    assert inside(program, ROOM, [[1, 0, 0], [0, 0, 1], [0, 0, 0]]).tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (Ball([0.5, 1, 2], 0.25), "ball of radius 0.25 around place, angle, speed = 0.5, 1, 2"),
        (Ball([1], 0.5, names=["speed"]), "ball of radius 0.5 around speed = 1"),
        (
            Box([0, -1], [1, 2.5], names=["speed", "angle"]),
            "speed in [0, 1], angle in [-1, 2.5]",
        ),
        (
            user_program("target", lambda x: ca.fabs(x[0]) < 1, (("x", 3),), INSIDE),
            "a condition of 3 operations",
        ),
    ],
)
def test_descriptions(target, words):
    assert describe_target(target, ROOM) == words


TWO = user_program("target", lambda x: x[0] > 0, (("x", 2),), INSIDE)
REFUSED = [
    (3, "must be a Ball, a Box or a function of the state; got 3"),
    ("home", "must be a Ball, a Box or a function of the state; got 'home'"),
    (TWO, "must be a program of 3 state(s), (x: 3) -> (inside: 1); got (x: 2) -> (inside: 1)"),
    (
        target_program(None, ROOM).__class__("t", (("x", 3),), (("y", 1),), (), (0,)),
        "must be a pro",
    ),
    (Ball([0], 1), "must have 3 dimension(s), or name some of the states place, angle, speed; got"),
    (
        Ball([0, 0], 1, names=["speed", "sped"]),
        "must name states among place, angle, speed; got 'sped'",
    ),
    (
        Ball([0, 0, 0], 1, names=["place", "angle", "sped"]),
        "must name states among place, angle, speed; got",
    ),
    (Box([0], [1], names=["sped"]), "got 'sped'"),
    (Box([0, 0, 0], [1, 1, 1], names=["place", "angle", "x3"]), "got 'x3'"),
    (Box([0, 0], [1, 1]), "must have 3 dimension(s), or name some of the states"),
    (Ball([3, 0, 0], 1.9), "must meet the domain; it lies outside"),
    (Ball([2, 0, 7], 2.2), "must meet the domain; it lies outside"),
    (Ball([7], 1, names=["speed"]), "must meet the domain; it lies outside"),
    (Box([1.1, 0, 0], [2, 1, 1]), "must meet the domain; it lies outside"),
    (Box([-9, 0, 0], [-1.1, 1, 1]), "must meet the domain; it lies outside"),
    (Box([-9], [-5.5], names=["speed"]), "must meet the domain; it lies outside"),
]


@pytest.mark.parametrize(("target", "message"), REFUSED)
def test_refusals(target, message):
    with pytest.raises(ProblemError) as caught:
        check_target(target, ROOM, "goal")
    text = str(caught.value)
    assert text.startswith("`goal` ") and message in text and "\n" not in text


@pytest.mark.parametrize(
    "target",
    [
        None,
        Ball([2, 0, 0], 1),
        Ball([2, 0, 6], 1.5),
        Ball([0, 99, 0], 0.1),
        Box([1, -99, 0], [2, -98, 1]),
        Box([-9, 0, 5], [-1, 1, 9]),
        user_program("target", lambda x: x[0] > 0, (("x", 3),), INSIDE),
    ],
)
def test_what_touches_the_domain_is_taken(target):
    check_target(target, ROOM)


def test_the_target_of_a_problem_is_a_set_or_a_program():
    tank, pendulum = problems.plain("double-tank-a"), problems.plain("cart-pendulum")
    assert transcribe_target(tank) is tank.target
    assert transcribe_target(tank.replace(target=None)) is None
    program = transcribe_target(pendulum)
    states = pendulum.domain.sample(300, 4)
    energy = 2 * states[:, 1] ** 2 + 9.81 * 2 * (np.cos(states[:, 0]) - 1)
    assert np.array_equal(
        inside(program, pendulum.domain, states), np.abs(energy) <= 0.05 * 4 * 9.81
    )
