"""C source of kernels: declarations, programs as lanes, and the hand-written loops."""

from __future__ import annotations

import ctypes
import functools
import platform
import sys
from collections.abc import Iterable
from importlib import resources

import numpy as np

from capsyn.native.compiler import find_compiler
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program

LANES = 64
"""States that a kernel of batches handles side by side."""
INLINE = {"sqrt": 1, "fabs": 1, "floor": 1, "ceil": 1, "rint": 1, "copysign": 2}
"""Functions that compilers turn into instructions by themselves, with their arity."""


def hand_written(path: str) -> str:
    """Return the text of a C file of capsyn, such as ``policies/lookup.c``."""
    return resources.files("capsyn").joinpath(path).read_text(encoding="utf-8")


def declarations(programs: Iterable[Program], precision: str, lanes: int) -> str:
    """Return the types, constants and functions that emitted programs use.

    Every function ``m_NAME`` keeps loops over lanes vectorised: it is the C library's vector
    version where the library has one (declared by hand, so that no ``-ffast-math`` is needed, and
    under another name, so that GCC does not merge sin and cos into a scalar sincos), else a call
    for each lane inside a function that is itself vectorised.
    """
    suffix = "f" if precision == "single" else ""
    real = "float" if precision == "single" else "double"
    lines = [
        "#include <math.h>",
        "#include <stdint.h>",
        "#include <stdlib.h>",
        f"typedef {real} real;",
        f"#define LANES {lanes}",
        "#define ZERO ((real)0)",
        "#define ONE ((real)1)",
        '#define EACH_LANE _Pragma("omp simd") for (int lane = 0; lane < LANES; ++lane)',
    ]
    lines += [f"#define m_{name} {name}{suffix}" for name in INLINE]
    used = {name for program in programs for name, *_ in program.instructions}
    clang = find_compiler().is_clang
    for name in sorted(used):
        if name == "const" or not OPERATIONS[name].libm or name in INLINE:
            continue
        arity = OPERATIONS[name].arity
        types = ", ".join(["real"] * arity)
        if clang:
            lines.append(f"#define m_{name} {name}{suffix}")
        elif lanes > 1 and _has_vector_version(name + suffix, arity, precision):
            lines.append(
                f'extern real m_{name}({types}) __asm__("{name}{suffix}")'
                ' __attribute__((simd("notinbranch"), const));'
            )
        else:
            names = ["a", "b"][:arity]
            parameters = ", ".join(f"real {n}" for n in names)
            lines += [
                "#pragma omp declare simd notinbranch",
                f"static __attribute__((noinline, const)) real m_{name}({parameters})",
                f"{{ return {name}{suffix}({', '.join(names)}); }}",
            ]
    return "\n".join(lines) + "\n"


@functools.lru_cache(maxsize=1)
def _vector_library() -> tuple[ctypes.CDLL, str] | None:
    """Return glibc's vector library and the letter of its smallest instruction set."""
    letter = {"x86_64": "b", "aarch64": "n"}.get(platform.machine())
    if sys.platform != "linux" or letter is None:
        return None
    try:
        return ctypes.CDLL("libmvec.so.1"), letter
    except OSError:
        return None


def _has_vector_version(function: str, arity: int, precision: str) -> bool:
    vectors = _vector_library()
    if vectors is None:
        return False
    library, letter = vectors
    lanes = 4 if precision == "single" else 2
    return hasattr(library, f"_ZGV{letter}N{lanes}{'v' * arity}_{function}")


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return where an array lies, as an argument of a kernel."""
    return ctypes.c_void_p(array.ctypes.data)
