"""How many threads there is work for."""

from __future__ import annotations

import os
from typing import Any

from capsyn.validation import whole_number


def processors(threads: Any = None) -> int:
    """Return a number of threads: as given, else one per processor that this process may use."""
    if threads is not None:
        return whole_number("threads", threads, least=1)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
