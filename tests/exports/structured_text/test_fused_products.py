"""Steps are the same where a PLC's C compiler fuses products with the sums that follow."""

import ctypes
import platform
import re
import subprocess

import numpy as np
import pytest

from capsyn import Box
from capsyn.exports.plan import Plan
from support.exports.c_machines import need
from support.trees import random_policy

pytest.importorskip(
    "tree_sitter_iec61131_3_st", reason="tree-sitter-iec61131-3-st is not installed"
)
from support.exports.structured_text import source  # noqa: E402

BOX = Box([-4.7], [5.0])
COUNT = 144


def compiled(lines, directory):
    """Return the faces that lines of Structured Text give, compiled as C with fused products."""
    body = "".join(line.replace(":=", "=") for line in lines)
    code = f"""
    double face_of(double lower, double upper, int middle, int count);
    double face_of(double lower, double upper, int middle, int count)
    {{
        double face, width = upper - lower;
        {body.replace("DINT_TO_LREAL", "(double)")}
        return face;
    }}"""
    directory.mkdir()
    (directory / "face.c").write_text(code)
    options = ["-mfma"] if platform.machine() in ("x86_64", "AMD64") else []
    command = ["gcc", "-O2", *options, "-shared", "-fPIC", "face.c", "-o", "face.so"]
    subprocess.run(command, cwd=directory, check=True)
    function = ctypes.CDLL(str(directory / "face.so")).face_of
    function.restype = ctypes.c_double
    ends = map(ctypes.c_double, (BOX.lower[0], BOX.upper[0]))
    low, high = ends
    return np.array([function(low, high, k, COUNT) for k in range(1, COUNT)])


def test_faces_are_rounded_as_written(tmp_path):
    need("gcc")
    if platform.machine() in ("x86_64", "AMD64"):
        with open("/proc/cpuinfo") as file:
            if " fma " not in file.read():
                pytest.skip("needs a processor that fuses products")
    text = source(Plan.of(random_policy(1))).decode()
    lines = re.findall(r"^ +(face := .*;)$", text, re.M)
    assert len(lines) == 3
    faces = BOX.faces(0, np.arange(1, COUNT), COUNT)
    assert np.array_equal(compiled(lines, tmp_path / "rounded"), faces)
    plain = [line.replace(" + 0.0", "") for line in lines]
    assert plain != lines and (compiled(plain, tmp_path / "fused") != faces).any()
