"""Subdivision with affine leaves: what is accepted, what it costs, and that nothing else counts."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn import Box, Policy, SsacSettings, agreement, problems, subdivide, synthesize
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError, SynthesisError
from capsyn.modelling.grid import Grid
from capsyn.subdivision.affine_fit import _used, fit_cells, point_weights
from capsyn.subdivision.cell_points import CellPoints
from capsyn.subdivision.growing_cells import row_grid


def waves(n, symbols, seed, curvature=0.6):
    """Return smooth scores of `symbols` on the unit cube of `n` axes."""
    rng = np.random.default_rng([n, symbols, seed])
    slopes, offsets = rng.normal(size=(symbols, n)), rng.normal(size=symbols)
    turns = rng.normal(size=(symbols, n))

    def scores(states):
        bent = np.sin(3 * states @ turns.T + offsets)
        return (states - 0.5) @ slopes.T + 0.1 * offsets + curvature * bent

    return scores


def unit_box(n):
    return Box([0.0] * n, [1.0] * n)


def recorded(scores):
    """Return the scoring function, and the list of the batches that it is given."""
    asked = []

    def label(states):
        asked.append(states.copy())
        return scores(states)

    return label, asked


def share_of(policy, scores, count=40_000):
    states = policy.domain.sample(count, 9)
    return float((policy(states) == scores(states).argmax(axis=1)).mean())


def leaf_tests(policy):
    """Yield (entry, states, lattice steps) of the vertices and the centre of each leaf cell."""
    tree = policy.cells
    n, counts = tree.n, np.array(tree.counts)
    for leaves in tree.leaves():
        for entry, lower, size in zip(*leaves[1:]):
            places = [np.array(p) for p in itertools.product((0, 1), repeat=n)] + [np.full(n, 0.5)]
            fractions = (lower + np.array(places) * size) / counts
            states = policy.domain.lower + fractions * policy.domain.widths
            steps = lower + np.minimum(np.array(places) * size, size - 1).astype(int)
            yield entry, states, steps


@settings(max_examples=40)
@given(
    st.integers(1, 3),
    st.integers(2, 5),
    st.integers(0, 99),
    st.integers(1, 3),
    st.booleans(),
    st.sampled_from([0.05, 1.0]),
    st.sampled_from(["isotropic", "adaptive"]),
)
def test_accepted_leaves_are_right_at_all_their_test_points(
    n, symbols, seed, partitions, plain, leaf_error, refine
):
    scores = waves(n, symbols, seed)

    def label(states):
        return scores(states).argmax(axis=1) if plain else scores(states)

    policy = subdivide(
        label,
        unit_box(n),
        symbols,
        partitions=partitions,
        max_level=5 - n,
        leaves="affine",
        leaf_error=leaf_error,
        refine=refine,
        returns="symbols" if plain else "scores",
    )
    tree, mixed = policy.cells, set(policy.cells.mixed_cells.tolist())
    finest = [x.places[(x.sizes == tree.sizes(5 - n)).all(axis=1)] for x in tree.leaves()]
    assert mixed <= set(np.concatenate(finest).tolist())
    tested = 0
    for entry, states, steps in leaf_tests(policy):
        if entry not in mixed:
            found = tree.labels_in(np.full(len(steps), entry), steps)
            assert np.array_equal(found, scores(states).argmax(axis=1))
            tested += 1
    assert tested + len(mixed) == tree.leaf_count
    statistics = policy.statistics
    assert statistics["cells"] == tree.leaf_count == sum(statistics["leaves_by_level"])
    assert statistics["mixed_cells"] == len(mixed)
    assert sum(statistics["solves_by_role"].values()) == statistics["solves"]
    assert sum(level["solves"] for level in statistics["levels"]) == statistics["solves"]


def test_random_test_points_are_judged_where_they_lie():
    box = Box([0.0, 0.0], [1.0, 1.0], periodic=[True, False])

    def scores(states):
        angle = 2 * np.pi * states[:, 0]
        bent = np.stack([np.sin(angle), np.cos(angle), states[:, 1] - 0.5], axis=1)
        return bent + 0.3 * np.sin(9 * states[:, 1:] * np.arange(3))

    label, asked = recorded(scores)
    options = {"partitions": 6, "max_level": 0, "leaves": "affine", "returns": "scores"}
    policy = subdivide(label, box, 3, test_points="vertices+center+random:6", **options)
    points = np.concatenate(asked)
    inside = points[(points * 6 % 1 != 0).all(axis=1)]
    assert len(inside) > 36 * 6
    entries = policy.cells.find(box.locate(inside, policy.cells.counts))
    wrong = policy(inside) != scores(inside).argmax(axis=1)
    mixed = set(policy.cells.mixed_cells.tolist())
    assert wrong.any() and set(entries[wrong].tolist()) <= mixed
    fewer = subdivide(scores, box, 3, **options).cells.mixed_cells.tolist()
    assert set(fewer) < mixed  # random points see more


def test_a_tie_hides_no_surface():
    def scores(states):
        wave = np.round(np.sin(2 * np.pi * states[:, 0]), 9)  # ties at 0, 1 / 2 and 1
        return np.stack([wave, 0 * wave], axis=1)

    for budget in (None, 40):
        policy = subdivide(
            scores, unit_box(1), 2, partitions=1, max_level=3, leaves="affine", returns="scores",
            max_solves=budget,
        )  # fmt: skip
        assert policy.statistics["solves_by_role"]["quarter"] >= 2
        assert policy([[0.2], [0.4], [0.6], [0.9]]).tolist() == [0, 0, 1, 1]


def test_flat_surfaces_are_not_refined():
    scores = waves(4, 3, 1, curvature=0.0)
    policy = subdivide(
        scores, unit_box(4), 3, partitions=2, max_level=4, leaves="affine", returns="scores"
    )
    assert policy.statistics["leaves_by_level"] == [16]
    assert policy.statistics["solves"] == 3**4 + 2**4
    assert share_of(policy, scores) > 0.9995  # the lattice has 16,384 steps along an axis


def test_affine_leaves_beat_constant_ones_of_the_same_cells():
    scores = waves(3, 4, 5)
    kinds = {}
    for leaves in ("constant", "affine"):
        kinds[leaves] = subdivide(
            scores, unit_box(3), 4, partitions=3, max_level=2, leaves=leaves, returns="scores"
        )
    constant, affine = kinds["constant"], kinds["affine"]
    assert affine.statistics["solves"] <= constant.statistics["solves"]
    assert 1 - share_of(affine, scores) < 0.1 * (1 - share_of(constant, scores))
    labels = subdivide(
        lambda x: scores(x).argmax(axis=1),
        unit_box(3),
        4,
        partitions=3,
        max_level=2,
        leaves="affine",
    )
    assert 1 - share_of(labels, scores) < 0.7 * (1 - share_of(constant, scores))


def test_every_point_is_solved_once_and_a_budget_is_kept():
    scores = waves(3, 3, 8)
    shares = []
    for budget in (64, 400, 1500, 6000):
        label, asked = recorded(scores)

        policy = subdivide(
            label,
            unit_box(3),
            3,
            partitions=3,
            max_level=4,
            leaves="affine",
            returns="scores",
            max_solves=budget + 27,
        )
        points = np.concatenate(asked)
        assert len(np.unique(points, axis=0)) == len(points) == policy.statistics["solves"]
        assert len(points) <= budget + 27 and policy.statistics["stopped_by_max_solves"]
        assert budget == 64 or len(points) > 0.9 * budget
        shares.append(share_of(policy, scores))
    assert shares == sorted(shares) and shares[-1] > 0.998
    with pytest.raises(ProblemError, match="`max_solves` must be at least the 91 solves"):
        subdivide(
            scores, unit_box(3), 3, partitions=3, leaves="affine", returns="scores", max_solves=90
        )


def test_progress_of_a_budget_is_one_count():
    scores, seen = waves(3, 3, 8), []
    options = {"partitions": 3, "max_level": 3, "leaves": "affine", "returns": "scores"}
    policy = subdivide(
        scores, unit_box(3), 3, **options, max_solves=3000, progress=seen.append, threads=2
    )
    assert {(p.level, p.max_level, p.solves) for p in seen} == {(3, 3, 3000)}
    solved = [p.solved for p in seen]
    assert solved == sorted(solved) and solved[-1] == seen[-1].total
    assert solved[-1] == policy.statistics["solves"]
    seen.clear()
    subdivide(scores, unit_box(3), 3, **options, progress=seen.append)
    assert [p.level for p in seen] == sorted(p.level for p in seen)
    assert all(p.solved <= p.solves for p in seen)


def test_a_budget_goes_where_surfaces_bend():
    def scores(states):
        bend = np.where(states[:, 0] < 0.5, 0.3 * np.sin(12 * states[:, 0]), 0.0)
        return np.stack([states[:, 1] - 0.52 - bend, np.zeros(len(states))], axis=1)

    policy = subdivide(
        scores, unit_box(2), 2, partitions=4, max_level=5, leaves="affine", returns="scores",
        max_solves=300,
    )  # fmt: skip
    deepest = {False: 0, True: 0}
    for leaves in policy.cells.leaves():
        for lower in leaves.lower:
            flat = bool(lower[0] >= policy.cells.counts[0] // 2)
            deepest[flat] = max(deepest[flat], leaves.level)
    assert deepest[True] == 0 and deepest[False] == 5


@pytest.mark.parametrize("options", [{}, {"max_solves": 2500}, {"test_points": "center+faces"}])
@pytest.mark.parametrize("name", ["cart-pole", "double-tank-a"])
def test_bytes_do_not_depend_on_threads(name, options, tmp_path):
    files = []
    for threads in (1, 3):
        policy = synthesize(
            problems.plain(name), leaves="affine", max_level=2, threads=threads, **options
        )
        policy.save(tmp_path / f"{threads}.cap")
        files.append((tmp_path / f"{threads}.cap").read_bytes())
    assert files[0] == files[1]
    assert Policy.load(tmp_path / "1.cap").statistics["leaves"] == "affine"


def test_rounds_do_not_matter_without_a_budget(monkeypatch, tmp_path):
    def bytes_of(name):
        policy = synthesize(problems.plain("cart-pole"), leaves="affine", max_level=2)
        policy.save(tmp_path / name)
        return (tmp_path / name).read_bytes()

    whole = bytes_of("whole.cap")
    monkeypatch.setattr("capsyn.subdivision.rounds.ROUND_POINTS", 5_000)
    monkeypatch.setattr("capsyn.subdivision.rounds.CHUNK_SCORES", 3_000)
    assert bytes_of("rounds.cap") == whole


@pytest.mark.parametrize(
    ("name", "options", "solves", "leaves", "share"),
    [
        ("cart-pendulum", {"max_level": 4}, 4000, 2000, 0.999),
        ("cart-pole", {"max_level": 0}, 1200, 300, 0.994),
        ("cart-pole", {"max_level": 3, "max_solves": 15_000}, 15_000, 10_000, 0.9985),
        ("planar-quadrotor", {"max_level": 0}, 6000, 729, 0.985),
        ("spacecraft", {"max_level": 0}, 6000, 729, 0.95),
        ("boost-converter", {}, 500, 300, 0.999),
    ],
)
def test_agreement_with_the_controller(name, options, solves, leaves, share):
    policy = synthesize(problems.plain(name), leaves="affine", **options)
    assert policy.statistics["solves"] <= solves and policy.statistics["cells"] <= leaves
    found = agreement(policy, states=50_000)
    assert found.share >= share
    policy.with_evidence(agreement=found.to_json())  # whole numbers and shares that make sense


@pytest.mark.parametrize("settings", [
    SsacSettings(gamma=-5.0),
    SsacSettings(gamma=-1.0, control_weight=0.01),
    SsacSettings(alpha_d=0.0),
    SsacSettings(rule="steepest", control_weight=0.02),
    SsacSettings(gamma=-5.0, on_no_descent="default"),
    SsacSettings(rule="steepest", on_no_descent="default"),
])  # fmt: skip
@pytest.mark.parametrize("name", ["cart-pendulum-4", "double-tank-a", "cart-pole"])
def test_smooth_scores_order_symbols_as_the_controller_does(name, settings):
    policy = synthesize(problems.plain(name).replace(settings=settings), max_level=0)
    controller = policy_controller(policy)
    states = policy.domain.sample(20_000, 3)
    masks, scores = controller.scored(states)
    assert np.array_equal(masks, controller.masks(states))
    assert np.isfinite(scores).all() and scores.shape[0] == len(states)
    best = scores[:, 0].argmax(axis=1).astype(np.uint64)
    assert (masks[:, 0] >> best & np.uint64(1)).all()


def test_no_descent_may_be_the_default_in_affine_leaves():
    problem = problems.plain("double-tank-a")
    settings = dataclasses.replace(problem.settings, on_no_descent="default")
    policy = synthesize(problem.replace(settings=settings), leaves="affine", max_level=3)
    assert agreement(policy, states=20_000).share > 0.99


def test_states_without_an_answer_take_the_default():
    scores = waves(2, 2, 3)

    def label(states):
        found = scores(states)
        found[(states < 0.05).all(axis=1)] = np.nan
        return found

    policy = subdivide(
        label, unit_box(2), 2, partitions=20, max_level=1, leaves="affine", returns="scores"
    )
    assert 0 < policy.statistics["not_finite_points"] < 0.05 * policy.statistics["solves"]
    assert policy([0.01, 0.01]) == -1 and policy([0.5, 0.5]) >= 0
    with pytest.raises(SynthesisError, match="no finite result"):
        subdivide(lambda x: scores(x) * np.nan, unit_box(2), 2, leaves="affine", returns="scores")


@pytest.mark.parametrize("size", [1e-300, 1e300, 0.0])
def test_scores_of_any_size_give_a_policy(size):
    scores = waves(2, 3, 4)
    policy = subdivide(
        lambda x: scores(x) * size,
        unit_box(2),
        3,
        partitions=3,
        max_level=2,
        leaves="affine",
        returns="scores",
    )
    assert share_of(policy, scores, 2000) > (0.2 if size == 0 else 0.97)


def test_seven_axes_without_vertices():
    scores = waves(7, 3, 2, curvature=0.2)
    shares = {}
    for points in ("center+faces", "center+faces+random:8"):
        label, asked = recorded(scores)

        policy = subdivide(
            label,
            unit_box(7),
            3,
            partitions=2,
            max_level=0,
            leaves="affine",
            test_points=points,
            returns="scores",
        )
        points_asked = np.concatenate(asked)
        assert len(np.unique(points_asked, axis=0)) == len(points_asked)
        shares[points] = share_of(policy, scores)
        faces = 7 * 3 * 2**6
        assert len(points_asked) == 2**7 + faces + 8 * 2**7 * ("random" in points)
    assert min(shares.values()) > 0.95


def one_cell(scores, offsets, size=16):
    """Fit one cell, the unit square of a lattice of 64 x 64 steps from its (16, 32)."""
    n = offsets.shape[1]
    places = np.minimum(offsets * (size // 2), size - 1)[:, None, :]
    masks = np.uint64(1) << scores.argmax(axis=1).astype(np.uint64)
    return fit_cells(
        scores[:, None, None, :],
        masks[:, None, None, None],
        offsets,
        places,
        np.full((1, n), 16),
        np.full((1, n), size),
        (64,) * n,
    )


@given(st.integers(0, 500), st.integers(2, 5))
@settings(max_examples=60)
def test_rows_that_are_left_out_are_largest_nowhere(seed, symbols):
    rng = np.random.default_rng(seed)
    offsets = CellPoints().offsets(2)
    scores = rng.normal(size=(symbols, 3)) @ np.vstack([np.ones(5), (offsets - 1).T])
    fits = one_cell(scores.T, offsets)
    steps = np.stack(np.meshgrid(np.arange(16, 32), np.arange(16, 32)), -1).reshape(-1, 2)
    values = fits.constants[0] + steps @ fits.slopes[0].T
    best = values.argmax(axis=1)
    assert fits.used[0, best].all()


@given(st.integers(0, 500), st.integers(2, 5))
def test_used_rows_are_those_that_no_other_beats_everywhere(seed, symbols):
    rng = np.random.default_rng(seed)
    constants = rng.integers(-4, 5, (1, symbols))
    slopes = rng.integers(-2, 3, (1, symbols, 2))
    corner, size = rng.integers(0, 9, (1, 2)), np.array([[3, 4]])
    steps = corner + np.stack(np.meshgrid(np.arange(3), np.arange(4)), -1).reshape(-1, 2)
    values = constants[0] + steps @ slopes[0].T
    expected = [
        not any((values[:, j] >= values[:, i] + (j > i)).all() for j in range(symbols) if j != i)
        for i in range(symbols)
    ]
    none = np.zeros((1, symbols), dtype=np.int64)
    used = _used(constants, slopes, corner, size, none[:, 0], none)
    assert used.tolist() == [expected] and used[0, values.argmax(axis=1)].all()


def test_weights_see_the_mean_of_a_square():
    offsets = CellPoints().offsets(3)
    weights = point_weights(offsets)
    assert np.isclose(weights.sum(), 1) and weights[-1] == 0.5
    assert (point_weights(offsets, plain=True) == 1 / 9).all()


def test_lattice_levels_of_rows():
    assert row_grid(Grid((9,), (2,), 4)).max_level == 10  # 9 * 2^10 = 9,216 of 16,384 steps
    assert row_grid(Grid((3,) * 6, (2,) * 6, 1)).max_level == 12
    assert row_grid(Grid((100, 3), (2, 2), 1)).max_level == 11  # 204,800 and 6,144
    assert row_grid(Grid((1000,), (2,), 10)).max_level == 13  # eight steps along a finest cell
    assert row_grid(Grid((5,), (100,), 2)).max_level == 3
    assert row_grid(Grid((1,), (2,), 22)).max_level == 25
    too_high = "^`max_level` {} is too high for affine leaves: {}$"
    for partitions, level, fits in (((1,), 30, 22), ((1,), 23, 22), ((1, 1), 22, 21)):
        with pytest.raises(ProblemError, match=too_high.format(level, f"max_level <= {fits} fits")):
            row_grid(Grid(partitions, (2,) * len(partitions), level))
        assert row_grid(Grid(partitions, (2,) * len(partitions), fits)).max_level == fits + 3
    with pytest.raises(ProblemError, match=too_high.format(0, "use fewer partitions")):
        row_grid(Grid((2**30,), (2,), 0))


@pytest.mark.parametrize("level", [8, 20])
def test_rows_follow_a_surface_at_any_level_that_is_allowed(level):
    def scores(states):
        height = states[:, 0] + 0.37 * states[:, 1] - 0.4 + 0.2 * states[:, 1] ** 2
        return np.stack([np.zeros(len(states)), height], axis=1)

    def run(level):
        return subdivide(
            scores, Box([0, 0], [1, 1]), 2, leaves="affine", returns="scores", partitions=3,
            max_level=level, max_solves=2000,
        )  # fmt: skip

    states = np.random.default_rng(0).random((50_000, 2))
    assert (run(level)(states) != scores(states).argmax(axis=1)).mean() < 2e-4
    with pytest.raises(ProblemError, match="too high for affine leaves: max_level <= 20 fits"):
        run(21)


@pytest.mark.parametrize(
    ("returns", "label", "message"),
    [
        ("scores", lambda x: np.zeros(len(x)), r"scores, or with the default's last"),
        ("scores", lambda x: np.zeros((len(x), 4)), r"scores, or with the default's last"),
        ("scores", lambda x: np.zeros((len(x), 2), dtype=int), "int64 of shape"),
        ("masks+scores", lambda x: np.ones(len(x), dtype=np.uint64), "a pair of masks and scores"),
        ("masks+scores", lambda x: (np.ones(len(x)), np.zeros((len(x), 2))), "unsigned integers"),
    ],
)
@pytest.mark.parametrize("leaves", ["constant", "affine"])
def test_wrong_scores_are_one_line(returns, label, message, leaves):
    with pytest.raises(ProblemError, match=message) as caught:
        subdivide(label, unit_box(2), 2, returns=returns, leaves=leaves)
    assert "\n" not in str(caught.value)
