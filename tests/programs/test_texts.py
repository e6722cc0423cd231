"""Programs as C and Python text against their own evaluation."""

import ctypes
import math
import shutil
import subprocess

import numpy as np
import pytest

from capsyn.errors import ProblemError
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program
from capsyn.programs.texts import PYTHON_HELPERS, c_lines, calls_library, python_lines

SPECIAL = [0.0, -0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0, 0.5, -0.5, 1.5, 2.5, 800.0, -800.0, 1e200]
SPECIAL += [-1e200, math.inf, -math.inf, math.nan]
PAIRS = np.array([(a, b) for a in SPECIAL for b in SPECIAL])
EVERY = Program(
    "every",
    (("x", 2),),
    (("y", len(OPERATIONS) + 2),),
    (*((name, 0, 1)[: 1 + OPERATIONS[name].arity] for name in OPERATIONS),
     ("const", -0.1), ("const", -math.inf)),
    tuple(range(2, len(OPERATIONS) + 4)),
)  # fmt: skip
"""A program with every operation."""


def expected():
    return EVERY.evaluate(PAIRS.T)[0].T


def assert_close(found, names=(*OPERATIONS, "a constant", "an infinite one")):
    for k, name in enumerate(names):
        np.testing.assert_allclose(found[:, k], expected()[:, k], rtol=1e-14, err_msg=name)


def test_python_text():
    lines, results = python_lines(EVERY, ["a", "b"])
    body = "".join(f"    {line}\n" for line in lines)
    code = "".join(PYTHON_HELPERS.values())
    code += f"\ndef every(a, b):\n{body}    return [{', '.join(results)}]\n"
    names = {"math": math}
    exec(code, names)
    assert_close(np.array([names["every"](*pair) for pair in PAIRS.tolist()]))


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
def test_c_text(tmp_path):
    lines, results = c_lines(EVERY, ["x[0]", "x[1]"])
    stores = [f"y[{k}] = {name};" for k, name in enumerate(results)]
    body = "\n".join([*lines, *stores])
    (tmp_path / "every.c").write_text(
        f"#include <math.h>\nvoid every(const double *x, double *y) {{\n{body}\n}}\n"
    )
    library = tmp_path / "every.so"
    command = ["gcc", "-std=c99", "-Wall", "-Werror", "-shared", "-fPIC", "-ffp-contract=off"]
    subprocess.run([*command, tmp_path / "every.c", "-o", library, "-lm"], check=True)
    found = np.empty((len(PAIRS), len(results)))
    every = ctypes.CDLL(str(library)).every
    for x, y in zip(PAIRS, found):
        every(ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data))
    assert_close(found)
    assert calls_library(EVERY)


def test_arithmetic_needs_no_library():
    bare = Program("f", (("x", 2),), (("y", 1),), (("mul", 0, 1), ("sub", 2, 0)), (3,))
    assert not calls_library(bare)
    assert c_lines(bare, ["a", "b"]) == (
        ["const double v2 = a * b;", "const double v3 = v2 - a;"],
        ["v3"],
    )


def test_unknown_operations_are_refused():
    strange = Program("f", (("x", 1),), (("y", 1),), (("exec", 0),), (1,))
    for text in (c_lines, python_lines):
        with pytest.raises(ProblemError, match="known operations; got 'exec'$"):
            text(strange, ["a"])
