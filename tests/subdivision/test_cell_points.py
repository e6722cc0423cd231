"""Test points of a cell: their text, and their places."""

import itertools

import numpy as np
import pytest

from capsyn.errors import ProblemError
from capsyn.subdivision.cell_points import CellPoints

CHOICES = [
    CellPoints(center, edges, random)
    for center, edges, random in itertools.product((False, True), (False, True), (0, 1, 12))
]


@pytest.mark.parametrize("points", CHOICES, ids=str)
def test_text_and_parse_are_inverse(points):
    assert CellPoints.parse(str(points)) == points


def test_parse_takes_any_order_and_spaces():
    assert CellPoints.parse(" random:3 +center+ vertices") == CellPoints(True, False, 3)
    assert CellPoints.parse("vertices") == CellPoints(False, False, 0)
    assert str(CellPoints()) == "vertices+center"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "center",
        "center+random:2",
        "vertices+middle",
        "vertices+center+center",
        "vertices++center",
        "vertices,center",
        "Vertices",
        "vertices:2",
        "vertices+center:1",
        "vertices+random",
        "vertices+random:",
        "vertices+random:0",
        "vertices+random:-1",
        "vertices+random:+1",
        "vertices+random:1.5",
        "vertices+random: 2",
        "vertices+random:²",
        "vertices+random:1+random:2",
        "vertices+center:\n2",
        None,
        3,
        ["vertices"],
    ],
)
def test_bad_text_is_one_line_that_names_the_argument(text):
    with pytest.raises(ProblemError, match="^`test_points` ") as caught:
        CellPoints.parse(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("points", CHOICES, ids=str)
def test_offsets_are_vertices_center_and_edge_midpoints(points, n):
    offsets = points.offsets(n)
    assert len(np.unique(offsets, axis=0)) == len(offsets)
    assert offsets.min() == 0 and offsets.max() == 2
    halves = (offsets == 1).sum(axis=1)
    edges = n * 2 ** (n - 1)
    expected = {0: 2**n}
    if points.edge_midpoints:
        expected[1] = edges
    if points.center:
        expected[n] = 1  # for n = 1 this is the midpoint of the one edge
    assert dict(zip(*np.unique(halves, return_counts=True))) == expected
    interior = points.center + edges * points.edge_midpoints + points.random
    assert points.interior(n) == interior
    assert interior >= len(offsets) - 2**n + points.random


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_faces_may_take_the_place_of_vertices(n):
    points = CellPoints.parse("center + faces + random:4")
    assert str(points) == "center+faces+random:4" and CellPoints.parse(str(points)) == points
    offsets = points.offsets(n)
    assert len(offsets) == 2 * n + 1 == len(np.unique(offsets, axis=0))
    assert ((offsets - 1) ** 2).sum(axis=1).tolist() == [0] + [1] * (2 * n)
    assert points.interior(n) == 2 * n + 5
    split = (2,) * n
    assert points.in_block(split) == 5 * 2**n + n * 3 * 2 ** (n - 1)
    both = CellPoints.parse("vertices+faces")
    assert len(both.offsets(n)) == (2 if n == 1 else 2**n + 2 * n)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_full_choice_has_as_many_points_as_the_formula_says(n):
    assert len(CellPoints(True, True).offsets(n)) == 2**n + 1 + n * 2 ** (n - 1)
