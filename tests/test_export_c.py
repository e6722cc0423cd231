import dataclasses
import functools
import re
import subprocess

import numpy as np
import pytest

import capsyn
from c_machines import WARNINGS, Library, avr, call, cortex_m3, need, prefix_of, write
from capsyn import problems
from capsyn.decision_tree import DecisionTree, Guarantee
from capsyn.errors import ProblemError
from capsyn.exports import c, c_counts, c_sizes, c_table
from capsyn.exports.c_language import round_up
from capsyn.exports.c_sizes import sizes
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import NOT_FINITE, OK, Plan
from capsyn.split_tree import LEAF, SplitTree, _second_children

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


def files(plan, golden, **options):
    """Return the files of target c."""
    return c.files(plan, golden, **options).files


@functools.cache
def policy(name):
    return capsyn.synthesize(problems.get(name), **POLICIES[name])


@functools.cache
def plan_of(name, mode="exact"):
    if name == "lopsided":
        return random_plan(144)
    return Plan.of(policy(name) if mode == "exact" else capsyn.compress(policy(name), mode=mode))


@functools.cache
def golden_of(name, mode="exact"):
    return golden_vectors(plan_of(name, mode))


def random_plan(count, label_count=3, depth=10, seed=1):
    """Return a plan of a random tree over the pendulum's states with many steps per axis."""
    rng = np.random.default_rng(seed)
    source = policy("cart-pendulum")
    nodes = []

    def grow(lower, upper, level):
        axis = int(rng.integers(2))
        if level == depth or upper[axis] - lower[axis] < 2 or rng.random() < 0.03:
            nodes.append((LEAF, int(rng.integers(label_count))))
            return
        cut = int(rng.integers(lower[axis] + 1, upper[axis]))
        nodes.append((axis, cut))
        below, above = list(upper), list(lower)
        below[axis] = above[axis] = cut
        grow(lower, below, level + 1)
        grow(above, upper, level + 1)

    grow([0, 0], [count, count], 0)
    split, threshold = np.array(nodes, dtype=np.int32).T.copy()
    second = _second_children(split == LEAF).astype(np.int32)
    tree = SplitTree((count, count), split, threshold, second, np.zeros((0, 2), dtype=np.int32))
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


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("name", NAMES)
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


@pytest.mark.parametrize("style", STYLES)
def test_nothing_is_undefined(tmp_path, style):
    plan, golden = plan_of("cart-pole"), golden_of("cart-pole")
    options = ["-O1", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover"]
    library = Library(files(plan, golden, style=style), tmp_path, plan.n, "gcc", options)
    assert_golden(library, golden, True)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("name", NAMES)
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
        *((name, "exact", style) for name in NAMES for style in STYLES),
        ("cart-pendulum", *NESTED),
    ],
)
def test_float_arithmetic_is_the_policy_at_the_float_state(tmp_path, name, mode, style):
    plan, states = plan_of(name, mode), golden_of(name, mode).states.astype(np.float32)
    domain = plan.policy.domain
    # a periodic float below the double bound rounds up to the float bound: it is the last step
    near = back_in_single_precision(domain, states).astype(float)
    expected = decide(plan, near)
    written = files(plan, None, style=style, arithmetic="float")
    symbols, statuses = Library(written, tmp_path, plan.n).decide(states)
    assert np.array_equal(statuses, expected.statuses)
    assert np.array_equal(symbols, expected.labels)


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
    assert "reading 0 * 0.0015339807878856412 + 0.1" in written["cart_pendulum.h"].decode()


COUNTS = {
    "encoder and converter": ([2 * np.pi / 4096, 10 / 4096], [0.0, -5.0]),
    "falling": ([-2 * np.pi / 4096, -0.003], [0.1, 0.25]),
    "full scale": ([2 * np.pi / 65536, 10 / 65536], [-0.5, 0.0]),
    "no power of two": ([2 * np.pi / 1000, -10 / 999], [100.0, 0.0]),
    "on faces": ([-2 * np.pi / 144, 1 / 3000], [0.0, 0.1]),
    "coarse": ([2 * np.pi / 100, 0.5], [0.01, 0.0]),
}
"""Scales and offsets of counts, for the pendulum's angle and speed."""


def in_turn(plan, counts):
    """Return counts with those of the angle in the turn that begins at the lower bound."""
    lower, upper = plan.policy.domain.lower[0], plan.policy.domain.upper[0]
    turn = round((upper - lower) / abs(plan.scale[0]))
    every = np.arange(-(1 << 18), 1 << 18, dtype=np.int64)
    first = every[every * plan.scale[0] + plan.offset[0] >= lower]
    first = first.min() if plan.scale[0] > 0 else first.max() - turn + 1
    return np.column_stack([first + (counts[:, 0] - first) % turn, counts[:, 1]])


@pytest.mark.parametrize("name", COUNTS)
def test_every_count(tmp_path, name):
    tree = plan_of("lopsided").policy
    plan = Plan.of(tree, scale=COUNTS[name][0], offset=COUNTS[name][1])
    every = np.arange(-(1 << 15), 1 << 15)
    counts = np.column_stack([every, np.random.default_rng(0).permutation(every)])
    expected = decide(plan, in_turn(plan, counts).astype(float))
    written = files(plan, None, readings="int16")
    options = ["-O1", "-fsanitize=undefined", "-fno-sanitize-recover"]
    library = Library(written, tmp_path, plan.n, "gcc", options)
    assert np.array_equal(library.steps(counts), expected.steps)
    symbols, statuses = library.decide(counts)
    assert np.array_equal(symbols, expected.labels)
    assert np.array_equal(statuses, expected.statuses)
    axes = c_counts.count_axes(plan, "int16")
    for axis, count, steps in zip(axes, plan.tree.cells.counts, expected.steps.T):
        assert axis.missed == count - len(np.unique(steps))
    told = b"steps never occur" in written["cart_pendulum.h"]
    assert told == any(axis.missed for axis in axes)
    assert "coarse" not in name or [axis.missed for axis in axes] == [44, 123]
    code = written["cart_pendulum.c"].split(b"*/", 1)[1]
    assert code.count(b"double") == 1  # the table of controls


