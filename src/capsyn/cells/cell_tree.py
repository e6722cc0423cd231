"""The cells of a policy: a grid of trees in one integer array."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from capsyn.cells.affine_leaves import AffineLeaves
from capsyn.cells.boxes import Boxes, Cells, digits_of, number_of, ragged
from capsyn.cells.masks import WORD, members, singles, word_count
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.modelling.grid import Grid, grid_places
from capsyn.validation import keep, keep_read_only

MAX_MASKED = 16
"""Most axes of a tree whose cells are split along some of them only."""
CELL_ARRAYS = {"entries": np.int32, "mixed_cells": np.int32, "mixed_labels": np.uint64}
SPLIT_ARRAYS = {"splits": np.uint16}
SEEN_ARRAYS = {"mixed_sets": np.uint64, "mixed_places": np.int32}
"""The arrays as files and kernels call them; `splits` where cells are split along some axes. Sets
for several labels in force are kept once each, with their places, instead of `mixed_labels`."""


@dataclass(frozen=True, eq=False)
class CellTree:
    """Cells as a grid of trees, on integer coordinates of finest cells.

    The entries are the root grid in C order, then blocks of children in C order, level by level:
    ``refinement`` along each axis that the cell is split along. An entry >= 0 is the place of its
    block; an entry < 0 is ``-1 - leaf``.

    Affine leaves are numbered in the order of their entries. Their rows are values on the lattice
    of finest cells; the grid's `max_level` is then that of the lattice, and no cell may be split so
    often. Mixed cells are then those whose rows are wrong at a test point, and labels seen in them
    include those of the rows.
    """

    grid: Grid
    entries: np.ndarray  # (M,) int32
    mixed_cells: np.ndarray  # (K,) int32: leaf entries, ascending, whose test points differ
    mixed_labels: np.ndarray  # (K, J, W) uint64: the sets of labels seen in each, by that in force
    affine: AffineLeaves | None = None
    splits: np.ndarray | None = None  # (M,) uint16: the axes of each split, 0 for leaves; else all

    kind: ClassVar[str] = "cells"
    planes_are: ClassVar[str] = "affine leaves"
    compiled: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.mixed_labels.ndim == 1:  # as files have one word, whatever is in force
            keep(self, mixed_labels=self.mixed_labels[:, None, None])
        keep_read_only(self, *CELL_ARRAYS, *SPLIT_ARRAYS)

    @property
    def n(self) -> int:
        """Number of axes."""
        return self.grid.n

    @property
    def partitions(self) -> tuple[int, ...]:
        """Cells of the root grid along each axis."""
        return self.grid.partitions

    @property
    def refinement(self) -> tuple[int, ...]:
        """Children of a split cell along each axis that it is split along."""
        return self.grid.refinement

    @property
    def max_level(self) -> int:
        """Most times that a cell may be split along an axis."""
        return self.grid.max_level

    @property
    def counts(self) -> tuple[int, ...]:
        """Finest cells along each axis."""
        return self.grid.counts

    @property
    def node_count(self) -> int:
        """Number of entries: leaf cells and blocks."""
        return len(self.entries)

    @property
    def has_planes(self) -> bool:
        """Whether planes that are oblique to the axes bound symbols: those of affine leaves."""
        return self.affine is not None

    @property
    def nested(self) -> bool:
        """Whether of two neighbours the face of one lies in that of the other."""
        return self.splits is None

    @property
    def disagreeing(self) -> np.ndarray:
        """Leaf entries whose test points did not agree."""
        return self.mixed_cells

    def structure(self) -> dict[str, Any]:
        """Return what a file says of the cells beside their arrays, as plain data."""
        return self.grid.to_json()

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by their names in a file."""
        arrays = {name: getattr(self, name) for name in CELL_ARRAYS}
        _, in_force, words = self.mixed_labels.shape
        if (in_force, words) == (1, 1):
            arrays["mixed_labels"] = self.mixed_labels[:, 0, 0]
        elif in_force > 1:
            del arrays["mixed_labels"]
            arrays |= self._seen_once
        if self.splits is not None:
            arrays["splits"] = self.splits
        return arrays | ({} if self.affine is None else self.affine.arrays())

    @functools.cached_property
    def _seen_once(self) -> dict[str, np.ndarray]:
        """The arrays of `SEEN_ARRAYS`."""
        count, in_force, words = self.mixed_labels.shape
        every = self.mixed_labels.reshape(-1, words)
        sets, places = np.unique(every, axis=0, return_inverse=True)
        where = places.reshape(count, in_force).astype(np.int32)
        return {"mixed_sets": sets, "mixed_places": where}

    def lookup_arguments(self) -> dict[str, Any]:
        """Return what lookup.c knows of the cells: numbers, and arrays, by name."""
        grid = {name: np.array(getattr(self, name)) for name in ("partitions", "refinement")}
        rows: dict[str, Any] = {}
        if self.affine is not None:
            rows = {"affine": self.affine.first, **self.affine.arrays()}
            if self.affine.ratios is not None:
                rows["labels"] = len(self.affine.ratios)
        splits = {} if self.splits is None else {"splits": self.splits}
        return {**grid, "entries": self.entries, **splits, **rows}

    def sizes(self, level: int) -> np.ndarray:
        """Return the edge lengths (n,) of cells split `level` times along each axis."""
        return self.grid.sizes(level)

    def factors(self, places: np.ndarray) -> np.ndarray:
        """Return into how many children along each axis (M, n) split cells (M,) are split."""
        refinement = np.array(self.refinement, dtype=np.int64)
        if self.splits is None:
            return np.broadcast_to(refinement, (len(places), self.n))
        return np.where(members(self.splits[places, None], self.n), refinement, 1)

    def find(self, steps: np.ndarray) -> np.ndarray:
        """Return the entries (B,) of the leaves that hold finest cells (B, n)."""
        size = self.sizes(0)
        entry = np.ravel_multi_index(tuple((steps // size).T), self.partitions)
        active = np.flatnonzero(self.entries[entry] >= 0)
        rest = steps[active] % size
        while active.size:
            place = entry[active]
            factors = self.factors(place)
            size = size // factors
            digits, rest = np.divmod(rest, size)
            place = self.entries[place] + number_of(digits, factors)
            entry[active] = place
            deeper = self.entries[place] >= 0
            active, rest, size = active[deeper], rest[deeper], size[deeper]
        return entry

    @property
    def priced(self) -> bool:
        """Whether rows of affine leaves depend on the label in force."""
        return self.affine is not None and self.affine.prices is not None

    def labels(self, steps: np.ndarray, in_force: np.ndarray | None = None) -> np.ndarray:
        """Return the numbers (B,) of the rows of finest cells (B, n): labels where these are all.

        That of an affine leaf is the label that follows those in force (B,), by default the
        default's.
        """
        return self.labels_in(self.find(steps), steps, in_force)

    def labels_in(
        self, places: np.ndarray, steps: np.ndarray, in_force: np.ndarray | None = None
    ) -> np.ndarray:
        """Return `labels` (B,) of finest cells (B, n) in leaf entries (B,)."""
        labels = self.labels_at(places)
        if self.affine is not None:
            rest = np.flatnonzero(labels >= self.affine.first)
            now = None if in_force is None else in_force[rest]
            labels[rest] = self.affine.labels(labels[rest], steps[rest], now)
        return labels

    def constant_leaves(self, rows: int) -> np.ndarray:
        """Return the numbers (L,) of all leaves but affine ones, of so many rows."""
        numbers = self.labels_at(np.flatnonzero(self.entries < 0))
        return numbers[numbers < rows]

    def labels_at(self, places: np.ndarray) -> np.ndarray:
        """Return the leaf numbers of leaf entries."""
        return -1 - self.entries[places]

    def levels(self) -> Iterator[Cells]:
        """Yield all cells, level by level: those of the root grid, their children, and so on."""
        lower = grid_places(self.partitions) * self.sizes(0)
        here = Cells(0, np.arange(len(lower)), lower, np.broadcast_to(self.sizes(0), lower.shape))
        while len(here.places):
            yield here
            here = self._children(here.where(self.entries[here.places] >= 0))

    def _children(self, parents: Cells) -> Cells:
        """Return the cells of the blocks of split cells."""
        factors = self.factors(parents.places)
        parent, number = ragged(np.prod(factors, axis=1))
        places = self.entries[parents.places][parent] + number
        sizes = (parents.sizes // factors)[parent]
        lower = parents.lower[parent] + digits_of(number, factors[parent]) * sizes
        return Cells(parents.level + 1, places, lower, sizes)

    def leaves(self) -> Iterator[Cells]:
        """Yield the leaf cells of every level."""
        for cells in self.levels():
            yield cells.where(self.entries[cells.places] < 0)

    @property
    def depth(self) -> int:
        """Highest level of a cell."""
        return max(cells.level for cells in self.levels())

    def times(self, cells: Cells) -> np.ndarray:
        """Return how often cells have been split along each axis, (M, n)."""
        shares = np.log(self.sizes(0) / cells.sizes) / np.log(self.refinement)
        return np.rint(shares).astype(np.int64)

    def volumes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the leaf entries (M,) and their volumes (M,) [finest cells]."""
        leaves = list(self.leaves())
        volumes = [np.prod(cells.sizes, axis=1, dtype=float) for cells in leaves]
        return np.concatenate([cells.places for cells in leaves]), np.concatenate(volumes)

    def layers(self) -> list[np.ndarray]:
        """Return the places of the cells of each level, which stand side by side."""
        return [cells.places for cells in self.levels()]

    def leaf_labels(self) -> np.ndarray:
        """Return the labels of all leaves; `ProblemError` where some are affine."""
        self._check_constant()
        return self.labels_at(np.flatnonzero(self.entries < 0))

    def finest(self, places: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Return whether leaf entries (M,) with edge lengths (M, n) are as fine as cells get."""
        finest = sizes == 1
        if self.splits is None:
            return finest.all(axis=1)
        # mixed cells are as fine as they get along the axes along which labels vary
        return finest.any(axis=1) | np.isin(places, self.mixed_cells)

    def _check_constant(self) -> None:
        if self.affine is not None:
            raise ProblemError(
                "a policy with affine leaves has no boxes of one symbol each; "
                "synthesize with leaves='constant' for this"
            )

    def boxes(self) -> Boxes:
        """Return the leaf cells as boxes, level by level; `ProblemError` where some are affine."""
        self._check_constant()
        leaves = list(self.leaves())
        places, lower, sizes = (
            np.concatenate([getattr(cells, name) for cells in leaves])
            for name in ("places", "lower", "sizes")
        )
        levels = np.repeat([x.level for x in leaves], [len(x.places) for x in leaves])
        return Boxes(places, lower, lower + sizes, self.labels_at(places), levels)

    def parts(
        self, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what the leaves cut boxes into, each of which lies in one cell of the root grid.

        Arguments and results are those of `SplitTree.parts`.
        """
        size = np.broadcast_to(self.sizes(0), lower.shape)
        place = np.ravel_multi_index(tuple((lower // size).T), self.partitions)
        box, corner, done = np.arange(len(lower)), lower // size * size, []
        while True:
            leaf = self.entries[place] < 0
            done.append((place[leaf], box[leaf], lower[leaf], upper[leaf]))
            if leaf.all():
                break
            place, box, lower, upper, corner, size = (
                x[~leaf] for x in (place, box, lower, upper, corner, size)
            )
            factors = self.factors(place)
            size = size // factors
            first = (lower - corner) // size
            counts = (upper - 1 - corner) // size - first + 1  # of children that a box meets
            parent, number = ragged(np.prod(counts, axis=1))
            digits = digits_of(number, counts[parent]) + first[parent]
            child = number_of(digits, factors[parent])
            place, box, size = self.entries[place[parent]] + child, box[parent], size[parent]
            corner = corner[parent] + digits * size
            lower = np.maximum(lower[parent], corner)
            upper = np.minimum(upper[parent], corner + size)
        leaves, boxes, lower, upper = (np.concatenate(x) for x in zip(*done))
        return leaves, boxes, lower, upper

    @functools.cached_property
    def leaf_count(self) -> int:
        """Number of leaf cells."""
        return int(np.count_nonzero(self.entries < 0))

    def check(self, label_count: int, rows: np.ndarray | None = None) -> None:
        """Raise `PolicyFormatError` unless the arrays are one well-formed grid of trees.

        Leaf numbers of constant leaves are those of `rows` (R, J), the label that follows each
        symbol in force, of `label_count` labels, N + 1; by default labels themselves.
        """
        rows = np.arange(label_count)[:, None] if rows is None else rows
        if len(rows) == label_count:  # all are constant
            rows = rows[:, : self.mixed_labels.shape[1]]
        known = len(rows) + (0 if self.affine is None else len(self.affine))
        entries, n = self.entries, self.n
        if self.splits is not None:
            self._check_splits()
        end = self.grid.roots
        if len(entries) < end:
            raise PolicyFormatError(f"{len(entries)} cells are fewer than the root grid's {end}")
        # how often the cells have been split along each axis
        start, times = 0, np.zeros((1 if self.splits is None else end, n), dtype=np.int8)
        while True:  # blocks follow each other without gaps, so this ends at the last entry
            here = entries[start:end]
            if (here < -known).any():
                raise PolicyFormatError("a cell has an unknown label")
            split = np.flatnonzero(here >= 0)
            if not split.size:
                break
            factors = self.factors(start + split)
            counts = np.prod(factors, axis=1, dtype=float)
            if end + counts.sum() > len(entries):
                raise PolicyFormatError("the cells are deeper or more than the file says")
            counts = counts.astype(np.int64)
            if not np.array_equal(here[split], end + np.cumsum(counts) - counts):
                raise PolicyFormatError("the blocks of cells are not one after the other")
            if self.splits is None:
                times = times + 1
            else:
                times = np.repeat(times[split] + (factors > 1), counts, axis=0).astype(np.int8)
            if times.max() > self.max_level:
                raise PolicyFormatError("the cells are deeper or more than the file says")
            start, end = end, end + int(counts.sum())
        if end != len(entries):
            raise PolicyFormatError(f"{len(entries) - end} cells belong to no block")
        if self.affine is not None:
            self._check_affine(len(rows), label_count)
        self._check_mixed(rows, label_count)

    def _check_mixed(self, rows: np.ndarray, label_count: int) -> None:
        """Raise `PolicyFormatError` unless mixed cells are leaves, and hold their own label."""
        mixed, entries, seen = self.mixed_cells, self.entries, self.mixed_labels
        if seen.shape != (len(mixed), rows.shape[1], word_count(label_count)):
            raise PolicyFormatError("mixed cells and their labels differ in number")
        if len(mixed) and (
            mixed.min() < 0
            or mixed.max() >= len(entries)
            or (np.diff(mixed.astype(np.int64)) <= 0).any()
            or (entries[mixed] >= 0).any()
        ):
            raise PolicyFormatError("the mixed cells are no ascending leaf cells")
        leaf = -1 - entries[mixed].astype(np.int64)
        own = singles(rows[np.minimum(leaf, len(rows) - 1)], label_count)
        if self.affine is not None:
            rest = leaf >= len(rows)
            own[rest] = self.affine.masks(label_count)[leaf[rest] - len(rows), None]
        if (own & ~seen).any():
            raise PolicyFormatError("a mixed cell's label is not among the labels seen in it")
        beyond = label_count % WORD
        if beyond and (seen[..., -1] >> np.uint64(beyond)).any():
            raise PolicyFormatError("a mixed cell has an unknown label")

    def _check_splits(self) -> None:
        assert self.splits is not None
        if self.n > MAX_MASKED:
            raise PolicyFormatError(
                f"cells of {self.n} axes cannot be split along some of them only"
            )
        if self.splits.shape != self.entries.shape or (self.splits >> self.n).any():
            raise PolicyFormatError(
                "the axes that cells are split along are not those of the cells"
            )
        if ((self.splits != 0) != (self.entries >= 0)).any():
            raise PolicyFormatError("a cell is split along no axis, or a leaf along some")

    def _check_affine(self, first: int, label_count: int) -> None:
        assert self.affine is not None
        if first > label_count and not self.priced:
            raise PolicyFormatError("affine leaves beside rows of transitions have no prices")
        self.affine.check(self.counts, first, label_count)
        leaves = -1 - self.entries[self.entries < 0].astype(np.int64)
        numbers = leaves[leaves >= first] - first
        if not np.array_equal(numbers, np.arange(len(self.affine))):
            raise PolicyFormatError("the affine leaves are not numbered in the order of the cells")
