"""Tables: symbols at the points of a uniform grid, made into policies that equal them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.masks import WORD, preferred, several
from capsyn.cells.merged import entry_count, grids_of, merged
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet, Outside, check_outside
from capsyn.modelling.domain import LARGEST, Box
from capsyn.modelling.grid import Grid
from capsyn.modelling.time_unit import check_time_unit
from capsyn.policies.policy import Policy
from capsyn.validation import describe, finite_array, keep, read_only

MOST_POINTS = 1 << 24
"""Most points of a grid."""
MOST_SYMBOLS = WORD - 1
"""Most symbols of a table: sets of them, and a gap, are bits of one word."""
MOST_AXES = 16
"""Most axes of a grid: a cell of n axes has 2^n children or more."""


@dataclass(frozen=True, eq=False)
class Table:
    """A controller that is given at the points of a uniform grid.

    Parameters
    ----------
    first, step : (n,)
        The grid's first point, and the distance of its points along each axis [state units].
    masks : (k1, .., kn) uint64
        The symbols that are allowed at each point, as bit masks; 0 if there is none. The array is
        copied, and read-only.
    alphabet : Alphabet
        The symbols.
    names, units : n strings, optional
        Names and units of the states.
    periodic : n booleans, optional
        Whether an axis is periodic: its last point is one step before the first point of the next
        turn.

    Raises
    ------
    ProblemError
        Wrong shapes, more than `MOST_POINTS` points or `MOST_AXES` axes, steps of 0 or less, or
        unknown symbols.
    """

    first: Any
    step: Any
    masks: np.ndarray
    alphabet: Alphabet
    names: Any = None
    units: Any = None
    periodic: Any = None

    def __post_init__(self) -> None:
        first, step = finite_array("first", self.first, 1), finite_array("step", self.step, 1)
        masks = _array("masks", self.masks)
        if masks.dtype != np.uint64 or masks.ndim == 0 or not masks.size:
            raise ProblemError(f"`masks` must be a grid of uint64; got {masks.dtype}{masks.shape}")
        _check_grid(first, step, masks.shape)
        if not isinstance(self.alphabet, Alphabet):
            raise ProblemError(
                f"`alphabet` must be a capsyn.Alphabet; got {describe(self.alphabet)}"
            )
        if len(self.alphabet) > MOST_SYMBOLS:
            raise ProblemError(
                f"`alphabet` of a table must have at most {MOST_SYMBOLS} symbols; "
                f"got {len(self.alphabet)}"
            )
        wrong = masks >> np.uint64(len(self.alphabet)) != 0
        if wrong.any():
            point = np.argwhere(wrong)[0]
            raise ProblemError(
                f"`masks` must hold symbols 0 to {len(self.alphabet) - 1}; got "
                f"{int(masks[tuple(point)]):#b} at state {_text(first + step * point)}"
            )
        keep(self, first=first, step=step, masks=read_only(masks.copy()))
        self.box()

    @staticmethod
    def of(
        first: Any, step: Any, symbols: Any, alphabet: Alphabet | Sequence[Any], **names: Any
    ) -> Table:
        """Return the table of an array of symbols.

        Parameters
        ----------
        first, step : (n,)
            The point with the least states, and the distance of points along each axis [state
            units].
        symbols : (k1, .., kn) ints, or (k1, .., kn, N) booleans
            The symbol of each point, -1 for none; or whether each symbol is allowed at each point.
        alphabet : Alphabet, or (N, m) or (N,) numbers
            The symbols.
        names
            ``names``, ``units`` and ``periodic`` of the states.

        Raises
        ------
        ProblemError
            The arrays make no table.
        """
        if not isinstance(alphabet, Alphabet):
            alphabet = Alphabet(alphabet)
        array, count = _array("symbols", symbols), len(alphabet)
        check_symbols(array.shape, array.dtype, first, step, count)
        if array.dtype == bool:
            masks = np.zeros(array.shape[:-1], dtype=np.uint64)
            for k in range(count):
                masks |= array[..., k].astype(np.uint64) << np.uint64(k)
        else:
            wrong = (array < -1) | (array >= count)
            if wrong.any():
                point = np.argwhere(wrong)[0]
                raise ProblemError(
                    f"`symbols` must be -1 to {count - 1}; got {array[tuple(point)]} at grid point "
                    f"{tuple(point.tolist())}"
                )
            bits = np.uint64(1) << np.arange(count, dtype=np.uint64)
            masks = np.where(array < 0, np.uint64(0), bits[array])
        return Table(first, step, masks, alphabet, **names)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of points along each axis."""
        return self.masks.shape

    def box(self) -> Box:
        """Return the box of states whose cells have the grid's points as centres."""
        return self._box(self.counts)

    def _box(self, counts: Sequence[int]) -> Box:
        lower = self.first - self.step / 2
        upper = lower + self.step * np.array(counts)
        box = Box(lower, upper, names=self.names, units=self.units, periodic=self.periodic)
        box.check_wide("domain")
        return box

    @property
    def symbols(self) -> np.ndarray:
        """The lowest symbol that is allowed at each point (k1, .., kn); -1 if there is none."""
        lowest = preferred(self.masks[..., None], range(len(self.alphabet)))
        return np.where(self.masks == 0, -1, lowest)

    def points(self) -> np.ndarray:
        """Return the states (P, n) of the grid in C order."""
        axes = [low + h * np.arange(k) for low, h, k in zip(self.first, self.step, self.counts)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))

    def policy(
        self,
        name: str = "table",
        *,
        default: Any = None,
        outside: Outside = "error",
        min_dwell: float = 0.0,
        time_unit: str = "s",
        outside_at_once: bool = False,
    ) -> Policy:
        """Return the policy that equals the table, with the grid's points as centres of its cells.

        If a point has several symbols, the policy takes the lowest. Compression in mode freedom may
        take any of them. If a point has no symbol, its cell is a gap, whose states count as
        outside.

        Parameters
        ----------
        name : str
            Name of the policy.
        default : (m,), optional
            Default control [input units]. Exports apply it where there is no symbol, unless told
            otherwise. Default: 0.
        outside : "error", "nearest" or symbol
            What a state outside gets. In a gap, ``"nearest"`` is an error.
        min_dwell : float
            Least time between switches [time unit].
        time_unit, outside_at_once
            See `Problem`.

        Raises
        ------
        ProblemError
            An argument that cannot be used, or a grid that is finer than floating point at its
            bounds.

        Notes
        -----
        Neighbouring points with the same symbols are merged into larger cells. An axis of a table
        with gaps is refined by two, and padded with gaps at its upper end if its count asks for it.
        The domain then grows by as much. Other axes are not padded, but refined by factors of their
        own counts: periodic axes, all axes of a table without gaps, and all axes under rule
        ``"nearest"``. The number of levels is the one that takes the fewest cells.
        """
        outside = check_outside(outside, self.alphabet)
        check_time_unit(time_unit)
        gap = np.uint64(1 << len(self.alphabet))
        masks = np.where(self.masks == 0, gap, self.masks)
        gaps = bool((self.masks == 0).any())
        padded = [gaps and outside != "nearest" and not p for p in self.box().periodic]
        grids = list(grids_of(self.counts, padded))
        grid = min(grids, key=lambda grid: entry_count(_padded(masks, gap, grid), grid))
        masks = _padded(masks, gap, grid)
        counts = {
            "points": int(self.masks.size),
            "outside": int(np.count_nonzero(self.masks == 0)),
            "several": int(np.count_nonzero(several(self.masks[..., None]))),
        }
        domain = self._box(masks.shape)
        domain.check_resolution(masks.shape)
        return Policy(
            name=name,
            domain=domain,
            alphabet=self.alphabet,
            default=np.zeros(self.alphabet.m) if default is None else default,
            cells=_merged(masks, grid, len(self.alphabet)),
            outside=outside,
            min_dwell=min_dwell,
            statistics={"table": counts},
            gaps=gaps,
            time_unit=time_unit,
            outside_at_once=outside_at_once,
        )


