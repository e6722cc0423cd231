"""Values of a grid by sweeps, and the grid that loops need."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Executor
from typing import Any

import numpy as np

from capsyn.execution.processors import pool_of
from capsyn.native.compiled import compiled
from capsyn.native.source import LANES
from capsyn.optima.grid import StateGrid
from capsyn.optima.loops import Lookahead, Loops
from capsyn.optima.sweeps import CHUNK, HUGE_COST, CompiledSweeps, NumpySweeps, Successors
from capsyn.optima.task import Task

SETTLED = 1e-6
"""Share of the mean value by which sweeps that are left out may change values apart."""
COARSE = 4
"""How much coarser the grid is by which the box is widened first."""
STRIDE_STATES, MOST_STRIDE = 1024, 8
"""Random states at which it is seen how far a sample leads, and most samples of a sweep."""
LONG = 8
"""Intervals that the longest moves go, too, where loops end in a target."""
LOOK = 8
"""Sweeps from one look at whether values have settled to the next."""


def reached(
    task: Task,
    grid: StateGrid,
    starts: np.ndarray,
    samples: int,
    widen: int,
    limit: int,
    backend: str,
    threads: int,
) -> tuple[StateGrid, int]:
    """Return a grid over what loops by a coarse one reach, and how often it was widened."""
    for widened in range(widen):
        counts = tuple(max(2, -(-count // COARSE)) for count in grid.counts)
        coarse = dataclasses.replace(grid, counts=counts)
        lookahead, _ = solved(task, coarse, samples, backend, threads)
        wider = wider_grid(task, grid, lookahead.run(starts, samples, threads), limit)
        if wider is None:
            return grid, widened
        grid = wider
    return grid, widen


def wider_grid(task: Task, grid: StateGrid, loops: Loops, limit: int) -> StateGrid | None:
    """Return the grid that loops would need which left this one; None where none did, or can."""
    out = loops.out.max(axis=1)
    if not out.any():
        return None
    return grid.widened(out).fitted(len(task.alphabet), task.rows, limit)


def _strides(task: Task, grid: StateGrid, kernel: Any, samples: int) -> tuple[int, ...]:
    """Return for how many samples sweeps hold symbols: where they move states by an interval.

    Interpolation blurs values at every sweep, the less the farther states move. Where loops end in
    a target, which must not be missed, symbols may be held for one sample, and for longer. With
    least times it is one.
    """
    if (task.held > 1).any() or (task.stop and task.remembers):
        return (1,)
    states = grid.box.sample(STRIDE_STATES, 0)
    symbols = np.arange(len(states)) % len(task.alphabet)
    ends, _ = kernel.advance(states, task.alphabet.values[symbols])
    with np.errstate(invalid="ignore"):
        moved = np.abs(ends - states) * (grid.counts / grid.box.widths)
    moved = moved.max(axis=1)[np.isfinite(moved).all(axis=1)]
    far = float(np.median(moved)) if len(moved) else 1.0
    near, long = (max(1, min(int(k / max(far, 1e-9)), k * MOST_STRIDE, samples)) for k in (1, LONG))
    return tuple(sorted({1, near, long})) if task.stop else (near,)


def solved(
    task: Task, grid: StateGrid, samples: int, backend: str, threads: int
) -> tuple[Lookahead, int]:
    """Return values of all but one sample, for lookahead, and how many sweeps they took."""

    def built(strides: tuple[int, ...]) -> Any:
        build = compiled(lambda: CompiledSweeps.build(task, grid, strides), backend, "sweeping")
        return build or NumpySweeps(task, grid, strides)

    own = built((1,))
    strides = _strides(task, grid, own, samples - 1)
    kernel = own if strides == (1,) else built(strides)
    table = Successors.empty(grid.blocks, len(task.alphabet) * len(strides), len(grid.counts))

    def fill(first: int) -> None:
        last = min(first + CHUNK, grid.blocks)
        kernel.successors(grid.states(first * LANES, last * LANES), table.part(first, last))

    with pool_of(threads) as pool:
        list(pool.map(fill, range(0, grid.blocks, CHUNK)))
        sweeps = (samples - 1) // strides[0]
        values, bends, made = _swept(kernel, table, task, grid, sweeps, pool, threads)
    return Lookahead(own, task, grid, values, bends), made


def _swept(
    kernel: Any,
    table: Successors,
    task: Task,
    grid: StateGrid,
    sweeps: int,
    pool: Executor,
    threads: int,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the values (R, size) of so many sweeps from 0, their curvature, and their number.

    Where all values change by nearly as much, further sweeps go on doing so: then they are added.
    """
    values, new = (np.zeros((task.rows, grid.size)) for _ in range(2))
    size = -(-grid.blocks // threads)
    parts = [(k, min(k + size, grid.blocks)) for k in range(0, grid.blocks, size)]
    bends = np.zeros((task.rows, grid.size, len(grid.counts)), np.float32)
    for made in range(1, sweeps + 1):
        old, out = values, new

        def sweep(part: tuple[int, int], old: Any = old, out: Any = out) -> tuple[float, float]:
            return kernel.sweep(table, old, bends, out, part)

        changes = list(pool.map(sweep, parts))
        values, new = new, values
        list(pool.map(lambda part, values=values: kernel.curvature(values, bends, *part), parts))
        if made % LOOK and made < sweeps:
            continue
        low, high = min(c[0] for c in changes), max(c[1] for c in changes)
        some = values[:, : grid.nodes]
        mean = float(np.mean(some, where=some < HUGE_COST))
        if (high - low) * (sweeps - made) <= SETTLED * mean:
            values[:, : grid.nothing] += (high + low) / 2 * (sweeps - made)
            return values, bends, made
    return values, bends, sweeps
