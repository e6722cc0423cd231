"""The command that says what this machine offers, and what works without the rest."""

from __future__ import annotations

import importlib
import platform
import re
import shutil
import subprocess
import sys
from importlib import metadata, resources
from typing import Any

import typer

from capsyn.cli.console import print_line, show
from capsyn.cli.options import Json
from capsyn.errors import CapsynError
from capsyn.version import __version__

DATA = {
    "alphabets": ("loops/choose.c",),
    "controllers": ("action.c", "one_step.c", "ssac.c"),
    "optima": ("dynamic_programming.c",),
    "policies": ("lookup.c",),
    "programs": ("intervals.c",),
    "reach": ("polygon.c", "box.c", "flow.c", "follow.c"),
    "simulation": ("simulate.c",),
    "sources": ("finite_control_set.c",),
    "exports": (
        "fmu/fmu.c",
        "javascript/lattice.js",
        "policy_json/schema.json",
        "policy_json/memory.json",
    ),
    "explorer": (
        *("page.css", "page.js", "page.memory.css", "page.memory.js"),
        *("page/page.html", "vendor/uPlot.LICENSE"),
    ),
    ".": ("py.typed",),
}
"""Files beside the modules that an installation must have, by folder."""

SLOWER = "NumPy does the work: a solve takes some 25 times as long, the results are the same"
COMMANDS: dict[str, tuple[str, str]] = {
    "gcc": ("bytes of exported C on this machine", "measured.json has no such figures"),
    "arm-none-eabi-gcc": (
        "bytes of exported C on Cortex-M0 and M4",
        "measured.json has no such figures",
    ),
    "avr-gcc": ("bytes of exported C on AVR", "measured.json has no such figures"),
    "dot": ("drawing what `export --to dot` writes", "`capsyn automaton -o FILE.svg` draws, too"),
    "iverilog": ("the test bench of exported Verilog", "any other simulator runs it"),
    "clang": ("tests of kernels and exported C", "these tests are skipped"),
    "cppcheck": ("tests of exported C against MISRA C:2012", "these tests are skipped"),
    "qemu-system-arm": (
        "how long exported C takes on a Cortex-M3, and its tests",
        "measured.json has no such figures, tests are skipped",
    ),
    "simavr": (
        "how long exported C takes on AVR, and its tests",
        "measured.json has no such figures, tests are skipped",
    ),
    "cmake": ("tests of exported CMake projects", "these tests are skipped"),
    "verilator": ("tests of exported Verilog", "these tests are skipped"),
    "yosys": ("tests of exported Verilog", "these tests are skipped"),
    "node": ("tests of exported JavaScript and of the explorer", "these tests are skipped"),
    "chromium": ("tests of the explorer's page, and its picture", "these tests are skipped"),
}
"""What a command is for, and what is without it."""
EXTRAS: dict[str, tuple[str, str, str]] = {
    "networkx": ("graphs", "`Automaton.to_networkx`", "DOT, JSON and drawings"),
    "gymnasium": ("gymnasium", "`capsyn.integrations.gymnasium`", "all else"),
    "control": ("control", "`capsyn.integrations.control`", "all else"),
    "distributed": ("distributed", "clusters: `--dask`, `executor=`", "threads of this machine"),
    "optuna": ("tune", "`capsyn tune`, `capsyn.tune`", "all else"),
    "scikit-learn": ("bench", "CART in the benchmarks", "all else"),
    "ziglang": (
        "compiler",
        "kernels where there is no other C compiler; binaries of other platforms in an FMU",
        "cc, gcc or clang builds kernels, and the binary of this platform",
    ),
    "fmpy": ("dev", "tests of the FMU", "exporting it"),
    "lief": ("dev", "tests of the FMU's binaries for other platforms", "exporting it"),
    "jsonschema": ("dev", "tests of exported JSON", "exporting it"),
    "tree-sitter-iec61131-3-st": ("dev", "tests of Structured Text", "exporting it"),
    "plcopen": ("dev", "tests of PLCopen XML", "exporting it"),
    "playwright": ("dev", "tests of the explorer's page", "making it"),
    "nbclient": ("dev", "tests of the notebooks", "reading and running them"),
    "sphinx": ("docs", "`make docs`", "all else"),
}
"""Optional Python packages: their extra, what they are for, and what works without."""
LANES = (("__AVX512F__", 8), ("__AVX__", 4), ("__SSE2__", 2), ("__ARM_NEON", 2))
"""What compilers predefine, and how many double-precision numbers one instruction then takes."""


def doctor(as_json: Json = False) -> None:
    """Say what this machine offers, and what works without the rest.

    The exit status is 1 where the installation itself is broken.
    """
    data = examine()
    show(as_json, data, lambda: _print(data))
    if data["broken"]:
        raise typer.Exit(1)


