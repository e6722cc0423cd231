"""Labelling functions: exact and elementwise, so that no batch can change a label."""

import numpy as np

from capsyn import Box
from capsyn.cells.masks import singles, word_count
from support.references.subdivision import noise


def noisy_masks(seed, n_symbols, ties):
    """Return a function to random masks: some symbol, and with `ties` one or two more.

    Beyond 63 symbols masks are several words.
    """

    def label(states):
        words = noise(states, seed)
        masks = np.zeros((len(states), word_count(n_symbols + 1)), dtype=np.uint64)
        for shift in (3, 19, 35)[: 1 + ties]:
            symbol = (words >> np.uint64(shift)) % np.uint64(n_symbols + 1)
            masks |= singles(symbol, n_symbols + 1)
        return masks if masks.shape[1] > 1 else masks[:, 0]

    return label


def planar_masks(box, seed, n_symbols, width):
    """Return a function to masks of the greatest of affine functions, tied within a width."""
    rng = np.random.default_rng(seed)
    slopes = rng.normal(size=(n_symbols + 1, box.n))
    heights = rng.normal(size=n_symbols + 1) * 0.3

    def label(states):
        unit = (states - box.lower) / box.widths
        scores = [
            sum((slope[i] * unit[:, i] for i in range(box.n)), start=height)
            for slope, height in zip(slopes, heights)
        ]
        best = np.max(scores, axis=0)
        masks = np.zeros(len(states), dtype=np.uint64)
        for symbol, score in enumerate(scores):
            masks |= np.where(score >= best - width, np.uint64(1 << symbol), np.uint64(0))
        return masks

    return label


def halves(states):
    """Label by a slanted line through the unit square or cube; two symbols."""
    return (states[:, 0] + 0.3 * states[:, -1] > 0.613).astype(int)


def disc(states):
    """Label by the radius; three symbols and the default."""
    radius = np.sqrt(sum((states[:, i] - 0.4) ** 2 for i in range(states.shape[1])))
    return np.digitize(radius, [0.2, 0.41, 0.57]) - 1


def unit_box(n=2, periodic=None):
    return Box([0.0] * n, [1.0] * n, periodic=periodic)


def recorder(label):
    """Return the labelling function, and the list of the batches that it is given."""
    batches = []

    def recording(states):
        batches.append(states.copy())
        return label(states)

    return recording, batches


def same(a, b):
    """Return whether two policies have the same cells and counts, bit for bit."""
    names = ("entries", "mixed_cells", "mixed_labels")
    return a.statistics == b.statistics and all(
        np.array_equal(getattr(a.cells, name), getattr(b.cells, name)) for name in names
    )
