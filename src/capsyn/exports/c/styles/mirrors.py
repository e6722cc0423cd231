"""Mirror symmetries of a tree: steps beyond the middle of an axis are those of the other half."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from capsyn.cells.split_tree import LEAF, SplitTree, depth_first

MOST_AXES = 8
"""Trees of more axes are not searched: there are ``2 ** n - 1`` reflections."""
MOST_NODES = 1 << 16
"""Larger trees are not searched."""
SAMPLES = (64, 4096)
"""Random steps that a symmetry must pass before it is proved."""
BOXES = 4096
"""Leaves that are proved at a time."""


@dataclass(frozen=True)
class Mirror:
    """A symmetry: steps reflected on some `axes` have label ``turned[label]``.

    The labels of steps beyond the middle of the axis `pivot`, one of `axes`, follow from the rest.
    """

    pivot: int
    axes: tuple[int, ...]
    turned: tuple[int, ...]

    @property
    def reversal(self) -> int | None:
        """The sum of a label and what it becomes, where this is the same for all that change."""
        sums = {a + b for a, b in enumerate(self.turned) if b >= 0}
        return sums.pop() if len(sums) == 1 else None

    @property
    def turns(self) -> bool:
        """Whether any label becomes another."""
        return any(b not in (a, -1) for a, b in enumerate(self.turned))


def middle(tree: SplitTree, mirror: Mirror) -> int:
    """Return the first step of the pivot that is beyond its middle."""
    return (tree.counts[mirror.pivot] + 1) // 2


def mirrors(tree: SplitTree) -> list[Mirror]:
    """Return independent symmetries of a tree, the pivot of each on no other's axes.

    They are proved leaf by leaf. A tree with oblique splits has none.
    """
    found: list[Mirror] = []
    if tree.has_planes or tree.n > MOST_AXES or tree.node_count > MOST_NODES:
        return found
    axes = range(tree.n)
    subsets = itertools.chain.from_iterable(
        itertools.combinations(axes, size) for size in range(1, tree.n + 1)
    )
    steps = np.random.default_rng(0).integers(tree.counts, size=(SAMPLES[-1], tree.n))
    labels = tree.labels(steps)
    for subset in subsets:
        rest = set(subset)
        for mirror in found:  # what is left when the pivots of others are taken out
            if mirror.pivot in rest:
                rest ^= set(mirror.axes)
        if not rest:
            continue
        flipped = np.isin(axes, list(rest))
        if any(_turned(tree, steps[:k], labels[:k], flipped) is None for k in SAMPLES):
            continue
        turned = _proved(tree, flipped)
        if turned is None:
            continue
        pivot = max(rest, key=lambda a: (tree.counts[a], -a))
        new = Mirror(pivot, tuple(sorted(rest)), turned)
        found = [_without(mirror, new) for mirror in found] + [new]
    return found


def half(tree: SplitTree, mirror: Mirror) -> SplitTree:
    """Return the tree for steps before the middle of the pivot; elsewhere it says nothing."""
    at, to = middle(tree, mirror), np.arange(tree.node_count)
    split, label = tree.split, tree.threshold
    for i in reversed(np.flatnonzero(split != LEAF)):
        first, second = to[i + 1], to[tree.second[i]]
        beyond = split[i] == mirror.pivot and tree.threshold[i] >= at
        same = split[first] == split[second] == LEAF and label[first] == label[second]
        if beyond or same:
            to[i] = first

    def look(node: int) -> tuple[int, int, list[int]]:
        children = [] if split[node] == LEAF else [int(to[node + 1]), int(to[tree.second[node]])]
        return int(split[node]), int(tree.threshold[node]), children

    return depth_first(tree.counts, int(to[0]), look)


def _turned(
    tree: SplitTree, steps: np.ndarray, labels: np.ndarray, flipped: np.ndarray
) -> tuple[int, ...] | None:
    """Return what labels become at reflected steps; none where one becomes two, or two one."""
    last = np.array(tree.counts) - 1
    return _permutation(labels, tree.labels(np.where(flipped, last - steps, steps)))


def _permutation(labels: np.ndarray, others: np.ndarray) -> tuple[int, ...] | None:
    """Return the label (L,) that stands for each in the others, -1 for none; none if unclear."""
    pairs = np.unique(np.column_stack([labels, others]), axis=0)
    if len(np.unique(pairs[:, 0])) < len(pairs) or len(np.unique(pairs[:, 1])) < len(pairs):
        return None
    turned = np.full(int(pairs.max()) + 1, -1)
    turned[pairs[:, 0]] = pairs[:, 1]
    return tuple(turned.tolist())


def _proved(tree: SplitTree, flipped: np.ndarray) -> tuple[int, ...] | None:
    """Return what labels become in the reflections of all leaves; none where it is no symmetry."""
    boxes, counts = tree.boxes(), np.array(tree.counts)
    lower = np.where(flipped, counts - boxes.upper, boxes.lower)
    upper = np.where(flipped, counts - boxes.lower, boxes.upper)
    pairs = []
    for start in range(0, len(lower), BOXES):
        some = slice(start, start + BOXES)
        leaves, box, _, _ = tree.parts(lower[some], upper[some])
        pairs.append(np.column_stack([boxes.labels[some][box], tree.threshold[leaves]]))
    return _permutation(*np.concatenate(pairs).T)


def _without(mirror: Mirror, new: Mirror) -> Mirror:
    """Return a symmetry without the pivot of a new one: that of both where it has it."""
    if new.pivot not in mirror.axes:
        return mirror
    axes = tuple(sorted(set(mirror.axes) ^ set(new.axes)))
    turned = tuple(b if b < 0 else new.turned[b] for b in mirror.turned)
    return Mirror(mirror.pivot, axes, turned)
