"""What is wanted of a controller: enough successes, then the least of something."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from capsyn.errors import ProblemError
from capsyn.statistics import check_confidence
from capsyn.tuning.figures import Figures
from capsyn.validation import keep, one_of

LEAST = ("cost", "effort", "switches", "nodes", "knee")
"""What may be least; the knee is that of switches against cost."""
UNMET, UNKNOWN = 2.0, 1.0
"""Where objectives begin of figures that miss the successes, and that have not what is least."""
TIE = 1e-3
"""What cost counts among figures that miss the successes."""


@dataclass(frozen=True)
class Goal:
    """A least share of successes, and what is to be least among all that have it.

    Parameters
    ----------
    success : float, optional
        Least share of successes; None where success is not asked for.
    least : str, optional
        One of `LEAST`. Default: the cost.

    Raises
    ------
    ProblemError
        No goal, or one that cannot be used.
    """

    success: float | None = None
    least: str | None = None

    def __post_init__(self) -> None:
        if self.success is None and self.least is None:
            raise ProblemError(
                "there is no goal: give `success` as a least share, `least` as one of "
                f"{', '.join(LEAST)}, or both"
            )
        if self.success is not None and self.success != 1:
            try:
                keep(self, success=check_confidence(self.success))
            except ProblemError:
                raise ProblemError(
                    f"`success` must be a share in (0, 1]; got {self.success!r}"
                ) from None
        keep(self, least="cost" if self.least is None else one_of("least", self.least, LEAST))

    @property
    def axes(self) -> tuple[str, ...]:
        """The figures that the search makes least: two of a knee."""
        return ("cost", "switches") if self.least == "knee" else (str(self.least),)

    def met(self, figures: Figures) -> bool:
        """Return whether figures have enough successes, and what is to be least."""
        enough = self.success is None or (figures.success or 0.0) >= self.success
        return enough and all(getattr(figures, axis) is not None for axis in self.axes)

    def spares(self, figures: Figures) -> bool:
        """Return whether figures meet the goal by a standard deviation of the successes or more."""
        if self.success is None or not self.met(figures):
            return self.met(figures)
        deviation = math.sqrt(self.success * (1 - self.success) / figures.starts)
        return (figures.success or 0.0) >= min(self.success + deviation, 1.0)

    def objectives(self, figures: Figures) -> list[float]:
        """Return what the search makes least: first the lack of successes, then each figure.

        Where no success is asked for the loops that are lost come first: they cost nothing more.
        A figure y is y / (1 + |y|), below `UNKNOWN`; only the order matters.
        """
        if self.success is not None and (figures.success or 0.0) < self.success:
            lack = self.success - (figures.success or 0.0)
            return [UNMET + lack + TIE * _bounded(figures.cost)] * len(self.axes)
        if self.success is None and figures.lost:
            shares = [figures.lost / figures.starts] * len(self.axes)
            return [
                UNMET + share + TIE * _bounded(getattr(figures, axis))
                for share, axis in zip(shares, self.axes)
            ]
        return [_bounded(getattr(figures, axis)) for axis in self.axes]

    def __str__(self) -> str:
        wanted = [] if self.success is None else [f"success >= {self.success:.6g}"]
        least = "knee of switches against cost" if self.least == "knee" else f"least {self.least}"
        return ", then ".join([*wanted, least])

    def to_json(self) -> dict[str, Any]:
        """Return the goal as plain data."""
        return {"success": self.success, "least": self.least}


def _bounded(figure: float | None) -> float:
    if figure is None or not math.isfinite(figure):
        return UNKNOWN
    return figure / (1 + abs(figure))


def front(candidates: Sequence[Any], axes: Sequence[str]) -> tuple[Any, ...]:
    """Return those of candidates whose `figures` no other beats in one axis at no loss in others.

    Of axes less is better, but of success; one that is None for any candidate does not count.
    """
    known = [a for a in axes if all(getattr(c.figures, a) is not None for c in candidates)]

    def row(candidate: Any) -> list[float]:
        return [(-1 if a == "success" else 1) * getattr(candidate.figures, a) for a in known]

    rows = [row(c) for c in candidates]

    def beaten(k: int) -> bool:
        mine = rows[k]
        return any(
            all(a <= b for a, b in zip(other, mine)) and (other != mine or j < k)
            for j, other in enumerate(rows)
            if j != k
        )

    return tuple(c for k, c in enumerate(candidates) if not beaten(k))
