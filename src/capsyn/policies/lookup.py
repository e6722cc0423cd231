"""Lookup of states in cells or trees, compiled; its NumPy twin is the cells' own ``labels``."""

from __future__ import annotations

import ctypes
import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.affine_leaves import PRICE_ARRAYS, ROW_ARRAYS
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.modelling.domain import Box
from capsyn.native.build import load
from capsyn.native.compiled import compiled
from capsyn.native.source import hand_written, pointer
from capsyn.validation import BACKENDS, one_of

COMPILED_FROM = 50_000
"""Batches of this size are looked up by the compiled kernel where there is a compiler."""
OUTSIDE, NOT_FINITE = -2, -3
"""Leaf numbers of states outside the domain, or not finite: `LookupKernel` tells these apart, the
NumPy lookup does not and gives both `OUTSIDE`."""
GAP = OUTSIDE
"""Leaf number of states in a gap: they are outside, although in the domain."""
NO_AFFINE = 2**63 - 1
"""Number of the first affine leaf where there is none: beyond all leaf numbers."""
LOOKUP_ARRAYS = {
    "lower": np.float64,
    "upper": np.float64,
    "periodic": np.uint8,
    "counts": np.int64,
    "partitions": np.int64,
    "refinement": np.int64,
    "entries": np.int32,
    "splits": np.uint16,
    "nodes": np.int32,
    "planes": np.int32,
    "starts": np.int32,
    **ROW_ARRAYS,
    **PRICE_ARRAYS,
}
"""The arrays that lookup.c reads, in its order; those of other cells are null there."""


class TreeArguments(ctypes.Structure):
    """The ``tree`` of lookup.c: where the arrays of a domain and its tree lie."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in LOOKUP_ARRAYS if not name.startswith("row_")),
        *((name, ctypes.c_int64) for name in ("oblique", "shift", "affine")),
        *((name, ctypes.c_void_p) for name in LOOKUP_ARRAYS if name.startswith("row_")),
        ("labels", ctypes.c_int64),
    ]

    @staticmethod
    def of(domain: Box, cells: CellTree | SplitTree) -> TreeArguments:
        """Return the arguments, which keep the arrays alive."""
        values = {
            "affine": NO_AFFINE,
            "lower": domain.lower,
            "upper": domain.upper,
            "periodic": np.array(domain.periodic),
            "counts": np.array(cells.counts),
            **cells.lookup_arguments(),
        }
        arrays = {
            name: np.ascontiguousarray(values.pop(name), dtype=dtype)
            for name, dtype in LOOKUP_ARRAYS.items()
            if name in values
        }
        pointers = {name: array.ctypes.data for name, array in arrays.items()}
        tree = TreeArguments(**values, **pointers)
        tree.arrays = arrays
        return tree


@dataclass(frozen=True)
class LookupKernel:
    """Labels of states from a tree, compiled for `n` states."""

    function: Any
    n: int

    @staticmethod
    def build(n: int) -> LookupKernel:
        """Return the kernel for `n` states; `KernelBuildError` if it fails."""
        source = f"#define STATES {n}\n" + hand_written("policies/lookup.c")
        function = load(source, ("-ffp-contract=off",)).capsyn_lookup
        function.restype = None
        p = ctypes.c_void_p
        function.argtypes = [ctypes.c_int64, p, p, ctypes.c_int, p, p]
        return LookupKernel(function, n)

    def __call__(
        self,
        states: np.ndarray,
        domain: Box,
        cells: CellTree | SplitTree,
        nearest: bool,
        in_force: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return numbers of rows (B,) int32, `OUTSIDE` or `NOT_FINITE`, of states (B, n).

        Those of affine leaves are the labels that follow those in force (B,), by default the
        default's.
        """
        states = np.ascontiguousarray(states, dtype=np.float64)
        labels = np.empty(len(states), dtype=np.int32)
        tree = TreeArguments.of(domain, cells)
        now = None if in_force is None else np.ascontiguousarray(in_force, dtype=np.int32)
        self.function(
            len(states),
            pointer(states),
            ctypes.addressof(tree),
            nearest,
            None if now is None else pointer(now),
            pointer(labels),
        )
        return labels


def lookup_kernel(n: int, backend: str, count: int, compiles: bool = True) -> LookupKernel | None:
    """Return the kernel that looks up `count` states of `n` numbers; None where NumPy does it.

    That is so, whatever the backend, where the kernel does not know the cells (`compiles`).
    """
    one_of("backend", backend, BACKENDS)
    if not compiles or (backend == "auto" and count < COMPILED_FROM):
        return None
    return compiled(lambda: _built(n), backend, "looking up")


def row_numbers(
    states: np.ndarray,
    domain: Box,
    cells: CellTree | SplitTree,
    nearest: bool,
    backend: str = "auto",
    in_force: np.ndarray | None = None,
) -> np.ndarray:
    """Return the rows (B,) int32 of states (B, n), of affine leaves the next label; or negative.

    With `nearest` a finite state outside the domain has that of the nearest cell; `in_force` (B,)
    are the labels in force, by default the default's.
    """
    kernel = lookup_kernel(domain.n, backend, len(states), cells.compiled)
    if kernel is not None:
        return kernel(states, domain, cells, nearest, in_force)
    covered = np.isfinite(states).all(axis=1) if nearest else domain.contains(states)
    numbers = np.full(len(states), OUTSIDE, dtype=np.int32)
    steps = domain.locate(states[covered], cells.counts)
    numbers[covered] = cells.labels(steps, None if in_force is None else in_force[covered])
    return numbers


@functools.lru_cache(maxsize=16)
def _built(n: int) -> LookupKernel:
    return LookupKernel.build(n)


def outside_text(domain: Box, state: np.ndarray, index: int | None, what: str = "state") -> str:
    """Return what is wrong with a state (n,): not finite, in a gap, or outside the domain.

    `index` is its place among others, if there are any; `what` it is called.
    """
    text = "(" + ", ".join(f"{v:g}" for v in state) + ")"
    which = f"{what} {index}" if index is not None else f"the {what}"
    if not np.isfinite(state).all():
        return f"{which} must be finite; got {text}"
    if domain.contains(state[None])[0]:
        return (
            f"{which} must be where the policy has a symbol; {text} is in a gap "
            "(a symbol as `outside` would answer)"
        )
    bounds = " x ".join(f"[{low:g}, {high:g}]" for low, high in zip(domain.lower, domain.upper))
    return (
        f"{which} must lie in the domain {bounds}; got {text} "
        '(outside="nearest" or a symbol would answer)'
    )
