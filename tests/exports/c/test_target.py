import dataclasses
import functools
import re
import subprocess
import time
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import capsyn
from capsyn import problems
from capsyn.cells.split_tree import LEAF, SplitTree, _second_children
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.exports.c import sizes as c_sizes
from capsyn.exports.c import target as c
from capsyn.exports.c.language import comment, round_up
from capsyn.exports.c.readings import counts as c_counts
from capsyn.exports.c.readings.lines import Line, exact_line, line_of, near_line
from capsyn.exports.c.readings.single import decide_single
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.styles import table as c_table
from capsyn.exports.export import export
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import NOT_FINITE, OK, Plan
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree
from support.c_machines import WARNINGS, Library, avr, call, cortex_m3, need, prefix_of, write
from support.trees import random_tree

POLICIES = {
    "cart-pendulum": {},
    "cart-pendulum-4": {},
    "double-tank-a": {},
    "double-tank-b": {},
    "cart-pole": {"max_level": 2},
}
NAMES = (*POLICIES, "lopsided")
"""Policies, and a random tree: that of the pendulum is the same at theta and at -theta."""
STYLES = ("table", "nested", "grid")
COMPILERS = ("gcc", "clang")
NESTED = ("linear", "nested")


UNDEFINED = ["-O1", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover"]
"""Options by which a program ends where what it does is undefined."""


def made(plan, golden=None, **options):
    """Return what target c makes."""
    if golden is None and options.get("arithmetic") == "float":
        golden = golden_vectors(plan)
    return c.files(plan, golden, **options)


def files(plan, golden, **options):
    """Return the files of target c."""
    return made(plan, golden, **options).files


@functools.cache
def policy(name):
    return capsyn.synthesize(problems.get(name), **POLICIES[name])


@functools.cache
def plan_of(name, mode="exact"):
    if name == "lopsided":
        return random_plan(144)
    if mode == "linear":  # as such trees are, but made at once
        return random_plan(200, 2, 7, oblique=0.4)
    return Plan.of(policy(name) if mode == "exact" else capsyn.compress(policy(name), mode=mode))


@functools.cache
def golden_of(name, mode="exact"):
    return golden_vectors(plan_of(name, mode))


def random_plan(count, label_count=3, depth=10, seed=1, oblique=0.0):
    """Return a plan of a random tree over the pendulum's states with many steps per axis.

    A share of its splits is oblique.
    """
    rng = np.random.default_rng(seed)
    source = policy("cart-pendulum")
    nodes, planes = [], []

    def grow(lower, upper, level):
        axis = int(rng.integers(2))
        if level == depth or upper[axis] - lower[axis] < 2 or rng.random() < 0.03:
            nodes.append((LEAF, int(rng.integers(label_count))))
            return
        if rng.random() < oblique:
            plane = rng.integers(-60, 61, 2)
            nodes.append((2 + len(planes), int(plane @ rng.integers(lower, upper))))
            planes.append(plane)
            grow(lower, upper, level + 1)
            return grow(lower, upper, level + 1)
        cut = int(rng.integers(lower[axis] + 1, upper[axis]))
        nodes.append((axis, cut))
        below, above = list(upper), list(lower)
        below[axis] = above[axis] = cut
        grow(lower, below, level + 1)
        grow(above, upper, level + 1)

    grow([0, 0], [count, count], 0)
    split, threshold = np.array(nodes, dtype=np.int32).T.copy()
    second = _second_children(split == LEAF).astype(np.int32)
    rows = np.array(planes, dtype=np.int32).reshape(-1, 2)
    tree = SplitTree((count, count), split, threshold, second, rows)
    tree.check(label_count)
    return Plan.of(DecisionTree.of(source, tree, Guarantee("exact", "0" * 64)))


def test_the_lopsided_tree_is_not_symmetric():
    for name, least in (("cart-pendulum", 0), ("lopsided", 5000)):
        tree = plan_of(name).tree.cells
        steps = np.stack(np.indices(tree.counts), axis=-1).reshape(-1, 2)
        turned = np.array(tree.counts) - 1 - steps
        assert np.count_nonzero(tree.labels(steps) != tree.labels(turned)) >= least


def assert_golden(library, golden, lattice):
    symbols, statuses = library.decide(golden.states)
    assert np.array_equal(symbols, golden.labels)
    assert np.array_equal(statuses, golden.statuses)
    if lattice:
        assert np.array_equal(library.steps(golden.states), golden.steps)
        found = golden.statuses == OK
        assert np.array_equal(library.look(golden.steps[found]), golden.labels[found])


def plan_of_nodes(counts, split, threshold, planes=(), box=None, label_count=2):
    """Return a plan of a tree that is given by its nodes, over a box from 0 to 1 by default."""
    n, split = len(counts), np.array(split, dtype=np.int32)
    second = _second_children(split == LEAF).astype(np.int32)
    planes = np.array(planes, dtype=np.int32).reshape(-1, n)
    tree = SplitTree(counts, split, np.array(threshold, dtype=np.int32), second, planes)
    tree.check(label_count)
    box = box or capsyn.Box([0] * n, [1] * n)
    alphabet = capsyn.Alphabet(np.arange(1.0, label_count))
    cells = random_tree((1,) * n, (2,) * n, 0, leaf_count=label_count)
    source = capsyn.Policy("few", box, alphabet, np.zeros(1), cells)
    return Plan.of(DecisionTree.of(source, tree, Guarantee("exact", "0" * 64)))


@pytest.mark.parametrize(
    ("name", "style", "compiler"),
    [
        *((name, style, "gcc") for name in NAMES for style in STYLES),
        *(("lopsided", style, "clang") for style in STYLES),
        ("cart-pole", "table", "clang"),
    ],
)
def test_golden_vectors(tmp_path, name, style, compiler):
    plan, golden = plan_of(name), golden_of(name)
    library = Library(files(plan, golden, style=style), tmp_path, plan.n, compiler)
    assert_golden(library, golden, True)


@pytest.mark.parametrize(
    ("mode", "style"), [*(("freedom", style) for style in STYLES), ("linear", "table"), NESTED]
)
@pytest.mark.parametrize("arithmetic", ["lattice", "double"])
def test_golden_vectors_of_compressed_trees(tmp_path, mode, style, arithmetic):
    plan, golden = plan_of("cart-pendulum", mode), golden_of("cart-pendulum", mode)
    written = files(plan, golden, style=style, arithmetic=arithmetic)
    assert_golden(Library(written, tmp_path, plan.n), golden, arithmetic == "lattice")


@pytest.mark.parametrize("compiler", COMPILERS)
def test_products_are_not_contracted(tmp_path, compiler):
    plan, golden = plan_of("cart-pendulum"), golden_of("cart-pendulum")
    options = ["-O2", "-march=native", "-ffp-contract=fast"]
    library = Library(files(plan, golden), tmp_path, plan.n, compiler, options)
    assert_golden(library, golden, True)


@pytest.mark.parametrize(
    ("name", "mode", "style", "options"),
    [
        *(("cart-pole", "exact", style, {}) for style in STYLES),
        *(("cart-pendulum", "linear", style, {}) for style in STYLES),
        ("cart-pendulum", *NESTED, {"arithmetic": "double"}),
        ("cart-pendulum", "linear", "table", {"arithmetic": "float"}),
        *(("lopsided", "exact", style, {"arithmetic": "double"}) for style in STYLES),
        *(("lopsided", "exact", style, {"arithmetic": "float"}) for style in ("table", "nested")),
    ],
)
@pytest.mark.parametrize("folded", [False, True])
def test_nothing_is_undefined(tmp_path, name, mode, style, options, folded):
    plan = plan_of(name, mode)
    if folded:
        plan = dataclasses.replace(plan, scale=plan.scale * -3e-4, offset=plan.offset + 0.7)
    plan = dataclasses.replace(plan, dwell=0.1)
    golden = golden_vectors(plan) if folded else golden_of(name, mode)
    rng = np.random.default_rng(3)
    far = rng.normal(size=(200, plan.n)) * 10.0 ** rng.uniform(0, 300, size=(200, 1))
    most = np.array([1, -1])[:, None] * np.full(plan.n, np.finfo(np.float32).max)
    golden = decide(plan, np.concatenate([golden.readings, far, most, 5 * most]))
    code = made(plan, golden, style=style, **options)
    golden = code.golden or golden
    library = Library(code.files, tmp_path, plan.n, "gcc", UNDEFINED)
    symbols, statuses = library.decide(golden.readings)
    assert np.array_equal(symbols, golden.labels)
    assert np.array_equal(statuses, golden.statuses)
    ticks = rng.integers(1 << 32, size=len(golden))
    assert np.isin(library.run(golden.readings, ticks), golden.labels).all()


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("mode", ["exact", "linear", "heavy"])
def test_steps_beyond_the_lattice_are_taken_as_the_nearest(tmp_path, style, mode):
    plan = plan_of_nodes((3, 3), [2, -1, -1], [1 << 28, 0, 1], [[-(2**29), 2**27]])
    if mode != "heavy":
        plan = plan_of("cart-pendulum", mode)
    counts = np.array(plan.tree.cells.counts)
    rng = np.random.default_rng(2)
    ends = np.array([-32768, -32767, -1, 0, 1, 32766, 32767])
    steps = np.stack(np.meshgrid(ends, [*ends, *(counts[1] + [-2, -1, 0])]), axis=-1).reshape(-1, 2)
    steps = np.concatenate([steps, steps[:, ::-1], rng.integers(-32768, 32768, (2000, 2))])
    steps = np.concatenate([steps, rng.integers(-counts, 2 * counts, (2000, 2))])
    library = Library(files(plan, None, style=style), tmp_path, 2, "gcc", UNDEFINED)
    nearest = np.clip(steps, 0, counts - 1)
    assert np.array_equal(library.look(steps), plan.tree.cells.labels(nearest))


@pytest.mark.parametrize("arithmetic", ["lattice", "double", "float"])
@pytest.mark.parametrize("threshold", [0, 1])
def test_a_plane_of_zeros_alone(tmp_path, arithmetic, threshold):
    plan = plan_of_nodes((3, 3), [2, -1, -1], [threshold, 0, 1], [[0, 0]])
    written = files(plan, None, style="nested", arithmetic=arithmetic)
    for compiler in COMPILERS:
        library = Library(written, tmp_path / compiler, 2, compiler)
        assert library.decide(np.full((1, 2), 0.5))[0] == 1 - threshold


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("name", ["lopsided", "double-tank-a", "cart-pole"])
def test_double_arithmetic(tmp_path, name, style):
    plan, golden = plan_of(name), golden_of(name)
    written = files(plan, golden, style=style, arithmetic="double")
    assert_golden(Library(written, tmp_path, plan.n), golden, False)


def back_in_single_precision(domain, states):
    """Return float states with periodic axes brought back as the header says."""
    states = states.copy()
    for i in np.flatnonzero(domain.periodic):
        low, high = round_up(domain.lower[i : i + 1])[0], round_up(domain.upper[i : i + 1])[0]
        off = np.isfinite(states[:, i]) & ~((states[:, i] >= low) & (states[:, i] < high))
        rest = np.fmod(states[off, i] - low, high - low)
        rest = low + np.where(rest < 0, rest + (high - low), rest)
        states[off, i] = np.where(rest >= high, low, rest)
    return states


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


def test_the_bound_on_turns_of_the_loop_is_told():
    header = files(plan_of("cart-pendulum"), None)["cart_pendulum.h"].decode()
    (turns,) = re.findall(r"finite up to ([\d,]+)", header.replace("\n *  ", ""))
    assert turns == "2,045"  # 2 ceil(log2(DBL_MAX / 2 pi)) + 1
    assert (
        "turns of a loop" not in files(plan_of("double-tank-a"), None)["double_tank_a.h"].decode()
    )


@pytest.mark.parametrize("arithmetic", ["lattice", "double", "float"])
@pytest.mark.parametrize("style", ["table", "nested"])
def test_states_far_outside_a_period(tmp_path, arithmetic, style):
    plan = random_plan(1 << 12)  # the pendulum's own policy is the same at theta and -theta
    rng = np.random.default_rng(5)
    theta = rng.choice([-1.0, 1.0], 4000) * 10.0 ** rng.uniform(-20, 37, 4000)
    theta[::2] = rng.uniform(-30, 30, 2000)
    if arithmetic != "float":
        theta[1000:] *= 1e270
    states = np.column_stack([theta, rng.uniform(-5, 5, 4000)])
    library = Library(files(plan, None, style=style, arithmetic=arithmetic), tmp_path, plan.n)
    symbols, statuses = library.decide(states)
    if arithmetic == "float":
        states = back_in_single_precision(plan.policy.domain, states.astype(np.float32))
    expected = decide(plan, states.astype(float))
    assert np.array_equal(symbols, expected.labels)
    assert np.array_equal(statuses, expected.statuses)


@pytest.mark.parametrize("style", STYLES)
def test_outside(tmp_path, style):
    nearest = dataclasses.replace(policy("double-tank-a"), outside="nearest")
    for case, plan in enumerate([Plan.of(nearest, safe=1), Plan.of(nearest, safe=None),
                                 Plan.of(policy("double-tank-a"), safe=1)]):  # fmt: skip
        golden = golden_vectors(plan)
        written = files(plan, golden, style=style)
        assert_golden(Library(written, tmp_path / str(case), plan.n), golden, True)
    lost = golden.labels[golden.statuses == NOT_FINITE]
    assert lost.size and (lost == 1).all()


@pytest.mark.parametrize("style", ["table", "nested"])
def test_readings(tmp_path, style):
    scale, offset = np.array([2 * np.pi / 4096, -0.003]), np.array([0.1, 0.25])
    plan = Plan.of(policy("cart-pendulum"), scale=scale, offset=offset)
    counts = np.random.default_rng(0).integers(-5000, 5000, size=(5000, 2)).astype(float)
    expected = decide(plan, np.concatenate([counts, golden_vectors(plan).readings]))
    for arithmetic in ("lattice", "double"):
        written = files(plan, None, style=style, arithmetic=arithmetic)
        library = Library(written, tmp_path / arithmetic, plan.n)
        symbols, statuses = library.decide(expected.readings)
        assert np.array_equal(symbols, expected.labels)
        assert np.array_equal(statuses, expected.statuses)
    assert "State 0 = 0.0015339807878856412 * reading + 0.1" in written["cart_pendulum.h"].decode()


COUNTS = {
    "encoder and converter": ([2 * np.pi / 4096, 10 / 4096], [0.0, -5.0]),
    "falling": ([-2 * np.pi / 4096, -0.003], [0.1, 0.25]),
    "full scale": ([2 * np.pi / 65536, 10 / 65536], [-0.5, 0.0]),
    "no power of two": ([2 * np.pi / 1000, -10 / 999], [100.0, 0.0]),
    "on faces": ([-2 * np.pi / 144, 1 / 3000], [0.0, 0.1]),
    "coarse": ([2 * np.pi / 100, 0.5], [0.01, 0.0]),
    "seam": ([-2 * np.pi / 36000, 0.01], [-np.pi, 0.0]),
    "tables": ([2 * np.pi / 65536, 0.001], [0.0, 0.0]),
}
"""Scales and offsets of counts, for the pendulum's angle and speed."""
FINE = {
    "coarse, falling": ([-2 * np.pi / 1000, -0.007], [0.5, 0.001], ["", "held"]),
    "coarse, offset": ([2 * np.pi / 1024, 0.0045], [-np.pi, 0.7], ["less", "wide held"]),
    "decimal": ([2 * np.pi / 6250, 0.0005], [0.1, 0.0003], ["wide", "wide"]),
    "decimal, on faces": ([2 * np.pi / 65536, 0.0004], [-np.pi, 0.001], ["less", "less more"]),
    "decimal, falling": ([-2 * np.pi / 10000, -0.00031], [0.1, 0.1], ["wide", "wide"]),
    "on faces": ([-2 * np.pi / 8192, 0.0007], [np.pi, 0.3], ["less", "less more"]),
}
"""The same for 8,192 steps per axis, with the lines that give the steps of counts."""


def kind_of(line):
    """Return words for what a line has besides its 32 bits."""
    words = {"wide": line.wide, "held": line.last, "less": line.less, "more": line.more}
    return " ".join(word for word, has in words.items() if has)


def in_turn(plan, counts):
    """Return counts with those of the angle in the turn that begins at the lower bound."""
    lower, upper = plan.policy.domain.lower[0], plan.policy.domain.upper[0]
    turn = round((upper - lower) / abs(plan.scale[0]))
    every = np.arange(-(1 << 18), 1 << 18, dtype=np.int64)
    first = every[every * plan.scale[0] + plan.offset[0] >= lower]
    first = first.min() if plan.scale[0] > 0 else first.max() - turn + 1
    return np.column_stack([first + (counts[:, 0] - first) % turn, counts[:, 1]])


def assert_golden_counts(library, plan, golden, bits):
    """Assert that golden vectors of counts are right, and where counts and steps change."""
    readings, limit = golden.readings, 1 << (bits - 1)
    assert len(golden) >= 2000 and readings.dtype == np.int64
    assert (readings.min(axis=0) == -limit).all() and (readings.max(axis=0) == limit - 1).all()
    expected = decide(plan, in_turn(plan, readings).astype(float))
    found = [library.steps(readings), *library.decide(readings)]
    for column in zip(found, ("steps", "labels", "statuses")):
        assert np.array_equal(column[0], getattr(golden, column[1]))
        assert np.array_equal(column[0], getattr(expected, column[1]))
    assert np.bincount(golden.statuses)[OK] > 500
    for axis, count, steps in zip(
        c_counts.count_axes(plan, f"int{bits}"), plan.tree.cells.counts, golden.steps.T
    ):
        assert len(np.unique(steps)) >= 0.9 * min(count - axis.missed, 1000)


def made_of_counts(plan):
    """Return what target c makes for counts, whatever their tables take."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CapsynWarning)
        return made(plan, readings="int16")


@pytest.mark.parametrize("name", [*COUNTS, *(f"fine, {name}" for name in FINE)])
def test_every_count(tmp_path, monkeypatch, name):
    fine = FINE.get(name.removeprefix("fine, ")) if "fine" in name else None
    tree = (random_plan(8192) if fine else plan_of("lopsided")).policy
    scale, offset = (fine or COUNTS[name])[:2]
    if name == "tables":
        monkeypatch.setattr(c_counts, "line_of", lambda *_: None)
    plan = Plan.of(tree, scale=scale, offset=offset)
    every = np.arange(-(1 << 15), 1 << 15)
    counts = np.column_stack([every, np.random.default_rng(0).permutation(every)])
    expected = decide(plan, in_turn(plan, counts).astype(float))
    code = made_of_counts(plan)
    written, golden = code.files, code.golden
    library = Library(written, tmp_path, plan.n, "gcc", UNDEFINED)
    assert_golden_counts(library, plan, golden, 16)
    assert np.array_equal(library.steps(counts), expected.steps)
    symbols, statuses = library.decide(counts)
    assert np.array_equal(symbols, expected.labels)
    assert np.array_equal(statuses, expected.statuses)
    axes = c_counts.count_axes(plan, "int16")
    for axis, count, steps in zip(axes, plan.tree.cells.counts, expected.steps.T):
        assert axis.missed == count - len(np.unique(steps))
    told = b"steps never occur" in written["cart_pendulum.h"]
    assert told == any(axis.missed for axis in axes)
    assert name != "coarse" or [axis.missed for axis in axes] == [44, 123]
    assert fine is None or [kind_of(axis.line) for axis in axes] == fine[2]
    assert max(len(text) for text in written["cart_pendulum.c"].splitlines()) <= 100
    code = written["cart_pendulum.c"].split(b"*/", 1)[1]
    assert code.count(b"double") == 1  # the table of controls


def test_counts_of_32_bits(tmp_path):
    tree = plan_of("lopsided").policy
    rng = np.random.default_rng(1)
    for case, (scale, offset) in enumerate([(1e-6, 0.0), (-5e-9, 0.25), (1e-3 / 3, 0.0)]):
        plan = Plan.of(tree, scale=[2 * np.pi / 2**17, scale], offset=[1.0, offset])
        axes = c_counts.count_axes(plan, "int32")
        assert kind_of(axes[1].line) == ("wide", "wide less more", "less")[case]
        changes = axes[1].first + np.array(axes[1].changes)
        near = (changes[:, None] + np.arange(-2, 3)).ravel()
        near = -1 - near if scale < 0 else near
        limits = [-(1 << 31), (1 << 31) - 1, 0, *axes[1].inside]
        speed = np.concatenate([near, limits, rng.integers(-(1 << 31), 1 << 31, 3000)])
        angle = rng.integers(-(1 << 31), 1 << 31, len(speed))
        counts = np.column_stack([angle, speed])
        expected = decide(plan, in_turn(plan, counts).astype(float))
        code = made(plan, readings="int32")
        library = Library(code.files, tmp_path / str(case), plan.n)
        assert_golden_counts(library, plan, code.golden, 32)
        assert np.array_equal(library.steps(counts), expected.steps)
        assert np.array_equal(library.decide(counts)[0], expected.labels)
        assert np.array_equal(library.decide(counts)[1], expected.statuses)


def test_whole_numbers_or_a_table():
    plan = plan_of("lopsided")
    found = {}
    for name, (scale, offset) in COUNTS.items():
        axes = c_counts.count_axes(Plan.of(plan.policy, scale=scale, offset=offset), "int16")
        found[name] = [axis.line for axis in axes]
    assert found["encoder and converter"] == [Line(9, 0, 8), Line(9, 252, 8)]
    assert all(found["full scale"]) and found["no power of two"][0]
    assert found["on faces"][1].less and found["on faces"][1].more  # by rounding of ties


@st.composite
def changes_near_a_line(draw):
    """Return the places where steps change, and the last place; some are off a line."""
    top = draw(st.integers(1, 400))
    slope, at = draw(st.floats(0.02, 5)), draw(st.floats(-1, 0))
    steps = np.arange(1, max(int(slope * top), 1) + 1)
    changes = np.ceil((steps - at) / slope).astype(np.int64)
    if draw(st.booleans()):
        changes += np.array(draw(st.lists(st.integers(-1, 1), min_size=5)))[steps % 5]
    return np.sort(changes.clip(0, top + 1)), top


@given(changes_near_a_line(), st.booleans(), st.booleans())
def test_lines_give_the_steps_of_all_places(case, wide, held):
    changes, top = case
    places = np.arange(top + 1)
    steps = np.searchsorted(changes, places, side="right")
    if held:  # where nothing is asked of the first place, and the last has the last step
        steps = np.append(0, np.maximum(steps, 1)[1:])
        changes = np.searchsorted(steps, np.arange(1, steps[-1] + 1))
    for line in (exact_line(changes, top, wide, held), near_line(changes, top, wide, held)):
        if line is None:
            continue
        found = np.array([p * line.factor + line.addend >> line.shift for p in places.tolist()])
        if line.last:
            found = np.append(0, np.minimum(found[:-1], line.last))
        found[list(line.less)] -= 1
        found[list(line.more)] += 1
        assert np.array_equal(found, steps)
        most = (top - (line.last > 0)) * line.factor + line.addend
        assert most < 1 << (62 if wide else 32) and line.factor < 1 << 32


def test_a_line_is_taken_where_it_is_smaller_than_a_table():
    rng = np.random.default_rng(0)
    near = 7 * np.arange(1, 300)
    assert line_of(near, 2100, False, 2) == exact_line(near, 2100, False, False)
    off = near + (np.arange(299) % 50 == 0)
    line = line_of(off, 2100, False, 2)
    assert line.less == tuple(near[::50].tolist()) and line.more == () and not line.wide
    assert line_of(off[:20], off[20], False, 2) is None  # as short as the list's code
    assert line_of(np.sort(rng.integers(1, 2100, 299)), 2100, False, 2) is None


def test_counts_on_faces_are_warned_of():
    plan = Plan.of(random_plan(8192, depth=3).policy, scale=[2 * np.pi / 4096, 10 / 4096 / 7])
    assert not sum(axis.table_bytes for axis in c_counts.count_axes(plan, "int16"))
    told = made(plan, readings="int16").notes  # no warning, which is an error
    assert [line.split(" is ")[0] for line in told] == [
        f"Readings are counts r; the step of axis {i}" for i in (0, 1)
    ]
    assert not any("tables" in line for line in told)
    on_faces = dataclasses.replace(plan, offset=np.array([-np.pi, 0.0]))
    axis = c_counts.count_axes(on_faces, "int16")[0]
    assert axis.table_bytes == 2 * axis.line.listed > 1024
    with pytest.warns(CapsynWarning) as warned:
        told = made(on_faces, readings="int16").notes
    (text,) = (str(warning.message) for warning in warned)
    assert f"take {axis.table_bytes:,} bytes for axis 'theta'" in text and "\n" not in text
    assert "cart_pendulum_symbol(z)" in text
    assert f"It takes {axis.table_bytes:,} bytes of tables." in told[0]
    better = float(re.search(r"`offset` of (\S+) ", text)[1])
    offset = np.array([better, 0.0])
    assert better == pytest.approx(-np.pi + np.pi / 8192, rel=1e-12)  # half a step
    mended = c_counts.count_axes(dataclasses.replace(plan, offset=offset), "int16")[0]
    assert f"takes {mended.table_bytes:,}" in text and mended.table_bytes == 0


def test_counts_need_no_floating_point():
    need("arm-none-eabi-gcc")
    for scale, most in ((2 * np.pi / 4096, 200), (-2 * np.pi / 1000, 300)):
        plan = Plan.of(policy("cart-pendulum"), scale=[scale, 0.01])
        found = sizes(files(plan, None, readings="int16"), "cart_pendulum")["cortex-m0"]
        assert 0 < found["quantiser"] <= most
        own = found["decision"] + found["quantiser"]
        assert found["with_library"] <= own + (4 if scale > 0 else 600)  # a division


@pytest.mark.parametrize(
    ("scale", "readings", "told"),
    [
        ([1.0, 0.01], "int8", "`readings` must be"),
        ([2 * np.pi / 2**33, 0.01], "int32", "axis 'theta'.*need 34 bits"),
        ([2 * np.pi / 2**17, 0.01], "int16", "axis 'theta'.*take int32"),
        ([2 * np.pi / 4096, 1e-4], "int16", "axis 'omega'.*need 17 bits; take int32"),
        ([2 * np.pi / 4096, 1e-18], "int32", "axis 'omega'.*counts of up to 5e"),
        ([0.001, 0.01], "int16", "'theta' a whole number of counts; got 6283.18"),
        ([2 * np.pi / 4096, -11.0], "int16", "coarser than axis 'omega'"),
    ],
)
def test_counts_that_do_not_fit(scale, readings, told):
    plan = Plan.of(policy("cart-pendulum"), scale=scale)
    with pytest.raises(ProblemError, match=told):
        files(plan, None, readings=readings)
    with pytest.raises(ProblemError, match="needs `arithmetic` lattice"):
        files(plan, None, readings="int16", arithmetic="double")


@pytest.mark.parametrize("default", [0.0, 5.0])  # 5: the same control as a symbol is no change
@pytest.mark.parametrize("dwell", [0.05, 0.1, 0.13])
def test_dwell_is_that_of_the_closed_loop(tmp_path, dwell, default):
    rate = 100.0
    source = dataclasses.replace(policy("cart-pendulum"), default=np.array([default]))
    starts = source.domain.sample(20, 3) * [1, 0.4]
    runs = capsyn.simulate(source, starts, 3, rate, min_dwell=dwell, outside="nearest")
    plan = Plan.of(dataclasses.replace(source, outside="nearest"), dwell=dwell)
    library = Library(files(plan, None, tick=1 / rate), tmp_path, plan.n)
    without = capsyn.simulate(source, starts, 3, rate, outside="nearest")
    assert runs.switches.sum() < without.switches.sum()
    for states, symbols, last in zip(runs.states, runs.symbols, runs.last):
        now = np.arange(last) + (1 << 32) - 50  # wraps around
        found = library.run(states[:last], now % (1 << 32))
        assert np.array_equal(found, symbols[:last] % plan.labels)


def of_vectors(golden, rows):
    """Return some rows of golden vectors."""
    names = [field.name for field in dataclasses.fields(golden)]
    return dataclasses.replace(golden, **{name: getattr(golden, name)[rows] for name in names})


@pytest.mark.parametrize("mode", ["exact", "freedom", "linear"])
@pytest.mark.parametrize("style", ["table", "nested"])
def test_cortex_m3(tmp_path, mode, style):
    plan, golden = plan_of("cart-pendulum", mode), golden_of("cart-pendulum", mode)
    golden = of_vectors(golden, golden.statuses == OK)
    assert len(golden) >= 2000
    assert cortex_m3(files(plan, golden, style=style), golden, tmp_path) == 0


@pytest.mark.parametrize("mode", ["exact", "freedom", "linear"])
@pytest.mark.parametrize("style", ["table", "nested"])
def test_avr(tmp_path, mode, style):
    plan, golden = plan_of("cart-pendulum", mode), golden_of("cart-pendulum", mode)
    golden = of_vectors(golden, np.flatnonzero(golden.statuses == OK)[::2])
    assert avr(files(plan, golden, style=style), golden, tmp_path) == 0


def test_quantisers_on_processors(tmp_path):
    plan, golden = plan_of("lopsided"), golden_of("lopsided")
    written = files(plan, golden)  # doubles by a library, in all turns of the angle
    assert cortex_m3(written, golden, tmp_path / "double", "decide") == 0
    wrong = dataclasses.replace(golden, labels=np.r_[golden.labels[:-1], plan.labels])
    assert cortex_m3(written, wrong, tmp_path / "wrong", "decide") == 1
    scale = [-2 * np.pi / 4096, 10 / 4096]
    code = made(Plan.of(plan.policy, scale=scale, offset=[0.1, 0.0]), readings="int16")
    assert cortex_m3(code.files, code.golden, tmp_path / "counts", "decide") == 0
    for name in ("coarse, offset", "decimal, falling", "on faces"):
        fine = Plan.of(random_plan(8192, depth=5).policy, scale=FINE[name][0], offset=FINE[name][1])
        code = made_of_counts(fine)
        assert cortex_m3(code.files, code.golden, tmp_path / name, "decide") == 0
        few = of_vectors(code.golden, slice(None, None, 2))
        assert avr(code.files, few, tmp_path / f"avr {name}", "decide") == 0
    code = made(plan, golden, style="nested", arithmetic="float")
    assert avr(code.files, of_vectors(code.golden, slice(None, None, 4)), tmp_path, "decide") == 0


def test_dwell_on_a_processor(tmp_path):
    source = dataclasses.replace(policy("cart-pendulum"), outside="nearest")
    run = capsyn.simulate(source, [[3.0, 0.5]], 4, 100.0, min_dwell=0.1, outside="nearest")
    plan = Plan.of(source, dwell=0.1)
    golden = decide(plan, run.states[0, : run.last[0]])
    held = dataclasses.replace(golden, labels=run.symbols[0, : run.last[0]] % plan.labels)
    assert len(held) > 300 and (held.labels != golden.labels).any()
    assert cortex_m3(files(plan, golden, tick=0.01), held, tmp_path, "step") == 0


@pytest.mark.parametrize(("mode", "most"), [("exact", 1200), ("freedom", 900)])
def test_sizes(mode, most):
    need("arm-none-eabi-gcc", "avr-gcc")
    found = sizes(files(plan_of("cart-pendulum", mode), None), "cart_pendulum")
    assert 0 < found["cortex-m0"]["decision"] <= most
    assert 0 < found["avr"]["decision"] <= 2500
    assert 0 < found["cortex-m0"]["quantiser"] <= 1000
    assert all(measured["ram"] == 0 for measured in found.values())
    assert all(0 < measured["stack"] <= 64 for measured in found.values())


@pytest.mark.parametrize("tool", ["gcc", "nm", "size"])
def test_sizes_without_a_tool(monkeypatch, tool):
    run = c_sizes._run
    monkeypatch.setattr(
        c_sizes,
        "_run",
        lambda command, *rest: None if command[0].endswith(tool) else run(command, *rest),
    )
    assert sizes(files(plan_of("cart-pendulum"), None), "cart_pendulum") == {}


def test_sizes_name_compilers():
    need("gcc")
    for measured in sizes(files(plan_of("cart-pendulum"), None), "cart_pendulum").values():
        assert re.fullmatch(r"[a-z-]*gcc \d+\.\d+\.\d+", measured["compiler"])


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a", "cart-pole"])
def test_few_nodes_are_read(name):
    tree = plan_of(name).tree.cells
    skips = c_table.best_skips(tree)
    assert c_table.nodes_read(tree, skips) <= c_table.most_read(tree)
    assert skips == 0 or c_table.nodes_read(tree, skips - 1) > c_table.most_read(tree)
    assert c_table.nodes_read(tree, tree.depth) == tree.depth + 1
    assert c_table.nodes_read(tree, 0) <= tree.node_count


def test_nodes_read_are_those_of_the_code():
    tree = plan_of("lopsided").tree.cells
    for skips in (0, 3, tree.depth):
        most, todo = 0, [(0, 0, 1)]
        while todo:
            node, depth, read = todo.pop()
            most = max(most, read)
            if tree.split[node] != LEAF:
                over = tree.second[node] - node - 1 if depth >= skips else 0
                todo += [(node + 1, depth + 1, read + 1)]
                todo += [(tree.second[node], depth + 1, read + 1 + over)]
        assert c_table.nodes_read(tree, skips) == most


def test_skips_of_a_large_tree_are_found_fast():
    tree = random_plan(1 << 20, depth=18).tree.cells
    assert tree.node_count > 100_000
    started = time.process_time()
    assert c_table.nodes_read(tree, c_table.best_skips(tree)) <= c_table.most_read(tree)
    assert time.process_time() - started < 2


def test_skips_wider_than_a_window(tmp_path, monkeypatch):
    wide = functools.partial(c_table.layout, skip=30)
    monkeypatch.setattr(c_table, "layout", wide)
    plan = random_plan(1 << 30)
    form = wide(plan.tree.cells, c_table.best_skips(plan.tree.cells))
    assert form.node + form.skip > 57 and form.apart and form.window == 8
    steps = np.random.default_rng(0).integers(1 << 30, size=(3000, 2))
    library = Library(files(plan, None), tmp_path, 2)
    assert np.array_equal(library.look(steps), plan.tree.cells.labels(steps))


def test_a_compiler_that_does_not_end_is_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(c_sizes, "SECONDS", 0.3)
    started = time.monotonic()
    assert c_sizes._run(["sh", "-c", "(sleep 2; touch late) & wait"], tmp_path) is None
    assert time.monotonic() - started < 1.9
    time.sleep(2)
    assert not (tmp_path / "late").exists()  # what it started has ended too


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
    ],
)
def test_misra(tmp_path, mode, style, arithmetic, dwell):
    plan = plan_of("cart-pendulum", "freedom") if mode == "freedom" else plan_of("cart-pendulum")
    if mode in ("small", "linear"):  # whose conditions do not follow from others
        plan = random_plan(8, depth=3, oblique=0.5 * (mode == "linear"))
        assert (mode == "linear") == (len(plan.tree.cells.planes) > 1)
    plan = dataclasses.replace(plan, dwell=dwell)
    assert_misra(files(plan, None, style=style, arithmetic=arithmetic), tmp_path, arithmetic)


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
    command = "cppcheck -q --addon=misra --enable=style --std=c99 --template={id} cart_pendulum.c"
    told = subprocess.run(command.split(), cwd=tmp_path, capture_output=True, text=True)
    assert told.returncode == 0, told.stdout + told.stderr
    known = ADVISORY if arithmetic == "lattice" else ADVISORY[:1]
    assert set(known) <= set(told.stderr.splitlines()), "the rules were not applied"
    found = [line for line in told.stderr.splitlines() if "[" not in line and line.strip(" ^")]
    assert {line for line in found if "misra" in line or "-" not in line} <= set(ADVISORY)
    assert all(rule.split("-")[-1] in written["cart_pendulum.h"].decode() for rule in ADVISORY)


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("dwell", [0.0, 0.1])
def test_example(tmp_path, compiler, dwell):
    need(compiler)
    plan = dataclasses.replace(plan_of("double-tank-a"), dwell=dwell)
    for arithmetic in ("lattice", "float"):
        write(files(plan, None, arithmetic=arithmetic), tmp_path)
        sources = ["double_tank_a.c", "example.c", "-o", "example"]
        call([compiler, "-std=c99", *WARNINGS, *sources], tmp_path)
        middle = plan.policy.domain.lower + plan.policy.domain.widths / 2
        symbol = decide(plan, middle[None]).labels[0]
        assert call(["./example"], tmp_path).startswith(f"symbol {symbol}, status 0")


def test_same_input_same_bytes():
    for options in (
        {},
        {"style": "nested", "arithmetic": "float"},
        {"style": "grid"},
        {"readings": "int16"},
    ):
        first = files(
            Plan.of(policy("cart-pendulum"), dwell=0.1, scale=0.0015339807878856412),
            None,
            **options,
        )
        again = files(
            Plan.of(policy("cart-pendulum"), dwell=0.1, scale=0.0015339807878856412),
            None,
            **options,
        )
        assert first == again
    for content in first.values():
        assert "(low + high)" not in content.decode()  # a sum beyond 16 bits
        assert "SHA-256" in content.decode()
    lines = [
        line for name, c in first.items() for line in c.decode().splitlines() if "#" not in line
    ]
    assert [line for line in lines if len(line) > 100] == []


@pytest.mark.parametrize("options", [{"arithmetic": "float"}, {"readings": "int16"}])
def test_the_same_files_in_two_folders(tmp_path, options):
    scale = 2 * np.pi / 4096
    found = [
        export(policy("cart-pendulum"), "c", tmp_path / k, scale=scale, **options) for k in "ab"
    ]
    for first, again in zip(*found):
        assert first.name == again.name and first.read_bytes() == again.read_bytes()
    vectors = (tmp_path / "a" / "golden.csv").read_text().splitlines()
    row = [line for line in vectors if line[0] != "#"][1].split(",")
    assert len(row) == 6 and ("." in row[0]) == ("arithmetic" in options)


@pytest.mark.parametrize("roundings", [9, 40, 1000])
def test_steps_of_a_few_roundings(tmp_path, roundings):
    tree = random_plan(1 << 12).policy
    lower, width = np.array([3e5, -7e5]), (1 << 12) * roundings * np.spacing(7e5)
    domain = capsyn.Box(lower, lower + width, periodic=(True, False))
    domain.check_resolution(tree.cells.counts)
    plan = Plan.of(dataclasses.replace(tree, domain=domain))
    assert_golden(Library(files(plan, None), tmp_path, 2), golden_vectors(plan), True)


@pytest.mark.parametrize("count", [1 << 12, 1 << 15, 1 << 20, 1 << 30])
@pytest.mark.parametrize("style", ["table", "nested"])
def test_large_lattices(tmp_path, count, style):
    plan = random_plan(count)
    written = files(plan, None, style=style)
    library = Library(written, tmp_path, 2)
    assert library.integer is (np.int16 if count < 1 << 15 else np.int32)
    steps = np.random.default_rng(0).integers(count, size=(3000, 2))
    assert np.array_equal(library.look(steps), plan.tree.cells.labels(steps))
    states = plan.policy.domain.sample(3000)
    assert np.array_equal(library.decide(states)[0], decide(plan, states).labels)


def test_a_deep_tree_is_cut_into_functions(tmp_path):
    need("clang")
    count = 600
    split = np.r_[np.tile([0, LEAF], count - 1), LEAF].astype(np.int32)
    threshold = np.empty(len(split), dtype=np.int32)
    threshold[0:-1:2], threshold[1::2] = np.arange(1, count), np.arange(count - 1) % 3
    threshold[-1] = 2
    second = _second_children(split == LEAF).astype(np.int32)
    tree = SplitTree((count, 1), split, threshold, second, np.zeros((0, 2), dtype=np.int32))
    guarantee = Guarantee("exact", "0" * 64)
    plan = Plan.of(DecisionTree.of(policy("cart-pendulum"), tree, guarantee))
    steps = np.column_stack([np.arange(count), np.zeros(count, dtype=int)])
    for style in STYLES:
        library = Library(files(plan, None, style=style), tmp_path / style, 2, "clang")
        assert np.array_equal(library.look(steps), tree.labels(steps))


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("arithmetic", ["lattice", "double", "float"])
def test_a_tree_of_one_leaf(tmp_path, style, arithmetic):
    leaf = np.array([LEAF], dtype=np.int32)
    for label in (0, 2):
        one, zero = np.array([label], dtype=np.int32), np.zeros(1, dtype=np.int32)
        tree = SplitTree((1, 1), leaf, one, zero, np.zeros((0, 2), dtype=np.int32))
        guarantee = Guarantee("exact", "0" * 64)
        plan = Plan.of(DecisionTree.of(policy("cart-pendulum"), tree, guarantee))
        written = files(plan, None, style=style, arithmetic=arithmetic)
        library = Library(written, tmp_path / str(label), 2)
        assert library.decide(np.array([[1.0, 0.0]]))[0] == label


def test_names(tmp_path):
    source = dataclasses.replace(policy("cart-pendulum"), name="7 */ int \\ ünder-the-surface ??/")
    written = files(Plan.of(source), None)
    p = prefix_of(written)
    assert p == "n7_int_under_the_s"
    header = written[f"{p}.h"].decode()
    told = " ".join(header.replace("\n *", " ").split())
    assert f"became {p}." in told and "Name '-5' became MINUS_5." in told
    assert f"{p.upper()}_SYMBOL_MINUS_5 = 1" in header
    Library(written, tmp_path, 2)
    assert prefix_of(files(Plan.of(source), None, name="double")) == "double_2"


@pytest.mark.parametrize(
    "name",
    "stdint stdbool float math string stdio Stdint limits test Test ALL install help clean example"
    " double".split(),
)
def test_names_that_others_have(tmp_path, name):
    written = files(plan_of("cart-pendulum"), None, name=name)
    assert prefix_of(written) == f"{name}_2"
    if name in ("stdint", "float", "math"):
        Library(written, tmp_path, 2, options=["-O1", "-I."])


@given(st.lists(st.text("*/\\?a \n", max_size=120), max_size=3))
def test_a_comment_ends_where_it_should(lines):
    text = comment(lines)
    assert text.startswith("/*") and text.endswith("*/") and not set(text) & {"\\"}
    assert not any(mark in text[2:-2] for mark in ("*/", "/*", "//", "??"))


@pytest.mark.parametrize("name", ["a *\\ int boom; b", "*??/ int boom; /*", "\\*\\/ // \\"])
def test_a_name_is_no_code(tmp_path, name):
    source = dataclasses.replace(policy("cart-pendulum"), name=name)
    written = files(Plan.of(source), None, name="k")
    Library(written, tmp_path, 2)
    assert "boom" not in re.sub(r"/\*.*?\*/", "", written["k.c"].decode(), flags=re.S)


def test_ticks_of_a_dwell_time():
    plan = dataclasses.replace(plan_of("cart-pendulum"), dwell=0.5)
    header = files(plan, None, tick=np.float64(1e-3))["cart_pendulum.h"].decode()
    assert "_DWELL 500uL /* ticks of 0.001 s: 0.5 s */" in header
    most = dataclasses.replace(plan, dwell=4294.967)
    assert "_DWELL 4294967000uL" in files(most, None)["cart_pendulum.h"].decode()
    with pytest.raises(ProblemError, match="`tick` must be at least 1.0000000001.*; got 1e-06"):
        files(dataclasses.replace(plan, dwell=4294.9672955), None)
    for dwell in (0.0, 0.5):
        for tick in (-1, 0, np.nan, "1"):
            with pytest.raises(ProblemError, match="`tick` must be"):
                files(dataclasses.replace(plan, dwell=dwell), None, tick=tick)


def test_what_cannot_be_written():
    plan = plan_of("cart-pendulum")
    with pytest.raises(ProblemError, match="`style` must be"):
        files(plan, None, style="fast")
    with pytest.raises(ProblemError, match="`arithmetic` must be"):
        files(plan, None, arithmetic="half")
    with pytest.raises(ProblemError, match="65,536 cells"):
        files(random_plan(1 << 12, depth=3), None, style="grid")
    with pytest.raises(ProblemError, match="axis 'theta'.*24 bits"):
        files(random_plan(1 << 24, depth=3), None, arithmetic="float")
    with pytest.raises(ProblemError, match="`tick` must be at least"):
        files(dataclasses.replace(plan, dwell=1.0), None, tick=1e-12)


def test_tables_of_faces_are_told_and_limited():
    tree = random_plan(3000, depth=3, oblique=1.0)
    made = c.files(tree, golden_vectors(tree), arithmetic="float")
    faces = sum(tree.tree.cells.counts) - tree.n
    assert f"tables of the faces take {4 * faces:,} bytes" in " ".join(made.notes)
    with pytest.raises(ProblemError, match="`arithmetic` float tabulates all .* take lattice"):
        files(random_plan(9000, depth=3, oblique=1.0), None, arithmetic="float")
