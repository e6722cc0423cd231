"""From where limits are kept as a policy of its own, which goes wherever policies go."""

from __future__ import annotations

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.policies.policy import Policy

NOT_KEPT, KEPT = 0, 1
"""Symbols of the policy that tells."""


def limits_policy(policy: Policy) -> Policy:
    """Return the policy whose symbol says whether another keeps its limits from a state.

    It is `KEPT` where they are kept whatever symbol is in force, else, and outside the domain,
    `NOT_KEPT`. A policy that was not made to keep limits is a `ProblemError`.
    """
    if policy.kept is None:
        raise ProblemError(f"`policy` must be made with `keep_limits`; got {policy!r}")
    cells, rows = policy.kept.cells, policy.kept.rows
    always = np.asarray(rows[:, : max(rows.shape[1] - 1, 1)].all(axis=1), dtype=np.int32)
    numbers = always[np.maximum(-1 - cells.entries, 0)]
    entries = np.where(cells.entries < 0, -1 - numbers, cells.entries)
    none = np.zeros((0, 1, 1), dtype=np.uint64)
    return Policy(
        name=f"limits {policy.name}",
        domain=policy.domain,
        alphabet=Alphabet([0.0, 1.0], names=["not kept", "kept"], inputs=["kept"]),
        default=np.zeros(1),
        cells=CellTree(cells.grid, entries.astype(np.int32), cells.mixed_cells, none),
        outside=NOT_KEPT,
        time_unit=policy.time_unit,
        exogenous=policy.exogenous,
    )
