"""Algorithm 1 against a reference of plain recursion; what is solved; what comes out."""

import itertools
import math
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn import Alphabet, Box, problems, subdivide, synthesize
from capsyn.errors import ProblemError, SynthesisError
from capsyn.modelling.grid import Grid
from capsyn.subdivision import lattice_points
from capsyn.subdivision.cell_points import CellPoints
from capsyn.subdivision.propositions import worst_case_solves
from support.labels import disc, halves, noisy_masks, planar_masks, recorder, same, unit_box
from support.references.subdivision import cells_of, reference

FIXED_POINTS = [
    "vertices",
    "vertices+center",
    "vertices+edge_midpoints",
    "vertices+center+edge_midpoints",
]


# Labelling functions. All are exact and elementwise, so that no batch can change a label.


def assert_equals_reference(label, box, n_symbols, q, r, max_level, points, order, max_solves=None):
    policy = subdivide(
        label,
        box,
        n_symbols,
        partitions=q,
        refinement=r,
        max_level=max_level,
        test_points=points,
        returns="masks",
        preference=order,
        max_solves=max_solves,
    )
    expected = reference(label, box, q, r, max_level, points, order)
    leaves, mixed = cells_of(policy)
    assert leaves == expected.leaves
    assert mixed == expected.mixed
    policy.cells.check(n_symbols + 1)
    statistics = policy.statistics
    assert statistics["solves"] == len(expected.masks)
    assert statistics["indifferent_points"] == sum(m & (m - 1) > 0 for m in expected.masks.values())
    return policy


# Against the reference


@st.composite
def cases(draw):
    n = draw(st.integers(1, 3))
    each = {"min_size": n, "max_size": n}
    q = tuple(draw(st.lists(st.integers(1, 4), **each)))
    r = tuple(draw(st.lists(st.integers(2, 3), **each)))
    points = draw(st.sampled_from(FIXED_POINTS))
    interior = CellPoints.parse(points).interior(n)
    fits = [k for k in range(5) if k == 0 or worst_case_solves(Grid(q, r, k), interior) <= 1500]
    lower = draw(st.lists(st.floats(-10, 10), **each))
    widths = draw(st.lists(st.floats(0.01, 10), **each))
    upper = [low + width for low, width in zip(lower, widths)]
    box = Box(lower, upper, periodic=draw(st.lists(st.booleans(), **each)))
    n_symbols = draw(st.integers(1, 5))
    seed = draw(st.integers(0, 2**32))
    if draw(st.booleans()):
        width = draw(st.sampled_from([0.0, 0.05, 0.3]))
        label = planar_masks(box, seed, n_symbols, width)
    else:
        label = noisy_masks(seed, n_symbols, draw(st.integers(0, 2)))
    order = draw(st.permutations(range(n_symbols + 1)))
    return label, box, n_symbols, q, r, draw(st.sampled_from(fits)), points, order


@settings(max_examples=100, deadline=None)
@given(cases())
def test_equals_the_reference_cell_by_cell(case):
    assert_equals_reference(*case)


@pytest.mark.parametrize("points", FIXED_POINTS)
@pytest.mark.parametrize(("n", "refinement"), [(1, (3,)), (2, (2, 3)), (3, (2, 2, 3))])
def test_many_ties_above_the_finest_level(n, refinement, points):
    grid = ((5, 4, 2)[:n], refinement, 1, points, [1, 0])
    policy = assert_equals_reference(noisy_masks(8, 1, 2), unit_box(n), 1, *grid)
    assert policy.statistics["solves_by_role"]["quarter"] > 0


@pytest.mark.parametrize("n_symbols", [7, 8, 15, 16, 31, 32, 62, 63, 130])
@pytest.mark.parametrize("ties", [0, 2])
def test_sets_of_many_symbols(n_symbols, ties):
    order = list(range(n_symbols, -1, -1))
    policy = assert_equals_reference(
        noisy_masks(5, n_symbols, ties),
        unit_box(),
        n_symbols,
        (4, 4),
        (2, 3),
        1,
        "vertices+center",
        order,
    )
    top = min(n_symbols, 64)  # the highest bit, or one of the second word, got through
    assert (policy.cells.entries <= -1 - top).any()
    assert policy(unit_box().sample(500)).min() == -1 or n_symbols > 64


