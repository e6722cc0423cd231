"""Automata of many symbols as matrices."""

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from capsyn import Alphabet, Automaton, Box, subdivide
from capsyn.plots import plot_automaton, save_automaton, symbol_looks
from support.relays import relay

matplotlib.use("Agg")
COUNT = 12


@pytest.fixture(scope="module")
def machine():
    """Return an automaton of symbols in bands, over which the loop goes, or slides."""
    alphabet = Alphabet(np.cos(np.arange(COUNT) * 2.0), names=[f"<{k}$>" for k in range(COUNT)])
    edges = np.linspace(-2, 2, COUNT + 1)[1:-1] - 1e-9
    box = Box([-2, -1], [2, 1])
    policy = relay(
        lambda x, u: [u[0], 1.0], box, lambda x: np.digitize(x[:, 0], edges), alphabet,
        partitions=[COUNT, 1],
    )  # fmt: skip
    return Automaton.of(policy)


def test_the_matrix_has_an_edge_at_every_place(machine):
    ax = plot_automaton(machine, Figure().add_subplot())
    (image,) = ax.get_images()
    pixels, looks = image.get_array(), symbol_looks(COUNT)
    cell = len(pixels) // (COUNT + 1)
    assert image.get_extent() == [-1, COUNT, COUNT, -1]

    def colors(row, column):
        part = pixels[(row + 1) * cell : (row + 2) * cell, (column + 1) * cell :][:, :cell]
        return {tuple(np.round(color, 9)) for color in part.reshape(-1, 3)}

    def look(k):
        kept = {looks[k].color, looks[k].ink} if looks[k].marks else {looks[k].color}
        return {tuple(np.round(to_rgb(color), 9)) for color in kept}

    kinds = set()
    for edge in machine.edges:
        kinds.add(edge.possible)
        wanted = look(edge.target) if edge.possible else {(1, 1, 1)}
        assert edge.possible is not None and colors(edge.source, edge.target) == wanted
    assert kinds == {True, False}
    for k in range(COUNT):
        assert colors(-1, k) == colors(k, -1) == look(k)
    marks = {line.get_marker(): line for line in ax.get_lines() if line.get_marker() in ("x", "*")}
    for marker, wanted in (("x", [e for e in machine.edges if e.possible is False]),
                           ("*", [e for e in machine.edges if e.sliding])):  # fmt: skip
        places = np.transpose(marks[marker].get_data())
        assert wanted and {(int(x), int(y)) for x, y in places} == {
            (edge.target, edge.source) for edge in wanted
        }
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names == [rf"<{k}\$>" for k in range(COUNT)]
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["impossible", "chatters somewhere"]


def test_without_a_model_all_is_faint():
    policy = subdivide(
        lambda x: np.minimum((30 * x[:, 0]).astype(int), 29), Box([0, 0], [1, 1]), 30,
        partitions=[30, 1], max_level=0,
    )  # fmt: skip
    ax = plot_automaton(Automaton.of(policy), Figure().add_subplot())
    pixels = ax.get_images()[0].get_array()
    cell = len(pixels) // 31
    assert pixels[2 * cell :, cell : 2 * cell].min() > 0.59  # switches to blue
    assert "without a model" in ax.get_legend().get_texts()[0].get_text()


def test_pictures_of_matrices_are_the_same_each_time(machine, tmp_path):
    for name in ("one.svg", "two.svg"):
        save_automaton(machine, tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
