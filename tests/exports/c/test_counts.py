"""Readings that are counts: lines of whole numbers, or tables, that give the step of each."""

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsyn.errors import CapsynWarning, ProblemError
from capsyn.exports.c.readings import counts as c_counts
from capsyn.exports.c.readings.lines import Line, exact_line, line_of, near_line
from capsyn.exports.c.sizes import sizes
from capsyn.exports.golden import decide
from capsyn.exports.plan import OK, Plan
from support.exports.c_machines import (
    Library,
    need,
)
from support.exports.c_plans import (
    COUNTS,
    FINE,
    UNDEFINED,
    files,
    made,
    made_of_counts,
    plan_of,
    policy,
    random_plan,
)


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
    assert code.count(b"double") == 3  # what gives controls


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
