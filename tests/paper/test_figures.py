"""The paper's figures, asserted by what was put on the axes."""

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from capsyn import Alphabet, Box, subdivide
from capsyn.errors import ProblemError
from capsyn.paper import figures as paper_figures
from capsyn.policies.colors import PALETTE


def policy_of(symbols=2, level=2, default=False, n=2):
    box = Box([-1.0] * n, [1.0] * n, names=["a", "b", "c"][:n], units=["m"] + [""] * (n - 1))
    alphabet = Alphabet(range(symbols))
    last = symbols - (0 if default else 1)

    def label(x):
        rings = np.minimum((np.abs(x).sum(axis=1) * symbols).astype(int), last)
        return np.where(rings == symbols, -1, rings)

    return subdivide(label, box, alphabet, partitions=3, max_level=level)


def axes(count=1):
    axes = Figure().subplots(1, count, squeeze=False)[0]
    return axes if count > 1 else axes[0]


def texts(ax):
    return [text.get_text() for text in ax.texts]


def polygons(ax):
    """Yield the centre (2,), area and colour of every polygon on an Axes."""
    for collection in ax.collections:
        faces = [to_hex(c).upper() for c in collection.get_facecolor()]
        for i, path in enumerate(collection.get_paths()):
            corners = path.vertices[:4]
            yield corners.mean(axis=0), np.prod(np.ptp(corners, axis=0)), faces[i % len(faces)]


def test_layers_show_what_is_labelled_so_far_and_white_where_cells_are_divided():
    policy = policy_of()
    tree = policy.cells
    drawn = paper_figures.draw_layers(policy, axes(3))
    cells = [leaves.level for leaves in tree.leaves() for _ in leaves.places]
    for level, ax in enumerate(drawn):
        shapes = list(polygons(ax))
        assert sum(area for _, area, _ in shapes) == pytest.approx(4.0)
        colored = [(center, color) for center, _, color in shapes if color != "#FFFFFF"]
        assert len(colored) == sum(k <= level for k in cells)
        centers = np.array([center for center, _ in colored])
        assert [color for _, color in colored] == [PALETTE[k] for k in policy(centers)]
        assert ax.get_title() == f"layer {level}" and ax.get_xlabel() == "a [m]"
    assert len(shapes) == tree.leaf_count
    assert drawn[0].get_ylabel() == "b" and not drawn[1].get_ylabel()


def test_layers_of_a_tree_that_is_never_split():
    policy = policy_of(symbols=1)
    for ax in paper_figures.draw_layers(policy, axes(3)):
        assert len(list(polygons(ax))) == 9


def test_layers_need_two_states_and_one_axes_a_level():
    with pytest.raises(ProblemError, match="two states to draw its layers; got 3"):
        paper_figures.draw_layers(policy_of(n=3), axes(3))
    with pytest.raises(ProblemError, match="`axes` must be 3 Axes; got 2"):
        paper_figures.draw_layers(policy_of(), axes(2))


def test_derivative_signs():
    x, y = np.linspace(-1, 1, 5), np.linspace(-1, 1, 7)
    signs = np.full((5, 7), -1)
    signs[2], signs[1, 3], signs[4, 6] = 0, 1, 2
    ax = paper_figures.draw_derivative_signs(x, y, signs, policy_of().domain, axes())
    zero, positive, unknown = ax.lines
    assert np.array_equal(zero.get_xydata(), [[0, v] for v in y])
    assert positive.get_xydata().tolist() == [[-0.5, 0]]
    assert positive.get_color() == "black"
    assert unknown.get_xydata().tolist() == [[1, 1]]
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["dV/dt < 0", "dV/dt = 0", "dV/dt > 0", "not finite"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("a [m]", "b")
    ax = paper_figures.draw_derivative_signs(x, y, np.full((5, 7), -1), policy_of().domain, axes())
    assert not ax.lines and len(ax.get_legend().get_texts()) == 1


def test_the_tanks_bear_their_names():
    ax = paper_figures.draw_tanks(axes())
    names = {"$V_1$", "$V_2$", "$V_3$", "$T_1$", "$T_2$", "$x_1$", "$x_2$", "$h$"}
    assert names <= set(texts(ax))


def test_end_states():
    initial, final = np.random.default_rng(0).random((2, 20, 2))
    names = [("x1", "m"), ("x2", "")]
    ax = paper_figures.draw_end_states(initial, final, [0.4, 0.6], 0.1, names, axes())
    first, last, circle = ax.lines
    assert np.array_equal(first.get_xydata(), initial) and np.array_equal(last.get_xydata(), final)
    assert first.get_marker() != last.get_marker() and first.get_color() != last.get_color()
    np.testing.assert_allclose(np.linalg.norm(circle.get_xydata() - [0.4, 0.6], axis=1), 0.1)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x1 [m]", "x2")


def test_costs_are_one_line_a_trial():
    costs = np.array([[3.0, 2.0, 1.0], [4.0, 1.0, np.nan]])
    ax = paper_figures.draw_costs(np.array([0.0, 0.1, 0.2]), costs, axes())
    assert np.array_equal([line.get_ydata() for line in ax.lines], costs, equal_nan=True)
    assert ax.get_ylabel() == "cost J of eq. (3)" and ax.get_ylim()[0] == 0.0
    ax = paper_figures.draw_costs(np.array([0.0, 0.1, 0.2]), costs, axes(), log=True)
    assert ax.get_yscale() == "log"


@pytest.mark.parametrize("dwell", [[0.0, 0.01, 0.1, 0.5], [0.1, 0.2, 0.3, 0.4]])
@pytest.mark.parametrize("least", [0.0, 2.0])
def test_dwell_tradeoff(dwell, least):
    shares = np.array([1.0, 0.9, 0.5, 0.0])
    rates = np.array([400.0, 90.0, 9.0, least])
    ax, second = paper_figures.draw_dwell_tradeoff(
        np.array(dwell), shares, shares * 0.9, shares + 0.1 * (1 - shares), rates, axes()
    )
    bars = ax.containers[0]
    assert np.array_equal(bars.lines[0].get_ydata(), shares)
    ends = np.array([segment[:, 1] for segment in bars.lines[2][0].get_segments()])
    np.testing.assert_allclose(ends[:, 0], shares * 0.9)
    np.testing.assert_allclose(ends[:, 1], shares + 0.1 * (1 - shares))
    assert np.array_equal(second.lines[0].get_ydata(), rates)
    assert second.get_yscale() == ("log" if least else "linear")
    assert ax.get_xlabel() == "minimum dwell time [s]"
    ax.figure.canvas.draw()  # every scale can be drawn, 0 too
