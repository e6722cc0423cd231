"""What a decision tree gives in every cell of a policy, found without sampling."""

from __future__ import annotations

import math

import numpy as np

from capsyn.cells.boxes import Boxes
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import FeatureTree, lattice_chunks
from capsyn.cells.split_tree import TREE_ARRAYS, SplitTree
from capsyn.compression.affine_tree import affine_tree
from capsyn.compression.coarsening import cut_off
from capsyn.compression.freedom import allowed_masks, allows
from capsyn.compression.rows import numbered_like
from capsyn.errors import ProblemError
from capsyn.policies.file import content_hash
from capsyn.policies.policy import DecisionTree, Policy, cell_tree
from capsyn.validation import describe

CHUNK = 100_000
"""Cells that are cut at a time."""
SAMPLES = 100_000
"""Lattice steps at which a tree of affine leaves is compared with them."""


def prove(tree: Policy, policy: Policy) -> float:
    """Prove again what a tree of mode ``exact`` or ``freedom`` guarantees about its policy.

    Parameters
    ----------
    tree : DecisionTree
        A tree of mode ``exact`` or ``freedom``.
    policy : Policy
        The policy of cells from which the tree was made.

    Returns
    -------
    float
        Share of the volume in which the tree gives another symbol than the policy, for any symbol
        in force.

    Raises
    ------
    ProblemError
        The tree is of another policy or of mode ``linear``, or its guarantee does not hold.
    """
    cells = cell_tree(policy)
    if not isinstance(tree, DecisionTree) or tree.guarantee.mode == "linear":
        raise ProblemError(
            f"`tree` must be a decision tree of mode exact or freedom; got {describe(tree)}"
        )
    if tree.guarantee.source != content_hash(policy):
        raise ProblemError(f"`tree` must be made from `policy`; {tree!r} was made from another")
    if cells.affine is not None:
        _prove_affine(tree, cells)
        return 0.0
    level = tree.guarantee.level
    base = policy if level is None else cut_off(policy, level)
    left, nodes = cell_tree(base), numbered_like(tree, policy)
    if isinstance(nodes, FeatureTree):
        return _prove_steps(nodes, policy, tree.guarantee.mode == "freedom")
    if nodes.counts != left.counts or tree.space != policy.space:
        raise ProblemError(f"`tree` must be on the lattice of `policy`; got {tree!r}")
    boxes = left.boxes()
    leaf, box, _ = _parts(nodes, boxes)
    places = boxes.places[box]
    masks = allowed_masks(base, tree.guarantee.mode == "freedom")
    wrong = ~allows(masks, places, nodes.labels_at(leaf))
    if wrong.any():
        cell = places[np.flatnonzero(wrong)[0]]
        raise ProblemError(f"`tree` does not keep its word: cell {cell} gets another symbol")
    finer = nodes.refined(cells.counts)
    changed = changed_cells(finer, cells).sum()
    return float(changed / np.prod(cells.counts, dtype=float))


def _prove_steps(tree: FeatureTree, policy: Policy, freedom: bool) -> float:
    """Return the share that a tree with features changes; each finest cell is looked up in both."""
    cells, allowed = cell_tree(policy), allowed_masks(policy, freedom)
    if tree.counts != cells.counts:
        raise ProblemError(f"`tree` must be on the lattice of `policy`; got {tree.counts}")
    changed = 0
    for steps in lattice_chunks(cells.counts):
        entries, labels = cells.find(steps), tree.labels(steps)
        wrong = np.flatnonzero(~allows(allowed, entries, labels))
        if len(wrong):
            at = steps[wrong[0]].tolist()
            raise ProblemError(f"`tree` does not keep its word: step {at} gets another symbol")
        changed += int(np.count_nonzero(labels != cells.labels_at(entries)))
    return changed / math.prod(cells.counts)


def _prove_affine(tree: DecisionTree, cells: CellTree) -> None:
    """Raise `ProblemError` unless a tree is the one that cells with affine leaves stand for.

    It is by construction equal to them; a sample of lattice steps is looked up in both.
    """
    own = affine_tree(cells)
    same = own is not None and tree.cells.counts == own.counts
    same = same and all(
        np.array_equal(getattr(tree.cells, name), getattr(own, name)) for name in TREE_ARRAYS
    )
    steps = np.random.default_rng(0).integers(cells.counts, size=(SAMPLES, cells.n))
    if not same or (tree.cells.labels(steps) != cells.labels(steps)).any():
        raise ProblemError("`tree` does not keep its word: it is another than its policy's")


def changed_cells(tree: SplitTree, cells: CellTree) -> np.ndarray:
    """Return how much of each cell has another label in a tree than in the cells, (K,).

    It is their volume [finest cells], in the order of ``cells.boxes()``. Each cell is cut along the
    splits of the tree, which are not oblique; nothing of how the tree was made is used.
    """
    boxes = cells.boxes()
    leaf, box, volume = _parts(tree, boxes)
    changed = np.where(tree.labels_at(leaf) != boxes.labels[box], volume, 0.0)
    return np.bincount(box, changed, minlength=len(boxes))


def _parts(tree: SplitTree, boxes: Boxes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return leaf, box and volume (P,) of all parts that a tree cuts boxes into."""
    parts = []
    for start in range(0, len(boxes), CHUNK):
        part = slice(start, start + CHUNK)
        leaf, box, lower, upper = tree.parts(boxes.lower[part], boxes.upper[part])
        parts.append((leaf, box + start, np.prod(upper - lower, axis=1, dtype=float)))
    leaf, box, volume = (np.concatenate(x) for x in zip(*parts))
    covered = np.bincount(box, volume, minlength=len(boxes))  # rounded beyond 2^53
    if not np.allclose(covered, boxes.volumes(), rtol=1e-12, atol=0):
        raise AssertionError("the leaves of the tree do not tile the cells")
    return leaf, box, volume
