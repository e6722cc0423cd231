"""Faces of neighbouring cells, against all pairs of neighbouring finest cells."""

import itertools
from collections import Counter

import numpy as np
import pytest

from capsyn.cells.faces import shared_faces
from capsyn.errors import ProblemError
from support.split_trees import all_points, random_split_tree
from support.trees import GRIDS, random_tree

GRIDS_HERE = [
    *GRIDS[1:7],
    ((1, 1), (2, 2), 3),
    ((1, 2), (3, 3), 2),
    ((2, 2, 1), (2, 2, 2), 2),
    ((1, 1, 2), (3, 3, 3), 1),
    ((1, 1, 1, 2), (2, 2, 2, 2), 1),
]


def everything(below, above):
    return np.ones(len(below), dtype=bool)


def neighbours(cells, periodic, keep):
    """Return (axis, *lower corner, below, above) of all faces of finest cells between cells."""
    found = Counter()
    points = all_points(cells.counts)
    here = cells.find(points)
    for axis, count in enumerate(cells.counts):
        beyond = points.copy()
        beyond[:, axis] += 1
        there = beyond[:, axis] < count
        if periodic is not None and periodic[axis]:
            there[:] = True
        beyond[:, axis] %= count
        other = cells.find(beyond)
        for i in np.flatnonzero(there & (other != here)):
            if keep(here[i : i + 1], other[i : i + 1])[0]:
                found[(axis, *beyond[i].tolist(), int(here[i]), int(other[i]))] += 1
    return found


def units(faces):
    """Return the same of faces, cut into those of finest cells."""
    found = Counter()
    for axis, low, high, below, above in zip(
        faces.axis, faces.lower, faces.upper, faces.below, faces.above
    ):
        assert low[axis] == high[axis] and (np.delete(high - low, axis) > 0).all()
        ranges = [range(a, b) for a, b in zip(low, high)]
        ranges[axis] = range(low[axis], low[axis] + 1)
        for place in itertools.product(*ranges):
            found[(int(axis), *map(int, place), int(below), int(above))] += 1
    return found


def check(cells, periodic):
    def unlike(below, above):
        return cells.labels_at(below) != cells.labels_at(above)

    for keep in (everything, unlike):
        faces = shared_faces(cells, keep, periodic)
        wanted = neighbours(cells, periodic, keep)
        assert units(faces) == wanted
        assert len(faces) == len(faces.lower) <= sum(wanted.values())
    return wanted


def turning(n, case):
    return [None, [False] * n, [True] * n, [i % 2 == 0 for i in range(n)]][case]


@pytest.mark.parametrize("grid", GRIDS_HERE)
@pytest.mark.parametrize("case", range(4))
@pytest.mark.parametrize("some_axes", [False, True])
def test_faces_of_cells_are_those_of_neighbouring_finest_cells(grid, case, some_axes):
    cells = random_tree(*grid, seed=case, some_axes=some_axes)
    check(cells, turning(cells.n, case))


@pytest.mark.parametrize("counts", [(1,), (2,), (9,), (5, 7), (1, 6), (2, 2), (4, 3, 5), (2,) * 4])
@pytest.mark.parametrize("case", range(4))
@pytest.mark.parametrize("seed", range(2))
def test_faces_of_trees_are_those_of_neighbouring_finest_cells(counts, case, seed):
    cells = random_split_tree(counts, seed=seed)
    check(cells, turning(len(counts), case))


def test_a_seam_is_at_0_and_lies_between_the_last_cell_and_the_first():
    cells = random_tree((4,), (2,), 0, seed=0)
    faces = shared_faces(cells, everything, [True])
    told = sorted(zip(faces.lower[:, 0].tolist(), faces.below.tolist(), faces.above.tolist()))
    assert told == [(0, 3, 0), (1, 0, 1), (2, 1, 2), (3, 2, 3)]
    assert sorted(shared_faces(cells, everything).lower[:, 0].tolist()) == [1, 2, 3]


def test_one_cell_has_no_faces_even_where_it_meets_itself():
    cells = random_tree((1, 1), (2, 2), 0)
    assert len(shared_faces(cells, everything, [True, True])) == 0


def test_equal_faces_are_as_large_as_the_smaller_cell():
    cells = random_tree((3, 3), (2, 2), 2, split=0, seed=1)
    faces = shared_faces(cells, everything)
    assert len(faces) == 12 and ((faces.upper - faces.lower).max(axis=1) == 4).all()


def test_oblique_trees_have_no_faces():
    with pytest.raises(ProblemError, match="^a tree with oblique splits has no boxes"):
        shared_faces(random_split_tree((5, 7), planes=1), everything)
