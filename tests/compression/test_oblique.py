import numpy as np
import pytest

from capsyn import Box
from capsyn.cells.masks import or_else
from capsyn.cells.split_tree import LEAF
from capsyn.compression.fitted import oblique
from capsyn.compression.fitted.oblique import Fit, fine_lattice, fit_tree
from capsyn.compression.fitted.plane_tree import best_shift, separating_plane
from capsyn.compression.fitted.surface import draw_samples, find_surface, nearest_plane
from capsyn.errors import ProblemError
from capsyn.modelling.grid import MAX_COUNT
from capsyn.statistics import clopper_pearson

SQUARE = Box([-1.0, -2.0], [1.0, 2.0])


def bits(labels):
    """Return masks of one bit."""
    return (np.uint64(1) << np.asarray(labels).astype(np.uint64))[:, None]


def plane(x):
    return bits(x[:, 0] - 0.7 * x[:, 1] >= 0.2)


def xor(x):
    return bits((x[:, 0] + x[:, 1] > 0.1) ^ (x[:, 0] - 2 * x[:, 1] > 0.2))


def stripe(x):
    return bits(np.abs(x[:, 0] + 0.5 * x[:, 1]) < 0.15)


def share_of(fit):
    return fit.right / fit.judged


def reached(fit, agreement):
    return clopper_pearson(fit.right, fit.judged)[0] >= agreement


def fitted(masks, domain, labels, agreement, **options) -> Fit:
    """Return a fit, after the checks that every fit must stand."""
    options = {"samples": 40_000, "states": 40_000} | options
    given = masks

    def masks(states):  # no finite answer is the default
        return or_else(given(states), labels - 1)

    fit = fit_tree(masks, domain, labels, agreement, **options)
    tree = fit.tree
    tree.check(labels)
    steps = np.array(tree.counts, dtype=float)
    assert (np.abs(tree.planes) @ steps <= MAX_COUNT).all()
    assert np.abs(tree.threshold.astype(float)).max() <= MAX_COUNT
    assert (np.count_nonzero(tree.planes, axis=1) > 1).all()
    # no split between leaves of one label
    inner = np.flatnonzero(tree.split != LEAF)
    first, second = tree.first[inner], tree.second[inner]
    leaves = (tree.split[first] == LEAF) & (tree.split[second] == LEAF)
    assert (tree.threshold[first] != tree.threshold[second])[leaves].all()
    # an estimate of the share that uses nothing of the fit
    states = domain.sample(40_000, 12345)
    found = masks(states)[:, 0]
    labelled = tree.labels(domain.locate(states, tree.counts)).astype(np.uint64)
    share = ((found >> labelled) & np.uint64(1)).mean()
    spread = np.sqrt(max(share * (1 - share), 1e-5) * (1 / 40_000 + 1 / fit.judged))
    assert share == pytest.approx(share_of(fit), abs=5 * spread)
    return fit


@pytest.mark.parametrize("masks, nodes", [(plane, 3), (stripe, 5), (xor, 7)])
def test_planes_are_found(masks, nodes):
    fit = fitted(masks, SQUARE, 2, 0.995)
    assert reached(fit, 0.995) and fit.tree.node_count == nodes
    assert share_of(fit) > 0.999


def test_plane_has_the_right_normal():
    tree = fitted(plane, SQUARE, 2, 0.995).tree
    slope = tree.planes[0] * tree.counts / SQUARE.widths
    assert slope[1] / slope[0] == pytest.approx(-0.7, abs=0.01)


def test_a_split_along_an_axis_is_a_threshold():
    fit = fitted(lambda x: bits(x[:, 1] < 0.5), SQUARE, 2, 0.995)
    assert fit.tree.node_count == 3 and len(fit.tree.planes) == 0
    assert fit.tree.split[0] == 1
    assert fit.tree.threshold[0] / fit.tree.counts[1] == pytest.approx(0.625, abs=1e-3)


def test_curved_surface_takes_more_planes_for_a_higher_target():
    def ball(x):
        return bits((x**2).sum(axis=1) < 0.6)

    domain = Box([-1.0, -1.0], [1.0, 1.0])
    coarse, fine = (fitted(ball, domain, 2, share) for share in (0.9, 0.98))
    assert reached(coarse, 0.9) and reached(fine, 0.98)
    assert coarse.tree.node_count < fine.tree.node_count <= 25


def test_periodic_axis():
    domain = Box([0.0, -1.0], [2 * np.pi, 1.0], periodic=[True, False])
    # the first label's region lies across the seam
    fit = fitted(lambda x: bits(np.cos(x[:, 0]) > 0.3 * x[:, 1]), domain, 2, 0.98)
    assert reached(fit, 0.98) and fit.tree.node_count <= 9
    below, above = domain.locate(np.array([[2 * np.pi + 0.01, 0.0], [-0.01, 0.0]]), fit.tree.counts)
    assert (fit.tree.labels(np.stack([below, above])) == 1).all()


def test_one_axis_three_labels_and_default():
    fit = fitted(lambda x: bits((x[:, 0] > 0.3) * 1 + (x[:, 0] > 0.7)), Box([0.0], [1.0]), 3, 0.995)
    assert reached(fit, 0.995) and fit.tree.node_count == 5
    assert sorted(fit.tree.threshold[fit.tree.split == LEAF]) == [0, 1, 2]


def test_no_finite_answer_is_the_default():
    def masks(x):
        return np.where(x[:, :1] < 0, np.uint64(0), np.uint64(2))

    fit = fitted(masks, SQUARE, 4, 0.99)
    assert reached(fit, 0.99) and fit.tree.node_count == 3
    assert fit.tree.labels(np.array([[0, 0], [8191, 0]])).tolist() == [3, 1]


