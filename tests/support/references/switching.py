"""What is in force from step to step, in plain Python: slow, readable, independent.

It is the rule of docs/switching.md and docs/dwell.md, for one trial.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

SLACK = 1e-9
"""Share of a least time by which it may be short, by rounding."""


def kinds_of(controls: Sequence, prices: Sequence) -> list[int]:
    """Return numbers of labels, equal where a change between them is no switch.

    Their `controls` are equal then, and none of those that have that control has a price to another
    of them; `prices` are from each to each, infinite where forbidden.
    """
    kinds = []
    for k, control in enumerate(controls):
        alike = [j for j, other in enumerate(controls) if other == control]
        paid = any(prices[i][j] for i in alike for j in alike)
        kinds.append(k if paid else alike[0])
    return kinds


class InForce:
    """The label in force, the default's before the first step; labels are symbols and the default.

    `controls` and `kinds` are of labels, as are the times `holds`; `input_holds` are of inputs,
    `forbidden` pairs of labels; the symbol `safe` is wanted for `hold_off` after the first step.
    """

    def __init__(
        self,
        controls: Sequence[Sequence[float]],
        kinds: Sequence[int],
        holds: Sequence[float],
        input_holds: Sequence[float],
        forbidden: Collection[Sequence[int]],
        safe: int = 0,
        hold_off: float = 0.0,
    ) -> None:
        self.controls, self.kinds, self.holds = controls, kinds, holds
        self.input_holds, self.forbidden = input_holds, {tuple(pair) for pair in forbidden}
        self.safe, self.hold_off = safe, hold_off
        self.default = self.now = len(controls) - 1
        self.start: float | None = None

    def step(self, wanted: int, at_once: bool, time: float) -> int:
        """Return the label in force from a time on, at which one is wanted, perhaps at once."""
        first = self.start is None
        if first:
            self.start = self.entered = time
            self.changed = [time] * len(self.input_holds)
        if not _is_over(self.start, self.hold_off, time):
            wanted = self.safe
        same = self.kinds[wanted] == self.kinds[self.now]
        taken = wanted if first or at_once or same else self._waiting(wanted, time)
        if self.kinds[taken] != self.kinds[self.now]:
            self.entered = time
        for i, (old, new) in enumerate(zip(self.controls[self.now], self.controls[taken])):
            if old != new:
                self.changed[i] = time
        self.now = taken
        return taken

    def _waiting(self, wanted: int, time: float) -> int:
        """Return what is taken where times are waited for."""
        now = self.now
        if not _is_over(self.entered, self.holds[now], time):
            return now
        mixed = [
            new if _is_over(since, hold, time) else old
            for since, hold, old, new in zip(
                self.changed, self.input_holds, self.controls[now], self.controls[wanted]
            )
        ]
        if mixed == list(self.controls[wanted]):
            return wanted  # nothing of it is held
        if mixed == list(self.controls[now]):
            return now  # nothing else of it changes
        for symbol in range(self.default):
            if mixed == list(self.controls[symbol]) and (now, symbol) not in self.forbidden:
                return symbol
        return now


def _is_over(since: float, hold: float, time: float) -> bool:
    return time - since >= hold * (1 - SLACK)