def test_lattice_of_more_points_than_words_for_sorting():
    def label(states):  # one corner is unlike the rest: few cells, but many levels
        return np.where((states < 1e-9).all(axis=1), np.uint64(1), np.uint64(2))

    policy = assert_equals_reference(
        label, unit_box(), 2, (3, 3), (2, 2), 26, "vertices+center", [0, 1, 2], max_solves=10**4
    )
    assert policy.statistics["leaves_by_level"] == [8] + [3] * 25 + [4]


def test_tie_does_not_hide_a_switching_surface():
    def label(states):  # ties on the line x2 = 1/2 and on the outer vertices of a 1 x 2 grid
        x, y = states.T
        tied = (y == 0.5) | (x == 0.0) | (x == 1.0)
        return np.where(tied, 3, np.where(y > 0.5, 2, 1)).astype(np.uint64)

    policy = subdivide(
        label, unit_box(), 2, partitions=1, max_level=1, test_points="vertices", returns="masks"
    )
    assert policy.statistics["solves_by_role"]["quarter"] == 4
    assert policy([[0.3, 0.2], [0.3, 0.8], [0.8, 0.4], [0.8, 0.6]]).tolist() == [0, 1, 0, 1]


def test_symbols_and_single_bit_masks_are_the_same():
    def masks(states):
        symbols = disc(states)
        return np.uint64(1) << np.where(symbols < 0, 3, symbols).astype(np.uint64)

    symbols = subdivide(disc, unit_box(), 3, max_level=3)
    assert same(symbols, subdivide(masks, unit_box(), 3, max_level=3, returns="masks"))
    assert np.unique(symbols(unit_box().sample(2000))).tolist() == [-1, 0, 1, 2]


# What is solved, and how often


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("points", [*FIXED_POINTS, "vertices+center+edge_midpoints+random:2"])
@pytest.mark.parametrize("periodic", [None, [True, False, True]])
def test_every_point_is_solved_once(threads, points, periodic):
    label, batches = recorder(noisy_masks(1, 4, 2))
    policy = subdivide(
        label,
        unit_box(3, periodic),
        4,
        partitions=(2, 1, 3),
        refinement=(2, 3, 2),
        max_level=2,
        test_points=points,
        returns="masks",
        threads=threads,
    )
    states = np.vstack(batches)
    assert len(np.unique(states, axis=0)) == len(states) == policy.statistics["solves"]
    assert sum(policy.statistics["solves_by_role"].values()) == len(states)
    if periodic:  # upper is lower there, and only lower is asked for
        assert not (states[:, [0, 2]] == 1.0).any() and (states[:, 1] == 1.0).any()


def test_uniform_label_gives_the_root_grid_only():
    policy = subdivide(lambda x: np.full(len(x), 1), unit_box(), 2, partitions=(9, 7))
    assert policy.cells.entries.tolist() == [-2] * 63
    assert policy.statistics["solves"] == 10 * 8 + 63
    assert policy.statistics["solves_by_role"]["vertices"] == 10 * 8
    assert policy.statistics["leaves_by_level"] == [63]
    assert policy.cells.mixed_cells.size == 0


def test_random_points_lie_inside_their_cells():
    label, batches = recorder(lambda x: np.zeros(len(x), dtype=int))
    box = Box([-1.0, 2.0], [1.0, 5.0])
    grid = {"partitions": (4, 5), "test_points": "vertices+random:3"}
    for max_level, seed in [(9, 4), (0, 4), (0, 5), (0, 6)]:
        batches.clear()
        subdivide(label, box, 1, max_level=max_level, seed=seed, **grid)
        place = (np.vstack(batches) - box.lower) / box.widths * [4, 5]
        on_face = np.abs(place - np.rint(place)) < 1e-6
        vertex = on_face.all(axis=1)
        assert (vertex == on_face.any(axis=1)).all() and vertex.sum() == 5 * 6
        cells, counts = np.unique(np.floor(place[~vertex]), axis=0, return_counts=True)
        assert len(cells) == 20 and counts.max() == 3
        assert counts.min() == 3 or max_level == 0  # few places to draw from: some are the same


