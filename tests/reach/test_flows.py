"""Flows of pieces beside exact ones: all states of a piece are in what it becomes, and not far."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from support.proofs.attack import asked_of
from support.proofs.pieces import SLACK, Pieces, beyond, exact, exact_hull
from support.proofs.random_loops import FAMILIES, KINDS, random_case

STEPS = 60


def kind_of(name):
    return next(kind for kind in KINDS if kind[0] == name)


def build(name):
    return Pieces.build(asked_of(random_case(np.random.default_rng(0), kind_of(name))).loop)


def points_of(shape, error, rng, n):
    """Return states (B, n) of a piece: corners moved by the error, and some inside."""
    if n == 2:
        mixes = rng.dirichlet(np.ones(len(shape)), 20)
        points = np.concatenate([shape, mixes @ shape])
    else:
        points = shape[0] + (shape[1] - shape[0]) * rng.choice([0.0, 1.0, 0.4], (30, n))
    return points + error * rng.choice([-1.0, 0.0, 1.0], points.shape)


def hold(points, shape, error):
    """Return by how much the farthest point is out of a shape that is widened by an error."""
    if shape.shape[1] != 2:
        return max((shape[0] - error - points).max(), (points - shape[1] - error).max())
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * error
    hull = exact_hull(exact((shape[:, None] + corners).reshape(-1, 2)))
    return max(beyond(point, hull) for point in exact(points))


def solution(family, x, u, p, time):
    """Return states (STEPS + 1, n) on the way, by an integrator of high order."""

    def rates(_, y):
        return family(y[:, None], u[:, None], p[:, None])[:, 0]

    ticks = np.linspace(0, time, STEPS + 1)
    found = solve_ivp(rates, (0, time), x, "DOP853", ticks, rtol=1e-13, atol=1e-13)
    return found.y.T


def random_piece(rng, n):
    middle, half = rng.uniform(-0.7, 0.7, n), 10.0 ** rng.uniform(-3, -1, n)
    if n == 2:
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
        slant = np.array([[1.0, rng.uniform(-1, 1)], [0.0, 1.0]])
        shape = middle + corners @ slant.T
    else:
        shape = np.stack([middle - half, middle + half])
    return shape, np.abs(rng.normal(size=n)) * 1e-4


def test_flows_of_linear_plants_are_exact():
    """Beside the matrix exponential, in exact polygons: nothing is lost, and nothing is added."""
    pieces, rng = build("linear"), np.random.default_rng(4)
    for _ in range(60):
        p = rng.uniform(-1, 1, 4) * [1, 3, 3, 1]
        u, time = rng.uniform(-1, 1, 2), 10.0 ** rng.uniform(-4, -1.3)
        shape, error = random_piece(rng, 2)
        known, after, wider, tube = pieces.flow(u, time, shape, error, np.stack([p, p]))
        assert known
        augmented = np.zeros((3, 3))
        augmented[:2] = [[p[0], p[1], u[0]], [p[2], p[3], u[1]]]
        flow = expm(augmented * time)
        points = points_of(shape, error, rng, 2)
        assert hold(points @ flow[:2, :2].T + flow[:2, 2], after, wider) <= 1e-14
        exactly = shape @ flow[:2, :2].T + flow[:2, 2]
        assert np.abs(after - exactly).max() <= 1e-13
        assert (wider <= np.abs(flow[:2, :2]) @ error + 1e-10).all()
        assert (points >= tube[0] - SLACK).all() and (points <= tube[1] + SLACK).all()


@pytest.mark.parametrize("name", ["plane", "roots", "space", "steps"])
def test_flows_hold_solutions(name):
    """All on the way are in the tube, what is at the end in the piece, at ends of parameters."""
    family, pieces, rng = FAMILIES[name], build(name), np.random.default_rng(5)
    n, known = pieces.loop.space.n, 0
    for _ in range(25):
        ends = np.sort(rng.uniform(-0.5, 0.5, (2, len(family.spans))) * family.spans, axis=0)
        u, time = rng.uniform(-1, 1, family.m), 10.0 ** rng.uniform(-3, -0.7)
        shape, error = random_piece(rng, n)
        if family.jumps:  # the ways of solutions beside jumps are followed by small steps
            shape, error = shape[:1] + [[0, 0], [1e-3, 0], [0, 1e-3]], error * 0
        found, after, wider, tube = pieces.flow(u, time, shape, error, ends)
        if not found:
            continue
        known += 1
        for x in points_of(shape, error, rng, n)[::4]:
            p = ends[rng.integers(0, 2, len(family.spans)), np.arange(len(family.spans))]
            if family.jumps:
                way = small_steps(family, x, u, p, time)
                off = 4 * time / 1000
            else:
                way, off = solution(family, x, u, p, time), 1e-11
            assert (way >= tube[0] - off).all() and (way <= tube[1] + off).all()
            assert hold(way[-1:], after, wider) <= off
    assert known >= 20


def small_steps(family, x, u, p, time):
    """Return states (1001, n) of Euler's method, near to some solution where rates jump."""
    states = [x]
    for _ in range(1000):
        y = states[-1]
        states.append(y + time / 1000 * family(y[:, None], u[:, None], p[:, None])[:, 0])
    return np.array(states)


def test_told_inputs_stay():
    pieces = build("told")
    lower, upper = [0.1, 0.2, 0.3], [0.2, 0.3, 0.4]
    shape = np.array([lower, upper])
    known, after, error, _ = pieces.flow([0.5], 0.1, shape, np.zeros(3), np.zeros((2, 2)))
    assert known and (error >= 0).all()
    assert after[0, 2] - error[2] == pytest.approx(0.3, abs=1e-12)
    assert after[1, 2] + error[2] == pytest.approx(0.4, abs=1e-12)
