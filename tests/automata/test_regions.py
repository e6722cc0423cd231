"""Regions: connected partitions as flood fill finds them, and boxes that tile them."""

import numpy as np
import pytest
from scipy import ndimage

from capsyn import problems, synthesize
from capsyn.automata.regions import Partitions, connected_partitions, merged_boxes, regions
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.errors import ProblemError
from capsyn.modelling.grid import Grid
from support.trees import GRIDS, random_tree

NO_PLANES = np.empty((0, 2), dtype=np.int32)


def every_point(counts):
    return np.stack([axis.ravel() for axis in np.indices(counts)], axis=1)


def image_of(cells):
    return cells.labels(every_point(cells.counts)).reshape(cells.counts)


def labelled_by_scipy(image, periodic):
    """Return the components of an image, joined across seams: flood fill, one symbol at a time."""
    numbers = np.zeros(image.shape, dtype=int)
    for label in np.unique(image):
        found, _ = ndimage.label(image == label)
        numbers[image == label] = numbers.max() + found[image == label]
    for axis in np.flatnonzero(periodic):
        ends = [image.take(k, axis).ravel() for k in (0, -1)]
        parts = [numbers.take(k, axis).ravel() for k in (0, -1)]
        for k in np.flatnonzero(ends[0] == ends[1]):
            first, last = parts[0][k], parts[1][k]
            numbers[numbers == last] = first
            for part in parts:
                part[part == last] = first
    return numbers


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("grid", range(len(GRIDS)))
@pytest.mark.parametrize("some_axes", [False, True])
def test_partitions_are_those_of_flood_fill(grid, turning, some_axes):
    cells = random_tree(*GRIDS[grid], seed=grid, some_axes=some_axes)
    periodic = [turning and i % 2 == 0 for i in range(cells.n)]
    found = connected_partitions(cells, periodic)
    image = image_of(cells)
    wanted = labelled_by_scipy(image, periodic).ravel()
    mine = found.of(cells.find(every_point(cells.counts)))
    pairs = np.unique(np.stack([mine, wanted]), axis=1).shape[1]
    assert pairs == len(found) == len(np.unique(wanted))  # a bijection
    assert np.array_equal(found.labels[mine], image.ravel())
    volumes = np.bincount(mine, minlength=len(found)) / image.size
    assert found.shares == pytest.approx(volumes)
    order = list(zip(found.labels, -found.shares))
    assert order == sorted(order)


def test_cells_that_touch_in_a_corner_are_not_connected_and_seams_connect():
    none = [np.empty(0)] * 2
    squares = np.array([-1, -2, -2, -1], np.int32)
    chess = CellTree(Grid((2, 2), (2, 2), 0), squares, *none)
    assert len(connected_partitions(chess)) == 4
    stripes = CellTree(Grid((3, 1), (2, 2), 0), np.array([-1, -2, -1], np.int32), *none)
    assert len(connected_partitions(stripes)) == 3
    turning = connected_partitions(stripes, [True, False])
    assert turning.labels.tolist() == [0, 1]
    assert turning.shares == pytest.approx([2 / 3, 1 / 3])


def covered(lower, upper, labels, counts):
    """Return the image that boxes paint, -1 where none does; they must not overlap."""
    image = np.full(counts, -1)
    for low, high, label in zip(lower, upper, labels):
        part = tuple(map(slice, low, high))
        assert (image[part] == -1).all(), "boxes overlap"
        image[part] = label
    return image


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_boxes_tile_the_regions_exactly(grid, seed):
    cells = random_tree(*GRIDS[grid], leaf_count=2, seed=seed)
    found = regions(cells, connected_partitions(cells))
    lower, upper = (np.concatenate([getattr(r, key) for r in found]) for key in ("lower", "upper"))
    labels = np.repeat([r.label for r in found], [len(r) for r in found])
    assert np.array_equal(covered(lower, upper, labels, cells.counts), image_of(cells))
    assert sum(r.cells for r in found) == cells.leaf_count
    assert sum(r.share for r in found) == pytest.approx(1)
    assert all(len(r) <= r.cells for r in found)


