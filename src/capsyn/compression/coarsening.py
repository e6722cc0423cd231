"""A policy as it would be with fewer levels."""

from __future__ import annotations

import dataclasses

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.compression.freedom import allowed_masks
from capsyn.errors import ProblemError
from capsyn.policies.policy import Policy, cell_tree


def cut_off(policy: Policy, level: int) -> Policy:
    """Return a policy whose cells below a level are merged into their parents at that level.

    Such a cell gets the label that takes most of its volume, of equals the first; it is mixed, with
    all labels that are in it or were seen in it.
    """
    cells = cell_tree(policy)
    if cells.affine is not None:
        raise ProblemError(f"`policy` must have constant leaves only; {policy!r} has affine leaves")
    labels = len(policy.alphabet) + 1
    leaf = np.where(cells.entries < 0, -1 - cells.entries, 0)
    masks = allowed_masks(policy, True)
    volumes = np.zeros((len(leaf), labels))
    leaves = list(cells.leaves())
    least = np.min([x.sizes.min(axis=0) for x in leaves if len(x.places)], axis=0)
    for x in leaves:  # whole numbers, so that equals are equal
        volumes[x.places, leaf[x.places]] = np.prod(x.sizes // least, axis=1, dtype=float)
    layers = [layer.places for layer in cells.levels()]
    for places, children in reversed(list(zip(layers[level:], layers[level + 1 :]))):
        blocks = places[cells.entries[places] >= 0]
        starts = cells.entries[blocks] - children[0]
        volumes[blocks] = np.add.reduceat(volumes[children], starts)
        masks[blocks] = np.bitwise_or.reduceat(masks[children], starts)
    kept = np.concatenate(layers[: level + 1])
    last = layers[level] if level < len(layers) else kept[:0]
    entries = cells.entries[: len(kept)].copy()  # levels follow each other
    merged = last[cells.entries[last] >= 0]
    entries[merged] = -1 - volumes[merged].argmax(axis=1)
    mixed = np.sort(np.concatenate([cells.mixed_cells[cells.mixed_cells < len(kept)], merged]))
    tree = CellTree(
        cells.grid.at(min(level, cells.max_level)),
        entries,
        mixed.astype(np.int32),
        masks[mixed, None],
        splits=None
        if cells.splits is None
        else np.where(entries < 0, 0, cells.splits[: len(kept)]),
    )
    return dataclasses.replace(policy, cells=tree, statistics={}, evidence={}, timings={})
