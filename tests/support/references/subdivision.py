"""Algorithm 1 as its text says it: one cell and one point after the other, on exact fractions."""

import itertools
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

HALF, QUARTER = Fraction(1, 2), Fraction(1, 4)


@dataclass
class Reference:
    """A subdivision of the unit cube; `mask_of` gives the mask (int) of a tuple of fractions."""

    mask_of: object
    partitions: tuple
    refinement: tuple
    max_level: int
    periodic: tuple
    test_points: str
    order: list
    masks: dict = field(default_factory=dict)  # every distinct point that was asked for
    leaves: dict = field(default_factory=dict)  # (level, indices of the cell): label
    mixed: dict = field(default_factory=dict)  # (level, indices of the cell): set of labels seen

    def run(self):
        for cell in itertools.product(*map(range, self.partitions)):
            self.visit(0, cell)
        return self

    def visit(self, level, cell):
        edges = [Fraction(1, q * r**level) for q, r in zip(self.partitions, self.refinement)]
        corner = [i * edge for i, edge in zip(cell, edges)]
        places = list(self.places(len(cell)))
        masks = [self.mask(corner, edges, place) for place in places]
        common = intersection(masks)
        if level < self.max_level and common:
            for place, mask in zip(places, masks):
                if len(symbols(mask)) > 1:  # tied: look again, a quarter of the way to the centre
                    moved = [p + QUARTER * (HALF - p) for p in place]
                    common &= self.mask(corner, edges, moved)
        if common:
            self.leaves[level, cell] = self.preferred(symbols(common))
        elif level < self.max_level:
            for child in itertools.product(*map(range, self.refinement)):
                self.visit(
                    level + 1, tuple(i * r + j for i, r, j in zip(cell, self.refinement, child))
                )
        else:
            self.leaves[level, cell], self.mixed[level, cell] = self.mode(masks)

    def places(self, n):
        for place in itertools.product((Fraction(0), HALF, Fraction(1)), repeat=n):
            halves = place.count(HALF)
            if (
                halves == 0
                or (halves == n and "center" in self.test_points)
                or (halves == 1 and "edge_midpoints" in self.test_points)
            ):
                yield place

    def mask(self, corner, edges, place):
        point = tuple(c + e * p for c, e, p in zip(corner, edges, place))
        point = tuple(x - (wraps and x == 1) for x, wraps in zip(point, self.periodic))
        if point not in self.masks:
            self.masks[point] = self.mask_of(point)
        return self.masks[point]

    def preferred(self, candidates):
        return min(candidates, key=self.order.index)

    def mode(self, masks):
        determined = [mask for mask in masks if len(symbols(mask)) == 1]
        seen = union(determined or masks)
        votes = {s: sum(s in symbols(mask) for mask in masks) for s in symbols(seen)}
        most = max(votes.values())
        return self.preferred([s for s in votes if votes[s] == most]), seen


def symbols(mask):
    return [s for s in range(mask.bit_length()) if mask >> s & 1]


def whole_mask(words):
    """Return a mask, or its words of 64 bits, as one whole number."""
    return sum(int(word) << 64 * k for k, word in enumerate(np.atleast_1d(words)))


def intersection(masks):
    result = masks[0]
    for mask in masks:
        result &= mask
    return result


def union(masks):
    result = 0
    for mask in masks:
        result |= mask
    return result


def state_of(point, box):
    """Return the state (1, n) of a point, rounded as `Box` says."""
    coordinates = [
        high if x == 1 else low + (high - low) * float(x)
        for x, low, high in zip(point, box.lower.tolist(), box.upper.tolist())
    ]
    return np.array([coordinates])


def reference(label_masks, box, q, r, max_level, test_points="vertices+center", order=range(64)):
    """Return the finished reference subdivision of a labelling function that gives masks."""

    def mask_of(point):
        return whole_mask(label_masks(state_of(point, box))[0])

    wraps = box.periodic
    return Reference(mask_of, q, r, max_level, wraps, test_points, list(order)).run()


def cells_of(policy):
    """Return the leaves and the mixed cells of a policy in the form of `Reference`."""
    tree = policy.cells
    seen = dict(zip(tree.mixed_cells.tolist(), map(whole_mask, tree.mixed_labels[:, 0])))
    leaves, mixed = {}, {}
    for part in tree.leaves():
        corners = part.lower // tree.sizes(part.level)
        assert (corners * tree.sizes(part.level) == part.lower).all()
        for entry, corner, label in zip(
            part.places.tolist(), corners.tolist(), tree.labels_at(part.places).tolist()
        ):
            cell = (part.level, tuple(corner))
            assert cell not in leaves
            leaves[cell] = label
            if entry in seen:
                mixed[cell] = seen.pop(entry)
    assert not seen  # every mixed cell is a leaf
    return leaves, mixed


def noise(states, seed):
    """Return pseudo-random 64-bit words (B,) that depend on every bit of the states (B, n)."""
    word = np.full(len(states), seed, dtype=np.uint64)
    for bits in np.ascontiguousarray(states.T).view(np.uint64):
        for value in (bits >> np.uint64(29), bits & np.uint64(2**29 - 1)):
            word = (word ^ value) * np.uint64(0x9E3779B97F4A7C15)
            word ^= word >> np.uint64(31)
    return word
