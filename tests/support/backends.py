"""The two that compute the same: NumPy, and compiled C where there is a compiler."""

import pytest

from capsyn.errors import KernelBuildError
from capsyn.native.compiler import find_compiler


def has_compiler():
    try:
        find_compiler()
    except KernelBuildError:
        return False
    return True


needs_compiler = pytest.mark.skipif(not has_compiler(), reason="there is no C compiler")


backends = pytest.mark.parametrize(
    "backend", ["numpy", pytest.param("c", marks=needs_compiler)], ids=str
)
