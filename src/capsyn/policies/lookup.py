"""Lookup of states in cells or trees, compiled; its NumPy twin is the cells' own ``labels``."""

from __future__ import annotations

import ctypes
import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.affine_leaves import ROW_ARRAYS
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.modelling.domain import Box
from capsyn.native.build import load
from capsyn.native.compiled import compiled
from capsyn.native.source import hand_written, pointer

COMPILED_FROM = 50_000
"""Batches of this size are looked up by the compiled kernel where there is a compiler."""
OUTSIDE, NOT_FINITE = -2, -3
"""What `LookupKernel` writes for states outside the domain, or not finite."""


class TreeArguments(ctypes.Structure):
    """The ``tree`` of lookup.c: where the arrays of a domain and its tree lie."""

    _fields_ = [
        *(
            (name, ctypes.c_void_p)
            for name in "lower upper periodic counts partitions refinement entries splits nodes "
            "planes starts".split()
        ),
        ("oblique", ctypes.c_int64),
        ("shift", ctypes.c_int64),
        ("affine", ctypes.c_int64),
        *(
            (name, ctypes.c_void_p)
            for name in "row_starts row_symbols row_constants row_slopes".split()
        ),
    ]

    @staticmethod
    def of(domain: Box, cells: CellTree | SplitTree) -> TreeArguments:
        """Return the arguments, which keep the arrays alive."""
        arrays = {
            "lower": np.ascontiguousarray(domain.lower),
            "upper": np.ascontiguousarray(domain.upper),
            "periodic": np.array(domain.periodic, dtype=np.uint8),
            "counts": np.array(cells.counts, dtype=np.int64),
        }
        made = TreeArguments(affine=2**63 - 1)
        if isinstance(cells, CellTree):
            arrays["partitions"] = np.array(cells.partitions, dtype=np.int64)
            arrays["refinement"] = np.array(cells.refinement, dtype=np.int64)
            arrays["entries"] = np.ascontiguousarray(cells.entries, dtype=np.int32)
            if cells.splits is not None:
                arrays["splits"] = np.ascontiguousarray(cells.splits, dtype=np.uint16)
            if cells.affine is not None:
                made.affine = cells.affine.first
                for name, values in cells.affine.arrays().items():
                    arrays[name] = np.ascontiguousarray(values, dtype=ROW_ARRAYS[name])
        else:
            arrays["nodes"], arrays["planes"] = (
                cells.rows,
                np.ascontiguousarray(cells.planes, dtype=np.int32),
            )
            made.shift, arrays["starts"] = cells.starts
            made.oblique = bool(len(cells.planes))
        for name, array in arrays.items():
            setattr(made, name, array.ctypes.data)
        made.arrays = arrays
        return made


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
        function.argtypes = [ctypes.c_int64, p, p, ctypes.c_int, p]
        return LookupKernel(function, n)

    def __call__(
        self, states: np.ndarray, domain: Box, cells: CellTree | SplitTree, nearest: bool
    ) -> np.ndarray:
        """Return leaf numbers (B,) int32, `OUTSIDE` or `NOT_FINITE`, of states (B, n)."""
        states = np.ascontiguousarray(states, dtype=np.float64)
        labels = np.empty(len(states), dtype=np.int32)
        tree = TreeArguments.of(domain, cells)
        self.function(
            len(states), pointer(states), ctypes.addressof(tree), nearest, pointer(labels)
        )
        return labels


def lookup_kernel(n: int, backend: str, count: int) -> LookupKernel | None:
    """Return the kernel that looks up `count` states of `n` numbers; None where NumPy does it."""
    if backend == "auto" and count < COMPILED_FROM:
        return None
    return compiled(lambda: _built(n), backend, "looking up")


@functools.lru_cache(maxsize=16)
def _built(n: int) -> LookupKernel:
    return LookupKernel.build(n)
