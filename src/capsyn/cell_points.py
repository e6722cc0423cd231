"""Which points of a cell are tested."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.validation import describe

NAMES = ("vertices", "center", "edge_midpoints", "random")


@dataclass(frozen=True)
class CellPoints:
    """The test points of a cell: its vertices, and what is added to them.

    Parameters
    ----------
    center, edge_midpoints : bool
        Add them.
    random : int
        Number of random interior points to add.
    """

    center: bool = True
    edge_midpoints: bool = False
    random: int = 0

    @staticmethod
    def parse(text: Any) -> CellPoints:
        """Return the test points that a text such as ``"vertices+center+random:2"`` names."""
        parts = [p.strip() for p in text.split("+")] if isinstance(text, str) else []
        names = [p.partition(":")[0] for p in parts]
        if "vertices" not in names or len(set(names)) < len(names) or set(names) - set(NAMES):
            raise ProblemError(
                "`test_points` must be 'vertices', then any of '+center', '+edge_midpoints', "
                f"'+random:R'; got {describe(text)}"
            )
        count = 0
        for name, part in zip(names, parts):
            digits = part.removeprefix("random:")
            if name == "random" and digits.isascii() and digits.isdecimal() and int(digits) > 0:
                count = int(digits)
            elif part != name or name == "random":
                raise ProblemError(
                    "`test_points` takes a count for random alone, as 'random:2'; "
                    f"got {describe(part)}"
                )
        return CellPoints("center" in names, "edge_midpoints" in names, count)

    def __str__(self) -> str:
        names = ["vertices"]
        names += ["center"] * self.center + ["edge_midpoints"] * self.edge_midpoints
        return "+".join(names + [f"random:{self.random}"] * bool(self.random))

    def interior(self, n: int) -> int:
        """Return how many points a cell of `n` axes has beside its vertices, at most."""
        edges = n * 2 ** (n - 1) if self.edge_midpoints else 0
        return int(self.center) + edges + self.random

    def in_block(self, split: Sequence[int]) -> int:
        """Return how many different points a block of `split` cells per axis has."""
        vertices, cells = math.prod(k + 1 for k in split), math.prod(split)
        edges = sum(vertices // (k + 1) * k for k in split) if self.edge_midpoints else 0
        return vertices + (int(self.center) + self.random) * cells + edges

    def offsets(self, n: int) -> np.ndarray:
        """Return the fixed points (P, n) in halves of the cell: vertices, the centre, the rest."""
        points = list(itertools.product((0, 2), repeat=n))
        points += [(1,) * n] * self.center
        if self.edge_midpoints:
            points += [p for p in itertools.product((0, 1, 2), repeat=n) if p.count(1) == 1]
        return np.array(list(dict.fromkeys(points)))  # for n = 1 the edge is the cell
