"""What `capsyn doctor` finds, on machines that lack one thing or another."""

import json
import re
from importlib import metadata
from pathlib import Path

import pytest
from typer.testing import CliRunner

import capsyn
from capsyn.cli import doctor as cli_doctor
from capsyn.cli.app import app
from capsyn.exports.c.sizes import COMPILERS
from capsyn.native import compiler


def script(folder, name, text):
    path = folder / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def test_versions_of_commands_are_read_wherever_they_are_told(tmp_path, monkeypatch):
    script(tmp_path, "iverilog", '[ "$1" = -V ] && echo "Icarus Verilog version 12.0 (stable)"')
    script(tmp_path, "dot", "echo 'dot - graphviz version 2.43.0 (0)' >&2")
    script(tmp_path, "yosys", "echo none")
    monkeypatch.setenv("PATH", str(tmp_path))
    found = {tool["name"]: tool["version"] for tool in cli_doctor.examine()["commands"]}
    assert found.pop("iverilog") == "12.0" and found.pop("dot") == "2.43.0"
    assert found.pop("yosys") == "unknown" and set(found.values()) == {None}


def test_a_compiler_that_makes_nothing_is_told(tmp_path, monkeypatch):
    script(tmp_path, "cc", '[ "$1" = --version ] && echo "cc 1.2" || { echo "no space"; exit 3; }')
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    compiler = cli_doctor.examine()["compiler"]
    assert compiler["version"] == "cc 1.2" and compiler["lanes"] is None
    assert "the C compiler failed with status 3" in compiler["trouble"]


def test_the_compiler_of_this_machine_builds_kernels():
    compiler = cli_doctor.examine()["compiler"]
    if compiler["command"] is None:
        pytest.skip("no C compiler is installed")
    assert compiler["trouble"] is None and compiler["lanes"] in (None, 2, 4, 8)


@pytest.mark.parametrize(
    "mode, trouble", [(0o700, None), (0o777, "others may write there")], ids=["own", "open"]
)
def test_the_cache_is_measured_and_judged(tmp_path, monkeypatch, mode, trouble):
    cache = tmp_path / "kernels"
    monkeypatch.setenv("CAPSYN_CACHE_DIR", str(cache))
    assert cli_doctor._cache() == {
        "directory": str(cache),
        "kernels": 0,
        "bytes": 0,
        "trouble": None,
    }
    assert not cache.exists()
    cache.mkdir()
    cache.chmod(mode)
    (cache / "a.so").write_bytes(bytes(700))
    (cache / "a.sha256").write_text("0")
    found = cli_doctor._cache()
    assert (found["kernels"], found["bytes"]) == (1, 700)
    assert found["trouble"] is trouble or trouble in found["trouble"]


def test_a_package_that_is_absent_old_or_damaged_is_a_broken_installation(tmp_path, monkeypatch):
    for name, version, text in (("olden", "1.9.3", ""), ("damaged", "2.0", "import nothing_such")):
        (tmp_path / f"{name}.py").write_text(text)
        information = tmp_path / f"{name}-{version}.dist-info"
        information.mkdir()
        (information / "METADATA").write_text(f"Name: {name}\nVersion: {version}\n")
    monkeypatch.syspath_prepend(tmp_path)
    wanted = ["olden>=1.10", "olden>=1.9", "damaged>=1", "absent>=3", 'other>=1; extra == "x"']
    monkeypatch.setattr(metadata, "requires", lambda name: wanted)
    run = CliRunner().invoke(app, ["doctor", "--json"])
    data = json.loads(run.stdout)
    assert run.exit_code == 1
    assert data["broken"] == [
        "olden: must be 1.10 or newer; is 1.9.3",
        "damaged: cannot be imported: ModuleNotFoundError: No module named 'nothing_such'",
        "absent: not installed",
    ]


def test_the_text_says_what_works_without(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(compiler, "zig_program", lambda: None)
    run = CliRunner().invoke(app, ["doctor"])
    assert run.exit_code == 0
    for _, without in cli_doctor.COMMANDS.values():
        assert f"without: {without}" in run.stdout
    assert "no kernels   no C compiler found" in run.stdout
    assert 'one comes with pip install "capsyn[compiler]"' in run.stdout


def test_the_files_beside_modules_are_looked_for():
    root = Path(capsyn.__file__).parent
    files = {path for path in root.rglob("*") if path.suffix in (".c", ".json", ".typed")}
    files |= set((root / "exports").rglob("*.js"))
    files |= {path for path in (root / "explorer").glob("page.*") if path.is_file()}
    files |= {root / "explorer" / "page" / "page.html", root / "explorer/vendor/uPlot.LICENSE"}
    listed = [root / folder / name for folder, names in cli_doctor.DATA.items() for name in names]
    assert set(listed) == files


def test_the_lists_are_those_of_code_and_package():
    assert {command[0] for command in COMPILERS.values()} <= set(cli_doctor.COMMANDS)
    offered = {
        (re.match(r"[\w-]+", text)[0], re.search(r'extra == "(\w+)"', text)[1])
        for text in metadata.requires("capsyn")
        if "extra ==" in text
    }
    listed = {(name, extra) for name, (extra, *_) in cli_doctor.EXTRAS.items()}
    assert listed <= offered
    assert {extra for _, extra in listed} == {extra for _, extra in offered} - {"all"}
