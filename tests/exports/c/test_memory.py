"""Exported C of policies that remember the symbol in force: rows, timers, the caller's state."""

import dataclasses
import functools
import json

import numpy as np
import pytest

import capsyn
from capsyn import problems
from capsyn.cells.affine_leaves import PriceRatios
from capsyn.errors import ProblemError
from capsyn.exports.c.memory import Memory, memory_of
from capsyn.exports.c.sizes import sizes
from capsyn.exports.export import export
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.sequence import golden_sequence
from support.exports.c_machines import Library, avr, call, cortex_m3, need, write
from support.exports.c_plans import COMPILERS, REMEMBERING, UNDEFINED, made, policy, remembering
from support.exports.remembering import random_rules
from support.features import exact
from support.trees import random_affine_policy

READINGS = [{"arithmetic": a} for a in ("lattice", "double", "float")]
READINGS += [{"readings": r} for r in ("int16", "int32")]
OPTIONS = [
    {"style": style, **readings}
    for style in ("table", "nested", "grid", "cells")
    for readings in READINGS
]


@functools.cache
def plan_of(kind, counts=False, hold_off=0.0):
    source = remembering(**REMEMBERING[kind])
    scale = source.domain.widths / 1000 if counts else None
    return Plan.of(source, scale=scale, hold_off=hold_off, safe=1)


def plan_of_prices(counts, some_axes):
    """Return a plan of affine leaves with prices, some of which forbid, at which many rows tie."""
    source = random_affine_policy(3, True, 1, some_axes)
    affine = source.cells.affine
    prices = np.random.default_rng(2).integers(0, 9, len(affine)).astype(np.int32)
    names = source.alphabet.names
    switching = capsyn.Switching([[0, 1], [3, 0]], forbidden=[("default", names[0])])
    ratios = PriceRatios.of(switching.prices(source.alphabet, source.default)).ratios
    affine = dataclasses.replace(affine, prices=prices, ratios=ratios)
    seen = np.repeat(source.cells.mixed_labels.reshape(-1, 1, 1), 3, axis=1)
    entries = np.where(source.cells.entries == -1, np.int32(-2), source.cells.entries)
    tables = {"entries": entries, "affine": affine, "mixed_labels": seen}
    cells = dataclasses.replace(source.cells, **tables)
    source = dataclasses.replace(source, cells=cells, outside="nearest", switching=switching)
    return Plan.of(source, scale=source.domain.widths / 1000 if counts else None)


@functools.cache
def priced(**options):
    price = capsyn.Switching(price="1%", hold={"5": 0.02})
    problem = problems.plain("cart-pendulum").replace(switching=price)
    return capsyn.synthesize(problem, **options)


def check(plan, directory, compiler="gcc", **options):
    """Assert that C gives golden vectors and sequences, whatever number ticks begin with."""
    golden, runs = golden_vectors(plan), golden_sequence(plan)
    code = made(plan, golden, tick=runs.period, **options)
    vectors, runs = code.golden or golden, code.sequence or runs
    options = UNDEFINED if compiler == "gcc" else ["-O1"]
    library = Library(code.files, directory, plan.n, compiler, options)
    if plan.policy.remembers:
        symbols, statuses = library.next(vectors.in_force, vectors.readings)
        unknown = np.where(vectors.in_force == plan.default, -1, vectors.in_force)
        assert np.array_equal(library.next(unknown, vectors.readings)[0], symbols)
        if library.quantises:
            found = vectors.statuses == 0
            looked = library.look(vectors.steps[found], vectors.in_force[found])
            assert np.array_equal(looked, vectors.labels[found])
    else:
        symbols, statuses = library.decide(vectors.readings)
    assert np.array_equal(symbols, vectors.labels)
    assert np.array_equal(statuses, vectors.statuses)
    now = (np.arange(runs.labels.shape[1]) + (1 << 32) - 100) % (1 << 32)
    for readings, labels in zip(runs.readings, runs.labels):
        assert np.array_equal(library.run(readings, now), labels)
    return code


@pytest.mark.parametrize(
    ("options", "kind"),
    [(o, k) for i, o in enumerate(OPTIONS) for j, k in enumerate(REMEMBERING) if (i + j) % 4 == 0],
)
def test_every_option(kind, options, tmp_path):
    compiler = COMPILERS[len(kind) % 2]
    check(plan_of(kind, "readings" in options), tmp_path, compiler, **options)


@pytest.mark.parametrize("kind", ["ways", "inputs"])
def test_the_start_and_what_does_not_wait(kind, tmp_path):
    check(plan_of(kind, hold_off=1.7), tmp_path / "safe")
    source = dataclasses.replace(plan_of(kind).policy, outside=1, outside_at_once=True)
    check(Plan.of(source, hold_off=0.3), tmp_path / "default")
    check(Plan.of(source), tmp_path / "at once")


def test_symbols_of_equal_controls_with_a_price_between(tmp_path):
    check(Plan.of(random_rules()), tmp_path)


