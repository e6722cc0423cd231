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

NAMES = ("vertices", "center", "edge_midpoints", "faces", "random")
FINE = 8
"""Lattice units along the edge of a finest cell: of vertices, centres and edge midpoints, and of
points a quarter of the way from these to the centre."""


@dataclass(frozen=True)
class CellPoints:
    """The test points of a cell: its vertices, or the centre and the faces, and what is added."""

    center: bool = True
    edge_midpoints: bool = False
    random: int = 0  # number of random interior points
    faces: bool = False  # the centres of the 2 n faces
    vertices: bool = True  # all 2^n; without them centre and faces must be there

    @staticmethod
    def parse(text: Any) -> CellPoints:
        """Return the test points that a text such as ``"vertices+center+random:2"`` names."""
        parts = [p.strip() for p in text.split("+")] if isinstance(text, str) else []
        names = [p.partition(":")[0] for p in parts]
        enough = "vertices" in names or {"center", "faces"} <= set(names)
        if not enough or len(set(names)) < len(names) or set(names) - set(NAMES):
            raise ProblemError(
                "`test_points` must be 'vertices', then any of '+center', '+edge_midpoints', "
                "'+faces', '+random:R', or 'center+faces' with more; "
                f"got {describe(text)}"
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
        return CellPoints(
            "center" in names,
            "edge_midpoints" in names,
            count,
            "faces" in names,
            "vertices" in names,
        )

    def __str__(self) -> str:
        names = ["vertices"] * self.vertices + ["center"] * self.center
        names += ["edge_midpoints"] * self.edge_midpoints + ["faces"] * self.faces
        return "+".join(names + [f"random:{self.random}"] * bool(self.random))

    def interior(self, n: int) -> int:
        """Return how many points a cell of `n` axes has beside its vertices, at most."""
        edges = n * 2 ** (n - 1) if self.edge_midpoints else 0
        return int(self.center) + edges + 2 * n * self.faces + self.random

    def in_block(self, split: Sequence[int]) -> int:
        """Return how many different points a block of `split` cells per axis has."""
        vertices, cells = math.prod(k + 1 for k in split), math.prod(split)
        edges = sum(vertices // (k + 1) * k for k in split) if self.edge_midpoints else 0
        faces = sum(cells // k * (k + 1) for k in split) if self.faces else 0
        inner = (int(self.center) + self.random) * cells
        return vertices * self.vertices + inner + edges + faces

    def offsets(self, n: int) -> np.ndarray:
        """Return the fixed points (P, n) in halves of the cell: vertices, the centre, the rest."""
        points = list(itertools.product((0, 2), repeat=n)) if self.vertices else []
        points += [(1,) * n] * self.center
        if self.faces:
            points += [(1,) * i + (k,) + (1,) * (n - 1 - i) for i in range(n) for k in (0, 2)]
        if self.edge_midpoints:
            points += [p for p in itertools.product((0, 1, 2), repeat=n) if p.count(1) == 1]
        return np.array(list(dict.fromkeys(points)))  # for n = 1 the edge is the cell