# Independence of how it is run


@pytest.mark.parametrize("points", ["vertices+center", "vertices+edge_midpoints+random:2"])
def test_threads_and_batches_do_not_matter(monkeypatch, points):
    label = noisy_masks(3, 4, 1)

    def run(threads):
        return subdivide(
            label,
            unit_box(3, [True, False, False]),
            4,
            partitions=(3, 2, 3),
            max_level=2,
            test_points=points,
            returns="masks",
            threads=threads,
        )

    first = run(1)
    assert first.statistics["solves"] > 2000
    assert same(run(2), first) and same(run(4), first)
    for chunk in (23, 1000, 10**9):
        monkeypatch.setattr(lattice_points, "CHUNK", chunk)
        assert same(run(1), first) and same(run(4), first)


def test_seed_decides_the_random_points():
    def run(seed, threads=1):
        label, batches = recorder(disc)
        options = {"partitions": 4, "max_level": 3, "test_points": "vertices+random:2"}
        policy = subdivide(label, unit_box(), 3, seed=seed, threads=threads, **options)
        return policy, {tuple(state) for state in np.vstack(batches).tolist()}

    first, asked = run(7)
    for again, asked_again in (run(7), run(7, threads=4)):
        assert same(again, first) and asked_again == asked
    other, asked_other = run(8)
    assert not same(other, first)
    assert len(asked & asked_other) < 0.6 * len(asked)


def test_scaling_a_state_leaves_the_cells():
    scale, shift = np.array([2.0**9, 2.0**-12]), np.array([0.0, 0.25])
    box = Box(shift * scale, (shift + 1) * scale)
    scaled = subdivide(lambda x: disc(x / scale - shift), box, 3)
    plain = subdivide(lambda x: disc(x - shift), Box(shift, shift + 1), 3)
    assert same(scaled, plain)
    assert len(plain.cells.entries) > 500


# What comes out


def test_statistics_agree_with_the_cells():
    label = noisy_masks(9, 3, 1)
    policy = subdivide(label, unit_box(), 3, partitions=3, max_level=3, returns="masks")
    statistics, tree = policy.statistics, policy.cells
    leaves = [len(part.places) for part in tree.leaves()]
    assert statistics["leaves_by_level"] == leaves
    assert statistics["cells"] == tree.leaf_count == sum(leaves)
    assert statistics["mixed_cells"] == len(tree.mixed_cells)
    levels = statistics["levels"]
    for above, below in itertools.pairwise(levels):
        assert below["cells"] == 4 * above["mixed"]
    quarter = statistics["solves_by_role"]["quarter"]
    assert sum(level["solves"] for level in levels) + quarter == statistics["solves"]
    assert [level["cells"] - level["mixed"] for level in levels[:-1]] == leaves[:-1]
    assert math.isclose(policy.volume_shares.sum(), 1.0)
    assert math.isclose(policy.mixed_share, len(tree.mixed_cells) / (9 * 4**3))


def test_mixed_cells_are_leaves_that_carry_the_labels_seen():
    policy = subdivide(disc, unit_box(), 3, partitions=5, max_level=3, test_points="vertices")
    tree = policy.cells
    seen = dict(zip(tree.mixed_cells.tolist(), tree.mixed_labels[:, 0, 0].tolist()))
    checked = 0
    for part in tree.leaves():
        size = tree.sizes(part.level)
        for entry, lower, label in zip(
            part.places.tolist(), part.lower, tree.labels_at(part.places).tolist()
        ):
            corners = lower + size * np.array(list(itertools.product((0, 1), repeat=2)))
            found = disc(tree_states(policy, corners)) % 4  # -1 is leaf number 3
            assert seen.get(entry, 1 << label) == sum(1 << int(s) for s in set(found))
            assert seen.get(entry, 1 << label) >> label & 1
            assert entry not in seen or part.level == tree.max_level
            checked += 1
    assert checked == tree.leaf_count and len(seen) > 50


