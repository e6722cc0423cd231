"""The cost certificate of an export: what a decision takes at most."""

from __future__ import annotations

from typing import Any

from capsyn.complexity import mean_depth
from capsyn.exports.plan import Files, Plan
from capsyn.packing import packed_bytes
from capsyn.policy_file import content_hash


def certificate(plan: Plan, files: Files, target: str) -> dict[str, Any]:
    """Return what a decision takes at most, as plain data.

    ``comparisons`` is exact, from the tree; ``tree_bytes`` counts its arrays in the smallest
    integers that hold them, ``file_bytes`` the files by name.
    """
    tree = plan.tree
    return {
        "target": target,
        "policy": plan.policy.name,
        "sha256": content_hash(plan.policy),
        "nodes": tree.node_count,
        "comparisons": {"most": tree.depth, "mean": mean_depth(tree)},
        "planes": len(tree.cells.planes),
        "lattice": list(tree.cells.counts),
        "tree_bytes": packed_bytes(tree.cells),
        "file_bytes": {name: len(content) for name, content in sorted(files.items())},
        "guarantee": tree.guarantee.text,
    }
