import dataclasses
import re

import numpy as np
import pytest

import capsyn
from capsyn import Alphabet, Box, Policy
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.errors import ProblemError
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.structured_text.functions import NESTING
from capsyn.exports.structured_text.target import TARGET
from support.exports.policies import PROBLEMS, built_in, oblique
from support.trees import GRIDS, random_policy, random_tree

pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
pytest.importorskip(
    "tree_sitter_iec61131_3_st", reason="tree-sitter-iec61131-3-st is not installed"
)
from support.exports.structured_text import check, source  # noqa: E402

STYLES = ("nested", "table")


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("name", PROBLEMS)
def test_every_golden_vector_has_its_symbol_and_status(name, style):
    check(Plan.of(built_in(name)), style=style)


@pytest.mark.parametrize("mode", ["freedom", "linear"])
def test_compressed_trees_too(mode):
    tree = oblique()
    if mode == "freedom":
        tree = capsyn.compress(built_in("cart-pendulum"), mode, states=5_000)
    assert tree.guarantee.mode == mode
    for style in STYLES:
        check(Plan.of(tree), style=style)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_random_policies_on_periodic_axes(grid, style):
    policy = random_policy(grid, periodic=True, seed=grid)
    plan = Plan.of(policy, safe=grid % 3 if grid % 3 < 2 else None)
    rng = np.random.default_rng(grid)
    far = policy.domain.sample(50, 1) * 10.0 ** rng.uniform(0, 300, (50, plan.n))
    check(plan, style=style)
    check(plan, decide(plan, far), style=style)


def test_outside_nearest():
    policy = random_policy(3)
    nearest = Policy(
        "nearest", policy.domain, policy.alphabet, policy.default, policy.cells, "nearest"
    )
    check(Plan.of(nearest))


@pytest.mark.parametrize("style", STYLES)
def test_readings_are_scaled_as_written(style):
    policy = random_policy(3, periodic=True)
    plan = Plan.of(policy, scale=[0.1, -3e-5], offset=[0.3, 1e-3])
    check(plan, style=style)


def test_deep_trees_are_cut_into_functions():
    depth, count = 300, 2**20
    split = np.full(2 * depth + 1, LEAF)
    split[: 2 * depth : 2] = 0
    second = np.arange(2 * depth + 1)
    second[: 2 * depth : 2] += 2
    threshold = np.arange(2 * depth + 1) % 3
    threshold[: 2 * depth : 2] = 7 + 3000 * np.arange(depth)
    tree = SplitTree(
        (count,), *(a.astype(np.int32) for a in (split, threshold, second)), np.zeros((0, 1), "i4")
    )
    tree.check(3)
    policy = Policy(
        "deep", Box([-1], [2]), Alphabet([1, 2]), np.zeros(1), random_tree((1,), (2,), 0)
    )
    made = capsyn.DecisionTree(
        "deep", policy.domain, policy.alphabet, policy.default, tree, "error",
        guarantee=capsyn.compress(policy).guarantee,
    )  # fmt: skip
    plan = Plan.of(made)
    for style in STYLES:
        check(plan, style=style)
    exported = TARGET.files(plan, golden_vectors(plan), style="table")
    assert exported.notes == ("tables of 32-bit numbers (DINT): thresholds",)
    assert b"wanted := DINT_TO_INT(thresholds[node]);" in exported.files["deep.st"]
    count = source(plan).count(b"END_FUNCTION\n")
    assert count == 1 + -(-depth // NESTING)  # lattice steps, and a chain as few as can be
    depths = np.cumsum(
        [
            line.strip().startswith("IF ") - (line.strip() == "END_IF;")
            for line in source(plan).decode().splitlines()
        ]
    )
    assert depths.max() <= NESTING


def test_names_that_the_language_keeps():
    names = ["SYMBOL", "Var", "x0", "Z1", "ünit *) (*", "9 9"]
    n = len(names)
    policy = Policy(
        "Function_Block",
        Box(-np.ones(n), np.ones(n), names=names, units=["°C"] * n),
        Alphabet([[1, 2], [3, 4]], names=["on *)", "off"], inputs=["Status", "a" * 200]),
        np.zeros(2),
        random_tree((1,) * n, (2,) * n, 1),
    )
    plan = Plan.of(policy)
    text = source(plan).decode("ascii")
    assert "FUNCTION_BLOCK Function_Block_2" in text
    for reading in ("SYMBOL_2", "Var_2", "x0", "Z1", "unit", "n9_9", "Status_2", "a" * 32):
        assert re.search(rf"^    {reading} : LREAL;", text, re.M), reading
    assert "Renamed: 'SYMBOL' is SYMBOL_2" in text
    for style in STYLES:
        for dialect in ("iec", "siemens"):
            check(plan, style=style, dialect=dialect)


def test_states_may_be_called_like_functions():
    domain = dataclasses.replace(random_policy(3).domain, names=["random_tree1", "random_step"])
    check(Plan.of(dataclasses.replace(random_policy(3), domain=domain)))


def test_same_input_same_bytes_and_header():
    plan = Plan.of(built_in("double-tank-b"))
    assert source(plan) == source(Plan.of(built_in("double-tank-b")))
    text = source(plan).decode()
    for line in plan.header:
        assert line[:60] in text


def test_style_must_be_known():
    with pytest.raises(ProblemError, match="style"):
        source(Plan.of(built_in("double-tank-b")), style="short")
