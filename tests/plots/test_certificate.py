"""Pictures of certificates, asserted by what was put on the axes."""

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from capsyn import Box
from capsyn.errors import ProblemError
from capsyn.plots.certificate import UNPROVED, plot_certificate, save_certificate_plot
from capsyn.plots.figure import new_figure
from support.proofs.certificates import by_hand, complete

SQUARE = Box([0, -2], [1, 2], names=["level", "flow"], units=["m", "m/s"])
CUBE = Box([0, 0, 0], [1, 2, 3], names=["a", "b", "c"], units=["m", "", "$"])


def drawn(certificate, plane=(0, 1)):
    return plot_certificate(certificate, new_figure(4, 3).add_subplot(), plane)


def texts(ax):
    return ax.get_legend_handles_labels()[1]


def outline(ax):
    """Return the length of the lines around the set in which the loop stays."""
    (lines,) = ax.collections
    return sum(np.abs(np.diff(segment, axis=0)).sum() for segment in lines.get_segments())


@pytest.mark.parametrize("plane", [(0, 1), (1, 0)])
def test_two_states_have_times_and_what_is_open(plane):
    certificate = by_hand(SQUARE, (20, 10))
    ax = drawn(certificate, plane)
    unproved, times = (image.get_array() for image in ax.images)
    assert ax.images[1].get_extent() == [[0, 1, -2, 2], [-2, 2, 0, 1]][plane[0]]
    shape = tuple(np.take([20, 10], plane[::-1]))
    assert times.shape == shape and unproved.shape == (*shape, 4)
    cells = certificate.cells
    proved = (cells.arrives == 1).reshape(20, 10).transpose(plane[::-1])
    assert (~np.ma.getmaskarray(times) == proved).all()
    assert times.max() == pytest.approx(certificate.within)
    opened = cells.statuses().reshape(20, 10).transpose(plane[::-1]) == 2
    assert (np.all(unproved == to_rgba(UNPROVED[2]), axis=-1) == opened).all() and opened.any()
    labels = ax.get_xlabel(), ax.get_ylabel()
    assert labels == tuple(np.take(["level [m]", "flow [m/s]"], plane))


def test_what_stays_is_outlined_and_its_ripple_is_dashed():
    ax = drawn(by_hand(SQUARE, (20, 10)))
    assert outline(ax) == pytest.approx(2 * (4 * 0.05 + 2 * 0.4))
    ripple = next(patch for patch in ax.patches if patch.get_label() == "ripple")
    assert ripple.get_linestyle() == "--"
    assert ripple.get_xy() == pytest.approx((0.45, -0.2))
    assert (ripple.get_width(), ripple.get_height()) == pytest.approx((0.1, 0.4))
    assert texts(ax) == ["open", "stays in", "ripple", "refuted"]


def test_nothing_is_outlined_at_the_seam_of_an_angle():
    certificate = by_hand(Box([0, 0], [1, 1], periodic=[True, False]), (10, 10))
    stays = certificate.cells.stays
    stays[:] = False
    stays.reshape(10, 10)[[0, 9], 3:5] = True
    assert outline(drawn(certificate)) == pytest.approx(2 * (0.2 + 0.2))
    straight = by_hand(Box([0, 0], [1, 1]), (10, 10))
    straight.cells.stays[:] = stays
    assert outline(drawn(straight)) == pytest.approx(4 * 0.1 + 4 * 0.2)


def test_refuted_starts_are_crosses_the_first_of_each_kind_with_its_name():
    states = np.array([[0.8, 1.0], [0.7, 1.5], [0.2, 0.0]])
    failures = ("stands still", "stands still", "leaves $ the domain")
    ax = drawn(by_hand(SQUARE, (20, 10), refuted=states, failures=failures))
    (crosses,) = ax.lines
    assert crosses.get_xydata().tolist() == states.tolist()
    assert [t.get_text() for t in ax.texts] == ["stands still", r"leaves \$ the domain"]


def test_a_whole_proof_has_no_more_in_its_legend_than_there_is():
    whole = complete(SQUARE, (20, 10), ripple=np.full((2, 2), np.nan))
    whole.cells.stays[:] = False
    assert texts(drawn(whole)) == []


@pytest.mark.parametrize("plane", [(0, 1), (2, 0), (1, 2)])
def test_more_states_have_shares_over_a_plane(plane):
    certificate = by_hand(CUBE, (10, 8, 6))
    ax = drawn(certificate, plane)
    (image,) = ax.images
    cells, (across, up) = certificate.cells, plane
    starts, arrives = (a.reshape(10, 8, 6) for a in (cells.starts, cells.arrives))
    (other,) = {0, 1, 2} - set(plane)
    for x, y in ((5, 4), (7, 3), (0, 0)):
        place = [slice(None)] * 3
        place[across], place[up] = min(x, cells.counts[across] - 1), min(y, cells.counts[up] - 1)
        there = starts[tuple(place)]
        shown = image.get_array()[place[up], place[across]]
        if there.any():
            share = (there * arrives[tuple(place)]).sum() / there.sum()
            assert shown == pytest.approx(share)
        else:
            assert np.ma.is_masked(shown)
    assert other not in plane and image.get_clim() == (0.0, 1.0)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_pictures_are_written(tmp_path, n):
    domain = Box([0] * n, [1] * n)
    save_certificate_plot(by_hand(domain, (10,) * n), "a $ b", tmp_path / "one.png")
    save_certificate_plot(by_hand(domain, (10,) * n), "a $ b", tmp_path / "two.png")
    assert (tmp_path / "one.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    save_certificate_plot(complete(domain, (10,) * n), "whole", tmp_path / "whole.svg")
    assert "<svg" in (tmp_path / "whole.svg").read_text()


def test_one_state_has_times_as_heights():
    ax = drawn(by_hand(Box([-1], [1], names=["x"], units=["m"]), (20,)))
    heights = [bar.get_height() for bar in ax.patches if bar.get_facecolor()[2] > 0.6]
    assert max(heights) == pytest.approx(4 * 0.375)
    assert ax.get_xlabel() == "x [m]" and "open" in texts(ax) and "stays in" in texts(ax)


def test_another_format_is_refused(tmp_path):
    with pytest.raises(ProblemError, match="must end in .png"):
        save_certificate_plot(by_hand(SQUARE, (4, 4)), "a", tmp_path / "a.txt")
