"""A decision tree whose splits may compare features, functions of the state."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from capsyn.cells.boxes import Boxes
from capsyn.cells.split_tree import SplitTree
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.programs.program import Program
from capsyn.validation import keep, read_only

MAX_FEATURES = 10_000
"""Most features of a tree."""
CHUNK = 1 << 18
"""Lattice steps at which features are evaluated at a time."""


@dataclass(frozen=True, eq=False)
class Features:
    """K functions of lattice steps, each cut into ranks by its thresholds.

    The rank of a feature is how many of its thresholds its value reaches. The value is that at the
    centre of a lattice step, so that a rank is the same all over it.
    """

    names: tuple[str, ...]
    program: Program  # steps (n,) to values (K,), in double precision
    thresholds: tuple[np.ndarray, ...]  # (m,) float64 of each feature, ascending
    margin: float | None
    """Least distance of a value on the lattice from a threshold, as a share of the values' span;
    None where the lattice is too fine to look at all its steps."""

    def __post_init__(self) -> None:
        kept = tuple(read_only(np.array(t, dtype=np.float64)) for t in self.thresholds)
        keep(self, thresholds=kept)

    @property
    def rank_counts(self) -> tuple[int, ...]:
        """Number of ranks of each feature."""
        return tuple(len(t) + 1 for t in self.thresholds)

    def values(self, steps: np.ndarray) -> np.ndarray:
        """Return the values (K, B) at lattice steps (B, n)."""
        parts = [
            self.program.evaluate(steps[start : start + CHUNK].T)[0]
            for start in range(0, max(len(steps), 1), CHUNK)
        ]
        return np.concatenate(parts, axis=1)

    def with_ranks(self, steps: np.ndarray) -> np.ndarray:
        """Return lattice steps (B, n) with the ranks of the features after them, (B, n + K)."""
        columns = [steps.T]
        for value, thresholds in zip(self.values(steps), self.thresholds):
            rank = np.searchsorted(thresholds, value, side="right")
            columns.append(np.where(np.isnan(value), 0, rank)[None])  # NaN reaches nothing
        return np.concatenate(columns).T.astype(np.int64)

    def check(self, n: int) -> None:
        """Raise `PolicyFormatError` unless they are well-formed features of `n` steps."""
        count = len(self.names)
        if not 0 < count <= MAX_FEATURES or len(self.thresholds) != count:
            raise PolicyFormatError(f"the tree has no, or too many, features: {count}")
        if not all(isinstance(x, str) and x and x.isprintable() for x in self.names):
            raise PolicyFormatError("a feature of the tree has no printable name")
        program = self.program
        sizes = [[size for _, size in ports] for ports in (program.inputs, program.outputs)]
        if sizes != [[n], [count]]:
            raise PolicyFormatError(f"the features' program must give {count} of {n} steps")
        for thresholds in self.thresholds:
            sound = thresholds.ndim == 1 and len(thresholds) and np.isfinite(thresholds).all()
            if not sound or (np.diff(thresholds) <= 0).any():
                raise PolicyFormatError("a feature's thresholds must be finite and ascend")
        if self.margin is not None and not (
            isinstance(self.margin, float) and 0 <= self.margin <= 1
        ):
            raise PolicyFormatError("the features' margin must be a share")

    def to_json(self) -> dict[str, Any]:
        """Return the features as plain data."""
        return {
            "names": list(self.names),
            "program": self.program.to_json(),
            "thresholds": [t.tolist() for t in self.thresholds],
            "margin": self.margin,
        }

    @staticmethod
    def from_json(data: Any) -> Features:
        """Return the features that `to_json` described; `PolicyFormatError` for anything else."""
        if not isinstance(data, dict) or set(data) != {"names", "program", "thresholds", "margin"}:
            raise PolicyFormatError("the features of the tree are of another kind")
        rows = data["thresholds"]
        if not isinstance(data["names"], list) or not all(
            isinstance(row, list) and all(type(t) in (int, float) for t in row) for row in rows
        ):
            raise PolicyFormatError("the features of the tree are of another kind")
        program = Program.from_json(data["program"])
        return Features(tuple(data["names"]), program, tuple(rows), data["margin"])


@dataclass(frozen=True, eq=False)
class FeatureTree(SplitTree):
    """A `SplitTree` of which splits ``n .. n + K - 1`` compare the ranks of K features.

    Node `i` compares, with its threshold, lattice step ``split[i]``, or the rank of feature
    ``split[i] - n``; planes, which come after, have coefficients (R, n + K).
    """

    features: Features

    planes_are: ClassVar[str] = "splits by features"
    compiled: ClassVar[bool] = False

    @staticmethod
    def of(counts: tuple[int, ...], ranked: SplitTree, features: Features) -> FeatureTree:
        """Return the tree on a lattice whose steps with ranks go down a tree of those."""
        arrays = {name: getattr(ranked, name) for name in ranked.arrays()}
        return FeatureTree(counts, **arrays, features=features)

    @functools.cached_property
    def ranked(self) -> SplitTree:
        """The tree over lattice steps with ranks after them."""
        counts = (*self.counts, *self.features.rank_counts)
        return SplitTree(counts, self.split, self.threshold, self.second, self.planes)

    @property
    def has_planes(self) -> bool:
        """True: what bounds symbols is oblique to the axes."""
        return True

    def structure(self) -> dict[str, Any]:
        """Return what a file says of the tree beside its arrays, as plain data."""
        return super().structure() | {"features": self.features.to_json()}

    def find(self, steps: np.ndarray) -> np.ndarray:
        """Return the leaves (B,) that lattice steps (B, n) end in."""
        return self.ranked.find(self.features.with_ranks(steps))

    def parts(
        self, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Raise `ProblemError`: leaves are no boxes."""
        raise ProblemError("a tree with features has no boxes; compress without `features`")

    def boxes(self) -> Boxes:
        """Raise `ProblemError`: leaves are no boxes."""
        raise ProblemError("a tree with features has no boxes; compress without `features`")

    def check(self, label_count: int, rows: np.ndarray | None = None) -> None:
        """Raise `PolicyFormatError` unless it is a well-formed tree of so many labels."""
        if min(self.counts) < 1:
            raise PolicyFormatError(f"the tree's lattice has {self.counts} steps")
        self.features.check(self.n)
        self.ranked.check(label_count, rows)
        used = np.unique(self.split[(self.split >= self.n)])
        if not np.isin(np.arange(len(self.features.names)) + self.n, used).all():
            raise PolicyFormatError("a feature of the tree is in no split")


def lattice_chunks(counts: tuple[int, ...]) -> Any:
    """Yield all lattice steps (B, n) in C order, some at a time."""
    total = math.prod(counts)
    for start in range(0, total, CHUNK):
        places = np.arange(start, min(start + CHUNK, total))
        yield np.stack(np.unravel_index(places, counts), axis=1)
