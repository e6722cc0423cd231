"""Pictures of policies that are told exogenous inputs: slices through their values."""

import dataclasses

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from capsyn import Box, compress
from capsyn.errors import ProblemError
from capsyn.plots.figure import new_figure
from capsyn.plots.policy import plot_policy
from capsyn.policies.colors import PALETTE
from support.relays import relay

matplotlib.use("Agg")

TOLD = Box([18.0, -5.0], [24.0, 15.0], names=["setpoint", "outdoor"], units=["degC", ""])


def policy_of(box, **options):
    """Return a policy of as many states that acts on the first less 4 times the outdoors."""
    n = box.n
    return relay(
        lambda x, u, w: [u[0]] + [0.0] * (n - 1),
        box,
        lambda z: np.digitize(z[:, 0] * 10 - z[:, n + 1], [-6.0, 6.0]),
        alphabet=[1.0, 0.0, -1.0],
        partitions=4,
        max_level=2,
        exogenous=TOLD,
        **options,
    )


@pytest.fixture(scope="module")
def policy():
    return policy_of(Box([-1.0, 0.0], [1.0, 2.0], names=["a", "b"]))


def drawn(ax):
    """Return the middles (M, 2) and the colours of the cells on the axes."""
    paths = [path for cells in ax.collections for path in cells.get_paths()]
    colours = [to_hex(c).upper() for cells in ax.collections for c in cells.get_facecolor()]
    return np.array([path.vertices[:4].mean(axis=0) for path in paths]), colours


@pytest.mark.parametrize("w", [None, [19.5, -4.0], [24.0, 15.0]])
def test_a_slice_is_the_policy_at_the_exogenous_inputs_and_its_title_says_them(policy, w):
    at = {} if w is None else dict(zip(TOLD.names, w))
    middles, colours = drawn(ax := plot_policy(policy, at=at, ax=Figure().add_subplot()))
    w = [21.0, 5.0] if w is None else w
    assert colours == [PALETTE[k] for k in policy(middles, w)]
    assert len(set(colours)) > 1 and (ax.get_xlabel(), ax.get_ylabel()) == ("a", "b")
    assert ax.get_title() == f"relay at setpoint = {w[0]:g}, outdoor = {w[1]:g}"
    alone = plot_policy(policy.at(w), ax=Figure().add_subplot())
    assert set(drawn(alone)[1]) == set(colours) and alone.get_title() == "relay"


def test_exogenous_inputs_may_be_axes(policy):
    plane, at = ("setpoint", "a"), {"outdoor": -3.0, "b": 1.7}
    middles, colours = drawn(ax := plot_policy(policy, plane, at, Figure().add_subplot()))
    readings = np.column_stack(
        [middles[:, 1], np.full(len(middles), 1.7), middles[:, 0], np.full(len(middles), -3.0)]
    )
    assert colours == [PALETTE[k] for k in policy(readings)]
    assert (ax.get_xlabel(), ax.get_xlim()) == ("setpoint [degC]", (18, 24))
    assert ax.get_title() == "relay at b = 1.7, outdoor = -3"


def test_one_state_is_drawn_against_the_first_exogenous_input():
    ax = plot_policy(policy_of(Box([-1.0], [1.0])), ax=Figure().add_subplot())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x1", "setpoint [degC]")
    assert ax.get_title() == "relay at outdoor = 5"


def test_a_long_title_is_wrapped_into_the_picture(policy):
    figure = new_figure(7.0, 4.5)
    named = dataclasses.replace(policy, name="a relay of a long name " * 5)
    title = plot_policy(named, ax=figure.add_subplot()).title
    FigureCanvasAgg(figure).draw()
    extent = title.get_window_extent()
    assert len(title.get_text()) > 120
    assert extent.x0 >= 0 and extent.x1 <= figure.bbox.width


def test_oblique_splits_are_drawn_at_the_exogenous_inputs(policy):
    tree = compress(policy, features={"error": lambda x, w: 10 * x[0] - w[1]}, states=1_000)
    assert tree.has_planes
    at = {"setpoint": 18.5, "outdoor": 9.0}
    ax = plot_policy(tree, at=at, ax=Figure().add_subplot())
    (image,) = ax.images
    pixels = np.asarray(image.get_array())
    share = (np.arange(len(pixels)) + 0.5) / len(pixels)
    x = np.column_stack([-1 + 2 * share, np.full(len(share), 0.3)])
    wanted = [PALETTE[k] for k in tree(x, [18.5, 9.0])]
    row = pixels[int(0.15 * len(pixels))]
    assert [to_hex(c).upper() for c in row] == wanted and len(set(wanted)) > 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"at": {"a": 0.5}}, r"states and exogenous inputs outside the plane \(setpoint, outdoor"),
        ({"at": {"setpoint": 30.0}}, r"`at setpoint` must lie in \[18, 24\]; got 30"),
        ({"plane": ("a", "wind")}, "two of the states and exogenous inputs a, b, setpoint"),
        ({"plane": ("setpoint", 2)}, "two different states and exogenous inputs"),
    ],
)
def test_wrong_slices_are_refused(policy, arguments, message):
    with pytest.raises(ProblemError, match=message):
        plot_policy(policy, **arguments, ax=Figure().add_subplot())


def test_the_map_in_notebooks_says_where_it_is(policy):
    html = policy._repr_html_()
    assert "b (0 to 2) against a (-1 to 1) at setpoint = 21 degC, outdoor = 5</div>" in html
    assert html == policy._repr_html_()
    assert "at setpoint" not in policy.at([21.0, 5.0])._repr_html_()