@pytest.mark.parametrize("hold", [{"hold": (0.2, 0.5, 0.1, 0.2)}, {"hold": {"valve": 0.3}}, {}])
def test_what_only_waits_decides_without_a_symbol_in_force(hold, tmp_path):
    source = remembering(own_rows=0, **hold)
    assert not source.remembers
    code = check(Plan.of(source, hold_off=0.0 if hold else 1.0, safe=2), tmp_path)
    assert b"_next(" not in code.files["remembering.c"]


@pytest.mark.parametrize("readings", READINGS, ids=lambda r: " ".join(r.values()))
@pytest.mark.parametrize("some_axes", [False, True])
def test_affine_leaves_with_prices(readings, some_axes, tmp_path):
    plan = plan_of_prices("readings" in readings, some_axes)
    code = check(plan, tmp_path, **readings)
    assert code.chosen["style"] == "cells"
    with pytest.raises(ProblemError, match="`style` must be cells for affine leaves with prices"):
        made(plan, style="table")


def test_features_and_gaps(tmp_path):
    tree = exact()
    rows = np.vstack([np.repeat(np.arange(3)[:, None], 3, 1), [[0, 1, 0]]])
    leaf = tree.cells.split < 0
    threshold = np.where(leaf & (tree.cells.threshold == 1), 3, tree.cells.threshold)
    cells = dataclasses.replace(tree.cells, threshold=threshold.astype(np.int32))
    made_of = dataclasses.replace(tree, cells=cells, transitions=rows, gaps=True)
    for style in ("table", "nested"):
        check(Plan.of(made_of), tmp_path / style, style=style)


def test_kept_sets_stand_for_rows_where_they_are_smaller(tmp_path):
    plan = plan_of("many")
    rows = np.array([[j if (j * r) % 7 < 4 else r for j in range(301)] for r in range(30)])
    rows[np.arange(9), 3 * np.arange(9) + 5] = 250
    rows = np.unique(rows, axis=0)
    table = np.vstack([np.repeat(np.arange(301)[:, None], 301, 1), rows])
    leaves = -1 - (np.arange(len(plan.policy.cells.entries)) % len(rows) + 301)
    entries = np.where(plan.policy.cells.entries < 0, leaves, plan.policy.cells.entries)
    cells = dataclasses.replace(plan.policy.cells, entries=entries.astype(np.int32))
    source = dataclasses.replace(plan.policy, cells=cells, transitions=table)
    code = check(Plan.of(source, safe=3), tmp_path)
    memory = memory_of(Plan.of(source).tree)
    assert memory.kept is not None and memory.bytes < memory.table.size / 6
    assert len(memory.kept.places) > 5
    assert code.written["row_bytes"] == memory.bytes
    wide = Memory(memory.cells, np.tile(memory.table, (40, 1)))
    assert '#error "tables of' in wide.follows("p").text


def test_rows_are_written_by_mirrors():
    """The priced pendulum takes at most 1.6 times the flash of the unpriced."""
    need("arm-none-eabi-gcc")
    files = [made(Plan.of(p)).files for p in (policy("cart-pendulum"), priced())]
    plain, remembers = (sizes(some, "cart_pendulum") for some in files)
    for processor in ("cortex-m0", "cortex-m4"):
        assert remembers[processor]["decision"] <= 1.6 * plain[processor]["decision"]
        assert remembers[processor]["ram"] == 0
    assert b"label = (int16_t)(3 - label);" in files[1]["cart_pendulum.c"]


@pytest.mark.parametrize("asked", ["next", "step"])
def test_on_processors(asked, tmp_path):
    plan = Plan.of(priced(), hold_off=0.03, safe=0, scale=[2 * np.pi / 4096, 10 / 4096])
    code = made(plan, readings="int16", tick=0.005)
    expected, runs = code.golden, code.sequence
    assert runs.period == 0.005
    if asked == "step":
        columns = {"readings": runs.readings, "labels": runs.labels, "statuses": runs.statuses}
        expected = dataclasses.replace(expected, **{k: v[0] for k, v in columns.items()})
        assert len(set(expected.labels.tolist())) == 2
    assert cortex_m3(code.files, expected, tmp_path / "cortex", asked) == 0
    assert avr(code.files, expected, tmp_path / "avr", asked) == 0
    labels = np.where(np.arange(len(expected.labels)) == 7, 2, expected.labels)
    wrong = dataclasses.replace(expected, labels=labels)
    assert avr(code.files, wrong, tmp_path / "wrong", asked) == 1


