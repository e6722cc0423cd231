"""A policy as it would be with fewer levels."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from capsyn.cells import CellTree
from capsyn.errors import ProblemError
from capsyn.policy import Policy, cell_tree


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
    masks = np.where(cells.entries < 0, np.uint64(1) << leaf.astype(np.uint64), np.uint64(0))
    masks[cells.mixed_cells] |= cells.mixed_labels
    volumes = np.zeros((len(leaf), labels))
    children = math.prod(cells.refinement)
    below = list(cells.levels())
    for k, places, _ in below:  # in finest cells: whole numbers, so that equals are equal
        inside = places[cells.entries[places] < 0]
        volumes[inside, leaf[inside]] = float(children) ** (len(below) - 1 - k)
    for _, places, _ in reversed(below[level:]):  # children before their parents
        blocks = places[cells.entries[places] >= 0]
        if not len(blocks):  # of a policy without blocks the refinement may be any number
            continue
        inside = cells.entries[blocks][:, None] + np.arange(children)
        volumes[blocks] = volumes[inside].sum(axis=1)
        masks[blocks] = np.bitwise_or.reduce(masks[inside], axis=1)
    kept = np.concatenate([places for _, places, _ in below[: level + 1]])
    last = below[level][1] if level < len(below) else kept[:0]
    entries = cells.entries[: len(kept)].copy()  # levels follow each other
    merged = last[cells.entries[last] >= 0]
    entries[merged] = -1 - volumes[merged].argmax(axis=1)
    mixed = np.sort(np.concatenate([cells.mixed_cells[cells.mixed_cells < len(kept)], merged]))
    tree = CellTree(
        cells.partitions,
        cells.refinement,
        min(level, cells.max_level),
        entries,
        mixed.astype(np.int32),
        masks[mixed],
    )
    return dataclasses.replace(policy, cells=tree, statistics={}, evidence={}, timings={})
