"""A quadratic terminal cost around a goal, smooth where axes are periodic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Tail:
    """A terminal cost ``V = d^T P d`` that stands for the cost to go near a goal.

    `riccati_tail` and `fitted_tail` return it. In the formula, d is the distance from the goal. A
    periodic axis of period L has the angle ``a = 2 pi d / L`` and ``s = L / (2 pi)``. On this axis
    d is ``s sin a``, and ``P[i, i] s^2 (1 - cos a)^2`` is added to V. V is therefore smooth
    everywhere, is 0 only at the goal, and has the same second derivatives there.

    Parameters
    ----------
    matrix : (n, n)
        P [cost / state unit^2], positive semidefinite.
    goal : (n,), or callable ``w -> n components``
        The goal [state units], or a function that gives the goal for exogenous inputs w.
    control : (m,)
        The mean control of the mixture of symbols that holds the goal [input units].
    effort : float or None
        The weight of the inputs; None for a fitted tail.
    horizon : float
        Proposed prediction horizon [time unit].
    periods : (n,)
        Periods of the axes [state units]; 0 for an axis that is not periodic.
    """

    matrix: np.ndarray
    goal: np.ndarray | Callable[..., Any]
    control: np.ndarray
    effort: float | None
    horizon: float
    periods: np.ndarray

    @property
    def text(self) -> str:
        """The tail in one line."""
        goal = "a function of w" if callable(self.goal) else _list(self.goal)
        kind = "fitted tail" if self.effort is None else f"Riccati tail of effort {self.effort:g}"
        return f"{kind}: goal {goal}, held by {_list(self.control)}, horizon {self.horizon:.3g}"

    def __call__(self, x: Any, w: Any = None) -> Any:
        """Return V at a state x (n,) with exogenous inputs w (k,), as CasADi columns or arrays."""
        goal = self.goal(w) if callable(self.goal) else self.goal
        offsets, value = [], 0.0
        for i, period in enumerate(self.periods):
            off = x[i] - goal[i]
            if period:
                scale = period / (2 * np.pi)
                angle = off / scale
                off = scale * np.sin(angle)
                value = value + self.matrix[i, i] * (scale * (1 - np.cos(angle))) ** 2
            offsets.append(off)
        for i, off in enumerate(offsets):
            row = sum(2 * self.matrix[i, j] * offsets[j] for j in range(i + 1, len(offsets)))
            value = value + off * (self.matrix[i, i] * off + row)
        return value


def _list(values: np.ndarray) -> str:
    return f"({', '.join(f'{value:.4g}' for value in values)})"
