"""Bytes of cells whose arrays have the smallest types that hold them."""

import numpy as np

from capsyn.cells.packing import packed_bytes, smallest_type
from support.closed_loops import linear_problem, random_grid_policy
from support.split_trees import random_split_tree


def test_packed_bytes():
    for values, kind in (
        ([], "i1"),
        ([127, -128], "i1"),
        ([128], "u1"),
        ([255], "u1"),
        ([-129], "i2"),
        ([128, -1], "i2"),
        ([256], "i2"),
        ([2**15], "u2"),
        ([2**16], "i4"),
        ([-(2**31)], "i4"),
    ):
        assert smallest_type(np.array(values, dtype=np.int64)) == np.dtype(kind), values
    cells = random_split_tree((300, 7), 2, seed=1)
    one_each = cells.node_count + cells.planes.size + cells.node_count
    size = smallest_type(cells.threshold).itemsize
    assert packed_bytes(cells) == one_each + size * cells.node_count
    policy = random_grid_policy(linear_problem())
    assert packed_bytes(policy.cells) == len(policy.cells.entries)
