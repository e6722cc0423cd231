"""Which C compiler builds kernels, and with which flags, here and on other systems."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from capsyn.errors import KernelBuildError
from capsyn.native import compiler


@pytest.fixture
def bin_(tmp_path, monkeypatch) -> Path:
    """Return the only folder on the path; there is no CC, and no package ziglang."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiler, "zig_program", lambda: None)
    yield folder
    compiler._find_compiler.cache_clear()


def script(path: Path, text: str) -> str:
    """Return an executable shell script that stands for a compiler."""
    compiler._find_compiler.cache_clear()
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)


def test_the_compiler_is_cc_from_the_environment_or_the_first_on_the_path(bin_, monkeypatch):
    script(bin_ / "clang", "echo Debian clang version 14")
    clang = compiler.find_compiler()
    assert clang.command == (str(bin_ / "clang"),) and clang.is_clang and not clang.is_zig
    script(bin_ / "gcc", "echo gcc 12.2; echo more")
    assert compiler.find_compiler() == compiler.Compiler((str(bin_ / "gcc"),), "gcc 12.2")
    script(bin_ / "cc", "echo cc")
    assert compiler.find_compiler().command == (str(bin_ / "cc"),)
    monkeypatch.setenv("CC", "gcc '-D A' -m64")
    assert compiler.find_compiler().command == (str(bin_ / "gcc"), "-D A", "-m64")
    monkeypatch.setenv("CC", " ")
    assert compiler.find_compiler().command == (str(bin_ / "cc"),)


def test_ziglang_is_taken_where_nothing_else_runs(bin_, monkeypatch, tmp_path):
    with pytest.raises(KernelBuildError, match=r'comes with pip install "capsyn\[compiler\]"$'):
        compiler.find_compiler()
    zig = script(tmp_path / "zig", '[ "$1" = cc ] && echo clang version 22')
    monkeypatch.setattr(compiler, "zig_program", lambda: zig)
    script(bin_ / "cc", "echo no tools are installed >&2; exit 1")  # as that of a new Mac
    found = compiler.find_compiler()
    assert found.command == (zig, "cc") and found.is_clang and found.is_zig
    script(bin_ / "gcc", "echo gcc 12.2")
    assert compiler.find_compiler().command == (str(bin_ / "gcc"),)
    monkeypatch.setenv("CC", "none")  # what was asked for is not replaced
    with pytest.raises(KernelBuildError, match="CC=none is not on the PATH"):
        compiler.find_compiler()


def test_the_program_of_ziglang_is_that_of_the_system(monkeypatch, tmp_path):
    class Package:
        submodule_search_locations = [str(tmp_path)]

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: Package)
    assert compiler.zig_program() == str(tmp_path / "zig")
    monkeypatch.setattr(compiler, "ON_WINDOWS", True)
    assert compiler.zig_program() == str(tmp_path / "zig.exe")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert compiler.zig_program() is None


@pytest.mark.parametrize(
    "command, is_zig",
    [
        (("/venv/ziglang/zig", "cc"), True),
        (("python", "-m", "ziglang", "cc"), True),
        (("zig.exe", "cc"), True),
        (("/home/zigzag/bin/gcc",), False),
    ],
)
def test_zig_is_known_by_its_command(command, is_zig):
    assert compiler.Compiler(command, "clang version 22").is_zig is is_zig


def test_a_clang_for_microsofts_linker_is_passed_over(bin_):
    """It would need an export for each function of a kernel, and Microsoft's own headers."""
    script(bin_ / "clang", "echo clang version 19; echo Target: x86_64-pc-windows-msvc")
    with pytest.raises(KernelBuildError, match="makes code for Microsoft's tools"):
        compiler.find_compiler()
    script(bin_ / "gcc", "echo gcc 15")
    assert compiler.find_compiler().version == "gcc 15"


def test_paths_of_windows_are_commands(bin_, monkeypatch):
    monkeypatch.setattr(compiler, "ON_WINDOWS", True)
    words = compiler._words(r'C:\mingw\bin\gcc.exe "-D A"', "")
    assert words == [r"C:\mingw\bin\gcc.exe", "-D A"]
    assert compiler._words(r'"C:\Program Files\zig\zig.exe" cc', "") == [
        r"C:\Program Files\zig\zig.exe",
        "cc",
    ]
    program = script(bin_ / "my gcc", "echo gcc 15")
    assert compiler._words(program, str(bin_)) == [program]  # a path alone needs no quotes


def test_flags_follow_the_compiler_and_the_system(monkeypatch):
    gcc = compiler.Compiler(("gcc",), "gcc (Debian) 12")
    clang = compiler.Compiler(("clang",), "Debian clang version 14")
    assert set(compiler.GCC_FLAGS) < set(compiler.usual_flags(gcc))
    # clang refuses flags that it does not know
    assert not set(compiler.GCC_FLAGS) & set(compiler.usual_flags(clang))
    monkeypatch.setattr(compiler, "ON_WINDOWS", True)
    monkeypatch.setattr(compiler.sys, "platform", "win32")
    assert compiler.GCC_ON_WINDOWS[0] in compiler.usual_flags(gcc)
    assert compiler.usual_flags(clang) == compiler.FLAGS
    monkeypatch.setattr(compiler.sys, "platform", "darwin")
    monkeypatch.setattr(compiler.platform, "machine", lambda: "arm64")
    flags = compiler.usual_flags(clang)
    assert "-mcpu=native" in flags and "-march=native" not in flags
