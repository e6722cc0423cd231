"""Exported C: golden vectors, lattices of every size, dwell, bytes, and refusals."""

import dataclasses
import re

import numpy as np
import pytest

import capsyn
from capsyn.cells.split_tree import LEAF, SplitTree, _second_children
from capsyn.errors import ProblemError
from capsyn.exports.export import export
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import NOT_FINITE, Plan
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree
from support.exports.c_machines import (
    WARNINGS,
    Library,
    call,
    need,
    write,
)
from support.exports.c_plans import (
    COMPILERS,
    NAMES,
    NESTED,
    STYLES,
    UNDEFINED,
    assert_golden,
    back_in_single_precision,
    files,
    golden_of,
    made,
    plan_of,
    plan_of_nodes,
    policy,
    random_plan,
)


def test_the_lopsided_tree_is_not_symmetric():
    for name, least in (("cart-pendulum", 0), ("lopsided", 5000)):
        tree = plan_of(name).tree.cells
        steps = np.stack(np.indices(tree.counts), axis=-1).reshape(-1, 2)
        turned = np.array(tree.counts) - 1 - steps
        assert np.count_nonzero(tree.labels(steps) != tree.labels(turned)) >= least


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


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("dwell", [0.0, 0.1])
def test_example(tmp_path, compiler, dwell):
    need(compiler)
    plan = dataclasses.replace(plan_of("double-tank-a"), dwell=dwell)
    for arithmetic in ("lattice", "float"):
        write(files(plan, None, arithmetic=arithmetic), tmp_path)
        sources = ["-I.", "double_tank_a.c", "example/main.c", "-o", "run"]
        call([compiler, "-std=c99", *WARNINGS, *sources], tmp_path)
        middle = plan.policy.domain.lower + plan.policy.domain.widths / 2
        symbol = decide(plan, middle[None]).labels[0]
        assert call(["./run"], tmp_path).startswith(f"symbol {symbol}, status 0")


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


def test_ticks_of_a_dwell_time():
    plan = dataclasses.replace(plan_of("cart-pendulum"), dwell=0.5)
    header = files(plan, None, tick=np.float64(1e-3))["cart_pendulum.h"].decode()
    assert "_DWELL 500uL /* ticks of 0.001 s: 0.5 s */" in header
    most = dataclasses.replace(plan, dwell=4294.967)
    assert "_DWELL 4294967000uL" in files(most, None)["cart_pendulum.h"].decode()
    with pytest.raises(ProblemError, match="`tick` must be 1e-05 s or more, and .*; got 1e-06"):
        files(dataclasses.replace(plan, dwell=4294.9672955), None)
    with pytest.raises(ProblemError, match="at most the dwell time, 0.5 s; got 0.6"):
        files(plan, None, tick=0.6)
    assert "_DWELL 1uL" in files(plan, None, tick=0.5)["cart_pendulum.h"].decode()
    for dwell, unit, tick, ticks in (
        (99.9, "s", 1e-6, 99_900_000),
        (1000.1, "s", 1e-6, 1_000_100_000),
        (1.1, "h", 1e-6, 3_960_000_000),
        (4294.1, "min", 1e-3, 257_646_000),
        (0.3, "s", 0.1, 3),
        (1.0, "s", 1 / 300, 300),
        (0.1, "s", 1 / 3000, 300),
        (1.05, "s", 0.1, 11),
    ):
        other = dataclasses.replace(plan.policy, time_unit=unit)
        header = files(Plan.of(other, dwell=dwell), None, tick=tick)["cart_pendulum.h"]
        assert f"_DWELL {ticks}uL".encode() in header
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
    with pytest.raises(ProblemError, match="`tick` must be 1e-09 s or more"):
        files(dataclasses.replace(plan, dwell=1.0), None, tick=1e-12)
