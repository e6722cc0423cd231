"""Sweeps of dynamic programming over a grid, compiled, and by NumPy."""

from __future__ import annotations

import ctypes
import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.native.build import load
from capsyn.native.source import LANES, declarations, hand_written
from capsyn.optima.grid import StateGrid
from capsyn.optima.task import Task

HUGE_COST = 1e30
"""Cost that counts as infinite."""
CHUNK = 256
"""Blocks of nodes whose successors NumPy finds at once."""


@dataclass(frozen=True, eq=False)
class Successors:
    """What each of N symbols leads to over a sample, in K blocks of states on a grid."""

    at: np.ndarray  # (K, N, LANES) int32: entry of values at the lower corner of the interval
    weights: np.ndarray  # (K, N, n, LANES) float32: how far along the interval, 0 to 1
    costs: np.ndarray  # (K, N, LANES) float32 [cost]

    @staticmethod
    def empty(blocks: int, symbols: int, n: int) -> Successors:
        """Return room for so many blocks."""
        return Successors(
            np.empty((blocks, symbols, LANES), np.int32),
            np.empty((blocks, symbols, n, LANES), np.float32),
            np.empty((blocks, symbols, LANES), np.float32),
        )

    def part(self, first: int, last: int) -> Successors:
        """Return some blocks."""
        return Successors(*(array[first:last] for array in vars(self).values()))


class _Lattice(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in "lower scale counts periodic".split()),
        ("nothing", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("controls", "efforts")),
        ("step", ctypes.c_double),
        *((name, ctypes.c_int64) for name in ("steps", "symbols")),
    ]


class _Table(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in "at weights costs corners".split()),
        *((name, ctypes.c_int64) for name in ("symbols", "size")),
        *((name, ctypes.c_void_p) for name in ("held", "prices")),
    ]


class _Journey(ctypes.Structure):
    _fields_ = [
        ("samples", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in "lower upper switches tops entries".split()),
        ("remembers", ctypes.c_int64),
        ("tie", ctypes.c_double),
    ]


