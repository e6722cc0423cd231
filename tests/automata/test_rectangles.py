"""The fewest rectangles: as few as trying everything finds, on every small image."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn.automata import rectangles
from capsyn.automata.rectangles import fewest_rectangles


def fewest_by_trying(image):
    """Return the fewest rectangles that tile an image, by trying all at its first cell."""
    height, width = image.shape

    @functools.cache
    def fewest(cells):
        if not cells:
            return 0
        row, column = divmod((cells & -cells).bit_length() - 1, width)
        best, widest = image.size, width - column
        for tall in range(1, height - row + 1):
            start = (row + tall - 1) * width + column
            wide = 0
            while wide < widest and cells >> (start + wide) & 1:
                wide += 1
            widest = wide
            for wide in range(1, widest + 1):
                line = ((1 << wide) - 1) << column
                taken = sum(line << (row + k) * width for k in range(tall))
                best = min(best, 1 + fewest(cells & ~taken))
        return best

    return fewest(sum(1 << k for k in np.flatnonzero(image).tolist()))


def painted(lower, upper, shape):
    image = np.zeros(shape, dtype=int)
    for low, high in zip(lower, upper):
        image[tuple(map(slice, low, high))] += 1
    return image


@settings(max_examples=150)
@given(st.data())
def test_no_tiling_has_fewer(data):
    height, width = data.draw(st.integers(1, 5)), data.draw(st.integers(1, 5))
    holes = data.draw(st.sets(st.integers(0, height * width - 1), max_size=12))
    image = np.ones(height * width, dtype=bool)
    image[list(holes)] = False
    image = image.reshape(height, width)
    lower, upper = fewest_rectangles(image)
    assert np.array_equal(painted(lower, upper, image.shape), image.astype(int))
    assert len(lower) == fewest_by_trying(image)


@pytest.mark.parametrize(
    ("rows", "count"),
    [
        (["111", "111"], 1),
        (["000"], 0),
        (["110", "011"], 2),
        (["010", "111", "010"], 3),
        (["111", "101", "111"], 4),
        (["1001", "1111", "1111", "1001"], 3),  # two chords that serve two corners each
        (["10", "01"], 2),
    ],
)
def test_known_shapes(rows, count):
    image = np.array([[c == "1" for c in row] for row in rows])
    assert len(fewest_rectangles(image)[0]) == count


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_large_images_are_tiled(share):
    image = np.random.default_rng(0).random((150, 120)) < share
    lower, upper = fewest_rectangles(image)
    assert np.array_equal(painted(lower, upper, image.shape), image.astype(int))


def test_without_chords_the_tiling_is_still_one(monkeypatch):
    image = np.random.default_rng(1).random((40, 50)) < 0.9
    fewest = len(fewest_rectangles(image)[0])
    monkeypatch.setattr(rectangles, "MAX_PAIRS", -1)
    lower, upper = fewest_rectangles(image)
    assert np.array_equal(painted(lower, upper, image.shape), image.astype(int))
    assert len(lower) >= fewest
