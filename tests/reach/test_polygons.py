"""Polygons of pieces beside exact ones: cuts, hulls and fewer vertices lose nothing but slack."""

import numpy as np
import pytest

from support.proofs.attack import asked_of
from support.proofs.pieces import SLACK, Pieces, beyond, exact, exact_cut, exact_hull, turn
from support.proofs.random_loops import KINDS, random_case

FLAT = next(kind for kind in KINDS if kind[0] == "linear")
SPACE = next(kind for kind in KINDS if kind[0] == "space")


def pieces_of(kind, seed=0):
    return Pieces.build(asked_of(random_case(np.random.default_rng(seed), kind)).loop)


@pytest.fixture(scope="module")
def flat():
    return pieces_of(FLAT)


@pytest.fixture(scope="module")
def boxes():
    return pieces_of(SPACE)


def polygon(rng, most=12):
    """Return the vertices (K, 2) of a random convex polygon: many thin, small or far away."""
    count = int(rng.integers(3, most + 1))
    angles = np.sort(rng.uniform(0, 2 * np.pi, count))
    round_ = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    thin = np.diag([1.0, 10.0 ** rng.uniform(-9, 0)])
    turn = rng.uniform(0, np.pi)
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    size, place = 10.0 ** rng.uniform(-6, 2), rng.normal(size=2) * 10.0 ** rng.uniform(-3, 3)
    hull = exact_hull(exact(round_ @ thin @ turned.T * size + place))
    return np.array([[float(x), float(y)] for x, y in hull])


def largest(*shapes):
    return max(float(np.abs(shape).max()) for shape in shapes)


def test_cuts_keep_what_is_on_their_side(flat):
    rng = np.random.default_rng(1)
    kept = 0
    for case in range(400):
        shape = polygon(rng)
        if case % 2:  # nearly along an edge
            k = int(rng.integers(len(shape)))
            edge = shape[(k + 1) % len(shape)] - shape[k]
            a = np.array([edge[1], -edge[0]]) * (1 + 1e-12 * rng.normal(size=2))
            limit = float(a @ shape[k])
        else:
            a = rng.normal(size=2)
            limit = float(rng.choice(shape @ a) if case % 4 else np.mean(shape @ a))
        size = float(np.abs(a) @ np.abs(shape).max(axis=0)) + abs(limit)
        wanted = exact_cut(exact(shape), a, limit)
        found = flat.cut(shape, a, limit + 4 * SLACK * size)
        if not wanted:
            continue
        hull = exact_hull(exact(found))
        assert max(beyond(point, hull) for point in wanted) <= SLACK * largest(shape)
        kept += 1
    assert kept > 200


def test_cuts_of_polygons_lose_the_rest(flat):
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    half = flat.cut(square, [1.0, 1.0], 1.0)
    assert sorted(set(map(tuple, half))) == [(0, 0), (0, 1), (1, 0)]
    assert flat.cut(square, [1.0, 0.0], -0.5) is None


def test_hulls_hold_both(flat):
    rng = np.random.default_rng(2)
    for case in range(400):
        one = polygon(rng)
        two = one * rng.uniform(0.5, 1.5) + rng.normal(size=2) if case % 2 else polygon(rng)
        found = flat.hull(one, two)
        assert len(found) <= 12
        hull = exact_hull(exact(found))
        most = SLACK * largest(one, two)
        assert max(beyond(point, hull) for point in exact(one) + exact(two)) <= most


def test_hulls_of_few_vertices_are_exact(flat):
    one = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    found = flat.hull(one, one + [2.0, 0.0])
    assert sorted(set(map(tuple, found))) == [(0, 0), (0, 1), (2, 1), (3, 0)]


def test_fewer_vertices_add_little(flat):
    """A circle of 24 vertices becomes one of 12 around it, its area at most a twentieth larger."""
    angles = 2 * np.pi * np.arange(24) / 24
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    found = flat.hull(circle[::2], circle[1::2])
    hull = exact_hull(exact(found))
    assert len(found) == 12
    assert max(beyond(point, hull) for point in exact(circle)) <= SLACK
    area = 0.5 * sum(turn((0, 0), a, b) for a, b in zip(hull, hull[1:] + hull[:1]))
    assert area <= 1.05 * 12 * np.sin(2 * np.pi / 24)


def test_cuts_of_boxes_hold_their_side(boxes):
    rng = np.random.default_rng(3)
    tighter = 0
    for _ in range(300):
        lower = rng.normal(size=3)
        shape = np.stack([lower, lower + 10.0 ** rng.uniform(-4, 1, 3)])
        a = rng.normal(size=3) * (rng.random(3) < 0.7)
        points = shape[0] + (shape[1] - shape[0]) * rng.choice([0, 1, 0.3, 0.7], (200, 3))
        limit = float(np.quantile(points @ a, rng.random()))
        inside = points[points @ a <= limit]
        found = boxes.cut(shape, a, limit + 1e-12)
        assert (inside >= found[0]).all() and (inside <= found[1]).all()
        assert (found[0] >= shape[0]).all() and (found[1] <= shape[1]).all()
        tighter += bool((found != shape).any())
    assert tighter > 50
    assert boxes.cut(np.array([[0.0, 0, 0], [1, 1, 1]]), [1.0, 1, 1], -0.1) is None
