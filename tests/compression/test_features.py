"""Trees whose splits compare features: what they guarantee, by brute force over all cells."""

import dataclasses
import warnings

import casadi as ca
import numpy as np
import pytest

from capsyn import Alphabet, Box, Policy, agreement, compress, problems, subdivide, synthesize
from capsyn.cells import feature_tree
from capsyn.cells.feature_tree import Features, FeatureTree
from capsyn.compression import compress as compression
from capsyn.compression.features import controller_fit
from capsyn.compression.features.growing import Pairs, best_split
from capsyn.compression.features.space import Space
from capsyn.compression.fitted.plane_tree import Node
from capsyn.compression.freedom import allowed_masks
from capsyn.compression.proof import prove
from capsyn.errors import CapsynWarning, ProblemError
from support.features import BY_NUMPY, FEATURES, all_steps, exact, pendulum, value_of, walked


@pytest.fixture
def coarse(monkeypatch):
    """Let trees of mode linear have a lattice of a few thousand steps."""
    monkeypatch.setattr(compression, "FEATURE_STEPS", 512)
    for name in ("SAMPLES", "PAIRS"):
        monkeypatch.setattr(controller_fit, name, 20_000)


def margins(tree):
    """Return the distances of all values on the lattice from all thresholds, by span."""
    counts, domain = tree.cells.counts, tree.domain
    centres = domain.lower + (all_steps(counts) + 0.5) / np.array(counts) * domain.widths
    found = []
    for name, thresholds in zip(tree.cells.features.names, tree.cells.features.thresholds):
        values = value_of(name, centres)
        found += [np.abs(values - t).min() / np.ptp(values) for t in thresholds]
    return found


def test_an_exact_tree_gives_every_finest_cell_the_policys_symbol():
    tree, policy = exact(), pendulum()
    steps = all_steps(policy.cells.counts)
    labels = policy.cells.labels(steps)
    np.testing.assert_array_equal(walked(tree, steps), labels)
    np.testing.assert_array_equal(tree.cells.labels(steps), labels)
    assert tree.node_count <= 9 and compress(policy).node_count > 500
    assert set(tree.cells.features.names) == set(BY_NUMPY)
    states = policy.domain.sample(60_000, 3)  # more than the compiled lookup takes over from
    np.testing.assert_array_equal(tree(states), policy(states))
    assert tree.guarantee.mode == "exact" and tree.guarantee.changed == prove(tree, policy) == 0
    np.testing.assert_allclose(tree.volume_shares, policy.volume_shares, atol=1e-12)


def test_a_free_tree_gives_every_finest_cell_an_allowed_symbol(monkeypatch):
    policy = pendulum()
    tree = compress(policy, "freedom", features=FEATURES, states=20_000)
    steps = all_steps(policy.cells.counts)
    entries, labels = policy.cells.find(steps), walked(tree, steps)
    allowed = allowed_masks(policy, True)[entries][:, 0]
    assert (allowed >> labels.astype(np.uint64) & np.uint64(1)).all()
    changed = np.mean(labels != policy.cells.labels(steps))
    assert tree.guarantee.changed == changed == prove(tree, policy) > 0 and tree.node_count <= 7
    monkeypatch.setattr(feature_tree, "CHUNK", 1000)
    assert prove(tree, policy) == changed
    again = compress(policy, "freedom", features=FEATURES, states=20_000)
    assert again.cells.structure() == tree.cells.structure()
    assert tree.guarantee.states == 20_000 and tree.guarantee.agreement > 0.99


def test_a_linear_tree_reaches_its_target_with_few_nodes(coarse):
    tree = compress(pendulum(), "linear", features=FEATURES, agreement=0.994)
    assert tree.guarantee.reached and tree.node_count <= 7 and tree.cells.counts == (512, 512)
    comparison = agreement(tree, 50_000, seed=5)
    assert comparison.high >= tree.guarantee.low and comparison.share >= 0.994
    steps = all_steps(tree.cells.counts)[::7]
    np.testing.assert_array_equal(tree.cells.labels(steps), walked(tree, steps))
    again = compress(pendulum(), "linear", features=FEATURES, agreement=0.994)
    assert again.cells.structure() == tree.cells.structure()


