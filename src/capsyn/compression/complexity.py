"""How complex a policy is: as a table, as a tree, as an automaton."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from capsyn.automata.automaton import Automaton
from capsyn.cells.cell_tree import CellTree
from capsyn.compression.rows import policy_bytes
from capsyn.compression.trees import affine_tree_of, tree_of
from capsyn.policies.policy import DecisionTree, Policy

MOST_NODES = 1_000_000
"""Most nodes of the tree of affine leaves."""


def complexity(policy: Policy) -> dict[str, Any]:
    """Return how complex a policy is, as plain data.

    Returns
    -------
    dict
        ``symbol_entropy``: of the symbols' shares of the volume [bits]. ``table``: of a policy of
        cells, ``bytes`` and ``comparisons``, most that a lookup takes as nested inequalities.
        ``tree``: of a decision tree, or of the exact one of a policy of cells, ``mode``,
        ``nodes``, ``planes``, ``bytes``, ``comparisons`` (most), ``deepest`` (a state that takes as
        many, [state units]) and ``mean_comparisons`` (over the volume), both None where splits are
        oblique; None where that of affine leaves has more than `MOST_NODES`, or where leaves have
        prices. ``automaton``:
        ``regions``, ``boxes`` that tile them, ``partitions`` (connected), ``edges`` and
        ``possible_edges``, ``switch_rate`` [1 / time unit], ``sliding_share`` and
        ``switching_entropy`` [bits] (None without a model, see `switching_entropy`). None where
        splits are oblique or leaves affine.
    """
    cells = policy.cells if isinstance(policy.cells, CellTree) else None
    tree: DecisionTree | None
    if cells is not None and cells.affine is not None:
        tree = affine_tree_of(policy, MOST_NODES)
    else:
        tree = tree_of(policy)
    return {
        "symbol_entropy": entropy(policy.volume_shares),
        "table": None if cells is None else _table(policy, cells),
        "tree": None if tree is None else _tree(tree),
        "automaton": None if policy.has_planes else _automaton(policy),
    }


def _tree(tree: DecisionTree) -> dict[str, Any]:
    return {
        "mode": tree.guarantee.mode,
        "nodes": tree.node_count,
        "planes": len(tree.cells.planes),
        "bytes": policy_bytes(tree),
        "comparisons": tree.depth,
        "deepest": _state(tree, deepest_steps(tree)),
        "mean_comparisons": mean_depth(tree),
    }


def entropy(shares: np.ndarray) -> float:
    """Return the entropy [bits] of shares that sum to 1."""
    some = shares[shares > 0]
    return abs(float(-(some * np.log2(some)).sum()))  # not -0.0


def switching_entropy(rates: np.ndarray) -> float:
    """Return how uncertain the next symbol is at a switch [bits]; 0 where there are none.

    It is the entropy of the next symbol given the present one, averaged over the switches, whose
    rates (V, V) [1 / time unit] are from a symbol (row) to another.
    """
    out = rates.sum(axis=1)
    total = out.sum()
    if total <= 0:
        return 0.0
    return sum(float(one / total) * entropy(row / one) for one, row in zip(out, rates) if one > 0)


def _table(policy: Policy, cells: CellTree) -> dict[str, int]:
    """Return the size of a table of cells; a lookup halves each axis that a cell is split along."""

    def halvings(sizes: tuple[int, ...]) -> np.ndarray:
        return np.array([math.ceil(math.log2(size)) for size in sizes])

    most = max(int((cells.times(x) @ halvings(cells.refinement)).max()) for x in cells.levels())
    comparisons = int(halvings(cells.partitions).sum()) + most
    if cells.affine is not None:  # the rows of a leaf, one after the other
        comparisons += int(np.diff(cells.affine.starts).max()) - 1
    return {"bytes": policy_bytes(policy), "comparisons": comparisons}


def mean_depth(tree: DecisionTree) -> float | None:
    """Return a lookup's mean comparisons over the volume; None where splits are oblique."""
    if tree.cells.has_planes:
        return None
    boxes = tree.cells.boxes()
    volumes = boxes.volumes()
    return float((tree.cells.depths[boxes.places] * volumes).sum() / volumes.sum())


def deepest_steps(tree: DecisionTree) -> list[int] | None:
    """Return lattice steps that a lookup compares most for; None where splits are oblique."""
    if tree.cells.has_planes:
        return None
    boxes = tree.cells.boxes()
    steps: list[int] = boxes.lower[tree.cells.depths[boxes.places].argmax()].tolist()
    return steps


def _state(tree: DecisionTree, steps: list[int] | None) -> list[float] | None:
    """Return the state in the middle of lattice steps."""
    if steps is None:
        return None
    share = (np.array(steps) + 0.5) / tree.cells.counts
    state: list[float] = (tree.space.lower + share * tree.space.widths).tolist()
    return state


def _automaton(policy: Policy) -> dict[str, Any]:
    machine = Automaton.of(policy)
    analysis = machine.switching
    rates = None if analysis is None else analysis.switch_rates + analysis.sliding_rates
    return {
        "regions": len(machine.regions),
        "boxes": sum(len(region) for region in machine.regions),
        "partitions": len(machine.partitions),
        "edges": len(machine.edges),
        "possible_edges": sum(edge.possible is not False for edge in machine.edges),
        "switch_rate": None if analysis is None else analysis.rate,
        "sliding_share": None if analysis is None else analysis.sliding_share,
        "switching_entropy": None if rates is None else switching_entropy(rates),
    }
