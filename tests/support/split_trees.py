"""Decision trees over lattices, made at random, and the rule of their lookup written out."""

import math

import numpy as np

from capsyn import Alphabet, Box, DecisionTree
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.policies.guarantee import Guarantee

LABELS = 3
BOXED = [(1,), (19,), (12, 7), (30, 1), (5, 6, 4), (3, 4, 3, 5), (2,) * 14]
"""Lattices of trees over boxes; see `tree_of`."""


def random_split_tree(counts, planes=0, labels=LABELS, depth=6, seed=0):
    """Return a tree with random splits, some of them of no effect.

    Oblique ones have one of `planes` normals, and may lie beyond the lattice.
    """
    rng, n = np.random.default_rng(seed), len(counts)
    coefficients = rng.integers(-4, 5, (planes, n)).astype(np.int32)
    rows, used = [], []

    def grow(left):
        here = len(rows)
        split = int(rng.integers(n + planes))
        if not left or (here and rng.random() < 0.2) or (split < n and counts[split] == 1):
            rows.append([LEAF, rng.integers(labels), here])
            return
        if split < n:
            cut = rng.integers(1, counts[split])
        else:
            cut = coefficients[split - n] @ rng.integers(counts)
            cut += (rng.random() < 0.1) * rng.integers(-3, 4) * max(counts)
            used.append(coefficients[split - n])
            split = n + len(used) - 1
        rows.append([split, cut, 0])
        grow(left - 1)
        rows[here][2] = len(rows)
        grow(left - 1)

    grow(depth)
    used = np.array(used, dtype=np.int32).reshape(-1, n)
    return SplitTree(tuple(counts), *np.array(rows, dtype=np.int32).T.copy(), used)


def all_points(counts):
    return np.stack(np.unravel_index(np.arange(math.prod(counts)), counts), axis=1)


def leaf_of(tree, z, node=0):
    """Return the leaf of one lattice point, as the rule is written, and the nodes on the way."""
    if tree.split[node] == LEAF:
        return node, [node]
    split = int(tree.split[node])
    values = [*z, *(sum(int(a) * int(b) for a, b in zip(row, z)) for row in tree.planes)]
    beyond = values[split] >= tree.threshold[node]
    leaf, way = leaf_of(tree, z, int(tree.second[node]) if beyond else node + 1)
    return leaf, [node, *way]


SOURCE = "0" * 64


def guarantee(mode="exact", **known):
    return Guarantee(mode, SOURCE, **known)


def tree_of(counts, planes=0, periodic=0, seed=0, depth=6, **changes):
    """Return a tree over a box with bounds that do not divide; `periodic`: none, some, all."""
    rng, n = np.random.default_rng(seed), len(counts)
    lower = rng.normal(size=n)
    turning = [[False] * n, [i % 2 == 0 for i in range(n)], [True] * n][periodic]
    domain = Box(lower, lower + rng.uniform(0.1, 7, n), periodic=turning)
    cells = changes.pop("cells", None)
    cells = cells or random_split_tree(counts, planes, depth=depth, seed=seed)
    made = guarantee("linear" if planes else "exact")
    fields = {"default": np.zeros(1), "cells": cells, "guarantee": made}
    return DecisionTree("tree", domain, Alphabet([-1, 1]), **fields | changes)