def tree_states(policy, coordinates):
    return policy.domain.points(coordinates, policy.cells.counts)


def test_preference_breaks_ties():
    def label(states):
        return np.full(len(states), 0b1101, dtype=np.uint64)

    for order, expected in [([1, 2, 0, 3], 2), ([3, 1, 2, 0], -1), (None, 0)]:
        policy = subdivide(label, unit_box(), 3, returns="masks", preference=order)
        assert (policy(unit_box().sample(10)) == expected).all()


def test_arguments_reach_the_policy():
    alphabet = Alphabet([[1.0, 0.0], [0.0, 1.0]], names=["a", "b"])
    policy = subdivide(
        halves, unit_box(), alphabet, outside="b", name="mine", partitions=(3, 2), refinement=(2, 3)
    )
    assert policy.alphabet == alphabet and policy.name == "mine"
    assert policy([7.0, 7.0]) == 1 and policy.control([0.9, 0.9]).tolist() == [0.0, 1.0]
    assert (policy.cells.partitions, policy.cells.refinement) == ((3, 2), (2, 3))
    assert set(policy.timings) == {"label", "subdivide"}


# A bound on the solves


@pytest.mark.parametrize("ties", [False, True])
def test_max_solves_stops_at_a_whole_level(ties):
    label = planar_masks(unit_box(), 11, 3, 0.004 if ties else 0.0)
    order = [2, 0, 1, 3]

    def run(**options):
        return subdivide(
            label, unit_box(), 3, partitions=5, returns="masks", preference=order, **options
        )

    whole = run(max_level=5)
    everything = whole.statistics["solves"]
    assert (whole.statistics["solves_by_role"]["quarter"] > 20) == ties
    levels = set()
    for budget in range(61, everything + 60, 37):
        policy = run(max_level=5, max_solves=budget)
        statistics = policy.statistics
        policy.cells.check(4)
        assert statistics["solves"] <= budget
        assert statistics["stopped_by_max_solves"] == (statistics["solves"] < everything)
        level = len(statistics["levels"]) - 1
        levels.add(level)
        coarse = run(max_level=level)  # the levels above the last one are those of any run
        leaves, coarse_leaves = cells_of(policy)[0], cells_of(coarse)[0]
        above = {cell for cell in leaves if cell[0] < level}
        assert above == {cell for cell in coarse_leaves if cell[0] < level}
        assert all(leaves[cell] == coarse_leaves[cell] for cell in above)
        assert leaves.keys() == coarse_leaves.keys()
        if not ties:
            assert leaves == coarse_leaves
    assert levels == set(range(6))
    assert same(policy, whole)


def test_a_wrong_leaf_error_is_told_before_memory():
    for function in (
        lambda **k: subdivide(halves, unit_box(), 2, **k),
        lambda **k: synthesize(problems.plain("cart-pendulum"), **k),
    ):
        for wrong in (2, -1, "x", np.nan):
            with pytest.raises(ProblemError, match="^`leaf_error` must be "):
                function(leaf_error=wrong, max_level=20, memory_limit=1000)


def test_max_solves_below_the_root_grid_is_refused_before_any_work():
    label, batches = recorder(halves)
    told = (
        r"^`max_solves` must be at least the 181 .*; got 180: use fewer partitions: 8 per axis fit"
    )
    for leaves in ("constant", "affine"):
        with pytest.raises(ProblemError, match=told):
            subdivide(label, unit_box(), 2, max_solves=180, leaves=leaves)
    with pytest.raises(ProblemError, match="; got 4: no root grid fits$"):
        subdivide(label, unit_box(), 2, max_solves=4)
    assert not batches
    assert subdivide(label, unit_box(), 2, max_solves=180, partitions=8).statistics["solves"] == 145
    batches.clear()
    policy = subdivide(label, unit_box(), 2, max_solves=181)
    assert policy.statistics["leaves_by_level"] == [81]


