"""Small trees with oblique splits that agree with a controller on most of the domain.

Trees are grown finer than the target needs, and pruned link by link with all splits fitted in
between, see `capsyn.compression.fitted.plane_tree`. The smallest that meets the target is rounded
to integers on a fine lattice. Trees are fitted to one set of random states, chosen by a second one,
and judged on a third.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from capsyn.cells.masks import Label
from capsyn.cells.split_tree import LEAF, SplitTree, depth_first
from capsyn.compression.fitted.plane_tree import Link, Node, grow, prune, refine
from capsyn.compression.fitted.surface import Plane, Samples, Surface, draw_samples, find_surface
from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.modelling.grid import MAX_COUNT
from capsyn.policies.guarantee import CONFIDENCE
from capsyn.random_streams import stream
from capsyn.statistics import clopper_pearson
from capsyn.validation import finite_number, whole_number

STEPS = 8192
"""Most lattice steps along an axis."""
MAX_COEFFICIENT = 2**15 - 1
"""Coefficients of planes fit 16 bits."""
MAX_SUM = 2**30
"""Largest size of their sums over the lattice."""
ATTEMPTS = 12
"""Most trees grown, each from other random planes."""
RESTARTS = 3
"""Trees that meet the target and are pruned."""
POLISHED = 3
"""Pruned trees that are fitted to more samples and pruned again."""
FINENESS, FINER = 2.5, 1.5
"""How much finer than a tree of the wanted agreement the first tree is grown, and a finer one."""
LEAST = 0.25
"""Share of the surface at which a region stays a leaf, by the share of wrong states allowed."""
FINEST = 1e-4
"""Least distance at which a plane explains a point of the surface [widths of the domain]."""
MAX_NODES = 600
"""A larger tree that still misses the target ends the search."""
BUDGET = 5e8
"""Work, as `_Search` counts it, after which no more trees are begun; by the aim."""
FIT_WORK = 60_000
"""Samples that take as much work to look up in a node as its fit takes at least."""
ERRORS, FEW = 150, 20_000
"""Wrong samples that make a fit precise enough, by the aim squared; least samples of a fit."""
POLISHED_ON = 4
"""Polishing takes so many times the samples."""
AT_ONCE = 0.25
"""Share of the surplus that is spent between two fits."""
PASSES, NEAR = 3, 0.25
"""Fits before a tree that just misses the target is given up, and how near that is."""
MARGIN = 3.5
"""Standard deviations, of judged states, by which a tree must exceed the target to be chosen."""
HOPE = 1.0
"""The same of trees that are judged after all where none exceeds it by that margin."""
OUT_OF_REACH = 3.0
"""Times the wrong states allowed that the best tree of a search has wrong, to end the searches."""
JUDGEMENTS = 3
"""Trees judged, on fresh states each, before a search counts as failed."""
AIMS = (1.0, 0.7, 0.4)
"""Shares of the wrong states allowed that searches aim at, each where those before failed."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A tree fitted to a controller, and how well."""

    tree: SplitTree
    judged: int  # fresh random states, which neither made nor chose the tree
    right: int  # how many of them the tree is right at


class Candidate(NamedTuple):
    """A tree and its share of right states among those that trees are chosen by."""

    root: Node
    nodes: int
    share: float


