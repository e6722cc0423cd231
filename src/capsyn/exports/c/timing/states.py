"""States among which is one whose decision takes longest.

The time of a tree's decision is that of the path through it: comparisons of integers take the same
time whatever they compare, so that a state of each leaf has them all, and steps beyond the lattice
go the way of the nearest. A grid's decision has no path, but a branch for where a step lies on each
axis and a shift for the place of a label in its byte. Where a tree has oblique splits, steps
beyond the lattice take a branch on each axis before it, and leaves have no boxes to take a state
from: then every step of a small lattice is looked at, or random ones of a larger, of which nobody
knows that they miss no leaf or branch.
"""

from __future__ import annotations

import math

import numpy as np

from capsyn.cells.split_tree import SplitTree
from capsyn.random_streams import stream

MOST = 20_000
"""States that are tried at most: of a tree with more leaves those of the deepest."""
SAMPLES = 1 << 18
"""Random states of a lattice, and the most of its states that are looked at one by one."""
TIMING = 11
"""Purpose of the random states."""


def longest_steps(tree: SplitTree, style: str) -> tuple[np.ndarray, bool]:
    """Return lattice steps (K, n), the deepest leaves first, and whether none takes longer."""
    counts = np.array(tree.counts)
    if style != "grid" and not tree.has_planes:
        boxes = tree.boxes()
        order = np.argsort(-tree.depths[boxes.places], kind="stable")
        return boxes.lower[order][:MOST], len(order) <= MOST
    every = math.prod(c + 2 for c in tree.counts) <= SAMPLES
    if every:
        steps = np.indices([count + 2 for count in tree.counts]).reshape(tree.n, -1).T - 1
    else:
        steps = stream(0, TIMING).integers(-1, counts + 1, size=(SAMPLES, tree.n))
    steps = steps[np.argsort(((steps < 0) | (steps >= counts)).any(axis=1), kind="stable")]
    branches = (steps > 0).astype(np.int64) + (steps >= counts)
    within = np.clip(steps, 0, counts - 1)
    if style == "grid":
        place = np.ravel_multi_index(tuple(within.T), tree.counts) % 8
    else:
        place = tree.find(within)
    _, first = np.unique(np.column_stack([place, branches]), axis=0, return_index=True)
    first.sort()  # those in the lattice first
    steps, place = steps[first], place[first]
    if style != "grid":
        steps = steps[np.argsort(-tree.depths[place], kind="stable")]
    return steps[:MOST], every and len(steps) <= MOST
