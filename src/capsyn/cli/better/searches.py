"""Options of the commands that search by closed loops, and what loops these mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from capsyn.cli.loop import LoopTexts, loop_options
from capsyn.cli.options import INITIAL, number_or_range, option, starts

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem

RUN_BY = ("seed", "backend", "threads", "executor", "stop_at_target", "avoid", "stay_in", "costs")
"""Options of a loop that are not those of the loops of a search."""


@dataclass(frozen=True)
class SearchTexts(LoopTexts):
    """How the closed loops of a search run, as texts."""

    initial: str | None = option(
        f"Where loops start: {INITIAL}",
        metavar="SET",
        before="target",
    )
    within: float | None = option(
        "Time within which a loop must arrive [time unit].", before="model"
    )
    hold: float | None = option(
        "Time at the end for which a loop must stay in the target [time unit] [default: 0].",
        before="model",
    )

    not_asked: ClassVar[tuple[str, ...]] = RUN_BY
    max_solves: int | None = option("Most solves of a policy, as in synth.", before="initial")

    @property
    def solves(self) -> dict[str, int]:
        """The arguments of `capsyn.synthesize` that are given."""
        return {} if self.max_solves is None else {"max_solves": self.max_solves}

    @property
    def synth(self) -> str:
        """What a command ``capsyn synth`` takes of them, after the other options."""
        return "".join(f" --max-solves {value}" for value in self.solves.values())

    def loops(self, problem: Problem) -> dict[str, Any]:
        """Return how loops of a problem run, as arguments of `capsyn.monte_carlo`."""
        loop = loop_options(problem, self, one=number_or_range, each=number_or_range)
        own = {name: value for name, value in vars(loop).items() if name not in self.not_asked}
        initial = starts(self.initial, problem.domain.names)
        return own | {"initial": initial, "within": self.within, "hold": self.hold or 0.0}
