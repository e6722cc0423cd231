"""Free settings of a problem: a range or choices in place of a value."""

from __future__ import annotations

import inspect
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from capsyn.errors import ProblemError
from capsyn.validation import describe, finite_number, keep, true_or_false

DECADE = 10.0
"""Ratio of the bounds from which on a range is searched by its logarithm."""
EDGE = 0.05
"""Share of a range that is its edge."""
DIGITS = 4
"""Significant digits of values that are found."""


@dataclass(frozen=True)
class Free:
    """A range, or choices, in place of a value that `capsyn.tune` shall find.

    Use it as the default of an argument of a function that returns the problem:
    ``def problem(speed=capsyn.Free(0.1, 10)): return capsyn.Problem(..)``.

    Parameters
    ----------
    low, high : float, or text as ``"1%"``
        Bounds of the range, ``low < high``.
    log : bool, optional
        Whether the range is searched by its logarithm. Default: if ``high`` is ten times ``low`` or
        more.
    choices : sequence, optional
        Values to choose from, in place of a range: texts, numbers or None.

    Raises
    ------
    ProblemError
        Bounds or choices that cannot be used.
    """

    low: Any = None
    high: Any = None
    log: bool | None = field(default=None, kw_only=True)
    choices: Sequence[Any] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.choices is not None:
            self._check_choices(self.choices)
            return
        low, high = self.bounds
        if self.is_share and not all(str(b).endswith("%") for b in (self.low, self.high)):
            raise ProblemError(f"`Free` must have two numbers or two shares; got {describe(self)}")
        if not low < high:
            raise ProblemError(f"`Free` must have low < high; got {self.low} and {self.high}")
        if self.log is None:
            keep(self, log=low > 0 and high >= DECADE * low)
        true_or_false("log", self.log)
        if self.log and low <= 0:
            raise ProblemError(f"`Free` must have low > 0 with `log`; got {self.low}")

    def _check_choices(self, choices: Any) -> None:
        if (self.low, self.high, self.log) != (None, None, None):
            raise ProblemError("`Free` must have either bounds or `choices`; got both")
        known = isinstance(choices, Sequence) and not isinstance(choices, str)
        if not known or len(choices) < 2:
            raise ProblemError(f"`choices` must be two or more values; got {describe(choices)}")
        for value in choices:
            if not isinstance(value, str | int | float | None):
                raise ProblemError(
                    f"`choices` must be texts, numbers or None; got {describe(value)}"
                )
        keep(self, choices=tuple(choices))

    @property
    def is_share(self) -> bool:
        """Whether the bounds are shares, given as texts."""
        return isinstance(self.low, str) or isinstance(self.high, str)

    @property
    def bounds(self) -> tuple[float, float]:
        """The bounds as numbers, which are percents for shares."""
        texts = (b.removesuffix("%") if isinstance(b, str) else b for b in (self.low, self.high))
        low, high = (_number(name, b) for name, b in zip(("low", "high"), texts))
        return low, high

    def value(self, found: Any) -> Any:
        """Return the value of the setting for `found`, a number within the bounds or a choice."""
        if self.choices is not None:
            return found
        low, high = self.bounds
        digits = DIGITS - 1 - math.floor(math.log10(min(high - low, abs(found) or high - low)))
        rounded = min(max(round(found, digits), low), high)
        return f"{rounded!r}%" if self.is_share else rounded

    def at(self, share: float) -> Any:
        """Return the number, or the choice, at a share in [0, 1] of the range."""
        if self.choices is not None:
            return self.choices[min(int(share * len(self.choices)), len(self.choices) - 1)]
        low, high = self.bounds
        found = low * (high / low) ** share if self.log else low + (high - low) * share
        return min(max(found, low), high)

    @property
    def middle(self) -> Any:
        """The value in the middle of the range, or the first choice."""
        return self.value(self.at(0.0 if self.choices is not None else 0.5))

    def edge(self, value: Any) -> Any:
        """Return the bound at which a `value` lies; None if it lies between, or is a choice."""
        if self.choices is not None:
            return None
        number = _number("value", value.removesuffix("%") if isinstance(value, str) else value)
        if number <= self.at(EDGE):
            return self.low
        return self.high if number >= self.at(1 - EDGE) else None

    def to_json(self) -> dict[str, Any]:
        """Return the range, or the choices, as plain data."""
        if self.choices is not None:
            return {"choices": list(self.choices)}
        return {"low": self.low, "high": self.high, "log": self.log}

    def __str__(self) -> str:
        if self.choices is not None:
            return ", ".join(map(str, self.choices))
        return f"{self.low} to {self.high}"


def _number(name: str, value: Any) -> float:
    """Return a finite number, also from a text."""
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            value = math.nan
    return finite_number(name, value)


def free_arguments(function: Any) -> dict[str, Free]:
    """Return what is free among the arguments of a function, by name; nothing of other things."""
    if not inspect.isfunction(function):
        return {}
    parameters = inspect.signature(function).parameters.values()
    return {p.name: p.default for p in parameters if isinstance(p.default, Free)}
