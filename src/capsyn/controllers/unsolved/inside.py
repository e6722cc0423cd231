"""Test points that have no finite answer themselves: the limit from inside a cell of theirs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from capsyn.cells.masks import empty
from capsyn.modelling.domain import Box

NEAREST, FARTHEST = 1 / 8, 1 / 4
"""How far inside, in widths of the finest cells: along the last axis, and along the first.

They differ so that no point goes along a diagonal, where differences of states stay 0.
"""


class InsideAnswers:
    """Answers of a labelling function that has none where a gradient is infinite, as at sqrt(0).

    A state without an answer, at which the model itself is `defined`, is asked again a part of the
    finest cells' width farther in, towards the middle of the domain; the answer there stands for
    the limit. That is no farther than cells tell states apart, and far enough for the steps of an
    integration, whose own gradient grows without bound towards such a point while that of the flow
    does not.
    """

    def __init__(
        self,
        label: Callable[[np.ndarray], Any],
        defined: Callable[[np.ndarray], np.ndarray],
        domain: Box,
        cells: Sequence[int],
    ) -> None:
        self._label, self._defined = label, defined
        self._middle = (domain.lower + domain.upper) / 2
        self._moves = np.linspace(FARTHEST, NEAREST, domain.n) * domain.widths / np.array(cells)
        self._lock = threading.Lock()
        self._count = 0
        self._example: tuple[float, ...] | None = None

    def __call__(self, states: np.ndarray) -> Any:
        """Return masks of states (B, n), or masks and scores."""
        answer = self._label(states)
        lost = _lost(answer)
        lost[lost] = self._defined(states[lost]) if lost.any() else False
        if not lost.any():
            return answer
        moved = states[lost]
        moved = moved + np.where(moved > self._middle, -self._moves, self._moves)
        other = self._label(moved)
        found = ~_lost(other)
        places = np.flatnonzero(lost)[found]
        if isinstance(answer, tuple):
            answer = tuple(_replaced(a, places, b[found]) for a, b in zip(answer, other))
        else:
            answer = _replaced(answer, places, other[found])
        with self._lock:
            self._count += len(places)
            for state in map(tuple, states[places].tolist()):
                self._example = state if self._example is None else min(state, self._example)
        return answer

    def statistics(self) -> dict[str, Any]:
        """Return how many states were answered so, and one of them; nothing where none was."""
        if self._example is None:
            return {}
        return {"limit_points": self._count, "limit_example": list(self._example)}


def _lost(answer: Any) -> np.ndarray:
    """Return which states (B,) of an answer have none."""
    masks = answer[0] if isinstance(answer, tuple) else answer
    return np.asarray(empty(masks.reshape(len(masks), -1, masks.shape[-1])).any(axis=1))


def _replaced(array: np.ndarray, places: np.ndarray, rows: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[places] = rows
    return array
