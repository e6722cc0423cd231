"""How long decisions take on emulated processors: exact counts, and no state takes longer."""

import dataclasses
import json

import numpy as np
import pytest

from capsyn.cells.split_tree import LEAF
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.exports.c.readings.single import decide_single
from capsyn.exports.c.target import Options, _code
from capsyn.exports.c.timing import emulators, slowest, states
from capsyn.exports.c.timing.emulators import MACHINES, longest
from capsyn.exports.export import export
from capsyn.exports.golden import decide
from capsyn.exports.plan import Plan
from support.exports.c_machines import need
from support.exports.c_plans import STYLES, files, golden_of, made, plan_of, policy, remembering
from support.processes.command_line import capsyn, error_of
from support.trees import random_affine_policy, random_policy

LOOPS = {
    "avr": (
        "movw r30, r24\n ld r24, Z\n ldd r25, Z+1\n 1: sbiw r24, 1\n brne 1b\n ret",
        lambda k: 4 + 1 + 2 + 2 + 4 * k - 1 + 4,  # call, movw, ld, ldd, the loop, ret
    ),
    "cortex-m3": (
        "ldrsh r0, [r0]\n 1: subs r0, #1\n bne 1b\n bx lr",
        lambda k: 1 + 1 + 2 * k + 1,  # bl, ldrsh, the loop, bx
    ),
}
"""Functions whose time a hand can count: those of the data sheets."""


def need_tools(name):
    need(MACHINES[name].compiler[0], MACHINES[name].emulator[0])


STRAIGHT = (
    "movw r30, r24\n lpm r18, Z\n mul r18, r18\n clr r1\n push r18\n pop r18\n rcall 2f\n rjmp 3f\n"
    " 2: ret\n 3: lds r18, 256\n sbrc r1, 0\n nop\n adiw r30, 1\n sts 256, r18\n ret"
)
"""Other instructions of an AVR: of program memory, products, the stack, calls, skips."""


@pytest.mark.parametrize("name", MACHINES)
def test_times_are_those_that_a_hand_counts(name):
    need_tools(name)
    text, time = LOOPS[name]
    own = written_by_hand(text)
    for turns in ([1], [2, 1], [100, 101], [7, 30000, 5]):
        given = np.array(turns)[:, None]
        found = longest(MACHINES[name], own, "k", "symbol", "int16_t", given)
        assert (found.time, found.row) == (time(max(turns)), int(np.argmax(turns)))


def test_times_are_those_of_the_data_sheet():
    need_tools("avr")
    own, given = written_by_hand(STRAIGHT), np.ones((1, 1), dtype=int)
    found = longest(MACHINES["avr"], own, "k", "symbol", "int16_t", given)
    assert found.time == 4 + 1 + 3 + 2 + 1 + 2 + 2 + 3 + 4 + 2 + 2 + 2 + 2 + 2 + 4


def written_by_hand(text):
    """Return files whose function is written in assembly language."""
    body = " ".join(f'"{line}\\n"' for line in text.split("\n"))
    source = '#include "k.h"\n__attribute__((naked)) int16_t k_symbol(const int16_t *z)\n'
    source += f"{{ __asm__ volatile({body}); }}\n"
    header = "#include <stdint.h>\nint16_t k_symbol(const int16_t *z);\n"
    return {"k.h": header.encode(), "k.c": source.encode()}


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("case", [("double-tank-a", "exact"), ("cart-pendulum", "linear")])
def test_no_state_takes_longer(name, style, case):
    need_tools(name)
    plan = plan_of(*case)
    tree, prefix = plan.tree.cells, case[0].replace("-", "_")
    written = files(plan, None, style=style)
    steps, exact = states.longest_steps(tree, style)
    assert exact
    call = (MACHINES[name], written, prefix, "symbol", "int16_t")
    worst = longest(*call, steps)
    within = np.clip(steps[[worst.row]], 0, np.array(tree.counts) - 1)
    assert worst.symbol == tree.labels(within)[0]
    counts = np.array(tree.counts)
    some = np.random.default_rng(6).integers(-2, counts + 2, size=(5000, plan.n))
    seen = longest(*call, some)
    assert 0.5 * worst.time < seen.time <= worst.time


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("affine", [False, True])
def test_no_state_of_cells_takes_longer(name, affine):
    need_tools(name)
    made_by = random_affine_policy if affine else random_policy
    plan = Plan.of(dataclasses.replace(made_by(3), name="cells"))
    written, cells = files(plan, None, style="cells"), plan.policy.cells
    steps, exact = states.longest_steps(cells, "cells")
    assert exact != affine
    call = (MACHINES[name], written, "cells", "symbol", "int16_t")
    worst = longest(*call, steps)
    within = np.clip(steps[[worst.row]], 0, np.array(cells.counts) - 1)
    assert worst.symbol == cells.labels(within)[0]
    some = np.random.default_rng(6).integers(-2, np.array(cells.counts) + 2, size=(5000, plan.n))
    seen = longest(*call, some)
    assert 0.5 * worst.time < seen.time <= worst.time


def test_there_is_a_state_of_each_leaf_and_of_each_branch():
    tree = plan_of("cart-pole").tree.cells
    steps, exact = states.longest_steps(tree, "nested")
    leaves = tree.find(steps)
    assert exact and sorted(leaves) == np.flatnonzero(tree.split == LEAF).tolist()
    assert (np.diff(tree.depths[leaves]) <= 0).all()
    oblique = plan_of("cart-pendulum", "linear").tree.cells
    steps, exact = states.longest_steps(oblique, "table")
    counts = np.array(oblique.counts)
    assert exact and {-1, 200} <= set(steps.ravel().tolist())
    reached = oblique.find(np.stack(np.indices(counts), axis=-1).reshape(-1, 2))
    assert set(oblique.find(np.clip(steps, 0, counts - 1))) == set(reached)


