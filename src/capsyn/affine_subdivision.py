"""Subdivision with affine leaves: cells are split where their rows are wrong, not on the surface.

Cells wait in a list; the next blocks to be split are taken from it in rounds, so that no more than
a round's test points are in memory beside the solved points.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from capsyn.affine_fit import fit_cells
from capsyn.cell_blocks import FINE, ROLES, CellBlocks, grid_places
from capsyn.cell_points import CellPoints
from capsyn.cells import MAX_COUNT, CellTree, lattice_counts
from capsyn.errors import SynthesisError
from capsyn.growing_cells import GrowingCells, Rows, lattice_level
from capsyn.lattice_points import MANY, LatticePoints, Question
from capsyn.limits import Limits
from capsyn.masks import most_voted, preferred, several
from capsyn.propositions import ROUND_BYTES, affine_memory, too_few_solves, worst_case_solves

ROUND_POINTS = 2**19
"""Test points of the blocks that are split in one round, at most."""
ROUND_SHARE = 4
"""One in so many of the solves that are left is spent in one round."""
NEGLIGIBLE = 1e-6
"""Estimated error for which no solves are spent: that of rounding rows."""
CHUNK_SCORES = 2**21
"""Scores that are fitted at a time."""


class AffineSubdivision:
    """Algorithm 1 with affine leaves, in rounds."""

    def __init__(
        self,
        partitions: tuple[int, ...],
        refinement: tuple[int, ...],
        max_level: int,
        test_points: CellPoints,
        seed: int,
        order: list[int],
        points: LatticePoints,
        limits: Limits,
        leaf_error: float,
        plain: bool,
    ) -> None:
        self._n, self._q, self._r = len(partitions), partitions, refinement
        self._max_level, self._test_points, self._seed = max_level, test_points, seed
        self._order, self._points = order, points
        self._blocks = CellBlocks(points, test_points, self._n, seed)
        self._offsets = test_points.offsets(self._n)
        self._limits, self._started = limits, time.perf_counter()
        self._max_solves, self._leaf_error, self._plain = limits.max_solves, leaf_error, plain
        # without vertices, cells whose test points agree may have others in their corners
        self._everywhere = not (plain or test_points.vertices)
        self._lattice_level = lattice_level(partitions, refinement, max_level)
        self._counts = lattice_counts(partitions, refinement, self._lattice_level)
        self._roles = np.zeros(len(ROLES), dtype=np.int64)
        self._solves = np.zeros(max_level + 1, dtype=np.int64)
        self._streams = 0
        self._needed = 0
        self._stopped = ""
        self._rows: list[Rows] = []
        self._row_count = 0
        self._summary: dict[str, Any] = {}

    def run(self) -> CellTree:
        """Return the cells."""
        roots = grid_places(self._q) * self._size(0)
        made = self._evaluate([(0, roots)])
        if made is None:
            raise too_few_solves(self._needed, self._max_solves, self._q, self._test_points)
        cells, spent = made, 0
        while not self._used_up(cells) and (chosen := self._next(cells, spent)).size:
            before = self._points.count
            new = self._split(cells, chosen)
            if new is None:
                break
            spent = (self._points.count - before) // max(1, len(new.level) // self._children)
            cells = GrowingCells.joined([cells, new])
            if len(cells.level) > MAX_COUNT:
                raise SynthesisError("there are more cells than 32-bit entries can number")
        if not self._open(cells).any():
            self._stopped = ""
        elif self._max_solves is not None and not self._stopped:
            self._stopped = "max_solves"
        self._points.check_finite(self._points.count)
        tree = cells.tree(self._q, self._r, self._lattice_level, max(self._order) + 1, self._rows)
        self._summary = self._counts_of(cells) | {
            "affine_leaves": 0 if tree.affine is None else len(tree.affine),
            "mixed_cells": len(tree.mixed_cells),
        }
        return tree

    def _used_up(self, cells: GrowingCells) -> bool:
        """Return whether there is no time or memory for another round."""
        seconds, memory = self._limits.max_seconds, self._limits.max_memory
        if seconds is not None and time.perf_counter() - self._started > seconds:
            self._stopped = "max_seconds"
        taken = affine_memory(self._points.count, len(cells.level), max(self._order), self._n)
        if memory is not None and taken + ROUND_BYTES > memory:
            self._stopped = "max_memory"
        return bool(self._stopped)

    @property
    def _children(self) -> int:
        return math.prod(self._r)

    def _size(self, level: int, finest: int = FINE) -> np.ndarray:
        """Return the edge lengths (n,) of cells of a level; `finest` is that of finest ones."""
        return finest * np.array([r ** (self._max_level - level) for r in self._r], dtype=np.int64)

    def _open(self, cells: GrowingCells) -> np.ndarray:
        """Return which cells may yet be split; where solves are counted, accepted ones too."""
        counted = self._max_solves is not None
        waiting = cells.error > NEGLIGIBLE if counted else ~cells.accepted
        return waiting & (cells.child < 0) & (cells.level < self._max_level)

    def _next(self, cells: GrowingCells, spent: int) -> np.ndarray:
        """Return the cells to split in the next round; `spent` solves went into a block before.

        Where solves are counted those come first whose estimated error, times their volume, is
        largest.
        """
        chosen = np.flatnonzero(self._open(cells))
        block = self._test_points.in_block(self._r)
        room = max(1, ROUND_POINTS // block)
        if self._max_solves is not None:
            left = self._max_solves - self._points.count
            room = min(room, max(1, left // (ROUND_SHARE * max(1, spent or block))))
            shares = np.array([1.0 / self._children**k for k in range(self._max_level + 1)])
            error = cells.error[chosen] * shares[cells.level[chosen]]
            chosen = chosen[np.argsort(-error, kind="stable")]
        return chosen[:room]

    def _split(self, cells: GrowingCells, chosen: np.ndarray) -> GrowingCells | None:
        """Split the cells, or fewer where there are too few solves left; None where for none."""
        while chosen.size:
            groups, order = [], []
            for level in np.unique(cells.level[chosen]):
                here = chosen[cells.level[chosen] == level]
                groups.append((int(level) + 1, cells.corner[here]))
                order.append(here)
            new = self._evaluate(groups)
            if new is not None:
                split = np.concatenate(order)
                cells.child[split] = len(cells.level) + self._children * np.arange(len(split))
                return new
            chosen = chosen[: len(chosen) // 2]
        return None

    def _evaluate(self, groups: list[tuple[int, np.ndarray]]) -> GrowingCells | None:
        """Return the children, of some levels, in blocks with these lower corners (M, n).

        The cells of the root grid are their own parents. None where that takes too many solves.
        """
        tests: list[tuple[int, np.ndarray, np.ndarray, tuple[int, ...], np.ndarray]] = []
        keys: list[np.ndarray] = []
        roles, levels = [], []
        for level, parents in groups:
            split = np.array(self._r if level else (1,) * self._n)
            found, table, role = self._blocks.keys(
                parents, split, self._size(level), self._blocks.stream(self._streams + len(tests))
            )
            tests.append((level, parents, split, found.shape, table))
            keys.append(found.ravel())
            roles.append(np.repeat(role, len(parents)))
            levels.append(np.full(found.size, level))
        question = self._points.ask(np.concatenate(keys))
        self._needed = int(question.new.sum())
        if self._exceeds(question):
            return None
        self._streams += len(tests)
        samples = question.samples
        self._roles += np.bincount(np.concatenate(roles)[samples], minlength=len(ROLES))
        self._solves += np.bincount(np.concatenate(levels)[samples], minlength=len(self._solves))
        counted = self._max_solves is not None  # then any level may come next
        deepest = self._max_level if counted else max(level for level, _ in groups)
        masks, scores = self._points.answer_with_scores(
            question, deepest, self._max_level, sum(len(p) for _, p in groups)
        )
        self._points.check_finite(self._points.count, MANY)
        made: list[GrowingCells] = []
        start = 0
        for (level, parents, split, shape, table), found in zip(tests, keys):
            part = slice(start, start + shape[0] * shape[1])
            start = part.stop
            chunk = max(1, CHUNK_SCORES // (table.size * scores[0].size))
            for first in range(0, len(parents), chunk):
                some = slice(first, first + chunk)
                made.append(
                    self._cells(
                        level,
                        parents[some],
                        split,
                        table,
                        found.reshape(shape)[:, some],
                        masks[part].reshape(shape)[:, some],
                        scores[part].reshape(*shape, *scores.shape[1:])[:, some],
                    )
                )
        return GrowingCells.joined(made)

    def _exceeds(self, question: Question) -> bool:
        allowed = self._max_solves
        return allowed is not None and self._points.count + int(question.new.sum()) > allowed

    def _cells(
        self,
        level: int,
        parents: np.ndarray,
        split: np.ndarray,
        table: np.ndarray,
        keys: np.ndarray,
        masks: np.ndarray,
        scores: np.ndarray,
    ) -> GrowingCells:
        """Return the children of blocks, fitted: keys, masks (U, M) and scores (U, M, V, S)."""
        size, children = self._size(level), len(table)
        corners = (parents[:, None, :] + grid_places(split) * size).reshape(-1, self._n)
        rows = np.moveaxis(table, 0, 1)  # (P, children)

        def spread(values: np.ndarray) -> np.ndarray:
            """Return values of test points (U, M, ...) as those of cells (P, M children, ...)."""
            found = np.swapaxes(values[rows], 1, 2)
            return found.reshape(len(rows), children * len(parents), *values.shape[2:])

        cell_masks = spread(masks)
        shared = common = np.bitwise_and.reduce(cell_masks, axis=0)
        if level < self._max_level:
            common = self._quarter_rule(common, cell_masks, corners, size, level)
        uniform = preferred(common, self._order)
        made = GrowingCells.uniform(corners, level, uniform.copy())
        made.accepted[:] = common != 0
        mixed = np.flatnonzero((common == 0) | self._everywhere)
        if not mixed.size:
            return made
        of_mixed = spread(scores)[:, mixed]
        known = np.isfinite(of_mixed).all(axis=(0, 2, 3))
        self._fit(made, mixed[known], cell_masks, of_mixed[:, known], spread(keys), level)
        hidden = np.flatnonzero((common == 0) & (shared != 0))  # by points of the quarter rule
        made.accepted[hidden] = False
        made.error[hidden] = np.maximum(made.error[hidden], 1 / len(rows))
        whole = (common != 0) & (made.label >= 0)
        made.label[whole] = uniform[whole]
        made.accepted[whole], made.error[whole], made.seen[whole] = True, 0.0, 0
        rest = mixed[~known & (common[mixed] == 0)]
        if rest.size:
            made.label[rest], made.seen[rest] = most_voted(cell_masks[:, rest], self._order)
            bits = cell_masks[:, rest] >> made.label[rest].astype(cell_masks.dtype)
            made.error[rest] = (bits & cell_masks.dtype.type(1) == 0).mean(axis=0)
        return made

    def _fit(
        self,
        made: GrowingCells,
        cells: np.ndarray,
        masks: np.ndarray,
        scores: np.ndarray,
        keys: np.ndarray,
        level: int,
    ) -> None:
        """Give some cells their rows: masks and keys (P, all cells), scores (P, K, V, S)."""
        if not cells.size:
            return
        fine = self._size(level)
        steps = self._size(level, 1) * np.array(
            [r ** (self._lattice_level - self._max_level) for r in self._r]
        )
        corners = made.corner[cells]
        places = np.empty((len(masks), len(cells), self._n), dtype=np.int64)
        fixed = len(self._offsets)
        places[:fixed] = (self._offsets * (fine // 2))[:, None, :]
        for p in range(fixed, len(masks)):  # random points, which lie inside
            places[p] = self._points.places(keys[p, cells]) - corners
        # below 2^63: cells have at most 2^31 steps, and no more lattice units than that
        places = np.minimum(places * steps // fine, steps - 1)
        corners = corners // fine * steps
        some = masks[:, cells]
        fits = fit_cells(
            scores, some, self._offsets, places, corners, steps, self._counts, self._plain,
        )  # fmt: skip
        self._rows.append(made.fit(cells, fits, some, self._row_count, self._leaf_error))
        self._row_count += len(self._rows[-1].symbols)

    def _quarter_rule(
        self,
        common: np.ndarray,
        masks: np.ndarray,
        corners: np.ndarray,
        size: np.ndarray,
        level: int,
    ) -> np.ndarray:
        """Return `common` (M,) after a second look at tied points of uniform cells."""
        movable = np.flatnonzero((self._offsets != 1).any(axis=1))
        point, cell = np.nonzero(several(masks[movable]) & (common != 0))
        if not cell.size:
            return common
        keys = self._blocks.quarter_keys(corners[cell], size, self._offsets[movable[point]])
        question = self._points.ask(keys)
        if self._exceeds(question):
            return common
        new = int(question.new.sum())
        self._roles[ROLES.index("quarter")] += new
        self._solves[level] += new
        shown = level if self._max_solves is None else self._max_level
        moved = self._points.answer(question, shown, self._max_level, common.size)
        common = common.copy()
        np.bitwise_and.at(common, cell, moved)
        return common

    def _counts_of(self, cells: GrowingCells) -> dict[str, Any]:
        """Return the counts of cells by level."""
        leaves, levels = [], []
        for level, here in enumerate(cells.by_level(math.prod(self._q), self._children)):
            split = cells.child[here] >= 0
            mixed = int(np.count_nonzero(split | (cells.seen[here] != 0)))
            leaves.append(int(np.count_nonzero(~split)))
            levels.append({"cells": len(here), "mixed": mixed, "solves": int(self._solves[level])})
        return {"cells": sum(leaves), "leaves_by_level": leaves, "levels": levels}

    def statistics(self) -> dict[str, Any]:
        """Return the counts of the subdivision as plain data."""
        points = self._points
        stopped = {"stopped_by": self._stopped} if self._stopped not in ("", "max_solves") else {}
        return (
            self._summary
            | stopped
            | {
                "leaves": "affine",
                "leaf_error": self._leaf_error,
                "solves": points.count,
                "solves_by_role": dict(zip(ROLES, self._roles.tolist())),
                "stopped_by_max_solves": self._stopped == "max_solves",
                "indifferent_points": points.indifferent,
                "not_finite_points": points.not_finite,
                "not_finite_example": points.example,
                "test_points": str(self._test_points),
                "seed": self._seed,
                "worst_case_solves": worst_case_solves(
                    self._q, self._r, self._max_level, self._test_points.interior(self._n)
                ),
            }
        )
