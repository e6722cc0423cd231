"""How many threads there is work for, and a pool of them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from capsyn.validation import whole_number


def processors(threads: Any = None) -> int:
    """Return a number of threads: as given, else one per processor that this process may use."""
    if threads is not None:
        return whole_number("threads", threads, least=1)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def pool_of(threads: int) -> Iterator[ThreadPoolExecutor]:
    """Yield a pool of threads that is not waited for where an error, or Ctrl-C, ends its use."""
    pool = ThreadPoolExecutor(threads)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
