"""Pieces followed from sample to sample, compiled for a loop."""

from __future__ import annotations

import ctypes
import math
import time
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.native.build import load
from capsyn.native.source import declarations, hand_written, pointer
from capsyn.programs.interval_text import interval_c
from capsyn.reach.loop import SampledLoop

STATUS = (
    "proved",
    "leaves the domain",
    "enters avoid",
    "has no enclosure",
    "falls into too many pieces",
    "takes too long",
)
"""What comes of a start, by number."""
PROVED = 0
MOST_VERTICES = 12
"""Of a polygon."""
CHUNK = 4
"""Parts of a batch for each thread."""

_ARRAYS = (
    "second row next normal below above controls parameters lower upper widths periodic noise "
    "stop holds kinds grid_lower grid_upper cell counts bound marks pieces flows"
).split()
_NUMBERS = "layers cells horizon record nearest piece_room flow_room".split()


class _Task(ctypes.Structure):
    """The ``task`` of follow.c."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in _ARRAYS),
        *((name, ctypes.c_int64) for name in _NUMBERS),
        ("sample", ctypes.c_double),
        ("delay", ctypes.c_double),
        ("piece_count", ctypes.c_int64),
        ("flow_count", ctypes.c_int64),
    ]


@dataclass(frozen=True, eq=False)
class Cells:
    """A grid of K cells over a box of states, in C order."""

    lower: np.ndarray  # (n,) [state units]
    upper: np.ndarray  # (n,)
    counts: np.ndarray  # (n,)

    @property
    def widths(self) -> np.ndarray:
        """Of one cell [state units]."""
        return (self.upper - self.lower) / self.counts

    @property
    def total(self) -> int:
        """How many there are."""
        return int(np.prod(self.counts))

    def boxes(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends (B, n) and (B, n) of cells (B,) by number; the last is the box's own."""
        places = np.stack(np.unravel_index(cells, tuple(self.counts)), axis=1)
        lower = self.lower + self.widths * places
        upper = self.lower + self.widths * (places + 1)
        return lower, np.where(places + 1 == self.counts, self.upper, upper)


@dataclass(frozen=True, eq=False)
class Followed:
    """What came of B starts."""

    status: np.ndarray  # (B,) ints into `STATUS`
    bound: np.ndarray  # (B,): time by which all have arrived [time unit]
    lower: np.ndarray  # (B, n): least of each state on the way
    upper: np.ndarray  # (B, n)
    switches: np.ndarray  # (B,): most on the way
    work: np.ndarray  # (B,): pieces that flowed


@dataclass(frozen=True, eq=False)
class Told:
    """The pieces of proofs and the parts of them that flowed, as records, for a checker."""

    pieces: np.ndarray
    flows: np.ndarray
    ends: np.ndarray  # (B, 2): how many of each there are after each start