def check_symbols(
    shape: tuple[int, ...], dtype: np.dtype[Any], first: Any, step: Any, count: int
) -> None:
    """Raise `ProblemError` where an array is no table of symbols, before its entries are read.

    `shape` and `dtype` are those of the ``symbols`` of `Table.of`, `first` and `step` its own, and
    `count` is the number of symbols.
    """
    if dtype.kind not in "biu":
        raise ProblemError(f"`symbols` must be whole numbers or booleans; got {dtype}")
    allowed = dtype.kind == "b"
    if allowed and shape[-1:] != (count,):
        raise ProblemError(
            f"`symbols` must be booleans of shape (k1, .., kn, {count}); got {shape}"
        )
    counts = shape[:-1] if allowed else shape
    if not counts or not math.prod(counts):
        raise ProblemError(f"`symbols` must be those of a grid of points; got shape {shape}")
    _check_grid(finite_array("first", first, 1), finite_array("step", step, 1), counts)


def _check_grid(first: np.ndarray, step: np.ndarray, counts: Sequence[int]) -> None:
    """Raise `ProblemError` where points (k1, .., kn), the first and their distances do not fit."""
    check_points(counts)
    if not len(first) == len(step) == len(counts):
        raise ProblemError(
            f"`first` and `step` must have {len(counts)} entries, one per axis; got {len(first)} "
            f"and {len(step)}"
        )
    if (step <= 0).any():
        raise ProblemError(f"`step` must be above 0; got {describe(step.tolist())}")
    with np.errstate(over="ignore"):
        last = first + step * counts
    if not (np.maximum(np.abs(first), np.abs(last)) <= LARGEST).all():
        raise ProblemError(
            f"`first` and `step` must make a grid within +-{LARGEST:g}; got "
            f"{describe(first.tolist())} and {describe(step.tolist())}"
        )
    finest = np.maximum(32 * np.spacing(np.maximum(np.abs(first), np.abs(last))), 1e-300)
    if (step < finest).any():
        raise ProblemError(
            f"`step` must be wider than floating point is fine near the points, {finest.tolist()}; "
            f"got {describe(step.tolist())}"
        )


