"""Limits of memory, time and solves; blocks of a level; keys of more than 64 bits."""

import contextlib
import hashlib
import itertools
import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn import Box, Policy, problems, subdivide, synthesize
from capsyn.errors import ProblemError, SynthesisError
from capsyn.execution.memory import memory
from capsyn.subdivision import lattice_points
from capsyn.subdivision.constant import ConstantSubdivision
from capsyn.subdivision.lattice_points import LatticePoints, inserted, key_strides
from capsyn.subdivision.limits import Limits
from support.labels import (
    disc,
    halves,
    noisy_masks,
    planar_masks,
    recorder,
    same,
    unit_box,
)
from support.references.subdivision import cells_of, noise, reference


@contextlib.contextmanager
def in_blocks(parents):
    """Let so many parents make a block."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("capsyn.subdivision.constant.block_bytes", lambda *rest: 1)
        patch.setattr("capsyn.subdivision.limits.block_room", lambda limits: parents)
        yield


# Amounts of memory


@pytest.mark.parametrize(
    ("value", "bytes_"),
    [
        (7, 7), ("7", 7), ("7 B", 7), ("1.5kB", 1500), ("2GB", 2 * 10**9), (" 2 GiB ", 2**31),
        ("0.5MiB", 2**19), ("3mb", 3 * 10**6), (np.int64(5), 5), ("1TB", 10**12),
    ],
)  # fmt: skip
def test_memory_is_bytes_or_a_text(value, bytes_):
    assert memory("it", value) == bytes_


@pytest.mark.parametrize(
    "value", ["", "GB", "-1GB", "1 PB", "1e9", "inf", "0.1B", "0", 0, -1, 1.5, True, [1], "٣MB"]
)
def test_other_amounts_are_refused_in_one_line(value):
    with pytest.raises(ProblemError, match="^`it` must be .*got ") as caught:
        memory("it", value)
    assert "\n" not in str(caught.value)


# Blocks


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 3),
    parents=st.integers(1, 40),
    ties=st.booleans(),
    smooth=st.booleans(),
    random=st.integers(0, 2),
    share=st.none() | st.floats(0.0, 1.2),
    periodic=st.booleans(),
    missing=st.booleans(),
)
def test_blocks_give_the_bytes_of_whole_levels(
    seed, n, parents, ties, smooth, random, share, periodic, missing
):
    box = unit_box(n, [periodic] + [False] * (n - 1))
    masks = planar_masks(box, seed, 3, 0.02 * ties) if smooth else noisy_masks(seed, 3, ties)

    def label(states):
        found = masks(states)
        found[(noise(states, seed) % np.uint64(211) == 0) & missing] = 0
        return found

    options = {
        "partitions": 3,
        "max_level": 3 if n < 3 else 2,
        "returns": "masks",
        "test_points": f"vertices+center+edge_midpoints{f'+random:{random}' if random else ''}",
    }

    def run(**more):
        try:
            return subdivide(label, box, 3, **options, **more)
        except (ProblemError, SynthesisError) as error:
            return type(error)

    whole = run()
    budget = {}
    if share is not None and isinstance(whole, Policy):
        budget = {"max_solves": max(1, int(share * whole.statistics["solves"]))}
        whole = run(**budget)
    with in_blocks(parents):
        blocks = run(**budget)
    if isinstance(whole, Policy):
        assert same(blocks, whole)
        blocks.cells.check(4)
    else:
        assert blocks is whole


def test_blocks_decide_on_solves_as_whole_levels_do():
    label = planar_masks(unit_box(), 11, 3, 0.004)
    options = {"partitions": 5, "max_level": 4, "returns": "masks"}
    everything = subdivide(label, unit_box(), 3, **options).statistics["solves"]
    for budget in range(61, everything + 20, 13):
        whole = subdivide(label, unit_box(), 3, max_solves=budget, **options)
        with in_blocks(9):
            assert same(subdivide(label, unit_box(), 3, max_solves=budget, **options), whole)


def test_the_example_without_an_answer_does_not_depend_on_blocks():
    def label(states):
        far = np.abs(states - [1 / 3, 2 / 3]).max(axis=1)  # vertices of two blocks, late ones first
        near = np.abs(states - [0.5, 0.5]).max(axis=1)
        masks = planar_masks(unit_box(), 4, 3, 0.0)(states)
        return np.where((far < 0.01) | (near < 0.01), np.uint64(0), masks)

    options = {"partitions": 3, "max_level": 4, "returns": "masks"}
    whole = subdivide(label, unit_box(), 3, **options)
    assert whole.statistics["not_finite_points"] > 1
    for parents in (1, 2, 3, 5):
        with in_blocks(parents):
            assert same(subdivide(label, unit_box(), 3, **options), whole)


def test_no_point_is_solved_twice_in_blocks():
    label, batches = recorder(disc)
    with in_blocks(5):
        policy = subdivide(label, unit_box(), 3, max_level=5, test_points="vertices+center")
    points = np.concatenate(batches)
    assert len(np.unique(points, axis=0)) == len(points) == policy.statistics["solves"]


def test_blocks_of_a_problem_give_the_same_file_within_the_limit(tmp_path):
    problem, digests, peaks = problems.plain("cart-pole"), [], []
    options = [{}, {"memory_limit": "200MB"}, {"max_memory": "40MB"}]
    for option in options:
        tracemalloc.start()
        try:
            policy = synthesize(problem, max_level=3, **option)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
        policy.save(tmp_path / "it.cap")
        digests.append(hashlib.sha256((tmp_path / "it.cap").read_bytes()).hexdigest())
    assert len(set(digests)) == 1
    assert peaks[2] < 0.6 * peaks[0] and peaks[1] < 200e6 and peaks[2] < 40e6


# Budgets


@pytest.mark.parametrize("leaves", ["constant", "affine"])
def test_a_memory_budget_leaves_a_valid_coarser_policy(leaves, monkeypatch):
    def scores(states):
        inside = 0.16 - sum((states[:, i] - 0.5) ** 2 for i in range(3))
        return np.stack([inside, np.zeros(len(states))], axis=1)

    options = {"partitions": 4, "max_level": 5}
    monkeypatch.setattr("capsyn.subdivision.rounds.ROUND_POINTS", 2**14)
    options |= {"leaves": leaves, "returns": "scores", "leaf_error": 1e-5}
    counts = []
    for budget in (3, 6, 9, 100):
        budget = budget * 10**6 + (300_000_000 if leaves == "affine" else 0)
        tracemalloc.start()
        try:
            policy = subdivide(scores, unit_box(3), 2, max_memory=budget, **options)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert peak < budget
        policy.cells.check(3)
        counts.append(policy.statistics["solves"])
        stopped = policy.statistics.get("stopped_by")
        assert stopped in ("max_memory", None) and not policy.statistics["stopped_by_max_solves"]
        states = unit_box(3).sample(20_000, 3)
        wrong = (policy(states) != scores(states).argmax(axis=1)).mean()
        assert wrong < 0.12
        again = subdivide(scores, unit_box(3), 2, max_memory=budget, threads=2, **options)
        assert same(again, policy)
    assert counts == sorted(counts) and counts[0] < counts[1] < counts[3]
    assert stopped is None
    assert same(policy, subdivide(scores, unit_box(3), 2, **options))


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    parents=st.integers(1, 40),
    share=st.none() | st.floats(0.02, 1.1),
    memory=st.none() | st.integers(2_000, 60_000),
    seconds=st.none() | st.integers(1, 60),
    points=st.sampled_from(["vertices+center", "vertices", "center+faces+random:1"]),
)
def test_what_is_solved_is_used_whatever_ends_the_run(
    seed, parents, share, memory, seconds, points
):
    label = planar_masks(unit_box(), seed, 3, 0.02)
    options = {"partitions": 2, "max_level": 6, "returns": "masks", "test_points": points}
    most = None
    if share is not None:
        everything = subdivide(label, unit_box(), 3, **options).statistics["solves"]
        most = max(20, int(share * everything))
    recorded, batches = recorder(label)
    clock = itertools.count()

    class Clock:
        perf_counter = staticmethod(lambda: float(next(clock)))

    with in_blocks(parents), pytest.MonkeyPatch.context() as patch:
        patch.setattr("capsyn.subdivision.ledger.time", Clock)
        policy = subdivide(
            recorded, unit_box(), 3, **options,
            max_solves=most, max_memory=memory, max_seconds=seconds,
        )  # fmt: skip
    policy.cells.check(4)
    solved, told = np.concatenate(batches), policy.statistics
    assert len(np.unique(solved, axis=0)) == len(solved) == told["solves"]
    assert most is None or told["solves"] <= most
    assert sum(told["solves_by_role"].values()) == told["solves"]
    quarter = told["solves_by_role"]["quarter"]
    assert sum(level["solves"] for level in told["levels"]) + quarter == told["solves"]
    for level, (cells, above) in enumerate(zip(told["levels"][1:], told["levels"])):
        assert cells["solves"] > 0 or cells["cells"] == 4 * above["mixed"], level
    if most is not None and most > 2 * everything and seconds is None:
        with in_blocks(parents):
            assert same(subdivide(label, unit_box(), 3, **options, max_memory=memory), policy)


def test_budgets_of_memory_and_solves_together_keep_the_blocks_that_are_done():
    label, batches = recorder(planar_masks(unit_box(), 11, 3, 0.004))
    options = {"partitions": 5, "max_level": 6, "returns": "masks", "max_memory": 30_000}
    with in_blocks(9):
        alone = subdivide(label, unit_box(), 3, **options)
        solves = alone.statistics["solves"]
        assert alone.statistics["stopped_by"] == "max_memory"
        levels = alone.statistics["levels"]
        assert levels[-1]["cells"] < 4 * levels[-2]["mixed"]  # it stops within a level
        for budget in (2 * solves, solves + 500, solves + 200):
            batches.clear()
            both = subdivide(label, unit_box(), 3, max_solves=budget, **options)
            assert sum(map(len, batches)) == both.statistics["solves"]
            assert both.statistics["stopped_by"] == "max_memory"
            assert sum(both.statistics["leaves_by_level"][5:]) > 100


@pytest.mark.parametrize("share", [0.4, 0.8, 1.05, 3.0])
def test_counting_stays_within_the_memory(share, monkeypatch):
    monkeypatch.setattr(lattice_points, "MERGED", 2**12)  # which is a constant beside all else

    def label(states):
        return (sum((states[:, i] - 0.5) ** 2 for i in range(3)) < 0.16).astype(int)

    options = {"partitions": 4, "refinement": 4, "max_level": 4, "max_memory": 4_000_000}
    solves = subdivide(label, unit_box(3), 2, **options).statistics["solves"]
    tracemalloc.start()
    try:
        policy = subdivide(label, unit_box(3), 2, max_solves=int(share * solves), **options)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < options["max_memory"]
    assert policy.statistics["solves"] <= share * solves
    assert policy.statistics["stopped_by_max_solves"] == (share < 2)


def test_solves_that_suffice_surely_are_not_counted(monkeypatch):
    counted = []
    count = ConstantSubdivision._count
    monkeypatch.setattr(
        ConstantSubdivision, "_count", lambda *a: (counted.append(a[2]), count(*a))[1]
    )
    label = planar_masks(unit_box(), 11, 3, 0.004)
    with in_blocks(9):
        whole = subdivide(label, unit_box(), 3, returns="masks")
        solves = whole.statistics["solves"]
        for budget, levels in ((100 * solves, 0), (solves, 2)):
            counted.clear()
            assert same(subdivide(label, unit_box(), 3, returns="masks", max_solves=budget), whole)
            assert len(counted) <= levels and bool(counted) == bool(levels)


@pytest.mark.parametrize("leaves", ["constant", "affine"])
def test_a_time_budget_stops_after_a_block(leaves, monkeypatch, tmp_path):
    clock = itertools.count()

    class Clock:
        perf_counter = staticmethod(lambda: float(next(clock)))

    monkeypatch.setattr("capsyn.subdivision.ledger.time", Clock)
    monkeypatch.setattr("capsyn.subdivision.rounds.ROUND_POINTS", 400)
    options = {"partitions": 3, "leaves": leaves, "max_level": 6, "leaf_error": 0.0}
    solves = []
    for seconds in (0.5, 5, 8, 12):
        with in_blocks(4):
            policy = subdivide(disc, unit_box(), 3, max_seconds=seconds, **options)
        policy.cells.check(4)
        assert policy.statistics["stopped_by"] == "max_seconds"
        solves.append(policy.statistics["solves"])
        policy.save(tmp_path / "it.cap")
        assert Policy.load(tmp_path / "it.cap").statistics == policy.statistics
    assert solves[0] == 25 and solves == sorted(set(solves))


def test_cells_that_a_budget_does_not_reach_stay_as_they_are():
    options = {"partitions": 3, "max_level": 6}
    coarse = [
        cells_of(subdivide(disc, unit_box(), 3, **options | {"max_level": k})) for k in (2, 3)
    ]
    whole = cells_of(subdivide(disc, unit_box(), 3, **options))
    stops = itertools.chain([False] * 40, itertools.repeat(True))

    def used_up(self, parents, level):
        self._ledger.stopped = "max_seconds" if level and next(stops) else ""
        return bool(self._ledger.stopped)

    with in_blocks(2) as _, pytest.MonkeyPatch.context() as patch:
        patch.setattr("capsyn.subdivision.constant.ConstantSubdivision._used_up", used_up)
        policy = subdivide(disc, unit_box(), 3, **options)
    policy.cells.check(4)
    leaves, mixed = cells_of(policy)
    levels = policy.statistics["levels"]
    last = len(levels) - 1
    assert last == 3 and 0 < levels[3]["cells"] < 4 * levels[2]["mixed"]
    assert policy.statistics["cells"] == len(leaves) == policy.cells.leaf_count
    assert policy.statistics["mixed_cells"] == len(mixed)
    assert {level for level, _ in mixed} == {2, 3}
    for cell, label in leaves.items():
        expected = [c for c in (*coarse, whole) if cell in c[0]]
        assert expected and expected[0][0][cell] == label
        assert expected[0][1].get(cell) == mixed.get(cell)


def test_a_time_budget_holds_by_the_clock():
    def slow(states):
        time.sleep(1e-4 * len(states))
        return halves(states)

    started = time.perf_counter()
    policy = subdivide(slow, unit_box(), 2, max_level=9, max_seconds=0.1)
    assert time.perf_counter() - started < 2.0
    assert policy.statistics["stopped_by"] == "max_seconds"
    assert len(policy.statistics["levels"]) >= 2


def test_what_stopped_is_told(capsys):
    from capsyn.cli.printed import print_report
    from capsyn.policies.report import hints, report

    policy = subdivide(halves, unit_box(), 2, max_level=9, max_memory="40KB")
    print_report(report(policy))
    assert "stopped by   max_memory, before max_level everywhere\n" in capsys.readouterr().out
    assert not any("max_memory" in hint for hint in hints(policy))


# Keys


def test_keys_number_the_lattice_in_order_whatever_their_width(monkeypatch):
    extents = [3, 5, 2, 7, 4]
    for word, words in ((2**63 - 1, 1), (60, 2), (20, 3), (7, 5)):
        monkeypatch.setattr(lattice_points, "WORD", word)
        strides, axes = key_strides(extents)
        assert strides.shape == (5, words) and axes == sorted(axes)
        points = np.array(list(itertools.product(*map(range, extents))))
        found = [tuple(row) for row in points @ strides]
        assert found == sorted(set(found)) and max(map(max, found)) < word + 1


def test_no_two_points_of_a_lattice_beyond_64_bits_share_a_key():
    n, count = 12, 2**30
    box = unit_box(n, [False, True] * 6)
    store = LatticePoints(lambda s: s, box, (count,) * n, 1, None, None)
    rng = np.random.default_rng(1)
    points = rng.integers(0, count, (50_000, n))
    points[25_000:] = points[:25_000]  # neighbours that differ in one coordinate
    axis = rng.integers(0, n, 25_000)
    points[25_000 + np.arange(25_000), axis] ^= 1 << rng.integers(0, 30, 25_000)
    keys = store.encode(np.zeros((1, n), dtype=np.int64), points)[0]
    assert keys.itemsize > 16
    assert len(np.unique(keys)) == len(np.unique(points, axis=0))
    assert (store.places(keys) == points).all()
    order = np.lexsort(points.T[::-1])
    assert (np.sort(keys) == keys[order]).all()
    seam = np.full((1, n), count)
    wrapped = store.places(store.encode(seam, np.zeros((1, n), dtype=np.int64))[0])
    assert wrapped.tolist() == [[count, 0] * 6]


@settings(max_examples=40)
@given(
    parts=st.lists(st.lists(st.integers(0, 80), max_size=30), max_size=6),
    solved=st.lists(st.integers(0, 80), min_size=1, max_size=40),
    wide=st.booleans(),
)
def test_keys_that_are_yet_to_be_solved_are_held_once(parts, solved, wide):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lattice_points, "WORD", 9 if wide else 2**63 - 1)
        store = LatticePoints(lambda x: np.ones(len(x)), unit_box(), (8, 8), 1, None, None)

        def keys(numbers):
            places = np.array([divmod(k, 9) for k in numbers], dtype=np.int64).reshape(-1, 2)
            found = store.encode(np.zeros((1, 2), dtype=np.int64), places)[0]
            assert (store.places(found) == places).all() and store.places(found).shape[1] == 2
            return found

        store.answer(store.ask(keys(solved)), 0, 0, 1)
        unsolved = store.unsolved()
        for part in parts:
            unsolved.add(keys(part))
        assert len(unsolved) == len({k for part in parts for k in part} - set(solved))
        assert unsolved.nbytes == (len(unsolved) + 1) * keys([1]).itemsize


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 3),
    word=st.sampled_from([200, 3000]),
    leaves=st.sampled_from(["constant", "affine"]),
    periodic=st.lists(st.booleans(), min_size=3, max_size=3),
)
def test_wide_keys_give_the_bytes_of_narrow_ones(seed, n, word, leaves, periodic):
    box = unit_box(n, periodic[:n])
    label = planar_masks(box, seed, 3, 0.01)
    options = {"partitions": 2, "max_level": 3 if n < 3 else 2, "returns": "masks"}
    options |= {"test_points": "vertices+center+random:2", "leaves": leaves}
    narrow = subdivide(label, box, 3, **options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lattice_points, "WORD", word)
        wide = subdivide(label, box, 3, **options)
    assert same(wide, narrow)


def test_levels_whose_lattice_is_beyond_64_bits_equal_the_reference():
    box = Box([0.0, 0.0], [1.0, 1.0])

    def label(states):
        near = np.maximum(np.abs(states[:, 0] - 1 / 3), np.abs(states[:, 1] - 1 / 7))
        return np.where(near < 1e-7, np.uint64(1), np.uint64(2))

    def corner(states):  # mixed only at the corner cells of every level
        return np.where(states.sum(axis=1) == 0, np.uint64(1), np.uint64(2))

    for function in (label, corner):
        policy = subdivide(
            function, box, 1, partitions=9, max_level=27, returns="masks", max_memory="2GB"
        )
        expected = reference(function, box, (9, 9), (2, 2), 27, "vertices+center")
        leaves, mixed = cells_of(policy)
        assert leaves == expected.leaves and mixed == expected.mixed
        assert policy.statistics["solves"] == len(expected.masks)
    assert len(policy.statistics["levels"]) == 28


def test_twelve_dimensions(tmp_path):
    n = 12
    box = unit_box(n)
    normal = np.arange(1.0, n + 1)

    def scores(states):
        height = sum(k * states[:, i] for i, k in enumerate(normal)) - 0.5 * normal.sum()
        return np.stack([height, np.zeros(len(states))], axis=1)

    policy = subdivide(
        scores, box, 2, partitions=(2,) + (1,) * 11, max_level=1, returns="scores",
        leaves="affine", test_points="center+faces", max_memory="4GB",
    )  # fmt: skip
    states = box.sample(20_000, 1)
    assert (policy(states) == scores(states).argmax(axis=1)).mean() > 0.999
    policy.save(tmp_path / "it.cap")
    assert (Policy.load(tmp_path / "it.cap")(states) == policy(states)).all()


# Points


@settings(max_examples=60)
@given(
    sizes=st.tuples(st.integers(1, 40), st.integers(0, 40)),
    seed=st.integers(0, 1000),
    chunk=st.integers(1, 12),
    shape=st.sampled_from([(), (2,)]),
)
def test_inserting_in_place_is_inserting(sizes, seed, chunk, shape):
    rng = np.random.default_rng(seed)
    array = rng.integers(0, 99, (sizes[0], *shape))
    values = rng.integers(0, 99, (sizes[1], *shape))
    places = np.sort(rng.integers(0, sizes[0], sizes[1]))
    expected = np.insert(array, places, values, axis=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lattice_points, "MERGED", chunk)
        inserted(array, places, values)
    assert np.array_equal(array, expected)


def test_inserting_takes_no_second_array():
    array, values = np.arange(0, 8_000_000, 2), np.arange(1, 400_000, 2)
    places = np.searchsorted(array, values)
    tracemalloc.start()
    try:
        inserted(array, places, values)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert (np.diff(array) > 0).all() and len(array) == 4_200_000
    assert peak < array.nbytes + 8 * (4 * lattice_points.MERGED + len(values))


def test_limits_are_checked_and_kept():
    limits = Limits.of(5, 2, "1KB", 10**6)
    assert limits == Limits(5, 2.0, 1000, 10**6) and Limits.of(None, None, None, None) == Limits()
