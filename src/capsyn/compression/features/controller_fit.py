"""Small trees with features that agree with a controller on most of the domain.

Trees are grown by pairs of nearby states, coarse ones first, then fitted again and pruned link by
link as oblique trees are. Trees are fitted to one set of random states, chosen by a second one, and
judged on a third.
"""

from __future__ import annotations

import math

import numpy as np

from capsyn.cells.masks import Label, empty
from capsyn.cells.split_tree import SplitTree
from capsyn.compression.features.growing import Pairs, across, best_split
from capsyn.compression.features.space import Space
from capsyn.compression.fitted.oblique import Fit, to_lattice
from capsyn.compression.fitted.plane_tree import MAX_DEPTH, Node, best_label, prune, refine
from capsyn.compression.fitted.surface import Samples, draw_samples
from capsyn.policies.guarantee import CONFIDENCE
from capsyn.random_streams import stream
from capsyn.statistics import clopper_pearson

LENGTHS = (0.06, 0.03, 0.015, 0.0075)
"""Distances between the states of a pair [widths of the domain]: each grows a finer tree, until one
that meets the target is no smaller than those before."""
CUT_PENALTY = 0.1
"""What a like pair that is parted counts against an unlike one."""
LEAST_UNLIKE = 0.002
"""Share of the unlike pairs at which a region stays a leaf."""
SAMPLES, PAIRS, MOST_PAIRS = 100_000, 100_000, 20_000
"""States of a fit, pairs of a length, and the pairs that one split is chosen by."""
MARGIN = 3.5
"""Standard deviations, of judged states, by which a tree must exceed the target to be chosen."""
AT_ONCE = 0.25
"""Share of the surplus that is spent between two fits."""
JUDGEMENTS = 3
"""Trees judged, on fresh states each, before the search counts as failed."""


def fit_controller(
    masks: Label, space: Space, labels: int, agreement: float, seed: int, states: int
) -> Fit:
    """Return a small tree with features that is right on a wanted share of the volume.

    The arguments are those of `capsyn.compression.fitted.oblique.fit_tree`. A tree that needs no
    feature has none.
    """
    domain = space.domain

    def cube_masks(cube: np.ndarray) -> np.ndarray:
        return masks(domain.lower + cube * domain.widths).astype(np.uint64)

    def draw(count: int, *purpose: int) -> Samples:
        return draw_samples(cube_masks, space.n, labels, count, [seed, 10, *purpose])

    plain = draw(SAMPLES, 0)
    fitted, chosen = _with_features(plain, space), _with_features(draw(SAMPLES, 1), space)
    bar = agreement + MARGIN * math.sqrt(agreement * (1 - agreement) / min(states, SAMPLES))
    found: list[tuple[int, float, Node]] = []
    least = math.inf
    for turn, length in enumerate(LENGTHS):
        pairs = _pairs(cube_masks, plain.states[:PAIRS], length, space, [seed, 11, turn])
        found += _pruned(_grown(pairs, fitted, [seed, 12, turn]), fitted, chosen, bar)
        before, least = least, min((x[0] for x in found if x[1] >= bar), default=math.inf)
        if before == least < math.inf:
            break
    passing = sorted((x for x in found if x[1] >= bar), key=lambda x: (x[0], -x[1]))
    best = max(found, key=lambda x: x[1])
    judged: list[Fit] = []
    for look, (_, _, root) in enumerate([*passing[: JUDGEMENTS - 1], best]):
        tree = space.tree(root, moved=True) or to_lattice(_bare(root, space.n), space.counts)
        judged.append(_judged(tree, draw(states, 2, look), space))
        if clopper_pearson(judged[-1].right, states, CONFIDENCE)[0] >= agreement:
            return judged[-1]
    return max(judged, key=lambda fit: fit.right)


def _judged(tree: SplitTree, samples: Samples, space: Space) -> Fit:
    right = samples.count_right(tree.labels(space.locate(samples.states)))
    return Fit(tree, len(samples), right)


def _with_features(samples: Samples, space: Space) -> Samples:
    """Return samples with the coordinates of their lattice steps."""
    steps = space.locate(samples.states)
    return Samples(space.coordinates(steps), samples.right, space.n)


def _pairs(masks: Label, start: np.ndarray, length: float, space: Space, seed: list[int]) -> Pairs:
    """Return pairs of states of the cube, some distance apart in random directions."""
    direction = stream(*seed).standard_normal(start.shape)
    end = start + direction * (length / np.sqrt((direction**2).sum(axis=1)))[:, None]
    inside = ((end >= 0) & (end < 1)).all(axis=1)
    start, end = start[inside], end[inside]
    unlike = empty(masks(start) & masks(end))
    one, other = (space.coordinates(space.locate(x)) for x in (start, end))
    return Pairs(one, other, unlike)


def _grown(pairs: Pairs, samples: Samples, seed: list[int]) -> Node:
    """Return a tree that parts most unlike pairs."""
    rng, count = stream(*seed), samples.states.shape[1]
    least = max(LEAST_UNLIKE * np.count_nonzero(pairs.unlike), 4)
    root = Node(best_label(samples.right))
    stack = [(root, pairs, np.arange(len(samples)), 0)]
    while stack:
        node, here, rows, depth = stack.pop()
        done = np.count_nonzero(here.unlike) < least or depth == MAX_DEPTH
        if done or samples.right[rows, node.label].all():
            continue
        some = here
        if len(here) > MOST_PAIRS:
            some = here.part(rng.choice(len(here), MOST_PAIRS, replace=False))
        split = best_split(some, CUT_PENALTY)
        if split is None:
            continue
        beyond = samples.states[rows, split[0]] >= split[1]
        if beyond.all() or not beyond.any():
            continue
        node.plane = across(*split, count)
        for beside, part in zip(here.beside(*split), (rows[~beyond], rows[beyond])):
            child = Node(best_label(samples.right[part]))
            node.children.append(child)
            stack.append((child, beside, part, depth + 1))
    return root


def _pruned(
    root: Node, fitted: Samples, chosen: Samples, bar: float
) -> list[tuple[int, float, Node]]:
    """Return the trees that a tree is pruned to: nodes, share of right states, and root."""
    found = []
    while True:
        refine(root, fitted)
        links = refine(root, fitted)
        share = chosen.count_right(root.labels(chosen.states)) / len(chosen)
        found.append((root.node_count, share, root.copy()))
        if not root.children or (share < bar and len(found) > 1 and not links):
            return found
        surplus = share - bar if share >= bar else 1 - share
        prune(links, AT_ONCE * len(fitted) * surplus)


def _bare(root: Node, n: int) -> Node:
    """Return a tree without features over the states alone."""
    bare = root.copy()
    stack = [bare]
    while stack:
        node = stack.pop()
        if node.plane is not None:
            node.plane = node.plane[0][:n], node.plane[1]
        stack += node.children
    return bare
