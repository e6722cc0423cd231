"""Propositions 1 and 2, and what a subdivision may take of the memory."""

import dataclasses
import itertools
import math
import re
import tracemalloc

import numpy as np
import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn import Box, subdivide
from capsyn.errors import ProblemError
from capsyn.modelling.grid import Grid
from capsyn.subdivision import limits as budgets
from capsyn.subdivision import propositions as props
from capsyn.subdivision.cell_points import CellPoints
from capsyn.subdivision.limits import Limits
from support.references.subdivision import noise

PAPER = Grid((9, 9), (2, 2), 0)
CENTER = CellPoints.parse("vertices+center")


def unit_box(n, periodic=None):
    return Box([0.0] * n, [1.0] * n, periodic=periodic)


def always_mixed(level, partitions=9):
    """Label the unit square so that every cell up to `level` has a vertex unlike its centre."""

    def label(states):
        k = np.rint(states[:, 0] * partitions * 2 ** (level + 1)).astype(int)
        return np.where(k == 0, 0, np.log2(np.maximum(k & -k, 1)).astype(int) % 2)

    return label


@pytest.mark.parametrize(
    ("level", "paper", "distinct", "one_axis_periodic"),
    [(4, 41_842, 41_761, 41_616), (5, 166_546, 166_465, 166_176)],
)
def test_worst_case_solves_is_the_papers_and_bounds_the_true_worst_case(
    level, paper, distinct, one_axis_periodic
):
    assert props.worst_case_solves(PAPER.at(level), 1) == paper
    for periodic, count in [((False, False), distinct), ((False, True), one_axis_periodic)]:
        box = unit_box(2, periodic)
        policy = subdivide(always_mixed(level), box, 2, partitions=9, max_level=level)
        assert policy.statistics["solves"] == count
        assert policy.statistics["worst_case_solves"] == paper
        assert policy.statistics["leaves_by_level"] == [0] * level + [81 * 4**level]


@given(
    q=st.lists(st.integers(1, 6), min_size=1, max_size=4),
    r=st.integers(2, 4),
    level=st.integers(0, 5),
    interior=st.integers(0, 9),
)
def test_worst_case_solves_is_eq_10(q, r, level, interior):
    vertices = math.prod(count * r**level + 1 for count in q)
    expected = vertices + (1 + (r ** len(q)) ** level) * math.prod(q) * interior
    assert props.worst_case_solves(Grid(tuple(q), (r,) * len(q), level), interior) == expected


axes = st.lists(
    st.tuples(st.integers(1, 10**6), st.integers(1, 10**4), st.integers(1, 12), st.integers(2, 5)),
    min_size=1,
    max_size=4,
)


@given(axes)
def test_level_for_precision_is_the_least_that_suffices(axes):
    widths, wanted, q, r = zip(*axes)
    box = Box([0.0] * len(axes), [float(w) for w in widths])
    level = props.level_for_precision(box, wanted, q, r)

    def suffices(level):  # in whole numbers
        return all(w <= d * c * f**level for w, d, c, f in zip(widths, wanted, q, r))

    assert level == next(k for k in itertools.count() if suffices(k))


@settings(max_examples=100)
@given(q=st.integers(1, 200), r=st.integers(2, 7), level=st.integers(0, 8))
def test_level_for_precision_is_exact_at_powers(q, r, level):
    edge = 1.0 / (q * r**level)
    assert props.level_for_precision(unit_box(1), [edge], q, r) == level
    assert props.level_for_precision(unit_box(1), [edge * (1 - 1e-12)], q, r) == level + 1


def test_level_for_precision_of_one_number_per_axis():
    box = Box([0.0, -5.0], [6.0, 5.0])
    assert props.level_for_precision(box, [2.0, 10.0], [3, 1]) == 0
    assert props.level_for_precision(box, [2.0, 0.5], [3, 1]) == 5
    assert props.level_for_precision(box, [2.0, 0.5], [3, 1], [2, 5]) == 2


@pytest.mark.parametrize("precision", [[1.0], [1, 0], [1, -1], [1, np.nan], [1, np.inf], 1.0])
def test_level_for_precision_refuses_what_is_no_precision(precision):
    with pytest.raises(ProblemError, match=r"^`precision` must be 2 positive number\(s\); got "):
        props.level_for_precision(unit_box(2), precision, 9)


