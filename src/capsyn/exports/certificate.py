"""What a decision of an export takes at most, as plain data."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.packing import packed_bytes, smallest_type
from capsyn.cells.work import work_of
from capsyn.compression.complexity import deepest_steps, mean_depth
from capsyn.exports.plan import Plan
from capsyn.exports.target import Exported
from capsyn.policies.policy import DecisionTree
from capsyn.policies.report import feature_figures


def certificate(
    plan: Plan, exported: Exported, target: str, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what a decision takes at most, as plain data.

    Of a tree ``comparisons`` is exact: most of them, lattice steps ``at`` which there are so many,
    and the mean over the volume; the last two are None where splits are oblique. ``tree_bytes``
    counts the tree's arrays in the smallest integers that hold them; ``features`` are there where
    the tree has any, and ``written`` where the target writes it in another form, see `Exported`. Of
    cells there are ``levels`` that are passed and ``rows_evaluated``, most and mean over the
    volume, ``cells_bytes`` as those of a tree, and ``worst``, lattice steps of a leaf with the most
    rows, of these the deepest. Where the next symbol depends on that in force, ``transitions`` has
    the rows of that table and its bytes, likewise. ``changed_by_rounding`` is the share of random
    states whose symbol is another as the target rounds them; None where it rounds to the policy's
    own lattice, which changes none.
    """
    costs = _of_cells(plan.cells) if isinstance(plan.cells, CellTree) else _of_tree(plan.tree)
    if plan.policy.remembers:
        table = plan.transitions
        size = table.size * smallest_type(table).itemsize
        costs["transitions"] = {"rows": len(table), "bytes": size}
    return {
        "header": list(plan.header),
        "target": target,
        "options": dict(options),
        "policy": plan.policy.name,
        "sha256": plan.sha256,
        **costs,
        **({} if exported.written is None else {"written": dict(exported.written)}),
        "files": {
            name: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
            for name, content in sorted(exported.files.items())
        },
        "guarantee": plan.guarantee.text,
        "changed_by_rounding": exported.changed,
        "renamed": dict(exported.renamed),
        "notes": [*plan.notes, *exported.notes],
    }


def _of_tree(tree: DecisionTree) -> dict[str, Any]:
    features = feature_figures(tree.cells)
    return {
        "nodes": tree.node_count,
        "comparisons": {"most": tree.depth, "at": deepest_steps(tree), "mean": mean_depth(tree)},
        "planes": len(tree.cells.planes),
        **({} if features is None else {"features": features}),
        "lattice": list(tree.cells.counts),
        "tree_bytes": packed_bytes(tree.cells),
    }


def _of_cells(cells: CellTree) -> dict[str, Any]:
    work = work_of(cells)
    return {
        "cells": cells.leaf_count,
        "affine_leaves": 0 if cells.affine is None else len(cells.affine),
        "rows": 0 if cells.affine is None else len(cells.affine.symbols),
        "levels": {"most": work.levels, "mean": work.mean_levels},
        "rows_evaluated": {"most": work.rows, "mean": work.mean_rows},
        "worst": work.steps.tolist(),
        "lattice": list(cells.counts),
        "cells_bytes": packed_bytes(cells),
    }
