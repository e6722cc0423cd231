"""Models whose gradients are infinite at single points, or whose states run out of their range."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import capsyn
from capsyn.cells.masks import masks_of_members
from capsyn.controllers.ssac import policy_controller
from capsyn.controllers.unsolved.inside import FARTHEST, InsideAnswers
from capsyn.errors import SynthesisError
from capsyn.improvement.refits import plan_like, remade
from capsyn.modelling.domain import Box
from capsyn.verification.switching_curve import repriced

ROOTS = {
    "plain": ca.sqrt,
    "guarded": lambda a: ca.sqrt(ca.fmax(a, 0)),
    "odd": lambda a: ca.sign(a) * ca.sqrt(ca.fabs(a)),
}


def problem(dynamics, domain: Box, **changes) -> capsyn.Problem:
    wanted = {
        "name": "case",
        "dynamics": dynamics,
        "domain": domain,
        "alphabet": [0, 1],
        "default": 0.6,
        "horizon": 1.0,
        "running_cost": lambda x: (x[0] - 1) ** 2,
        "settings": capsyn.SsacSettings(rule="steepest", steps=16),
        "partitions": 8,
        "max_level": 1,
        "outside": "nearest",
    }
    return capsyn.Problem(**wanted | changes)


def tank(root=ca.sqrt, **changes) -> capsyn.Problem:
    box = Box([0], [2], names=["level"])
    return problem(lambda x, u: [0.8 * u[0] - 0.5 * root(x[0])], box, **changes)


@pytest.mark.parametrize("root", ROOTS)
def test_a_tank_is_labelled_down_to_empty(root):
    policy = capsyn.synthesize(tank(ROOTS[root]))
    statistics = policy.statistics
    assert statistics["not_finite_points"] == 0
    assert statistics["limit_points"] == 1 and statistics["limit_example"] == [0.0]
    levels = np.array([[0.0], [0.01], [0.9], [1.1], [2.0]])
    assert policy(levels).tolist() == [1, 1, 1, 0, 0]


@pytest.mark.parametrize("root", ROOTS)
def test_no_loop_of_two_tanks_is_lost(root):
    flow = ROOTS[root]
    tanks = problem(
        lambda x, u: [u[0] - flow(x[0]), flow(x[0]) - flow(x[1])],
        Box([0, 0], [4, 4]),
        alphabet=[0, 2],
        default=1.0,
        running_cost=lambda x: (x[1] - 1) ** 2,
    )
    policy = capsyn.synthesize(tanks)
    statistics = policy.statistics
    assert statistics["not_finite_points"] == 0
    edges = 2 * 16 + 1  # test points with an empty tank, were all of them solved
    assert 0 < statistics["limit_points"] <= edges
    starts = np.array([[0, 0], [0, 4], [4, 0], [1e-12, 3], [3, 1e-300], [0.3, 0.2]])
    for backend in ("numpy", "c"):
        loop = capsyn.simulate(policy, starts, duration=2.0, rate=10, substeps=4, backend=backend)
        assert (loop.ended == "time").all() and np.isfinite(loop.states).all()
    shut = capsyn.simulate(
        lambda t, x: np.zeros((len(x), 1)), starts, duration=5.0, rate=10, substeps=4, model=tanks
    )
    assert np.isfinite(shut.states).all() and np.abs(shut.states[:4, -1]).max() < 0.3


def test_norms_asin_and_powers_are_solved_as_limits_and_higher_powers_as_they_are():
    line, plane = Box([0], [1]), Box([-1, -1], [1, 1])
    for case, limits in [
        (problem(lambda x, u: [x[1], u[0]], plane, running_cost=ca.norm_2), 1),
        (problem(lambda x, u: [u[0] - ca.asin(x[0])], Box([-1], [1])), 2),
        (problem(lambda x, u: [u[0] - x[0] ** 0.3], line), 1),
        (problem(lambda x, u: [u[0] - x[0] ** 1.5], line), None),
        (problem(lambda x, u: [u[0] - x[0]], line, running_cost=lambda x: ca.sqrt(x[0])), 1),
    ]:
        statistics = capsyn.synthesize(case).statistics
        assert statistics["not_finite_points"] == 0
        assert statistics.get("limit_points") == limits


def test_limits_are_those_of_all_ways_to_solve(tmp_path):
    wall = problem(
        lambda x, u: [x[1], u[0] - ca.sign(x[0]) * ca.sqrt(ca.fabs(x[0]))],
        Box([-1, -1], [1, 1]),
        alphabet=[-1, 1],
        default=0.0,
    )
    whole = capsyn.synthesize(wall)
    assert whole.statistics["limit_points"] > 1
    states = wall.domain.sample(500, 0)
    for way in (
        {"backend": "numpy", "threads": 1},
        {"checkpoint": tmp_path / "kept"},
        {"checkpoint": tmp_path / "kept"},
    ):
        again = capsyn.synthesize(wall, **way)
        assert again.statistics["limit_points"] == whole.statistics["limit_points"]
        assert (again(states) == whole(states)).all()
    for other in ({"leaves": "affine"}, {"switching": capsyn.Switching(0.01)}):
        assert capsyn.synthesize(wall, **other).statistics["not_finite_points"] == 0


@pytest.mark.parametrize("case, told", {
    "log": (
        problem(lambda x, u: [u[0] + ca.log(x[0])], Box([0], [2], names=["level"])),
        r"dynamics\[0\] is not finite: log of `level`, at level = 0$",
    ),
    "quotient": (
        problem(lambda x, u: [u[0] + 1 / x[0]], Box([-1], [1], names=["gap"])),
        r"dynamics\[0\] is not finite: a quotient by `gap`, at gap = 0$",
    ),
    "a root of less than 0": (
        problem(lambda x, u: [x[1], u[0] - ca.sqrt(x[0] - x[1])], Box([-1, -1], [2, 2])),
        r"dynamics\[1\] is not finite: sqrt of an expression of `x1` and `x2` that is -",
    ),
    "a cost": (
        problem(lambda x, u: [u[0]], Box([-1], [1]), running_cost=lambda x: ca.acos(2 * x[0])),
        r"running_cost is not finite: acos of an expression of `x1` that is -2, at x1 = -1$",
    ),
    "an end": (
        tank(terminal_cost=lambda x: ca.log(x[0] - 5)),
        r"terminal_cost is not finite: log of .*, 1 after the start of the prediction$",
    ),
    "an escape": (
        problem(lambda x, u: [x[0] ** 3 + u[0]], Box([-20], [20]), horizon=10.0),
        "the prediction grows without bound, .* after its start: take more `steps`",
    ),
}.values(), ids=lambda value: "" if isinstance(value, str) else value.name)  # fmt: skip
def test_what_is_not_finite_is_named(case, told):
    with pytest.raises(SynthesisError, match=told) as error:
        capsyn.synthesize(case)
    assert "\n" not in str(error.value)


def test_a_gradient_that_stays_infinite_is_named():
    edge = problem(  # a square root of 0 along the whole of x1 = x2 >= 0.5, and its inside
        lambda x, u: [u[0], ca.sqrt(ca.fmax(x[0] - 0.5, 0) * 0)], Box([0, 0], [1, 1])
    )
    assert capsyn.synthesize(edge).statistics["not_finite_points"] == 0  # folded: 0 is 0
    flat = problem(lambda x, u: [u[0] - ca.sqrt(ca.floor(x[0]) * x[0])], Box([0], [0.9]))
    with pytest.raises(SynthesisError, match=r"the gradient of dynamics\[0\] is not finite: sqrt"):
        capsyn.synthesize(flat)


def test_points_are_asked_again_inside_only_where_the_model_is_defined():
    asked = []

    def label(states):
        asked.append(states.copy())
        members = np.zeros((len(states), 3), dtype=bool)
        members[:, 0] = ~np.isin(states[:, 0], [0.0, 1.0])
        return masks_of_members(members)

    answers = InsideAnswers(label, lambda states: states[:, 1] > 0, Box([0, 0], [1, 2]), [10, 10])
    sets = answers(np.array([[0, 0], [0, 1], [0.5, 0], [1, 2]], dtype=float))
    assert sets[:, 0].tolist() == [0, 1, 1, 1]
    assert len(asked) == 2 and np.allclose(
        asked[1], [[FARTHEST / 10, 1 + 1 / 40], [1 - FARTHEST / 10, 2 - 1 / 40]]
    )
    assert answers.statistics() == {"limit_points": 2, "limit_example": [0.0, 1.0]}


def test_a_loop_of_another_model_keeps_to_its_range():
    policy = capsyn.synthesize(tank())
    leaky = capsyn.simulate(
        policy, [0.2], duration=2.0, rate=20, model=lambda x, u: [-0.5 * ca.sqrt(x[0])]
    )
    assert np.isfinite(leaky.states).all() and abs(leaky.states[-1, 0]) < 0.01


def test_policies_that_are_made_again_are_solved_inside_too():
    policy = capsyn.synthesize(tank())
    again = repriced(policy, policy_controller(policy), capsyn.Switching(price=0.01))
    tail = remade(
        policy,
        plan_like(policy, policy.cells, None, None, 4),
        policy.model.terminal_cost,
        0.5,
        "auto",
        1,
    )
    for made in (again, tail):
        assert made.statistics["limit_points"] == 1
        assert made.statistics["not_finite_points"] == 0