def test_blocks_do_not_follow_some_free_megabytes(monkeypatch):
    rooms = set()
    for free in (1_400_000_000, 1_499_000_000, 1_500_000_000, 1_600_000_000):
        monkeypatch.setattr(budgets, "available_memory", lambda free=free: free)
        rooms.add(budgets.block_room(Limits()))
    assert rooms == {2**28}
    assert budgets.block_room(Limits(max_memory=10**7)) == 10**7 // budgets.ROOM


def test_blocks_stay_as_they_were_while_there_is_memory_for_them():
    def parents(room, limit, taken=0):
        limits = Limits(memory_limit=limit, room=room)
        return budgets.block_parents(limits, 1000, 100, 10, taken)

    assert parents(None, 40_000) == 100  # a quarter of the memory
    assert parents(4_000, 40_000) == 40 and parents(4_000, 40_000, 39_000) == 40
    assert parents(20_000, 40_000) == 200 and parents(30_000, 40_000) == 300
    assert parents(30_001, 40_000, 1) == 100 and parents(30_100, 40_000) == 100
    assert parents(10**9, 120_000) == 10**7 and parents(10**9, 109_000) == 272
    assert parents(1, 40_000) == parents(None, 1) == 1


@pytest.mark.parametrize("max_solves", [None, 10**6])
def test_too_large_max_level_says_how_much_and_what_would_fit(monkeypatch, max_solves):
    free = 20_000_000
    monkeypatch.setattr(budgets, "available_memory", lambda: free)
    room = budgets.block_room(Limits())
    assert free // 8 < room <= free // 4
    need = [budgets.worst_case_memory(PAPER.at(k), CENTER, 1, max_solves, room) for k in range(8)]
    fits = max(k for k in range(8) if need[k] <= free)
    assert fits < 7 and need == sorted(need)
    with pytest.raises(ProblemError) as caught:
        budgets.check_memory(PAPER.at(fits + 1), CENTER, 1, Limits(max_solves))
    message = str(caught.value)
    assert "\n" not in message and message.startswith(f"`max_level` {fits + 1} ")
    assert f"{need[fits + 1] / 1e9:.3g} GB" in message and "0.02 GB is available" in message
    assert f"max_level <= {fits} fits" in message and "or `max_memory`" in message
    budgets.check_memory(PAPER.at(fits), CENTER, 1, Limits(max_solves))
    budgets.check_memory(PAPER.at(fits + 1), CENTER, 1, Limits(max_solves, memory_limit=need[-1]))
    budgets.check_memory(PAPER.at(fits + 1), CENTER, 1, Limits(max_solves, max_memory=free))
    with pytest.raises(ProblemError, match=r"0\.001 GB is allowed by `memory_limit`"):
        budgets.check_memory(PAPER.at(fits), CENTER, 1, Limits(max_solves, memory_limit=10**6))


def test_solves_that_are_said_to_fit_do(monkeypatch):
    monkeypatch.setattr(budgets, "available_memory", lambda: 10**7)
    for affine in (False, True):
        with pytest.raises(ProblemError, match="with `max_solves`") as caught:
            budgets.check_memory(PAPER.at(9), CENTER, 1, Limits(memory_limit=4 * 10**8), affine)
        found = re.search(r"at most ([\d,]+)\)", str(caught.value))
        most = int(found[1].replace(",", ""))
        limits = Limits(most, memory_limit=4 * 10**8)
        budgets.check_memory(PAPER.at(9), CENTER, 1, limits, affine)
        with pytest.raises(ProblemError):
            limits = dataclasses.replace(limits, max_solves=3 * most)
            budgets.check_memory(PAPER.at(9), CENTER, 1, limits, affine)


def test_no_solves_are_advised_that_level_0_exceeds():
    for affine, limit in ((False, 10**4), (True, 300_010_000)):
        with pytest.raises(ProblemError, match="or bound it with `max_memory`$"):
            budgets.check_memory(PAPER.at(9), CENTER, 1, Limits(memory_limit=limit), affine)


def test_too_large_max_level_is_refused_before_any_work(monkeypatch):
    calls = []

    def label(states):
        calls.append(len(states))
        return np.zeros(len(states), dtype=int)

    monkeypatch.setattr(budgets, "available_memory", lambda: 10**6)
    with pytest.raises(ProblemError, match=r"`max_level` 9 .* max_level <= 3 fits") as caught:
        subdivide(label, unit_box(2), 2, max_level=9)
    assert 'fits, or fewer `partitions`, or leaves="affine", or bound it' in str(caught.value)
    assert not calls
    policy = subdivide(label, unit_box(2), 2, max_level=9, max_solves=900)
    assert policy.statistics["solves"] == sum(calls) == 181


