"""What labels cost where a policy leaves a choice: its mixed cells."""

from __future__ import annotations

import numpy as np

from capsyn.cells.masks import Label, members, or_else, singles
from capsyn.cells.row_table import row_sets
from capsyn.compression.induction import Prices
from capsyn.policies.policy import Policy, cell_tree
from capsyn.random_streams import stream

VOTING = 5
"""Purpose of the random states at which votes are cast."""
VOTES = 16
"""Random states of each mixed cell at which the controller is asked."""


def exact_prices(policy: Policy) -> Prices:
    """Return prices under which every cell keeps its own label."""
    none = np.zeros((0, len(policy.transitions)), dtype=np.int64)
    return Prices(allowed_masks(policy, False), cell_tree(policy).mixed_cells[:0], none, 1)


def free_prices(policy: Policy, votes: np.ndarray, node_price: float) -> Prices:
    """Return prices under which mixed cells may take any label that was seen in them.

    `votes` (K, N + 1) are those of `cell_votes`, `node_price` the finest cells of disagreement that
    saving one node of the tree is worth.
    """
    leaf_price = max(1, round(2 * VOTES * node_price))  # a leaf more is two nodes more
    return Prices(
        allowed_masks(policy, True), cell_tree(policy).mixed_cells, VOTES - votes, leaf_price
    )


def cell_votes(policy: Policy, controller: Label | None, seed: int) -> np.ndarray:
    """Return how many of `VOTES` votes each label (K, N + 1) has in each mixed cell.

    The controller gives masks (B, W) of the symbols that could be best; it is asked at random
    states of the cells. Without it the policy's own label has all votes; of a table, each label
    that it allows.
    """
    cells, labels = cell_tree(policy), len(policy.alphabet) + 1
    mixed = cells.mixed_cells
    votes = np.zeros((len(mixed), labels), dtype=np.int64)
    if controller is None and "table" in policy.statistics:
        votes[members(cells.mixed_labels[:, 0], labels)] = VOTES
        return votes
    if controller is None:
        votes[np.arange(len(mixed)), -1 - cells.entries[mixed]] = VOTES
        return votes
    boxes = cells.boxes()
    place = np.empty(len(cells.entries), dtype=np.int64)
    place[boxes.places] = np.arange(len(boxes))
    lower = policy.domain.points(boxes.lower[place[mixed]], cells.counts)
    upper = policy.domain.points(boxes.upper[place[mixed]], cells.counts)
    random = stream(seed, VOTING)
    for _ in range(VOTES):
        masks = controller(lower + random.random(lower.shape) * (upper - lower))
        votes += members(or_else(masks, labels - 1), labels)  # no finite answer: the default
    return votes


def allowed_masks(policy: Policy, freedom: bool) -> np.ndarray:
    """Return the rows (M, W) that each entry of the cells may take, as bit masks; 0 for blocks.

    With `freedom`, mixed cells may take any row whose labels were seen in them.
    """
    cells = cell_tree(policy)
    masks = singles(np.maximum(-1 - cells.entries, 0), len(policy.transitions))
    masks[cells.entries >= 0] = 0
    if freedom:
        masks[cells.mixed_cells] |= row_sets(cells.mixed_labels, policy.transitions)
    return masks