WALK = """
#include <stdio.h>
#include "{p}.h"
static uint32_t seed = 1u;
static uint32_t any(uint32_t most)
{{
    seed = seed * 1664525u + 1013904223u;
    return (uint32_t)(((uint64_t)seed * most) >> 32);
}}
static const double lower[] = {{{lower}}}, widths[] = {{{widths}}};
static const double holds[] = {{{holds}}}, input_holds[] = {{{input_holds}}};
static const int forbidden[{count}][{count}] = {{{forbidden}}}, kinds[] = {{{kinds}}};
int main(void)
{{
    {p}_state state;
    double since[{m} + 1] = {{0.0}}, time = 0.0;
    int before = {none}, broken = 0, ways = 0, changes = 0;
    uint32_t now = 4294967295u - 5000u;
    {p}_init(&state);
    for (long k = 0; k < {steps}; ++k) {{
        {p}_status status;
        double x[{n}];
        for (int i = 0; i < {n}; ++i) {{
            x[i] = lower[i] + widths[i] * (any(1001u) / 1000.0);
        }}
        const int symbol = {p}_step(&state, x, {now}&status);
        if ((k > 0) && (kinds[symbol] != kinds[before])) {{
            ++changes;
            ways += forbidden[before][symbol];
            broken += time - since[{m}] < holds[before] - 0.5;
            since[{m}] = time;
        }}
        for (uint16_t i = 0; (k > 0) && (i < {m}u); ++i) {{
            if ({p}_control((int16_t)symbol, i) != {p}_control((int16_t)before, i)) {{
                broken += time - since[i] < input_holds[i] - 0.5;
                since[i] = time;
            }}
        }}
        before = symbol;
        const uint32_t ticks = any({most}u);
        now += ticks;
        time += ticks;
    }}
    printf("%d %d %d", changes, ways, broken);
    return 0;
}}
"""
"""A million random steps at random times, of which the program itself looks for broken rules."""


@pytest.mark.parametrize("kind", ["holds", "inputs", "forbidden", "ways"])
def test_no_rule_is_broken_in_a_million_steps(kind, tmp_path):
    plan = plan_of(kind)
    policy, rules, tick = plan.policy, plan.policy.rules, 0.01
    code = made(plan, tick=tick)
    texts = {
        "lower": policy.domain.lower,
        "widths": policy.domain.widths,
        "holds": rules.holds / tick,
        "input_holds": rules.input_holds / tick,
        "forbidden": rules.forbidden.astype(int).ravel(),
        "kinds": rules.kinds,
    }
    words = {name: ", ".join(map(repr, values.tolist())) for name, values in texts.items()}
    words |= {"p": "remembering", "n": plan.n, "m": policy.alphabet.m, "count": plan.labels}
    words |= {"none": plan.default, "steps": 1_000_000, "most": 20}
    words["now"] = "now, " * code.files["remembering.h"].count(b"uint32_t now, remembering_status")
    write(code.files, tmp_path, **{"walk.c": WALK.format(**words)})
    call(["gcc", "-std=c99", "-O2", "walk.c", "remembering.c", "-o", "walk"], tmp_path)
    changes, ways, broken = map(int, call(["./walk"], tmp_path).split())
    assert changes > 10_000 and ways == broken == 0


def test_packages_and_cycles(tmp_path):
    export(priced(), "c", tmp_path / "cmake", cycles=True, hold_off=1.0)
    measured = json.loads((tmp_path / "cmake" / "measured.json").read_text())
    for processor in measured["worst"].values():
        assert processor["symbol"]["exact"]
    words = (tmp_path / "cmake" / "golden.csv").read_text().split("\n")
    assert "theta,omega,step_0,step_1,in_force,symbol,status" in words
    assert (tmp_path / "cmake" / "sequence.csv").exists()
    for name, options in (("waits", {}), ("now", {"dwell": 0.0})):
        export(priced(), "c", tmp_path / name, package="arduino", **options)
        folder = tmp_path / name / "cart_pendulum"
        keywords = (folder / "keywords.txt").read_text().split()
        assert {"cart_pendulum_next", "CART_PENDULUM_NONE"} <= set(keywords)
        sketch = (folder / "examples" / "cart_pendulum" / "cart_pendulum.ino").read_text()
        assert ("state.symbol = symbol;" in sketch) == (name == "now")
        assert ("cart_pendulum_hold(&state" in sketch) == (name == "waits")
        body = sketch.split("#include <cart_pendulum.h>")[1]
        main = "#include <stdint.h>\n#include <cart_pendulum.h>\n" + SERIAL + body
        (folder / "src" / "main.cpp").write_text(main)
        for double in ([], ["-DCART_PENDULUM_NO_DOUBLE"]):
            flags = ["-Wall", "-Wextra", "-Werror", "-I.", "-fsyntax-only", *double]
            call(["g++", *flags, "main.cpp"], folder / "src")


SERIAL = """
struct { void begin(long) {} void println(double, int) {} } Serial;
static uint32_t micros() { return 0; }
static void delay(int) {}
"""


def test_a_tick_longer_than_the_shortest_least_time():
    plan = plan_of("inputs")
    with pytest.raises(ProblemError, match="at most the shortest least time, 0.4 s; got 0.45"):
        made(plan, tick=0.45)
    with pytest.raises(ProblemError, match="`tick` must be 1e-09 s or more"):
        made(plan, tick=1e-12)
