"""The cost certificate of an export: what a decision takes at most."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from capsyn.cells.packing import packed_bytes
from capsyn.compression.complexity import mean_depth
from capsyn.exports.plan import Plan
from capsyn.exports.target import Exported
from capsyn.policies.file import content_hash


def certificate(
    plan: Plan, exported: Exported, target: str, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what a decision takes at most, as plain data.

    ``comparisons`` is exact, from the tree; the mean is over the volume, and None where splits are
    oblique. ``tree_bytes`` counts the tree's arrays in the smallest integers that hold them.
    ``changed_by_rounding`` is the share of random states whose symbol is another as the target
    rounds them; None where it rounds to the policy's own lattice, which changes none.
    """
    tree = plan.tree
    return {
        "header": list(plan.header),
        "target": target,
        "options": dict(options),
        "policy": plan.policy.name,
        "sha256": content_hash(plan.policy),
        "nodes": tree.node_count,
        "comparisons": {"most": tree.depth, "mean": mean_depth(tree)},
        "planes": len(tree.cells.planes),
        "lattice": list(tree.cells.counts),
        "tree_bytes": packed_bytes(tree.cells),
        "files": {
            name: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
            for name, content in sorted(exported.files.items())
        },
        "guarantee": tree.guarantee.text,
        "changed_by_rounding": exported.changed,
        "renamed": dict(exported.renamed),
        "notes": list(exported.notes),
    }
