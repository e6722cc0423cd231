"""Compiler discovery, the kernel cache, and what happens without a compiler."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from capsyn import problems, synthesize
from capsyn.controllers.solver import SsacKernel, bind_default, make_solver
from capsyn.errors import CapsynWarning, KernelBuildError
from capsyn.modelling.transcription import transcribe
from capsyn.native import build, compiler
from capsyn.native.source import LANES

SOURCE = "int answer(void) { return 42; }\n"


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    """Return the directory of an empty cache; nothing counts as loaded yet."""
    directory = tmp_path / "cache"
    monkeypatch.setenv("CAPSYN_CACHE_DIR", str(directory))
    monkeypatch.setattr(build, "_loaded", {})
    return directory


@pytest.fixture
def no_compiler(tmp_path, monkeypatch, cache) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(compiler, "zig_program", lambda: None)


def script(path: Path, *lines: str) -> Path:
    """Return an executable shell script that stands for a compiler."""
    path.write_text("\n".join(["#!/bin/sh", *lines, ""]))
    path.chmod(0o755)
    return path


def counted(monkeypatch) -> list[list[str]]:
    """Return a list to which every compiler run from now on adds its flags."""
    runs: list[list[str]] = []
    compile_ = build._compile

    def count(compiler, source, flags, target):
        runs.append(list(flags))
        compile_(compiler, source, flags, target)

    monkeypatch.setattr(build, "_compile", count)
    return runs


@pytest.mark.parametrize(
    "cc, message",
    [
        ("/no/such/compiler", "CC=/no/such/compiler is not on the PATH"),
        ("''", "is not on the PATH"),
        ('gcc "', "is not a command"),
        ("false", "does not run"),
    ],
)
def test_a_compiler_that_cannot_be_used_is_an_error_and_numpy_takes_over(
    cc, message, monkeypatch, cache
):
    monkeypatch.setenv("CC", cc)
    with pytest.raises(KernelBuildError, match=message):
        build.load(SOURCE)
    with pytest.warns(CapsynWarning, match=message):
        assert pendulum_solver("auto")[1] == "numpy"


def test_a_file_that_is_no_program_is_an_error(tmp_path, monkeypatch):
    fake = tmp_path / "cc"
    fake.write_bytes(b"\x7fELF nothing")
    fake.chmod(0o755)
    monkeypatch.setenv("CC", str(fake))
    with pytest.raises(KernelBuildError, match="does not run") as caught:
        compiler.find_compiler()
    assert caught.value.command == [str(fake)]


def pendulum_solver(backend: str):
    problem = problems.plain("cart-pendulum")
    return make_solver(bind_default(transcribe(problem), problem.default), "double", backend)


def test_a_failed_build_carries_its_command_and_output(cache):
    with pytest.raises(KernelBuildError, match="failed with status 1") as caught:
        build.load("int answer(void) { return nothing; }\n")
    command = caught.value.command
    assert command[: len(compiler.find_compiler().command)] == list(
        compiler.find_compiler().command
    )
    assert "-shared" in command and "-march=native" in command  # of the first try
    assert "nothing" in caught.value.output and "error" in caught.value.output
    assert os.listdir(cache) == []


def test_a_build_that_takes_too_long_is_an_error(tmp_path, monkeypatch, cache):
    slow = script(tmp_path / "cc", '[ "$1" = --version ] && echo slow && exit', "exec sleep 9")
    monkeypatch.setenv("CC", str(slow))
    monkeypatch.setattr(build, "BUILD_TIMEOUT", 0.1)
    with pytest.raises(KernelBuildError, match="timed out"):
        build.load(SOURCE)


def test_a_compiler_without_the_usual_flags_gets_plain_ones(tmp_path, monkeypatch, cache):
    real = " ".join(compiler.find_compiler().command)
    old = script(
        tmp_path / "old",
        'case "$*" in *-march=native*) echo "old: unknown flag" >&2; exit 1;; esac',
        f'exec {real} "$@"',
    )
    monkeypatch.setenv("CC", str(old))
    runs = counted(monkeypatch)
    states = problems.plain("cart-pendulum").domain.sample(100)
    solver, backend = pendulum_solver("c")
    assert backend == "c" and len(runs) == 2
    assert "-march=native" in runs[0] and "-march=native" not in runs[1]
    for got, want in zip(solver(states, 1.2, 8), pendulum_solver("numpy")[0](states, 1.2, 8)):
        np.testing.assert_allclose(got, want, rtol=1e-9)


def test_the_c_backend_is_refused_without_a_compiler(no_compiler):
    with pytest.raises(KernelBuildError, match="no C compiler found: cc, gcc or clang") as caught:
        pendulum_solver("c")
    assert caught.value.command == [] and caught.value.output == ""


def test_without_a_compiler_numpy_solves_with_one_warning(no_compiler):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        solver, backend = pendulum_solver("auto")
        solver(np.zeros((1, 2)), 1.2, 4)
    assert backend == "numpy"
    assert [w.category for w in caught] == [CapsynWarning]
    assert str(caught[0].message).startswith("solving with NumPy: no C compiler found")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pendulum_solver("numpy")[1] == "numpy"


def test_a_synthesis_without_a_compiler_warns_once_and_gives_the_same_policy(
    no_compiler, monkeypatch
):
    problem = problems.plain("double-tank-a").replace(max_level=1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        policy = synthesize(problem)
    assert [w.category for w in caught] == [CapsynWarning]
    assert caught[0].filename == __file__
    monkeypatch.undo()
    states = problem.domain.sample(2000)
    np.testing.assert_array_equal(policy(states), synthesize(problem, backend="c")(states))


def test_the_cache_is_closed_to_others_and_holds_only_libraries(cache):
    assert build.load(SOURCE).answer() == 42
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    assert sorted(path.suffix for path in cache.iterdir()) == [".sha256", ".so"]


def test_the_cache_is_the_users_own_unless_told(tmp_path, monkeypatch):
    monkeypatch.delenv("CAPSYN_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if sys.platform == "linux":
        assert build.cache_directory() == tmp_path / "capsyn"
    monkeypatch.setenv("CAPSYN_CACHE_DIR", str(tmp_path / "mine"))
    assert build.cache_directory() == tmp_path / "mine"


def test_a_second_load_does_not_compile(cache, monkeypatch):
    first = build.load(SOURCE)
    runs = counted(monkeypatch)
    assert build.load(SOURCE) is first
    monkeypatch.setattr(build, "_loaded", {})  # as in another process
    assert build.load(SOURCE).answer() == 42 and runs == []
    assert build.load(SOURCE.replace("42", "43")).answer() == 43
    build.load(SOURCE, ("-DOTHER",))
    assert len(runs) == 2 and len(list(cache.glob("*.so"))) == 3


def test_a_kernel_of_another_compiler_or_processor_is_not_reused(cache, monkeypatch):
    build.load(SOURCE)
    runs = counted(monkeypatch)
    with monkeypatch.context() as patch:
        patch.setattr(build, "_cpu", lambda: "another processor")
        build.load(SOURCE)
    real = compiler.find_compiler()
    newer = compiler.Compiler(real.command, real.version + " (newer)")
    monkeypatch.setattr(build, "find_compiler", lambda: newer)
    build.load(SOURCE)
    assert len(runs) == 2


PROGRAM = """
import sys
from capsyn.native.build import load
print("ready", flush=True)
sys.stdin.readline()
print(load(sys.argv[1]).answer())
"""


def start(cache: Path) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, SOURCE],
        env=os.environ | {"CAPSYN_CACHE_DIR": str(cache)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def test_processes_that_build_at_once_all_succeed(cache):
    processes = [start(cache) for _ in range(4)]
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    assert [process.communicate(timeout=60)[0] for process in processes] == ["42\n"] * 4
    assert sorted(path.suffix for path in cache.iterdir()) == [".sha256", ".so"]
    (library,) = cache.glob("*.so")
    assert build._cached(library).answer() == 42


def no_checksum(library: Path) -> None:
    library.with_suffix(".sha256").unlink()


def other_bytes(library: Path) -> None:
    library.write_bytes(library.read_bytes()[:-1] + b"!")


def empty(library: Path) -> None:
    library.write_bytes(b"")


def vouched_garbage(library: Path) -> None:
    library.write_bytes(b"garbage")
    digest = build.hashlib.sha256(b"garbage").hexdigest()
    library.with_suffix(".sha256").write_text(digest)


def binary_checksum(library: Path) -> None:
    library.with_suffix(".sha256").write_bytes(b"\xff\xfe")


@pytest.mark.parametrize(
    "damage", [no_checksum, other_bytes, empty, vouched_garbage, binary_checksum]
)
def test_a_damaged_library_is_built_again(damage, cache, monkeypatch):
    assert start(cache).communicate("go\n", timeout=60)[0].endswith("42\n")  # not loaded here
    (library,) = cache.glob("*.so")
    good = library.read_bytes()
    damage(library)
    runs = counted(monkeypatch)
    assert build.load(SOURCE).answer() == 42
    assert len(runs) == 1 and library.read_bytes() == good
    assert build._cached(library) is not None


def test_a_library_that_cannot_be_replaced_is_bypassed(cache):
    start(cache).communicate("go\n", timeout=60)
    (library,) = cache.glob("*.so")
    library.unlink()
    library.mkdir()
    assert build.load(SOURCE).answer() == 42
    assert library.is_dir()


@pytest.mark.parametrize("mode", [0o770, 0o702, 0o750, 0o755])
def test_a_cache_open_to_others_is_bypassed(mode, cache):
    cache.mkdir()
    cache.chmod(mode)
    with pytest.warns(CapsynWarning, match="mode 0700"):
        assert build.load(SOURCE).answer() == 42
    assert os.listdir(cache) == [] and stat.S_IMODE(cache.stat().st_mode) == mode


def test_a_cache_that_is_a_link_is_bypassed(cache, tmp_path):
    (tmp_path / "real").mkdir(mode=0o700)
    cache.symlink_to(tmp_path / "real")
    assert build.load(SOURCE).answer() == 42
    assert os.listdir(tmp_path / "real") == []


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owners on this system")
def test_a_cache_of_another_user_is_bypassed(cache, monkeypatch):
    cache.mkdir(mode=0o700)
    monkeypatch.setattr(build.os, "getuid", lambda: cache.stat().st_uid + 1)
    with pytest.warns(CapsynWarning, match="must be yours"):
        assert build.load(SOURCE).answer() == 42
    assert os.listdir(cache) == []


def test_a_cache_that_cannot_be_written_is_bypassed(cache, monkeypatch):
    cache.mkdir(mode=0o700)
    monkeypatch.setattr(build.os, "access", lambda path, mode: False)  # root may write anywhere
    assert build.load(SOURCE).answer() == 42
    assert os.listdir(cache) == []


def test_a_cache_below_a_file_is_bypassed(cache, monkeypatch):
    cache.write_text("not a directory")
    monkeypatch.setenv("CAPSYN_CACHE_DIR", str(cache / "below"))
    assert build.load(SOURCE).answer() == 42
    assert cache.read_text() == "not a directory"


def test_a_full_disk_under_the_cache_does_not_stop_the_build(cache, monkeypatch):
    replace = os.replace

    def full(source, target):
        if Path(target).parent == cache:
            raise OSError(errno.ENOSPC, "no space left on device")
        replace(source, target)

    monkeypatch.setattr(build.os, "replace", full)
    assert build.load(SOURCE).answer() == 42
    assert os.listdir(cache) == []


def test_kernels_may_be_called_from_threads_and_with_one_lane():
    problem = problems.plain("cart-pole")
    model = bind_default(transcribe(problem), problem.default)
    kernel = SsacKernel.build(model, "double", 1e-9)
    states = problem.domain.sample(4 * 333, seed=1)
    whole = kernel(states, 0.6, 20)
    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(lambda part: kernel(part, 0.6, 20), np.split(states, 4)))
    for got, want in zip(map(np.concatenate, zip(*parts)), whole):
        np.testing.assert_array_equal(got, want)
    one = SsacKernel.build(model, "double", 1e-9, lanes=1)
    assert LANES > 1
    for got, want in zip(one(states[:50], 0.6, 20), whole):
        np.testing.assert_allclose(got, want[:50], rtol=1e-10, atol=1e-12)
    assert [values.shape for values in kernel(states[:0], 0.6, 20)] == [(0,), (0, 2), (0, 2)]