# Progress


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("width", [0.0, 0.1])
def test_progress_counts_every_solve(monkeypatch, threads, width):
    monkeypatch.setattr(lattice_points, "CHUNK", 40)
    reports, main = [], threading.get_ident()

    def progress(report):
        assert threading.get_ident() == main
        reports.append(report)

    label = planar_masks(unit_box(), 2, 3, width)
    policy = subdivide(
        label, unit_box(), 3, max_level=3, returns="masks", threads=threads, progress=progress
    )
    levels = policy.statistics["levels"]
    assert [r.level for r in reports] == sorted(r.level for r in reports)
    assert {r.level for r in reports} == set(range(len(levels)))
    assert all(r.max_level == 3 and r.cells == levels[r.level]["cells"] for r in reports)
    assert all(0 < r.solved <= r.solves for r in reports)
    totals = [r.total for r in reports]
    assert totals == sorted(set(totals)) and totals[-1] == policy.statistics["solves"]
    finished = [r for r in reports if r.solved == r.solves]
    assert sum(r.solves for r in finished) == policy.statistics["solves"]
    assert len(reports) >= policy.statistics["solves"] / 40


@pytest.mark.parametrize("threads", [1, 2])
def test_interrupt_in_progress_ends_the_run_at_once(monkeypatch, threads):
    monkeypatch.setattr(lattice_points, "CHUNK", 10)

    def slow(states):
        time.sleep(0.02)
        return halves(states)

    label, batches = recorder(slow)

    def progress(report):
        raise KeyboardInterrupt

    started = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        subdivide(label, unit_box(), 2, partitions=30, threads=threads, progress=progress)
    assert time.perf_counter() - started < 1.0  # all of level 0 would take 1.9 s or more
    asked = len(batches)
    time.sleep(0.1)
    assert len(batches) == asked < 30  # no thread goes on


# Labelling functions that fail


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("wrong", [2, -2, 10**9])
def test_label_out_of_range_names_the_state(wrong, threads):
    def label(states):
        return np.where((states == [0.5, 1.0]).all(axis=1), wrong, 0)

    with pytest.raises(ProblemError) as caught:
        subdivide(label, unit_box(), 2, partitions=4, threads=threads)
    message = str(caught.value)
    assert "\n" not in message and message.startswith("`label` ")
    assert f"-1 to 1; got {wrong} at state [0.5, 1.0]" in message


@pytest.mark.parametrize(
    "label",
    [
        lambda x: 0,
        lambda x: None,
        lambda x: np.zeros(1, dtype=int),
        lambda x: np.zeros((len(x), 1), dtype=int),
        lambda x: np.zeros(len(x)),
        lambda x: np.zeros(len(x), dtype=bool),
        lambda x: ["a"] * len(x),
    ],
)
@pytest.mark.parametrize("returns", ["symbols", "masks"])
def test_label_of_wrong_shape_or_type_is_refused(label, returns):
    with pytest.raises(ProblemError, match=r"^`label` must return \(181,\) .*; got ") as caught:
        subdivide(label, unit_box(), 2, returns=returns)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("wrong", [1 << 3, 1 << 8, 1 << 16, (1 << 63) + 1])
def test_mask_of_unknown_symbols_names_the_state(wrong):
    def label(states):
        corner = (states == [0.5, 1.0]).all(axis=1)
        return np.where(corner, np.uint64(wrong), np.uint64(1))

    with pytest.raises(ProblemError, match=r"^`label` .* at state \[0\.5, 1\.0\]$"):
        subdivide(label, unit_box(), 2, partitions=4, returns="masks")


def test_labels_may_be_any_integers():
    expected = subdivide(halves, unit_box(), 2)
    for convert in (np.int8, np.uint8, np.uint64):
        policy = subdivide(lambda x, to=convert: halves(x).astype(to), unit_box(), 2)
        assert same(policy, expected)
    assert same(subdivide(lambda x: halves(x).tolist(), unit_box(), 2), expected)


