"""Policies that remember: the symbol in force, least times of symbols and inputs, a hold-off."""

import itertools

import numpy as np
import pytest

import capsyn
from capsyn import problems
from capsyn.errors import ProblemError
from capsyn.exports.export import export
from capsyn.exports.plan import Plan
from capsyn.exports.sequence import step_period
from support.exports.remembering import random_rules
from support.exports.valves import HOLDS, assert_rules_kept, valves

pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
pytest.importorskip(
    "tree_sitter_iec61131_3_st", reason="tree-sitter-iec61131-3-st is not installed"
)
from support.exports.mutants import mutants  # noqa: E402
from support.exports.structured_text import (  # noqa: E402
    Program,
    Refused,
    check,
    check_sequence,
    program,
    source,
)

NUMBERS = [("LREAL", "real"), ("REAL", "real"), ("LREAL", "INT"), ("REAL", "DINT")]
MATRIX = [
    (style, *row, dialect)
    for (style, row), dialect in zip(
        itertools.product(("nested", "table", "cells"), NUMBERS),
        itertools.cycle(("iec", "siemens")),
    )
] + [("nested", "LREAL", "real", "siemens"), ("table", "LREAL", "INT", "iec")]


def planned(policy, readings="real", **options):
    widths = policy.domain.widths
    sign = np.where(np.arange(len(widths)) % 2, -1, 1)
    counted = {"scale": sign * widths / 2**12, "offset": 0.3 * widths}
    return Plan.of(policy, **({} if readings == "real" else counted), **options)


@pytest.mark.parametrize("holds", HOLDS)
def test_every_kind_of_least_time(holds):
    policy = valves(holds)
    for at_once, hold_off, style in ((False, 0.0, "nested"), (True, 0.36, "table")):
        plan = planned(policy, outside_at_once=at_once, hold_off=hold_off)
        assert plan.has_state and plan.waits == (holds != "none" or hold_off > 0)
        check(plan, style=style)
        labels = check_sequence(plan, style=style)
        assert len(np.unique(labels)) >= 7


@pytest.mark.parametrize("row", MATRIX, ids="-".join)
def test_every_style_and_dialect(row):
    style, real, readings, dialect = row
    options = {"style": style, "real": real, "readings": readings, "dialect": dialect}
    policy = valves(priced=style == "cells", seed=1, outside=4)
    plan = planned(policy, readings, hold_off=0.2)
    assert policy.cells.priced == (style == "cells")
    count, seen = check(plan, **options)
    assert count >= 2000 and len(seen) >= 7
    check_sequence(plan, **options)


def test_least_times_alone():
    """The next symbol does not depend on the symbol in force, but there are several timers."""
    plan = planned(valves("inputs", constant=True))
    assert plan.has_state and not plan.policy.remembers
    for style in ("nested", "table"):
        text = source(plan, style=style)
        assert b"now" not in text and b"transitions" not in text
        check(plan, style=style)
        check_sequence(plan, style=style)


def test_symbols_of_equal_controls_with_a_price_between():
    check_sequence(planned(random_rules()), style="table")


def test_gaps_and_nearest():
    for fields in ({"outside": "nearest"}, {"outside": 4, "gaps": True}):
        plan = planned(valves("symbols", seed=2, **fields), safe=3)
        for style in ("nested", "table"):
            check(plan, style=style)
            check_sequence(plan, style=style)


@pytest.mark.parametrize("style", ["nested", "table", "cells"])
def test_every_eighth_error_is_refused(style):
    policy = valves(grid=1, priced=style == "cells", outside="nearest")
    plan = planned(policy, hold_off=0.2)
    text = source(plan, style=style)
    right, count = outer_types(Program(text)), 0
    for what, wrong in itertools.islice(mutants(text), 0, None, 8):
        count += 1
        try:
            found = outer_types(Program(wrong))
        except (Refused, OverflowError):
            continue
        assert found != right, f"{what} is taken"  # else it shows at the first connection
    assert count > 100


def outer_types(made):
    return [
        {k: unit.kinds[k] for k in (*unit.inputs, *unit.outputs)} for unit in made.units.values()
    ]


@pytest.mark.parametrize("holds", ["symbols", "inputs"])
def test_no_forbidden_transition_and_no_broken_hold(holds):
    policy = valves(holds, seed=4)
    plan = planned(policy)
    rng, period = np.random.default_rng(5), step_period(plan)
    places = 1.02 * rng.random((8000, plan.n)) - 0.01
    states = policy.domain.lower + places * policy.domain.widths
    call = program(plan, style="table").instance()
    found = []
    for state in states.tolist():
        told = call(*state, 1000 * period)
        found.append((told["symbol"], told["status"]))
    labels, statuses = np.array(found).T
    at_once = np.isin(statuses, plan.at_once)
    assert assert_rules_kept(policy, labels, at_once, period) > 400


def test_the_block_holds_as_simulations_do():
    problem = problems.plain("cart-pendulum")
    switching = capsyn.Switching(price="1%", hold={"5": 0.02, "-5": 0.05})
    policy = capsyn.synthesize(problem.replace(switching=switching))
    run = capsyn.simulate(policy, x0=[0.5, 0.3], duration=4.0, rate=100.0)
    call = program(Plan.of(policy)).instance()
    found = [call(*state, 10)["symbol"] for state in run.states[: len(run.symbols)].tolist()]
    np.testing.assert_array_equal(found, run.symbols)
    assert len(set(found)) > 1


def test_times_that_are_no_milliseconds_and_beyond_the_type():
    plan = planned(valves("symbols"), hold_off=0.0003)
    assert b"is held for T#1ms, rounded up" in source(plan)
    for policy, name in ((valves("symbols"), "hold_off"), (valves(hold={"0 1": 3e6}), "hold")):
        plan = planned(policy, **({"hold_off": 3e6} if name == "hold_off" else {}))
        with pytest.raises(ProblemError, match=f"`{name}` must be at most 2147483.647 s in TIME"):
            source(plan)


def test_an_export_has_vectors_and_sequences(tmp_path):
    paths = export(valves(), "structured-text", tmp_path)
    assert {path.name for path in paths} >= {"valves.st", "golden.csv", "sequence.csv"}
