"""Sets of symbols as bit masks, against Python's sets."""

import numpy as np
import pytest

from capsyn.cells.masks import (
    empty,
    holds,
    masks_of_members,
    members,
    most_voted,
    or_else,
    preferred,
    several,
    singles,
    word_count,
    word_type,
)

COUNTS = [3, 8, 9, 31, 33, 64, 65, 129, 257]


def random_sets(count, shape, seed=0):
    """Return sets, and what they hold as booleans (..., count)."""
    held = np.random.default_rng(seed).random((*shape, count)) < 1.5 / count
    sets = masks_of_members(held)
    return sets.astype(word_type(count)), held


@pytest.mark.parametrize("bits", [8, 16, 32, 64])
def test_members_are_the_bits_of_a_mask(bits):
    dtype = np.dtype(f"uint{bits}")
    masks = np.random.default_rng(bits).integers(2**bits, size=200, dtype=dtype)
    wanted = [[mask >> k & 1 == 1 for k in range(bits)] for mask in masks.tolist()]
    found = members(masks[:, None], bits)
    assert found.tolist() == wanted
    assert np.array_equal(members(masks.reshape(20, 10, 1), bits), found.reshape(20, 10, bits))
    assert masks_of_members(found)[:, 0].tolist() == masks.tolist()
    symbols = np.arange(200) % bits
    assert holds(masks[:, None], symbols).tolist() == [w[k] for w, k in zip(wanted, symbols)]


@pytest.mark.parametrize("count", COUNTS)
def test_sets_of_any_number_of_symbols_are_sets(count):
    sets, held = random_sets(count, (40, 25))
    assert sets.shape == (40, 25, word_count(count))
    assert np.array_equal(members(sets, count), held)
    assert np.array_equal(empty(sets), ~held.any(axis=-1))
    assert np.array_equal(several(sets), held.sum(axis=-1) > 1)
    symbols = np.random.default_rng(1).integers(count, size=(40, 25))
    own = np.take_along_axis(held, symbols[..., None], axis=-1)[..., 0]
    assert np.array_equal(holds(sets, symbols), own)
    assert np.array_equal(
        members(singles(symbols, count), count), np.eye(count, dtype=bool)[symbols]
    )
    filled = members(or_else(sets, count - 1), count)
    assert np.array_equal(filled[~empty(sets)], held[~empty(sets)])
    assert (filled[empty(sets)].sum(axis=-1) == 1).all() and filled[empty(sets), -1].all()


@pytest.mark.parametrize("count", COUNTS)
def test_the_preferred_symbol_comes_first_in_the_order(count):
    sets, held = random_sets(count, (500,), 2)
    order = np.random.default_rng(3).permutation(count).tolist()
    found = preferred(sets, order)
    for row, label in zip(held, found.tolist()):
        if row.any():
            assert label == next(k for k in order if row[k])


@pytest.mark.parametrize("count", COUNTS)
def test_votes_are_those_of_points_and_ties_go_by_order(count):
    sets, held = random_sets(count, (7, 300), 4)
    order = np.random.default_rng(5).permutation(count).tolist()
    labels, _, seen = most_voted(sets, order)
    for cell in range(300):
        points = [set(np.flatnonzero(row).tolist()) for row in held[:, cell]]
        known = set().union(*(p for p in points if len(p) == 1)) or set().union(*points)
        assert set(np.flatnonzero(members(seen[cell], count)).tolist()) == known
        if known:
            votes = {k: sum(k in p for p in points) for k in known}
            best = [k for k in order if votes.get(k) == max(votes.values())]
            assert labels[cell] == best[0]
