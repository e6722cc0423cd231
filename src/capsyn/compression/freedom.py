"""What rows cost where a policy leaves a choice: its mixed cells.

A leaf stands for a row, the label that follows each symbol in force; without memory for a label.
"""

from __future__ import annotations

import numpy as np

from capsyn.cells.masks import Label, holds, members, or_else, singles
from capsyn.cells.row_table import ROOM, row_sets
from capsyn.compression.induction import Prices
from capsyn.policies.policy import Policy, cell_tree
from capsyn.random_streams import stream

VOTING = 5
"""Purpose of the random states at which votes are cast."""
VOTES = 16
"""Random states of each mixed cell at which the controller is asked."""


def exact_prices(policy: Policy) -> Prices:
    """Return prices under which every cell keeps its own row."""
    none = np.zeros((0, len(policy.transitions)), dtype=np.uint8)
    return Prices(allowed_masks(policy, False), cell_tree(policy).mixed_cells[:0], none, 1)


def free_prices(policy: Policy, votes: np.ndarray, node_price: float) -> Prices:
    """Return prices under which mixed cells may take any row whose labels were seen in them.

    `votes` (K, R) are those of `cell_votes`, `node_price` the finest cells of disagreement that
    saving one node of the tree is worth.
    """
    leaf_price = max(1, round(2 * VOTES * node_price))  # a leaf more is two nodes more
    return Prices(
        allowed_masks(policy, True), cell_tree(policy).mixed_cells, VOTES - votes, leaf_price
    )


def cell_votes(policy: Policy, controller: Label | None, seed: int) -> np.ndarray:
    """Return how many of `VOTES` votes each row (K, R) uint8 has in each mixed cell.

    The controller gives masks (B, W) of the symbols that could be best, or (B, J, W) for each
    symbol in force; it is asked at random states of the cells, and votes for the rows whose labels
    could be best for all. Without it the policy's own row has all votes; of a table, each row that
    it allows.
    """
    cells, rows = cell_tree(policy), policy.transitions
    mixed, default = cells.mixed_cells, len(policy.alphabet)
    votes = np.zeros((len(mixed), len(rows)), dtype=np.uint8)
    if controller is None and "table" in policy.statistics:
        votes[members(row_sets(cells.mixed_labels, rows), len(rows))] = VOTES
        return votes
    if controller is None:
        votes[np.arange(len(mixed)), -1 - cells.entries[mixed]] = VOTES
        return votes
    boxes = cells.boxes()
    place = np.empty(len(cells.entries), dtype=np.int64)
    place[boxes.places] = np.arange(len(boxes))
    lower = policy.space.points(boxes.lower[place[mixed]], cells.counts)
    upper = policy.space.points(boxes.upper[place[mixed]], cells.counts)
    random, size = stream(seed, VOTING), max(1, ROOM // (8 * max(default**2, len(rows))))
    for _ in range(VOTES):
        states = lower + random.random(lower.shape) * (upper - lower)
        for start in range(0, len(mixed), size):
            some = slice(start, start + size)
            sets = or_else(controller(states[some]), default)  # no finite answer: the default
            sets = sets.reshape(len(sets), -1, sets.shape[-1])
            votes[some] += members(row_sets(sets, rows), len(rows))
    return votes


def allowed_masks(policy: Policy, freedom: bool) -> np.ndarray:
    """Return the rows (M, W) that each entry of the cells may take, as bit masks; 0 for blocks.

    With `freedom`, mixed cells may take any row of the policy whose labels were all seen in them,
    each for its symbol in force.
    """
    cells = cell_tree(policy)
    masks = singles(np.maximum(-1 - cells.entries, 0), len(policy.transitions))
    masks[cells.entries >= 0] = 0
    if freedom:
        masks[cells.mixed_cells] |= row_sets(cells.mixed_labels, policy.transitions)
    return masks


def allows(masks: np.ndarray, entries: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return whether the masks (M, W) of entries (B,) hold rows (B,)."""
    found = np.empty(len(entries), dtype=bool)
    size = max(1, ROOM // masks.itemsize // masks.shape[1])
    for start in range(0, len(entries), size):
        some = slice(start, start + size)
        found[some] = holds(masks[entries[some]], rows[some])
    return found
