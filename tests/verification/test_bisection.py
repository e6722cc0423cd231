"""Bisection: parts make up their cells, and signs are known where they can be."""

import numpy as np
import pytest

from capsyn.verification.bisection import Boxes, bisect

LOWER = np.array([[-1.0, 0.0, 1.0], [-1.0, -1.0, -1.0]])
UPPER = np.array([[0.0, 1.0, 2.0], [1.0, 1.0, 1.0]])
SHARES = np.array([0.5, 0.25, 0.25])


def plane(lower, upper, cells):
    """Bound ``x - 0.3``, which the second axis has no part in."""
    return lower[0] - 0.3, upper[0] - 0.3


def circle(lower, upper, cells):
    """Bound ``x^2 + y^2 - 0.5``."""
    size = np.maximum(np.abs(lower), np.abs(upper))
    least = np.where(lower * upper <= 0, 0.0, np.minimum(np.abs(lower), np.abs(upper)))
    return (least**2).sum(axis=0) - 0.5, (size**2).sum(axis=0) - 0.5


def volumes(boxes):
    return (boxes.upper - boxes.lower).prod(axis=0)


@pytest.mark.parametrize("bounds", [plane, circle])
@pytest.mark.parametrize("depth", [0, 1, 7])
def test_parts_tile_their_cells(bounds, depth):
    boxes = bisect(bounds, LOWER, UPPER, SHARES, depth, 10_000)
    for k in range(3):
        part = boxes.take(boxes.cells == k)
        assert (part.lower >= LOWER[:, [k]]).all() and (part.upper <= UPPER[:, [k]]).all()
        assert part.shares.sum() == SHARES[k]
        np.testing.assert_array_equal(part.shares / SHARES[k], volumes(part) / 2)
        points = np.random.default_rng(k).uniform(LOWER[:, k], UPPER[:, k], (200, 2)).T[..., None]
        inside = (part.lower[:, None] <= points) & (points <= part.upper[:, None])
        assert (inside.all(axis=0).sum(axis=1) == 1).all()
    low, high = bounds(boxes.lower, boxes.upper, boxes.cells)
    np.testing.assert_array_equal([low, high], [boxes.low, boxes.high])
    assert len(boxes.cells) == 3 if depth == 0 else len(boxes.cells) > 3
    settled = boxes.proved | boxes.violated
    np.testing.assert_array_equal(boxes.undecided, ~settled)


def test_only_the_axis_that_helps_is_cut():
    boxes = bisect(plane, LOWER, UPPER, SHARES, 10, 10_000)
    assert (boxes.lower[1] == -1).all() and (boxes.upper[1] == 1).all()
    assert boxes.undecided.sum() == 1 and len(boxes.cells) == 3 + 10
    assert boxes.shares[boxes.undecided].sum() == 0.25 / 2**10

    def plane_of_the_second(lower, upper, cells):
        return plane(lower[::-1], upper[::-1], cells)

    swapped = bisect(plane_of_the_second, LOWER[::-1], UPPER[::-1], SHARES, 10, 99)
    np.testing.assert_array_equal(swapped.lower[::-1], boxes.lower)


def test_depth_makes_shares_better():
    left = [bisect(circle, LOWER, UPPER, SHARES, d, 10**6).undecided.sum() for d in (0, 1)]
    shares = [
        boxes.shares[boxes.undecided].sum()
        for boxes in (bisect(circle, LOWER, UPPER, SHARES, d, 10**6) for d in range(0, 13, 3))
    ]
    assert left[0] == 2 and (np.diff(shares) < 0).all() and shares[-1] < 0.03


def test_proved_parts_are_cut_until_they_are_negative():
    # -x^2 on [0, 1] is nowhere positive, and negative in ever larger parts
    def parabola(lower, upper, cells):
        return -(upper[0] ** 2), -(lower[0] ** 2)

    boxes = bisect(parabola, np.array([[0.0]]), np.array([[1.0]]), np.ones(1), 8, 100)
    assert boxes.proved.all() and not boxes.undecided.any()
    assert boxes.shares[boxes.negative].sum() == 1 - 2.0**-8

    def zero(lower, upper, cells):
        return 0 * lower[0], 0 * upper[0]

    assert len(bisect(zero, LOWER, UPPER, SHARES, 8, 100).cells) == 3


def test_max_boxes_bounds_a_round_and_the_undecided_go_first():
    rounds = []

    def counted(lower, upper, cells):
        rounds.append(len(cells))
        low, high = circle(lower, upper, cells)
        loose = lower[0] >= 1  # proved there, though not as negative
        return np.where(loose, -1.0, low), np.where(loose, 0.0, high)

    boxes = bisect(counted, LOWER, UPPER, SHARES, 12, 16)
    assert max(rounds[1:]) == 16
    assert np.isclose(boxes.shares.sum(), 1) and volumes(boxes).sum() == 6
    few = bisect(counted, LOWER, UPPER, SHARES, 3, 4)
    assert (few.cells == 2).sum() == 1, "no turn for what is proved"


def test_large_boxes_go_before_small_ones():
    def unknown(lower, upper, cells):
        return np.full(len(cells), -1.0), np.full(len(cells), 1.0)

    boxes = bisect(unknown, LOWER, UPPER, np.array([0.2, 0.5, 0.3]), 1, 4)
    np.testing.assert_array_equal(np.bincount(boxes.cells), [1, 2, 2])


def test_undefined_parts_are_undecided_and_cut_last():
    def root(lower, upper, cells):
        with np.errstate(invalid="ignore"):
            undefined = np.isnan(np.sqrt(lower[0]))
        return np.where(undefined, np.nan, -1.0), np.where(undefined, np.nan, -1.0)

    boxes = bisect(root, np.array([[-1.0], [0.0]]), np.array([[1.0], [1.0]]), np.ones(1), 4, 100)
    assert boxes.shares[boxes.proved].sum() == 0.5
    assert boxes.shares[boxes.undecided].sum() == 0.5
    assert (boxes.lower[1][boxes.proved] == 0).all()


def test_boxes_of_a_few_numbers_are_not_cut():
    low = np.array([[1.0], [0.0]])
    high = np.array([[np.nextafter(1.0, 2.0)], [1.0]])
    seen = bisect(lambda a, b, k: (-b[0], a[0]), low, high, np.ones(1), 60, 10**3)
    assert (seen.lower[0] == 1.0).all() and (seen.upper[0] == high[0]).all()
    np.testing.assert_array_equal(volumes(seen) / volumes(seen).sum(), seen.shares)
    point = bisect(lambda a, b, k: (-b[0], a[0]), low, low, np.ones(1), 9, 99)
    assert len(point.cells) == 1


def test_joined_is_the_opposite_of_take():
    boxes = bisect(circle, LOWER, UPPER, SHARES, 3, 100)
    first = np.arange(len(boxes.cells)) < 4
    again = Boxes.joined([boxes.take(first), boxes.take(~first)])
    np.testing.assert_array_equal(again.lower, boxes.lower)
    np.testing.assert_array_equal(again.high, boxes.high)
