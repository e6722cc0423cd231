"""Single precision: the policy at the float state, and what that changes."""

import dataclasses

import numpy as np
import pytest

import capsyn
from capsyn.errors import ProblemError
from capsyn.exports.c.readings.single import decide_single
from capsyn.exports.c.target import TARGET as c
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import Plan
from support.exports.c_machines import (
    Library,
)
from support.exports.c_plans import (
    NESTED,
    STYLES,
    back_in_single_precision,
    files,
    golden_of,
    made,
    plan_of,
    plan_of_nodes,
    policy,
    random_plan,
)


@pytest.mark.parametrize(
    ("name", "mode", "style"),
    [
        *((name, "exact", style) for name in ("lopsided", "cart-pole") for style in STYLES),
        ("cart-pendulum", "exact", "table"),
        ("cart-pendulum", *NESTED),
    ],
)
def test_float_arithmetic_is_the_policy_at_the_float_state(tmp_path, name, mode, style):
    plan, states = plan_of(name, mode), golden_of(name, mode).states.astype(np.float32)
    domain = plan.policy.domain
    # a periodic float below the double bound rounds up to the float bound: it is the last step
    near = back_in_single_precision(domain, states).astype(float)
    expected = decide(plan, near)
    code = made(plan, golden_of(name, mode), style=style, arithmetic="float")
    symbols, statuses = Library(code.files, tmp_path, plan.n).decide(states)
    assert np.array_equal(statuses, expected.statuses)
    assert np.array_equal(symbols, expected.labels)
    golden = code.golden  # vectors of its own, since some differ from the policy at the double
    assert np.array_equal(golden.readings, states.astype(float), equal_nan=True)
    assert np.array_equal(golden.labels, expected.labels)
    assert np.array_equal(golden.statuses, expected.statuses)
    assert np.array_equal(golden.steps, expected.steps)
    assert name != "cart-pendulum" or (golden.labels != golden_of(name, mode).labels).any()


@pytest.mark.parametrize(
    ("scale", "offset"), [(1.0, 0.0), (1e-6, 1e6), (-2 * np.pi / 4096, 0.1), (3e-5, -7.0)]
)
def test_what_single_precision_changes(tmp_path, scale, offset):
    plan = Plan.of(plan_of("lopsided").policy, scale=scale, offset=offset)
    code = made(plan, arithmetic="float")
    library = Library(code.files, tmp_path, plan.n)
    symbols, statuses = library.decide(code.golden.readings)
    assert np.array_equal(symbols, code.golden.labels)
    assert np.array_equal(statuses, code.golden.statuses)
    readings = (plan.policy.domain.sample(20_000) - offset) / scale
    exact = decide(plan, readings)
    symbols, statuses = library.decide(readings)
    share = ((symbols != exact.labels) | (statuses != exact.statuses)).mean()
    assert code.changed == pytest.approx(share, abs=1e-12)
    assert (share > 0.1) == (offset == 1e6)  # which takes 20 of 24 bits
    told = " ".join(code.files["cart_pendulum.h"].decode().replace("\n *", " ").split())
    assert f"{share:.3%} of 20,000 random states" in told
    assert ("Rounding readings, scale and offset" in told) == plan.folded


@pytest.mark.parametrize(
    ("what", "options"),
    [
        ("`scale`", {"scale": 1e300}),
        ("`scale`", {"scale": -1e-50}),
        ("`offset`", {"offset": 1e-60}),
        ("controls", {"default": 1e39}),
        ("controls", {"default": -1e-46}),
    ],
)
def test_numbers_that_single_precision_does_not_hold(what, options):
    default = np.array([options.pop("default", 0.0)])
    source = dataclasses.replace(policy("cart-pendulum"), default=default)
    with pytest.raises(ProblemError, match=f"float needs {what} between .*; got -?1e"):
        files(Plan.of(source, **options), golden_of("cart-pendulum"), arithmetic="float")


def test_the_farthest_float_is_brought_into_its_period(tmp_path):
    for bound, taken in ((1e32, False), (1.1e31, False), (9.9e30, True)):
        box = capsyn.Box([-bound], [bound], periodic=(True,))
        plan = plan_of_nodes((4,), [0, -1, -1], [2, 0, 1], box=box)
        if not taken:
            with pytest.raises(ProblemError, match="float needs bounds of a periodic axis within"):
                files(plan, None, arithmetic="float")
            continue
        library = Library(files(plan, None, arithmetic="float"), tmp_path, 1)
        most = np.finfo(np.float32).max
        states = np.array([[most], [-most], [1e37], [-3e38]], dtype=np.float32)
        assert np.array_equal(library.decide(states)[0], decide_single(plan, states).labels)


def test_tables_of_faces_are_told_and_limited():
    tree = random_plan(3000, depth=3, oblique=1.0)
    made = c.files(tree, golden_vectors(tree), arithmetic="float")
    faces = sum(tree.tree.cells.counts) - tree.n
    assert f"tables of the faces take {4 * faces:,} bytes" in " ".join(made.notes)
    with pytest.raises(ProblemError, match="`arithmetic` float tabulates all .* take lattice"):
        files(random_plan(9000, depth=3, oblique=1.0), None, arithmetic="float")
