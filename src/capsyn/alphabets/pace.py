"""How far a piece of work is, and about how long it still takes, as a text."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Pace:
    """Says what comes next of some equal parts, and the time that is left.

    Parameters
    ----------
    say : callable, optional
        What takes the text.
    what : str
        What is being done.
    parts : int
        Number of parts.
    """

    say: Callable[[str], None] | None
    what: str
    parts: int
    done: int = 0
    start: float = field(default_factory=time.monotonic)

    def next(self, text: str = "") -> None:
        """Say that the next part begins, and what it is."""
        told = f" {text}" if text else ""
        self.tell(f"{self.what}{told}: {self.done + 1} of {self.parts}")
        self.done += 1

    def tell(self, text: str) -> None:
        """Say a text, with the time that is left for the parts that are not done."""
        if self.say is not None:
            left = ""
            if self.done:
                each = (time.monotonic() - self.start) / self.done
                left = f", {duration(each * (self.parts - self.done))} left"
            self.say(f"{text}{left}")


def duration(seconds: float) -> str:
    """Return a time in the unit that fits it."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"about {seconds / size:.0f} {unit}"
    return f"about {seconds:.0f} s"
