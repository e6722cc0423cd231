"""A problem as a function of its free settings."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from capsyn.errors import ProblemError
from capsyn.modelling.problem import Problem
from capsyn.modelling.switching import Switching
from capsyn.tuning.free import Free, free_arguments
from capsyn.validation import called, describe


def _with_settings(problem: Problem, **changes: Any) -> Problem:
    return problem.replace(settings=dataclasses.replace(problem.settings, **changes))


def _priced(problem: Problem, price: Any) -> Problem:
    own = problem.switching or Switching()
    return problem.replace(switching=dataclasses.replace(own, price=price))


def _tailed(problem: Problem, tail: Any) -> Problem:
    text = tail if isinstance(tail, str | None) else f"riccati:{float(tail)!r}"
    own = None if text is not None and text.startswith("riccati") else problem.horizon
    return problem.replace(tail=text, horizon=own)


CHANGES: dict[str, Callable[[Problem, Any], Problem]] = {
    "tail": _tailed,
    "horizon": lambda problem, time: problem.replace(
        horizon=round(time) if problem.discrete else time
    ),
    "rule": lambda problem, rule: _with_settings(problem, rule=rule),
    "gamma": lambda problem, gamma: _with_settings(problem, gamma=gamma, alpha_d=None),
    "control_weight": lambda problem, r: _with_settings(problem, control_weight=r),
    "price": _priced,
}
"""What any problem may leave free, by name, in the order in which it is changed.

A number is the effort of a Riccati tail, which brings its horizon; ``price`` is that of a switch.
"""


@dataclass(frozen=True, eq=False)
class Family:
    """The problems that free settings make.

    Parameters
    ----------
    source : Problem, or function that returns one
        Its arguments are settings; others are those of `CHANGES`.
    free : dict of name to Free
        What is free.
    """

    source: Any
    free: dict[str, Free]

    @staticmethod
    def of(source: Any, free: Mapping[str, Free] | None = None) -> Family:
        """Return the family of a problem, or function, where `free` adds to what is free in it.

        Raises
        ------
        ProblemError
            It is neither, or a name is no setting of it.
        """
        own = free_arguments(source)
        if not isinstance(source, Problem) and not inspect.isfunction(source):
            raise ProblemError(
                "`problem` must be a capsyn.Problem, or a function that returns one; got "
                f"{describe(source)}"
            )
        for name, value in (free or {}).items():
            _check_name(source, name)
            if not isinstance(value, Free):
                raise ProblemError(f"`free` {name} must be a capsyn.Free; got {describe(value)}")
        return Family(source, {**own, **(free or {})})

    def __call__(self, settings: Mapping[str, Any]) -> Problem:
        """Return the problem with values for all that is free."""
        return with_settings(self.source, settings)

    @property
    def middle(self) -> dict[str, Any]:
        """The settings in the middle of their ranges."""
        return {name: free.middle for name, free in self.free.items()}


def with_settings(source: Any, settings: Mapping[str, Any]) -> Problem:
    """Return the problem that settings make of a problem, or of a function that returns one.

    Raises
    ------
    ProblemError
        A name that is no setting of it, something that stays free, or a value that cannot be used.
    """
    for name in settings:
        _check_name(source, name)
    problem, own = source, _arguments(source)
    if not isinstance(source, Problem):
        missing = [name for name in free_arguments(source) if name not in settings]
        if missing:
            raise ProblemError(f"the settings must have all that is free; {missing[0]} is missing")
        given = {name: value for name, value in settings.items() if name in own}
        problem = called(source.__name__, lambda: source(**given))
        if not isinstance(problem, Problem):
            raise ProblemError(
                f"`{source.__name__}` must return a capsyn.Problem; got {describe(problem)}"
            )
    for name, change in CHANGES.items():
        if name in settings and name not in own:
            problem = change(problem, settings[name])
    return problem


def _arguments(source: Any) -> list[str]:
    return [] if isinstance(source, Problem) else list(inspect.signature(source).parameters)


def _check_name(source: Any, name: str) -> None:
    """Raise unless a name is that of an argument of the function, or of `CHANGES`."""
    own = _arguments(source)
    if name not in own and name not in CHANGES:
        known = ", ".join(dict.fromkeys([*own, *CHANGES]))
        raise ProblemError(f"there is no setting '{name}' to be free; known are {known}")
