"""Lyapunov evidence: the sign of dV/dt along the closed loop, on a grid and proved cell by cell.

Under a policy that remembers, several symbols may be in force at a state: all symbols of its row
there. dV/dt is then the largest of their values.

Exogenous inputs are constant along a loop. States in this module are readings, with exogenous
inputs last.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.faces import shared_faces
from capsyn.errors import ProblemError
from capsyn.modelling.exogenous import exogenous_text
from capsyn.policies.in_force import reachable
from capsyn.policies.policy import Policy
from capsyn.statistics import TOLD
from capsyn.validation import describe, finite_number, is_list, one_line, whole_number
from capsyn.verification.bisection import Boxes, bisect
from capsyn.verification.loop_derivative import LoopDerivative

MAX_STATES = 50_000_000
"""Most states of a grid."""
CHUNK = 100_000
"""States of the grid that are evaluated at once."""


@dataclass(frozen=True, eq=False)
class LyapunovCells:
    """The cells of a policy that are not proved, in the order of the cell table.

    Parameters
    ----------
    entries : (K,) ints
        Places of the cells in ``policy.cells``.
    levels, symbols : (K,) ints
        Level of subdivision, and the symbol of the value; -1 is the default control.
    boundary : (K,) booleans
        Whether a finest cell, or a leaf of a tree, is on a switching surface: its test points did
        not agree, or a neighbour has another symbol or row.
    lower, upper : (K, n)
        Bounds of the cells [state units].
    states : (K, n)
        For a violated cell, the worst state found [state units]. For an undecided cell, the middle
        of the part with the largest upper bound.
    values : (K,)
        For a violated cell, dV/dt at this state [V / time unit]. For an undecided cell, the upper
        bound, or NaN if dV/dt may be undefined.
    """

    entries: np.ndarray
    levels: np.ndarray
    symbols: np.ndarray
    boundary: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    states: np.ndarray
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.entries)

    def to_json(self) -> list[dict[str, Any]]:
        """Return the first `TOLD` cells as plain data."""
        return [
            {
                "level": int(self.levels[k]),
                "symbol": int(self.symbols[k]),
                "boundary": bool(self.boundary[k]),
                "lower": self.lower[k].tolist(),
                "upper": self.upper[k].tolist(),
                "state": self.states[k].tolist(),
                "value": float(self.values[k]) if np.isfinite(self.values[k]) else None,
            }
            for k in range(min(len(self), TOLD))
        ]


@dataclass(frozen=True, eq=False)
class LyapunovProof:
    """What interval arithmetic proves about dV/dt in the cells of a policy.

    Parameters
    ----------
    function : str
        Name of V.
    depth, max_boxes : int
        The arguments of the proof; see `lyapunov`.
    proved, negative : float
        Shares of the domain's volume for which dV/dt <= 0 is proved, and for which dV/dt < 0 is
        proved, at every state, faces included.
    violated : float
        Share for which dV/dt > 0 is proved.
    undecided : float
        Share of the rest.
    cells, proved_cells, negative_cells : int
        Numbers of all cells, of wholly proved cells, and of cells with dV/dt < 0 wholly proved.
    violated_cells : LyapunovCells
        Cells with a state at which dV/dt > 0 by more than rounding explains.
    undecided_cells : LyapunovCells
        Cells that are neither proved nor violated.
    time_unit : str
        Unit of time of the policy, see `Problem`.
    exogenous : str
        Exogenous inputs with their bounds, or empty. Their volume counts, too. A full proof holds
        for every constant value of the inputs.
    """

    function: str
    depth: int
    max_boxes: int
    proved: float
    negative: float
    violated: float
    undecided: float
    cells: int
    proved_cells: int
    negative_cells: int
    violated_cells: LyapunovCells
    undecided_cells: LyapunovCells
    time_unit: str = "s"
    exogenous: str = ""

    def __repr__(self) -> str:
        return (
            f"LyapunovProof('{self.function}', dV/dt <= 0 proved on {self.proved:.3%} of the "
            f"volume, violated on {self.violated:.3%}, undecided {self.undecided:.3%})"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the proof as plain data, with the time unit if it is not s."""
        usual = ("time_unit", "s"), ("exogenous", "")
        told = {k: v for k, v in vars(self).items() if (k, v) not in usual}
        return told | {
            "violated_cell_count": len(self.violated_cells),
            "violated_cells": self.violated_cells.to_json(),
            "undecided_cell_count": len(self.undecided_cells),
            "undecided_cells": self.undecided_cells.to_json(),
        }


