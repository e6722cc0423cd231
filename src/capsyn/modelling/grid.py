"""The grid of cells: partitions, refinement and depth, per axis."""

from __future__ import annotations

from capsyn.validation import whole_number, whole_numbers

MAX_COUNT = 2**31 - 1
"""Most finest cells along one axis."""


def lattice_counts(
    partitions: tuple[int, ...], refinement: tuple[int, ...], max_level: int
) -> tuple[int, ...]:
    """Return the finest cells along each axis, ``partitions * refinement ** max_level``."""
    return tuple(q * r**max_level for q, r in zip(partitions, refinement))


def grid_settings(
    partitions: object, refinement: object, max_level: object, n: int
) -> tuple[tuple[int, ...], tuple[int, ...], int]:
    """Return validated (partitions, refinement, max_level) for `n` axes.

    Raises
    ------
    ProblemError
        Not whole numbers, or 2^31 finest cells or more along an axis.
    """
    q = whole_numbers("partitions", partitions, n, least=1, most=MAX_COUNT)
    r = whole_numbers("refinement", refinement, n, least=2, most=MAX_COUNT)
    most = 0
    while max(lattice_counts(q, r, most + 1)) <= MAX_COUNT and most < 31:
        most += 1
    return q, r, whole_number("max_level", max_level, least=0, most=most)
