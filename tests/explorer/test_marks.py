"""Many symbols on the page: marks over their colours, as in pictures."""

import numpy as np

from capsyn import Alphabet, Box, subdivide
from capsyn.explorer.page_data import page_data
from capsyn.policies.colors import TILE, symbol_looks, tiles
from support.explorer.page import hex_color

DOT = 2
DARK, WHITE = (0x15, 0x18, 0x1D), (255, 255, 255)


def bands(count, used):
    """Return a policy of so many symbols, of which some are bands of x."""
    names = [f"s{k}" for k in range(count)]
    return subdivide(
        lambda x: np.minimum((used * x[:, 0]).astype(int), used - 1),
        Box([0, 0], [1, 1]),
        Alphabet(np.arange(count), names=names),
        partitions=[used, 1],
        max_level=0,
    )


def test_many_symbols_have_marks_on_the_map_and_in_the_legend(show):
    policy = bands(40, 30)
    shown = show(policy)
    shown.page.uncheck("#outlines")
    shares = np.random.default_rng(3).uniform(0.01, 0.99, (600, 2))
    pixels, states = shown.colors(shares)
    frame, scale = shown.state["frame"], 1
    colors, looks = shown.state["colors"], symbol_looks(40)
    right = 0
    for pixel, (x, y) in zip(pixels, states):
        symbol = policy([x, y])
        column = int(x * round(frame["width"] * scale))
        row = int((1 - y) * round(frame["height"] * scale))
        marked = tiles()[looks[symbol].marks, row // DOT % TILE, column // DOT % TILE]
        color = hex_color(colors[symbol])
        light = np.dot(color, [0.299, 0.587, 0.114]) >= 140
        right += tuple(pixel) == (tuple(color) if not marked else DARK if light else WHITE)
    assert right > 0.99 * len(pixels)  # a centre may round to the other side of a face
    keys = shown.page.locator("#legend .key")
    assert keys.all_inner_texts() == [f"s{k}" for k in range(30)]  # those that occur
    assert keys.locator("canvas").count() == 22
    assert shown.page.locator("#automaton pattern").count() == 22
    names = shown.page.locator("#automaton .vertex .name").all_text_contents()
    assert names == [f"s{k}" for k in range(30)]


def test_the_looks_of_a_page_are_those_of_pictures():
    told = page_data(bands(40, 3))["looks"]
    assert told == [[look.color, look.marks] for look in symbol_looks(40)]
