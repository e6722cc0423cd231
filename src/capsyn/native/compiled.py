"""A compiled kernel, or none where its NumPy twin is to do the work."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from capsyn.errors import KernelBuildError, warn
from capsyn.validation import BACKENDS, one_of

Kernel = TypeVar("Kernel")


def compiled(build: Callable[[], Kernel], backend: str, doing: str = "") -> Kernel | None:
    """Return the kernel that `build` gives, or None where NumPy is to be used.

    Backend "auto" takes the kernel where it can be built; with "c" a `KernelBuildError` is raised
    where it cannot. `doing` is what is done with NumPy instead, for a warning; none is given
    without it.
    """
    one_of("backend", backend, BACKENDS)
    if backend == "numpy":
        return None
    try:
        return build()
    except KernelBuildError as error:
        if backend == "c":
            raise
        if doing:
            warn(f"{doing} with NumPy: {error}")
        return None
