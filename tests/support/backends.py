"""The two that compute the same: NumPy, and compiled C where there is a compiler."""

import pytest

from capsyn.native.compiler import has_compiler

needs_compiler = pytest.mark.skipif(not has_compiler(), reason="there is no C compiler")


backends = pytest.mark.parametrize(
    "backend", ["numpy", pytest.param("c", marks=needs_compiler)], ids=str
)
