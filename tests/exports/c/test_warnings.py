"""Exported C without a warning: every option by every compiler, and policies of hardly anything."""

import dataclasses
import itertools
import subprocess

import numpy as np
import pytest

import capsyn
from capsyn.cells.split_tree import LEAF
from support.exports.c_machines import WARNINGS, need
from support.exports.c_plans import COMPILERS, STYLES, made, plan_of_nodes, random_plan

READINGS = (
    {"arithmetic": "lattice"},
    {"arithmetic": "double"},
    {"arithmetic": "float"},
    {"readings": "int16"},
    {"readings": "int32"},
)
TURN = 2 * np.pi / 1000
"""Scale by which a turn of the angle is a whole number of counts."""


def plans():
    """Yield plans of a small tree, among which any two things occur together in every way."""
    for a, b, c in itertools.product((0, 1), repeat=3):
        dwell, nearest, gaps, folded, oblique = a, b, c, a ^ b, a ^ c
        plan = random_plan(8, depth=3, oblique=0.5 * oblique)
        policy = dataclasses.replace(plan.policy, gaps=bool(gaps), outside_at_once=bool(b ^ c))
        scale, offset = ([-TURN, 0.01], [0.1, 0.25]) if folded else ([1.0, 1.0], [0.0, 0.0])
        yield dataclasses.replace(
            plan,
            policy=policy,
            dwell=0.1 * dwell,
            nearest=bool(nearest),
            scale=np.array(scale),
            offset=np.array(offset),
        )


def few_plans():
    """Yield plans of hardly anything: leaves, axes of one step, symbols, states."""
    one, two = capsyn.Box([-1], [1]), capsyn.Box([-1, 0], [1, 3], periodic=(True, False))
    three = capsyn.Box([0] * 3, [1] * 3, periodic=(True, False, True))
    yield plan_of_nodes((1,), [LEAF], [0], box=one)
    yield plan_of_nodes((1, 1), [LEAF], [1], box=two)
    yield plan_of_nodes((5, 4), [LEAF], [0], box=two, label_count=2)
    yield plan_of_nodes((1, 4), [1, LEAF, LEAF], [2, 0, 1], box=two)
    yield plan_of_nodes((4, 1), [0, LEAF, LEAF], [2, 1, 0], box=two)
    yield plan_of_nodes((1, 1, 2), [2, LEAF, LEAF], [1, 1, 1], box=three)
    yield plan_of_nodes((1, 2), [2, LEAF, LEAF], [1, 0, 1], [[0, 1]], box=two)
    yield plan_of_nodes((1, 1), [2, LEAF, LEAF], [1, 0, 1], [[0, 0]], box=two)
    many = 60
    split = [0, LEAF] * (many - 1) + [LEAF]
    threshold = [k // 2 + 1 if k % 2 == 0 else k // 2 for k in range(2 * many - 1)]
    threshold[-1] = many - 1
    yield plan_of_nodes((many,), split, threshold, box=one, label_count=many)


UNDEFINED = "".join(f"#undef CAPSYN_{name}\n" for name in ("ROM", "COPY", "BYTE"))
"""Ends each source where many are compiled as one, so that an unused macro is told of each."""


def source_of(chosen, directory):
    """Write the headers of plans by all options; return how many, and their sources as one file."""
    sources = []
    every = (
        (p, s, r) for p in chosen for s in STYLES[: 3 if p.tree.depth else 1] for r in READINGS
    )
    for plan, style, readings in every:
        name = f"p{len(sources)}"
        if "readings" in readings and (plan.scale == 1).all():
            widths = plan.policy.domain.widths
            plan = dataclasses.replace(plan, scale=widths / 1000, offset=0 * widths)
        files = made(plan, name=name, style=style, **readings).files
        assert files[f"{name}.c"].endswith((b"\n}\n", b"\n#endif\n"))
        (directory / f"{name}.h").write_bytes(files[f"{name}.h"])
        sources.append(files[f"{name}.c"].decode())
    (directory / "all.c").write_text(UNDEFINED.join(sources))
    return len(sources)


@pytest.fixture(scope="module")
def every_option(tmp_path_factory):
    directory = tmp_path_factory.mktemp("options")
    return directory, source_of(plans(), directory)


@pytest.fixture(scope="module")
def hardly_anything(tmp_path_factory):
    directory = tmp_path_factory.mktemp("few")
    return directory, source_of(
        (dataclasses.replace(plan, dwell=0.1) for plan in few_plans()), directory
    )


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("written", ["every_option", "hardly_anything"])
def test_no_warning(request, written, compiler):
    need(compiler)
    directory, count = request.getfixturevalue(written)
    assert count >= 100
    how = (
        ["-fsyntax-only"] if compiler == "clang" else ["-O1", "-S"]
    )  # GCC warns while it optimises
    command = [compiler, "-std=c99", *how, *WARNINGS, "all.c"]
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr[:4000]
