"""Stories of readings that do not wait for the dwell time, and the symbols that must come of them.

A relay on [-1, 1] counts time in minutes: symbol 0 below 0, symbol 1 from there on; 2 is another
control. There is a reading a second, and 0.05 minutes are three of them, so that a control is held
at readings k, k + 1 and k + 2 before another is taken at k + 3.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from capsyn import Policy
from support.closed_loops import grid_policy, relay_problem

NAN, INF = float("nan"), float("inf")
RATE, DWELL = 60.0, 0.05
"""Readings a minute, and least minutes between switches."""


@dataclass(frozen=True)
class Story:
    """Readings in order and the symbols in force after each; -1 is the default control."""

    name: str
    readings: tuple[float, ...]
    symbols: tuple[int, ...]
    switches: int
    outside: Any = 2
    at_once: bool = False
    default: float = 0.0

    @property
    def policy(self) -> Policy:
        """The relay, under the rule of the story."""
        problem = relay_problem(
            dynamics=lambda x, u: [0 * u[0]], alphabet=[1.0, -1.0, 3.0], time_unit="min"
        )
        return dataclasses.replace(
            grid_policy(problem, [0, 1], [2]),
            default=[self.default],
            outside=self.outside,
            min_dwell=DWELL,
            time_unit="min",
            outside_at_once=self.at_once,
        )


LOW, HIGH = -0.5, 0.5
STORIES = (
    Story(
        "not finite, one reading after a switch; finite again waits anew",
        (LOW, LOW, LOW, HIGH, NAN, HIGH, HIGH, HIGH, LOW),
        (0, 0, 0, 1, 2, 2, 2, 1, 1),
        3,
    ),
    Story(
        "infinite twice: the second changes nothing, and is not held anew",
        (HIGH, INF, -INF, LOW, LOW, LOW),
        (1, 2, 2, 2, 0, 0),
        2,
    ),
    Story(
        "outside waits, and is over before its turn",
        (LOW, LOW, LOW, HIGH, 1.5, HIGH, HIGH, 1.5, HIGH),
        (0, 0, 0, 1, 1, 1, 1, 2, 2),
        2,
    ),
    Story(
        "outside at once; inside again waits anew",
        (LOW, LOW, LOW, HIGH, 1.5, HIGH, HIGH, HIGH, HIGH),
        (0, 0, 0, 1, 2, 2, 2, 1, 1),
        3,
        at_once=True,
    ),
    Story(
        "outside at once with the nearest symbol",
        (LOW, LOW, LOW, HIGH, -1.5, HIGH, HIGH, HIGH),
        (0, 0, 0, 1, 0, 0, 0, 1),
        3,
        outside="nearest",
        at_once=True,
    ),
    Story(
        "nearest waits",
        (LOW, LOW, LOW, HIGH, -1.5, HIGH, HIGH),
        (0, 0, 0, 1, 1, 1, 1),
        1,
        outside="nearest",
    ),
    Story(
        "a safe control that is in force already is no switch, and is not held anew",
        (LOW, LOW, LOW, HIGH, NAN, LOW, LOW, LOW),
        (0, 0, 0, 1, -1, -1, 0, 0),
        2,
        outside=-1,
        default=-1.0,
    ),
    Story(
        "the same where it is outside, at once",
        (LOW, LOW, LOW, HIGH, 2.0, LOW, LOW, LOW),
        (0, 0, 0, 1, -1, -1, 0, 0),
        2,
        outside=-1,
        at_once=True,
        default=-1.0,
    ),
    Story("not finite at first is held like any other", (NAN, LOW, LOW, LOW), (2, 2, 2, 0), 1),
)
"""What must come of readings, reading by reading."""
