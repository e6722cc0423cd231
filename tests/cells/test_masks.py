"""Sets of symbols as bit masks, against Python's integers."""

import numpy as np
import pytest

from capsyn.cells.masks import holds, masks_of_members, members


@pytest.mark.parametrize("bits", [8, 16, 32, 64])
def test_members_are_the_bits_of_a_mask(bits):
    dtype = np.dtype(f"uint{bits}")
    masks = np.random.default_rng(bits).integers(2**bits, size=200, dtype=dtype)
    wanted = [[mask >> k & 1 == 1 for k in range(bits)] for mask in masks.tolist()]
    found = members(masks, bits)
    assert found.tolist() == wanted
    assert np.array_equal(members(masks.reshape(20, 10), bits), found.reshape(20, 10, bits))
    assert masks_of_members(found).tolist() == masks.tolist()
    symbols = np.arange(200) % bits
    assert holds(masks, symbols).tolist() == [w[k] for w, k in zip(wanted, symbols)]
