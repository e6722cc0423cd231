"""A decision tree over lattice integers, as flat integer arrays."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np

from capsyn.cells.boxes import Boxes
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.modelling.grid import MAX_COUNT, grid_places
from capsyn.validation import keep_read_only

Node = TypeVar("Node")

LEAF = -1
"""What `SplitTree.split` is for a leaf."""
TREE_ARRAYS = {"split": np.int32, "threshold": np.int32, "second": np.int32, "planes": np.int32}
"""The arrays as files call them."""
MAX_DEPTH = 1000
"""Most comparisons from the root to a leaf."""
MAX_PARTS = 10_000_000
"""Most parts of boxes at a time."""
START_NODES = 1 << 13
STARTS_PER_NODE = 4
"""Most entries of `SplitTree.starts`, of a small tree and by the nodes of others."""


@dataclass(frozen=True, eq=False)
class SplitTree:
    """A decision tree over the integer lattice of a `Box`, in depth-first order.

    Node `i` goes to its second child, node ``second[i]``, exactly when ``z[split[i]] >=
    threshold[i]``, or, for an oblique split, ``planes[split[i] - n] @ z >= threshold[i]``; else to
    its first, node ``i + 1``. The threshold of a leaf is its label: a symbol, or N for the default
    control; its second child is the leaf itself. The sums ``planes @ z`` fit 32 bits.
    """

    counts: tuple[int, ...]  # lattice steps along each axis
    split: np.ndarray  # (K,) int32: axis ``0 .. n-1``, ``n + row`` of `planes`, or `LEAF`
    threshold: np.ndarray  # (K,) int32
    second: np.ndarray  # (K,) int32
    planes: np.ndarray  # (R, n) int32: coefficients, in the order of their nodes

    kind: ClassVar[str] = "tree"
    planes_are: ClassVar[str] = "oblique splits"
    nested: ClassVar[bool] = False
    compiled: ClassVar[bool] = True
    priced: ClassVar[bool] = False

    def __post_init__(self) -> None:
        keep_read_only(self, *TREE_ARRAYS)

    @property
    def n(self) -> int:
        """Number of axes."""
        return len(self.counts)

    @property
    def node_count(self) -> int:
        """Inner nodes and leaves."""
        return len(self.split)

    @property
    def has_planes(self) -> bool:
        """Whether planes that are oblique to the axes bound symbols: those of splits."""
        return len(self.planes) > 0

    @property
    def mixed_cells(self) -> np.ndarray:
        """All leaves: nobody has looked at test points of them."""
        return np.flatnonzero(self.split == LEAF)

    @property
    def disagreeing(self) -> np.ndarray:
        """No leaves: none has test points."""
        return np.empty(0, dtype=np.int32)

    def structure(self) -> dict[str, Any]:
        """Return what a file says of the tree beside its arrays, as plain data."""
        return {"counts": list(self.counts)}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by their names in a file."""
        return {name: getattr(self, name) for name in TREE_ARRAYS}

    def lookup_arguments(self) -> dict[str, Any]:
        """Return what lookup.c knows of the tree: numbers, and arrays, by name."""
        shift, starts = self.starts
        arrays = {"nodes": self.rows, "planes": self.planes, "starts": starts}
        return {"shift": shift, "oblique": self.has_planes, **arrays}

    @property
    def leaf_count(self) -> int:
        """Number of leaves, one more than inner nodes."""
        return (self.node_count + 1) // 2

    @functools.cached_property
    def first(self) -> np.ndarray:
        """The first child (K,) int32 of each node; of a leaf the leaf itself."""
        return np.arange(self.node_count, dtype=np.int32) + (self.split != LEAF).astype(np.int32)

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """Nodes (K, 4) int32 for walks: split, threshold, children; leaves point to themselves."""
        split = np.maximum(self.split, 0)
        columns = [split, self.threshold, self.first, self.second]
        return np.column_stack(columns).astype(np.int32, copy=False)

    @functools.cached_property
    def depths(self) -> np.ndarray:
        """Comparisons from the root to each node, (K,)."""
        depths = np.zeros(self.node_count, dtype=np.int32)
        nodes = np.zeros(1, dtype=np.int32)
        for depth in range(1, MAX_DEPTH + 2):
            nodes = nodes[self.split[nodes] != LEAF]
            nodes = np.concatenate([self.first[nodes], self.second[nodes]])
            if not nodes.size:
                break
            depths[nodes] = depth
        return depths

    @property
    def depth(self) -> int:
        """Most comparisons that a lookup takes."""
        return int(self.depths.max())

    def find(self, steps: np.ndarray) -> np.ndarray:
        """Return the leaves (B,) that lattice steps (B, n) end in."""
        nodes = np.zeros(len(steps), dtype=np.int32)
        rows = np.arange(len(steps))
        while rows.size:
            at = nodes[rows]
            inner = self.split[at] != LEAF
            rows, at = rows[inner], at[inner]
            value, _ = self._compared(at, steps, steps, rows)
            nodes[rows] = np.where(value >= self.threshold[at], self.second[at], self.first[at])
        return nodes

    def _compared(
        self, nodes: np.ndarray, lower: np.ndarray, last: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and largest values (B,) that inner nodes (B,) compare in boxes.

        The boxes are those of `rows` (B,), with lower and last lattice steps (M, n).
        """
        split = self.split[nodes]
        oblique = np.flatnonzero(split >= self.n)
        axis = split % self.n
        least, most = lower[rows, axis], last[rows, axis]
        if oblique.size:
            planes = self.planes[split[oblique] - self.n].astype(np.int64)
            low, high = lower[rows[oblique]], last[rows[oblique]]
            up, down = np.maximum(planes, 0), np.minimum(planes, 0)
            least[oblique] = (up * low + down * high).sum(axis=1)
            most[oblique] = (up * high + down * low).sum(axis=1)
        return least, most

    def labels(self, steps: np.ndarray, in_force: np.ndarray | None = None) -> np.ndarray:
        """Return the numbers (B,) of the rows of lattice steps (B, n), whatever is in force."""
        return self.labels_at(self.find(steps))

    def labels_in(
        self, places: np.ndarray, steps: np.ndarray, in_force: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the numbers (B,) of the rows of leaf nodes, whatever the steps, and in force."""
        return self.labels_at(places)

    def constant_leaves(self, rows: int) -> np.ndarray:
        """Return the numbers (L,) of all leaves."""
        return self.leaf_labels()

    def labels_at(self, places: np.ndarray) -> np.ndarray:
        """Return the labels of leaf nodes."""
        return self.threshold[places]

    def parts(
        self, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what the leaves cut lattice boxes ``lower <= z < upper``, (M, n) each, into.

        They are the leaf and the box (P,) of each part and its corners (P, n) and (P, n); the parts
        of a box tile it. A tree with oblique splits, or more than `MAX_PARTS` parts, is a
        `ProblemError`.
        """
        if self.has_planes:
            raise ProblemError(
                "a tree with oblique splits has no boxes; compress in mode exact or freedom"
            )
        node, box = np.zeros(len(lower), dtype=np.int32), np.arange(len(lower))
        done = []
        while True:
            if len(box) > MAX_PARTS:
                raise ProblemError(
                    f"the leaves of the tree cut {box[-1] + 1} boxes into more than {MAX_PARTS} "
                    "parts: it is too large for this"
                )
            axis, cut = self.split[node], self.threshold[node]
            leaf = axis == LEAF
            done.append((node[leaf], box[leaf], lower[leaf], upper[leaf]))
            if leaf.all():
                break
            lower, upper, node, box, axis, cut = (
                x[~leaf] for x in (lower, upper, node, box, axis, cut)
            )
            rows = np.arange(len(box))
            low, high = lower[rows, axis] < cut, upper[rows, axis] > cut
            first_upper, second_lower = upper.copy(), lower.copy()
            first_upper[rows, axis] = np.minimum(upper[rows, axis], cut)
            second_lower[rows, axis] = np.maximum(lower[rows, axis], cut)
            lower = np.concatenate([lower[low], second_lower[high]])
            upper = np.concatenate([first_upper[low], upper[high]])
            node = np.concatenate([self.first[node[low]], self.second[node[high]]])
            box = np.concatenate([box[low], box[high]])
        leaves, boxes, lower, upper = (np.concatenate(x) for x in zip(*done))
        return leaves, boxes, lower, upper

    def refined(self, counts: tuple[int, ...]) -> SplitTree:
        """Return the same tree on a lattice of more steps, multiples of its own.

        Splits must not be oblique.
        """
        factors = np.array(counts) // np.array(self.counts)
        scale = np.where(self.split == LEAF, 1, factors[self.split])
        threshold = (self.threshold * scale).astype(np.int32)
        return SplitTree(counts, self.split, threshold, self.second, self.planes)

    def layers(self) -> list[np.ndarray]:
        """Return all nodes at once: they have no levels."""
        return [np.arange(self.node_count)]

    def leaf_labels(self) -> np.ndarray:
        """Return the labels of all leaves."""
        return self.labels_at(self.mixed_cells)

    def finest(self, places: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Return that leaves (M,) are as fine as they get, whatever their sizes (M, n)."""
        return np.ones(len(places), dtype=bool)

    def boxes(self) -> Boxes:
        """Return the leaves as boxes; `ProblemError` where splits are oblique."""
        whole = np.array([self.counts], dtype=np.int64)
        leaf, _, lower, upper = self.parts(np.zeros_like(whole), whole)
        order = np.argsort(leaf)
        leaf, lower, upper = leaf[order], lower[order], upper[order]
        return Boxes(leaf, lower, upper, self.threshold[leaf], np.zeros(len(leaf), dtype=np.int64))

    def check(self, label_count: int, rows: np.ndarray | None = None) -> None:
        """Raise `PolicyFormatError` unless the arrays are a well-formed tree with such leaves.

        The arguments are those of `CellTree.check`.
        """
        known = label_count if rows is None else len(rows)
        count, n = self.node_count, self.n
        if not count or not len(self.threshold) == len(self.second) == count:
            raise PolicyFormatError("the arrays of the tree differ in length, or are empty")
        if min(self.counts) < 1 or max(self.counts) > MAX_COUNT:
            raise PolicyFormatError(f"the tree's lattice has {self.counts} steps")
        if self.planes.ndim != 2 or self.planes.shape[1] != n:
            raise PolicyFormatError(f"the tree's planes must have {n} coefficients")
        leaf = self.split == LEAF
        if (self.split < LEAF).any() or (self.split >= n + len(self.planes)).any():
            raise PolicyFormatError("a node of the tree splits an unknown axis")
        labels = self.threshold[leaf]
        if (labels < 0).any() or (labels >= known).any():
            raise PolicyFormatError("a leaf of the tree has an unknown label")
        expected = _second_children(leaf)
        if expected is None or not np.array_equal(self.second, expected):
            raise PolicyFormatError("the nodes are not one tree in depth-first order")
        if self.depth > MAX_DEPTH:
            raise PolicyFormatError(f"the tree takes more than {MAX_DEPTH} comparisons")
        if not np.array_equal(self.split[self.split >= n] - n, np.arange(len(self.planes))):
            raise PolicyFormatError("the nodes do not use each plane of the tree once, in order")
        sums = np.abs(self.planes.astype(np.float64)) @ np.array(self.counts, dtype=np.float64)
        if (sums > MAX_COUNT).any():
            raise PolicyFormatError("a plane of the tree has sums beyond 32 bits")
        counts = np.array((*self.counts, *[0] * len(self.planes)))[self.split]
        axis = (self.split != LEAF) & (self.split < n)
        if (axis & ((self.threshold < 1) | (self.threshold >= counts))).any():
            raise PolicyFormatError("a node of the tree splits an axis beyond its lattice")

    @functools.cached_property
    def starts(self) -> tuple[int, np.ndarray]:
        """Where lookups may begin: (shift, nodes).

        The lattice is cut into blocks of ``2 ** shift`` steps along each axis; the nodes (M,)
        int32, in C order, are the deepest that hold a whole block each. There are at most
        `START_NODES`, or `STARTS_PER_NODE` for each node of the tree.
        """
        shift, counts = 0, np.array(self.counts, dtype=np.int64)
        room = max(START_NODES, STARTS_PER_NODE * self.node_count)
        while np.prod((((counts - 1) >> shift) + 1).astype(float)) > room:
            shift += 1
        lower = grid_places(((counts - 1) >> shift) + 1) << shift
        upper = np.minimum(lower + (1 << shift), counts)
        last = upper - 1
        nodes = np.zeros(len(lower), dtype=np.int32)
        rows = np.flatnonzero(self.split[nodes] != LEAF)
        while rows.size:
            at = nodes[rows]
            least, most = self._compared(at, lower, last, rows)
            beyond, before = least >= self.threshold[at], most < self.threshold[at]
            whole = beyond | before
            nodes[rows] = np.where(beyond, self.second[at], np.where(before, self.first[at], at))
            rows = rows[whole & (self.split[nodes[rows]] != LEAF)]
        return shift, nodes


def depth_first(
    counts: tuple[int, ...],
    root: Node,
    look: Callable[[Node], tuple[int | Sequence[int] | np.ndarray, int, Sequence[Node]]],
) -> SplitTree:
    """Return the tree below a root: what `look` says of a node, its split, threshold and children.

    A split is an axis, a plane (n,), or `LEAF` with no children and the label for a threshold.
    """
    splits: list[int] = []
    thresholds: list[int] = []
    second: list[int] = []
    planes: list[Sequence[int] | np.ndarray] = []
    stack: list[tuple[Node, int]] = [(root, -1)]
    while stack:
        node, parent = stack.pop()
        here = len(splits)
        if parent >= 0:
            second[parent] = here
        second.append(here)
        split, threshold, children = look(node)
        if not isinstance(split, int):
            planes.append(split)
            split = len(counts) + len(planes) - 1
        splits.append(split)
        thresholds.append(threshold)
        if children:  # the first comes next, then all its offspring, then the second
            stack += [(children[1], here), (children[0], -1)]
    table = np.array(planes, dtype=np.int32).reshape(-1, len(counts))
    split_row, threshold_row, second_row = np.array([splits, thresholds, second], dtype=np.int32)
    return SplitTree(counts, split_row, threshold_row, second_row, table)


def _second_children(leaf: np.ndarray) -> np.ndarray | None:
    """Return the second children (K,) of nodes in depth-first order, of leaves themselves.

    Nodes left to visit after node `i` are `left[i] + 1`; the first subtree of an inner node ends
    where they have become one less. None where the nodes are not one tree.
    """
    nodes, left = np.arange(len(leaf)), np.cumsum(np.where(leaf, -1, 1))
    if left[-1] != -1 or (left[:-1] < 0).any():
        return None
    order = np.lexsort((nodes, left))
    keys = left[order] * len(leaf) + nodes[order]
    ends = np.searchsorted(keys, (left - 1) * len(leaf) + nodes) % len(leaf)
    return np.where(leaf, nodes, nodes[order][ends] + 1)
