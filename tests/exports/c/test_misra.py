"""Exported C against MISRA C:2012."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from capsyn.exports.c.readings import counts as c_counts
from capsyn.exports.c.styles import stream as c_stream
from capsyn.exports.plan import Plan
from support.exports.c_machines import (
    need,
    prefix_of,
    write,
)
from support.exports.c_plans import (
    FINE,
    REMEMBERING,
    files,
    made_of_counts,
    plan_of,
    plan_of_nodes,
    random_plan,
    remembering,
)
from support.features import exact
from support.trees import random_affine_policy, random_policy

ADVISORY = ("misra-c2012-2.4", "misra-c2012-8.7")
"""Deviations that the header names."""


@pytest.mark.parametrize(
    ("mode", "style", "arithmetic", "dwell"),
    [
        ("exact", "table", "lattice", 0.1),
        ("exact", "table", "float", 0.0),
        ("freedom", "table", "double", 0.0),
        ("linear", "table", "lattice", 0.0),
        ("linear", "nested", "lattice", 0.1),
        ("freedom", "nested", "float", 0.0),
        ("small", "grid", "lattice", 0.0),
        ("same", "nested", "lattice", 0.1),
        ("plain cells", "cells", "double", 0.0),
        ("rows", "cells", "lattice", 0.1),
        ("rows of some axes", "cells", "lattice", 0.0),
    ],
)
def test_misra(tmp_path, mode, style, arithmetic, dwell):
    plan = plan_of("cart-pendulum", "freedom") if mode == "freedom" else plan_of("cart-pendulum")
    if mode in ("small", "linear"):  # whose conditions do not follow from others
        plan = random_plan(8, depth=3, oblique=0.5 * (mode == "linear"))
        assert (mode == "linear") == (len(plan.tree.cells.planes) > 1)
    if style == "cells":
        policy = random_affine_policy(3, some_axes=mode != "rows")
        policy = random_policy(3) if mode == "plain cells" else policy
        plan = Plan.of(dataclasses.replace(policy, name="cart-pendulum"))
    plan = dataclasses.replace(plan, dwell=dwell)
    if mode == "same":  # the default control is a symbol's, and nothing waits outside
        source = dataclasses.replace(
            random_plan(8, depth=3).policy, default=np.array([5.0]), outside=0, outside_at_once=True
        )
        plan = Plan.of(source, dwell=dwell)
        assert plan.same_control
    assert_misra(files(plan, None, style=style, arithmetic=arithmetic), tmp_path, arithmetic)


@pytest.mark.parametrize("style", ["table", "nested", "grid"])
def test_misra_of_features(tmp_path, style):
    assert_misra(files(Plan.of(exact()), None, style=style), tmp_path)


@pytest.mark.parametrize("kind", REMEMBERING)
def test_misra_of_what_remembers(tmp_path, kind):
    plan = Plan.of(remembering(2, **REMEMBERING[kind]), safe=1, hold_off=1.0 * (kind == "holds"))
    style = "cells" if kind == "forbidden" else "table"
    assert_misra(files(plan, None, style=style, tick=0.01), tmp_path)


def test_misra_of_mirrors_and_references(tmp_path, monkeypatch):
    written = files(plan_of("cart-pole"), None)
    assert b"_half(y)" in written["cart_pole.c"] and b"references" in written["cart_pole.c"]
    assert_misra(written, tmp_path / "both")
    monkeypatch.setattr(c_stream, "MIRRORED_AXIS", 0)
    monkeypatch.setattr(c_stream, "TURNED_LABELS", 0)
    split = [0, 0, 0, -1, -1, 0, -1, -1, 0, 0, -1, -1, 0, -1, -1]
    threshold = [4, 2, 1, 0, 2, 3, 0, 2, 6, 5, 2, 1, 7, 2, 1]  # 0 becomes 1, and 2 stays
    written = files(plan_of_nodes((8,), split, threshold, label_count=3), None)
    assert b"few_turned_0[label]" in written["few.c"]
    assert_misra(written, tmp_path / "table")


@pytest.mark.parametrize("name", [name for name in FINE if name != "decimal"])
def test_misra_of_lines(tmp_path, name):
    plan = Plan.of(random_plan(8192, depth=3).policy, scale=FINE[name][0], offset=FINE[name][1])
    assert_misra(made_of_counts(plan).files, tmp_path)


@pytest.mark.parametrize("turn", [-4096, 1000])
def test_misra_of_counts(tmp_path, turn, monkeypatch):
    if turn > 0:  # as where rounding decides at each face
        monkeypatch.setattr(c_counts, "line_of", lambda *_: None)
    plan = Plan.of(random_plan(8, depth=3).policy, scale=[2 * np.pi / turn, 0.01])
    written = files(plan, None, readings="int16")
    assert (b"_axis_rank" if turn > 0 else b"_axis_step") in written["cart_pendulum.c"]
    assert_misra(written, tmp_path)


def assert_misra(written, tmp_path, arithmetic="lattice"):
    need("cppcheck")
    write(written, tmp_path)
    prefix = prefix_of(written)
    command = "cppcheck -q --addon=misra --enable=style --std=c99 --template={id}"
    command += f" {prefix}.c"
    # the addon is a Python program, run once for each configuration: by this Python, without a shim
    here = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    told = subprocess.run(command.split(), cwd=tmp_path, capture_output=True, text=True, env=here)
    assert told.returncode == 0, told.stdout + told.stderr
    known = ADVISORY if arithmetic == "lattice" else ADVISORY[:1]
    assert set(known) <= set(told.stderr.splitlines()), "the rules were not applied"
    found = [line for line in told.stderr.splitlines() if "[" not in line and line.strip(" ^")]
    assert {line for line in found if "misra" in line or "-" not in line} <= set(ADVISORY)
    assert all(rule.split("-")[-1] in written[f"{prefix}.h"].decode() for rule in ADVISORY)