@dataclass(frozen=True, eq=False)
class Follower:
    """Follows starts of a loop over the cells of a grid."""

    loop: SampledLoop
    cells: Cells
    function: Any
    threads: int
    arrays: dict[str, np.ndarray]
    deadline: float = math.inf

    @staticmethod
    def build(
        loop: SampledLoop, cells: Cells, threads: int, deadline: float = math.inf
    ) -> Follower:
        """Return what follows a loop; `KernelBuildError` where there is no compiler.

        What is not done by the `deadline`, as `time.monotonic` counts [s], is not proved.
        """
        function = load(source(loop), ("-ffp-contract=off",)).capsyn_follow
        p = ctypes.c_void_p
        function.restype, function.argtypes = None, [ctypes.c_int64, *[p] * 11]
        space, tree = loop.space, loop.tree
        doubles = {
            "normal": tree.normal, "below": tree.below, "above": tree.above,
            "controls": loop.controls, "parameters": loop.parameters, "lower": space.lower,
            "upper": space.upper, "widths": space.widths, "noise": loop.noise,
            "grid_lower": cells.lower, "grid_upper": cells.upper, "cell": cells.widths,
        }  # fmt: skip
        arrays = {name: np.ascontiguousarray(a, dtype=float) for name, a in doubles.items()}
        for name, values in (("second", tree.second), ("row", tree.row), ("next", loop.next)):
            arrays[name] = np.ascontiguousarray(values, dtype=np.int32)
        for name, values in (
            ("holds", loop.holds), ("kinds", loop.kinds), ("counts", cells.counts)
        ):  # fmt: skip
            arrays[name] = np.ascontiguousarray(values, dtype=np.int64)
        arrays["periodic"] = np.array(space.periodic, dtype=np.uint8)
        shape = (loop.layers, cells.total)
        arrays["bound"] = np.full(shape, np.inf)
        arrays["marks"] = np.zeros(shape, dtype=np.uint8)
        arrays["stop"] = np.zeros(1, dtype=np.int32)
        return Follower(loop, cells, function, threads, arrays, deadline)

    @property
    def bound(self) -> np.ndarray:
        """Time to arrive from each cell in each layer [time unit]; infinite where not proved."""
        return self.arrays["bound"]

    @property
    def marks(self) -> np.ndarray:
        """Cells of each layer in which loops ended that were followed for a time."""
        return self.arrays["marks"]

    def follow(
        self, lower: np.ndarray, upper: np.ndarray, held: np.ndarray, work: Any, horizon: int = 0,
        record: int = 0,
    ) -> Followed:  # fmt: skip
        """Return what comes of boxes (B, n) with labels in force (B,), by at most so many flows.

        They are followed until they arrive, or for a `horizon` [samples]; what happens on the way
        is told from sample `record` on.
        """
        most = np.broadcast_to(np.asarray(work, dtype=np.int64), held.shape)
        size = max(1, -(-len(held) // (CHUNK * self.threads)))
        parts = [slice(k, k + size) for k in range(0, len(held), size)]

        def run(part: slice) -> Followed:
            return self._run(lower[part], upper[part], held[part], most[part], horizon, record)[0]

        with ThreadPoolExecutor(self.threads) as pool:
            running = [pool.submit(run, part) for part in parts]
            try:
                left = self.deadline - time.monotonic()
                wait(running, timeout=None if left == math.inf else max(left, 0.0))
            finally:  # late, or interrupted
                self.arrays["stop"][0] = any(not one.done() for one in running)
            found = [one.result() for one in running]
        columns = zip(*(vars(one).values() for one in found), strict=True)
        return Followed(*(np.concatenate(column) for column in columns))

    def tell(
        self, lower: np.ndarray, upper: np.ndarray, held: np.ndarray, work: Any, room: int
    ) -> tuple[Followed, Told]:
        """Return what comes of boxes, and the pieces and flows that say why, `room` of each."""
        pieces = np.zeros(room, self._record("held samples ended id merged"))
        flows = np.zeros(room, self._record("label samples start end waits"))
        most = np.broadcast_to(np.asarray(work, dtype=np.int64), held.shape)
        return self._run(lower, upper, held, most, 0, 0, pieces, flows)

    def _record(self, names: str) -> np.dtype:
        n = self.loop.space.n
        size = 2 * MOST_VERTICES if n == 2 else 2 * n
        fields = [("v", float, size), ("error", float, n), ("count", np.int32)]
        return np.dtype([*fields, *((name, np.int32) for name in names.split())], align=True)

    def _run(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        held: np.ndarray,
        work: np.ndarray,
        horizon: int,
        record: int,
        pieces: np.ndarray | None = None,
        flows: np.ndarray | None = None,
    ) -> tuple[Followed, Told]:
        count, n = lower.shape
        none = np.empty(0)
        pieces, flows = (none if a is None else a for a in (pieces, flows))
        arrays = {**self.arrays, "pieces": pieces, "flows": flows}
        task = _Task(
            **{name: array.ctypes.data for name, array in arrays.items()},
            layers=self.loop.layers, cells=self.cells.total, horizon=horizon, record=record,
            nearest=self.loop.nearest, piece_room=len(pieces), flow_room=len(flows),
            sample=self.loop.period, delay=self.loop.delay,
        )  # fmt: skip
        lower, upper = (np.ascontiguousarray(a, dtype=float) for a in (lower, upper))
        held = np.ascontiguousarray(held, dtype=np.int32)
        work = np.ascontiguousarray(work)
        status, bound = np.empty(count, dtype=np.int32), np.empty(count)
        extents = np.empty((count, 2, n))
        switches, spent = np.empty((2, count), dtype=np.int64)
        ends = np.empty((count, 2), dtype=np.int64)
        results = (status, bound, extents, switches, spent, ends)
        self.function(
            count, ctypes.addressof(task), *map(pointer, (lower, upper, held, work, *results))
        )
        followed = Followed(status, bound, extents[:, 0], extents[:, 1], switches, spent)
        return followed, Told(pieces, flows, ends)


SMALL = """
static inline double lesser(double a, double b) { return a < b ? a : b; }
static inline double greater(double a, double b) { return a > b ? a : b; }
"""


def source(loop: SampledLoop) -> str:
    """Return the C source that follows a loop."""
    programs = {
        "rates": loop.rates, "slopes": loop.slopes, "breaks": loop.breaks,
        "target": loop.target, "avoid": loop.avoid,
    }  # fmt: skip
    n, m = loop.space.n, loop.controls.shape[1]
    defined = {
        "STATES": n,
        "MOVING": loop.moving,
        "CONTROLS": m,
        "PARAMETERS": loop.parameters.shape[1],
        "INPUTS": n + m + loop.parameters.shape[1],
        "BREAKS": len(loop.breaks.results),
        "LABELS": loop.labels,
        "GAPS": int((loop.next < 0).any()),
        "DRIFTS": int((loop.next != loop.next[:, :1]).any() or (loop.holds != loop.holds[0]).any()),
        "SLACK": "0x1p-43",
        "MOST_VERTICES": MOST_VERTICES,
    }
    return "\n".join(
        [
            declarations(programs.values(), "double", 1),
            "#include <string.h>",
            *(f"#define {name} {value}" for name, value in defined.items()),
            hand_written("programs/intervals.c"),
            SMALL,
            *(interval_c(program, name) for name, program in programs.items()),
            *(
                hand_written(f"reach/{name}.c")
                for name in ("polygon" if n == 2 else "box", "flow", "follow")
            ),
        ]
    )
