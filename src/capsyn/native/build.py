"""The system's C compiler, and the cache of what it built.

A cached library is used only from a directory that belongs to this user and is closed to others,
and only when its bytes have the checksum that was written beside it; otherwise it is built again,
in a temporary directory if need be.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from capsyn.errors import KernelBuildError, warn

FLAGS = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fopenmp-simd")
GCC_FLAGS = ("-fno-tree-sink", "-fno-thread-jumps", "-fno-tree-pre")
"""Else GCC moves what one branch of a selection needs into that branch, and the loop over lanes is
scalar: 9 times slower for ``if_else(x > 0, sin(x), exp(x))``, 6 times for a saturated law."""
PLAIN_FLAGS = ("-O2",)
COMMON_FLAGS = ("-std=gnu11", "-fPIC", "-shared")
BUILD_TIMEOUT = 600
"""Seconds that one compiler run may take."""

OTHERS_MAY_WRITE = "others may write there: it must be yours with mode 0700"

_lock = threading.Lock()
_loaded: dict[str, ctypes.CDLL] = {}


@dataclass(frozen=True)
class Compiler:
    """A C compiler: its command, and the first line of ``--version``."""

    command: tuple[str, ...]
    version: str

    @property
    def is_clang(self) -> bool:
        """Whether this is clang, which finds vector functions in its own way."""
        return "clang" in self.version


def find_compiler() -> Compiler:
    """Return the C compiler: ``CC`` if set, else the first of cc, gcc and clang that runs."""
    return _find_compiler(os.environ.get("CC", ""), os.environ.get("PATH", ""))


@functools.lru_cache(maxsize=8)
def _find_compiler(cc: str, path: str) -> Compiler:
    try:
        candidates = [shlex.split(cc)] if cc.strip() else [["cc"], ["gcc"], ["clang"]]
    except ValueError as error:
        raise KernelBuildError(f"CC={cc} is not a command: {error}") from None
    broken: KernelBuildError | None = None
    for command in candidates:
        program = shutil.which(command[0], path=path)
        if not program:
            continue
        arguments = [program, *command[1:]]
        try:
            run = subprocess.run(
                [*arguments, "--version"], capture_output=True, text=True, timeout=30
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            broken = KernelBuildError(f"the C compiler {program} does not run: {error}", arguments)
            continue
        if run.returncode == 0:
            return Compiler(tuple(arguments), (run.stdout.splitlines() or [""])[0])
        output = run.stdout + run.stderr
        broken = KernelBuildError(f"the C compiler {program} does not run", arguments, output)
    if broken:
        raise broken
    wanted = f"CC={cc}" if cc.strip() else "cc, gcc or clang"
    raise KernelBuildError(f"no C compiler found: {wanted} is not on the PATH")


@functools.lru_cache(maxsize=1)
def _cpu() -> str:
    """Return a text that differs between machines whose native code differs."""
    try:
        text = Path("/proc/cpuinfo").read_text()
        keep = ("model name", "flags", "Features", "CPU part")
        lines = {line for line in text.splitlines() if line.startswith(keep)}
        return platform.machine() + "\n".join(sorted(lines))
    except OSError:
        return platform.machine() + platform.processor()


def processor_name() -> str:
    """Return what the processor calls itself."""
    names = [line for line in _cpu().splitlines() if "model name" in line]
    return names[0].partition(":")[2].strip() if names else platform.processor() or "unknown"


def cache_directory() -> Path:
    """Return the directory of the kernel cache: ``CAPSYN_CACHE_DIR``, or the user's own."""
    chosen = os.environ.get("CAPSYN_CACHE_DIR")
    if chosen:
        return Path(chosen)
    import platformdirs

    return Path(platformdirs.user_cache_dir("capsyn", appauthor=False))


def cache_trouble(directory: Path) -> str | None:
    """Return why an existing directory cannot keep kernels, None where it can."""
    status = directory.lstat()
    if directory.is_symlink():
        return "it is a symbolic link"
    if not directory.is_dir():
        return "it is not a directory"
    if not os.access(directory, os.W_OK):
        return "it cannot be written to"
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & 0o077):
        return OTHERS_MAY_WRITE
    return None


