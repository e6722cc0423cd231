"""Policies: one symbol for every state, on faces and seams too, whatever computes it."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import capsyn
from capsyn import Alphabet, Box
from capsyn.errors import CapsynWarning, KernelBuildError, OutsideDomainError, ProblemError
from capsyn.modelling.alphabet import check_outside
from capsyn.modelling.grid import Grid
from capsyn.policies import lookup
from support.backends import backends, needs_compiler
from support.trees import GRIDS, random_policy, states_at_faces

NAN, INF = float("nan"), float("inf")
HUGE = 1.7976931348623157e308


def disc(states):
    """Return 0 inside a disc, 1 and 2 left and right of it, -1 (the default) far above."""
    x, y = states.T
    sides = np.where(x < 0.1, 1, 2)
    return np.where(x**2 + y**2 < 1, 0, np.where(y > 1.5, -1, sides))


@pytest.fixture(scope="module")
def plane():
    """Two ordinary axes, three symbols and the default."""
    alphabet = Alphabet([[0, 1], [-5, 2], [5, 3]], names=["hold", "left", "right"])
    made = capsyn.subdivide(disc, Box([-2, -2], [2, 2]), alphabet, partitions=4, max_level=3)
    return dataclasses.replace(made, default=np.array([0.5, -0.5]))


@pytest.fixture(scope="module")
def cylinder():
    """A periodic axis and an ordinary one, unequal grids."""
    domain = Box([0, -5], [2 * np.pi, 5], periodic=[True, False])
    return capsyn.subdivide(
        lambda x: (np.sin(x[:, 0]) * x[:, 1] > 0).astype(int),
        domain,
        2,
        partitions=[9, 5],
        refinement=[2, 3],
        max_level=3,
    )


@backends
@pytest.mark.parametrize("shape", [(2,), (5, 2), (3, 4, 2), (0, 2), (3, 0, 2), (1, 1, 1, 2)])
def test_shapes(plane, backend, shape):
    states = plane.domain.sample(int(np.prod(shape[:-1])), seed=1).reshape(shape)
    symbols = plane(states, backend=backend)
    controls = plane.control(states)
    assert np.shape(symbols) == shape[:-1] and np.asarray(symbols).dtype == np.int32
    assert controls.shape == (*shape[:-1], 2)
    one_by_one = [plane(s) for s in states.reshape(-1, 2)]
    assert np.ravel(symbols).tolist() == one_by_one


def test_one_state_gives_a_number(plane):
    assert isinstance(plane([0.0, 0.0]), np.int32) and plane([0.0, 0.0]) == 0
    assert plane.alphabet.names[plane([1.5, 0.0])] == "right"


@pytest.mark.parametrize(
    ("states", "message"),
    [
        ([0.0, 0.0, 0.0], r"`states` must have shape \(\.\.\., 2\); got \(3,\)"),
        (np.zeros((2, 3)), r"`states` must have shape \(\.\.\., 2\); got \(2, 3\)"),
        (0.0, r"`states` must have shape \(\.\.\., 2\); got \(\)"),
        ([], r"`states` must have shape \(\.\.\., 2\); got \(0,\)"),
        (None, r"`states` must have shape \(\.\.\., 2\); got \(\)"),
        ([[0, 0], [0]], r"`states` must be numbers; got \[\[0, 0\], \[0\]\]"),
        (["0", "0"], r"`states` must be numbers; got \['0', '0'\]"),
        (np.zeros(2, complex), r"`states` must be numbers; got array"),
        ([10**400, 0], r"`states` must be numbers; got \[1000"),
    ],
)
def test_states_of_another_kind_are_refused(plane, states, message):
    with pytest.raises(ProblemError, match="^" + message):
        plane(states)


@backends
def test_any_memory_layout_and_real_type(plane, backend):
    grid = np.arange(-2, 3)
    states = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    wanted = plane(states.astype(float), backend="numpy")
    wide = np.full((len(states) * 2, 4), NAN)
    wide[::2, 1::2] = states
    layouts = [
        states.astype(np.int64),
        states.astype(np.int8),
        states.astype(np.float32),
        states.astype(np.float16),
        states.astype(">f8"),
        np.asfortranarray(states.astype(float)),
        wide[::2, 1::2],
        states.astype(float)[::-1][::-1],
        states.tolist(),
        tuple(map(tuple, states.tolist())),
    ]
    for layout in layouts:
        assert np.array_equal(plane(layout, backend=backend), wanted)
    wide_cells = np.repeat(plane.cells.entries.astype(np.int64), 2)[::2]
    other = dataclasses.replace(plane, cells=dataclasses.replace(plane.cells, entries=wide_cells))
    assert np.array_equal(other(states, backend=backend), wanted)
    frozen = states.astype(float)
    frozen.flags.writeable = False
    assert np.array_equal(plane(frozen, backend=backend), wanted)


@backends
@pytest.mark.parametrize("which", ["plane", "cylinder"])
def test_states_are_left_as_they_were(which, backend, request):
    made = request.getfixturevalue(which)
    states = made.domain.sample(100) + 3 * made.domain.widths
    before = states.copy()
    made(states, outside="nearest", backend=backend)
    made(states, outside=0, backend=backend)
    assert np.array_equal(states, before)


def test_symbols_are_those_of_the_labelling_function(plane):
    # a point in a leaf that is not mixed has that leaf's label; disc's features are wider than
    # a root cell, so no leaf above the finest level can hide another label
    mixed = set(plane.cells.mixed_cells.tolist())
    states = plane.domain.sample(20_000, seed=2)
    places = plane.cells.find(plane.domain.locate(states, plane.cells.counts))
    sure = np.array([p not in mixed for p in places])
    wrong = plane(states)[sure] != disc(states[sure])
    assert 0.8 < sure.mean() < 1 and wrong.mean() < 0.002
    assert set(plane(states).tolist()) == {-1, 0, 1, 2}


@pytest.mark.parametrize("grid", range(len(GRIDS)))
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("some_axes", [False, True])
def test_lookup_against_a_search_among_the_faces(grid, periodic, some_axes):
    made = random_policy(grid, periodic, grid, some_axes)
    counts = made.cells.counts
    states = states_at_faces(made.domain, counts, 400, seed=grid)
    inside = ((states >= made.domain.lower) & (states < made.domain.upper)).all(axis=1)
    states = states[inside]
    steps = np.empty(states.shape, dtype=int)
    for i, count in enumerate(counts):
        faces = made.domain.faces(i, np.arange(count + 1), count)
        steps[:, i] = np.searchsorted(faces, states[:, i], side="right") - 1
    wanted = np.full(len(states), -9)
    for leaves in made.cells.leaves():
        labels = made.cells.labels_at(leaves.places)
        for corner, size, label in zip(leaves.lower, leaves.sizes, labels):
            held = ((steps >= corner) & (steps < corner + size)).all(axis=1)
            wanted[held] = label if label < 2 else -1
    assert len(states) > 100 and np.array_equal(made(states), wanted)


def test_upper_faces_belong_to_the_last_cells_and_seams_to_the_first(cylinder):
    low, high = cylinder.domain.lower, cylinder.domain.upper
    inner = np.nextafter(high, -INF)
    y = np.linspace(-5, 5, 101)
    at = np.full_like(y, 1.0)
    assert np.array_equal(
        cylinder(np.stack([high[0] * at, y], 1)), cylinder(np.stack([low[0] * at, y], 1))
    )
    x = np.linspace(0, 2 * np.pi, 101)
    assert np.array_equal(
        cylinder(np.stack([x, high[1] * at], 1)), cylinder(np.stack([x, inner[1] * at], 1))
    )
    corners = [[low[0], low[1]], [high[0], low[1]], [low[0], high[1]], [high[0], high[1]]]
    found = cylinder(corners)
    assert found[0] == found[1] and found[2] == found[3] and found[0] != found[2]


@backends
def test_whole_turns_do_not_matter(backend):
    box = Box([-2, 0], [6, 1], periodic=[True, False])  # turns are exact in floating point
    made = capsyn.subdivide(lambda x: (x[:, 0] > 1.3).astype(int), box, 2, partitions=4)
    k = np.arange(64)
    states = np.stack([-2 + k / 8, (k % 7) / 7], axis=1)
    wanted = made(states, backend="numpy")
    assert set(wanted.tolist()) == {0, 1}
    for turns in (-(2**40), -3, -1, 1, 2, 2**30):
        assert np.array_equal(made(states + [8.0 * turns, 0], backend=backend), wanted)


@backends
@pytest.mark.parametrize("x", [HUGE, -HUGE, 1e300, -1e17, 5e-324, -5e-324, -1e-20])
def test_huge_and_tiny_values_on_a_periodic_axis(cylinder, backend, x):
    turned = np.fmod(x, 2 * np.pi)
    turned += 2 * np.pi * (turned < 0)
    symbol = cylinder([x, 1.0], backend=backend)
    assert symbol == cylinder([turned if turned < 2 * np.pi else 0.0, 1.0], backend="numpy")


@backends
def test_outside_error_names_the_first_such_state(plane, backend):
    states = np.array([[0, 0], [0, 2.5], [NAN, 0], [-3, 0]])
    with pytest.raises(OutsideDomainError) as caught:
        plane(states, backend=backend)
    assert str(caught.value) == (
        "state 1 must lie in the domain [-2, 2] x [-2, 2]; got (0, 2.5) "
        '(outside="nearest" or a symbol would answer)'
    )
    with pytest.raises(
        OutsideDomainError, match=r"^(the state|state 0) must be finite; got \(nan, 0\)$"
    ):
        plane(states[2:], backend=backend)
    for beyond in (np.nextafter(2, INF), -np.nextafter(2, INF)):
        with pytest.raises(OutsideDomainError):
            plane([0.0, beyond], backend=backend)


@backends
def test_outside_nearest_is_the_label_of_the_nearest_cell(plane, backend):
    rng = np.random.default_rng(3)
    states = rng.uniform(-2, 2, (500, 2)) * rng.choice([1, 1.5, 1e3, 1e300], (500, 2))
    clipped = np.clip(states, -2, 2)
    found = plane(states, outside="nearest", backend=backend)
    assert (clipped != states).any()
    assert np.array_equal(found, plane(clipped, backend="numpy"))


@backends
@pytest.mark.parametrize(("rule", "symbol"), [(2, 2), ("left", 1), (-1, -1), (np.int64(0), 0)])
def test_outside_safe_symbol(plane, backend, rule, symbol):
    lost = [[0, 2.5], [-9, 0], [NAN, 0], [0, INF], [-INF, NAN], [HUGE, -HUGE]]
    found = plane(np.array([*lost, [0.0, 0.0], [2, 2]]), outside=rule, backend=backend)
    assert found.tolist() == [symbol] * len(lost) + [0, -1]


@backends
@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("rule", ["error", "nearest"])
def test_what_is_not_finite_has_no_nearest_cell(cylinder, backend, value, rule):
    for state in ([value, 0.0], [0.0, value], [value, value], [9e9, value], [value, 9e9]):
        with pytest.raises(OutsideDomainError, match="^(the state|state 0) must be finite"):
            cylinder(state, outside=rule, backend=backend)


def test_the_policys_own_rule_applies_unless_another_is_given(plane):
    out = [0.0, -7.0]
    own = {"error": None, "nearest": plane([0.0, -2.0]), 2: 2, -1: -1}
    for rule, symbol in own.items():
        made = dataclasses.replace(plane, outside=rule)
        if symbol is None:
            with pytest.raises(OutsideDomainError):
                made(out)
        else:
            assert made(out) == symbol
        assert made(out, outside="right") == 2
        assert made.control(out, outside="right").tolist() == [5, 3]


@pytest.mark.parametrize("rule", ["nowhere", 3, -2, True, 1.0, None, ["nearest"]])
def test_outside_rules_that_are_none(plane, rule):
    message = r'`outside` must be "error", "nearest" or a symbol .* -1 to 2\); got '
    with pytest.raises(ProblemError, match=message):
        check_outside(rule, plane.alphabet)
    if rule is not None:
        with pytest.raises(ProblemError, match=message):
            plane([0.0, 0.0], outside=rule)


def test_unknown_backend(plane):
    with pytest.raises(
        ProblemError, match="`backend` must be one of 'auto', 'c', 'numpy'; got 'gpu'"
    ):
        plane([0.0, 0.0], backend="gpu")


@needs_compiler
@pytest.mark.parametrize("grid", range(len(GRIDS)))
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("rule", ["nearest", 1])
@pytest.mark.parametrize("some_axes", [False, True])
def test_compiled_lookup_is_the_readable_one_bit_for_bit(grid, periodic, rule, some_axes):
    made = random_policy(grid, periodic, 7, some_axes)
    rng = np.random.default_rng(8)
    n = made.domain.n
    states = np.vstack(
        [
            states_at_faces(made.domain, made.cells.counts, 4000, seed=9),
            made.domain.sample(4000) + rng.normal(size=(4000, n)) * made.domain.widths,
            rng.choice([0.0, -0.0, 5e-324, 1.0, 1e17, -1e17, HUGE, -HUGE], (1000, n)),
        ]
    )
    if rule != "nearest":
        states = np.vstack([states, rng.choice([0.3, NAN, INF, -INF], (100, n))])
    found = made(states, outside=rule, backend="c")
    assert np.array_equal(found, made(states, outside=rule, backend="numpy"))
    assert set(found.tolist()) == {-1, 0, 1} or made.cells.leaf_count < 3


@needs_compiler
@given(
    st.floats(-1e3, 1e3),
    st.floats(1e-6, 1e3),
    st.integers(1, 200),
    st.integers(2, 5),
    st.integers(0, 5),
    st.booleans(),
)
def test_compiled_lookup_on_random_axes(lower, width, partitions, refinement, level, periodic):
    rng = np.random.default_rng(partitions)
    domain = Box([lower], [lower + width], periodic=[periodic])
    base = random_policy(0)
    entries = (-1 - rng.integers(0, 3, partitions)).astype(np.int32)
    tree = dataclasses.replace(
        base.cells,
        grid=Grid((partitions,), (refinement,), level),
        entries=entries,
        mixed_cells=np.empty(0, dtype=np.int32),
        mixed_labels=np.empty(0, dtype=np.uint64),
    )
    made = dataclasses.replace(base, domain=domain, cells=tree)
    states = states_at_faces(domain, tree.counts, 100)
    found = made(states, outside="nearest", backend="c")
    assert np.array_equal(found, made(states, outside="nearest", backend="numpy"))


@needs_compiler
def test_large_batches_are_compiled(plane, monkeypatch):
    states = plane.domain.sample(1000)
    wanted = plane(states)
    monkeypatch.setattr(lookup, "COMPILED_FROM", 1000)
    monkeypatch.setattr(type(plane.cells), "labels", None)  # the NumPy way is closed
    assert np.array_equal(plane(states), wanted)
    with pytest.raises(TypeError):
        plane(states[1:])


def test_without_a_compiler_numpy_answers_with_a_warning(plane, monkeypatch):
    def broken(n):
        raise KernelBuildError("no C compiler found")

    states = plane.domain.sample(100)
    wanted = plane(states)
    monkeypatch.setattr(lookup, "_built", broken)
    monkeypatch.setattr(lookup, "COMPILED_FROM", 100)
    with pytest.warns(CapsynWarning, match="looking up with NumPy: no C compiler found"):
        assert np.array_equal(plane(states), wanted)
    with pytest.raises(KernelBuildError):
        plane(states, backend="c")


@backends
def test_batch_order_and_size_do_not_matter(cylinder, backend):
    states = states_at_faces(cylinder.domain, cylinder.cells.counts, 300)
    wanted = cylinder(states, outside="nearest", backend="numpy")
    order = np.random.default_rng(4).permutation(len(states))
    shuffled = cylinder(states[order], outside="nearest", backend=backend)
    assert np.array_equal(shuffled, wanted[order])
    for size in (1, 7, 64, 65):
        parts = np.array_split(states[:200], range(size, 200, size))
        found = np.concatenate([cylinder(p, outside="nearest", backend=backend) for p in parts])
        assert np.array_equal(found, wanted[:200])


def test_control_is_the_symbols_vector_and_the_default(plane):
    states = plane.domain.sample(500)
    symbols = plane(states)
    controls = plane.control(states)
    assert (symbols == -1).any()
    for symbol, control in zip(symbols, controls):
        wanted = plane.default if symbol < 0 else plane.alphabet.values[symbol]
        assert np.array_equal(control, wanted)
    assert plane.control([0.0, 1.9]).tolist() == [0.5, -0.5]
    assert plane.symbol_name(-1) == "default" and plane.symbol_name(1) == "left"


def test_ties_on_a_face_go_to_the_cell_above_it():
    def label(states):  # both symbols on the line, one on either side
        side = np.sign(states[:, 0]).astype(int)
        return np.array([3, 2, 1], dtype=np.uint64)[side]

    made = capsyn.subdivide(
        label, Box([-1, 0], [1, 1]), 2, partitions=[2, 1], max_level=3, returns="masks"
    )
    assert made.cells.leaf_count == 2 and made.statistics["indifferent_points"] == 2
    on = np.array([[0.0, 0.0], [0.0, 0.5], [0.0, 1.0], [-0.0, 0.5]])
    assert made(on).tolist() == [1] * 4
    assert made(np.nextafter(on, -1) * [1, 0]).tolist() == [0] * 4


def test_63_symbols_and_the_default():
    def label(states):  # the vertex that a cell shares with the next one is outvoted
        return np.minimum(np.floor(states[:, 0]).astype(int) - 1, 62)

    made = capsyn.subdivide(label, Box([0], [64]), 63, partitions=64, max_level=0)
    states = np.arange(64)[:, None] + 0.25
    assert made(states).tolist() == list(range(-1, 63))
    assert set(made.volume_shares.tolist()) == {1 / 64}


@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_volume_shares_are_measured_by_monte_carlo(grid):
    made = random_policy(grid, seed=1)
    shares = made.volume_shares
    assert shares.shape == (3,) and abs(shares.sum() - 1) < 1e-12
    count = 40_000
    symbols = made(made.domain.sample(count, seed=2))
    measured = np.bincount(np.where(symbols < 0, 2, symbols), minlength=3) / count
    assert (np.abs(measured - shares) <= 5 * np.sqrt(shares * (1 - shares) / count)).all()


def test_mixed_share_is_the_volume_of_the_mixed_cells(plane):
    finest = np.prod(plane.cells.counts)
    assert plane.mixed_share == pytest.approx(len(plane.cells.mixed_cells) / finest, rel=1e-12)
    assert len(plane.cells.mixed_cells) == plane.statistics["mixed_cells"] > 0
    one = capsyn.subdivide(lambda x: np.zeros(len(x), int), Box([0], [1]), 2)
    assert one.mixed_share == 0.0
    made = random_policy(4, seed=3)  # mixed cells of every level
    steps = made.domain.locate(made.domain.sample(40_000), made.cells.counts)
    measured = np.isin(made.cells.find(steps), made.cells.mixed_cells).mean()
    assert abs(measured - made.mixed_share) < 0.0125


def test_scaling_a_state_leaves_the_tree_unchanged(plane):
    scale = np.array([4.0, 1 / 1024])
    scaled = capsyn.subdivide(
        lambda x: disc(x / scale),
        Box([-2, -2] * scale, [2, 2] * scale),
        3,
        partitions=4,
        max_level=3,
    )
    for name in ("entries", "mixed_cells", "mixed_labels"):
        assert np.array_equal(getattr(scaled.cells, name), getattr(plane.cells, name))
    states = plane.domain.sample(1000)
    assert np.array_equal(scaled(states * scale), plane(states))


def test_exchanging_the_axes_exchanges_the_cells(cylinder):
    box = cylinder.domain
    other = capsyn.subdivide(
        lambda x: (np.sin(x[:, 1]) * x[:, 0] > 0).astype(int),
        Box(box.lower[::-1], box.upper[::-1], periodic=box.periodic[::-1]),
        2,
        partitions=[5, 9],
        refinement=[3, 2],
        max_level=3,
    )
    states = states_at_faces(box, cylinder.cells.counts, 1000)
    wanted = cylinder(states, outside="nearest")
    assert np.array_equal(other(states[:, ::-1], outside="nearest"), wanted)


def test_statistics_count_the_cells(plane, cylinder):
    for made in (plane, cylinder):
        assert made.statistics["cells"] == made.cells.leaf_count
        by_level = [len(x.places) for x in made.cells.leaves()]
        assert made.statistics["leaves_by_level"] == by_level
        made.cells.check(len(made.alphabet) + 1)


def test_repr(plane):
    assert repr(plane) == f"Policy('policy', 2 states, 3 symbols, {plane.cells.leaf_count} cells)"
