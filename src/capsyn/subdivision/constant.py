"""Algorithm 1 of the paper with one symbol for each cell, level by level.

A level whose test points would take too much memory is labelled block by block. What stays from
block to block are the solved points, each with its key and mask, the entries of the cells, and the
keys of the mixed cells' corners. So no point is solved twice, and the result is that of whole
levels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.row_table import whole
from capsyn.errors import SynthesisError
from capsyn.modelling.grid import MAX_COUNT, grid_places
from capsyn.subdivision.cell_blocks import SubdivisionTask
from capsyn.subdivision.cell_points import FINE
from capsyn.subdivision.lattice_points import MANY, Question
from capsyn.subdivision.ledger import QUARTER, Ledger, QuarterRule, Tied
from capsyn.subdivision.limits import (
    BYTES_PER_ENTRY,
    BYTES_PER_MIXED,
    block_bytes,
    block_parents,
)


@dataclass(eq=False)
class _Block:
    """Parents' corners (M, n), and the keys of their children's test points as `CellBlocks`."""

    parents: np.ndarray
    keys: np.ndarray
    table: np.ndarray
    roles: np.ndarray


@dataclass(eq=False)
class _Level:
    """Labelled cells.

    Entries (K,); of those that are mixed and not split the places, the labels seen and the keys of
    the corners (M,); and how many are, or were, mixed.
    """

    entries: np.ndarray
    mixed: np.ndarray
    seen: np.ndarray
    corners: np.ndarray
    count: int

    @staticmethod
    def joined(parts: list[_Level]) -> _Level:
        """Return the cells of blocks that follow each other."""
        if len(parts) == 1:
            return parts[0]
        starts = np.cumsum([0] + [len(p.entries) for p in parts[:-1]])
        return _Level(
            np.concatenate([p.entries for p in parts]),
            np.concatenate([p.mixed + start for p, start in zip(parts, starts)]),
            np.concatenate([p.seen for p in parts]),
            np.concatenate([p.corners for p in parts]),
            sum(p.count for p in parts),
        )

    @property
    def split(self) -> int:
        """How many cells are split."""
        return self.count - len(self.mixed)


class ConstantSubdivision:
    """Algorithm 1, level by level, all cells of a level or of a block of it at once.

    Arrays over the test points of a block have the point first and the parent cell last, so that
    all work on masks runs along contiguous memory.
    """

    def __init__(self, task: SubdivisionTask) -> None:
        self._task, self._points, self._rows = task, task.points, task.rows
        self._grid, self._max_level = task.plan.grid, task.plan.grid.max_level
        self._ledger = Ledger(task, self._max_level + 1)  # by level it has test points only
        self._rule = QuarterRule(task, self._ledger)
        self._levels: list[_Level] = []
        self._held = 0  # bytes beside the solved points

    def run(self) -> CellTree:
        """Return the cells."""
        parents = self._keys(grid_places(self._grid.partitions) * self._size(0))
        start = 0
        for level in range(self._max_level + 1):
            cells = self._children(level) * len(parents)
            if start + cells > MAX_COUNT:
                raise SynthesisError(f"level {level} has more cells than 32-bit entries can number")
            labelled = self._level(parents, level)
            if labelled is None:
                break
            if level:  # the mixed cells of the level above are split after all
                self._link(self._levels[-1], start, len(labelled.entries))
            self._levels.append(labelled)
            start += len(labelled.entries)
            parents, labelled.corners = labelled.corners, labelled.corners[:0]
            if self._ledger.stopped or not len(parents):
                break
        self._points.check_finite(self._points.count)
        starts = np.cumsum([0] + [len(x.entries) for x in self._levels[:-1]])
        mixed = [x.mixed + start for x, start in zip(self._levels, starts)]
        entries = np.concatenate([x.entries for x in self._levels])
        leaves = entries < 0
        entries[leaves] = -1 - self._rows.settle(-1 - entries[leaves])
        return CellTree(
            self._grid,
            entries,
            np.concatenate(mixed).astype(np.int32),
            np.concatenate([x.seen for x in self._levels]).astype(np.uint64),
        )

    def statistics(self) -> dict[str, Any]:
        """Return the counts of the subdivision as plain data."""
        leaves = [len(x.entries) - x.split for x in self._levels]
        return self._ledger.statistics() | {
            "cells": sum(leaves),
            "leaves_by_level": leaves,
            "mixed_cells": sum(len(x.mixed) for x in self._levels),
            "levels": [
                {"cells": len(x.entries), "mixed": x.count, "solves": solves}
                for x, solves in zip(self._levels, self._ledger.solves.tolist())
            ],
        }

    def _children(self, level: int) -> int:
        """Return the cells of a level that have one parent."""
        return math.prod(self._grid.split(level))

    def _size(self, level: int) -> np.ndarray:
        """Return the edge lengths (n,) of the cells of a level [lattice units]."""
        return FINE * self._grid.sizes(level)

    def _keys(self, corners: np.ndarray) -> np.ndarray:
        """Return the keys (K,) of lattice points (K, n)."""
        return self._points.encode(np.zeros((1, self._grid.n), dtype=np.int64), corners)[0]

    def _link(self, above: _Level, start: int, cells: int) -> None:
        """Split the first mixed cells of a level into `cells` new ones from entry `start` on."""
        children = self._grid.children
        split = cells // children
        above.entries[above.mixed[:split]] = start + children * np.arange(split)
        above.mixed, above.seen = above.mixed[split:], above.seen[split:]

    def _level(self, parents: np.ndarray, level: int) -> _Level | None:
        """Return the labelled children of cells whose corners have these keys.

        Those of the first blocks, where time or memory is used up; None where there are no solves
        for all of them, or no block was labelled.
        """
        self._held = sum(map(_bytes, self._levels))
        sizes = len(parents), self._need(level), self._leave(level), self._taken
        step = block_parents(self._task.plan.limits, *sizes)
        parts = [parents[i : i + step] for i in range(0, len(parents), step)]
        cells = self._children(level) * len(parents)
        quarter = level < self._max_level
        stop: Callable[[int, int], bool] | None = self._used_up
        tests = len(parents) * self._tests_of(level)
        tied = cells * len(self._rule.movable) * quarter
        ledger = self._ledger
        if len(parts) > 1 and tests + tied > ledger.left:  # else they suffice, surely
            tests = self._count(parts, level)
            if ledger.exceeds(tests, level):
                return None
            if quarter and tests + tied > ledger.left:
                parts, quarter = self._solve_first(parts, level, cells)
                stop = None
        done: list[_Level] = []
        for block in self._tests(parts, level, stop):
            question = self._points.ask(block.keys.ravel())
            if ledger.exceeds(int(question.new.sum()), level):
                break
            masks = self._solve(block, question, level, cells)
            done.append(self._label(block, masks, level, cells, quarter))
            self._held += _bytes(done[-1])
        if done:
            self._points.check_finite(self._points.count, MANY)
        return _Level.joined(done) if done else None

    def _tests(
        self, parts: list[np.ndarray], level: int, stop: Callable[[int, int], bool] | None
    ) -> Iterator[_Block]:
        """Yield the blocks of some parents, given by the keys of their corners.

        Below the root grid no more once ``stop(parents, level)`` says so.
        """
        blocks, split = self._task.blocks, np.array(self._grid.split(level))
        rng, size = blocks.stream(level), self._size(level)
        for part in parts:
            if level and stop and stop(len(part), level):
                return
            corners = self._points.places(part)
            yield _Block(corners, *blocks.keys(corners, split, size, rng))

    def _need(self, level: int) -> int:
        """Return the bytes that labelling the children of one cell takes."""
        plan = self._task.plan
        return block_bytes(plan.points, plan.grid.split(level), self._points.set_bytes)

    def _tests_of(self, level: int) -> int:
        """Return the test points of the children of one cell."""
        return self._task.plan.points.in_block(self._grid.split(level))

    def _used_up(self, parents: int, level: int) -> bool:
        """Return whether time or memory does not suffice for a block of so many parents."""
        return self._ledger.used_up(self._taken + parents * self._need(level))

    @property
    def _taken(self) -> int:
        """Bytes that are taken between blocks."""
        return self._points.count * self._points.point_bytes + self._held

    def _leave(self, level: int) -> int:
        """Return the bytes that the children of one cell leave at worst."""
        points = self._tests_of(level) * self._points.point_bytes
        return points + self._children(level) * (BYTES_PER_ENTRY + BYTES_PER_MIXED)

    def _count(self, parts: list[np.ndarray], level: int) -> int:
        """Return how many test points of blocks are new.

        Below the root grid it ends where they are too many; or where their keys fill the memory:
        solved points take more, so that what follows would not be reached.
        """
        new = self._points.unsolved()

        def stop(parents: int, level: int) -> bool:
            needed = self._taken + new.nbytes + parents * self._need(level)
            return len(new) > self._ledger.left or self._ledger.too_large(needed)

        for block in self._tests(parts, level, stop):
            new.add(block.keys.ravel())
        return len(new)

    def _solve_first(
        self, parts: list[np.ndarray], level: int, cells: int
    ) -> tuple[list[np.ndarray], bool]:
        """Solve the test points of blocks, and then see whether solves suffice for ties.

        Returns the blocks that time and memory sufficed for, and whether all their ties can have
        the quarter rule. Memory is charged with all that they will leave.
        """
        held, point = self._held, self._points.point_bytes
        children = self._children(level)
        labels = self._held = held + len(parts[0]) * self._leave(level)  # it will be made anew
        tied, reached = self._points.unsolved(), 0
        for block in self._tests(parts, level, self._used_up):
            keys, mixed = self._solve_and_tie(block, level, cells)
            tied.add(keys)
            reached += 1
            labels += BYTES_PER_ENTRY * children * len(block.parents) + BYTES_PER_MIXED * mixed
            self._held = labels + tied.nbytes + len(tied) * point
        self._held = held
        return parts[:reached], not self._ledger.exceeds(len(tied))

    def _solve(self, block: _Block, question: Question, level: int, cells: int) -> np.ndarray:
        """Return the sets (U, M, J, W) of a block's test points."""
        shape = block.keys.shape
        roles = block.roles[question.samples // shape[1]]
        self._ledger.enter(roles, np.full(len(roles), level))
        block.keys = block.keys[:0]
        masks, _ = self._points.answer(question, level, self._max_level, cells)
        return masks.reshape(*shape, *self._points.shape)

    def _solve_and_tie(self, block: _Block, level: int, cells: int) -> tuple[np.ndarray, int]:
        """Solve test points; return the keys (K,) of the quarter rule, and mixed cells at worst."""
        masks = self._solve(block, self._points.ask(block.keys.ravel()), level, cells)
        masks = masks[block.table.T]
        common = np.bitwise_and.reduce(masks, axis=0)
        tied = self._tied(common, masks, block.parents, level)
        common[tied.cells] = 0
        return tied.keys, int(np.sum(~whole(common)))

    def _label(
        self, block: _Block, masks: np.ndarray, level: int, cells: int, quarter: bool
    ) -> _Level:
        """Return the labelled children of a block, whose test points have sets (U, M, J, W)."""
        masks = masks[block.table.T]  # (points, children, parents, J, W)
        common = np.bitwise_and.reduce(masks, axis=0)
        if quarter:
            common = self._quarter_rule(common, masks, block.parents, level, cells)
        children, count = common.shape[:2]
        alike = whole(common)
        entries = -1 - self._rows.uniform(common, alike).T.ravel()  # in the order of the blocks
        mixed = np.flatnonzero(~alike.T)
        parent, child = np.divmod(mixed, children)
        points = masks.reshape(len(masks), -1, *self._points.shape)
        labels, seen = self._rows.voted(points.take(child * count + parent, axis=1))
        entries[mixed] = -1 - labels
        deeper = slice(None) if level < self._max_level else slice(0)
        corners = self._corners(block.parents, child[deeper], parent[deeper], level)
        return _Level(entries, mixed, seen, self._keys(corners), len(mixed))

    def _corners(
        self, parents: np.ndarray, child: np.ndarray, parent: np.ndarray, level: int
    ) -> np.ndarray:
        """Return the lower corners (K, n) of children of parents."""
        return parents[parent] + grid_places(self._grid.split(level))[child] * self._size(level)

    def _tied(self, common: np.ndarray, masks: np.ndarray, parents: np.ndarray, level: int) -> Tied:
        """Return what the quarter rule is for, of the children of parents (M, n)."""

        def places(child: np.ndarray, parent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return self._corners(parents, child, parent, level), self._size(level)

        return self._rule.tied(common, masks, places)

    def _quarter_rule(
        self, common: np.ndarray, masks: np.ndarray, parents: np.ndarray, level: int, cells: int
    ) -> np.ndarray:
        """Return `common` (children, parents, J, W) after a second look at tied points.

        Where that would exceed the solves that are allowed, this level is the last and goes
        without.
        """

        def solve(question: Question) -> np.ndarray:
            self._ledger.enter(np.full(question.new.sum(), QUARTER))
            return self._points.answer(question, level, self._max_level, cells, quarter=True)[0]

        return self._rule.applied(common, self._tied(common, masks, parents, level), solve)


def _bytes(level: _Level) -> int:
    """Return what labelled cells take."""
    return BYTES_PER_ENTRY * len(level.entries) + BYTES_PER_MIXED * len(level.mixed)