def trusted_cache() -> Path | None:
    """Return the cache directory if it is this user's alone, creating it where needed."""
    try:
        directory = cache_directory()
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        trouble = cache_trouble(directory)
    except (OSError, RuntimeError):
        return None
    if trouble == OTHERS_MAY_WRITE:
        _warn_open_cache(directory)
    return None if trouble else directory


@functools.lru_cache(maxsize=8)
def _warn_open_cache(directory: Path) -> None:
    warn(f"the kernel cache '{directory}' is not used, since {OTHERS_MAY_WRITE}")


def load(source: str, flags: tuple[str, ...] = ()) -> ctypes.CDLL:
    """Return the shared library built from a C translation unit, from the cache if it is there.

    The flags go beside the usual ones. A `KernelBuildError` says that there is no compiler, or that
    it fails with the usual flags and with plain ones.
    """
    compiler = find_compiler()
    first_error: KernelBuildError | None = None
    for chosen in (usual_flags(compiler), PLAIN_FLAGS):
        try:
            return _load(compiler, source, (*chosen, *COMMON_FLAGS, *flags))
        except KernelBuildError as error:
            first_error = first_error or error
    assert first_error is not None
    raise first_error


def usual_flags(compiler: Compiler) -> tuple[str, ...]:
    """Return the flags that make loops over lanes vectorised."""
    if not compiler.is_clang:
        return (*FLAGS, *GCC_FLAGS)
    if sys.platform == "linux" and platform.machine() == "x86_64":
        return (*FLAGS, "-fveclib=libmvec")
    return FLAGS


def _load(compiler: Compiler, source: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    parts = (source, *flags, *compiler.command, compiler.version, _cpu())
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:40]
    with _lock:
        if key in _loaded:
            return _loaded[key]
        cache = trusted_cache()
        if cache is not None:
            library = _cached(cache / f"{key}.so")
            if library is None:
                try:
                    library = _build_in_cache(compiler, source, flags, cache, key)
                except OSError:  # a full or read-only disk: build elsewhere
                    library = None
            if library is not None:
                _loaded[key] = library
                return library
        try:
            with tempfile.TemporaryDirectory(prefix="capsyn-") as directory:
                target = Path(directory) / "kernel.so"
                _compile(compiler, source, flags, target)
                _loaded[key] = ctypes.CDLL(str(target))
        except OSError as error:
            command = [*compiler.command, *flags]
            raise KernelBuildError(
                f"what {compiler.command[0]} built cannot be loaded: {error}", command
            ) from None
        return _loaded[key]


def _cached(path: Path) -> ctypes.CDLL | None:
    """Return the library at `path` if its checksum file vouches for its bytes."""
    try:
        wanted = path.with_suffix(".sha256").read_text().strip()
        if hashlib.sha256(path.read_bytes()).hexdigest() == wanted:
            return ctypes.CDLL(str(path))
    except (OSError, UnicodeDecodeError):
        pass  # absent or damaged: the caller builds it again
    return None


def _build_in_cache(
    compiler: Compiler, source: str, flags: tuple[str, ...], cache: Path, key: str
) -> ctypes.CDLL:
    for left in cache.glob(".build-*"):  # of processes that were killed
        with contextlib.suppress(OSError):
            if time.time() - left.stat().st_mtime > 2 * BUILD_TIMEOUT:
                shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=".build-", dir=cache) as directory:
        target = Path(directory) / "kernel.so"
        _compile(compiler, source, flags, target)
        library = ctypes.CDLL(str(target))  # what cannot be loaded is not kept
        checksum = Path(directory) / "kernel.sha256"
        checksum.write_text(hashlib.sha256(target.read_bytes()).hexdigest() + "\n")
        os.replace(target, cache / f"{key}.so")
        os.replace(checksum, cache / f"{key}.sha256")
    return library


def _compile(compiler: Compiler, source: str, flags: tuple[str, ...], target: Path) -> None:
    file = target.with_suffix(".c")
    file.write_text(source)
    command = [*compiler.command, *flags, "-o", str(target), str(file), "-lm"]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=BUILD_TIMEOUT)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise KernelBuildError(f"the C compiler failed: {error}", command) from None
    if run.returncode:
        lines = run.stderr.strip().splitlines() or ["no message"]
        raise KernelBuildError(
            f"the C compiler failed with status {run.returncode}: {lines[0]}", command, run.stderr
        )