@pytest.mark.parametrize("mask, label", [(1, 0), (4, 2), (0, 2)])
def test_one_label_everywhere(mask, label):
    fit = fitted(lambda x: np.full((len(x), 1), mask, dtype=np.uint64), SQUARE, 3, 0.999)
    assert reached(fit, 0.999) and fit.right == fit.judged
    assert fit.tree.node_count == 1 and fit.tree.threshold[0] == label


def test_ties_leave_room():
    # both labels are right in a wide band: one split along an axis does
    fit = fitted(
        lambda x: np.where(np.abs(x[:, :1]) < 0.4, np.uint64(3), bits(x[:, 0] > 0)), SQUARE, 2, 0.99
    )
    assert reached(fit, 0.999) and fit.tree.node_count == 3


def test_missed_target_gives_the_best_tree():
    def noise(x):
        return bits(np.floor(x * 997).sum(axis=1) % 2)

    fit = fitted(noise, SQUARE, 2, 0.99, samples=4000, states=4000)
    assert not reached(fit, 0.99)
    assert 0.4 < share_of(fit) < 0.6
    missed = fitted(plane, SQUARE, 2, 1.0)
    assert not reached(missed, 1.0) and share_of(missed) > 0.999


def test_what_a_search_misses_harder_ones_find(monkeypatch):
    def ball(x):
        return bits((x**2).sum(axis=1) < 0.6)

    domain = Box([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])
    monkeypatch.setattr(oblique, "ATTEMPTS", 1)
    monkeypatch.setattr(oblique, "FINENESS", 1.3)  # the first tree is too coarse
    found = fitted(ball, domain, 2, 0.97)
    monkeypatch.setattr(oblique, "AIMS", oblique.AIMS[:1])
    once = fitted(ball, domain, 2, 0.97)
    assert reached(found, 0.97) and not reached(once, 0.97)


def test_same_seed_same_tree():
    first, again, other = (
        fit_tree(xor, SQUARE, 2, 0.99, seed=seed, samples=20_000) for seed in (3, 3, 4)
    )
    for name in ("split", "threshold", "second", "planes"):
        assert getattr(first.tree, name).tobytes() == getattr(again.tree, name).tobytes()
    assert first.right == again.right
    assert first.tree.planes.tobytes() != other.tree.planes.tobytes()


def test_many_axes():
    domain = Box([-1.0] * 6, [1.0] * 6)
    fit = fitted(lambda x: bits(x @ np.array([1, -2, 0.5, 0.3, 0, 1]) > 0.1), domain, 2, 0.98)
    assert reached(fit, 0.98) and fit.tree.node_count == 3


def test_tiny_region_and_states():
    domain = Box([0.0, 1e-12], [1e-12, 3e-12])
    fit = fitted(lambda x: bits(x[:, 0] > x[:, 1] - 1e-12), domain, 2, 0.99)
    assert reached(fit, 0.99)


def test_lattice_is_as_fine_as_floating_point_allows():
    assert fine_lattice(SQUARE) == (8192, 8192)
    narrow = Box([1e6, 0.0], [1e6 + 3e-8, 1.0])
    assert fine_lattice(narrow) == (32, 8192)
    fit = fitted(lambda x: bits(x[:, 0] > 1e6 + 1e-8), narrow, 2, 0.97)
    assert reached(fit, 0.97) and fit.tree.node_count == 3


@pytest.mark.parametrize(
    "options",
    [{"agreement": 0.0}, {"agreement": 1.1}, {"samples": 10}, {"seed": -1}, {"labels": 0}],
)
def test_bad_arguments(options):
    with pytest.raises(ProblemError, match=next(iter(options))):
        fit_tree(**{"masks": plane, "domain": SQUARE, "labels": 2, "agreement": 0.9} | options)


def test_surface_area_and_points():
    def disk(x):
        return bits(((x - 0.5) ** 2).sum(axis=1) < 0.16)

    samples = draw_samples(disk, 2, 2, 100_000, [0])
    surface = find_surface(disk, samples, [1])
    assert surface.area * len(surface.points) == pytest.approx(2 * np.pi * 0.4, rel=0.05)
    radius = np.linalg.norm(surface.points - 0.5, axis=1)
    assert np.abs(radius - 0.4).max() < 1e-4


def test_nearest_plane():
    rng = np.random.default_rng(0)
    x = rng.random((100, 3))
    x[:, 2] = 0.3 * x[:, 0] - 0.2 * x[:, 1] + 0.5
    normal, offset = nearest_plane(x)
    assert np.abs(x @ normal - offset).max() < 1e-12
    assert np.linalg.norm(normal) == pytest.approx(1.0)


def test_separating_plane():
    x = np.random.default_rng(0).random((2000, 2))
    second = x[:, 0] + x[:, 1] >= 1.1
    normal, offset = separating_plane(x, second, (np.array([1.0, 0.0]), 0.5))
    assert ((x @ normal >= offset) == second).mean() > 0.995


def test_best_shift():
    rng = np.random.default_rng(0)
    for _ in range(50):
        x = rng.integers(-5, 6, 30) / 4  # with ties
        second = rng.random(30) < 0.5
        shift, saved = best_shift(x, second)
        errors = [np.count_nonzero((x >= s) != second) for s in np.append(np.unique(x), 9)]
        assert np.count_nonzero((x >= shift) != second) == min(errors)
        assert np.count_nonzero((x >= 0) != second) - saved == min(errors)
    assert best_shift(np.empty(0), np.empty(0, dtype=bool)) == (0.0, 0)
