"""Coordinates of lattice steps for trees with features: the readings, then the features.

All are shares of their span, so that one length means the same along each. Where a lattice has few
enough steps, all of them are looked at, so that nothing about features is a guess.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from capsyn.cells.feature_tree import Features, FeatureTree, lattice_chunks
from capsyn.cells.split_tree import LEAF, depth_first
from capsyn.compression.features.growing import across
from capsyn.compression.fitted.oblique import integer_plane
from capsyn.compression.fitted.plane_tree import Node
from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.programs.builder import selected, with_sums
from capsyn.programs.program import Program
from capsyn.random_streams import stream
from capsyn.validation import describe

MAX_FEATURES = 64
"""Most functions that are given."""
ENUMERATED = 2**26
"""A lattice of at most so many steps is looked at as a whole."""
SAMPLED = 2**20
"""Random steps of a larger one that are looked at."""
GRAIN = 2.0**-28
"""Values of a feature so close, as a share of their span, are not told apart by a fit."""
LARGEST = 1e150
"""Values of features are smaller in size, so that their differences are finite."""
LEAST_MARGIN = 1e-9
"""A threshold closer to a value, as a share of the span, may not be the same for every target."""
SLIGHT = 3e-4
"""Factors of a sum of features, by their spans, that are left out."""
DIGITS = 6
"""Significant digits of the factors in sums of features."""
NEAR, TRIED = 1e-6, 65
"""How far a threshold may move for a wider gap [share of the span], and the places tried."""

Functions = Mapping[str, Callable[..., Any]]


def check_functions(features: Any) -> Functions:
    """Return features if they are functions by name; `ProblemError` else."""
    known = isinstance(features, Mapping) and 0 < len(features) <= MAX_FEATURES
    if not known or not all(map(callable, features.values())):
        raise ProblemError(
            f"`features` must be a dict of 1 to {MAX_FEATURES} functions of the state by name; got "
            f"{describe(features)}"
        )
    for name in features:
        if not isinstance(name, str) or not name or not name.isprintable():
            raise ProblemError(f"`features` must have printable names; got {describe(name)}")
    return features


@dataclass(frozen=True, eq=False)
class Space:
    """Lattice steps of a domain, with the values of K features at their centres."""

    domain: Box
    counts: tuple[int, ...]
    names: tuple[str, ...]
    program: Program
    low: np.ndarray  # (K,) least value of each feature
    span: np.ndarray  # (K,) > 0: largest less least value; 1 where it is constant

    @staticmethod
    def of(functions: Functions, domain: Box, counts: tuple[int, ...], told: int = 0) -> Space:
        """Return the space of some features; `ProblemError` where one is not finite.

        The last `told` axes of the domain are exogenous: functions take them as w, after x.
        """
        from capsyn.modelling.transcription import feature_program

        program = feature_program(functions, domain, counts, told)
        names = tuple(functions)
        low, high = np.full(len(names), np.inf), np.full(len(names), -np.inf)
        bare = Space(domain, counts, names, program, low, high)
        for steps in bare.all_steps():
            values = program.evaluate(steps.T)[0]
            finite = np.abs(values) < LARGEST  # false for NaN
            if not finite.all():
                k, b = np.argwhere(~finite)[0]
                at = bare.centres(steps[b : b + 1])[0]
                state = ", ".join(f"{s} = {x:g}" for s, x in zip(domain.names, at))
                got = np.broadcast_to(values, (len(names), len(steps)))[k, b]
                raise ProblemError(
                    f"`features[{names[k]!r}]` must be a number below {LARGEST:g} all over the "
                    f"domain; got {got:g} at {state}"
                )
            low, high = np.minimum(low, values.min(axis=1)), np.maximum(high, values.max(axis=1))
        span = np.where(high > low, high - low, 1.0)
        return Space(domain, counts, names, program, low, span)

    @property
    def n(self) -> int:
        """Number of states, and of exogenous inputs."""
        return self.domain.n

    @property
    def whole(self) -> bool:
        """Whether all steps of the lattice are looked at."""
        return math.prod(self.counts) <= ENUMERATED

    def all_steps(self) -> Iterator[np.ndarray]:
        """Yield all steps (B, n), some at a time; of a lattice too fine for it random ones."""
        if self.whole:
            yield from lattice_chunks(self.counts)
        else:
            yield stream(0).integers(self.counts, size=(SAMPLED, self.n))

    def centres(self, steps: np.ndarray) -> np.ndarray:
        """Return the states (B, n) at the centres of steps (B, n)."""
        return self.domain.lower + (steps + 0.5) * (self.domain.widths / np.array(self.counts))

    def coordinates(self, steps: np.ndarray) -> np.ndarray:
        """Return the coordinates (B, n + K) of steps (B, n), in [0, 1]."""
        values = self.program.evaluate(steps.T)[0]
        shares = (values.T - self.low) / self.span
        return np.column_stack([(steps + 0.5) / self.counts, np.rint(shares / GRAIN) * GRAIN])

    def locate(self, cube: np.ndarray) -> np.ndarray:
        """Return the steps (B, n) of states of the unit cube."""
        return self.domain.locate(self.domain.lower + cube * self.domain.widths, self.counts)

    def tree(self, root: Node, moved: bool) -> FeatureTree | None:
        """Return the tree on the lattice of one over coordinates; None if no feature is in it.

        Thresholds of features are put in the middle of a gap between values on the lattice; with
        `moved`, of the widest gap nearby, else of that which they are in. A plane that combines
        features becomes a feature of its own.
        """
        space, root = self._combined(root)
        return space._tree(root, moved)

    def _combined(self, root: Node) -> tuple[Space, Node]:
        """Return the space with sums of features as features, and the tree of single ones."""
        root, sums = root.copy(), dict[tuple[float, ...], int]()
        for node in nodes_of(root):
            if node.plane is None or np.count_nonzero(node.plane[0][self.n :]) < 2:
                continue
            normal, most = node.plane[0][self.n :], np.abs(node.plane[0]).argmax() - self.n
            slight = np.abs(normal) < SLIGHT
            weights = np.where(slight, 0.0, normal) / self.span
            offset = node.plane[1] - normal[slight].sum() / 2 + weights @ self.low
            if np.count_nonzero(weights) == 1:  # one alone, beyond its threshold or before it
                threshold = (offset / weights[most] - self.low[most]) / self.span[most]
                node.plane = across(self.n + most, threshold)
                node.children = node.children[:: -1 if weights[most] < 0 else 1]
                continue
            weights, offset = weights / abs(weights[most]), offset / abs(weights[most])
            factors = tuple(float(f"{w:.{DIGITS}g}") for w in weights)
            place = sums.setdefault(factors, len(sums))
            span = float(np.abs(factors) @ self.span)
            node.plane = across(self.n + len(self.names) + place, offset / span)
        for node in nodes_of(root):
            if node.plane is not None:
                normal = np.zeros(self.n + len(self.names) + len(sums))
                normal[: len(node.plane[0])] = node.plane[0]
                node.plane = normal, node.plane[1]
        table = np.array(list(sums)).reshape(-1, len(self.names))
        return replace(
            self,
            names=(*self.names, *(_sum_name(row, self.names) for row in table.tolist())),
            program=with_sums(self.program, table.tolist()),
            low=np.append(self.low, np.zeros(len(table))),
            span=np.append(self.span, np.abs(table) @ self.span),  # at most
        ), root

    def _tree(self, root: Node, moved: bool) -> FeatureTree | None:
        """Return the tree whose planes are across one feature each, or of states alone."""
        wanted: dict[int, set[float]] = {}
        for node in nodes_of(root):
            k = _feature(node, self.n)
            if k is not None and node.plane is not None:
                wanted.setdefault(k, set()).add(float(self.low[k] + node.plane[1] * self.span[k]))
        if not wanted:
            return None
        used = sorted(wanted)
        places = {k: np.array(sorted(wanted[k])) for k in used}
        put, margin = self._placed(places, moved)
        thresholds = [np.unique(put[k]) for k in used]
        counts = (*self.counts, *(len(t) + 1 for t in thresholds))

        def look(node: Node) -> tuple[int | list[int], int, list[Node]]:
            if not node.children:
                return LEAF, node.label, []
            assert node.plane is not None
            k = _feature(node, self.n)
            if k is not None:
                at = np.searchsorted(places[k], self.low[k] + node.plane[1] * self.span[k])
                place = used.index(k)
                rank = int(np.searchsorted(thresholds[place], put[k][at])) + 1
                return self.n + place, rank, node.children
            a, c = integer_plane((node.plane[0][: self.n], node.plane[1]), self.counts)
            axis, *others = (i for i, coefficient in enumerate(a) if coefficient)
            if others:
                return a + [0] * len(used), c, node.children
            if a[axis] < 0:
                return axis, 1 - c, node.children[::-1]
            return axis, c, node.children

        ranked = depth_first(counts, root, look)
        names = tuple(self.names[k] for k in used)
        features = Features(names, selected(self.program, used), tuple(thresholds), margin)
        return FeatureTree.of(self.counts, ranked, features)

    def _placed(
        self, places: dict[int, np.ndarray], moved: bool
    ) -> tuple[dict[int, np.ndarray], float | None]:
        """Return thresholds (m,) by feature in gaps between values, and the least margin."""
        if not self.whole:
            return places, None
        shifts = np.linspace(-NEAR, NEAR, TRIED) if moved else np.zeros(1)
        tried = {
            k: np.sort((t[:, None] + shifts * self.span[k]).ravel()) for k, t in places.items()
        }
        least = {k: np.full(len(t) + 1, np.inf) for k, t in tried.items()}  # of values by rank
        most = {k: np.full(len(t) + 1, -np.inf) for k, t in tried.items()}
        for steps in lattice_chunks(self.counts):
            values = self.program.evaluate(steps.T)[0]
            for k, t in tried.items():
                rank = np.searchsorted(t, values[k], side="right")
                np.minimum.at(least[k], rank, values[k])
                np.maximum.at(most[k], rank, values[k])
        put, margins = {}, [1.0]
        for k, t in tried.items():
            below = np.maximum.accumulate(most[k])[:-1]
            above = np.minimum.accumulate(least[k][::-1])[::-1][1:]
            gap = np.where(np.isfinite(above - below), above - below, 0.0)
            choice = []
            for threshold in places[k]:
                near = np.flatnonzero(np.abs(t - threshold) <= 1.01 * NEAR * self.span[k])
                best = near[gap[near].argmax()] if moved else np.searchsorted(t, threshold)
                if gap[best]:
                    margins.append(float(gap[best] / 2 / self.span[k]))
                    threshold = below[best] + gap[best] / 2
                choice.append(threshold)
            put[k] = np.array(choice)
        return put, min(margins)


def _sum_name(factors: list[float], names: tuple[str, ...]) -> str:
    """Return a sum of features as text."""
    text = ""
    for factor, name in zip(factors, names):
        if factor:
            sign = (" - " if factor < 0 else " + ") if text else "-" * (factor < 0)
            many = "" if abs(factor) == 1 else f"{abs(factor):.6g} "
            text += f"{sign}{many}{name if name.isidentifier() else f'({name})'}"
    return text


def nodes_of(root: Node) -> Iterator[Node]:
    """Yield all nodes of a tree."""
    stack = [root]
    while stack:
        node = stack.pop()
        yield node
        stack += node.children


def _feature(node: Node, n: int) -> int | None:
    """Return the feature that a node of a tree over coordinates compares; None for others."""
    if node.plane is None or not node.children or not node.plane[0][n:].any():
        return None
    return int(np.flatnonzero(node.plane[0][n:])[0])