def test_sums_of_features_are_features(coarse):
    """The law of four accelerations compares the energy with multiples of cos(theta) omega."""
    policy = synthesize(problems.plain("cart-pendulum-4"))
    law = {name: FEATURES[name] for name in BY_NUMPY}
    tree = compress(policy, "linear", features=law, agreement=0.97)
    assert tree.guarantee.reached and tree.node_count <= 21
    sums = [name for name in tree.cells.features.names if name not in BY_NUMPY]
    assert sums and all("energy" in name and "(cos(theta) * omega)" in name for name in sums)
    steps = all_steps(tree.cells.counts)[::11]
    different = walked(tree, steps) != tree.cells.labels(steps)
    assert np.mean(different) < 1e-4  # names have six digits
    assert tree.cells.features.margin <= min(margins(tree)) * 1.01


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_sum_with_one_factor_that_counts_is_that_feature(sign):
    box, law = Box([0.0], [4.0]), {"a": lambda x: 2 * x[0] - 3, "b": lambda x: ca.sin(x[0])}
    space = Space.of(law, box, (64,))
    x = (np.arange(64) + 0.5) / 16
    values = [(v - v.min()) / np.ptp(v) for v in (2 * x - 3, np.sin(x))]
    for slight, names in ((1e-5, ("a",)), (0.5, (f"{'-' * (sign < 0)}a + ",))):
        plane = np.array([0.0, sign, slight]), sign * 0.4 + slight / 2
        root = Node(0, plane, [Node(0), Node(1)])
        tree = space.tree(root, moved=False)
        expected = sign * values[0] + slight * values[1] >= plane[1]
        np.testing.assert_array_equal(tree.labels(np.arange(64)[:, None]), expected)
        assert len(tree.features.names) == 1 and tree.features.names[0].startswith(names[0])


def test_margins_are_those_of_the_whole_lattice(coarse):
    free = compress(pendulum(), "linear", features=FEATURES, agreement=0.99, states=20_000)
    for tree in (exact(), free):
        found = margins(tree)
        assert tree.cells.features.margin == pytest.approx(min(found), rel=1e-6)
        assert min(found) > 1e-9


def test_a_lattice_too_fine_to_look_at_has_no_margin(coarse, monkeypatch):
    monkeypatch.setattr("capsyn.compression.features.space.ENUMERATED", 1000)
    tree = compress(pendulum(), "linear", features=FEATURES, agreement=0.98, states=20_000)
    assert tree.cells.features.margin is None and tree.guarantee.reached


def test_planes_of_states_and_features_go_together(coarse):
    """A law of which one half is a plane and the other a circle."""
    box = Box([-1, -1], [1, 1])

    def law(x):
        plane, circle = x[:, 1] > 0.4 * x[:, 0] + 0.3, (x**2).sum(axis=1) < 0.36
        return np.where(plane, 0, np.where(circle, 1, 2))

    policy = subdivide(law, box, 3, max_level=3)
    radius = {"radius": lambda x: ca.norm_2(x)}
    tree = compress(policy, "linear", controller=law, features=radius, agreement=0.97)
    assert tree.guarantee.reached and tree.node_count <= 7
    assert tree.cells.features.names == ("radius",) and len(tree.cells.planes) > 0
    assert (tree.cells.planes[:, 2:] == 0).all()
    states = box.sample(20_000, 9)
    assert np.mean(tree(states) == law(states)) > 0.97


def test_a_linear_tree_without_use_for_features_has_none(coarse):
    def law(x):
        return (x[:, 0] + x[:, 1] > 0.1).astype(int)

    policy = subdivide(law, Box([-1, -1], [1, 1]), 2, max_level=3)
    tree = compress(
        policy, "linear", controller=law, features={"r": lambda x: ca.norm_2(x)}, states=20_000
    )
    assert not isinstance(tree.cells, FeatureTree) and tree.node_count == 3


def test_features_that_are_no_use_are_told():
    policy = synthesize(problems.plain("cart-pendulum"), max_level=1)
    with pytest.warns(CapsynWarning, match=r"^no tree with `features` is smaller than the \d+ "):
        tree = compress(policy, features={"e": lambda x: ca.exp(x[1])})
    assert not isinstance(tree.cells, FeatureTree)
    np.testing.assert_array_equal(tree.cells.split, compress(policy).cells.split)


def test_cells_without_a_common_symbol_are_parted_even_where_no_neighbours_are_unlike():
    """Along the diagonal are mixed cells, which may take either symbol."""

    def law(x):
        return (x[:, 0] + x[:, 1] > 1).astype(int)

    policy = subdivide(law, Box([0, 0], [1, 1]), 2, partitions=6, max_level=0)
    masks = allowed_masks(policy, True)[policy.cells.find(all_steps((6, 6))), 0].reshape(6, 6)
    assert (masks[1:] & masks[:-1]).all() and (masks[:, 1:] & masks[:, :-1]).all()
    tree = compress(policy, "freedom", features={"sum": lambda x: x[0] + x[1]}, states=1000)
    assert isinstance(tree.cells, FeatureTree) and tree.node_count == 3
    labels = tree.cells.labels(all_steps((6, 6))).astype(np.uint64)
    assert (masks.ravel() >> labels & np.uint64(1)).all()


def test_gaps_stay_gaps(coarse):
    policy = dataclasses.replace(
        subdivide(
            lambda x: np.where((x**2).sum(axis=1) < 0.5, 0, -1),
            Box([-1, -1], [1, 1]),
            1,
            max_level=4,
        ),
        gaps=True,
    )
    tree = compress(policy, features={"r": lambda x: ca.norm_2(x)})
    assert isinstance(tree.cells, FeatureTree) and tree.node_count < compress(policy).node_count
    states = policy.domain.sample(20_000, 2)
    np.testing.assert_array_equal(tree.covers(states), policy.covers(states))


