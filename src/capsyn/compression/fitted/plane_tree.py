"""Trees of oblique splits on the unit cube: growing, fitting again, pruning.

1. Top down, that plane comes first which explains most of the switching surface and cuts least
   elsewhere. Unlike an entropy this sees laws like XOR, whose planes gain nothing by volume.
2. Every split is fitted again, given the rest of the tree (tree alternating optimisation [1]_).
3. The subtrees that earn their nodes least go (weakest link pruning [2]_).

References
----------
.. [1] M. A. Carreira-Perpinan and P. Tavallali, Alternating optimization of decision trees, with
   application to learning sparse oblique trees, NeurIPS 2018.
.. [2] L. Breiman, J. Friedman, R. Olshen and C. Stone, Classification and regression trees, 1984,
   Section 3.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from capsyn.compression.fitted.surface import (
    Plane,
    Samples,
    Surface,
    at_labels,
    best_plane,
    distances,
)

MAX_DEPTH = 64
"""Most splits above a leaf of a grown tree."""
BANDS = (0.15, 0.04, 0.01)
"""Half widths of the bands around a split in which it is fitted again [widths of the domain]."""
BAND_STATES = 10_000
"""Most states of a band that it is fitted to."""
OBLIQUE_WORTH = 0.05
"""Share of its errors that a split along an axis must lose to become oblique."""
SHARPNESS = 30.0
"""Slope of the logistic function that a separation starts from [1 / width of the domain]."""
ITERATIONS, HALVINGS, CONVERGED = 15, 8, 1e-3
"""Most Newton steps of a separation, most halvings of a step, and the relative gain at its end."""
RIDGE = 1e-6
"""Penalty on the squared slope of a logistic function, which keeps it finite."""


@dataclass
class Node:
    """A node of a growing tree: a leaf with a label, or a split with two children."""

    label: int
    plane: Plane | None = None
    children: list[Node] = field(default_factory=list)
    settled: tuple[int, ...] = ()

    @property
    def node_count(self) -> int:
        """Inner nodes and leaves."""
        return 1 + sum(child.node_count for child in self.children)

    def copy(self) -> Node:
        """Return a copy of the subtree."""
        return Node(self.label, self.plane, [child.copy() for child in self.children], self.settled)

    def become(self, other: Node) -> None:
        """Take the place of another node."""
        self.label, self.plane = other.label, other.plane
        self.children, self.settled = other.children, other.settled

    def beyond(self, states: np.ndarray) -> np.ndarray:
        """Return whether states (B, n) belong to the second child, (B,)."""
        assert self.plane is not None
        return distances(states, self.plane) >= 0

    def labels(self, states: np.ndarray) -> np.ndarray:
        """Return the labels (B,) of states (B, n)."""
        labels = np.empty(len(states), dtype=np.int64)
        stack = [(self, np.arange(len(states)))]
        while stack:
            node, rows = stack.pop()
            if not node.children:
                labels[rows] = node.label
                continue
            beyond = node.beyond(states.take(rows, axis=0))
            stack += [(node.children[0], rows[~beyond]), (node.children[1], rows[beyond])]
        return labels


class Link(NamedTuple):
    """A subtree and what could take its place."""

    price: float
    """Samples lost per node saved."""
    node: Node
    substitute: Node
    loss: float
    """Samples lost."""


def best_label(right: np.ndarray) -> int:
    """Return the label that is right at most samples; `right` is (B, L)."""
    return int(np.count_nonzero(right, axis=0).argmax())


def grow(
    surface: Surface,
    samples: Samples,
    tolerance: float,
    least_share: float,
    rng: np.random.Generator,
) -> Node:
    """Return a tree whose planes explain the surface to a tolerance [widths of the domain].

    The samples are states of the whole cube. Regions with less than `least_share` of the surface
    stay leaves. `rng` draws the planes that are tried.
    """
    least = max(least_share * len(surface.points), 4 * samples.states.shape[1])
    root = Node(best_label(samples.right))
    stack = [(root, surface, np.arange(len(samples)), 0)]
    while stack:
        node, here, rows, depth = stack.pop()
        done = len(here.points) < least or depth == MAX_DEPTH
        if done or samples.right[rows, node.label].all():
            continue
        states = samples.states.take(rows, axis=0)
        plane = best_plane(here, states, len(rows) / len(samples), tolerance, rng)
        beyond = distances(states, plane) >= 0
        if beyond.all() or not beyond.any():
            continue
        from_plane = distances(here.points, plane)
        node.plane = plane
        for side, unexplained in (
            (~beyond, from_plane <= -tolerance),
            (beyond, from_plane >= tolerance),
        ):
            child = Node(best_label(samples.right[rows[side]]))
            node.children.append(child)
            stack.append((child, here.part(unexplained), rows[side], depth + 1))
    return root


def refine(root: Node, samples: Samples) -> list[Link]:
    """Fit every split again, given the rest of the tree, in place; return what could go.

    Subtrees that gain nothing go at once. The links are a child or a leaf for each split that is
    left, the cheapest first.
    """
    links: list[Link] = []
    axes = samples.states.shape[1] if samples.axes is None else samples.axes

    def visit(node: Node, rows: np.ndarray) -> None:
        right = samples.right.take(rows, axis=0)
        label = best_label(right) if len(rows) else node.label
        if not node.children:
            node.label = label
            return
        states = samples.states.take(rows, axis=0)
        beyond = node.beyond(states)
        for child, part in zip(node.children, (rows[~beyond], rows[beyond])):
            visit(child, part)
        good = [at_labels(right, child.labels(states)) for child in node.children]
        matters = good[0] != good[1]
        hopeless = np.count_nonzero(~(good[0] | good[1]))
        wrong = hopeless + _fit_split(node, states[matters], good[1][matters], axes)
        substitutes = [Node(label), *node.children]
        errors = [len(rows) - np.count_nonzero(right[:, label])]
        errors += [len(rows) - np.count_nonzero(x) for x in good]
        count = node.node_count
        price, best = min(
            ((error - wrong) / (count - other.node_count), k)
            for k, (other, error) in enumerate(zip(substitutes, errors))
        )
        if price <= 0:
            node.become(substitutes[best])
        else:
            links.append(Link(price, node, substitutes[best], errors[best] - wrong))

    visit(root, np.arange(len(samples)))
    return sorted(links, key=lambda link: link.price)


def prune(links: list[Link], allowed: float) -> None:
    """Put the substitutes of the cheapest links in place: one, and more while losses are allowed.

    A link within a subtree that went before it changes nothing.
    """
    lost = 0.0
    for k, link in enumerate(links):
        lost += link.loss
        if k and lost > allowed:
            return
        link.node.become(link.substitute)


def _fit_split(node: Node, states: np.ndarray, second: np.ndarray, axes: int) -> int:
    """Fit a split to states that belong to its second child or not; return its errors.

    A plane may combine the first `axes` coordinates, or those after them.
    """
    n = states.shape[1]
    assert node.plane is not None
    distance = distances(states, node.plane)
    wrong = int(np.count_nonzero((distance >= 0) != second))
    task = len(states), int(np.count_nonzero(second))
    if not wrong or len(states) <= 4 * n or node.settled == (*task, wrong):
        return wrong
    along = np.count_nonzero(node.plane[0]) == 1
    if along:
        shift, saved = best_shift(distance, second)
        node.plane, wrong = (node.plane[0], node.plane[1] + shift), wrong - saved
    part = slice(axes, n) if node.plane[0][axes:].any() else slice(0, axes)
    if part.stop - part.start == 1:
        return wrong
    worth = OBLIQUE_WORTH * wrong if along else 0.0
    for band in BANDS:
        near = np.flatnonzero(np.abs(distances(states, node.plane)) < band)[:BAND_STATES]
        if len(near) <= 4 * n or second[near].all() or not second[near].any():
            continue
        start = node.plane[0][part], node.plane[1]
        normal, offset = separating_plane(states[near][:, part], second[near], start)
        plane = np.zeros(n), offset
        plane[0][part] = normal
        distance = distances(states, plane)
        near = np.abs(distance) < band
        shift, saved = best_shift(distance[near], second[near])
        errors = int(np.count_nonzero((distance >= 0) != second)) - saved
        if errors < wrong - worth:
            node.plane, wrong, worth = (plane[0], plane[1] + shift), errors, 0.0
    node.settled = (*task, wrong)
    return wrong


def separating_plane(states: np.ndarray, second: np.ndarray, start: Plane) -> Plane:
    """Return a plane that separates two classes, by logistic regression (Newton's method).

    `second` (B,) tells which states (B, n) belong beyond the plane. The iteration begins at
    `start`, which is returned where it finds nothing.
    """
    extended = np.column_stack([states, np.ones(len(states))])
    sign = np.where(second, 1.0, -1.0)

    def loss_at(weights: np.ndarray) -> tuple[float, np.ndarray]:
        exponent = np.einsum("bi,i->b", extended, weights)
        mean = np.logaddexp(0, -sign * exponent).mean()
        return float(mean + RIDGE * (weights**2).sum() / 2), exponent

    weights = SHARPNESS * np.append(start[0], -start[1])
    loss, exponent = loss_at(weights)
    for _ in range(ITERATIONS):
        p = 1 / (1 + np.exp(-np.clip(exponent, -30, 30)))
        gradient = np.einsum("bi,b->i", extended, p - second) / len(states) + RIDGE * weights
        curvature = extended * (p * (1 - p))[:, None]
        hessian = np.einsum("bi,bj->ij", curvature, extended) / len(states)
        step = np.linalg.solve(hessian + RIDGE * np.eye(len(weights)), gradient)
        for _ in range(HALVINGS):
            new_loss, exponent = loss_at(weights - step)
            if new_loss < loss:
                break
            step /= 2
        else:
            break
        ended = loss - new_loss < CONVERGED * new_loss
        weights, loss = weights - step, new_loss
        if ended:
            break
    size = math.sqrt((weights[:-1] ** 2).sum())
    if not (size > 0 and np.isfinite(weights).all()):
        return start
    return weights[:-1] / size, float(-weights[-1] / size)


def best_shift(distance: np.ndarray, second: np.ndarray) -> tuple[float, int]:
    """Return how far to move a plane along its normal for fewest errors, and the errors saved.

    `second` (B,) tells which states, at signed distances (B,) from the plane, belong beyond it.
    """
    if not len(distance):
        return 0.0, 0
    order = np.argsort(distance)  # states at one place in any order: they stay together
    x = distance[order]
    # errors with the first k states before the plane, less those with none
    errors = np.append(0, np.cumsum(np.where(second[order], 1, -1)))
    here = int(np.searchsorted(x, 0.0))
    apart = np.concatenate([[True], x[1:] > x[:-1], [True]])
    best = int(np.where(apart, errors, len(x) + 1).argmin())
    saved = int(errors[here] - errors[best])
    if not saved:
        return 0.0, 0
    after = x[best] if best < len(x) else np.nextafter(x[-1], np.inf)
    before = x[best - 1] if 0 < best < len(x) else after
    return float((before + after) / 2), saved
