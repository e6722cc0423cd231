"""The cells of a policy: a grid of trees in one integer array."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from capsyn.affine_leaves import AffineLeaves
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.validation import whole_number, whole_numbers

MAX_COUNT = 2**31 - 1
"""Most finest cells along one axis."""


@dataclass(frozen=True)
class Leaves:
    """Leaf cells of one level.

    Parameters
    ----------
    level : int
        Level of subdivision, 0 for the root grid.
    entries : (M,)
        Their places in ``CellTree.entries``.
    lower : (M, n)
        Integer coordinates of their lower corners, in finest cells.
    labels : (M,)
        Leaf numbers: symbols, and N for the default.
    """

    level: int
    entries: np.ndarray
    lower: np.ndarray
    labels: np.ndarray


@dataclass(frozen=True, eq=False)
class Boxes:
    """Labelled boxes of the lattice, ``lower <= z < upper``, that tile it.

    Parameters
    ----------
    places : (M,)
        What ``find`` gives for the lattice points in them.
    lower, upper : (M, n)
        Integer corners, in finest cells.
    labels : (M,)
        Leaf numbers: symbols, and N for the default.
    levels : (M,)
        Levels of subdivision.
    """

    places: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    labels: np.ndarray
    levels: np.ndarray

    def __len__(self) -> int:
        return len(self.labels)

    def volumes(self) -> np.ndarray:
        """Return the finest cells in each box, (M,) floats."""
        return np.prod(self.upper - self.lower, axis=1, dtype=float)


@dataclass(frozen=True, eq=False)
class CellTree:
    """Cells as a grid of trees, on integer coordinates of finest cells.

    Parameters
    ----------
    partitions, refinement : (n,) ints
        Cells of the root grid per axis, and children of a split cell per axis (>= 2).
    max_level : int
        Most times that a cell may be split.
    entries : (M,) int32
        The root grid in C order, then blocks of ``prod(refinement)`` children in C order, level
        by level. An entry >= 0 is the place of its block; an entry < 0 is ``-1 - leaf``.
    mixed_cells : (K,) int32
        Leaf entries, ascending, whose test points did not agree; in a tree with affine leaves
        those whose rows are wrong at one.
    mixed_labels : (K,) uint64
        For each of them the set of labels seen, as a bit mask, with those of its rows.
    affine : AffineLeaves, optional
        The affine leaves, numbered in the order of their entries. Their rows are values on the
        lattice of finest cells; `max_level` is then that of the lattice, and no cell may be split
        so often.
    """

    partitions: tuple[int, ...]
    refinement: tuple[int, ...]
    max_level: int
    entries: np.ndarray
    mixed_cells: np.ndarray
    mixed_labels: np.ndarray
    affine: AffineLeaves | None = None

    def __post_init__(self) -> None:
        for name in ("entries", "mixed_cells", "mixed_labels"):
            frozen = getattr(self, name).view()
            frozen.flags.writeable = False
            object.__setattr__(self, name, frozen)

    @property
    def n(self) -> int:
        """Number of axes."""
        return len(self.partitions)

    @property
    def counts(self) -> tuple[int, ...]:
        """Finest cells along each axis."""
        return lattice_counts(self.partitions, self.refinement, self.max_level)

    @property
    def node_count(self) -> int:
        """Number of entries: leaf cells and blocks."""
        return len(self.entries)

    def sizes(self, level: int) -> np.ndarray:
        """Return the edge lengths (n,) of cells of a level, in finest cells."""
        return np.array([r ** (self.max_level - level) for r in self.refinement], dtype=np.int64)

    def find(self, steps: np.ndarray) -> np.ndarray:
        """Return the entries (B,) of the leaves that hold finest cells (B, n)."""
        size = self.sizes(0)
        entry = np.ravel_multi_index(tuple((steps // size).T), self.partitions)
        active = np.flatnonzero(self.entries[entry] >= 0)
        rest = steps[active] % size
        while active.size:
            size = size // self.refinement
            child = np.ravel_multi_index(tuple((rest // size).T), self.refinement)
            place = self.entries[entry[active]] + child
            entry[active] = place
            deeper = self.entries[place] >= 0
            active, rest = active[deeper], rest[deeper] % size
        return entry

    def labels(self, steps: np.ndarray) -> np.ndarray:
        """Return the labels (B,) of finest cells (B, n): symbols, and N for the default."""
        return self.labels_in(self.find(steps), steps)

    def labels_in(self, places: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return the labels (B,) of finest cells (B, n) in leaf entries (B,)."""
        labels = self.labels_at(places)
        if self.affine is not None:
            rest = np.flatnonzero(labels >= self.affine.first)
            labels[rest] = self.affine.labels(labels[rest], steps[rest])
        return labels

    def labels_at(self, places: np.ndarray) -> np.ndarray:
        """Return the leaf numbers of leaf entries."""
        return -1 - self.entries[places]

    def levels(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield (level, entries (M,), lower corners (M, n)) of all cells, level by level."""
        offsets = np.stack(np.unravel_index(np.arange(math.prod(self.partitions)), self.partitions))
        lower = offsets.T * self.sizes(0)
        places = np.arange(len(lower))
        for level in range(self.max_level + 1):
            yield level, places, lower
            split = self.entries[places] >= 0
            if level == self.max_level or not split.any():
                return
            # made only here: of a tree without blocks the refinement may be any number
            children = np.stack(
                np.unravel_index(np.arange(math.prod(self.refinement)), self.refinement), axis=1
            )
            starts = self.entries[places[split]].astype(np.int64)
            places = (starts[:, None] + np.arange(len(children))).ravel()
            corners = lower[split][:, None, :] + children * self.sizes(level + 1)
            lower = corners.reshape(-1, self.n)

    def leaves(self) -> Iterator[Leaves]:
        """Yield the leaf cells of every level."""
        for level, places, lower in self.levels():
            leaf = self.entries[places] < 0
            yield Leaves(level, places[leaf], lower[leaf], -1 - self.entries[places[leaf]])

    @property
    def depth(self) -> int:
        """Highest level of a cell."""
        return max(level for level, _, _ in self.levels())

    def volumes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the leaf entries (M,) and their volumes (M,) [finest cells]."""
        places, volumes = [], []
        for leaves in self.leaves():
            places.append(leaves.entries)
            size = np.prod(self.sizes(leaves.level), dtype=float)
            volumes.append(np.full(len(leaves.entries), size))
        return np.concatenate(places), np.concatenate(volumes)

    def boxes(self) -> Boxes:
        """Return the leaf cells as boxes, level by level; `ProblemError` where some are affine."""
        if self.affine is not None:
            raise ProblemError(
                "a policy with affine leaves has no boxes of one symbol each; "
                "synthesize with leaves='constant' for this"
            )
        leaves = list(self.leaves())
        lower = np.concatenate([x.lower for x in leaves])
        levels = np.repeat([x.level for x in leaves], [len(x.labels) for x in leaves])
        sizes = np.stack([self.sizes(k) for k in range(self.max_level + 1)])
        return Boxes(
            np.concatenate([x.entries for x in leaves]),
            lower,
            lower + sizes[levels],
            np.concatenate([x.labels for x in leaves]),
            levels,
        )

    @functools.cached_property
    def leaf_count(self) -> int:
        """Number of leaf cells."""
        return int(np.count_nonzero(self.entries < 0))

    def check(self, leaf_count: int) -> None:
        """Raise `PolicyFormatError` unless the arrays are one well-formed grid of trees.

        Parameters
        ----------
        leaf_count : int
            Number of labels, N + 1: leaf numbers of constant leaves must be below it.
        """
        known = leaf_count + (0 if self.affine is None else len(self.affine))
        entries, children = self.entries, math.prod(self.refinement)
        level, start, end = 0, 0, math.prod(self.partitions)
        if len(entries) < end:
            raise PolicyFormatError(f"{len(entries)} cells are fewer than the root grid's {end}")
        while True:  # blocks follow each other without gaps, so this ends at the last entry
            here = entries[start:end]
            if (here < -known).any():
                raise PolicyFormatError("a cell has an unknown label")
            blocks = here[here >= 0].astype(np.int64)
            if not np.array_equal(blocks, end + children * np.arange(len(blocks))):
                raise PolicyFormatError("the blocks of cells are not one after the other")
            if not len(blocks):
                break
            level += 1
            start, end = end, end + children * len(blocks)
            if level > self.max_level or end > len(entries):
                raise PolicyFormatError("the cells are deeper or more than the file says")
        if end != len(entries):
            raise PolicyFormatError(f"{len(entries) - end} cells belong to no block")
        mixed = self.mixed_cells
        if mixed.shape != self.mixed_labels.shape:
            raise PolicyFormatError("mixed cells and their labels differ in number")
        if len(mixed) and (
            mixed.min() < 0
            or mixed.max() >= len(entries)
            or (np.diff(mixed.astype(np.int64)) <= 0).any()
            or (entries[mixed] >= 0).any()
        ):
            raise PolicyFormatError("the mixed cells are no ascending leaf cells")
        leaf = -1 - entries[mixed].astype(np.int64)
        own = np.uint64(1) << np.minimum(leaf, 63).astype(np.uint64)
        if self.affine is not None:
            self._check_affine(leaf_count)
            rest = leaf >= leaf_count
            own[rest] = self.affine.masks()[leaf[rest] - leaf_count]
        if (own & ~self.mixed_labels).any():
            raise PolicyFormatError("a mixed cell's label is not among the labels seen in it")
        if leaf_count < 64 and (self.mixed_labels >> np.uint64(leaf_count)).any():
            raise PolicyFormatError("a mixed cell has an unknown label")

    def _check_affine(self, leaf_count: int) -> None:
        assert self.affine is not None
        self.affine.check(self.counts, leaf_count)
        leaves = -1 - self.entries[self.entries < 0].astype(np.int64)
        numbers = leaves[leaves >= leaf_count] - leaf_count
        if not np.array_equal(numbers, np.arange(len(self.affine))):
            raise PolicyFormatError("the affine leaves are not numbered in the order of the cells")


def lattice_counts(
    partitions: tuple[int, ...], refinement: tuple[int, ...], max_level: int
) -> tuple[int, ...]:
    """Return the finest cells along each axis, ``partitions * refinement ** max_level``."""
    return tuple(q * r**max_level for q, r in zip(partitions, refinement))


def grid_settings(
    partitions: object, refinement: object, max_level: object, n: int
) -> tuple[tuple[int, ...], tuple[int, ...], int]:
    """Return validated (partitions, refinement, max_level) for `n` axes.

    Raises
    ------
    ProblemError
        Not whole numbers, or 2^31 finest cells or more along an axis.
    """
    q = whole_numbers("partitions", partitions, n, least=1, most=MAX_COUNT)
    r = whole_numbers("refinement", refinement, n, least=2, most=MAX_COUNT)
    most = 0
    while max(lattice_counts(q, r, most + 1)) <= MAX_COUNT and most < 31:
        most += 1
    return q, r, whole_number("max_level", max_level, least=0, most=most)
