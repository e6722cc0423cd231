"""Propositions 1 and 2 of the paper: how deep, and how many solves at worst."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.modelling.grid import Grid
from capsyn.validation import describe


def level_for_precision(
    domain: Box, precision: Sequence[float], partitions: Any, refinement: Any = 2
) -> int:
    """Return the least maximum level whose finest cells are no larger than wanted, eq. (9).

    The wanted edge lengths are `precision` (n,) [state units]; the grid's numbers are those of
    `Grid.of`. An argument that cannot be used is a `ProblemError`.
    """
    wanted = np.asarray(precision, dtype=float)
    if wanted.shape != (domain.n,) or not (np.isfinite(wanted) & (wanted > 0)).all():
        raise ProblemError(
            f"`precision` must be {domain.n} positive number(s); got {describe(precision)}"
        )
    grid = Grid.of(partitions, refinement, 0, domain.n)
    level = 0
    while any(
        width / cells > delta
        for width, delta, cells in zip(
            domain.widths.tolist(), wanted.tolist(), grid.at(level).counts
        )
    ):
        level += 1
    return level


def worst_case_solves(grid: Grid, interior_points: int = 1, adaptive: bool = False) -> int:
    """Return the number of solves of Proposition 2, eq. (10), counted as the paper does.

    It bounds the test points, of which a cell has some beside its vertices; those of the quarter
    rule, random ones of the levels between, and parents' centres where axes are refined by even and
    odd numbers come on top. Adaptive splits, along one axis after the other, make fewer than twice
    as many cells as there are finest ones.
    """
    vertices = math.prod(count + 1 for count in grid.counts)
    cells = 2 * grid.cells if adaptive else grid.roots + grid.cells
    return vertices + cells * interior_points
