"""Leaves that stand for rows, the symbol that follows each symbol in force, by brute force."""

import itertools

import numpy as np
import pytest

from capsyn.cells.masks import members, preferred, singles
from capsyn.cells.row_table import RowTable
from capsyn.modelling.grid import Grid
from capsyn.subdivision.cell_blocks import SubdivisionTask
from capsyn.subdivision.constant import ConstantSubdivision
from capsyn.subdivision.lattice_points import LatticePoints
from capsyn.subdivision.limits import Limits
from capsyn.subdivision.plan import SubdivisionPlan
from capsyn.subdivision.rounds import RoundSubdivision
from support.labels import unit_box

N = 2
IN_FORCE = N + 1
ORDER = [1, 0, 2]


def kept(states):
    """Return sets (B, J, 1) of a law with a band, in which the symbol in force stays."""
    x = states[:, 0] + 0.3 * states[:, 1]
    band = np.abs(x - 0.6) < 0.17
    best = (x > 0.6).astype(int)
    labels = np.stack([np.where(band, j, best) if j < N else best for j in range(IN_FORCE)], axis=1)
    sets = singles(labels, N + 1)
    tie = np.abs(x - 0.2) < 0.15  # there both could be best, whatever is in force
    sets[tie] = 0b11
    return sets


def random_sets(states):
    """Return sets without any order, some of them of several symbols."""
    rng = np.random.default_rng(np.abs(np.ascontiguousarray(states)).view(np.uint64).sum() % 2**32)
    return rng.integers(1, 8, size=(len(states), IN_FORCE, 1)).astype(np.uint64)


def by_state(label):
    """Return a function that asks for states one by one, so that no batch changes an answer."""
    return lambda states: np.concatenate([label(state[None]) for state in states])


def subdivided(label, refine):
    """Return the cells, the rows that their leaves stand for, and the plan."""
    plan = SubdivisionPlan.of(
        Grid.of((3, 2), (2, 2), 3, 2),
        Limits.of(None, None, None, None),
        leaves="constant",
        leaf_error=0.01,
        refine=refine,
        test_points="vertices+center",
        seed=0,
    )
    points = LatticePoints(label, unit_box(), plan.lattice, N, None, None, in_force=IN_FORCE)
    task = SubdivisionTask(plan, RowTable(ORDER, IN_FORCE), points, plain=True)
    cells = (ConstantSubdivision if refine == "isotropic" else RoundSubdivision)(task).run()
    rows = task.rows.labels()
    used = set(cells.leaf_labels().tolist())
    assert used >= set(range(N + 1, len(rows)))  # no row that no cell uses
    assert rows[N + 1 :].tolist() == sorted(rows[N + 1 :].tolist())
    return cells, rows


@pytest.mark.parametrize("refine", ["isotropic", "adaptive"])
@pytest.mark.parametrize("label", [kept, random_sets])
def test_a_row_could_be_best_at_all_test_points_of_its_cell(label, refine):
    label = by_state(label)
    cells, rows = subdivided(label, refine)
    cells.check(N + 1, rows)
    assert np.array_equal(rows[: N + 1], np.arange(N + 1)[:, None].repeat(IN_FORCE, 1))
    assert len(np.unique(rows, axis=0)) == len(rows)
    mixed = set(cells.mixed_cells.tolist())
    boxes, counts = cells.boxes(), np.array(cells.counts)
    corners = np.array(list(itertools.product((0, 1), repeat=2)))
    whole = 0
    for place, low, high, leaf in zip(boxes.places, boxes.lower, boxes.upper, boxes.labels):
        points = np.concatenate([low + corners * (high - low), [(low + high) / 2]]) / counts
        held = members(label(points), N + 1).all(axis=0)  # (J, N + 1)
        if int(place) in mixed:
            continue
        whole += 1
        for j in range(IN_FORCE):
            best = next(k for k in ORDER if held[j, k])
            assert rows[leaf, j] == (j if held[j, j] else best)
    assert whole > 10 or label is not kept


def test_with_a_band_the_symbol_in_force_stays():
    cells, rows = subdivided(by_state(kept), "isotropic")
    assert rows[N + 1 :].tolist() == [[0, 1, 0], [0, 1, 1]]
    at = cells.labels(np.array([[0, 0], [9, 9], [23, 15]]))
    assert rows[at].tolist()[0] == [0] * 3 and rows[at].tolist()[2] == [1] * 3


def test_votes_go_to_the_symbol_in_force_among_equals():
    sets = np.array([[[0b01], [0b01], [0b10]], [[0b10], [0b10], [0b01]]], dtype=np.uint64)
    table = RowTable(ORDER, IN_FORCE)
    numbers, seen = table.voted(sets[:, None])
    assert table.labels()[numbers].tolist() == [[0, 1, 1]]  # the default is no candidate: by order
    assert (seen == 0b11).all()
    assert preferred(sets[0], ORDER).tolist() == [0, 0, 1]
    assert table.right(sets[:, None], numbers).tolist() == [[False], [False]]
