"""Trees of many sizes, fitted to states as often as loops visit them.

A tree grows where most of its samples are wrong: such a leaf is split by the plane that makes most
of them right, found by logistic regression or along an axis, and all splits are fitted again given
the rest of the tree. Then it is pruned link by link, see `capsyn.compression.fitted.plane_tree`:
a tree that was once larger is better than one that never was.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from capsyn.compression.fitted.plane_tree import (
    Link,
    Node,
    best_shift,
    prune,
    refine,
    separating_plane,
)
from capsyn.compression.fitted.surface import Plane, Samples, distances

GROWN_ON, PRUNED_ON = 20_000, 40_000
"""Samples that a growing tree is fitted to, and one that is pruned."""
SPLIT_ON = 4_000
"""Most samples of a leaf that its split is looked for with."""
FASTER = 1.25
"""Times its leaves that a tree has after all of them are fitted again, at most."""
SMALLER = 0.88
"""Share of its nodes that a tree keeps between two fits."""
RIVALS = 4
"""Labels that a split of a leaf may be for, beside its own."""
LEAST = 5
"""Fewer wrong samples leave a leaf as it is."""


def growing(root: Node, samples: Samples, most: int) -> Iterator[Node]:
    """Yield a tree as it grows in place, from `root` to so many nodes, or until it gains nothing.

    All samples (B, n) count the same: a state that loops visit often is there often.
    """
    few = samples.first(GROWN_ON)
    refine(root, few)
    while True:
        yield root
        before = root.node_count
        if before >= most or not _grow(root, few):
            return
        refine(root, few)
        if root.node_count <= before:
            return


def pruning(root: Node, samples: Samples) -> Iterator[Node]:
    """Yield a tree as it is pruned in place, down to a leaf."""
    many = samples.first(PRUNED_ON)
    links = refine(root, many)
    while root.children:
        yield root
        _shrink(root, links, max(1, int(SMALLER * root.node_count)))
        links = refine(root, many)
    yield root


def _shrink(root: Node, links: list[Link], most: int) -> None:
    """Put substitutes in place, the cheapest first, until a tree has at most so many nodes."""
    for link in links:
        prune([link], 0.0)
        if root.node_count <= most:
            return


def _grow(root: Node, samples: Samples) -> bool:
    """Split the leaves where most can be made right; return whether there were any."""
    leaves = [(leaf, rows) for leaf, rows in _leaves(root, samples.states) if len(rows)]
    wrong = [int(np.count_nonzero(~samples.right[rows, leaf.label])) for leaf, rows in leaves]
    room = max(1, math.ceil((FASTER - 1) * len(leaves)))
    found: list[tuple[int, int, Plane, list[int]]] = []
    for k in np.argsort(wrong, kind="stable")[::-1][: 2 * room]:
        leaf, rows = leaves[k]
        if wrong[k] >= LEAST:
            split = best_split(samples.states[rows], samples.right[rows], leaf.label)
            if split is not None:
                found.append((split[0], int(k), *split[1:]))
    found.sort(key=lambda split: (-split[0], split[1]))
    for _, k, plane, labels in found[:room]:
        leaf = leaves[k][0]
        leaf.plane, leaf.children, leaf.settled = plane, [Node(label) for label in labels], ()
    return bool(found)


def _leaves(root: Node, states: np.ndarray) -> Iterator[tuple[Node, np.ndarray]]:
    """Yield the leaves of a tree, each with the rows of states (B, n) in it."""
    stack = [(root, np.arange(len(states)))]
    while stack:
        node, rows = stack.pop()
        if not node.children:
            yield node, rows
            continue
        beyond = node.beyond(states[rows])
        stack += [(node.children[0], rows[~beyond]), (node.children[1], rows[beyond])]


def best_split(
    states: np.ndarray, right: np.ndarray, label: int
) -> tuple[int, Plane, list[int]] | None:
    """Return how many states (B, n) a split of a leaf makes right, its plane, and two labels.

    `right` (B, L) says which labels are right, `label` is that of the leaf. None where no plane
    that was tried makes any right.
    """
    own, exact = right[:, label], right.astype(np.float32)  # counts below 2^24 are exact
    total = exact.sum(axis=0)
    rivals = total - own.astype(np.float32) @ exact
    best: tuple[int, Plane, list[int]] | None = None
    for rival in np.argsort(-rivals, kind="stable")[:RIVALS]:
        if rivals[rival] < LEAST:
            break
        matters = np.flatnonzero(own != right[:, rival])[:SPLIT_ON]
        for plane in _planes(states[matters], right[matters, rival]):
            beyond = distances(states, plane) >= 0
            second = beyond.astype(np.float32) @ exact
            counts = total - second, second
            gained = int(sum(count.max() for count in counts)) - int(own.sum())
            if not beyond.all() and beyond.any() and gained > (best[0] if best else 0):
                best = gained, plane, [int(count.argmax()) for count in counts]
    return best


def _planes(states: np.ndarray, second: np.ndarray) -> Iterator[Plane]:
    """Yield planes that may part states (B, n) of a `second` class (B,) from the others.

    Each is moved along its normal to where it parts best.
    """
    if second.all() or not second.any():
        return
    one, other = states[~second].mean(axis=0), states[second].mean(axis=0)
    apart, middle = other - one, (one + other) / 2
    scaled = apart / (states.var(axis=0) + 1e-12)
    normals = [direction / size for direction in (apart, scaled)
               if (size := math.sqrt((direction**2).sum())) > 0]  # fmt: skip
    planes = [(normal, float((normal * middle).sum())) for normal in normals]
    planes += [separating_plane(states, second, plane) for plane in planes[-1:]]
    for axis in np.vstack([np.eye(states.shape[1]), -np.eye(states.shape[1])]):
        planes.append((axis, float(np.median((states * axis).sum(axis=1)))))
    for normal, offset in planes:
        shift, _ = best_shift(distances(states, (normal, offset)), second)
        yield normal, offset + shift
