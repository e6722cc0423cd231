"""Closed loops of the optimum's own policy: one step of lookahead on its values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.execution.processors import pool_of
from capsyn.native.source import LANES
from capsyn.optima.grid import StateGrid
from capsyn.optima.sweeps import HUGE_COST, CompiledSweeps, Successors
from capsyn.optima.task import Task

TIE = 1e-12
"""Share of a cost by which another symbol must be cheaper than the one in force."""


@dataclass(frozen=True, eq=False)
class Lookahead:
    """Values on a grid, and what each symbol costs by them. Safe to call from threads."""

    kernel: Any  # `NumpySweeps` or `CompiledSweeps`
    task: Task
    grid: StateGrid
    values: np.ndarray  # (R, size): of nodes, and after them zeros
    bends: np.ndarray  # (R, size, n): half their curvature along each axis

    def costs(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return costs (B, N) of each symbol at states (B, n): if it is in force, if it is entered.

        They are those of a sample and of the best after it; infinite where there is none.
        """
        count = len(self.task.alphabet)
        table = Successors.empty(-(-len(states) // LANES), count, len(self.grid.counts))
        self.kernel.successors(states, table)

        def along(rows: np.ndarray) -> np.ndarray:
            costs = self.kernel.follow(table, self.values, self.bends, rows)
            costs = costs.swapaxes(1, 2).reshape(-1, count)[: len(states)]
            return np.where(costs >= HUGE_COST, np.inf, costs)

        stays = along(self.task.tops)
        return stays, along(self.task.entries) if (self.task.held > 1).any() else stays

    def options(self, states: np.ndarray, current: np.ndarray) -> np.ndarray:
        """Return costs (B, N) of what may be next where symbols `current` (B,) are in force.

        -1 is the default control, which may be left at once.
        """
        stays, entered = self.costs(states)
        costs = entered + self.task.switches[current]
        now = np.flatnonzero(current >= 0)
        costs[now, current[now]] = stays[now, current[now]]
        return costs

    def choose(self, states: np.ndarray, current: np.ndarray) -> np.ndarray:
        """Return the best symbols (B,); of ties that in force, else the lowest."""
        costs = self.options(states, current)
        best = costs.argmin(axis=1)
        every = np.arange(len(costs))
        if self.task.remembers:
            own = np.where(current >= 0, costs[every, current], np.inf)
            least = costs[every, best]
            best = np.where(own <= least + TIE * np.abs(least), current, best)
        return best

    def run(self, starts: np.ndarray, samples: int, threads: int = 1) -> Loops:
        """Return closed loops from starts (B, n)."""
        if not isinstance(self.kernel, CompiledSweeps):
            return self._run(starts, samples)
        blocks = -(-len(starts) // LANES)
        size = -(-blocks // threads) * LANES
        parts = [starts[k : k + size] for k in range(0, len(starts), size)]
        with pool_of(threads) as pool:
            own = (samples, self.values, self.bends, TIE)
            found = pool.map(lambda x: self.kernel.loops(x, *own), parts)
            costs, switches, out = zip(*found, strict=True)
        cost = np.concatenate(costs)
        cost[~np.isfinite(cost)] = np.inf
        return Loops(cost, np.concatenate(switches), np.concatenate(out, axis=1))

    def _run(self, starts: np.ndarray, samples: int) -> Loops:
        """Return the same by NumPy."""
        task = self.task
        count, box = len(starts), self.grid.box
        x, cost = starts.astype(float), np.zeros(count)
        symbol, rest = np.full(count, -1), np.zeros(count, dtype=int)
        out, switches = np.zeros((2, count, x.shape[1])), np.zeros(count, dtype=int)
        free = ~np.array(box.periodic)
        for live in self._live(x, samples):
            now = symbol[live]
            taken = np.where(rest[live] > 0, now, self.choose(x[live], now))
            changed = taken != now
            cost[live] += np.where(changed, task.switches[now, taken], 0.0)
            switches[live] += changed & (now >= 0)
            rest[live] = np.where(changed, task.held[taken], rest[live]) - 1
            symbol[live] = taken
            ends, gathered = self.kernel.advance(x[live], task.alphabet.values[taken])
            x[live] = ends
            cost[live] += gathered + task.efforts[taken] * task.period
            beyond = np.stack([box.lower - ends, ends - box.upper])
            finite = np.isfinite(beyond).all(axis=(0, 2))[None, :, None]
            beyond = np.where(finite, np.maximum(beyond, 0.0), np.inf) * free
            out[:, live] = np.maximum(out[:, live], np.nan_to_num(beyond, nan=0.0, posinf=np.inf))
        cost[~np.isfinite(cost)] = np.inf
        return Loops(cost, switches, out)

    def _live(self, x: np.ndarray, samples: int) -> Iterator[np.ndarray]:
        """Yield, for each sample, which loops go on."""
        for _ in range(samples):
            condition = self.task.inside.evaluate(x.T)[0][0]
            ended = (condition != 0) & np.isfinite(condition)
            live = np.flatnonzero(~ended & np.isfinite(x).all(axis=1))
            if not len(live):
                return
            yield live


@dataclass(frozen=True, eq=False)
class Loops:
    """What closed loops cost, and how far they left the grid."""

    costs: np.ndarray  # (B,), infinite where a state was not finite
    switches: np.ndarray  # (B,) ints
    out: np.ndarray  # (2, B, n): farthest beyond the lower and the upper face [state units]

    @property
    def left(self) -> np.ndarray:
        """Which loops left the grid (B,)."""
        return np.asarray(self.out.any(axis=(0, 2)))
