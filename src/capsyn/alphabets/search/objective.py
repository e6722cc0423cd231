"""What an alphabet should make least: figures of its closed loops, each with a weight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.alphabets.judged import weighed
from capsyn.alphabets.loops.alphabet_loops import FIGURES, LoopFigures
from capsyn.errors import ProblemError
from capsyn.validation import describe, finite_number


@dataclass(frozen=True)
class Objective:
    """Weights of the figures of a closed loop, whose mean over loops is to be least.

    Parameters
    ----------
    weights : mapping of name to float
        Weights >= 0 of some `FIGURES`, one of them > 0 at least.

    Raises
    ------
    ProblemError
        Other names or weights.
    """

    weights: Mapping[str, float]

    @staticmethod
    def of(given: Any) -> Objective:
        """Return the objective of an argument: a mapping, one name, or None for the cost."""
        if given is None or isinstance(given, str):
            given = {given or "cost": 1.0}
        wanted = f"`objective` must be weights by name, of {', '.join(FIGURES)}; got "
        if not isinstance(given, Mapping) or not given:
            raise ProblemError(wanted + describe(given))
        for name in given:
            if name not in FIGURES:
                raise ProblemError(wanted + describe(name))
        weights = {
            name: finite_number(f"objective {name}", given[name], least=0.0)
            for name in FIGURES
            if name in given
        }
        if not any(weights.values()):
            raise ProblemError(wanted + "no weight that is not 0")
        return Objective(weights)

    def values(self, found: LoopFigures) -> np.ndarray:
        """Return the objective (A, S) of each loop; of those that are lost it is NaN."""
        total = sum(weight * found.figures[name] for name, weight in self.weights.items())
        return np.where(found.lost, np.nan, total)

    def __str__(self) -> str:
        return weighed(self.weights)