@dataclass(frozen=True, eq=False)
class LyapunovGrid:
    """The sign of dV/dt at the states of a grid. Faces belong to cells as in the policy.

    Parameters
    ----------
    axes : n arrays
        Positions on each axis [state units], both ends included.
    signs : (len(axes[0]), ..) int8
        Sign of dV/dt: -1, 0 or 1, and 2 for a state at which dV/dt is undefined.
    tolerance : float
        Largest ``|dV/dt|`` that counts as 0 [V / time unit].
    """

    axes: tuple[np.ndarray, ...]
    signs: np.ndarray
    tolerance: float

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of states at which dV/dt is negative, zero, positive and undefined."""
        names = {"negative": -1, "zero": 0, "positive": 1, "undefined": 2}
        return {name: int(np.count_nonzero(self.signs == sign)) for name, sign in names.items()}

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the states at which dV/dt is negative, zero, positive and undefined."""
        return {name: count / self.signs.size for name, count in self.counts.items()}

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data, without the signs of single states."""
        figures = {name: getattr(self, name) for name in ("tolerance", "counts", "shares")}
        return {"states": list(self.signs.shape)} | figures


def lyapunov(
    policy: Policy, V: Callable[..., Any], *, depth: int = 12, max_boxes: int = 100_000
) -> LyapunovProof:
    """Return what interval arithmetic proves about dV/dt in continuous time, cell by cell.

    In every cell, faces included, the control is that of the cell's symbol, or of each symbol that
    may be in force there. At a kink of V, such as ``abs(E)`` at ``E = 0``, all gradients between
    its sides count. V must be positive, which is not checked. Jumps of V are only looked for at
    random pairs of states.

    Parameters
    ----------
    policy : Policy
        A policy with a model.
    V : callable ``x -> scalar``, or ``(x, w) -> scalar`` where there are exogenous inputs
        The function V of CasADi columns, continuous and piecewise differentiable in x.
    depth : int
        How often a cell may be bisected, each time along the axis that decides most.
    max_boxes : int
        Most parts of cells that one round of bisections makes. Parts that get no turn count as
        undecided.

    Returns
    -------
    LyapunovProof
        Shares of the volume, the cells in which V grows, and the undecided cells.

    Raises
    ------
    ProblemError
        A policy without a model, or a V that has no derivative along its dynamics.
    """
    depth = whole_number("depth", depth, least=0)
    max_boxes = whole_number("max_boxes", max_boxes, least=2)
    loop = LoopDerivative(policy, V)
    function = one_line(getattr(V, "__name__", "V"))
    return _Cells(policy).prove(loop, function, depth, max_boxes)


def lyapunov_grid(
    policy: Policy, V: Callable[..., Any], spacing: Any, zero: float = 1e-9
) -> LyapunovGrid:
    """Return the sign of dV/dt at the states of a grid, in ordinary floating point.

    Parameters
    ----------
    policy, V
        The policy and the function V, as in `lyapunov`.
    spacing : float or (n,)
        Largest distance of neighbouring states on each axis [state units].
    zero : float
        Largest ``|dV/dt|`` that counts as 0, as a fraction of the largest one on the grid.

    Raises
    ------
    ProblemError
        An argument that `lyapunov` refuses, or a grid of more than `MAX_STATES` states.
    """
    zero = finite_number("zero", zero, least=0.0)
    loop = LoopDerivative(policy, V)
    domain = policy.space
    spacings = spacing if is_list(spacing, domain.n) else (spacing,) * domain.n
    spacings = [finite_number("spacing", value, above=0.0) for value in spacings]
    # 1e-9: a width that is a multiple of the spacing up to rounding gives no further state
    steps = [
        max(math.ceil(min(width / distance, 1e18) - 1e-9), 1)
        for width, distance in zip(domain.widths.tolist(), spacings)
    ]
    shape = tuple(k + 1 for k in steps)
    if math.prod(shape) > MAX_STATES:
        raise ProblemError(
            f"`spacing` must give at most {MAX_STATES} states; {describe(spacing)} gives "
            f"{math.prod(shape)}"
        )
    axes = tuple(domain.faces(i, np.arange(k + 1), k) for i, k in enumerate(steps))
    values = np.empty(math.prod(shape))
    for start in range(0, len(values), CHUNK):
        part = np.arange(start, min(start + CHUNK, len(values)))
        places = np.unravel_index(part, shape)
        states = np.stack([axis[k] for axis, k in zip(axes, places)], axis=1)
        values[part] = _largest_value(loop, policy, states)
    sizes = np.abs(values)
    finite = np.isfinite(values)
    tolerance = zero * float(sizes.max(where=finite, initial=0.0))
    signs = np.where(sizes <= tolerance, 0, np.where(finite, np.sign(values), 2)).astype(np.int8)
    return LyapunovGrid(axes, signs.reshape(shape), tolerance)


def _largest_value(loop: LoopDerivative, policy: Policy, states: np.ndarray) -> np.ndarray:
    """Return the largest dV/dt (B,) at states (B, n) of symbols that may be in force, or NaN."""
    before = reachable(policy) if policy.remembers else ()
    values = np.full(len(states), -np.inf)
    for label in (*before, len(policy.alphabet)):
        symbols = policy(states, outside="nearest", current=label)
        values = np.maximum(values, loop.values(states, symbols))
    return values


class _Cells:
    """The leaf cells of a policy as arrays, and what is found in them."""

    def __init__(self, policy: Policy) -> None:
        tree = policy.cells
        self.policy, self.boxes = policy, (boxes := tree.boxes())
        self.entries, self.rows, self.levels = boxes.places, boxes.labels, boxes.levels
        rows, before = policy.transitions, [*reachable(policy), len(policy.alphabet)]
        given = np.zeros(rows.shape, dtype=bool)
        np.put_along_axis(given, rows[:, before], True, axis=1)
        _, self.given = np.nonzero(given)  # the labels that rows give, one row after the other
        self.counts = given.sum(axis=1)
        self.first = np.cumsum(self.counts) - self.counts
        self.shares = boxes.volumes() / np.prod(tree.counts, dtype=float)
        self.lower = policy.space.points(boxes.lower, tree.counts)
        self.upper = policy.space.points(boxes.upper, tree.counts)

    def prove(self, loop: LoopDerivative, function: str, depth: int, most: int) -> LyapunovProof:
        boxes = bisect(
            lambda lower, upper, cells: self._bounds(loop, lower, upper, cells)[:2],
            self.lower.T,
            self.upper.T,
            self.shares,
            depth,
            most,
        )
        violated = self._violated(loop, boxes.take(~boxes.proved))
        left = boxes.take(~boxes.proved & ~np.isin(boxes.cells, violated[0]))
        worst = _largest(left.cells, np.where(np.isnan(left.high), np.inf, left.high))
        ends = left.lower[:, worst], left.upper[:, worst]
        symbols = self._bounds(loop, *ends, left.cells[worst])[2]
        undecided = left.cells[worst], symbols, left.middle.T[worst], left.high[worst]
        count, kinds = len(self.entries), ("proved", "negative", "violated", "undecided")
        shares: dict[str, Any] = {  # which rounding must not lift above the whole
            kind: min(1.0, math.fsum(boxes.shares[getattr(boxes, kind)])) for kind in kinds
        }
        return LyapunovProof(
            function,
            depth,
            most,
            **shares,
            cells=count,
            proved_cells=count - len(np.unique(boxes.cells[~boxes.proved])),
            negative_cells=count - len(np.unique(boxes.cells[~boxes.negative])),
            violated_cells=self._describe(*violated),
            undecided_cells=self._describe(*undecided),
            time_unit=self.policy.time_unit,
            exogenous=exogenous_text(self.policy.exogenous),
        )

    def _in_turn(self, cells: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the labels that may be in force in cells (B,): places (L,) in these, and labels."""
        rows = self.rows[cells]
        for k in range(int(self.counts[rows].max(initial=0))):
            some = np.flatnonzero(self.counts[rows] > k)
            yield some, self.given[self.first[rows[some]] + k]

    def _bounds(
        self, loop: LoopDerivative, lower: np.ndarray, upper: np.ndarray, cells: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return bounds (B,) of dV/dt over boxes in cells (B,), and the label of the upper one."""
        low, high, worst = *np.full((2, len(cells)), -np.inf), np.zeros(len(cells), dtype=np.int64)
        for some, labels in self._in_turn(cells):
            least, most = loop.bounds(lower[:, some], upper[:, some], labels)
            above = ~(most <= high[some]) & ~np.isnan(high[some])  # NaN is the worst
            worst[some[above]] = labels[above]
            low[some], high[some] = np.maximum(low[some], least), np.maximum(high[some], most)
        return low, high, worst

    def _violated(
        self, loop: LoopDerivative, boxes: Boxes
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the cells in which the middle of a box has dV/dt > 0, label, state and dV/dt."""
        states = boxes.middle.T
        values, symbols = np.full(len(states), -np.inf), np.zeros(len(states), dtype=np.int64)
        for some, labels in self._in_turn(boxes.cells):
            points = states[some]
            # bounds at the state alone tell what rounding may explain
            low, _ = loop.bounds(points.T, points.T, labels)
            found = loop.values(points, labels)
            better = (low > 0) & (found > np.maximum(values[some], 0))
            values[some[better]], symbols[some[better]] = found[better], labels[better]
        cells = self.policy.cells
        entries = cells.find(self.policy.space.locate(states, cells.counts))
        kept = np.flatnonzero((values > 0) & (entries == self.entries[boxes.cells]))
        kept = kept[_largest(boxes.cells[kept], values[kept])]
        return boxes.cells[kept], symbols[kept], states[kept], values[kept]

    def _describe(
        self, cells: np.ndarray, labels: np.ndarray, states: np.ndarray, values: np.ndarray
    ) -> LyapunovCells:
        sizes = self.boxes.upper[cells] - self.boxes.lower[cells]
        return LyapunovCells(
            entries=self.entries[cells],
            levels=self.levels[cells],
            symbols=np.where(labels == len(self.policy.alphabet), -1, labels),
            boundary=self.policy.cells.finest(self.entries[cells], sizes) & self._differing(cells),
            lower=self.lower[cells],
            upper=self.upper[cells],
            states=states,
            values=values,
        )

    def _differing(self, cells: np.ndarray) -> np.ndarray:
        """Return which cells are mixed or have a neighbour with another row."""
        tree, boxes = self.policy.cells, self.boxes
        unlike = shared_faces(
            tree,
            lambda below, above: tree.labels_at(below) != tree.labels_at(above),
            self.policy.space.periodic,
        )
        places = np.concatenate([unlike.below, unlike.above, tree.disagreeing])
        return np.isin(boxes.places[cells], places)


def _largest(groups: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the place of the largest value of every group, groups ascending."""
    order = np.lexsort((-values, groups))
    return order[np.unique(groups[order], return_index=True)[1]]
