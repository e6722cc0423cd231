"""A policy as it would be with fewer levels."""

from __future__ import annotations

import dataclasses

import numpy as np

from capsyn.cells.cell_tree import CellTree, ragged
from capsyn.cells.masks import singles
from capsyn.cells.row_table import ROOM
from capsyn.errors import ProblemError
from capsyn.policies.policy import Policy, cell_tree


def cut_off(policy: Policy, level: int) -> Policy:
    """Return a policy whose cells below a level are merged into their parents at that level.

    Such a cell gets the row that takes most of its volume, of equals the first; it is mixed, with
    all labels that are in it or were seen in it, for each label in force.
    """
    cells = cell_tree(policy)
    if cells.affine is not None:
        raise ProblemError(f"`policy` must have constant leaves only; {policy!r} has affine leaves")
    layers = [layer.places for layer in cells.levels()]
    kept = np.concatenate(layers[: level + 1])
    last = layers[level] if level < len(layers) else kept[:0]
    entries = cells.entries[: len(kept)].copy()  # levels follow each other
    merged = last[cells.entries[last] >= 0]
    leaves, into = _leaves_within(cells, merged)
    entries[merged] = -1 - _largest(cells, leaves, into, len(policy.transitions))
    own = cells.mixed_cells < len(kept)
    mixed = np.concatenate([cells.mixed_cells[own], merged])
    seen = np.concatenate([cells.mixed_labels[own], _seen(policy, leaves, into, len(merged))])
    order = np.argsort(mixed)
    tree = CellTree(
        cells.grid.at(min(level, cells.max_level)),
        entries,
        mixed[order].astype(np.int32),
        seen[order],
        splits=None
        if cells.splits is None
        else np.where(entries < 0, 0, cells.splits[: len(kept)]),
    )
    return dataclasses.replace(
        policy, cells=tree, kept=None, statistics={}, evidence={}, timings={}
    )


def _leaves_within(cells: CellTree, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the leaf entries (L,) within blocks (K,) of one level, and the block of each."""
    found, within, active = [], [], np.arange(len(blocks))
    places = blocks
    while len(places):
        counts = np.prod(cells.factors(places), axis=1, dtype=np.int64)
        block, child = ragged(counts)
        places, active = cells.entries[places][block] + child, active[block]
        leaf = cells.entries[places] < 0
        found.append(places[leaf])
        within.append(active[leaf])
        places, active = places[~leaf], active[~leaf]
    none = np.empty(0, dtype=np.int64)
    return np.concatenate([none, *found]), np.concatenate([none, *within])


def _largest(cells: CellTree, leaves: np.ndarray, into: np.ndarray, rows: int) -> np.ndarray:
    """Return the row (K,) with most volume of each block that leaf entries (L,) lie in."""
    if not len(leaves):
        return leaves
    volumes = np.zeros(len(cells.entries))
    sizes = [x for x in cells.leaves() if len(x.places)]
    least = np.min([x.sizes.min(axis=0) for x in sizes], axis=0)
    for x in sizes:  # whole numbers, so that equals are equal
        volumes[x.places] = np.prod(x.sizes // least, axis=1, dtype=float)
    pairs, place = np.unique(into * rows + cells.labels_at(leaves), return_inverse=True)
    total = np.bincount(place.ravel(), volumes[leaves])
    block, row = np.divmod(pairs, rows)
    order = np.lexsort([row, -total, block])
    return np.asarray(row[order[np.unique(block, return_index=True)[1]]])


def _seen(policy: Policy, leaves: np.ndarray, into: np.ndarray, blocks: int) -> np.ndarray:
    """Return the labels (K, J, W) that leaf entries (L,) in blocks have, or were seen there."""
    cells, labels = cell_tree(policy), len(policy.alphabet) + 1
    _, in_force, words = cells.mixed_labels.shape
    seen = np.zeros((blocks, in_force, words), dtype=np.uint64)
    size = max(1, ROOM // (8 * in_force * words))
    for start in range(0, len(leaves), size):
        some = slice(start, start + size)
        own = policy.transitions[cells.labels_at(leaves[some]), :in_force]
        np.bitwise_or.at(seen, into[some], singles(own, labels))
    place = np.full(len(cells.entries), -1)
    place[leaves] = into
    mixed = place[cells.mixed_cells]
    inside = mixed >= 0
    np.bitwise_or.at(seen, mixed[inside], cells.mixed_labels[inside])
    return seen
