"""Adaptive splits: the axes that are chosen, and what subdivisions with them guarantee."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn import Box, subdivide
from capsyn.cells.cell_tree import CellTree
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.modelling.grid import Grid
from capsyn.subdivision.cell_points import CellPoints
from capsyn.subdivision.rounds import RoundSubdivision
from capsyn.subdivision.split_axes import SplitAxes
from support.labels import planar_masks, recorder
from support.policy_files import refuse, rewrite
from support.trees import random_policy


def unit_box(n, periodic=False):
    return Box([0.0] * n, [1.0] * n, periodic=[periodic] + [False] * (n - 1))


def axes_by(kind, n, text, values):
    """Return the axes of one cell, from what a function gives at its test points (P, n)."""
    offsets = CellPoints.parse(text).offsets(n)
    found = values(offsets - 1.0)
    can = np.ones((1, n), dtype=bool)
    if kind == "by_labels":  # sets are words, for each symbol in force
        found = found[..., None, None]
    return getattr(SplitAxes.of(offsets), kind)(found, can)[0].tolist()


@pytest.mark.parametrize("text", ["vertices", "vertices+center", "center+faces"])
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_labels_that_vary_along_an_axis_split_it(n, text):
    for axis in range(n):
        along = axes_by("by_labels", n, text, lambda x, i=axis: (1 + (x[:, i] > 0.5))[:, None])
        assert along == [i == axis for i in range(n)]
    tied = axes_by("by_labels", n, text, lambda x: np.where(x[:, 0] > 0.5, 3, 1)[:, None])
    assert tied == [True] * n  # symbol 0 could be best everywhere


def test_a_centre_that_differs_alone_splits_all_axes():
    labels = axes_by("by_labels", 3, "vertices+center", lambda x: 1 + (x == 0).all(1)[:, None])
    assert labels == [True] * 3


def scores_of(values):
    """Return residuals of two symbols that differ by values (P,)."""
    return np.stack([values, -values], axis=1)[:, None, :]


def test_products_are_seen_between_opposite_vertices_and_squares_between_faces():
    found = axes_by("by_residuals", 3, "vertices+center", lambda x: scores_of(x[:, 0] * x[:, 2]))
    assert found == [True, False, True]
    for text in ("center+faces", "vertices+center+faces", "vertices+center+edge_midpoints"):
        squares = axes_by("by_residuals", 3, text, lambda x: scores_of(x[:, 1] ** 2))
        assert squares == [False, True, False]
    # without points half-way squares do not tell their axes; a small product must not hide them
    for share, expected in ((0.05, [True] * 3), (1.0, [True, False, True])):
        both = axes_by(
            "by_residuals",
            3,
            "vertices+center",
            lambda x, share=share: scores_of(x[:, 1] ** 2 + share * x[:, 0] * x[:, 2]),
        )
        assert both == expected


def test_only_axes_that_can_be_split_are_compared():
    offsets = CellPoints().offsets(3)
    x = offsets - 1.0
    values = scores_of(x[:, 0] * (3 * x[:, 1] + x[:, 2]))
    found = SplitAxes.of(offsets)
    assert found.by_residuals(values, np.array([[1, 1, 1]], bool)).tolist() == [[1, 1, 0]]
    assert found.by_residuals(values, np.array([[0, 0, 1]], bool)).tolist() == [[0, 0, 1]]
    masks = (1 + (x[:, :1] > 0)).astype(np.uint8)[..., None, None]
    assert not found.by_labels(masks, np.array([[0, 1, 1]], bool)).any()


@settings(max_examples=40)
@given(
    st.integers(1, 3),
    st.integers(0, 99),
    st.integers(1, 3),
    st.sampled_from(["vertices", "vertices+center", "center+faces"]),
    st.booleans(),
)
def test_leaves_agree_or_are_finest_along_the_axes_that_vary(n, seed, partitions, text, periodic):
    box = unit_box(n, periodic)
    labels = planar_masks(box, seed, 3, 0.05)
    label, asked = recorder(labels)
    policy = subdivide(
        label, box, 3, partitions=partitions, max_level=5 - n, returns="masks",
        refine="adaptive", test_points=text,
    )  # fmt: skip
    tree = policy.cells
    tree.check(4)
    assert sum(len(states) for states in asked) == policy.statistics["solves"]
    offsets = CellPoints.parse(text).offsets(n)
    choose, seen = SplitAxes.of(offsets), dict(zip(tree.mixed_cells, tree.mixed_labels[:, 0, 0]))
    can = np.ones((1, n), dtype=bool)
    for place, lower, size in itertools.chain.from_iterable(zip(*x[1:]) for x in tree.leaves()):
        points = (lower + size * offsets / 2) / tree.counts
        masks = labels(np.where(box.periodic, points % 1, points))
        symbol = -1 - tree.entries[place]
        if place in seen:
            assert (size[choose.by_labels(masks[:, None, None, None], can)[0]] == 1).all()
        else:
            assert (masks >> np.uint64(symbol) & np.uint64(1)).all()
    statistics = policy.statistics
    assert statistics["refine"] == "adaptive" and statistics["cells"] == tree.leaf_count
    assert sum(statistics["leaves_by_level"]) == tree.leaf_count
    assert sum(level["solves"] for level in statistics["levels"]) == statistics["solves"]
    roles = statistics["solves_by_role"]
    assert sum(roles.values()) == statistics["solves"]
    assert statistics["solves"] - roles["quarter"] <= statistics["worst_case_solves"]


def test_splits_one_after_the_other_may_take_more_solves_than_all_at_once():
    labels = {(0.0, 0.0): 0, (0.0, 1.0): 0, (1.0, 0.0): 1, (1.0, 1.0): 1, (0.5, 1.0): 1}

    def label(states):
        return np.array([labels.get(tuple(state), 0) for state in states.tolist()])

    options = {"partitions": 1, "max_level": 1}
    found = [
        subdivide(label, unit_box(2), 2, refine=refine, **options).statistics
        for refine in ("isotropic", "adaptive")
    ]
    assert [x["solves"] for x in found] == [13, 15]
    assert [x["worst_case_solves"] for x in found] == [14, 17]


def test_cells_go_in_rounds_whose_blocks_are_as_small_as_their_splits(monkeypatch):
    rounds, evaluate = [], RoundSubdivision._evaluate

    def counting(self, groups):
        rounds.append(len(groups))
        return evaluate(self, groups)

    monkeypatch.setattr(RoundSubdivision, "_evaluate", counting)

    def label(states):
        return (np.abs(states[:, 0] - 0.43) < 0.2 * states[:, 5]).astype(int)

    policy = subdivide(
        label, unit_box(8), 2, partitions=1, max_level=5, refine="adaptive", max_memory="4GB"
    )
    assert policy.statistics["solves"] > 10_000
    # blocks of 2^8 cells in rounds of 2^19 test points would be many times more
    assert len(rounds) < 12


def test_an_axis_that_does_not_matter_is_not_split():
    def label(states):
        return (states[:, 1] > 0.37).astype(int)

    options = {"partitions": 2, "max_level": 4}
    both = subdivide(label, unit_box(3), 2, **options)
    some = subdivide(label, unit_box(3), 2, refine="adaptive", **options)
    sizes = np.concatenate([cells.sizes for cells in some.cells.leaves()])
    assert (sizes[:, [0, 2]] == 16).all() and sizes[:, 1].min() == 1
    assert some.statistics["solves"] < both.statistics["solves"] / 20
    steps = np.stack(np.unravel_index(np.arange(32**3), (32,) * 3), axis=1)
    assert np.array_equal(some.cells.labels(steps), both.cells.labels(steps))


def curved(states):
    """Return scores that are curved along two of four axes only."""
    x = states.T
    return np.stack([np.sin(4 * x[0]) * x[2], x[1] + 0.3 * x[3] - 0.4], axis=1)


def test_adaptive_splits_save_solves_where_few_axes_are_curved():
    options = {"partitions": 2, "max_level": 5, "leaves": "affine", "returns": "scores"}
    states = unit_box(4).sample(50_000, 3)
    right = curved(states).argmax(axis=1)
    found = {}
    for refine in ("isotropic", "adaptive"):
        policy = subdivide(curved, unit_box(4), 2, refine=refine, leaf_error=0.02, **options)
        share = (policy(states) == right).mean()
        assert share > 0.995
        found[refine] = policy.statistics["solves"]
    assert found["adaptive"] < 0.5 * found["isotropic"]


@pytest.mark.parametrize("leaves", ["constant", "affine"])
def test_the_result_depends_on_neither_rounds_nor_threads(leaves, monkeypatch):
    options = {"partitions": 2, "max_level": 3, "leaves": leaves, "returns": "scores"}
    options["refine"] = "adaptive"
    whole = subdivide(curved, unit_box(4), 2, **options)
    assert subdivide(curved, unit_box(4), 2, threads=3, **options).cells.entries.tobytes() == (
        whole.cells.entries.tobytes()
    )
    monkeypatch.setattr("capsyn.subdivision.rounds.ROUND_POINTS", 3_000)
    monkeypatch.setattr("capsyn.subdivision.rounds.CHUNK_SCORES", 2_000)
    again = subdivide(curved, unit_box(4), 2, **options)
    assert again.statistics["solves"] == whole.statistics["solves"]
    found, wanted = again.cells.arrays(), whole.cells.arrays()
    assert found.keys() == wanted.keys()
    assert all(np.array_equal(found[name], wanted[name]) for name in wanted)


@pytest.mark.parametrize("leaves", ["constant", "affine"])
@pytest.mark.parametrize("budget", [100, 1000, 5000])
def test_a_budget_of_solves_is_kept(leaves, budget):
    policy = subdivide(
        curved, unit_box(4), 2, partitions=2, max_level=5, leaves=leaves, returns="scores",
        refine="adaptive", max_solves=budget,
    )  # fmt: skip
    assert budget * 0.6 < policy.statistics["solves"] <= budget
    assert policy.statistics["stopped_by_max_solves"]
    policy.cells.check(3)
    with pytest.raises(ProblemError, match="`max_solves` must be at least the 97 solves of level"):
        subdivide(
            curved, unit_box(4), 2, partitions=2, returns="scores", refine="adaptive", max_solves=9
        )


def test_bad_arguments():
    with pytest.raises(ProblemError, match="`refine` must be one of 'isotropic', 'adaptive'; got"):
        subdivide(curved, unit_box(4), 2, refine="no")
    with pytest.raises(ProblemError, match="`refine` 'adaptive' is for at most 16 axes; the dom"):
        subdivide(
            curved, unit_box(17), 2, partitions=1, max_level=1, refine="adaptive",
            test_points="center+faces", max_solves=100,
        )  # fmt: skip


BROKEN = {
    "a leaf that splits": (lambda a: a["splits"].__setitem__(-1, 1), "along no axis, or a leaf"),
    "a split along none": (
        lambda a: a["splits"].__setitem__(np.flatnonzero(a["splits"])[0], 0),
        "a cell is split along no axis",
    ),
    "an unknown axis": (
        lambda a: a["splits"].__setitem__(np.flatnonzero(a["splits"])[0], 4),
        "not those of the cells",
    ),
    "another axis": (
        lambda a: a["splits"].__setitem__(np.flatnonzero(a["splits"] == 1)[0], 3),
        "not one after the other|deeper or more than",
    ),
    "too few": (lambda a: a.update(splits=a["splits"][:-1].copy()), "not those of the cells"),
    "another type": (
        lambda a: a.update(splits=a["splits"].astype(np.int32)),
        "array 'splits' must be one-dimensional uint16",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_masks_that_do_not_fit_are_refused(name, tmp_path):
    random_policy(3, seed=1, some_axes=True).save(tmp_path / "p.cap")
    change, message = BROKEN[name]
    rewrite(tmp_path / "p.cap", lambda _, arrays: change(arrays))
    refuse(tmp_path / "p.cap", message)


def test_an_axis_that_is_split_too_often_is_refused(tmp_path):
    random_policy(3, seed=1, some_axes=True).save(tmp_path / "p.cap")
    rewrite(tmp_path / "p.cap", lambda document, _: document["policy"].update(max_level=2))
    refuse(tmp_path / "p.cap", "deeper or more than the file says")


def test_trees_of_many_axes_are_not_split_along_some():
    grid = Grid((1,) * 17, (2,) * 17, 1)
    with pytest.raises(PolicyFormatError, match="cells of 17 axes cannot be split along some"):
        CellTree(
            grid, np.array([-1], np.int32), np.empty(0, np.int32), np.empty(0, np.uint64),
            splits=np.zeros(1, np.uint16),
        ).check(3)  # fmt: skip
