"""Sets of states of the checker, many at once, and what it reads of a policy's tree.

A set is the hull of points, in any order, of two states, or a box of other numbers of states: the
points are its lower and its upper end. Around it is an error, a box. Points are (B, K, n).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.modelling.domain import Box

SLACK = 2.0**-46
"""What rounding moves points by, of their largest coordinate."""


def around(points: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends (B, n) of the boxes around sets."""
    return points.min(axis=1) - error, points.max(axis=1) + error


def corners(low: np.ndarray, high: np.ndarray, count: int) -> np.ndarray:
    """Return `count` points of boxes (B, n): the two ends, or four corners of two states."""
    if low.shape[1] != 2:
        return np.stack([low, high], axis=1)
    four = [low, np.stack([high[:, 0], low[:, 1]], 1), high, np.stack([low[:, 0], high[:, 1]], 1)]
    return np.stack(four + [low] * (count - 4), axis=1)


def clip(points: np.ndarray, a: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points (B, K', n) of what has ``a . x <= limit``, and in which (B,) there is any."""
    if points.shape[2] != 2:
        low, high = points[:, 0], points[:, 1]
        spare = limit - (np.where(a > 0, low, high) * a).sum(axis=1)
        room = np.divide(spare[:, None], a, out=np.full_like(a, np.inf), where=a != 0)
        low, high = (
            np.where(a < 0, np.maximum(low, high + room), low),
            np.where(a > 0, np.minimum(high, low + room), high),
        )
        return np.stack([low, high], axis=1), spare >= 0
    value = (points * a[:, None]).sum(axis=2) - limit[:, None]
    gone = value > 0
    some, alive = gone.any(axis=1), ~gone.all(axis=1)
    rows = np.flatnonzero(some & alive)
    if not len(rows):
        return points, alive
    p, v, gone = points[rows], value[rows], gone[rows]
    along = p[:, :, 1] * a[rows, :1] - p[:, :, 0] * a[rows, 1:]
    with np.errstate(all="ignore"):  # of other pairs than one that stays and one that goes
        t = v[:, :, None] / (v[:, :, None] - np.where(gone, v, 1.0)[:, None])
        cross = along[:, :, None] + t * (along[:, None] - along[:, :, None])
    pairs = ~gone[:, :, None] & gone[:, None]
    least, most = (np.where(pairs, cross, end).reshape(len(rows), -1) for end in (np.inf, -np.inf))
    ends, every = [], np.arange(len(rows))
    for best in (least.argmin(axis=1), most.argmax(axis=1)):
        i, j = np.divmod(best, p.shape[1])
        ends.append(p[every, i] + t[every, i, j, None] * (p[every, j] - p[every, i]))
    longer = np.concatenate([points, points[:, :1]], axis=1)
    longer[rows] = np.concatenate(
        [np.where(gone[:, :, None], ends[0][:, None], p), ends[1][:, None]], axis=1
    )
    return longer, alive


def within(a: np.ndarray, a_error: np.ndarray, b: np.ndarray, b_error: np.ndarray) -> np.ndarray:
    """Return which (B,) sets `a` lie in sets `b`, by more than rounding.

    Points may be as far from those of `b`, one by one, as the errors leave room, or each in one of
    the triangles of the first point of `b` and two in succession, or that far from it.
    """
    size = np.maximum(np.abs(a).max(axis=1), np.abs(b).max(axis=1))
    room = b_error - a_error - SLACK * size
    if a.shape[2] != 2:
        return ((a[:, 0] - b[:, 0] >= -room) & (b[:, 1] - a[:, 1] >= -room)).all(axis=1)
    found = np.zeros(len(a), bool)
    if a.shape == b.shape:
        found = (np.abs(a - b) <= room[:, None]).all(axis=(1, 2))
    rows = np.flatnonzero(~found & (room >= 0).all(axis=1))
    if not len(rows):
        return found
    a, b, room = a[rows], b[rows], room[rows]
    inside = np.zeros(a.shape[:2], bool)
    for k in range(1, b.shape[1] - 1):
        corners = b[:, [0, k, k + 1]]
        low, high = around(corners, room)
        here = ((a >= low[:, None]) & (a <= high[:, None])).all(axis=2)
        for i in range(3):
            p, q, r = corners[:, i], corners[:, (i + 1) % 3], corners[:, (i + 2) % 3]
            normal = np.stack([q[:, 1] - p[:, 1], p[:, 0] - q[:, 0]], axis=1)
            third = (normal * (r - p)).sum(axis=1)[:, None]
            more = (np.abs(normal) * room).sum(axis=1)[:, None]
            value = ((a - p[:, None]) * normal[:, None]).sum(axis=2)
            here &= (value >= np.minimum(third, 0) - more) & (value <= np.maximum(third, 0) + more)
        inside |= here
    found[rows] = inside.all(axis=1)
    return found


@dataclass(frozen=True, eq=False)
class Tree:
    """A policy's tree as half-spaces of states.

    A first child has states with ``normal . x < below``, a second one with ``> above``.
    """

    space: Box
    row: np.ndarray  # (K,): of a leaf, else -1
    second: np.ndarray  # (K,): second children
    parent: np.ndarray  # (K,): -1 of the root
    normal: np.ndarray  # (K, n)
    below: np.ndarray  # (K,)
    above: np.ndarray  # (K,)

    @staticmethod
    def of(tree: SplitTree, space: Box) -> Tree:
        """Return what a tree says of the states of a box."""
        leaf, every = tree.split == LEAF, np.arange(tree.node_count)
        parent = np.full(tree.node_count, -1)
        parent[every[~leaf] + 1] = parent[tree.second[~leaf]] = every[~leaf]
        normal = np.zeros((tree.node_count, tree.n))
        below, above = np.zeros((2, tree.node_count))
        for axis, count in enumerate(tree.counts):
            of = tree.split == axis
            face = space.lower[axis] + space.widths[axis] * (tree.threshold[of] / count)
            normal[of, axis], below[of], above[of] = 1.0, face, face
        for node in np.flatnonzero(tree.split >= tree.n):
            p = tree.planes[tree.split[node] - tree.n].astype(float)
            a = p * tree.counts / space.widths  # steps are up to 1 less than a . (x - lower)
            at = a @ space.lower + tree.threshold[node]
            far = np.abs(a) @ (np.abs(space.lower) + np.abs(space.upper)) + abs(at)
            normal[node] = a
            below[node] = at - 1 + p.clip(0).sum() + 2.0**-44 * far
            above[node] = at + p.clip(None, 0).sum() - 2.0**-44 * far
        row = np.where(leaf, tree.threshold, -1)
        return Tree(space, row, tree.second, parent, normal, below, above)

    def under(
        self, low: np.ndarray, high: np.ndarray, wraps: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the leaves that closed boxes (B, n) may be over: box and leaf of each.

        With them by how much of a periodic state the tree is moved there, (P, n).
        """
        periods = np.tile(self.space.periods, (len(low), 1))
        if wraps is not None:
            periods[~wraps] = 0.0
        size = np.where(periods > 0, periods, 1.0)
        first, last = (
            np.where(periods > 0, np.floor((x - self.space.lower) / size), 0) for x in (low, high)
        )
        last -= high < self.space.upper + (last - 1) * size  # where the quotient is rounded up
        box, moved = np.arange(len(low)), first * size
        for axis in np.flatnonzero(self.space.periodic):
            count = (last - first)[box, axis].astype(int) + 1
            of = np.repeat(np.arange(len(box)), count)
            turn = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
            box, moved = box[of], moved[of]
            moved[:, axis] += turn * size[box, axis]
        moved = moved * (periods[box] > 0)
        node = np.zeros(len(box), dtype=int)
        done: list[tuple[np.ndarray, ...]] = []
        while len(box) or not done:
            leaf = self.row[node] >= 0
            done.append((box[leaf], node[leaf], moved[leaf]))
            box, node, moved = box[~leaf], node[~leaf], moved[~leaf]
            a = self.normal[node]
            up, down, at = np.maximum(a, 0), np.minimum(a, 0), (a * moved).sum(axis=1)
            one = (up * low[box] + down * high[box]).sum(axis=1) - at < self.below[node]
            two = (up * high[box] + down * low[box]).sum(axis=1) - at >= self.above[node]
            node = np.concatenate([node[one] + 1, self.second[node[two]]])
            box, moved = (np.concatenate([x[one], x[two]]) for x in (box, moved))
        box, node, moved = (np.concatenate(x) for x in zip(*done))
        return box, node, moved

    def met(
        self, low: np.ndarray, high: np.ndarray, leaf: np.ndarray, moved: np.ndarray
    ) -> np.ndarray:
        """Return which (P,) leaves that boxes (P, n) may be over have something of them."""
        return self.cut(corners(low, high, 4), np.zeros_like(low), leaf, moved)[1]

    def cut(
        self, points: np.ndarray, reach: np.ndarray, leaf: np.ndarray, moved: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return points of parts of sets within reach (B, n) of leaves (B,); which there are."""
        alive = np.ones(len(points), bool)
        for axis in np.flatnonzero(self.space.periodic):
            for sign, face in ((1.0, self.space.upper[axis]), (-1.0, -self.space.lower[axis])):
                a = np.zeros_like(reach)
                a[:, axis] = sign
                points, some = clip(points, a, face + sign * moved[:, axis] + reach[:, axis])
                alive &= some
        for _ in range(1 if points.shape[2] == 2 else 2):  # boxes: each face with all others
            node = leaf
            while (self.parent[node] >= 0).any():
                parent = self.parent[node]
                root = parent < 0
                first = node == parent + 1
                a = np.where(first[:, None], 1.0, -1.0) * self.normal[parent]
                limit = np.where(first, self.below[parent], -self.above[parent]) + (a * moved).sum(
                    axis=1
                )
                limit += (np.abs(a) * reach).sum(axis=1)
                a[root], limit[root] = 0.0, 1.0
                points, some = clip(points, a, limit)
                alive &= some
                node = np.where(root, node, parent)
        return points, alive
