"""Binaries of an FMU: by the compiler of this platform, and for others by zig's."""

from __future__ import annotations

import platform
import struct
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from capsyn.errors import KernelBuildError, ProblemError
from capsyn.exports.plan import Files
from capsyn.native.build import trusted_cache
from capsyn.native.compiler import (
    LIBRARIES,
    ON_WINDOWS,
    find_compiler,
    zig_environment,
    zig_program,
)

ENDINGS = {"linux64": "so", "win64": "dll", "darwin64": "dylib"}
"""Platforms of FMI 2.0 that there are binaries for, and the endings of their libraries."""
NAMES = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}
"""What FMI 2.0 calls the systems that Python knows."""
PLAIN = ("-std=c99", "-O2", "-ffp-contract=off")
FLAGS = (*PLAIN, "-fPIC", "-shared", "-fvisibility=hidden", "-s")
OWN_FLAGS = (*PLAIN, "-shared", "-s") if ON_WINDOWS else FLAGS
BUILD_SECONDS = 120
"""Longest that a compiler may take."""
WINDOWS = ("-target", "x86_64-windows-gnu")
LINUX = ("-target", "x86_64-linux-gnu.2.17")  # glibc of 2012, and all later ones
MACS = (("-target", "x86_64-macos"), ("-target", "aarch64-macos"))
LIBRARY = "LIBRARY msvcrt.dll\nEXPORTS\n" + "\n".join(
    "calloc ceil fabs floor fmod free malloc memcpy memmove memset strcmp".split()
)
"""What the source may call of the C library that every Windows has."""
ENTRY = "int DllMainCRTStartup(void *m, unsigned long why, void *p);\n"
ENTRY += "int DllMainCRTStartup(void *m, unsigned long why, void *p) {\n"
ENTRY += "    (void)m; (void)why; (void)p;\n    return 1;\n}\n"
"""Where Windows enters a library: there is nothing to do."""
FAT, ALIGNED = 0xCAFEBABE, 14
"""What a library for several processors of a Mac begins with; slices begin at ``2 ** 14`` bytes."""


def own_platform() -> str | None:
    """Return what FMI 2.0 calls this platform, None where it has no name."""
    return NAMES.get(sys.platform) if platform.machine() in ("x86_64", "AMD64") else None


def build(name: str, source: bytes, platforms: Sequence[str]) -> Files:
    """Return the libraries of a source for platforms, by their places in the archive.

    Raises
    ------
    ProblemError
        A platform needs zig, which is not installed.
    KernelBuildError
        A compiler fails.
    """
    own = own_platform() if _has_compiler() else None
    zig = zig_program() if any(chosen != own for chosen in platforms) else None
    if zig is None and (others := [chosen for chosen in platforms if chosen != own]):
        raise ProblemError(
            f"`platforms` {others[0]} needs zig's C compiler: "
            'pip install "capsyn[compiler]"; got none'
        )
    files: Files = {}
    for chosen in platforms:
        with tempfile.TemporaryDirectory(prefix="capsyn-") as directory:
            folder, target = Path(directory), f"{name}.{ENDINGS[chosen]}"
            (folder / f"{name}.c").write_bytes(source)
            if chosen == own:
                _by_own_compiler(folder, name, target)
            else:
                assert zig is not None
                _by_zig(zig, folder, name, target, chosen)
            files[f"binaries/{chosen}/{target}"] = (folder / target).read_bytes()
    return files


def _has_compiler() -> bool:
    """Return whether there is a compiler for this platform's library, other than ziglang's."""
    try:
        return zig_program() not in find_compiler().command
    except KernelBuildError:
        return False


def _by_own_compiler(folder: Path, name: str, target: str) -> None:
    # names without a directory: the place leaves no trace in the library
    _run([*find_compiler().command, *OWN_FLAGS, f"{name}.c", "-o", target, *LIBRARIES], folder)


def _by_zig(zig: str, folder: Path, name: str, target: str, chosen: str) -> None:
    """Write the library of a platform."""
    cache = trusted_cache()
    environment = zig_environment(cache / "zig" if cache else folder / "cache")
    environment |= {"ZIG_LOCAL_CACHE_DIR": str(folder / "cache"), "SOURCE_DATE_EPOCH": "0"}
    compile_ = [zig, "cc"]
    if chosen == "win64":  # without the C library of MinGW, which takes a minute to build
        (folder / "entry.c").write_text(ENTRY, encoding="ascii")
        (folder / "library.def").write_text(LIBRARY, encoding="ascii")
        make = [zig, "dlltool", "-m", "i386:x86-64", "-d", "library.def", "-l", "library.a"]
        objects = ["code.o", "entry.o"]
        link = ["-nostdlib", "-shared", "-s", *objects, "library.a"]
        _run(make, folder, environment)
        for file, code in zip((f"{name}.c", "entry.c"), objects):
            _run([*compile_, *WINDOWS, *PLAIN, "-c", file, "-o", code], folder, environment)
        _run([*compile_, *WINDOWS, *link, "-o", target], folder, environment)
        return
    slices = []
    for machine in MACS if chosen == "darwin64" else (LINUX,):
        command = [*compile_, *machine, *FLAGS, f"{name}.c", "-o", target, "-lm"]
        _run(command, folder, environment)
        slices.append((folder / target).read_bytes())
    if len(slices) > 1:
        (folder / target).write_bytes(universal(slices))


def universal(slices: Sequence[bytes]) -> bytes:
    """Return a Mach-O library for several processors, made of one for each."""
    head = struct.pack(">II", FAT, len(slices))
    body = bytearray(1 << ALIGNED)
    for data in slices:
        processor, kind = struct.unpack_from("<II", data, 4)
        head += struct.pack(">IIIII", processor, kind, len(body), len(data), ALIGNED)
        body += data
        body += bytes(-len(body) % (1 << ALIGNED))
    body[: len(head)] = head
    return bytes(body)


def _run(command: list[str], folder: Path, environment: dict[str, str] | None = None) -> None:
    try:
        subprocess.run(
            command,
            cwd=folder,
            check=True,
            capture_output=True,
            timeout=BUILD_SECONDS,
            env=environment,
        )
    except (OSError, subprocess.SubprocessError) as error:
        output = (getattr(error, "stderr", None) or b"").decode(errors="replace")
        raise KernelBuildError(
            f"the compiler failed on the source of the FMU: {output.strip() or error}", command
        ) from None
