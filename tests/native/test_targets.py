"""Kernels for systems that are not this one: their C is vectorised there, without a warning."""

from __future__ import annotations

import subprocess

import pytest

from capsyn import problems
from capsyn.controllers import solver
from capsyn.modelling.transcription import transcribe
from capsyn.native.compiler import FLAGS, Compiler, zig_program

WARNINGS = ("-Wall", "-Wextra", "-Wno-unused-function", "-Wno-psabi", "-Werror")


@pytest.fixture(scope="module")
def source() -> str:
    """Return the C that solves the cart-pendulum, with the functions of a C library."""
    texts = []

    class Stop(Exception):
        pass

    def keep(text, flags):
        texts.append(text)
        raise Stop

    problem = problems.plain("cart-pendulum")
    model = solver.bind_default(transcribe(problem), problem.default)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solver, "load", keep)
        clang = Compiler(("clang",), "clang version 22")
        patch.setattr("capsyn.native.source.find_compiler", lambda: clang)
        with pytest.raises(Stop):
            solver.SsacKernel.build(model, "double", 1e-9)
    return texts[0]


@pytest.mark.parametrize("target", ["x86_64-windows-gnu", "aarch64-macos"])
def test_the_kernel_that_solves_compiles_for(target, source, tmp_path):
    if zig_program() is None:
        pytest.skip("needs ziglang")
    (tmp_path / "kernel.c").write_text(source, encoding="utf-8")
    flags = [flag for flag in FLAGS if flag != "-march=native"]
    run = subprocess.run(
        [
            *(zig_program(), "cc", "-target", target, "-std=gnu11", *flags, *WARNINGS),
            *("-c", "kernel.c", "-o", "kernel.o"),
        ],
        cwd=tmp_path, capture_output=True, encoding="utf-8",
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "kernel.o").stat().st_size > 1000
