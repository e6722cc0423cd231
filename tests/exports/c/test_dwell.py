"""The dwell time in C: what is held, what is taken at once, and the unit of time."""

import dataclasses

import numpy as np
import pytest

from capsyn import Alphabet
from capsyn.exports.golden import decide
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, Plan
from support.exports.c_machines import Library, avr, cortex_m3
from support.exports.c_plans import files, made, policy

TICKS = 10
"""Ticks of the dwell time."""


def sequence(at_once, default=0.0, count=900):
    """Return a plan, and decisions of readings that are lost or outside now and then."""
    source = dataclasses.replace(
        policy("cart-pendulum"), default=np.array([default]), outside=0, outside_at_once=at_once
    )
    plan = Plan.of(source, safe=0, dwell=TICKS / 100)
    rng = np.random.default_rng(4)
    states = source.domain.sample(count, 2)
    states = states[np.repeat(rng.integers(count, size=count), rng.integers(1, 9, count))[:count]]
    fate = rng.random(count)
    states[fate < 0.15, 0] = np.nan
    states[fate > 0.85, 1] = source.domain.upper[1] + 1
    golden = decide(plan, states)
    assert set(golden.statuses.tolist()) == {OK, OUTSIDE, NOT_FINITE}
    return plan, golden


def held(plan, golden):
    """Return the symbols in force, as the header says it, with a tick between readings."""
    controls, symbol, since, symbols = plan.policy.controls, None, 0, []
    for now, (wanted, status) in enumerate(zip(golden.labels, golden.statuses)):
        if symbol is None or (controls[wanted] != controls[symbol]).any():
            at_once = status == NOT_FINITE or (status == OUTSIDE and plan.policy.outside_at_once)
            if symbol is None or at_once or now - since >= TICKS:
                symbol, since = wanted, now
        else:
            symbol = wanted
        symbols.append(symbol)
    return dataclasses.replace(golden, labels=np.array(symbols))


@pytest.mark.parametrize("at_once", [False, True])
@pytest.mark.parametrize("same", [False, True])
def test_what_is_not_finite_does_not_wait(tmp_path, at_once, same):
    default = float(policy("cart-pendulum").controls[0, 0]) if same else 0.123
    plan, golden = sequence(at_once, default)
    expected = held(plan, golden).labels
    assert bool(plan.same_control) == same
    library = Library(files(plan, golden, tick=0.01), tmp_path, plan.n)
    now = (np.arange(len(golden)) + (1 << 32) - 50) % (1 << 32)
    assert np.array_equal(library.run(golden.readings, now), expected)
    lost, outside = golden.statuses == NOT_FINITE, golden.statuses == OUTSIDE
    assert (expected[lost] == 0).all() and (expected[outside] == 0).all() == at_once
    after = np.flatnonzero(lost[:-1] & (golden.labels[1:] == 1))
    assert (expected[after + 1] == 0).any()  # it is held anew


@pytest.mark.parametrize("at_once", [False, True])
def test_what_does_not_wait_on_processors(tmp_path, at_once):
    plan, golden = sequence(at_once)
    code = made(plan, golden, arithmetic="float", style="nested", tick=0.01)
    expected = held(plan, code.golden)
    assert cortex_m3(code.files, expected, tmp_path / "cortex", "step") == 0
    assert avr(code.files, expected, tmp_path / "avr", "step") == 0
    held_too_long = dataclasses.replace(expected, labels=expected.labels.copy())
    held_too_long.labels[np.flatnonzero(golden.statuses == NOT_FINITE)[0]] = 1
    assert avr(code.files, held_too_long, tmp_path / "wrong", "step") == 1


def test_counts_are_always_finite():
    for at_once in (False, True):
        source = dataclasses.replace(policy("cart-pendulum"), outside_at_once=at_once)
        plan = Plan.of(source, dwell=0.1, scale=[2 * np.pi / 4096, 0.01])
        text = files(plan, None, readings="int16")
        step = text["cart_pendulum.c"].decode().split("int16_t cart_pendulum_step(")[1]
        assert ("_take(state, symbol, now)" in step) == at_once and "NOT_FINITE" not in step
        told = " ".join(text["cart_pendulum.h"].decode().replace("\n *", " ").split())
        assert ("where the status is CART_PENDULUM_OUTSIDE." in told) == at_once


def test_symbols_of_equal_controls_follow_each_other_freely(tmp_path):
    plan, golden = sequence(False, 0.123)
    alphabet = Alphabet([[5], [5]], names=["left", "right"])
    source = dataclasses.replace(plan.policy, alphabet=alphabet, default=np.array([5.0]))
    for default, pairs in ((5.0, 6), (0.123, 2)):
        source = dataclasses.replace(source, default=np.array([default]))
        plan = Plan.of(source, safe=0, dwell=TICKS / 100)
        assert len(plan.same_control) == pairs
        library = Library(files(plan, golden, tick=0.01), tmp_path / str(pairs), plan.n)
        found = library.run(golden.readings, np.arange(len(golden)))
        assert np.array_equal(found, held(plan, golden).labels)
        assert np.array_equal(found[golden.labels < 2], golden.labels[golden.labels < 2])


def test_minutes_are_minutes(tmp_path):
    source = dataclasses.replace(policy("cart-pendulum"), time_unit="min", min_dwell=5.0)
    plan = Plan.of(source)
    states = source.domain.sample(100)
    pair = [states[source(states) == k][0] for k in (0, 1)]
    library = Library(files(plan, None, tick=0.1), tmp_path, plan.n)
    # a scan every 100 ms that wants the other symbol at every call after the first
    wanted = np.array([pair[0]] + [pair[1]] * 3000 + [pair[0]] * 3000 + [pair[1]] * 3000)
    symbols = library.run(wanted, np.arange(len(wanted)))
    assert np.flatnonzero(np.diff(symbols)).tolist() == [2999, 5999, 8999]


@pytest.mark.parametrize(
    ("unit", "dwell", "ticks", "told"),
    [
        ("s", 0.5, 5, "0.5 s"),
        ("min", 5.0, 3000, "5.0 min = 300.0 s"),
        ("ms", 250.0, 3, "250.0 ms = 0.25 s"),
    ],
)
def test_ticks_are_in_seconds_whatever_the_unit_of_time(unit, dwell, ticks, told):
    source = dataclasses.replace(policy("cart-pendulum"), time_unit=unit, min_dwell=dwell)
    header = files(Plan.of(source), None, tick=0.1)["cart_pendulum.h"].decode()
    assert f"CART_PENDULUM_DWELL {ticks}uL /* ticks of 0.1 s: {told} */" in header