def fit_tree(
    masks: Label,
    domain: Box,
    labels: int,
    agreement: float,
    *,
    seed: int = 0,
    samples: int = 200_000,
    states: int = 100_000,
) -> Fit:
    """Return a small tree that is right on a wanted share, in (0, 1], of the domain's volume.

    It is the smallest tree found of which the lower end of the Clopper-Pearson interval of the
    judged states, with a confidence of `CONFIDENCE`, meets the target; where there is none, the
    best that was judged. `masks` gives the labels that are right at states [state units], none
    where a mask is 0. Trees are fitted to at most `samples` states, chosen by other ones, and
    judged on fresh `states`: the fewer, the more a tree must exceed the target to be chosen. The
    same seed gives the same tree. An argument that cannot be used is a `ProblemError`.
    """
    labels = whole_number("labels", labels, least=1)
    agreement = finite_number("agreement", agreement, above=0.0)
    if agreement > 1:
        raise ProblemError(f"`agreement` must be at most 1; got {agreement:g}")
    seed = whole_number("seed", seed, least=0)
    samples = whole_number("samples", samples, least=1000)
    states = whole_number("states", states, least=1)

    def cube_masks(cube: np.ndarray) -> np.ndarray:
        return masks(domain.lower + cube * domain.widths).astype(np.uint64)

    def draw(count: int, *stream: int) -> Samples:
        return draw_samples(cube_masks, domain.n, labels, count, [seed, *stream])

    search = _Search(domain, agreement, draw(samples, 0), draw(samples, 1), states)
    surface = find_surface(cube_masks, search.fitted, [seed, 2])
    judged: list[Fit] = []
    for turn, aim in enumerate(AIMS):
        share = search.run(surface, [seed, 3, turn], aim)
        last = aim == AIMS[-1] or 1 - share > OUT_OF_REACH * (1 - agreement)
        for tree in search.best(last):
            right = search.count_right(tree, draw(states, 4, len(judged)))
            judged.append(Fit(tree, states, right))
            if clopper_pearson(right, states, CONFIDENCE)[0] >= agreement:
                return judged[-1]
        if last:
            break
    return max(judged, key=lambda fit: fit.right)


class _Search:
    """The trees of one fit, and the samples that they are fitted to and chosen by."""

    def __init__(
        self, domain: Box, agreement: float, fitted: Samples, chosen: Samples, states: int
    ) -> None:
        spread = math.sqrt(agreement * (1 - agreement) / min(states, len(chosen)))
        self.bar = min(agreement + MARGIN * spread, 1.0)
        self._hopeful = min(agreement + HOPE * spread, 1.0)
        self._domain, self._agreement = domain, agreement
        self._counts = fine_lattice(domain)
        self.fitted, self._chosen = self._centred(fitted), self._centred(chosen)
        self._candidates: list[Candidate] = []
        self._grown: list[tuple[float, float]] = []
        self._told = 0.0
        self._work, self._budget = 0.0, BUDGET

    def run(self, surface: Surface, seed: list[int], aim: float) -> float:
        """Grow trees, finer ones until they meet the target, and prune those that do.

        Their fineness begins at what errs at the share `aim` of the wrong states allowed, or at
        that of the best tree grown so far. The harder the aim, the more samples they are fitted to.
        Returns the share of right states of the best tree so far.
        """
        self._work, self._budget = 0.0, BUDGET / aim
        wrong = aim * (1 - self._agreement)
        enough = ERRORS / max(aim * wrong, 1e-9)
        few = self.fitted.first(int(np.clip(enough, FEW, max(len(self.fitted), FEW))))
        area = max(surface.area * len(surface.points), 1e-9)
        # a plane within a tolerance of a surface errs by about an eighth of it
        coarse = min(0.04, 8 * wrong / area)
        _, best = max(self._grown, default=(0.0, math.inf))
        fineness, pruned = max(FINENESS, coarse / best), 0
        for attempt in range(ATTEMPTS):
            tolerance = max(coarse / fineness, FINEST)
            rng = stream(*seed, attempt)
            root = grow(surface, few, tolerance, LEAST * wrong / fineness, rng)
            self._refine(root, few)
            self._refine(root, few)
            share = self._record(root)
            self._grown.append((share, tolerance))
            if share >= self.bar:
                self._prune(root, few, whole=not pruned)
                pruned += 1
            elif root.node_count > MAX_NODES:
                break
            else:
                fineness *= FINER
            if pruned == RESTARTS or self._tired:
                break
        more = self.fitted.first(POLISHED_ON * len(few))
        for candidate in self._passing(self.bar)[:POLISHED]:
            if not self._tired:
                self._prune(candidate.root.copy(), more)
        return max(candidate.share for candidate in self._candidates)

    def best(self, last: bool) -> Iterator[SplitTree]:
        """Yield the trees to judge: those that meet the target, the smallest first.

        None is told twice, nor one that is no better than those told before. Where none ever met
        the target, the last search tells those that may, or else the best.
        """
        bar, yielded = self.bar, 0
        if last and not self._told and not self._passing(bar):
            bar = self._hopeful
        candidates = [candidate for candidate in self._passing(bar) if candidate.share > self._told]
        for candidate in candidates[: JUDGEMENTS - 1] + candidates[JUDGEMENTS - 1 :][-1:]:
            tree = to_lattice(candidate.root, self._counts)
            if self.count_right(tree, self._chosen) >= bar * len(self._chosen):
                yielded += 1
                self._told = max(self._told, candidate.share)
                yield tree
        if last and not yielded and not self._told:
            best = min(self._candidates, key=lambda c: (-c.share, c.nodes))
            yield to_lattice(best.root, self._counts)

    def count_right(self, tree: SplitTree, samples: Samples) -> int:
        """Return the number of samples where a tree is right."""
        return samples.count_right(tree.labels(self._locate(samples.states)))

    def _prune(self, root: Node, samples: Samples, whole: bool = False) -> None:
        """Prune a tree link by link while it meets the target, or as a whole."""
        met = True
        while met or (whole and not self._tired):
            for _ in range(PASSES):
                links = self._refine(root, samples)
                share = self._record(root)
                near = self.bar > share >= self.bar - NEAR * (1 - self.bar)
                if not (met and near):
                    break
            met = share >= self.bar
            if not root.children:
                return
            allowed = AT_ONCE * len(samples) * (share - self.bar if met else 1 - share)
            prune(links, allowed)

    def _passing(self, bar: float) -> list[Candidate]:
        """Return the trees that meet a bar, smallest first, each better than those before."""
        passing: list[Candidate] = []
        for candidate in sorted(self._candidates, key=lambda c: (c.nodes, -c.share)):
            if candidate.share >= bar and (not passing or candidate.share > passing[-1].share):
                passing.append(candidate)
        return passing

    @property
    def _tired(self) -> bool:
        return self._work > self._budget

    def _refine(self, root: Node, samples: Samples) -> list[Link]:
        self._work += root.node_count * (FIT_WORK + len(samples))
        return refine(root, samples)

    def _record(self, root: Node) -> float:
        share = self._chosen.count_right(root.labels(self._chosen.states)) / len(self._chosen)
        self._candidates.append(Candidate(root.copy(), root.node_count, share))
        return share

    def _locate(self, cube: np.ndarray) -> np.ndarray:
        return self._domain.locate(self._domain.lower + cube * self._domain.widths, self._counts)

    def _centred(self, samples: Samples) -> Samples:
        """Return samples with the states moved to the centres of their lattice steps.

        A plane of the cube then does what its rounded one will do.
        """
        return Samples((self._locate(samples.states) + 0.5) / self._counts, samples.right)


