"""Bytes of exported C on processors, as their compilers tell."""

import re
import time

import pytest

from capsyn import Switching, problems, synthesize
from capsyn.errors import ProblemError
from capsyn.exports.c import sizes as c_sizes
from capsyn.exports.c.code import Code
from capsyn.exports.c.code_size import CodeSize
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.source import source
from capsyn.exports.c.target import written_bytes
from capsyn.exports.plan import Plan
from support.exports.c_machines import need
from support.exports.c_plans import files, plan_of


@pytest.mark.parametrize(("mode", "most"), [("exact", 1200), ("freedom", 900)])
def test_sizes(mode, most):
    need("arm-none-eabi-gcc", "avr-gcc")
    found = sizes(files(plan_of("cart-pendulum", mode), None), "cart_pendulum")
    assert 0 < found["cortex-m0"]["decision"] <= most
    assert 0 < found["avr"]["decision"] <= 2500
    assert 0 < found["cortex-m0"]["quantiser"] <= 1000
    assert all(measured["ram"] == 0 for measured in found.values())
    assert all(0 < measured["stack"] <= 64 for measured in found.values())


@pytest.mark.parametrize(
    ("name", "options", "affine"),
    [
        ("cart-pendulum", {"max_level": 2, "switching": None}, False),
        ("double-tank-b", {"max_level": 1, "switching": Switching(price=1.0)}, False),
        ("double-tank-a", {"max_level": 2, "leaves": "affine"}, True),
        ("cart-pendulum", {"max_level": 0, "partitions": 1, "switching": None}, False),
    ],
)
def test_bytes_that_are_told_without_a_compiler_are_those_of_the_tables_that_are_written(
    name, options, affine
):
    problem = problems.get(name)
    plan = Plan.of(synthesize(problem.replace(switching=options.pop("switching", None)), **options))
    style, plan = ("cells", plan.written(True)) if affine else ("table", plan)
    text = source(Code.of(plan, style, "lattice", "real", "t", 1e-6))
    tables = re.findall(r"static const u?int(\d+)_t t_\w+\[(\d+)\] CAPSYN_ROM", text)
    assert written_bytes(plan) == sum(int(bits) // 8 * int(size) for bits, size in tables)
    assert bool(tables) == bool(options["max_level"])


def test_a_budget_of_bytes_counts_what_an_export_says_a_decision_takes():
    need("arm-none-eabi-gcc")
    plan, size = plan_of("cart-pendulum", "freedom"), CodeSize("cortex-m0")
    measured = sizes(files(plan, None), "cart_pendulum", ["cortex-m0"])
    assert size(plan.tree) == measured["cortex-m0"]["decision"]
    assert list(measured) == ["cortex-m0"] and size.name == "bytes of C on cortex-m0"


def test_a_budget_of_bytes_needs_a_compiler(monkeypatch):
    with pytest.raises(ProblemError, match="`target` must be one of 'cortex-m0'"):
        CodeSize("z80")
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(ProblemError, match="`target` avr needs avr-gcc, which is not installed"):
        CodeSize("avr")


@pytest.mark.parametrize("tool", ["gcc", "nm", "size"])
def test_sizes_without_a_tool(monkeypatch, tool):
    run = c_sizes.run_tool
    monkeypatch.setattr(
        c_sizes,
        "run_tool",
        lambda command, *rest: None if command[0].endswith(tool) else run(command, *rest),
    )
    assert sizes(files(plan_of("cart-pendulum"), None), "cart_pendulum") == {}


def test_sizes_name_compilers():
    need("gcc")
    for measured in sizes(files(plan_of("cart-pendulum"), None), "cart_pendulum").values():
        assert re.fullmatch(r"[a-z-]*gcc \d+\.\d+\.\d+", measured["compiler"])


@pytest.mark.parametrize("driver", ["wait", "exit"])  # the second leaves what it started alone
def test_a_compiler_that_does_not_end_is_left_out(tmp_path, monkeypatch, driver):
    monkeypatch.setattr(c_sizes, "SECONDS", 0.3)
    started = time.monotonic()
    assert c_sizes.run_tool(["sh", "-c", f"(sleep 2; touch late) & {driver}"], tmp_path) is None
    assert time.monotonic() - started < 1.9
    time.sleep(2)
    assert not (tmp_path / "late").exists()  # what it started has ended too
