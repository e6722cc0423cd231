"""The cost certificate of an export: what a decision takes at most."""

from __future__ import annotations

from typing import Any

from capsyn.complexity import mean_depth
from capsyn.exports.c_sizes import sizes
from capsyn.exports.plan import Made, Plan
from capsyn.packing import packed_bytes
from capsyn.policy_file import content_hash


def certificate(plan: Plan, made: Made, target: str) -> dict[str, Any]:
    """Return what a decision takes at most, as plain data.

    ``comparisons`` is exact, from the tree; ``tree_bytes`` counts its arrays in the smallest
    integers that hold them, ``file_bytes`` the files by name; ``changed_by_rounding`` is the share
    of states whose symbol is another as the target rounds them. Target c has ``measured`` besides:
    flash and stack by processor, of the compilers that are here; see `c_sizes.sizes`.
    """
    tree = plan.tree
    figures = {
        "header": list(plan.header),
        "target": target,
        "policy": plan.policy.name,
        "sha256": content_hash(plan.policy),
        "nodes": tree.node_count,
        "comparisons": {"most": tree.depth, "mean": mean_depth(tree)},
        "planes": len(tree.cells.planes),
        "lattice": list(tree.cells.counts),
        "tree_bytes": packed_bytes(tree.cells),
        "file_bytes": {name: len(content) for name, content in sorted(made.files.items())},
        "guarantee": tree.guarantee.text,
        "changed_by_rounding": made.changed,
        "renamed": dict(made.renamed),
        "notes": list(made.notes),
    }
    if target == "c":
        (header,) = (name for name in made.files if name.endswith(".h"))
        figures["measured"] = sizes(made.files, header.removesuffix(".h"))
    return figures
