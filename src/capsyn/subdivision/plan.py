"""All that a subdivision is asked for, checked once."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from typing import Any

from capsyn.cells.cell_tree import MAX_MASKED
from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.modelling.grid import LEAVES, Grid
from capsyn.subdivision.cell_points import FINE, CellPoints
from capsyn.subdivision.growing_cells import row_grid
from capsyn.subdivision.limits import Limits, block_room, check_memory
from capsyn.validation import finite_number, one_of, whole_number

REFINE = ("isotropic", "adaptive")


@dataclass(frozen=True)
class SubdivisionPlan:
    """What a subdivision is asked for; see `subdivide`."""

    grid: Grid
    limits: Limits
    leaves: str
    leaf_error: float
    refine: str
    test_points: str
    seed: int

    @staticmethod
    def of(
        grid: Grid,
        limits: Limits,
        *,
        leaves: Any,
        leaf_error: Any,
        refine: Any,
        test_points: Any,
        seed: Any,
    ) -> SubdivisionPlan:
        """Return a validated plan; `ProblemError` for what cannot be used."""
        leaf_error = finite_number("leaf_error", leaf_error, least=0.0)
        if leaf_error > 1:
            raise ProblemError(f"`leaf_error` must be between 0 and 1; got {leaf_error:g}")
        one_of("leaves", leaves, list(LEAVES))
        one_of("refine", refine, list(REFINE))
        CellPoints.parse(test_points)
        seed = whole_number("seed", seed, least=0)
        return SubdivisionPlan(grid, limits, leaves, leaf_error, refine, test_points, seed)

    @property
    def affine(self) -> bool:
        """Whether leaves may be affine."""
        return self.leaves == "affine"

    @property
    def adaptive(self) -> bool:
        """Whether cells are split along some axes only."""
        return self.refine == "adaptive"

    @property
    def in_rounds(self) -> bool:
        """Whether cells are split in rounds, not level by level."""
        return self.affine or self.adaptive

    @functools.cached_property
    def points(self) -> CellPoints:
        """The test points of a cell."""
        return CellPoints.parse(self.test_points)

    @property
    def lattice(self) -> tuple[int, ...]:
        """Lattice units of the test points along each axis."""
        return tuple(FINE * count for count in self.grid.counts)

    def check(self, domain: Box, n_symbols: int, in_force: int = 1) -> None:
        """Raise `ProblemError` for what floating point in a domain, or memory, cannot hold."""
        if self.adaptive and domain.n > MAX_MASKED:
            raise ProblemError(
                f"`refine` 'adaptive' is for at most {MAX_MASKED} axes; the domain has {domain.n}"
            )
        domain.check_resolution(self.lattice)
        if self.affine:
            domain.check_resolution(row_grid(self.grid).counts)
        kind = self.affine, self.adaptive, in_force
        check_memory(self.grid, self.points, n_symbols, self.limits, *kind)

    def with_room(self, room: int) -> SubdivisionPlan:
        """Return the plan of a run that goes on, whose blocks took so much memory [bytes]."""
        return dataclasses.replace(self, limits=dataclasses.replace(self.limits, room=room))

    @property
    def room(self) -> int:
        """What a block of cells may take [bytes]."""
        return block_room(self.limits)

    def asked(self) -> dict[str, Any]:
        """Return what results depend on beside grid and limits, as plain data."""
        names = ("leaves", "leaf_error", "refine", "test_points", "seed")
        return {name: getattr(self, name) for name in names}
