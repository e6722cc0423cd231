"""The books of a subdivision: what it has solved, what is left, what stopped it, second looks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.masks import last_any, several
from capsyn.cells.row_table import whole
from capsyn.subdivision.cell_blocks import ROLES, SubdivisionTask
from capsyn.subdivision.lattice_points import Question
from capsyn.subdivision.limits import too_few_solves
from capsyn.subdivision.propositions import worst_case_solves

QUARTER = ROLES.index("quarter")


class Ledger:
    """What a subdivision with so many `levels` has solved and has left.

    `roles` (4,) are solves by `ROLES`, `solves` (levels,) those that are counted by level;
    `stopped` is the limit that ended the work, if any.
    """

    def __init__(self, task: SubdivisionTask, levels: int) -> None:
        self._task, self._limits = task, task.plan.limits
        self.roles = np.zeros(len(ROLES), dtype=np.int64)
        self.solves = np.zeros(levels, dtype=np.int64)
        self.stopped = ""
        self._started = time.perf_counter()

    @property
    def left(self) -> float:
        """Solves that are left."""
        allowed = self._limits.max_solves
        return math.inf if allowed is None else allowed - self._task.points.count

    def exceeds(self, new: int, level: int = 1) -> bool:
        """Return whether so many solves are more than are left; an error for those of level 0."""
        if new <= self.left:
            return False
        plan = self._task.plan
        if level == 0:
            raise too_few_solves(new, plan.limits.max_solves, plan.grid, plan.points)
        self.stopped = self.stopped or "max_solves"
        return True

    def too_large(self, needed: int) -> bool:
        """Return whether so much memory [bytes] may not be taken."""
        bound = self._limits.max_memory
        return bound is not None and needed > bound

    def used_up(self, needed: int) -> bool:
        """Return whether time is used up, or memory does not suffice for so much [bytes]."""
        seconds = self._limits.max_seconds
        if seconds is not None and time.perf_counter() - self._started > seconds:
            self.stopped = "max_seconds"
        if self.too_large(needed):
            self.stopped = "max_memory"
        return self.stopped in ("max_seconds", "max_memory")

    def enter(self, roles: np.ndarray, levels: np.ndarray | None = None) -> None:
        """Enter solves: what they are (M,), and their levels (M,) where these are counted."""
        self.roles += np.bincount(roles, minlength=len(ROLES))
        if levels is not None:
            self.solves += np.bincount(levels, minlength=len(self.solves))

    def statistics(self) -> dict[str, Any]:
        """Return the counts of what was solved as plain data."""
        plan, points, stopped = self._task.plan, self._task.points, self.stopped
        interior = plan.points.interior(plan.grid.n)
        return ({"stopped_by": stopped} if stopped not in ("", "max_solves") else {}) | {
            "solves": points.count,
            "solves_by_role": dict(zip(ROLES, self.roles.tolist())),
            "stopped_by_max_solves": stopped == "max_solves",
            "indifferent_points": points.indifferent,
            "not_finite_points": points.not_finite,
            "not_finite_example": points.example,
            "test_points": str(plan.points),
            "seed": plan.seed,
            "worst_case_solves": worst_case_solves(plan.grid, interior, plan.adaptive),
        }


@dataclass(frozen=True, eq=False)
class Tied:
    """Points a quarter of the way to the centres of uniform cells, for test points that tie."""

    keys: np.ndarray  # (K,): their keys
    cells: tuple[np.ndarray, ...]  # (K,) each: their cells, as indices of an array of cells


class QuarterRule:
    """A tie must not hide a surface: points that tie are looked at again, nearer to the centre."""

    def __init__(self, task: SubdivisionTask, ledger: Ledger) -> None:
        self._blocks, self._points, self._ledger = task.blocks, task.points, ledger
        offsets = task.offsets
        self.movable = np.flatnonzero((offsets != 1).any(axis=1))
        """Places of the test points (K,) that it is for: fixed ones; the centre stays."""
        self._offsets = offsets[self.movable]

    def tied(
        self,
        common: np.ndarray,
        masks: np.ndarray,
        places: Callable[..., tuple[np.ndarray, np.ndarray]],
        can: np.ndarray | bool = True,
    ) -> Tied:
        """Return the points to look at again, in cells that `can` (...) be split.

        `common` (..., J, W) are the sets of symbols that could be best throughout cells, `masks`
        (P, ..., J, W) those of their test points. `places` gives, for indices of K cells, their
        corners (K, n) and edge lengths (n,) or (K, n) [lattice units].
        """
        tie = last_any(several(masks[self.movable]))
        tie &= whole(common) & can
        point, *cells = np.nonzero(tie)
        corners, sizes = places(*cells)
        keys = self._blocks.quarter_keys(corners, sizes, self._offsets[point])
        return Tied(keys, tuple(cells))

    def applied(
        self, common: np.ndarray, tied: Tied, solve: Callable[[Question], np.ndarray]
    ) -> np.ndarray:
        """Return `common` after the second look at points, whose masks `solve` returns.

        Where that would exceed the solves that are left, cells go without.
        """
        if not len(tied.keys):
            return common
        question = self._points.ask(tied.keys)
        if self._ledger.exceeds(int(question.new.sum())):
            return common
        common, seen = common.copy(), solve(question)
        for j, w in np.ndindex(*common.shape[-2:]):
            np.bitwise_and.at(common[..., j, w], tied.cells, seen[:, j, w])
        return common
