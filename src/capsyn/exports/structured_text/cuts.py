"""What a split means to a reader: a face or a plane in states, with their units."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from capsyn.cells.split_tree import LEAF
from capsyn.exports.plan import Plan
from capsyn.exports.structured_text.block import Block
from capsyn.exports.text import signed_sum


def cut(plan: Plan, node: int) -> str:
    """Return the condition of an inner node in states; of an oblique split about so.

    A step z of an axis with C steps is about ``C (x - lower) / (upper - lower) - 1/2``, and sums of
    steps reach the threshold about half of their common divisor before it. The state that matters
    most over its axis gets the factor 1, and the bound has its unit.
    """
    tree, domain = plan.tree.cells, plan.policy.space
    split, threshold = int(tree.split[node]), int(tree.threshold[node])
    if split < tree.n:
        place = float(domain.faces(split, np.array([threshold]), tree.counts[split])[0])
        return f"{domain.names[split]} >= {_measured(repr(place), domain.units[split])}"
    plane, counts = tree.planes[split - tree.n].astype(np.int64), np.asarray(tree.counts)
    per_state = plane * counts / domain.widths
    beside = float(plane @ (0.5 + counts * domain.lower / domain.widths))
    bound = threshold - np.gcd.reduce(plane) / 2 + beside
    lead = int(np.argmax(np.abs(plane * counts)))
    factors, bound = per_state / per_state[lead], bound / per_state[lead]
    compared = ">=" if per_state[lead] > 0 else "<="
    products = (
        name if f"{abs(factor):.4g}" == "1" else f"{abs(factor):.4g} * {name}"
        for name, factor in zip(domain.names, factors)
    )
    text = signed_sum(np.sign(factors).astype(int).tolist(), products)
    return f"about {text} {compared} {_measured(f'{bound:.4g}', domain.units[lead])}"


def listed(block: Block) -> Iterator[str]:
    """Yield what the splits and thresholds in tables mean."""
    tree = block.nodes
    inner = np.flatnonzero(tree.split != LEAF)
    pairs = np.column_stack([tree.split[inner], tree.threshold[inner]])
    different, at = np.unique(pairs, axis=0, return_index=True)
    for (split, threshold), k in zip(different.tolist(), at):
        yield f"Split {split} from {threshold} on: {cut(block.plan, int(inner[k]))}"


def _measured(number: str, unit: str) -> str:
    return f"{number} {unit}".rstrip()
