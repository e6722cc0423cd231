"""Cuts: cells, or a decision tree, of the first axes while the lattice steps of the last stay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from capsyn.cells.affine_leaves import AffineLeaves
from capsyn.cells.boxes import digits_of, number_of, ragged
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import Features, FeatureTree
from capsyn.cells.split_tree import LEAF, SplitTree, depth_first
from capsyn.modelling.grid import Grid
from capsyn.programs.builder import restricted, selected


def cut(cells: CellTree | SplitTree, steps: np.ndarray) -> CellTree | SplitTree:
    """Return cells of the axes before the last k, those of `cells` at steps (k,) of the last ones.

    Every lattice step of what is left has the leaf, symbols, and mixed labels that it has there.
    """
    if isinstance(cells, CellTree):
        return _cut_cells(cells, steps)
    if isinstance(cells, FeatureTree):
        return _cut_features(cells, steps)
    n = cells.n - len(steps)
    return _followed(cells, cells.counts[:n], range(n), dict(zip(range(n, cells.n), steps)))


def _cut_cells(tree: CellTree, steps: np.ndarray) -> CellTree:
    """Return the cut through a grid of trees, level by level, in the order of its entries.

    Cells that are split along none of the axes left give way to their one child that is cut.
    """
    n = tree.n - len(steps)
    grid = Grid(tree.grid.partitions[:n], tree.grid.refinement[:n], tree.max_level)
    root = tree.sizes(0)
    low = digits_of(np.arange(grid.roots), np.tile(grid.partitions, (grid.roots, 1)))
    fixed = np.tile(steps // root[n:], (grid.roots, 1))
    shape = np.tile(tree.partitions, (grid.roots, 1))
    places = number_of(np.hstack([low, fixed]), shape)
    rest = np.tile(steps % root[n:], (grid.roots, 1))  # of the steps, in the cells
    sizes = np.tile(root[n:], (grid.roots, 1))
    layers: list[np.ndarray] = []  # old places, in the order of the new entries
    blocks: list[np.ndarray] = []  # offsets of new blocks, or -1 for leaves
    splits: list[np.ndarray] = []
    end = grid.roots
    while len(places):
        factors = np.where(tree.entries[places] < 0, 1, 0)[:, None] + np.zeros((1, tree.n), int)
        inner = np.flatnonzero(tree.entries[places] >= 0)
        while inner.size:  # down through cells that are split along exogenous axes alone
            factors[inner] = tree.factors(places[inner])
            alone = inner[(factors[inner, :n] == 1).all(axis=1)]
            child, rest[alone], sizes[alone] = _children(
                tree, places[alone], factors[alone], rest[alone], sizes[alone], n
            )
            places[alone] = child
            factors[alone] = 1
            inner = alone[tree.entries[child] >= 0]
        split = np.flatnonzero(tree.entries[places] >= 0)
        counts = np.prod(factors[split, :n], axis=1)
        offsets = np.full(len(places), -1, dtype=np.int64)
        offsets[split] = end + np.cumsum(counts) - counts
        end += int(counts.sum())
        layers.append(places)
        blocks.append(offsets)
        if tree.splits is not None:
            mask = np.zeros(len(places), dtype=np.uint16)
            mask[split] = tree.splits[places[split]] & np.uint16((1 << n) - 1)
            splits.append(mask)
        parent, number = ragged(counts)
        above = split[parent]
        digits = digits_of(number, factors[above, :n])
        places, rest, sizes = _children(
            tree, places[above], factors[above], rest[above], sizes[above], n, digits
        )
    old, offsets = np.concatenate(layers), np.concatenate(blocks)
    leaves = -1 - tree.entries[old].astype(np.int64)
    affine = tree.affine
    if affine is not None:
        affine, leaves = _cut_rows(affine, np.where(offsets < 0, leaves, -1), steps)
    entries = np.where(offsets < 0, -1 - leaves, offsets).astype(np.int32)
    where = np.searchsorted(tree.mixed_cells, old)
    where = np.minimum(where, max(0, len(tree.mixed_cells) - 1))
    known = np.zeros(len(old), dtype=bool)
    if len(tree.mixed_cells):
        known = (offsets < 0) & (tree.mixed_cells[where] == old)
    mixed = np.flatnonzero(known).astype(np.int32)
    along = np.concatenate(splits) if splits else None
    return CellTree(grid, entries, mixed, tree.mixed_labels[where[known]], affine, along)


def _children(
    tree: CellTree,
    places: np.ndarray,
    factors: np.ndarray,
    rest: np.ndarray,
    sizes: np.ndarray,
    n: int,
    digits: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the children of split cells (M,) that the cut meets, what is left, and their sizes.

    `digits` (M, n) are their numbers along the first axes, by default 0.
    """
    sizes = sizes // factors[:, n:]
    fixed, rest = np.divmod(rest, sizes)
    first = np.zeros((len(places), n), dtype=np.int64) if digits is None else digits
    return tree.entries[places] + number_of(np.hstack([first, fixed]), factors), rest, sizes


