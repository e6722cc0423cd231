"""Many symbols in pictures: looks that stay apart, marks, names in regions, and legends."""

import dataclasses
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import capsyn
from capsyn.plots import symbol_looks
from capsyn.plots.policy import plot_policy, save_policy_plot
from capsyn.policies.colors import PALETTE, TILE, Look, ink_on, tiles
from support.pictures.color_vision import VIEWERS, least

matplotlib.use("Agg")
DOTS = 2


def striped(count, across, names=None, target=None):
    """Return a policy whose symbols are bands of x, in turn."""
    symbols = count if names is None else capsyn.Alphabet(np.arange(count), names=names)
    policy = capsyn.subdivide(
        lambda x: np.minimum((across * x[:, 0]).astype(int), across - 1) % count,
        capsyn.Box([0, 0], [1, 1], names=["x", "y"]),
        symbols,
        partitions=[across, 1],
        max_level=0,
    )
    return dataclasses.replace(policy, target=target)


@pytest.fixture
def few_pixels(monkeypatch):
    monkeypatch.setattr("capsyn.plots.policy.PIXELS", 240)


@pytest.mark.parametrize("viewer", VIEWERS)
def test_looks_stay_apart_for_every_viewer(viewer):
    assert least(symbol_looks(8), viewer) > 15
    assert least(symbol_looks(27), viewer) > 10
    assert least(symbol_looks(27), viewer, [1, 3, 9]) > 12  # one of three settings is another
    assert least(symbol_looks(256), viewer) > 7  # 2.3 can just be noticed


def test_256_symbols_look_different_and_what_one_switch_parts_has_another_colour():
    looks = symbol_looks(256)
    assert len(set(looks)) == 256 and looks[:8] == [Look(color, 0) for color in PALETTE]
    assert symbol_looks(27) == looks[:27]  # however many there are
    for k in range(256):
        assert all(looks[k].color != looks[k ^ 1 << bit].color for bit in range(8))
    assert {look.marks for look in looks} == set(range(32)) and not tiles()[0].any()
    assert symbol_looks(4096)[4095].marks == 31


def test_inks_can_be_seen():
    assert [ink_on(color) for color in ("#000000", "#ffffff", PALETTE[6])] == [
        "#ffffff", "#111111", "#111111"]  # fmt: skip


def test_marks_lie_over_the_cells_of_their_symbols(few_pixels):
    policy = striped(27, 27)
    ax = plot_policy(policy, ax=Figure().add_subplot())
    (image,) = ax.get_images()
    pixels, looks = image.get_array(), symbol_looks(27)
    assert image.get_extent() == [0, 1, 0, 1] and image.origin == "lower"
    for row, column in np.random.default_rng(1).integers(0, 240, (400, 2)):
        look = looks[policy([(column + 0.5) / 240, (row + 0.5) / 240])]
        dot = tiles()[look.marks, (239 - row) // DOTS % TILE, column // DOTS % TILE]
        assert pixels[row, column, 3] == dot
        assert not dot or tuple(pixels[row, column, :3]) == to_rgb(look.ink)
    for cells in ax.collections:  # and the colours under them
        for path, color in zip(cells.get_paths(), cells.get_facecolor()):
            assert tuple(color[:3]) == to_rgb(looks[policy(path.vertices[:4].mean(axis=0))].color)


def test_few_symbols_have_no_marks_and_no_names(few_pixels):
    ax = plot_policy(striped(8, 8), ax=Figure().add_subplot())
    assert not ax.get_images() and not ax.texts


def test_names_stand_in_the_regions_of_their_symbols(few_pixels):
    policy = striped(10, 9, [f"v{k}" for k in range(9)] + ["$^x"])
    ax = plot_policy(policy, ax=Figure().add_subplot())
    assert len(ax.texts) == 9
    for text in ax.texts:
        assert policy.symbol_name(policy(text.get_position())) == text.get_text()
    narrow = plot_policy(striped(60, 60), ax=Figure().add_subplot())
    assert not narrow.texts  # there is no room


def test_long_names_are_numbers_that_the_legend_explains(few_pixels):
    names = [f"thruster {k}" for k in range(9)] + ["<b>$x"]
    ax = plot_policy(striped(10, 10, names), ax=Figure().add_subplot())
    assert [t.get_text() for t in ax.texts] == [f"u{k}" for k in range(1, 11)]
    texts = [t.get_text() for t in ax.get_legend().get_texts()]
    assert texts[0] == "u1: thruster 0" and texts[-1] == r"u10: <b>\$x"


@pytest.mark.parametrize(("count", "across", "named"), [(20, 20, 20), (256, 30, 30)])
def test_legends_name_what_is_drawn_in_columns(count, across, named, few_pixels):
    ax = plot_policy(striped(count, across), ax=Figure().add_subplot())
    texts = [t.get_text() for t in ax.get_legend().get_texts()]
    assert texts == [str(k) for k in range(named)]


def test_of_very_many_the_largest_are_named(few_pixels):
    policy = capsyn.subdivide(
        lambda x: np.where(x[:, 1] > 0.5, 99, np.minimum((100 * x[:, 0] + 1e-6).astype(int), 98)),
        capsyn.Box([0, 0], [1, 1]), 100, partitions=[100, 2], max_level=0,
    )  # fmt: skip
    ax = plot_policy(policy, ax=Figure().add_subplot())
    texts = [t.get_text() for t in ax.get_legend().get_texts()]
    assert len(texts) == 67 and texts[-2:] == ["99", "and 34 more"]


def test_saved_pictures_are_wide_enough_and_the_same_each_time(few_pixels, tmp_path):
    names = [f"settings number {k}" for k in range(18)]
    for name in ("one.svg", "two.svg"):
        save_policy_plot(striped(18, 18, names), tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    save_policy_plot(striped(9, 9), tmp_path / "narrow.svg")
    sizes = [
        [float(ElementTree.parse(tmp_path / f"{name}.svg").getroot().get(side)[:-2])
         for side in ("width", "height")]
        for name in ("narrow", "one")
    ]  # fmt: skip
    assert sizes[0] == [504, 324] and sizes[1][0] > 600 and sizes[1][1] == 324  # [points]


def test_a_line_is_around_the_target(few_pixels):
    ball = capsyn.Ball([0.0, 0.5], 0.2, names=["y", "x"])
    ax = plot_policy(striped(3, 3, target=ball), ax=Figure().add_subplot())
    (line,) = [c for c in ax.collections if c.get_zorder() == 3.5]
    points = np.concatenate([path.vertices for path in line.get_paths()])
    edge = points[points[:, 1] > 0.01]
    assert np.hypot(edge[:, 0] - 0.5, edge[:, 1]) == pytest.approx(0.2, abs=0.01)
    assert ax.get_legend().get_texts()[-1].get_text() == "target"
    outside = capsyn.Ball([0.0, 0.5, 0.0], 0.1)
    box = capsyn.Box([0, 0, -1], [1, 1, 1])
    policy = capsyn.subdivide(lambda x: 0 * x[:, 0].astype(int), box, 1, max_level=0)
    policy = dataclasses.replace(policy, target=outside)
    ax = plot_policy(policy, at={"x3": 0.5}, ax=Figure().add_subplot())
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["0"]  # it is elsewhere
