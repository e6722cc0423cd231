"""Subdivision in rounds: the cells that are split next are those where most is wrong.

So are made affine leaves, whose cells are split where their rows are wrong and not on the surface,
and cells that are split along some axes only. Cells wait in a list; no more than a round's test
points are in memory beside the solved points.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.row_table import whole
from capsyn.errors import SynthesisError
from capsyn.modelling.grid import MAX_COUNT, grid_places
from capsyn.subdivision.affine_fit import fit_cells
from capsyn.subdivision.cell_blocks import SubdivisionTask
from capsyn.subdivision.cell_points import FINE
from capsyn.subdivision.growing_cells import GrowingCells, Rows, SplitCells, row_grid
from capsyn.subdivision.lattice_points import MANY, Question
from capsyn.subdivision.ledger import QUARTER, Ledger, QuarterRule
from capsyn.subdivision.limits import round_bytes, rounds_memory
from capsyn.subdivision.split_axes import SplitAxes

ROUND_POINTS = 2**19
"""Test points of the blocks that are split in one round, at most."""
ROUND_SHARE = 4
"""One in so many of the solves that are left is spent in one round."""
NEGLIGIBLE = 1e-6
"""Estimated error for which no solves are spent: that of rounding rows."""
CHUNK_SCORES = 2**21
"""Scores that are fitted, or masks of constant leaves that are compared, at a time."""


class RoundSubdivision:
    """Algorithm 1 in rounds."""

    def __init__(self, task: SubdivisionTask) -> None:
        self._task, self._points, self._row_table = task, task.points, task.rows
        self._labels = task.rows.label_count
        self._plan = plan = task.plan
        self._grid, self._refinement = plan.grid, plan.grid.refinement
        self._max_level, self._max_solves = plan.grid.max_level, plan.limits.max_solves
        self._offsets = task.offsets
        self._axes = SplitAxes.of(self._offsets) if plan.adaptive else None
        # without vertices, cells whose test points agree may have others in their corners
        self._everywhere = plan.affine and not (task.plain or plan.points.vertices)
        self._lattice = row_grid(plan.grid) if plan.affine else plan.grid
        self._last_level = self._max_level * (plan.grid.n if plan.adaptive else 1)
        self._ledger = Ledger(task, self._last_level + 1)
        self._rule = QuarterRule(task, self._ledger)
        self._streams = 0
        self._rows: list[Rows] = []
        self._row_count = 0
        self._summary: dict[str, Any] = {}

    def run(self) -> CellTree:
        """Return the cells."""
        corners = grid_places(self._grid.partitions) * (FINE * self._grid.sizes(0))
        cells, spent = self._evaluate([SplitCells.roots(corners)]), 0
        assert cells is not None  # too few solves for the root grid are an error
        while not self._used_up(cells) and (chosen := self._next(cells, spent)).size:
            before, split = self._points.count, np.count_nonzero(cells.child >= 0)
            new = self._split(cells, chosen)
            if new is None:
                break
            spent = (self._points.count - before) // (np.count_nonzero(cells.child >= 0) - split)
            cells = GrowingCells.joined([cells, new])
            if len(cells.level) > MAX_COUNT:
                raise SynthesisError("there are more cells than 32-bit entries can number")
        ledger, plan = self._ledger, self._plan
        if not self._open(cells).any():
            ledger.stopped = ""
        elif self._max_solves is not None:
            ledger.stopped = ledger.stopped or "max_solves"
        self._points.check_finite(self._points.count)
        leaves = cells.child < 0
        cells.label[leaves] = self._row_table.settle(cells.label[leaves])
        first = len(self._row_table.labels())
        prices = self._task.prices
        ratios = None if prices is None else prices.ratios
        tree = cells.tree(self._lattice, first, self._rows, plan.adaptive, ratios)
        self._summary = self._counts_of(cells) | {"mixed_cells": len(tree.mixed_cells)}
        if plan.affine:
            self._summary["affine_leaves"] = 0 if tree.affine is None else len(tree.affine)
        return tree

    def _used_up(self, cells: GrowingCells) -> bool:
        """Return whether there is no time or memory for another round."""
        labels = self._labels if self._plan.affine else 0
        taken = rounds_memory(self._points.count, len(cells.level), labels, self._grid.n)
        return self._ledger.used_up(
            taken + round_bytes(self._plan.points, self._refinement, labels)
        )

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
            shares = 1 / np.prod(
                np.array(self._refinement, dtype=float) ** cells.times[chosen], axis=1
            )
            chosen = chosen[np.argsort(-cells.error[chosen] * shares, kind="stable")]
        tests = np.cumsum(self._tests(cells.axes[chosen]))
        solves = spent * np.arange(1, len(chosen) + 1) if spent else tests
        return chosen[: max(1, np.count_nonzero((tests <= ROUND_POINTS) & (solves <= left)))]

    def _tests(self, axes: np.ndarray) -> np.ndarray:
        """Return the test points of the blocks (M,) of cells that are split along axes (M, n)."""
        points, refinement = self._plan.points, self._refinement
        if not self._plan.adaptive:
            return np.full(len(axes), points.in_block(refinement))
        _, first, kind = np.unique(
            axes @ (1 << np.arange(self._grid.n)), return_index=True, return_inverse=True
        )
        blocks = [points.in_block(np.where(axes[k], refinement, 1).tolist()) for k in first]
        return np.array(blocks, dtype=np.int64)[kind]

    def _split(self, cells: GrowingCells, chosen: np.ndarray) -> GrowingCells | None:
        """Split the cells, or fewer where there are too few solves left; None where for none."""
        while chosen.size:
            groups = cells.groups(chosen, self._refinement)
            new = self._evaluate(groups)
            if new is not None:
                parents = np.concatenate([group.cells for group in groups])
                counts = cells.children(parents, self._refinement)
                cells.child[parents] = len(cells.level) + np.cumsum(counts) - counts
                return new
            chosen = chosen[: len(chosen) // 2]
        return None

    def _evaluate(self, groups: list[SplitCells]) -> GrowingCells | None:
        """Return the children in blocks, or None where that takes too many solves."""
        tests: list[tuple[np.ndarray, tuple[int, ...], np.ndarray]] = []
        roles, levels = [], []
        blocks = self._task.blocks
        for group in groups:
            size = FINE * self._grid.edges(group.times)
            stream = blocks.stream(self._streams + len(tests))
            keys, table, role = blocks.keys(group.corners, group.factors, size, stream)
            tests.append((keys.ravel(), keys.shape, table))
            roles.append(np.repeat(role, len(size)))
            levels.append(np.tile(group.level, len(keys)))
        question = self._points.ask(np.concatenate([keys for keys, _, _ in tests]))
        deepest = max(int(group.level.max()) for group in groups)
        if self._ledger.exceeds(int(question.new.sum()), deepest):
            return None
        self._streams += len(tests)
        samples = question.samples
        self._ledger.enter(np.concatenate(roles)[samples], np.concatenate(levels)[samples])
        masks, scores = self._points.answer(
            question, *self._shown(deepest), sum(len(group.corners) for group in groups)
        )
        self._points.check_finite(self._points.count, MANY)
        children: list[GrowingCells] = []
        start = 0
        for group, (keys, shape, table) in zip(groups, tests):
            part = slice(start, start + len(keys))
            start = part.stop
            chunk = max(1, CHUNK_SCORES // (table.size * max(1, scores[0].size)))
            for first in range(0, len(group.corners), chunk):
                some = slice(first, first + chunk)
                children.append(
                    self._cells(
                        group.part(some),
                        table,
                        keys.reshape(shape)[:, some],
                        masks[part].reshape(*shape, *self._points.shape)[:, some],
                        scores[part].reshape(*shape, *scores.shape[1:])[:, some],
                    )
                )
        return GrowingCells.joined(children)

    def _shown(self, level: int) -> tuple[int, int]:
        """Return the level that progress tells, and the last; any may come where solves count."""
        return level if self._max_solves is None else self._last_level, self._last_level

    def _cells(
        self,
        blocks: SplitCells,
        table: np.ndarray,
        keys: np.ndarray,
        masks: np.ndarray,
        scores: np.ndarray,
    ) -> GrowingCells:
        """Return the children of blocks, fitted.

        Of test points are given keys (U, M), sets (U, M, J, W) and scores (U, M, V, S).
        """
        count, children = len(blocks.corners), len(table)
        times = np.repeat(blocks.times, children, axis=0)
        size = FINE * self._grid.edges(times)
        corners = np.repeat(blocks.corners, children, axis=0)
        corners = corners + np.tile(grid_places(blocks.factors), (count, 1)) * size
        rows = np.moveaxis(table, 0, 1)  # (P, children)

        def spread(values: np.ndarray) -> np.ndarray:
            """Return values of test points (U, M, ...) as those of cells (P, M children, ...)."""
            of_cells = np.swapaxes(values[rows], 1, 2)
            return of_cells.reshape(len(rows), children * count, *values.shape[2:])

        cell_masks = spread(masks)
        shared = np.bitwise_and.reduce(cell_masks, axis=0)
        level = np.repeat(blocks.level, children)
        can = np.asarray(times < self._max_level)
        deeper = np.asarray(can.any(axis=1))
        common = self._quarter_rule(shared, cell_masks, level, deeper, (corners, size))
        alike = whole(common)
        uniform = self._row_table.uniform(common, alike)
        cells = GrowingCells.uniform(
            corners, times, level, can.copy(), uniform.copy(), self._points.shape
        )
        cells.accepted[:] = alike
        unlike = rest = np.flatnonzero(~alike)
        if self._plan.affine:
            mixed = np.flatnonzero(~alike | self._everywhere)
            of_mixed = spread(scores)[:, mixed]
            known = np.isfinite(of_mixed).all(axis=(0, 2, 3))
            self._fit(cells, mixed[known], cell_masks, of_mixed[:, known], spread(keys), size)
            rest = mixed[~known & ~alike[mixed]]
        if rest.size:
            sets = cell_masks[:, rest]
            cells.label[rest], cells.seen[rest] = self._row_table.voted(sets)
            cells.error[rest] = (~self._row_table.right(sets, cells.label[rest])).mean(axis=0)
            if self._axes is not None:
                fixed = cell_masks[: len(self._offsets), rest]
                cells.axes[rest] = self._axes.by_labels(fixed, can[rest])
        hidden = unlike[whole(shared[unlike])]  # by points of the quarter rule
        cells.accepted[hidden] = False
        cells.error[hidden] = np.maximum(cells.error[hidden], 1 / len(rows))
        same = alike & (cells.label >= 0)
        cells.label[same] = uniform[same]
        cells.accepted[same], cells.error[same], cells.seen[same] = True, 0.0, 0
        return cells

    def _fit(
        self,
        cells: GrowingCells,
        chosen: np.ndarray,
        masks: np.ndarray,
        scores: np.ndarray,
        keys: np.ndarray,
        size: np.ndarray,
    ) -> None:
        """Give K chosen cells their rows, of sets, keys (P, all cells) and scores (P, K, V, S)."""
        if not chosen.size:
            return
        fine = size[chosen]
        per_cell = self._lattice.sizes(self._max_level)
        steps = fine // FINE * per_cell
        corners = cells.corner[chosen]
        places = np.empty((len(masks), len(chosen), self._grid.n), dtype=np.int64)
        fixed = len(self._offsets)
        places[:fixed] = self._offsets[:, None, :] * (fine // 2)
        for p in range(fixed, len(masks)):  # random points, which lie inside
            places[p] = self._points.places(keys[p, chosen]) - corners
        # below 2^63: cells have at most 2^31 steps, and no more lattice units than that
        places = np.minimum(places * steps // fine, steps - 1)
        corners = corners // FINE * per_cell
        masks = masks[:, chosen]
        fits = fit_cells(
            scores, masks, self._offsets, places, corners, steps, self._lattice.counts,
            self._task.plain, self._axes, cells.axes[chosen], self._task.prices,
        )  # fmt: skip
        rows = cells.fit(chosen, fits, masks, self._row_count, self._plan.leaf_error)
        self._rows.append(rows)
        self._row_count += len(rows.symbols)

    def _quarter_rule(
        self,
        common: np.ndarray,
        masks: np.ndarray,
        level: np.ndarray,
        can: np.ndarray,
        places: tuple[np.ndarray, np.ndarray],
    ) -> np.ndarray:
        """Return `common` after a second look at tied points of uniform cells that can split.

        `places` are the corners and edge lengths (M, n) of the cells. Where that would exceed the
        solves that are allowed they go without.
        """
        corners, size = places
        tied = self._rule.tied(common, masks, lambda cell: (corners[cell], size[cell]), can)

        def solve(question: Question) -> np.ndarray:
            new = level[tied.cells][question.samples]
            self._ledger.enter(np.full(len(new), QUARTER), new)
            return self._points.answer(question, *self._shown(int(level.max())), len(common))[0]

        return self._rule.applied(common, tied, solve)

    def _counts_of(self, cells: GrowingCells) -> dict[str, Any]:
        """Return the counts of cells by level."""
        leaves, levels = [], []
        solves = self._ledger.solves.tolist()
        for level, here in enumerate(cells.by_level(self._grid)):
            split = cells.child[here] >= 0
            seen = (cells.seen[here] != 0).any(axis=(1, 2))
            mixed = int(np.count_nonzero(split | seen))
            leaves.append(int(np.count_nonzero(~split)))
            levels.append({"cells": len(here), "mixed": mixed, "solves": solves[level]})
        return {"cells": sum(leaves), "leaves_by_level": leaves, "levels": levels}

    def statistics(self) -> dict[str, Any]:
        """Return the counts of the subdivision as plain data."""
        plan, statistics = self._plan, self._ledger.statistics()
        if plan.affine:
            statistics |= {"leaves": "affine", "leaf_error": plan.leaf_error}
        if plan.adaptive:
            statistics["refine"] = "adaptive"
        return statistics | self._summary
