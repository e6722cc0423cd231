"""What a C compiler built of kernels, kept in a cache.

A cached library is used only from a directory that belongs to this user and is closed to others,
and only when its bytes have the checksum that was written beside it; otherwise it is built again,
in a temporary directory if need be.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import logging
import os
import platform
import shutil
import subprocess
import tempfile
import threading
import time
from pathlib import Path

from capsyn.errors import KernelBuildError, warn
from capsyn.native.compiler import (
    COMMON_FLAGS,
    ENDING,
    LIBRARIES,
    PLAIN_FLAGS,
    Compiler,
    find_compiler,
    usual_flags,
    zig_environment,
)

BUILD_TIMEOUT = 600
"""Seconds that one compiler run may take."""

COLD = "that takes some 10 s, on Windows a minute or more"
"""How long it takes that zig builds its C library."""

OTHERS_MAY_WRITE = "others may write there: it must be yours with mode 0700"

_LOG = logging.getLogger(__name__)
_lock = threading.Lock()
_loaded: dict[str, ctypes.CDLL] = {}


@functools.lru_cache(maxsize=1)
def _cpu() -> str:
    """Return a text that differs between machines whose native code differs."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
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


def _load(compiler: Compiler, source: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    parts = (source, *flags, *compiler.command, compiler.version, _cpu())
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:40]
    with _lock:
        if key in _loaded:
            return _loaded[key]
        cache = trusted_cache()
        if cache is not None:
            path = cache / f"{key}{ENDING}"
            library = _cached(path)
            if library is None:
                try:
                    library = _build_in_cache(compiler, source, flags, path)
                except OSError:  # another process was faster, or a full or read-only disk
                    library = _cached(path)
            if library is not None:
                _loaded[key] = library
                return library
        try:  # on Windows what is loaded cannot be removed
            with tempfile.TemporaryDirectory(
                prefix="capsyn-", ignore_cleanup_errors=True
            ) as directory:
                target = Path(directory) / f"kernel{ENDING}"
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
        wanted = path.with_suffix(".sha256").read_text(encoding="ascii").strip()
        if hashlib.sha256(path.read_bytes()).hexdigest() == wanted:
            return ctypes.CDLL(str(path))
    except (OSError, UnicodeDecodeError):
        pass  # absent or damaged: the caller builds it again
    return None


def _build_in_cache(
    compiler: Compiler, source: str, flags: tuple[str, ...], path: Path
) -> ctypes.CDLL:
    cache = path.parent
    for left in cache.glob(".build-*"):  # of processes that were killed
        with contextlib.suppress(OSError):
            if time.time() - left.stat().st_mtime > 2 * BUILD_TIMEOUT:
                shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(
        prefix=".build-", dir=cache, ignore_cleanup_errors=True
    ) as directory:
        target = Path(directory) / f"kernel{ENDING}"
        _compile(compiler, source, flags, target)
        library = ctypes.CDLL(str(target))  # what cannot be loaded is not kept
        checksum = Path(directory) / "kernel.sha256"
        checksum.write_text(hashlib.sha256(target.read_bytes()).hexdigest() + "\n", "ascii")
        os.replace(target, path)  # Windows, too, renames what is loaded
        os.replace(checksum, path.with_suffix(".sha256"))
    return library


def _compile(compiler: Compiler, source: str, flags: tuple[str, ...], target: Path) -> None:
    file = target.with_suffix(".c")
    file.write_text(source, encoding="utf-8")
    command = [*compiler.command, *flags, "-o", str(target), str(file), *LIBRARIES]
    try:
        run = subprocess.run(
            command, capture_output=True, encoding="utf-8", errors="replace",
            timeout=BUILD_TIMEOUT, env=_environment(compiler),
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise KernelBuildError(f"the C compiler failed: {error}", command) from None
    if run.returncode:
        lines = run.stderr.strip().splitlines() or ["no message"]
        raise KernelBuildError(
            f"the C compiler failed with status {run.returncode}: {lines[0]}", command, run.stderr
        )


def _environment(compiler: Compiler) -> dict[str, str] | None:
    """Return what a compiler finds in its environment, None where that is as here."""
    cache = trusted_cache() if compiler.is_zig else None
    if cache is None:
        return None
    environment = zig_environment(cache / "zig")
    if not Path(environment["ZIG_GLOBAL_CACHE_DIR"], "o").exists():
        _LOG.warning("zig builds its C library, once: %s", COLD)
    return environment
