"""Exported C on processors: a Cortex-M3 and an AVR."""

import dataclasses

import numpy as np
import pytest

import capsyn
from capsyn.exports.golden import decide
from capsyn.exports.plan import OK, Plan
from support.exports.c_machines import (
    avr,
    cortex_m3,
)
from support.exports.c_plans import (
    FINE,
    files,
    golden_of,
    made,
    made_of_counts,
    of_vectors,
    plan_of,
    policy,
    random_plan,
)


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
