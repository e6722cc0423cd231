"""What a subdivision may take: solves, seconds, memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from capsyn.execution.memory import memory
from capsyn.validation import finite_number, whole_number


@dataclass(frozen=True)
class Limits:
    """What a subdivision may take; see `subdivide`.

    `room` is what a block of cells took before [bytes], where a run goes on: blocks stay as they
    were unless there is no longer memory for them.
    """

    max_solves: int | None = None
    max_seconds: float | None = None  # [s]
    max_memory: int | None = None  # [bytes]
    memory_limit: int | None = None  # what a run may need at worst [bytes]
    room: int | None = None

    @staticmethod
    def of(max_solves: Any, max_seconds: Any, max_memory: Any, memory_limit: Any) -> Limits:
        """Return validated limits; None where there is none."""
        return Limits(
            None if max_solves is None else whole_number("max_solves", max_solves, least=1),
            None if max_seconds is None else finite_number("max_seconds", max_seconds, above=0.0),
            None if max_memory is None else memory("max_memory", max_memory),
            None if memory_limit is None else memory("memory_limit", memory_limit),
        )
