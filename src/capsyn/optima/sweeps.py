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
    """What each of N symbols, or moves, leads to, in K blocks of states on a grid."""

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
        ("samples", ctypes.c_void_p),
    ]


class _Table(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in "at weights costs corners inner".split()),
        *((name, ctypes.c_int64) for name in ("nodes", "symbols", "size")),
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
    strides: tuple[int, ...] = (1,)  # samples that `successors` holds symbols

    @property
    def moves(self) -> list[tuple[int, int]]:
        """Symbols and samples that they are held: all of them, for one stride after the other."""
        return [(s, k) for k in self.strides for s in range(len(self.task.alphabet))]

    def successors(self, states: np.ndarray, out: Successors) -> None:
        """Fill blocks with what the symbols lead to from states (B, n); the last one is repeated.

        They are those of `moves`. At each sample a loop may end in the target. States beyond the
        grid count as at its face, those in the target cost nothing from there.
        """
        blocks, n = len(out.at), states.shape[1]
        filled = np.minimum(np.arange(blocks * LANES), len(states) - 1)
        x = np.ascontiguousarray(states[filled].T)
        begun = self._inside(x)
        for column, (s, samples) in enumerate(self.moves):
            control = np.repeat(self.task.alphabet.values[s][:, None], x.shape[1], axis=1)
            ends, cost, ended = x, np.zeros(x.shape[1]), begun
            for _ in range(samples):
                ends, more = self._moved(ends, control)
                more = more + self.task.efforts[s] * self.task.period
                cost = np.where(ended, cost, cost + more)
                ended = ended | self._inside(ends)
            at, weights = self._located(ends)
            finite = ended | np.isfinite(ends).all(axis=0)
            cost = np.where(finite & np.isfinite(cost) & (cost < HUGE_COST), cost, HUGE_COST)
            out.at[:, column] = np.where(ended, self.grid.nothing, at).reshape(blocks, LANES)
            out.weights[:, column] = weights.reshape(n, blocks, LANES).swapaxes(0, 1)
            out.costs[:, column] = cost.reshape(blocks, LANES)

    def advance(self, states: np.ndarray, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states (B, n) and costs (B,) after a sample under controls (B, m)."""
        ends, cost = self._moved(states.T, controls.T)
        return ends.T, cost

    def curvature(self, values: np.ndarray, out: np.ndarray, first: int, last: int) -> None:
        """Write half the curvature (R, size, n) of values (R, size) in some blocks of intervals.

        It is that along each axis, the smaller one of both ends, so that kinks stay what they are.
        """
        here = slice(first * LANES, min(last * LANES, self.grid.nodes))
        shape = (len(values), *self.grid.shape)
        nodes = values[:, : self.grid.nodes].reshape(shape)
        for i in range(len(self.grid.counts)):
            second = np.zeros(shape)
            along = np.moveaxis(second, i + 1, -1)
            along[..., 1:-1] = np.diff(np.moveaxis(nodes, i + 1, -1), 2, axis=-1)
            other = np.roll(second, -1, axis=i + 1)
            least = np.where(np.abs(second) < np.abs(other), second, other)
            good = (second * other > 0) & (np.abs(least) < 1e-6 * HUGE_COST)
            flat = np.where(good, 0.5 * least, 0.0).reshape(len(values), -1) * self.grid.inner[i]
            out[:, here, i] = flat[:, here]

    def follow(
        self, table: Successors, values: np.ndarray, bends: np.ndarray, rows: np.ndarray
    ) -> np.ndarray:
        """Return costs (K, N, LANES) of each symbol over a sample, and then of a row of values.

        `rows` (N,) are those rows of values (R, size), `bends` (R, size, n) their curvature.
        """
        corners, n = self.grid.corners, len(self.grid.counts)
        out = np.empty(table.costs.shape)
        for s, row in enumerate(rows):
            near = values[row][table.at[:, s, :, None] + corners]
            for i in range(n - 1, -1, -1):
                low, high = near[..., 0::2], near[..., 1::2]
                near = low + table.weights[:, s, i, :, None].astype(float) * (high - low)
            w = table.weights[:, s].swapaxes(1, 2)
            off = (w * (1 - w) * bends[row][table.at[:, s]]).sum(axis=-1)
            out[:, s] = np.minimum(table.costs[:, s] + (near[..., 0] - off), HUGE_COST)
        return out

    def sweep(
        self,
        table: Successors,
        values: np.ndarray,
        bends: np.ndarray,
        out: np.ndarray,
        part: tuple[int, int],
    ) -> tuple[float, float]:
        """Write new values of blocks first .. last - 1; return the least and largest change.

        Values and `out` are (R, size); `bends` is their curvature, `table` that of the whole grid.
        """
        first, last = part
        some, here = table.part(first, last), slice(first * LANES, last * LANES)
        held, prices = self.task.held, self.task.prices
        if prices is None:
            none = np.zeros(table.at.shape[1], dtype=int)
            free = self.follow(some, values, bends, none).min(axis=1).reshape(1, -1)
            tops = np.array([0])
        else:
            tops = self.task.tops
            each = [self.follow(some, values, bends, tops)]
            for r in range(1, held.max()):
                rows = tops + np.minimum(r, held - 1)
                each.append(self.follow(some, values, bends, rows))
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
    strides: tuple[int, ...]

    @staticmethod
    def build(task: Task, grid: StateGrid, strides: tuple[int, ...] = (1,)) -> CompiledSweeps:
        """Return the kernel of a task on a grid; `KernelBuildError` if it fails."""
        plant = task.plant
        programs = {
            "dynamics": plant.in_loops[0],
            "running_cost": plant.in_loops[1],
            "inside": task.inside,
        }
        source = "\n".join(
            [
                declarations(programs.values(), "double", LANES),
                f"#define AXES {plant.n}\n#define INPUTS {plant.m}",
                f"#define DISCRETE {int(plant.sample_time is not None)}",
                *(program.to_c(name) for name, program in programs.items()),
                hand_written("optima/dynamic_programming.c"),
            ]
        )
        library = load(source, ("-ffp-contract=off",))
        p, whole = ctypes.c_void_p, ctypes.c_int64
        for name, arguments in (
            ("capsyn_successors", [whole, p, p, p, p, p]),
            ("capsyn_advance", [whole, p, p, p, p, p]),
            ("capsyn_curvature", [whole, whole, p, p, p]),
            ("capsyn_follow", [whole, p, p, p, p, p]),
            ("capsyn_sweep", [whole, whole, p, p, p, p, p]),
            ("capsyn_loops", [whole, p, p, p, p, p, p, p, p, p]),
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
            "controls": np.tile(task.alphabet.values, (len(strides), 1)).astype(float),
            "efforts": np.tile(task.efforts, len(strides)).astype(float),
            "samples": np.repeat(np.array(strides, np.int64), len(task.alphabet)),
            "corners": grid.corners,
            "inner": grid.inner,
            "held": np.ascontiguousarray(task.held, np.int64),
            "least": np.where(box.periodic, -np.inf, box.lower),
            "most": np.where(box.periodic, np.inf, box.upper),
            "switches": np.ascontiguousarray(task.switches, float),
            "tops": np.ascontiguousarray(task.tops, np.int64),
            "entries": np.ascontiguousarray(task.entries, np.int64),
        }
        if task.prices is not None:
            kept["prices"] = np.ascontiguousarray(task.prices, float)
        return CompiledSweeps(library, task, grid, kept, strides)

    @functools.cached_property
    def _lattice(self) -> _Lattice:
        task = self.task
        names = "lower scale counts periodic controls efforts samples".split()
        places: dict[str, Any] = {name: self.kept[name].ctypes.data for name in names}
        return _Lattice(
            nothing=self.grid.nothing,
            step=task.period / task.substeps,
            steps=task.substeps,
            symbols=len(self.kept["samples"]),
            **places,
        )

    def _table(self, table: Successors) -> _Table:
        places: dict[str, Any] = {
            name: self.kept[name].ctypes.data
            for name in ("corners", "inner", "held", "prices")
            if name in self.kept
        }
        places |= {name: array.ctypes.data for name, array in vars(table).items()}
        sizes = {"symbols": len(self.kept["samples"]), "size": self.grid.size}
        return _Table(nodes=self.grid.nodes, **sizes, **places)

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

    def curvature(self, values: np.ndarray, out: np.ndarray, first: int, last: int) -> None:
        """Write half the curvature of values; see `NumpySweeps`."""
        told = self._table(Successors.empty(0, 0, len(self.grid.counts)))
        last = min(last * LANES, self.grid.nodes)
        for row, bends in zip(values, out, strict=True):
            self.library.capsyn_curvature(
                first * LANES, last, ctypes.addressof(told), row.ctypes.data, bends.ctypes.data
            )

    def follow(
        self, table: Successors, values: np.ndarray, bends: np.ndarray, rows: np.ndarray
    ) -> np.ndarray:
        """Return what going on from each symbol costs; see `NumpySweeps`."""
        out, told = np.empty(table.costs.shape), self._table(table)
        rows = np.ascontiguousarray(rows, np.int64)
        self.library.capsyn_follow(
            len(out), ctypes.addressof(told), values.ctypes.data, bends.ctypes.data,
            rows.ctypes.data, out.ctypes.data,
        )  # fmt: skip
        return out

    def sweep(
        self,
        table: Successors,
        values: np.ndarray,
        bends: np.ndarray,
        out: np.ndarray,
        part: tuple[int, int],
    ) -> tuple[float, float]:
        """Write new values of some blocks; see `NumpySweeps`."""
        change, told = np.array([np.inf, -np.inf]), self._table(table)
        self.library.capsyn_sweep(
            *part, ctypes.addressof(told), values.ctypes.data, bends.ctypes.data,
            out.ctypes.data, change.ctypes.data,
        )  # fmt: skip
        return float(change[0]), float(change[1])

    def loops(
        self,
        starts: np.ndarray,
        samples: int,
        values: np.ndarray,
        bends: np.ndarray,
        tie: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return costs (B,), switches (B,) and ways out (2, B, n) of loops from starts (B, n)."""
        starts = np.ascontiguousarray(starts, float)
        costs, switches = np.zeros(len(starts)), np.zeros(len(starts), np.int64)
        out = np.zeros((2, *starts.shape))
        names = {"lower": "least", "upper": "most"} | {
            k: k for k in ("switches", "tops", "entries")
        }
        places = {name: self.kept[own].ctypes.data for name, own in names.items()}
        count = len(self.task.alphabet)
        journey = _Journey(
            samples=samples, symbols=count, remembers=self.task.remembers, tie=tie, **places
        )
        told = self._table(Successors.empty(0, 0, starts.shape[1]))
        done = self.library.capsyn_loops(
            len(starts), starts.ctypes.data, ctypes.addressof(self._lattice),
            ctypes.addressof(told), ctypes.addressof(journey), values.ctypes.data,
            bends.ctypes.data, costs.ctypes.data, switches.ctypes.data, out.ctypes.data,
        )  # fmt: skip
        if not done:
            raise MemoryError
        return costs, switches, out