# splits


def by_trying(pairs, penalty):
    """Return the best gain of a split, of all thresholds between ends."""
    best = -np.inf
    for k in range(pairs.one.shape[1]):
        ends = np.unique(np.concatenate([pairs.one[:, k], pairs.other[:, k]]))
        for threshold in (ends[1:] + ends[:-1]) / 2:
            parted = (pairs.one[:, k] >= threshold) != (pairs.other[:, k] >= threshold)
            if (parted & pairs.unlike).any():
                best = max(best, gain(parted, pairs, penalty))
    return best


def gain(parted, pairs, penalty):
    return np.count_nonzero(parted & pairs.unlike) - penalty * np.count_nonzero(
        parted & ~pairs.unlike
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_best_split_is_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    one = rng.integers(0, 8, size=(60, 3)) / 8
    other = one + rng.integers(-1, 2, size=(60, 3)) / 8
    pairs = Pairs(one, other, rng.random(60) < 0.3)
    k, threshold = best_split(pairs, 0.1)
    parted = (one[:, k] >= threshold) != (other[:, k] >= threshold)
    assert gain(parted, pairs, 0.1) == pytest.approx(by_trying(pairs, 0.1))
    assert best_split(Pairs(one, one, pairs.unlike), 0.1) is None


# what is refused


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ({}, r"^`features` must be a dict of 1 to 64 functions of the state by name; got \{\}$"),
        (lambda x: x[0], "^`features` must be a dict of 1 to 64 functions"),
        ({"a": 3}, "^`features` must be a dict of 1 to 64 functions"),
        ({"": lambda x: x[0]}, "^`features` must have printable names; got ''$"),
        ({"a": lambda x: x}, r"^`features\['a'\]` must return a scalar; got shape \(2, 1\)$"),
        ({"a": lambda x: x[5]}, r"^`features\['a'\]` failed on symbols .*out of range$"),
        ({"a": lambda x: x[0] * ca.SX.sym("q")}, "it uses the undeclared symbol 'q'$"),
        (
            {"b": lambda x: x[0], "a": lambda x: ca.log(x[1])},
            r"^`features\['a'\]` must be a number below 1e\+150 all over the domain; got nan at "
            r"theta = 0\.\d+, omega = -4\.9\d+$",
        ),
        ({"a": lambda x: 1e200 * x[0]}, "got 2.*e\\+198 at theta"),
    ],
)
def test_features_that_cannot_be_used(features, message):
    with pytest.raises(ProblemError, match=message) as caught:
        compress(pendulum(), features=features)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("mode", "options"),
    [
        ("exact", {"level": 2}),
        ("freedom", {"level": 2}),
        ("freedom", {"node_price": 2.0}),
        ("freedom", {"agreement": 0.9}),
    ],
)
def test_options_that_do_not_go_with_features(mode, options):
    (name,) = options
    with pytest.raises(ProblemError, match=f"^`{name}` is not for mode {mode} with `features`"):
        compress(pendulum(), mode, features=FEATURES, **options)


def test_cells_that_do_not_go_with_features(monkeypatch):
    monkeypatch.setattr(compression, "MOST_CELLS", 1000)
    with pytest.raises(ProblemError, match="for at most 1,000 finest cells.*; got 20,736$"):
        compress(pendulum(), features=FEATURES)
    monkeypatch.undo()
    policy = synthesize(problems.plain("cart-pendulum"), max_level=2, leaves="affine")
    with pytest.raises(ProblemError, match="mode freedom|and affine leaves$"):
        compress(policy, features=FEATURES)


def test_a_tree_with_features_is_not_compressed_again():
    with pytest.raises(ProblemError, match="^`policy` must be one of cells"):
        compress(exact(), features=FEATURES)


def test_a_tree_that_does_not_keep_its_word_is_found_out():
    tree, policy = exact(), pendulum()
    features = dataclasses.replace(
        tree.cells.features, thresholds=[t + 0.5 for t in tree.cells.features.thresholds]
    )
    assert isinstance(features, Features)
    wrong = dataclasses.replace(tree, cells=dataclasses.replace(tree.cells, features=features))
    with pytest.raises(ProblemError, match="does not keep its word: step"):
        prove(wrong, policy)


def test_a_near_threshold_is_told(monkeypatch):
    monkeypatch.setattr(compression, "LEAST_MARGIN", 0.1)
    with pytest.warns(CapsynWarning, match="^a feature comes as near as .* of its span"):
        compress(pendulum(), features=FEATURES)


def test_a_constant_feature_is_never_used():
    space = Space.of({"one": lambda x: 1.0 + 0 * x[0]}, Box([0.0], [1.0]), (8,))
    assert (space.coordinates(np.arange(8)[:, None])[:, 1] == 0).all()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CapsynWarning)
        tree = compress(pendulum(), features={"one": lambda x: 1})
    assert not isinstance(tree.cells, FeatureTree) and isinstance(tree, Policy)
    assert Alphabet([1.0, 2.0]).m == 1
