"""States among which is one whose decision takes longest.

The time of a tree's decision is that of the path through it: comparisons of integers take the same
time whatever they compare, so that a state of each leaf has them all, and steps beyond the lattice
go the way of the nearest. A table that is a diagram has the paths of the tree that it stands for;
of one that is half of a tree, reflections of steps have paths of their own. A grid's decision has
no path, but a branch for where a step lies on each axis and a shift for the place of a label in its
byte. Where a tree has oblique splits, steps beyond the lattice take a branch on each axis before
it, and leaves have no boxes to take a state from: then every step of a small lattice is looked at,
or random ones of a larger, of which nobody knows that they miss no leaf or branch. In cells as they
are the time is that of their leaf's level and rows, and of how often a row beats those before it:
of leaves with most rows that step is taken, of some random ones, where it is most often.
"""

from __future__ import annotations

import math

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.cells.work import heaviest_leaves
from capsyn.exports.c.styles.mirrors import Mirror
from capsyn.exports.c.styles.stream import stream
from capsyn.random_streams import stream as random_stream

MOST = 20_000
"""States that are tried at most: of a tree with more leaves those of the deepest."""
SAMPLES = 1 << 18
"""Random states of a lattice, and the most of its states that are looked at one by one."""
TIMING = 11
"""Purpose of the random states."""
MOST_LEAVES, TRIES = 4000, 64
"""Affine leaves in which steps are tried, and how many in each."""


def _of_cells(cells: CellTree) -> tuple[np.ndarray, bool]:
    """Return those of cells."""
    leaves = heaviest_leaves(cells)
    counts = np.array(cells.counts)
    steps = _with_neighbours(leaves.lower, leaves.lower + leaves.sizes, counts)
    if cells.affine is None:
        return steps[:MOST], len(steps) <= MOST
    many = slice(0, min(MOST_LEAVES, int(np.count_nonzero(leaves.rows))))
    sizes, lower = leaves.sizes[many], leaves.lower[many]
    tried = lower + random_stream(0, TIMING).integers(sizes, size=(TRIES, *sizes.shape))
    leaf = np.broadcast_to(cells.labels_at(leaves.places[many]), tried.shape[:2])
    rises = cells.affine.rises(leaf.ravel(), tried.reshape(-1, cells.n))
    best = rises.reshape(tried.shape[:2]).argmax(axis=0)
    steps = np.concatenate([tried[best, np.arange(len(lower))], steps])
    return steps[:MOST], False


def _with_neighbours(lower: np.ndarray, upper: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return steps (5 M, n) of boxes (M, n), and such that go to them from beyond the lattice.

    On an axis steps before the lattice, in it and beyond take branches of their own; those of an
    axis cost the same whatever the others do, so that all of a kind or none are the longest.
    """
    first, last = lower == 0, upper == counts
    before, beyond = np.where(first, -1, lower), np.where(last, counts, lower)
    both = np.where(first, -1, beyond), np.where(last, counts, before)
    return np.stack([lower, before, beyond, *both], axis=1).reshape(-1, lower.shape[1])


def longest_steps(
    tree: CellTree | SplitTree, style: str, of_rows: bool = False
) -> tuple[np.ndarray, bool]:
    """Return lattice steps (K, n) and whether none takes longer than all of them.

    Deep leaves come first, of cells those with most rows. Labels may be numbers `of_rows`.
    """
    if isinstance(tree, CellTree):
        return _of_cells(tree)
    counts = np.array(tree.counts)
    if style != "grid" and not tree.has_planes:
        mirrors: tuple[Mirror, ...] = ()
        every = True
        if style == "table":
            written = stream(tree, of_rows)
            unfolded = written.diagram.unfolded(MOST)
            every = unfolded is not None
            mirrors, tree = written.mirrors, unfolded or tree
        boxes = tree.boxes()
        order = np.argsort(-tree.depths[boxes.places], kind="stable")
        steps = boxes.lower[order]
        for mirror in mirrors:
            flipped = np.where(np.isin(np.arange(tree.n), mirror.axes), counts - 1 - steps, steps)
            steps = np.stack([steps, flipped], axis=1).reshape(-1, tree.n)
        return steps[:MOST], every and len(steps) <= MOST
    every = math.prod(c + 2 for c in tree.counts) <= SAMPLES
    if every:
        steps = np.indices([count + 2 for count in tree.counts]).reshape(tree.n, -1).T - 1
    else:
        steps = random_stream(0, TIMING).integers(-1, counts + 1, size=(SAMPLES, tree.n))
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