def check_points(counts: Sequence[int]) -> None:
    """Raise `ProblemError` for a grid of too many points or axes."""
    if len(counts) > MOST_AXES:
        raise ProblemError(f"a table must have at most {MOST_AXES} axes; got {len(counts)}")
    if math.prod(counts) > MOST_POINTS:
        shape = " x ".join(f"{k:,}" for k in counts)
        raise ProblemError(f"a table must have at most {MOST_POINTS:,} points; got {shape}")


def _padded(masks: np.ndarray, gap: np.uint64, grid: Grid) -> np.ndarray:
    more = [(0, size - k) for size, k in zip(grid.counts, masks.shape)]
    return np.pad(masks, more, constant_values=gap)


def _merged(masks: np.ndarray, grid: Grid, gap: int) -> CellTree:
    """Return the cells of a grid of masks; label `gap` where its bit is set."""
    blocks, own = merged(masks, grid)
    labels = preferred(own[:, None], range(gap + 1)).astype(np.int64)
    entries = np.where(blocks < 0, -1 - labels, blocks).astype(np.int32)
    free = np.flatnonzero(several(own[:, None]))
    return CellTree(grid, entries, free.astype(np.int32), own[free])


def _array(name: str, value: Any) -> np.ndarray:
    """Return an array of any kind; `ProblemError` where lists are ragged."""
    try:
        return np.asarray(value)
    except (TypeError, ValueError):
        raise ProblemError(
            f"`{name}` must be a grid, with rows of equal lengths; got {describe(value)}"
        ) from None


def _text(state: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.6g}" for v in state) + ")"