@dataclass(frozen=True, eq=False)
class NumpySweeps:
    """The same computation as the compiled kernel, by NumPy."""

    task: Task
    grid: StateGrid

    def successors(self, states: np.ndarray, out: Successors) -> None:
        """Fill blocks with what the symbols lead to from states (B, n); the last one is repeated.

        States beyond the grid count as at its face, those in the target cost nothing from there.
        """
        blocks, n = len(out.at), states.shape[1]
        filled = np.minimum(np.arange(blocks * LANES), len(states) - 1)
        x = np.ascontiguousarray(states[filled].T)
        begun = self._inside(x)
        for s in range(len(self.task.alphabet)):
            control = np.repeat(self.task.alphabet.values[s][:, None], x.shape[1], axis=1)
            ends, cost = self._moved(x, control)
            arrived = self._inside(ends)
            at, weights = self._located(ends)
            cost = cost + self.task.efforts[s] * self.task.period
            finite = np.isfinite(cost) & np.isfinite(ends).all(axis=0) & (cost < HUGE_COST)
            cost = np.where(begun, 0.0, np.where(finite, cost, HUGE_COST))
            out.at[:, s] = np.where(begun | arrived, self.grid.nothing, at).reshape(blocks, LANES)
            out.weights[:, s] = weights.reshape(n, blocks, LANES).swapaxes(0, 1)
            out.costs[:, s] = cost.reshape(blocks, LANES)

    def advance(self, states: np.ndarray, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states (B, n) and costs (B,) after a sample under controls (B, m)."""
        ends, cost = self._moved(states.T, controls.T)
        return ends.T, cost

    def follow(self, table: Successors, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return costs (K, N, LANES) of each symbol over a sample, and then of a row of values.

        `rows` (N,) are those rows of values (R, size).
        """
        corners, n = self.grid.corners, len(self.grid.counts)
        out = np.empty(table.costs.shape)
        for s, row in enumerate(rows):
            near = values[row][table.at[:, s, :, None] + corners]
            for i in range(n - 1, -1, -1):
                low, high = near[..., 0::2], near[..., 1::2]
                near = low + table.weights[:, s, i, :, None].astype(float) * (high - low)
            out[:, s] = np.minimum(table.costs[:, s] + near[..., 0], HUGE_COST)
        return out

    def sweep(
        self, table: Successors, values: np.ndarray, out: np.ndarray, first: int, last: int
    ) -> tuple[float, float]:
        """Write new values of blocks first .. last - 1; return the least and largest change.

        Values and `out` are (R, size); `table` is that of the whole grid.
        """
        some, here = table.part(first, last), slice(first * LANES, last * LANES)
        held, prices = self.task.held, self.task.prices
        if prices is None:
            none = np.zeros(len(held), dtype=int)
            free = self.follow(some, values, none).min(axis=1).reshape(1, -1)
            tops = np.array([0])
        else:
            tops = self.task.tops
            each = [self.follow(some, values, tops)]
            for r in range(1, held.max()):
                each.append(self.follow(some, values, tops + np.minimum(r, held - 1)))
            flat = [costs.swapaxes(0, 1).reshape(len(held), -1) for costs in each]
            for s in range(len(held)):
                for r in range(1, held[s]):
                    out[tops[s] + r, here] = flat[r - 1][s]
            entered = np.stack([flat[held[s] - 1][s] for s in range(len(held))])
            others = prices + np.where(np.eye(len(held), dtype=bool), np.inf, 0.0)
            left = np.stack([(row[:, None] + entered).min(axis=0) for row in others])
            free = np.minimum(flat[0], left)
        change = free - values[tops, here]
        out[tops, here] = free
        return float(change.min()), float(change.max())

    def _inside(self, x: np.ndarray) -> np.ndarray:
        condition = self.task.inside.evaluate(x)[0][0]
        return (condition != 0) & np.isfinite(condition)

    def _moved(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states (n, B) and costs (B,) after a sample from states (n, B)."""
        task, total = self.task, np.zeros(x.shape[1])
        plant, none = task.plant, np.zeros((0, x.shape[1]))
        push, time = np.zeros_like(x), np.full(x.shape[1], task.period)
        return plant.advance(x, total, u, none, push, time, task.substeps)

    def _located(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return entries (B,) and weights (n, B) of states (n, B)."""
        place, weights = np.zeros(x.shape[1]), np.empty(x.shape, np.float32)
        box = self.grid.box
        for i, count in enumerate(self.grid.counts):
            with np.errstate(invalid="ignore"):
                c = (x[i] - box.lower[i]) * (count / box.widths[i])
                c = c - count * np.floor(c / count) if box.periodic[i] else c
                c = np.minimum(np.where(c > 0, c, 0.0), count)
            k = np.minimum(np.floor(c), count - 1)
            weights[i] = c - k
            place = place * (count + 1) + k
        return place.astype(np.int32), weights


@dataclass(frozen=True, eq=False)
class CompiledSweeps:
    """Sweeps of `NumpySweeps`, compiled. Safe to call from threads."""

    library: Any
    task: Task
    grid: StateGrid
    kept: dict[str, np.ndarray]  # what the structures point to

    @staticmethod
    def build(task: Task, grid: StateGrid) -> CompiledSweeps:
        """Return the kernel of a task on a grid; `KernelBuildError` if it fails."""
        plant = task.plant
        programs = {
            "dynamics": plant.dynamics,
            "running_cost": plant.running_cost,
            "inside": task.inside,
        }
        source = "\n".join(
            [
                declarations(programs.values(), "double", LANES),
                f"#define AXES {plant.n}\n#define INPUTS {plant.m}",
                *(program.to_c(name) for name, program in programs.items()),
                hand_written("optima/dynamic_programming.c"),
            ]
        )
        library = load(source, ("-ffp-contract=off",))
        p, whole = ctypes.c_void_p, ctypes.c_int64
        for name, arguments in (
            ("capsyn_successors", [whole, p, p, p, p, p]),
            ("capsyn_advance", [whole, p, p, p, p, p]),
            ("capsyn_follow", [whole, p, p, p, p]),
            ("capsyn_sweep", [whole, whole, p, p, p, p]),
            ("capsyn_loops", [whole, p, p, p, p, p, p, p, p]),
        ):
            function = getattr(library, name)
            function.restype, function.argtypes = None, arguments
        library.capsyn_loops.restype = ctypes.c_int
        box = grid.box
        kept = {
            "lower": box.lower.astype(float),
            "scale": np.array(grid.counts) / box.widths,
            "counts": np.array(grid.counts, np.int64),
            "periodic": np.array(box.periodic, np.int64),
            "controls": np.ascontiguousarray(task.alphabet.values, float),
            "efforts": np.ascontiguousarray(task.efforts, float),
            "corners": grid.corners,
            "held": np.ascontiguousarray(task.held, np.int64),
            "least": np.where(box.periodic, -np.inf, box.lower),
            "most": np.where(box.periodic, np.inf, box.upper),
            "switches": np.ascontiguousarray(task.switches, float),
            "tops": np.ascontiguousarray(task.tops, np.int64),
            "entries": np.ascontiguousarray(task.entries, np.int64),
        }
        if task.prices is not None:
            kept["prices"] = np.ascontiguousarray(task.prices, float)
        return CompiledSweeps(library, task, grid, kept)

    @functools.cached_property
    def _lattice(self) -> _Lattice:
        task = self.task
        names = "lower scale counts periodic controls efforts".split()
        places: dict[str, Any] = {name: self.kept[name].ctypes.data for name in names}
        return _Lattice(
            nothing=self.grid.nothing,
            step=task.period / task.substeps,
            steps=task.substeps,
            symbols=len(task.alphabet),
            **places,
        )

    def _table(self, table: Successors) -> _Table:
        places: dict[str, Any] = {
            name: self.kept[name].ctypes.data
            for name in ("corners", "held", "prices")
            if name in self.kept
        }
        places |= {name: array.ctypes.data for name, array in vars(table).items()}
        return _Table(symbols=len(self.task.alphabet), size=self.grid.size, **places)

    def successors(self, states: np.ndarray, out: Successors) -> None:
        """Fill blocks with what the symbols lead to; see `NumpySweeps`."""
        states = np.ascontiguousarray(states, float)
        places = [array.ctypes.data for array in vars(out).values()]
        self.library.capsyn_successors(
            len(states), states.ctypes.data, ctypes.addressof(self._lattice), *places
        )

    def advance(self, states: np.ndarray, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states and costs after a sample; see `NumpySweeps`."""
        states = np.ascontiguousarray(states, float)
        controls = np.ascontiguousarray(controls, float)
        ends, costs = np.empty_like(states), np.empty(len(states))
        self.library.capsyn_advance(
            len(states), states.ctypes.data, controls.ctypes.data, ctypes.addressof(self._lattice),
            ends.ctypes.data, costs.ctypes.data,
        )  # fmt: skip
        return ends, costs

    def follow(self, table: Successors, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return what going on from each symbol costs; see `NumpySweeps`."""
        out, told = np.empty(table.costs.shape), self._table(table)
        rows = np.ascontiguousarray(rows, np.int64)
        self.library.capsyn_follow(
            len(out), ctypes.addressof(told), values.ctypes.data, rows.ctypes.data, out.ctypes.data
        )
        return out

    def sweep(
        self, table: Successors, values: np.ndarray, out: np.ndarray, first: int, last: int
    ) -> tuple[float, float]:
        """Write new values of some blocks; see `NumpySweeps`."""
        change, told = np.array([np.inf, -np.inf]), self._table(table)
        self.library.capsyn_sweep(
            first, last, ctypes.addressof(told), values.ctypes.data, out.ctypes.data,
            change.ctypes.data,
        )  # fmt: skip
        return float(change[0]), float(change[1])

    def loops(
        self, starts: np.ndarray, samples: int, values: np.ndarray, tie: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return costs (B,), switches (B,) and ways out (2, B, n) of loops from starts (B, n)."""
        starts = np.ascontiguousarray(starts, float)
        costs, switches = np.zeros(len(starts)), np.zeros(len(starts), np.int64)
        out = np.zeros((2, *starts.shape))
        names = {"lower": "least", "upper": "most"} | {
            k: k for k in ("switches", "tops", "entries")
        }
        places = {name: self.kept[own].ctypes.data for name, own in names.items()}
        journey = _Journey(samples=samples, remembers=self.task.remembers, tie=tie, **places)
        told = self._table(Successors.empty(0, len(self.task.alphabet), starts.shape[1]))
        done = self.library.capsyn_loops(
            len(starts), starts.ctypes.data, ctypes.addressof(self._lattice),
            ctypes.addressof(told), ctypes.addressof(journey), values.ctypes.data,
            costs.ctypes.data, switches.ctypes.data, out.ctypes.data,
        )  # fmt: skip
        if not done:
            raise MemoryError
        return costs, switches, out
