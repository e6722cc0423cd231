"""Wheel and sdist hold what they must, and work in an environment of their own."""

import ast
import json
import os
import re
import subprocess
import sys
import tarfile
import venv
import zipfile
from email.parser import Parser
from pathlib import Path

import numpy as np
import pytest
import yaml

import capsyn
from capsyn.cli.doctor import DATA

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "capsyn"


def without(*names):
    """Return the environment of this process without some variables."""
    return {name: value for name, value in os.environ.items() if name not in names}


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """Build the sdist, and the wheel from the sdist; return the folder that they are in."""
    made = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", made, ROOT]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    return made


@pytest.fixture(scope="session")
def wheel(built):
    (path,) = built.glob("*.whl")
    return path


@pytest.fixture(scope="session")
def clean(wheel, tmp_path_factory):
    """Install the wheel into an environment where nothing else of this repository is.

    What capsyn needs is not fetched again: a .pth file shows the packages of this environment,
    but not its editable capsyn, since .pth files found through a .pth file do not count.
    """
    place = tmp_path_factory.mktemp("clean") / "venv"
    venv.create(place, with_pip=False, symlinks=True)
    python = place / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--no-index", "--no-deps"]
    subprocess.run(
        [*pip, "--quiet", wheel], check=True, capture_output=True, env=without("PYTHONPATH")
    )
    (site,) = place.glob("lib/python*/site-packages")
    (site / "needed.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
    return place


def run(clean, *command, code=0, cwd=None, path="", **environment):
    """Run a command of the clean environment; return its stdout and stderr.

    Without a path there is no compiler; that of ziglang could be seen from there, too.
    """
    environment = ({} if path else {"CC": "none"}) | environment
    done = subprocess.run(
        [clean / "bin" / command[0], *map(str, command[1:])],
        capture_output=True,
        text=True,
        cwd=cwd or clean,
        env=without("PYTHONPATH", "CC") | {"PATH": path} | environment,
    )
    assert done.returncode == code, done.stderr
    return done.stdout, done.stderr


def test_the_wheel_is_the_package_and_nothing_else(wheel):
    here = {
        str(path.relative_to(PACKAGE.parent))
        for path in PACKAGE.rglob("*")
        if path.is_file() and path.suffix not in (".pyc", ".pyo")
    } - {f"capsyn/explorer/vendor/uPlot.{end}" for end in ("esm.js", "min.css")}  # bundled
    names = zipfile.ZipFile(wheel).namelist()
    assert {name for name in names if ".dist-info/" not in name} == here
    needed = {f"capsyn/{folder}/{name}" for folder, files in DATA.items() for name in files}
    assert {str(Path(name)) for name in needed} <= here


def test_the_sdist_has_tests_guides_and_examples(built):
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = ["Makefile", "LICENSE", "CITATION.cff", "examples/boat.py", "docs/theory.md"]
    wanted += [str(test.relative_to(ROOT)) for test in (ROOT / "tests").glob("*.py")]
    assert not set(wanted) - names
    assert not [name for name in names if "__pycache__" in name or name.endswith(".cap")]


def test_one_version_and_honest_metadata(wheel):
    archive = zipfile.ZipFile(wheel)
    (name,) = (name for name in archive.namelist() if name.endswith("/METADATA"))
    metadata = Parser().parsestr(archive.read(name).decode())
    assert metadata["Version"] == capsyn.__version__
    assert {"graphs", "gymnasium", "control", "all", "bench", "docs", "dev"} <= set(
        metadata.get_all("Provides-Extra")
    )
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == capsyn.__version__
    assert metadata["License-Expression"] == f"{citation['license']} AND MIT"  # that of uPlot
    assert citation["references"][0]["title"] in (ROOT / "README.md").read_text()


def test_what_is_imported_is_declared():
    declared = (ROOT / "pyproject.toml").read_text()
    needed = re.search(r"\ndependencies = \[(.*?)\]", declared, re.DOTALL)[1]
    all_of = re.search(r'\nall = \["capsyn\[(.*?)\]"\]', declared)[1].split(",")
    offered = "".join(re.search(rf"\n{extra} = \[(.*?)\]", declared)[1] for extra in all_of)
    names = {re.match(r"[\w-]+", text)[0] for text in re.findall(r'"(.*?)"', needed + offered)}
    imported = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(node.module.partition(".")[0])
    assert imported - sys.stdlib_module_names - {"capsyn"} == names


def test_without_a_compiler_there_is_one_warning_and_the_same_policy(clean, tmp_path):
    out, err = run(clean, "capsyn", "synth", "cart-pendulum", cwd=tmp_path)
    assert err.count("\n") == 1 and err.startswith("warning: solving with NumPy: no C compiler")
    assert "9,092" in out
    compiled = tmp_path / "compiled.cap"
    command = [sys.executable, "-m", "capsyn", "synth", "cart-pendulum", "-o", compiled]
    subprocess.run(command, check=True, capture_output=True)
    assert (tmp_path / "cart-pendulum.cap").read_bytes() == compiled.read_bytes()


def test_it_is_the_installed_package_that_runs(clean, tmp_path):
    code = "import capsyn; print(capsyn.__file__, *capsyn.__all__)"
    path, *names = run(clean, "python", "-c", code)[0].split()
    assert Path(path).is_relative_to(clean) and names == capsyn.__all__
    version = f"capsyn {capsyn.__version__}\n"
    assert run(clean, "capsyn", "--version")[0] == version
    assert run(clean, "python", "-m", "capsyn", "--version")[0] == version
    run(clean, "capsyn", "synth", "double-tank-b", cwd=tmp_path, path=os.environ["PATH"])
    targets = ["export", "double-tank-b.cap", "--to", "all", "-o", "out"]
    run(clean, "capsyn", *targets, cwd=tmp_path, path=os.environ["PATH"])
    assert (tmp_path / "out" / "fmu" / "double_tank_b.fmu").exists()


def test_doctor_says_whether_the_installation_is_whole(clean, tmp_path):
    data = json.loads(run(clean, "capsyn", "doctor", "--json")[0])
    assert data["broken"] == [] and "no C compiler" in data["compiler"]["trouble"]
    assert {tool["version"] for tool in data["commands"]} == {None}
    (source,) = clean.glob("lib/python*/site-packages/capsyn/controllers/ssac.c")
    source.rename(tmp_path / "ssac.c")
    try:
        err = run(clean, "capsyn", "doctor", code=1)[1]
    finally:
        (tmp_path / "ssac.c").rename(source)
    assert err == "error: broken installation: the file controllers/ssac.c is missing\n"
