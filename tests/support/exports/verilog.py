"""Simulators and linters that run the Verilog of an export."""

import re
import shutil
import subprocess

import pytest

from capsyn.exports.golden import golden_vectors
from capsyn.exports.sequence import RUNS, STEPS
from capsyn.exports.verilog.target import TARGET as target


def tool(name):
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed")
    return name


def run(folder, *command):
    tool(command[0])
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def simulate(folder, files, other="_sequence_tb.v"):
    """Return what a test bench says, not that whose file's name has the `other` end."""
    for name, content in files.items():
        (folder / name).write_bytes(content)
        assert max(map(len, content.splitlines())) < 100
    sources = [name for name in files if name.endswith(".v") and not name.endswith(other)]
    warnings = run(folder, "iverilog", "-g2005", "-Wall", "-o", "bench.vvp", *sources)
    assert warnings == ""
    return run(folder, "vvp", "-n", "bench.vvp")


def check(folder, plan, **options):
    golden = golden_vectors(plan)
    files = target.files(plan, golden, **options).files
    name = next(iter(files))
    finite = int((golden.statuses != 2).sum())
    assert simulate(folder, files) == f"PASS: {finite} vectors\n"
    if plan.has_state:
        other = f"{name[:-2]}_tb.v"
        assert simulate(folder, files, other) == f"PASS: {RUNS * STEPS} vectors\n"
    assert run(folder, "verilator", "--lint-only", "-Wall", name) == ""
    said = re.findall(r"^// Symbol (\d+): .*\((.*)\)$", files[name].decode(), re.M)
    controls = [[float(value) for value in values.split(", ")] for _, values in said]
    assert [int(k) for k, _ in said] == list(range(plan.labels))
    assert controls == plan.policy.controls.tolist()
    return files[name].decode()
