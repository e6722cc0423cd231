"""The whole command line where POSIX is hidden and only zig compiles, and where nothing does."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import capsyn
from support.processes.command_line import run_here

HIDING = Path(__file__).parents[1] / "support" / "portable"
SOURCE = Path(capsyn.__file__).parents[1]
OTHER_BITS = ("c.zip", "kept/", "c/measured.json")
"""Files that know the compiler: a proof's flows, a checkpoint's probe, bytes of exported C."""

BY_KERNELS = ("synth", "simulate", "verify", "switching", "improve")
"""Commands that say once that NumPy does the work."""
MEASURED = ("synth", "export")
"""Commands whose text depends on compilers: a hint from simulated loops, bytes of exported C."""


def go_through(folder: Path, *hidden: Path, **environment: str) -> dict:
    """Return what all commands do in a folder of their own, with their files beside it."""
    folder.mkdir()
    path = os.pathsep.join(map(str, (*hidden, SOURCE)))
    run = subprocess.run(
        [sys.executable, HIDING / "whole.py", folder],
        env=os.environ | {"PYTHONPATH": path} | environment,
        capture_output=True,
        encoding="utf-8",
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout) | {"folder": folder}


def files(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all files but those of other bits."""
    paths = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*"))}
    return {
        name: path.read_bytes()
        for name, path in paths.items()
        if path.is_file() and not name.startswith(OTHER_BITS)
    }


def said(text: str) -> str:
    """Return what a command printed, without times."""
    return re.sub(r"\d+\.\d+ s\b", "T s", text)


def test_the_command_line_needs_no_posix_and_no_compiler(tmp_path):
    """What zig's kernels give where POSIX is hidden is what NumPy gives where it is not."""
    pytest.importorskip("ziglang")
    zig = go_through(tmp_path / "zig", HIDING, PATH=str(tmp_path), CC="")
    none = go_through(tmp_path / "none", CC="none")
    assert none["posix"] and not zig["posix"]
    assert [words for words, status, *_ in zig["done"] if status] == ["info missing.cap"]
    for (words, *own), (_, *other) in zip(zig["done"], none["done"], strict=True):
        lines = other[2].splitlines()
        warned = [line for line in lines if "no C compiler found: CC=none" in line]
        kind = words.split()[0]
        if kind == "certify":  # the only kernel without a twin
            assert other[0] == 2 and warned == lines and lines[0].startswith("error: ")
        elif kind == "check":  # of what was not written
            assert other[0] == 1
        elif kind == "doctor":
            assert "ziglang/zig cc: clang version" in own[1] and "no kernels" not in own[1]
            assert "no kernels" in other[1]
        else:
            assert other[0] == own[0] and all(line.startswith("warning: ") for line in warned), (
                words
            )
            assert bool(warned) == (kind in BY_KERNELS), words
            assert [line for line in lines if line not in warned] == own[2].splitlines(), words
            assert kind in MEASURED or said(other[1]) == said(own[1]), words
    assert files(none["folder"]) == files(zig["folder"])
    run = run_here(["synth", "boat.py", "-o", "own.cap"], tmp_path / "zig")  # by our own compiler
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "zig/own.cap").read_bytes() == (tmp_path / "zig/p.cap").read_bytes()