def test_counts_of_32_bits(tmp_path):
    tree = plan_of("lopsided").policy
    rng = np.random.default_rng(1)
    for case, (scale, offset) in enumerate([(1e-6, 0.0), (-5e-9, 0.25), (1e-3 / 3, 0.0)]):
        plan = Plan.of(tree, scale=[2 * np.pi / 2**17, scale], offset=[1.0, offset])
        axes = c_counts.count_axes(plan, "int32")
        changes = axes[1].first + np.array(axes[1].changes)
        near = (changes[:, None] + np.arange(-2, 3)).ravel()
        near = -1 - near if scale < 0 else near
        limits = [-(1 << 31), (1 << 31) - 1, 0, *axes[1].inside]
        speed = np.concatenate([near, limits, rng.integers(-(1 << 31), 1 << 31, 3000)])
        angle = rng.integers(-(1 << 31), 1 << 31, len(speed))
        counts = np.column_stack([angle, speed])
        expected = decide(plan, in_turn(plan, counts).astype(float))
        written = files(plan, None, readings="int32")
        library = Library(written, tmp_path / str(case), plan.n)
        assert np.array_equal(library.steps(counts), expected.steps)
        assert np.array_equal(library.decide(counts)[0], expected.labels)
        assert np.array_equal(library.decide(counts)[1], expected.statuses)


def test_whole_numbers_or_a_table():
    plan = plan_of("lopsided")
    found = {}
    for name, (scale, offset) in COUNTS.items():
        axes = c_counts.count_axes(Plan.of(plan.policy, scale=scale, offset=offset), "int16")
        found[name] = [axis.affine for axis in axes]
    assert found["encoder and converter"] == [(9, 0, 8), (9, 252, 8)]
    assert found["on faces"][1] is None  # rounding decides each tie in its own way
    assert all(found["full scale"]) and found["no power of two"][0]


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


@pytest.mark.parametrize("mode", ["exact", "freedom", "linear"])
@pytest.mark.parametrize("style", ["table", "nested"])
def test_cortex_m3(tmp_path, mode, style):
    plan, golden = plan_of("cart-pendulum", mode), golden_of("cart-pendulum", mode)
    inside = golden.statuses == OK
    golden = dataclasses.replace(golden, steps=golden.steps[inside], labels=golden.labels[inside])
    assert len(golden) >= 2000
    assert cortex_m3(files(plan, golden, style=style), golden, tmp_path) == 0


@pytest.mark.parametrize("mode", ["exact", "freedom", "linear"])
@pytest.mark.parametrize("style", ["table", "nested"])
def test_avr(tmp_path, mode, style):
    plan, golden = plan_of("cart-pendulum", mode), golden_of("cart-pendulum", mode)
    inside = np.flatnonzero(golden.statuses == OK)[::2]
    golden = dataclasses.replace(golden, steps=golden.steps[inside], labels=golden.labels[inside])
    assert avr(files(plan, golden, style=style), golden, tmp_path) == 0


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
    assert c_table.nodes_read(tree, skips) <= c_table.MOST_READ
    assert skips == 0 or c_table.nodes_read(tree, skips - 1) > c_table.MOST_READ
    assert c_table.nodes_read(tree, tree.depth) == tree.depth + 1
    assert c_table.nodes_read(tree, 0) <= tree.node_count


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
    plan = random_plan(8, depth=3) if mode == "small" else plan_of("cart-pendulum", mode)
    plan = dataclasses.replace(plan, dwell=dwell)
    assert_misra(files(plan, None, style=style, arithmetic=arithmetic), tmp_path)


@pytest.mark.parametrize("turn", [-4096, 1000])
def test_misra_of_counts(tmp_path, turn, monkeypatch):
    if turn > 0:  # as where rounding decides at each face
        monkeypatch.setattr(c_counts, "_affine", lambda changes, top: None)
    plan = Plan.of(random_plan(8, depth=3).policy, scale=[2 * np.pi / turn, 0.01])
    written = files(plan, None, readings="int16")
    assert (b"_axis_rank" if turn > 0 else b"_axis_step") in written["cart_pendulum.c"]
    assert_misra(written, tmp_path)


def assert_misra(written, tmp_path):
    need("cppcheck")
    write(written, tmp_path)
    command = "cppcheck -q --addon=misra --enable=style --std=c99 --template={id} cart_pendulum.c"
    told = subprocess.run(command.split(), cwd=tmp_path, capture_output=True, text=True)
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
        assert "SHA-256" in content.decode()
    lines = [
        line for name, c in first.items() for line in c.decode().splitlines() if "#" not in line
    ]
    assert [line for line in lines if len(line) > 100] == []


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
    with pytest.raises(ProblemError, match="`tick` must be more than"):
        files(dataclasses.replace(plan, dwell=1.0), None, tick=1e-12)