@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_every_box_lies_in_its_connected_partition(grid):
    cells = random_tree(*GRIDS[grid], seed=7)
    partitions = connected_partitions(cells)
    for region in regions(cells, partitions):
        for low, high, part in zip(region.lower, region.upper, region.partitions):
            inside = low + every_point(high - low)
            assert (partitions.of(cells.find(inside)) == part).all()


def test_no_two_boxes_of_a_region_can_be_merged_any_more():
    cells = random_tree((3, 4), (2, 2), 3, leaf_count=2, seed=5)
    for region in regions(cells, connected_partitions(cells)):
        for axis in range(2):
            other = 1 - axis
            ends = {
                (*b, lo)
                for b, lo in zip(
                    zip(region.lower[:, other], region.upper[:, other]), region.lower[:, axis]
                )
            }
            starts = {
                (*b, hi)
                for b, hi in zip(
                    zip(region.lower[:, other], region.upper[:, other]), region.upper[:, axis]
                )
            }
            assert not ends & starts


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_a_box_in_pieces_is_put_together_whatever_the_pieces(n):
    counts = (6,) * n
    lower = every_point(counts)
    labels = (lower[:, 0] >= 2).astype(int)
    low, high, label = merged_boxes(lower, lower + 1, labels, counts)
    assert label.tolist() == [0, 1]
    assert low.tolist() == [[0] * n, [2] + [0] * (n - 1)]
    assert high.tolist() == [[2] + [6] * (n - 1), [6] * n]


def test_merging_does_not_depend_on_the_order_of_the_boxes():
    boxes = random_tree((3, 4), (2, 2), 3, seed=1).boxes()
    counts = (24, 32)
    wanted = merged_boxes(boxes.lower, boxes.upper, boxes.labels, counts)
    mixed = np.random.default_rng(0).permutation(len(boxes))
    again = merged_boxes(boxes.lower[mixed], boxes.upper[mixed], boxes.labels[mixed], counts)
    assert all(np.array_equal(a, b) for a, b in zip(wanted, again))


def test_wide_lattices_need_more_than_one_sort_key():
    n, wide = 4, 2**30
    lower = np.zeros((4, n), dtype=np.int64)
    lower[:, 3] = np.arange(4) * 2**28
    upper = np.full((4, n), wide)
    upper[:, 3] = lower[:, 3] + 2**28
    low, high, _ = merged_boxes(lower, upper, np.zeros(4, dtype=int), (wide,) * n)
    assert low.tolist() == [[0] * n] and high.tolist() == [[wide] * n]


def test_trees_of_splits_have_the_same_regions():
    # x1 < 2: label 1; else x2 < 3: label 0, else label 1
    tree = SplitTree(
        (4, 5),
        np.array([0, LEAF, 1, LEAF, LEAF], np.int32),
        np.array([2, 1, 3, 0, 1], np.int32),
        np.array([2, 1, 4, 3, 4], np.int32),
        NO_PLANES,
    )
    found = connected_partitions(tree)
    assert found.labels.tolist() == [0, 1]
    assert found.shares == pytest.approx([0.3, 0.7])
    one, two = regions(tree, found)
    assert (one.lower.tolist(), one.upper.tolist()) == ([[2, 0]], [[4, 3]])
    assert (len(two), two.cells) == (2, 2)
    oblique = SplitTree(
        (4, 4),
        np.array([2, LEAF, LEAF], np.int32),
        np.array([3, 0, 1], np.int32),
        np.array([2, 1, 2], np.int32),
        np.array([[1, 1]], np.int32),
    )
    with pytest.raises(ProblemError, match="oblique"):
        connected_partitions(oblique)


def test_the_two_tanks_in_case_b_are_four_boxes():
    policy = synthesize(problems.plain("double-tank-b"))
    found = regions(policy.cells, connected_partitions(policy.cells))
    assert [len(r) for r in found] == [1, 1, 1, 1]
    for region in found:
        lower, upper = region.bounds(policy.domain, policy.cells.counts)
        inside = np.vstack([lower, np.nextafter(upper, -np.inf)])
        assert (policy(inside) == region.label).all()
        assert policy(upper)[0] != region.label or (upper[0] == policy.domain.upper).any()
    assert sum(r.share for r in found) == pytest.approx(1)


def test_partitions_say_how_many_they_are():
    found = connected_partitions(random_tree((3,), (2,), 0))
    assert isinstance(found, Partitions) and len(found) == len(found.shares)
