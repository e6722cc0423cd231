"""Subdivision in rounds: the cells that are split next are those where most is wrong.

So are made affine leaves, whose cells are split where their rows are wrong and not on the surface,
and cells that are split along some axes only. Cells wait in a list; no more than a round's test
points are in memory beside the solved points.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.masks import holds, most_voted, preferred, several
from capsyn.errors import SynthesisError
from capsyn.modelling.grid import MAX_COUNT, lattice_counts
from capsyn.subdivision.affine_fit import fit_cells
from capsyn.subdivision.cell_blocks import FINE, ROLES, SubdivisionTask, grid_places
from capsyn.subdivision.growing_cells import GrowingCells, Rows, SplitCells, lattice_level
from capsyn.subdivision.lattice_points import MANY, Question
from capsyn.subdivision.propositions import round_bytes, rounds_memory, too_few_solves
from capsyn.subdivision.split_axes import SplitAxes

ROUND_POINTS = 2**19
"""Test points of the blocks that are split in one round, at most."""
ROUND_SHARE = 4
"""One in so many of the solves that are left is spent in one round."""
NEGLIGIBLE = 1e-6
"""Estimated error for which no solves are spent: that of rounding rows."""
CHUNK_SCORES = 2**21
"""Scores that are fitted, or masks of constant leaves that are compared, at a time."""


@dataclass(frozen=True)
class LeafRule:
    """What leaves are made of.

    Parameters
    ----------
    affine : bool
        Whether cells whose test points do not agree get affine rows.
    most_error : float
        Largest estimated share of a cell where rows may be wrong.
    plain : bool
        Whether scores are mere indicators of labels.
    adaptive : bool
        Whether cells are split along some axes only.
    """

    affine: bool
    most_error: float = 0.0
    plain: bool = False
    adaptive: bool = False


class RoundSubdivision:
    """Algorithm 1 in rounds."""

    def __init__(self, task: SubdivisionTask, rule: LeafRule) -> None:
        self._task, self._points, self._blocks = task, task.points, task.blocks
        self._n, self._q, self._r = task.n, task.partitions, task.refinement
        self._max_level, self._test_points, self._order = (
            task.max_level,
            task.test_points,
            task.order,
        )
        self._offsets = task.test_points.offsets(task.n)
        self._limits, self._started = task.limits, time.perf_counter()
        self._max_solves, self._rule = task.limits.max_solves, rule
        self._axes = SplitAxes.of(self._offsets) if rule.adaptive else None
        # without vertices, cells whose test points agree may have others in their corners
        self._everywhere = rule.affine and not (rule.plain or task.test_points.vertices)
        self._lattice_level = task.max_level
        if rule.affine:
            self._lattice_level = lattice_level(self._q, self._r, task.max_level)
        self._counts = lattice_counts(self._q, self._r, self._lattice_level)
        self._roles = np.zeros(len(ROLES), dtype=np.int64)
        most = task.max_level * (self._n if rule.adaptive else 1)
        self._solves = np.zeros(most + 1, dtype=np.int64)
        self._streams = 0
        self._needed = 0
        self._stopped = ""
        self._rows: list[Rows] = []
        self._row_count = 0
        self._summary: dict[str, Any] = {}

    def run(self) -> CellTree:
        """Return the cells."""
        size = FINE * self._finest(np.zeros((1, self._n)))
        made = self._evaluate([SplitCells.roots(grid_places(self._q) * size)])
        if made is None:
            raise too_few_solves(self._needed, self._max_solves, self._q, self._test_points)
        cells, spent = made, 0
        while not self._used_up(cells) and (chosen := self._next(cells, spent)).size:
            before, split = self._points.count, np.count_nonzero(cells.child >= 0)
            new = self._split(cells, chosen)
            if new is None:
                break
            spent = (self._points.count - before) // (np.count_nonzero(cells.child >= 0) - split)
            cells = GrowingCells.joined([cells, new])
            if len(cells.level) > MAX_COUNT:
                raise SynthesisError("there are more cells than 32-bit entries can number")
        if not self._open(cells).any():
            self._stopped = ""
        elif self._max_solves is not None and not self._stopped:
            self._stopped = "max_solves"
        self._points.check_finite(self._points.count)
        tree = cells.tree(
            self._q,
            self._r,
            self._lattice_level,
            max(self._order) + 1,
            self._rows,
            self._rule.adaptive,
        )
        self._summary = self._counts_of(cells) | {"mixed_cells": len(tree.mixed_cells)}
        if self._rule.affine:
            self._summary["affine_leaves"] = 0 if tree.affine is None else len(tree.affine)
        return tree

    def _used_up(self, cells: GrowingCells) -> bool:
        """Return whether there is no time or memory for another round."""
        seconds, memory = self._limits.max_seconds, self._limits.max_memory
        if seconds is not None and time.perf_counter() - self._started > seconds:
            self._stopped = "max_seconds"
        labels = max(self._order) + 1 if self._rule.affine else 0
        taken = rounds_memory(self._points.count, len(cells.level), labels, self._n)
        if memory is not None and taken + round_bytes(self._test_points, self._r, labels) > memory:
            self._stopped = "max_memory"
        return bool(self._stopped)

    def _finest(self, times: np.ndarray) -> np.ndarray:
        """Return the finest cells along cells' edges (M, n), split so often along each axis."""
        return np.array(self._r, dtype=np.int64) ** (self._max_level - times.astype(np.int64))

    def _open(self, cells: GrowingCells) -> np.ndarray:
        """Return which cells may yet be split; where solves are counted, accepted ones too."""
        counted = self._max_solves is not None
        waiting = cells.error > NEGLIGIBLE if counted else ~cells.accepted
        return waiting & (cells.child < 0) & cells.axes.any(axis=1)

    def _next(self, cells: GrowingCells, spent: int) -> np.ndarray:
        """Return the cells to split in the next round; `spent` solves went into a block before.

        Where solves are counted those come first whose estimated error, times their volume, is
        largest.
        """
        chosen = np.flatnonzero(self._open(cells))
        left = math.inf
        if self._max_solves is not None:
            left = (self._max_solves - self._points.count) // ROUND_SHARE
            shares = 1 / np.prod(np.array(self._r, dtype=float) ** cells.times[chosen], axis=1)
            chosen = chosen[np.argsort(-cells.error[chosen] * shares, kind="stable")]
        tests = np.cumsum(self._tests(cells.axes[chosen]))
        solves = spent * np.arange(1, len(chosen) + 1) if spent else tests
        return chosen[: max(1, np.count_nonzero((tests <= ROUND_POINTS) & (solves <= left)))]

    def _tests(self, axes: np.ndarray) -> np.ndarray:
        """Return the test points of the blocks (M,) of cells that are split along axes (M, n)."""
        if not self._rule.adaptive:
            return np.full(len(axes), self._test_points.in_block(self._r))
        _, first, kind = np.unique(
            axes @ (1 << np.arange(self._n)), return_index=True, return_inverse=True
        )
        blocks = [self._test_points.in_block(np.where(axes[k], self._r, 1).tolist()) for k in first]
        return np.array(blocks, dtype=np.int64)[kind]

    def _split(self, cells: GrowingCells, chosen: np.ndarray) -> GrowingCells | None:
        """Split the cells, or fewer where there are too few solves left; None where for none."""
        while chosen.size:
            groups = cells.groups(chosen, self._r)
            new = self._evaluate(groups)
            if new is not None:
                parents = np.concatenate([group.cells for group in groups])
                counts = cells.children(parents, self._r)
                cells.child[parents] = len(cells.level) + np.cumsum(counts) - counts
                return new
            chosen = chosen[: len(chosen) // 2]
        return None

    def _evaluate(self, groups: list[SplitCells]) -> GrowingCells | None:
        """Return the children in blocks, or None where that takes too many solves."""
        tests: list[tuple[np.ndarray, tuple[int, ...], np.ndarray]] = []
        roles, levels = [], []
        for group in groups:
            size = FINE * self._finest(group.times)
            stream = self._blocks.stream(self._streams + len(tests))
            keys, table, role = self._blocks.keys(group.corners, group.factors, size, stream)
            tests.append((keys.ravel(), keys.shape, table))
            roles.append(np.repeat(role, len(size)))
            levels.append(np.tile(group.level, len(keys)))
        question = self._points.ask(np.concatenate([keys for keys, _, _ in tests]))
        self._needed = int(question.new.sum())
        if self._exceeds(question):
            return None
        self._streams += len(tests)
        samples, counted = question.samples, self._max_solves is not None
        self._roles += np.bincount(np.concatenate(roles)[samples], minlength=len(ROLES))
        self._solves += np.bincount(np.concatenate(levels)[samples], minlength=len(self._solves))
        # where solves are counted, any level may come next
        deepest = len(self._solves) - 1 if counted else max(int(g.level.max()) for g in groups)
        masks, scores = self._points.answer_with_scores(
            question, deepest, len(self._solves) - 1, sum(len(g.corners) for g in groups)
        )
        self._points.check_finite(self._points.count, MANY)
        made: list[GrowingCells] = []
        start = 0
        for group, (keys, shape, table) in zip(groups, tests):
            part = slice(start, start + len(keys))
            start = part.stop
            chunk = max(1, CHUNK_SCORES // (table.size * max(1, scores[0].size)))
            for first in range(0, len(group.corners), chunk):
                some = slice(first, first + chunk)
                made.append(
                    self._cells(
                        group.part(some),
                        table,
                        keys.reshape(shape)[:, some],
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
        blocks: SplitCells,
        table: np.ndarray,
        keys: np.ndarray,
        masks: np.ndarray,
        scores: np.ndarray,
    ) -> GrowingCells:
        """Return the children of blocks, fitted: keys, masks (U, M) and scores (U, M, V, S)."""
        count, children = len(blocks.corners), len(table)
        times = np.repeat(blocks.times, children, axis=0)
        size = FINE * self._finest(times)
        corners = np.repeat(blocks.corners, children, axis=0)
        corners = corners + np.tile(grid_places(blocks.factors), (count, 1)) * size
        rows = np.moveaxis(table, 0, 1)  # (P, children)

        def spread(values: np.ndarray) -> np.ndarray:
            """Return values of test points (U, M, ...) as those of cells (P, M children, ...)."""
            found = np.swapaxes(values[rows], 1, 2)
            return found.reshape(len(rows), children * count, *values.shape[2:])

        cell_masks = spread(masks)
        shared = np.bitwise_and.reduce(cell_masks, axis=0)
        level = np.repeat(blocks.level, children)
        can = np.asarray(times < self._max_level)
        deeper = np.asarray(can.any(axis=1))
        common = self._quarter_rule(shared, cell_masks, corners, size, level, deeper)
        uniform = preferred(common, self._order)
        made = GrowingCells.uniform(corners, times, level, can.copy(), uniform.copy())
        made.accepted[:] = common != 0
        unlike = rest = np.flatnonzero(common == 0)
        if self._rule.affine:
            mixed = np.flatnonzero((common == 0) | self._everywhere)
            of_mixed = spread(scores)[:, mixed]
            known = np.isfinite(of_mixed).all(axis=(0, 2, 3))
            self._fit(made, mixed[known], cell_masks, of_mixed[:, known], spread(keys), size)
            rest = mixed[~known & (common[mixed] == 0)]
        if rest.size:
            made.label[rest], made.seen[rest] = most_voted(cell_masks[:, rest], self._order)
            made.error[rest] = (~holds(cell_masks[:, rest], made.label[rest])).mean(axis=0)
            if self._axes is not None:
                fixed = cell_masks[: len(self._offsets), rest]
                made.axes[rest] = self._axes.by_labels(fixed, can[rest])
        hidden = unlike[shared[unlike] != 0]  # by points of the quarter rule
        made.accepted[hidden] = False
        made.error[hidden] = np.maximum(made.error[hidden], 1 / len(rows))
        whole = (common != 0) & (made.label >= 0)
        made.label[whole] = uniform[whole]
        made.accepted[whole], made.error[whole], made.seen[whole] = True, 0.0, 0
        return made

    def _fit(
        self,
        made: GrowingCells,
        cells: np.ndarray,
        masks: np.ndarray,
        scores: np.ndarray,
        keys: np.ndarray,
        size: np.ndarray,
    ) -> None:
        """Give some cells their rows: masks and keys (P, all cells), scores (P, K, V, S)."""
        if not cells.size:
            return
        fine = size[cells]
        per_cell = np.array([r ** (self._lattice_level - self._max_level) for r in self._r])
        steps = fine // FINE * per_cell
        corners = made.corner[cells]
        places = np.empty((len(masks), len(cells), self._n), dtype=np.int64)
        fixed = len(self._offsets)
        places[:fixed] = self._offsets[:, None, :] * (fine // 2)
        for p in range(fixed, len(masks)):  # random points, which lie inside
            places[p] = self._points.places(keys[p, cells]) - corners
        # below 2^63: cells have at most 2^31 steps, and no more lattice units than that
        places = np.minimum(places * steps // fine, steps - 1)
        corners = corners // FINE * per_cell
        some, rule = masks[:, cells], self._rule
        fits = fit_cells(
            scores, some, self._offsets, places, corners, steps, self._counts, rule.plain,
            self._axes, made.axes[cells],
        )  # fmt: skip
        self._rows.append(made.fit(cells, fits, some, self._row_count, rule.most_error))
        self._row_count += len(self._rows[-1].symbols)

    def _quarter_rule(
        self,
        common: np.ndarray,
        masks: np.ndarray,
        corners: np.ndarray,
        size: np.ndarray,
        level: np.ndarray,
        can: np.ndarray,
    ) -> np.ndarray:
        """Return `common` (M,) after a second look at tied points of uniform cells that can split.

        Where that would exceed the solves that are allowed they go without.
        """
        movable = np.flatnonzero((self._offsets != 1).any(axis=1))
        point, cell = np.nonzero(several(masks[movable]) & (common != 0) & can)
        if not cell.size:
            return common
        keys = self._blocks.quarter_keys(corners[cell], size[cell], self._offsets[movable[point]])
        question = self._points.ask(keys)
        if self._exceeds(question):
            return common
        self._roles[ROLES.index("quarter")] += question.new.sum()
        new = level[cell][question.samples]
        self._solves += np.bincount(new, minlength=len(self._solves))
        last = len(self._solves) - 1
        shown = int(level.max()) if self._max_solves is None else last
        moved = self._points.answer(question, shown, last, common.size)
        common = common.copy()
        np.bitwise_and.at(common, cell, moved)
        return common

    def _counts_of(self, cells: GrowingCells) -> dict[str, Any]:
        """Return the counts of cells by level."""
        leaves, levels = [], []
        for level, here in enumerate(cells.by_level(math.prod(self._q), self._r)):
            split = cells.child[here] >= 0
            mixed = int(np.count_nonzero(split | (cells.seen[here] != 0)))
            leaves.append(int(np.count_nonzero(~split)))
            levels.append({"cells": len(here), "mixed": mixed, "solves": int(self._solves[level])})
        return {"cells": sum(leaves), "leaves_by_level": leaves, "levels": levels}

    def statistics(self) -> dict[str, Any]:
        """Return the counts of the subdivision as plain data."""
        rule = self._rule
        found = self._task.statistics(self._roles, self._stopped, rule.adaptive)
        if rule.affine:
            found |= {"leaves": "affine", "leaf_error": rule.most_error}
        if rule.adaptive:
            found["refine"] = "adaptive"
        return found | self._summary
