"""The C compiler that builds kernels, and the flags that it is given on this system.

On Windows a library exports nothing unless it is asked to, code needs no flag to be independent of
its place, and mathematical functions are in the C library. GCC there cannot align the stack to 32
bytes, so that its AVX code must load and store unaligned [1]_; an assembler that does not know the
flag fails, and the plain flags, without AVX, are taken.

References
----------
.. [1] GCC bug 54412, "minimal 32-byte AVX stack aligned variable mingw64 crash".
"""

from __future__ import annotations

import functools
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from capsyn.errors import KernelBuildError

FLAGS = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fopenmp-simd")
GCC_FLAGS = ("-fno-tree-sink", "-fno-thread-jumps", "-fno-tree-pre")
"""Else GCC moves what one branch of a selection needs into that branch, and the loop over lanes is
scalar: 9 times slower for ``if_else(x > 0, sin(x), exp(x))``, 6 times for a saturated law."""
CLANG_WITH_GLIBC = ("-fveclib=libmvec", "-mllvm", "-force-vector-interleave=2")
"""Vector functions of glibc's own library. All registers are theirs at a call, so that four vectors
side by side, which clang would take, wait in memory: a fifth slower than two."""
GCC_ON_WINDOWS = ("-Wa,-muse-unaligned-vector-move",)
PLAIN_FLAGS = ("-O2",)

ON_WINDOWS = sys.platform == "win32"
ENDING = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
"""What the names of shared libraries end in."""
COMMON_FLAGS = ("-std=gnu11", "-shared") if ON_WINDOWS else ("-std=gnu11", "-fPIC", "-shared")
LIBRARIES = () if ON_WINDOWS else ("-lm",)


@dataclass(frozen=True)
class Compiler:
    """A C compiler: its command, and the first line of ``--version``."""

    command: tuple[str, ...]
    version: str

    @property
    def is_clang(self) -> bool:
        """Whether this is clang, which finds vector functions in its own way."""
        return "clang" in self.version

    @property
    def is_zig(self) -> bool:
        """Whether this is zig's clang, which builds the C library when it is first needed."""
        return any(Path(part).name.startswith("zig") for part in self.command)


def find_compiler() -> Compiler:
    """Return the C compiler that kernels are built by.

    It is ``CC`` if set, else the first of cc, gcc and clang that runs, else that of the package
    ziglang.
    """
    return _find_compiler(os.environ.get("CC", "").strip(), os.environ.get("PATH", ""))


def has_compiler() -> bool:
    """Return whether there is a C compiler."""
    try:
        find_compiler()
    except KernelBuildError:
        return False
    return True


@functools.lru_cache(maxsize=8)
def _find_compiler(cc: str, path: str) -> Compiler:
    zig = zig_program()
    candidates = [_words(cc, path)] if cc else [["cc"], ["gcc"], ["clang"]]
    if zig and not cc:
        candidates.append([zig, "cc"])
    broken: KernelBuildError | None = None
    for command in candidates:
        program = shutil.which(command[0], path=path)
        if not program:
            continue
        arguments = [program, *command[1:]]
        try:
            run = subprocess.run(
                [*arguments, "--version"],
                capture_output=True, encoding="utf-8", errors="replace", timeout=30,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            broken = KernelBuildError(f"the C compiler {program} does not run: {error}", arguments)
            continue
        if "windows-msvc" in run.stdout:
            broken = KernelBuildError(
                f"the C compiler {program} makes code for Microsoft's tools; kernels need that of "
                "zig or MinGW",
                arguments,
            )
        elif run.returncode == 0:
            return Compiler(tuple(arguments), (run.stdout.splitlines() or [""])[0])
        else:
            output = run.stdout + run.stderr
            broken = KernelBuildError(f"the C compiler {program} does not run", arguments, output)
    if broken:
        raise broken
    if cc:
        raise KernelBuildError(f"no C compiler found: CC={cc} is not on the PATH")
    raise KernelBuildError(
        "no C compiler found: cc, gcc or clang is not on the PATH; "
        'one comes with pip install "capsyn[compiler]"'
    )


def _words(cc: str, path: str) -> list[str]:
    """Return the words of a command; a program's own path may have spaces."""
    if shutil.which(cc, path=path):
        return [cc]
    try:  # a backslash is part of a path on Windows
        words = shlex.split(cc, posix=not ON_WINDOWS)
    except ValueError as error:
        raise KernelBuildError(f"CC={cc} is not a command: {error}") from None
    return [word.strip('"') for word in words] if ON_WINDOWS else words


def zig_program() -> str | None:
    """Return the program of the package ziglang, None where that is not installed."""
    package = importlib.util.find_spec("ziglang")
    folders = package.submodule_search_locations if package is not None else None
    return str(Path(folders[0], "zig.exe" if ON_WINDOWS else "zig")) if folders else None


def zig_environment(cache: Path) -> dict[str, str]:
    """Return the environment in which zig keeps what it builds in a folder, or where it is told."""
    return {"ZIG_GLOBAL_CACHE_DIR": str(cache), **os.environ}


def usual_flags(compiler: Compiler) -> tuple[str, ...]:
    """Return the flags that make loops over lanes vectorised."""
    if not compiler.is_clang:
        return (*FLAGS, *GCC_FLAGS, *(GCC_ON_WINDOWS if ON_WINDOWS else ()))
    if sys.platform == "linux" and platform.machine() == "x86_64":
        return (*FLAGS, *CLANG_WITH_GLIBC, *(["-lmvec"] if compiler.is_zig else []))
    if sys.platform == "darwin" and platform.machine() == "arm64":  # old ones know no -march there
        return ("-mcpu=native", *(flag for flag in FLAGS if flag != "-march=native"))
    return FLAGS