def examine() -> dict[str, Any]:
    """Return what was found, as plain data.

    Returns
    -------
    dict
        ``capsyn``, ``python``, ``platform``; ``processors``; ``compiler`` and ``cache``, whose
        ``trouble`` is None where there is none; ``packages`` that capsyn needs; ``commands`` and
        ``extras`` that are optional, whose ``version`` is None where they are absent; ``broken``:
        a sentence for each thing that the installation lacks.
    """
    from capsyn.execution.processors import processors

    packages = [_package(text) for text in metadata.requires("capsyn") or [] if ";" not in text]
    root = resources.files("capsyn")
    missing = [f"{folder}/{name}" for folder, names in DATA.items() for name in names]
    missing = [name for name in missing if not (root / name).is_file()]
    broken = [f"{p['name']}: {p['trouble']}" for p in packages if p["trouble"]]
    broken += [f"the file {name} is missing" for name in missing]
    return {
        "capsyn": __version__,
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "processors": processors(),
        "compiler": _compiler(bool(broken)),
        "cache": _cache(),
        "packages": packages,
        "commands": [
            {"name": name, "version": _version(name), "for": use, "without": without}
            for name, (use, without) in COMMANDS.items()
        ],
        "extras": [
            {"name": name, "version": _installed(name), "extra": extra, "for": use, "without": rest}
            for name, (extra, use, rest) in EXTRAS.items()
        ],
        "broken": broken,
    }


def _package(requirement: str) -> dict[str, Any]:
    """Return how a requirement such as ``numpy>=1.24`` is met."""
    name, _, least = requirement.partition(">=")
    version, trouble = _installed(name), None
    if version is None:
        trouble = "not installed"
    elif _numbers(version) < _numbers(least):
        trouble = f"must be {least} or newer; is {version}"
    else:
        try:
            importlib.import_module(name)
        except Exception as error:  # whatever a damaged package does
            trouble = f"cannot be imported: {type(error).__name__}: {error}"
    return {"name": name, "least": least, "version": version, "trouble": trouble}


def _numbers(version: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", version)[:3]]


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _version(command: str) -> str | None:
    """Return the version of a command, "unknown" if it does not tell, None if it is not there."""
    program = shutil.which(command)
    if program is None:
        return None
    for option in ("--version", "-V"):
        version = re.search(r"\d+(\.\d+)+", _said([program, option]))
        if version:
            return version[0]
    return "unknown"


def _said(command: list[str]) -> str:
    """Return what a command prints when it is given no input; nothing where it does not run."""
    try:
        run = subprocess.run(
            command, input="", capture_output=True, encoding="utf-8", errors="replace", timeout=20
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return run.stdout + run.stderr


def _compiler(broken: bool) -> dict[str, Any]:
    """Return the C compiler, and whether a kernel that it builds can be loaded."""
    from capsyn.native.compiler import find_compiler, usual_flags
    from capsyn.policies.lookup import LookupKernel

    facts: dict[str, Any] = {"command": None, "version": None, "lanes": None, "trouble": None}
    try:
        compiler = find_compiler()
        facts["command"], facts["version"] = list(compiler.command), compiler.version
        facts["lanes"] = _lanes([*compiler.command, *usual_flags(compiler)])
        if not broken:
            LookupKernel.build(1)
    except CapsynError as error:
        facts["trouble"] = str(error)
    return facts


def _lanes(command: list[str]) -> int | None:
    """Return how many double-precision numbers an instruction takes; None if it does not tell."""
    defined = set(_said([*command, "-dM", "-E", "-x", "c", "-"]).split())
    return next((lanes for macro, lanes in LANES if macro in defined), None)


def _cache() -> dict[str, Any]:
    """Return where kernels are kept, how many, and their bytes; nothing is made."""
    from capsyn.native.build import cache_directory, cache_trouble
    from capsyn.native.compiler import ENDING

    facts: dict[str, Any] = {"directory": None, "kernels": 0, "bytes": 0, "trouble": None}
    try:
        directory = cache_directory()
        facts["directory"] = str(directory)
        if directory.is_dir():
            sizes = [path.stat().st_size for path in directory.glob(f"*{ENDING}")]
            facts["kernels"], facts["bytes"] = len(sizes), sum(sizes)
        if directory.exists() or directory.is_symlink():
            facts["trouble"] = cache_trouble(directory)
    except (OSError, RuntimeError) as error:
        facts["trouble"] = str(error)
    return facts


def _print(data: dict[str, Any]) -> None:
    compiler, cache = data["compiler"], data["cache"]
    print_line("capsyn", f"{data['capsyn']}, Python {data['python']}, {data['platform']}")
    if compiler["command"]:
        lanes = f"; {compiler['lanes']} double-precision lanes" if compiler["lanes"] else ""
        print_line("compiler", f"{' '.join(compiler['command'])}: {compiler['version']}{lanes}")
    if compiler["trouble"]:
        print_line("no kernels", f"{compiler['trouble']}. {SLOWER}")
    print_line("processors", f"{data['processors']} that this process may use")
    kept = f"{cache['kernels']:,} kernels, {cache['bytes']:,} bytes"
    print_line("cache", f"{cache['directory']}: {kept}")
    if cache["trouble"]:
        print_line(
            "", f"not used, since {cache['trouble']}; kernels are built for each process anew"
        )
    for package in data["packages"]:
        print_line(package["name"], package["trouble"] or package["version"])
    typer.echo("\noptional commands")
    for tool in data["commands"]:
        _print_optional(tool, "without: ")
    typer.echo("\noptional packages")
    for extra in data["extras"]:
        _print_optional(extra, f"capsyn[{extra['extra']}]; without: ")
    for sentence in data["broken"]:
        print(f"error: broken installation: {sentence}", file=sys.stderr)


def _print_optional(tool: dict[str, Any], without: str) -> None:
    version = tool["version"] or "-"
    typer.echo(f"  {tool['name']:<27}{version:<15}{tool['for']}")
    if tool["version"] is None:
        typer.echo(f"  {'':<42}{without}{tool['without']}")
