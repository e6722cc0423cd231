"""The modules of the explorer's page, run by Node."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

import capsyn.explorer
from capsyn.explorer.memory_data import needs_memory
from capsyn.explorer.packed import pack
from capsyn.explorer.policy_data import policy_data
from capsyn.explorer.program_javascript import features_javascript, model_javascript

NODE = shutil.which("node")
HOME = Path(capsyn.explorer.__file__).parents[1]
BEGIN = """
import { readFileSync } from "node:fs";
import { unpacked } from "./explorer/page/policy/packed.js";
const input = JSON.parse(readFileSync(process.argv[2], "utf8"));
input.policy = await unpacked(input.policy);
const numbers = rows => rows.map(row => row.map(v => (v === "nan" ? NaN : Number(v))));
const print = value => console.log(JSON.stringify(value, (_, v) =>
  ArrayBuffer.isView(v) ? Array.from(v) : Number.isNaN(v) ? null : v));
"""
SPECIAL = {"nan": "nan", "inf": "Infinity", "-inf": "-Infinity"}


def texts(states):
    """Return states (K, n) as texts that JavaScript's Number reads exactly."""
    return [[SPECIAL.get(repr(v), repr(v)) for v in row] for row in states.tolist()]


def node(directory, code, policy, **inputs):
    """Return what a script prints of ``input``: a policy's data and more.

    Modules of which there are two are imported from ``#page``, as the page does.
    """
    if not NODE:
        pytest.skip("needs node: apt-get install nodejs")
    for path in [*HOME.rglob("explorer/page/**/*.js"), *HOME.rglob("exports/**/*.js")]:
        copy = directory / path.relative_to(HOME)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(path.read_bytes())
    (directory / "model.js").write_text(model_javascript(policy))
    (directory / "features.js").write_text(
        features_javascript(policy) or "export const features = null;"
    )
    modules = {"memory": "./explorer/page/memory/*", "default": "./explorer/page/*"}
    package = {"type": "module", "imports": {"#page/*": modules}}
    (directory / "package.json").write_text(json.dumps(package))
    (directory / "run.js").write_text(code)
    (directory / "input.json").write_text(
        json.dumps({"policy": pack(policy_data(policy)), **inputs})
    )
    command = [NODE, *["--conditions=memory"] * needs_memory(policy)]
    command += [directory / "run.js", directory / "input.json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)