def test_root_grid_that_does_not_fit_asks_for_fewer_partitions(monkeypatch):
    free = 2**13  # so that a fourth of it is a power of two, as blocks of unknown limits are
    monkeypatch.setattr(budgets, "available_memory", lambda: free)
    fits = max(
        k
        for k in range(1, 9)
        if budgets.worst_case_memory(Grid((k, k), (2, 2), 0), CENTER, 1, None, free // budgets.ROOM)
        <= free
    )
    advice = f"use fewer partitions: {fits} per axis fit at level 0"
    for level in (0, 3):
        with pytest.raises(ProblemError, match=advice):
            budgets.check_memory(PAPER.at(level), CENTER, 1, Limits())
    with pytest.raises(ProblemError, match=f"`max_memory` must be at least .*{fits} per axis fit"):
        budgets.check_memory(PAPER.at(3), CENTER, 1, Limits(max_memory=free))
    budgets.check_memory(Grid((fits, fits), (2, 2), 0), CENTER, 1, Limits())
    monkeypatch.setattr(budgets, "available_memory", lambda: 100)
    with pytest.raises(ProblemError, match="no root grid fits, or bound it with `max_memory`"):
        budgets.check_memory(PAPER.at(3), CENTER, 1, Limits())


def test_memory_that_suffices_refuses_nothing(monkeypatch):
    monkeypatch.setattr(budgets, "available_memory", lambda: 2**160)
    budgets.check_memory(Grid((9,) * 6, (2,) * 6, 20), CENTER, 8, Limits())


def test_available_memory_is_what_the_system_says():
    free, total = budgets.available_memory(), psutil.virtual_memory().total
    assert type(free) is int and 2**20 < free <= total


@pytest.mark.parametrize(
    ("n", "partitions", "level", "n_symbols", "points", "max_solves"),
    [
        (2, 9, 4, 2, "vertices+center", None),
        (4, 3, 2, 12, "vertices+center", 40_000),
        (6, 3, 2, 7, "vertices+center", 60_000),
        (6, 2, 1, 12, "center+faces+random:9", None),
        (2, 200, 0, 3, "vertices", None),
    ],
)
@pytest.mark.parametrize(
    ("leaves", "refine"),
    [("affine", "isotropic"), ("affine", "adaptive"), ("constant", "adaptive")],
)
def test_worst_case_memory_of_rounds(
    n, partitions, level, n_symbols, points, max_solves, leaves, refine
):
    def label(states):
        found = noise(states, 1)
        bits = [found >> np.uint64(3 * k) & np.uint64(1023) for k in range(n_symbols)]
        return np.stack(bits, axis=1).astype(float)

    grid = {"partitions": partitions, "max_level": level, "test_points": points}
    tracemalloc.start()
    try:
        subdivide(
            label, unit_box(n), n_symbols, **grid, leaves=leaves, returns="scores",
            max_solves=max_solves, refine=refine,
        )  # fmt: skip
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < budgets.worst_case_rounds_memory(
        Grid((partitions,) * n, (2,) * n, level),
        CellPoints.parse(points),
        n_symbols + 1 if leaves == "affine" else 0,
        max_solves,
        refine == "adaptive",
    )


@pytest.mark.parametrize(
    ("n", "partitions", "level", "n_symbols", "points"),
    [
        (1, 1000, 5, 40, "vertices"),
        (2, 9, 4, 2, "vertices+center"),
        (2, 9, 4, 40, "vertices+center+random:5"),
        (4, 3, 2, 12, "vertices+center+edge_midpoints"),
        (6, 2, 1, 2, "vertices+center"),
        (6, 2, 1, 40, "vertices+center"),
        (6, 4, 0, 2, "vertices"),
    ],
)
def test_worst_case_memory_bounds_what_is_taken(n, partitions, level, n_symbols, points):
    def label(states):
        return (noise(states, 1) >> np.uint64(40)).astype(int) % n_symbols

    grid = {"partitions": partitions, "max_level": level, "test_points": points}
    tracemalloc.start()
    try:
        policy = subdivide(label, unit_box(n), n_symbols, **grid)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    bound = budgets.worst_case_memory(
        Grid((partitions,) * n, (2,) * n, level), CellPoints.parse(points), n_symbols
    )
    assert policy.statistics["cells"] > 0.75 * (partitions * 2**level) ** n  # a bad case indeed
    assert 0.3 * bound < peak < bound