def test_what_is_not_known_to_be_the_longest(monkeypatch):
    monkeypatch.setattr(states, "MOST", 100)
    tree = plan_of("cart-pole").tree.cells
    steps, exact = states.longest_steps(tree, "table")
    assert not exact and len(steps) == 100
    assert tree.depths[tree.find(steps)].min() >= np.median(tree.depths[tree.split == LEAF])
    another = dataclasses.replace(
        _code(plan_of("cart-pendulum"), Options(style="table")), style="another"
    )
    assert not next(slowest._asked(another, golden_of("cart-pendulum")))[3]
    monkeypatch.setattr(states, "SAMPLES", 1000)
    assert not states.longest_steps(plan_of("cart-pendulum", "linear").tree.cells, "table")[1]


def test_an_export_says_how_long_a_decision_takes(tmp_path):
    need_tools("avr")
    need_tools("cortex-m3")
    source = policy("cart-pendulum")
    export(source, "c", tmp_path, cycles=True)
    worst = json.loads((tmp_path / "measured.json").read_text())["worst"]
    assert worst["avr"]["unit"] == "cycles" and worst["cortex-m3"]["unit"] == "instructions"
    assert "decide" not in worst["avr"]  # whose doubles are floats
    for found in worst.values():
        assert found["symbol"]["exact"]
        assert found["symbol"]["of"] == 440  # paths and their mirrors
        assert found["symbol"]["most"] > 1000
    seen = worst["cortex-m3"]["decide"]
    assert not seen["exact"] and seen["most"] > worst["cortex-m3"]["symbol"]["most"]
    (symbol,) = source(np.array([seen["at"]]))
    assert seen["symbol"] == symbol
    certificate = json.loads((tmp_path / "certificate.json").read_text())
    tree = plan_of("cart-pendulum").tree.cells
    (leaf,) = tree.find(np.array([certificate["comparisons"]["at"]]))
    assert tree.depths[leaf] == certificate["comparisons"]["most"]


@pytest.mark.parametrize(
    "options", [{"arithmetic": "float", "style": "nested"}, {"readings": "int16", "style": "grid"}]
)
def test_times_from_readings(options):
    need_tools("avr")
    plan = plan_of("cart-pole")
    if "readings" in options:
        widths = plan.policy.domain.widths
        plan = plan.of(plan.policy, scale=widths / 1000)
    code = made(plan, golden_of("cart-pole"), **options)
    found = slowest.slowest(_code(plan, Options(**options)), code.files, code.golden)["avr"]
    assert ("symbol" in found) == ("readings" in options)
    at = np.array([found["decide"]["at"]])
    if "readings" in options:
        (expected,) = decide(plan, at.astype(float)).labels
    else:
        (expected,) = decide_single(plan, at).labels
    assert found["decide"]["symbol"] == expected


def test_the_command_says_how_long_a_decision_takes(tmp_path):
    need_tools("avr")
    need_tools("cortex-m3")
    policy("cart-pendulum").save(tmp_path / "p.cap")
    where = ["-o", tmp_path / "made", "--style", "nested"]
    out, _ = capsyn("export", tmp_path / "p.cap", "--to", "c", "--cycles", *where)
    worst = json.loads((tmp_path / "made" / "measured.json").read_text())["worst"]
    assert f"c, avr, from steps to a symbol {worst['avr']['symbol']['most']} cycles, at most" in out
    assert "c, cortex-m3, from readings to a symbol" in out and "longest of 1,200 seen, at (" in out
    remembering().save(tmp_path / "r.cap")
    out, _ = capsyn("export", tmp_path / "r.cap", "--to", "c", "--cycles", *where)
    worst = json.loads((tmp_path / "made" / "measured.json").read_text())["worst"]
    seen = worst["cortex-m3"]["next"]
    assert f"from readings to a symbol {seen['most']:,} instructions, the longest of " in out
    told = error_of("export", tmp_path / "p.cap", "--to", "json", "--cycles", *where[:2])
    assert "`cycles` is no option of target json, which has name" in told


def test_processors_without_tools_are_left_out(monkeypatch, tmp_path):
    monkeypatch.setattr(emulators.shutil, "which", lambda tool: None)
    code = made(plan_of("cart-pendulum"))
    options = _code(plan_of("cart-pendulum"), Options(style="table"))
    with pytest.warns(CapsynWarning, match="`cycles` needs avr-gcc with simavr or .*timed"):
        assert slowest.slowest(options, code.files, golden_of("cart-pendulum")) == {}
    with pytest.raises(ProblemError, match="`cycles` must be True or False; got 3"):
        export(policy("cart-pendulum"), "c", tmp_path, cycles=3)


def test_inputs_that_do_not_fit_go_in_several_programs():
    need_tools("avr")
    steps, _ = states.longest_steps(plan_of("cart-pendulum").tree.cells, "table")
    call = (files(plan_of("cart-pendulum"), None), "cart_pendulum", "symbol", "int16_t")
    worst = longest(MACHINES["avr"], *call, steps)
    some = np.delete(steps, worst.row, axis=0)[:40]
    few = dataclasses.replace(MACHINES["avr"], room=72)
    found = longest(few, *call, np.concatenate([some, steps[[worst.row]]]))
    assert found == dataclasses.replace(worst, row=40)


def test_a_program_that_cannot_be_built_is_left_out():
    need_tools("avr")
    own = {"k.h": b"", "k.c": b"no C"}
    assert longest(MACHINES["avr"], own, "k", "symbol", "int16_t", np.zeros((1, 1), int)) is None