def test_exception_of_a_label_comes_through():
    def label(states):
        raise ZeroDivisionError("mine")

    for threads in (1, 2):
        with pytest.raises(ZeroDivisionError, match="mine"):
            subdivide(label, unit_box(), 2, threads=threads)


def test_points_without_an_answer_take_the_default():
    def label(states):
        answer = np.where(states[:, 0] > 0.4, 2, 1).astype(np.uint64)
        corner = (states[:, 0] > 0.93) & (states[:, 1] == 0.0)
        return np.where(corner, np.uint64(0), answer)

    policy = subdivide(label, unit_box(), 2, max_level=2, returns="masks")
    assert policy.statistics["not_finite_points"] == 3  # one at each level
    assert policy.statistics["not_finite_example"] == [1.0, 0.0]
    tree = policy.cells
    entry = tree.find(np.array([[35, 0]]))[0]  # the finest cell at that corner
    assert entry in tree.mixed_cells
    assert tree.mixed_labels[tree.mixed_cells.tolist().index(entry), 0, 0] == 0b110
    assert policy([1.0, 0.0]) == 1


@pytest.mark.parametrize("missing", [1, 2, 10])
def test_more_than_one_percent_without_an_answer_stops_the_run(missing):
    def label(states):
        lost = (states[:, 0] == 1.0) & (states[:, 1] < (missing - 0.5) / 9)
        return np.where(lost, 0, 1).astype(np.uint64)

    def run():
        return subdivide(label, unit_box(), 2, returns="masks", max_level=0)

    if missing == 1:
        assert run().statistics["not_finite_points"] == 1
        return
    message = rf"^{missing} of 181 solves .* at state \[1\.0, 0\.0\]"
    with pytest.raises(SynthesisError, match=message):
        run()


# Arguments


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("partitions", {"partitions": 0}),
        ("partitions", {"partitions": (3, 3, 3)}),
        ("partitions", {"partitions": 2.0}),
        ("refinement", {"refinement": 1}),
        ("max_level", {"max_level": -1}),
        ("max_level", {"max_level": 40}),
        ("test_points", {"test_points": "center"}),
        ("seed", {"seed": -1}),
        ("seed", {"seed": None}),
        ("returns", {"returns": "probabilities"}),
        ("leaves", {"leaves": "linear"}),
        ("leaf_error", {"leaf_error": 1.5}),
        ("preference", {"preference": [0, 1]}),
        ("preference", {"preference": [0, 1, 1]}),
        ("preference", {"preference": [0.5, 1, 2]}),
        ("preference", {"preference": "012"}),
        ("preference", {"preference": 3}),
        ("outside", {"outside": "no"}),
        ("outside", {"outside": 2}),
        ("max_solves", {"max_solves": 0}),
        ("max_solves", {"max_solves": 1e4}),
        ("max_seconds", {"max_seconds": 0.0}),
        ("max_seconds", {"max_seconds": "1"}),
        ("max_memory", {"max_memory": 0}),
        ("max_memory", {"max_memory": "much"}),
        ("max_memory", {"max_memory": 2000}),
        ("memory_limit", {"memory_limit": 1.5}),
        ("memory_limit", {"memory_limit": "-1GB"}),
        ("max_level", {"memory_limit": "20KB"}),
        ("threads", {"threads": 0}),
        ("symbols", {"symbols": 0}),
        ("symbols", {"symbols": 2.0}),
        ("alphabet", {"symbols": 4097}),
        ("domain", {"domain": [[0, 1], [0, 1]]}),
        ("label", {"label": 3}),
    ],
)
def test_bad_argument_is_one_line_that_names_it(name, options):
    label, batches = recorder(halves)
    arguments = {"label": label, "domain": unit_box(), "symbols": 2} | options
    with pytest.raises(ProblemError, match=f"`{name}` ") as caught:
        subdivide(**arguments)
    assert "\n" not in str(caught.value)
    assert not batches


def test_cells_finer_than_floating_point_are_refused():
    with pytest.raises(ProblemError, match="`max_level` is too high: axis 'far'"):
        subdivide(halves, Box([1e15], [1e15 + 10], names=["far"]), 2, partitions=3, max_level=5)
