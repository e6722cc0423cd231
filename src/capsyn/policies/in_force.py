"""Which symbols may be in force, where they stay, and how much of the domain each has."""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.modelling.grid import places_or_some

SAMPLES = 100_000
"""States at which the volumes of symbols are estimated where planes bound them."""


def followers(policy: Any) -> np.ndarray:
    """Return which label may follow which somewhere in the domain, (N + 1, N + 1) booleans.

    Of affine leaves it may be any of their rows that is not forbidden.
    """
    table, cells = policy.transitions, policy.cells
    count = table.shape[1]
    follows = np.zeros((count, count), dtype=bool)
    follows[np.arange(count), table[np.unique(cells.constant_leaves(len(table)))]] = True
    affine = getattr(cells, "affine", None)
    if affine is not None:
        could = np.zeros((count, count), dtype=bool)
        could[:, np.unique(affine.symbols)] = True
        if affine.ratios is not None:
            forbidden = could & (affine.ratios < 0)
            could &= ~forbidden
            np.fill_diagonal(could, could.diagonal() | forbidden.any(axis=1))  # j stays if all are
        follows |= could
    return follows


def reachable(policy: Any) -> np.ndarray:
    """Return the labels (K,) that may be in force, ascending, N for the default control.

    They are those that the policy gives at the start, when the default control is in force, or
    later, in turn, the safe symbol outside the domain, and what is taken while inputs are held. The
    default control is one of them only where the policy gives it.
    """
    follows = followers(policy)
    found = follows[-1].copy()
    if policy.remembers and not isinstance(policy.outside, str):
        found[policy.outside] = True
    while True:
        more = found | follows[found].any(axis=0) | _mixed(policy, found)
        if (more == found).all():
            return np.flatnonzero(found)
        found = more


def _mixed(policy: Any, found: np.ndarray) -> np.ndarray:
    """Return which labels (N + 1,) may be taken while inputs are held, of values of `found`."""
    controls, held = policy.controls, policy.rules.input_holds > 0
    if not held.any():
        return np.zeros_like(found)
    same = (controls[:, None] == controls[found]).any(axis=1).all(axis=1)
    same[-1] = False  # never the default
    return np.asarray(same)


def staying_rows(policy: Any, current: int | None = None) -> np.ndarray:
    """Return the rows (R,) of which a symbol in force stays though the start would take another.

    Only `current` counts, or by default each symbol that may be in force.
    """
    table = policy.transitions
    labels = np.array([reachable(policy) if current is None else [current]]).ravel()
    kept = table[:, labels] == labels
    return np.asarray((kept & (table[:, -1:] != labels)).any(axis=1))


def stays(
    policy: Any, states: np.ndarray, current: int | None = None, backend: str = "auto"
) -> np.ndarray:
    """Return at which states (B, n) a symbol in force stays though the start would take another.

    Which symbols count is as in `staying_rows`, the backend that of a call of the policy. Outside
    the domain the nearest cell counts.
    """
    found = np.zeros(len(states), dtype=bool)
    if policy.remembers:
        first = policy.leaves(states, True, backend)
        for label in reachable(policy) if current is None else [current]:
            now = np.full(len(states), label, dtype=np.int32)
            found |= (policy.leaves(states, True, backend, now) == label) & (first != label)
    return found


def volume_shares(policy: Any) -> np.ndarray:
    """Return the share of the domain's volume of each symbol, and of the default last, (N + 1,).

    Of a policy that remembers they are the mean over all symbols in force.
    """
    cells, table = policy.cells, policy.transitions
    count = table.shape[1]
    if policy.has_planes:
        steps = places_or_some(cells.counts, SAMPLES)
        volumes = None
    else:
        boxes = cells.boxes()
        volumes = boxes.volumes() / np.prod(cells.counts, dtype=float)

    def shares(now: int) -> np.ndarray:
        if volumes is not None:
            return np.bincount(table[boxes.labels, now], volumes, count)
        rows = cells.labels(steps, np.full(len(steps), now, dtype=np.int32))
        return np.bincount(table[rows, now], minlength=count) / len(steps)

    in_force = range(count - 1) if policy.remembers else [count - 1]
    return np.asarray(np.mean([shares(now) for now in in_force], axis=0))


def mixed_share(cells: CellTree) -> float:
    """Return the share of the volume of cells whose test points did not agree."""
    places, volumes = cells.volumes()
    mixed = volumes[np.isin(places, cells.mixed_cells)]
    return float(mixed.sum() / np.prod(cells.counts, dtype=float))
