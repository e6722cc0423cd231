"""Trees that give numbers, and the tree over a lattice that says which of several is least.

A node compares one coordinate with a bound: not above it is low, above it high.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from capsyn.cells.split_tree import LEAF, SplitTree, depth_first
from capsyn.errors import ProblemError
from capsyn.sources.tables.json_text import is_real, told

MOST_NODES = 1 << 21
"""Most nodes of all trees of a file, and of the tree that is made of them."""


@dataclass(frozen=True, eq=False)
class Regressor:
    """A tree of numbers, its root first.

    Parameters
    ----------
    axis : (K,) ints
        What a node compares; `LEAF` of a leaf.
    bound : (K,)
        The bound of a node, the number of a leaf.
    low, high : (K,) ints
        Children; of a leaf the leaf itself.
    """

    axis: np.ndarray
    bound: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def values(self, states: np.ndarray) -> np.ndarray:
        """Return the numbers (B,) at states (B, n)."""
        node = np.zeros(len(states), dtype=np.int64)
        rows = np.arange(len(states))
        while rows.size:
            at = node[rows]
            inner = self.axis[at] != LEAF
            rows, at = rows[inner], at[inner]
            above = states[rows, self.axis[at]] > self.bound[at]
            node[rows] = np.where(above, self.high[at], self.low[at])
        return self.bound[node]

    def least_and_most(self) -> tuple[list[float], list[float]]:
        """Return the least and the largest number (K,) below each node."""
        least, most = self.bound.tolist(), self.bound.tolist()
        for node in np.flatnonzero(self.axis != LEAF)[::-1].tolist():  # children come later
            low, high = self.low[node], self.high[node]
            least[node] = min(least[low], least[high])
            most[node] = max(most[low], most[high])
        return least, most


class Refuse:
    """Raises the error of a part of a file."""

    def __init__(self, where: str) -> None:
        self.where = where

    def __call__(self, wanted: str, got: Any) -> NoReturn:
        """Raise it: what is expected, and what there is instead."""
        raise ProblemError(f"{self.where}: expected {wanted}; got {told(got)}")


def regressor_of(tree: Any, axes: int, sign: float, refuse: Refuse, room: int) -> Regressor:
    """Return the tree of nested objects ``{"var", "bound", "low", "high"}`` and numbers.

    Parameters
    ----------
    tree : plain data
        The text ``"inf"`` is a number, too: infinite, whatever the `sign`.
    axes : int
        Number of coordinates.
    sign : float
        What numbers are multiplied by.
    refuse : callable
        Called with what is expected, and what there is instead; raises.
    room : int
        Most nodes.
    """
    axis: list[int] = []
    bound: list[float] = []
    children: list[list[int]] = []
    stack = [(tree, -1, 0)]
    while stack:
        node, parent, side = stack.pop()
        here = len(axis)
        if here >= room:
            raise ProblemError(f"a strategy must have at most {MOST_NODES:,} nodes")
        if parent >= 0:
            children[parent][side] = here
        children.append([here, here])
        if is_real(node):
            axis.append(LEAF)
            bound.append(_finite(node, refuse) * sign)
        elif node == "inf":
            axis.append(LEAF)
            bound.append(math.inf)
        elif isinstance(node, dict) and {"var", "bound", "low", "high"} <= set(node):
            place = node["var"]
            if not isinstance(place, int) or isinstance(place, bool) or not 0 <= place < axes:
                refuse(f"'var', 0 to {axes - 1}", place)
            if not is_real(node["bound"]):
                refuse("a number for 'bound'", node["bound"])
            axis.append(place)
            bound.append(_finite(node["bound"], refuse))
            stack += [(node["high"], here, 1), (node["low"], here, 0)]
        else:
            refuse("a number, or an object with var, bound, low and high", node)
    pairs = np.array(children, dtype=np.int64)
    return Regressor(np.array(axis), np.array(bound, dtype=float), pairs[:, 0], pairs[:, 1])


def _finite(value: float, refuse: Refuse) -> float:
    if abs(value) > 1e290:
        refuse("a number within +-1e+290", value)
    return float(value)


@dataclass(frozen=True, eq=False)
class Contest:
    """Regressors of symbols, whose least number decides.

    Parameters
    ----------
    symbols : K ints, ascending
        The symbols.
    trees : K regressors
        Their numbers.
    cuts : K lists of ints
        The lattice step from which on states are above each bound.
    """

    symbols: Sequence[int]
    trees: Sequence[Regressor]
    cuts: Sequence[list[int]]


Corners = tuple[tuple[int, ...], tuple[int, ...]]


def least(counts: tuple[int, ...], keyed: dict[tuple[int, ...], Contest], none: int) -> SplitTree:
    """Return the tree over a lattice that gives the symbol of the least number.

    Parameters
    ----------
    counts : (n,) ints
        Lattice steps.
    keyed : contests by the steps of the first axes
        The axes of their regressors come after these. Of equal numbers the first symbol wins.
    none : int
        The label where there is no contest, or no finite number.

    Raises
    ------
    ProblemError
        More than `MOST_NODES` nodes.
    """
    n = len(next(iter(keyed)))
    bounds = {key: [tree.least_and_most() for tree in c.trees] for key, c in keyed.items()}
    visited = 0

    def look(node: Any) -> tuple[int, int, Sequence[Any]]:
        nonlocal visited
        visited += 1
        if visited > MOST_NODES:
            raise ProblemError(
                f"the regions of a strategy must be at most {MOST_NODES // 2:,}; there are more"
            )
        (lower, upper), keys, standing = node
        if not keys:
            return LEAF, none, ()
        if standing is None:
            split = _between(keys, lower[:n], upper[:n])
            if split is not None:
                axis, cut = split
                first = [key for key in keys if key[axis] < cut]
                second = [key for key in keys if key[axis] >= cut]
                parts = _halves(lower, upper, axis, cut)
                return axis, cut, [(parts[0], first, None), (parts[1], second, None)]
            standing = [(k, 0) for k in range(len(keyed[keys[0]].trees))]
        contest, ends = keyed[keys[0]], bounds[keys[0]]
        standing = [(k, _descend(contest, k, at, n, lower, upper)) for k, at in standing]
        best = min(ends[k][1][at] for k, at in standing)
        standing = [(k, at) for k, at in standing if ends[k][0][at] <= best]
        winner = _winner(standing, ends)
        if winner is not None:
            k, at = winner
            lost = math.isinf(ends[k][0][at])
            return LEAF, none if lost else contest.symbols[k], ()
        k, at = next((k, at) for k, at in standing if contest.trees[k].axis[at] != LEAF)
        axis, cut = n + int(contest.trees[k].axis[at]), contest.cuts[k][at]
        parts = _halves(lower, upper, axis, cut)
        return axis, cut, [(part, keys, standing) for part in parts]

    whole = ((0,) * len(counts), counts)
    return _joined(depth_first(counts, (whole, list(keyed), None), look))


def _between(
    keys: Sequence[tuple[int, ...]], lower: tuple[int, ...], upper: tuple[int, ...]
) -> tuple[int, int] | None:
    """Return axis and cut that part keys, or a key from a box around it; None where it fills it."""
    for axis, (low, high) in enumerate(zip(lower, upper)):
        if high - low > 1:
            places = sorted({key[axis] for key in keys})
            if len(places) > 1:
                return axis, places[len(places) // 2]
            if places[0] > low:
                return axis, places[0]
            return axis, places[0] + 1
    return None


def _halves(
    lower: tuple[int, ...], upper: tuple[int, ...], axis: int, cut: int
) -> tuple[Corners, Corners]:
    """Return the two parts of a box of lattice steps."""
    middle_up = (*upper[:axis], cut, *upper[axis + 1 :])
    middle_low = (*lower[:axis], cut, *lower[axis + 1 :])
    return (lower, middle_up), (middle_low, upper)


def _descend(
    contest: Contest, k: int, at: int, n: int, lower: tuple[int, ...], upper: tuple[int, ...]
) -> int:
    """Return the node of a tree that holds a box of lattice steps."""
    tree, cuts = contest.trees[k], contest.cuts[k]
    while (axis := tree.axis[at]) != LEAF:
        cut = cuts[at]
        if cut <= lower[n + axis]:
            at = int(tree.high[at])
        elif cut >= upper[n + axis]:
            at = int(tree.low[at])
        else:
            break
    return at


def _winner(
    standing: Sequence[tuple[int, int]], ends: Sequence[tuple[list[float], list[float]]]
) -> tuple[int, int] | None:
    """Return the tree, and its node, whose numbers are the least all over a box, if there is one.

    Where all are infinite, it is any.
    """
    for k, at in standing:
        least_of_k, most = ends[k][0][at], ends[k][1][at]
        if math.isinf(most) and not math.isinf(least_of_k):
            continue
        if all(
            most < ends[j][0][node] or most == ends[j][0][node] and k <= j
            for j, node in standing
            if j != k
        ):
            return k, at
    return None


def _joined(tree: SplitTree) -> SplitTree:
    """Return a tree without splits whose parts all have one label."""
    label = np.where(tree.split == LEAF, tree.threshold, -1).tolist()
    second = tree.second.tolist()
    for node in np.flatnonzero(tree.split != LEAF)[::-1].tolist():
        if label[node + 1] >= 0 and label[node + 1] == label[second[node]]:
            label[node] = label[node + 1]

    def look(node: int) -> tuple[int, int, Sequence[int]]:
        if label[node] >= 0:
            return LEAF, label[node], ()
        return int(tree.split[node]), int(tree.threshold[node]), (node + 1, second[node])

    return depth_first(tree.counts, 0, look)
