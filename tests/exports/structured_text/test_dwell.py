"""The least time between switches, as TIME."""

import dataclasses

import numpy as np
import pytest

from capsyn import Alphabet, Box, Policy, simulate
from capsyn.errors import ProblemError
from capsyn.exports.golden import decide
from capsyn.exports.plan import NOT_FINITE, Plan
from support.exports.policies import built_in, mixed
from support.trees import random_tree

pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
pytest.importorskip(
    "tree_sitter_iec61131_3_st", reason="tree-sitter-iec61131-3-st is not installed"
)
from support.exports.structured_text import program, source  # noqa: E402

DIALECTS = ("iec", "siemens")


def line_policy(default=0.0, **fields):
    """Return a policy of one axis; its default control may be that of a symbol."""
    cells = random_tree((5,), (3,), 3)
    policy = Policy("dwell", Box([-1], [1]), Alphabet([-1, 1]), np.array([default]), cells)
    return dataclasses.replace(policy, **fields)


def held(plan, golden, cycles, dwell):
    """Yield the symbols in force by the rule of the closed loop; cycles and dwell [ms]."""
    controls, symbol, since = plan.policy.controls, None, 0
    for wanted, status, cycle in zip(golden.labels, golden.statuses, cycles):
        since += cycle
        if symbol is None:
            symbol, since = wanted, 0
        elif (controls[wanted] == controls[symbol]).all():
            symbol = wanted
        elif since >= dwell or status in plan.at_once:
            symbol, since = wanted, 0
        yield symbol


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("at_once", [False, True])
@pytest.mark.parametrize("default", [0.0, -1.0])
def test_dwell_time_is_that_of_the_closed_loop(default, at_once, dialect):
    policy = line_policy(default, outside_at_once=at_once)
    rng = np.random.default_rng(1)
    states = rng.uniform(-1.3, 1.3, (500, 1))
    states[rng.random(500) < 0.1] = np.nan
    seen = set()
    for cycle, dwell in ((10, 0.07), (100, 0.25), (20, 0.02), (300, 0.1), (None, 0.05)):
        plan = Plan.of(policy, dwell=dwell)
        golden = decide(plan, states)
        cycles = [cycle] * 500 if cycle else rng.integers(0, 40, 500).tolist()
        call = program(plan, dialect=dialect).instance()
        for state, time, symbol in zip(states, cycles, held(plan, golden, cycles, 1000 * dwell)):
            found = call(state[0], time)
            assert (found["symbol"], found["u1"]) == (symbol, policy.controls[symbol, 0])
            seen.add((found["status"], symbol == 2))
    assert len({status for status, _ in seen}) == 3
    assert (NOT_FINITE, True) in seen


@pytest.mark.parametrize("dialect", DIALECTS)
def test_minutes_are_minutes(dialect):
    policy = line_policy(min_dwell=5.0, time_unit="min")
    plan = Plan.of(policy)
    text = source(plan, dialect=dialect).decode()
    assert "rest := T#5m;" in text and "rounded up" not in text
    states = policy.domain.sample(100)
    labels = decide(plan, states).labels
    pair = [states[labels == k][0, 0] for k in (0, 1)]
    call = program(plan, dialect=dialect).instance()
    symbols = [0]
    for _ in range(9001):  # at every call the other symbol is wanted
        symbols.append(int(call(pair[1 - symbols[-1]], 100)["symbol"]))
    np.testing.assert_array_equal(np.flatnonzero(np.diff(symbols)), [0, 3000, 6000, 9000])


@pytest.mark.parametrize("cycle", [0.999999, 1.0, 1.000001])
def test_finer_time_is_rounded(cycle):
    plan = Plan.of(line_policy(), dwell=0.02)
    policy = plan.policy
    states = policy.domain.sample(100)
    labels = decide(plan, states).labels
    pair = [states[labels == k][0, 0] for k in (0, 1)]
    call = program(plan).instance()
    call(pair[0], cycle)
    symbols = [call(pair[1], cycle)["symbol"] for _ in range(25)]
    assert symbols == [0] * 19 + [1] * 6


def test_dwell_times_that_are_no_milliseconds_are_rounded_up():
    for dwell, literal in ((0.0003, "T#1ms"), (1.0005, "T#1001ms"), (0.1 * 3, "T#300ms")):
        text = source(Plan.of(line_policy(), dwell=dwell)).decode()
        assert f"rest := {literal};" in text
        assert (f"for {literal} at least, rounded up." in text) == (dwell != 0.1 * 3)
    for dwell, literal in ((7200, "T#2h"), (86400 * 3, "T#3d"), (90, "T#90s")):
        assert f"rest := {literal};" in source(Plan.of(line_policy(), dwell=dwell)).decode()


def test_dwell_times_beyond_the_type():
    with pytest.raises(ProblemError, match="`dwell` must be at most 2147483.647 s in TIME"):
        source(Plan.of(line_policy(), dwell=2.2e6))


def test_counts_are_always_finite():
    plan = Plan.of(mixed(), dwell=0.3, scale=[6.5 / 4096, 0.001], offset=[0, 0.1])
    text = source(plan, readings="INT").decode()
    assert "status = 2" not in text and "status := 2" not in text


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("dwell", [0.01, 0.05, 0.1])
def test_blocks_hold_as_simulations_do(dwell, dialect):
    policy = built_in("cart-pendulum")
    run = simulate(policy, x0=[0.5, 0.3], duration=4.0, rate=100.0, min_dwell=dwell)
    call = program(Plan.of(policy, dwell=dwell), dialect=dialect).instance()
    found = [call(*state, 10)["symbol"] for state in run.states[: len(run.symbols)].tolist()]
    np.testing.assert_array_equal(found, run.symbols)
    assert len(set(found)) > 1


@pytest.mark.parametrize("dialect", DIALECTS)
def test_time_neither_runs_back_nor_over(dialect):
    plan = Plan.of(line_policy(), dwell=2_000_000)
    states = plan.policy.domain.sample(100)
    labels = decide(plan, states).labels
    pair = [states[labels == k][0, 0] for k in (0, 1)]
    call = program(plan, dialect=dialect).instance()
    far = 2**31 - 1
    symbols = [call(pair[0], far)["symbol"]]
    symbols += [call(pair[1], time)["symbol"] for time in (0, -far, -far, 1_999_999_999, 1, far)]
    assert symbols == [0, 0, 0, 0, 0, 1, 1]
    assert call(pair[0], far)["symbol"] == 0