def _cut_rows(
    affine: AffineLeaves, leaves: np.ndarray, steps: np.ndarray
) -> tuple[AffineLeaves | None, np.ndarray]:
    """Return the affine leaves among leaf numbers (M,), -1 for none, and all numbers anew."""
    here = np.flatnonzero(leaves >= affine.first)
    if not len(here):
        return None, leaves
    used = leaves[here] - affine.first
    leaves = leaves.copy()
    leaves[here] = affine.first + np.arange(len(here))
    counts = np.diff(affine.starts)[used]
    leaf, number = ragged(counts)
    rows = affine.starts[used][leaf] + number
    n = affine.slopes.shape[1] - len(steps)
    constants = affine.constants[rows] + affine.slopes[rows, n:].astype(np.int64) @ steps
    prices = None if affine.prices is None else affine.prices[used]
    kept = AffineLeaves.of(
        affine.first, counts, affine.symbols[rows], constants.astype(np.int32),
        affine.slopes[rows, :n], prices, affine.ratios,
    )  # fmt: skip
    return kept, leaves


def _followed(
    tree: SplitTree, counts: tuple[int, ...], free: Sequence[int], fixed: dict[int, Any]
) -> SplitTree:
    """Return the tree on its axes `free`, in their order, while those of `fixed` have values.

    The others are compared nowhere. Comparisons whose result does not depend on the axes left are
    made; planes that are left with one axis become splits of it.
    """
    number = {axis: k for k, axis in enumerate(free)}
    last = np.array(counts, dtype=np.int64) - 1

    def settled(node: int) -> tuple[int, Any, int, bool]:
        """Return the next node that still compares, or a leaf: node, split, threshold, swapped."""
        while True:
            axis, threshold = int(tree.split[node]), int(tree.threshold[node])
            if axis == LEAF:
                return node, LEAF, threshold, False
            if axis < tree.n and axis in number:
                return node, number[axis], threshold, False
            if axis < tree.n:
                beyond = bool(fixed[axis] >= threshold)
            else:
                plane = tree.planes[axis - tree.n].astype(np.int64)
                threshold -= int(sum(plane[i] * value for i, value in fixed.items()))
                left = plane[list(free)]
                least, most = (int(part(left, 0) @ last) for part in (np.minimum, np.maximum))
                if least < threshold <= most:
                    axes = np.flatnonzero(left)
                    if len(axes) > 1:
                        return node, left, threshold, False
                    k, c = int(axes[0]), int(left[axes[0]])
                    if c > 0:  # c z >= t where z >= ceil(t / c)
                        return node, k, -(-threshold // c), False
                    return node, k, threshold // c + 1, True  # where z < floor(t / c) + 1
                beyond = threshold <= least
            node = int(tree.second[node] if beyond else tree.first[node])

    def look(node: int) -> tuple[Any, int, Sequence[int]]:
        node, split, threshold, swapped = settled(node)
        if isinstance(split, int) and split == LEAF:
            return LEAF, threshold, ()
        children = (int(tree.first[node]), int(tree.second[node]))
        return split, threshold, children[::-1] if swapped else children

    return depth_first(counts, 0, look)


def _cut_features(tree: FeatureTree, steps: np.ndarray) -> SplitTree:
    """Return the cut through a tree with features, of those that are still in a split."""
    n, features = tree.n - len(steps), tree.features
    ranks = features.rank_counts
    free = [*range(n), *range(tree.n, tree.n + len(ranks))]
    counts = tree.counts[:n]
    ranked = _followed(tree.ranked, (*counts, *ranks), free, dict(zip(range(n, tree.n), steps)))
    used = [
        k
        for k in range(len(ranks))
        if (ranked.split == n + k).any() or ranked.planes[:, n + k].any()
    ]
    left = [*range(n), *(n + k for k in used)]
    ranked = _followed(ranked, (*counts, *(ranks[k] for k in used)), left, {})
    if not used:
        return ranked
    ((name, _),), ((values, _),) = features.program.inputs, features.program.outputs
    program = restricted(features.program, ((name, n),), ((values, len(ranks)),), {name: steps})
    kept = Features(
        tuple(features.names[k] for k in used), selected(program, used),
        tuple(features.thresholds[k] for k in used), features.margin,
    )  # fmt: skip
    return FeatureTree.of(counts, ranked, kept)