def fine_lattice(domain: Box, most: int = STEPS) -> tuple[int, ...]:
    """Return the lattice steps of a tree along each axis: powers of two, at most `most`."""
    counts = []
    for axis in range(domain.n):
        count = most
        while count > 1:
            try:
                domain.check_resolution([count if i == axis else 1 for i in range(domain.n)])
                break
            except ProblemError:
                count //= 2
        counts.append(count)
    return tuple(counts)


def to_lattice(root: Node, counts: tuple[int, ...]) -> SplitTree:
    """Return a tree with its splits rounded to integers.

    A lattice step ``z`` stands for its centre ``(z + 1/2) / counts`` in the unit cube.
    """

    def look(node: Node) -> tuple[int | list[int], int, list[Node]]:
        if not node.children:
            return LEAF, node.label, []
        assert node.plane is not None
        a, c = integer_plane(node.plane, counts)
        axis, *others = (i for i, coefficient in enumerate(a) if coefficient)
        if others:
            return a, c, node.children
        if a[axis] < 0:  # -z >= c exactly when not z >= 1 - c
            return axis, 1 - c, node.children[::-1]
        return axis, c, node.children

    return depth_first(counts, root, look)


def integer_plane(plane: Plane, counts: tuple[int, ...]) -> tuple[list[int], int]:
    """Return coefficients (n,) and threshold, as integers without a common divisor."""
    slope = plane[0] / np.array(counts)
    scale = min(MAX_COEFFICIENT / np.abs(slope).max(), MAX_SUM / (np.abs(slope) * counts).sum())
    coefficients = [int(a) for a in np.rint(slope * scale)]
    divisor = math.gcd(*coefficients)
    threshold = (plane[1] * scale - sum(coefficients) / 2) / divisor
    largest = MAX_COUNT // 2 + 1
    return [a // divisor for a in coefficients], int(
        np.clip(math.ceil(threshold), -largest, largest)
    )
