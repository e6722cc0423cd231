"""Which module may import which: one list, in order; and what an import costs."""

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import capsyn
from capsyn import errors

ROOT = Path(capsyn.__file__).parent

ORDER = [
    "errors",
    "validation",
    "domain",
    "alphabet",
    "settings",
    "operations",
    "program",
    "program_builder",
    "intervals",
    "expansion",
    "targets",
    "model",
    "affine_leaves",
    "cells",
    "split_tree",
    "faces",
    "packing",
    "native",
    "native.build",
    "native.source",
    "native.kernels",
    "native.finite_control_set",
    "policy",
    "native.single",
    "verification",
    "verification.statistics",
    "decision_tree",
    "files",
    "answers",
    "policy_file",
    "cell_points",
    "limits",
    "propositions",
    "masks",
    "random_streams",
    "processors",
    "checkpoint",
    "cluster",
    "lattice_points",
    "cell_blocks",
    "constant_subdivision",
    "split_axes",
    "affine_fit",
    "growing_cells",
    "round_subdivision",
    "subdivision",
    "problem",
    "transcription",
    "ssac",
    "label_job",
    "remote_labels",
    "labelling",
    "synthesis",
    "plant",
    "closed_loop",
    "policy_loop",
    "trial_job",
    "actions",
    "sac",
    "online",
    "experiment",
    "simulation",
    "rectangles",
    "regions",
    "face_rates",
    "switching",
    "automaton",
    "verification.bisection",
    "verification.loop_derivative",
    "verification.lyapunov",
    "verification.agreement",
    "verification.monte_carlo",
    "compression",
    "compression.optimal",
    "compression.induction",
    "compression.freedom",
    "compression.surface",
    "compression.plane_tree",
    "compression.oblique",
    "compression.coarsening",
    "compression.affine_tree",
    "compression.proof",
    "compression.judge",
    "compression.compress",
    "compression.curve",
    "complexity",
    "sources",
    "sources.callables",
    "sources.finite_control_set",
    "sources.table",
    "sources.text",
    "sources.scots",
    "sources.grid_files",
    "integrations",
    "integrations.gymnasium",
    "integrations.control",
    "problems.cart_pendulum",
    "problems.cart_pole",
    "problems.double_tank",
    "problems.planar_quadrotor",
    "problems.spacecraft",
    "problems.double_pendulum",
    "problems.boost_converter",
    "problems",
    "problem_finder",
    "report",
    "evidence_text",
    "plots",
    "policy_picture",
    "automaton_drawing",
    "curve_plot",
    "paper",
    "paper_figures",
    "paper_pendulum",
    "paper_tanks",
    "reproduction",
    "explorer",
    "explorer.policy_data",
    "explorer.program_javascript",
    "explorer.expression",
    "explorer.formulas",
    "exports",
    "exports.plan",
    "exports.constants",
    "exports.golden",
    "exports.made",
    "exports.identifiers",
    "exports.long_lines",
    "exports.c_language",
    "exports.c_table",
    "exports.c_nested",
    "exports.c_grid",
    "exports.c_single",
    "exports.c_quantiser",
    "exports.c_lines",
    "exports.c_places",
    "exports.c_counts",
    "exports.c_notes",
    "exports.c_dwell",
    "exports.c_cmake",
    "exports.c",
    "exports.c_sizes",
    "exports.structured_text_lines",
    "exports.structured_text",
    "exports.verilog_ports",
    "exports.verilog_words",
    "exports.verilog_tree",
    "exports.verilog_bench",
    "exports.verilog",
    "exports.python_module",
    "exports.javascript",
    "exports.policy_json",
    "exports.dot",
    "exports.fmu",
    "exports.certificate",
    "exports.export",
    "explorer.facts",
    "explorer.page_data",
    "explorer.explore",
    "console",
    "cli_options",
    "cli_evidence",
    "cli_compression",
    "cli_export",
    "cli_explore",
    "cli_import",
    "cli_doctor",
    "cli",
    "__main__",
]
"""Every module; each imports only modules above it, inside functions too."""

EXCEPTIONS = {
    # `Policy.save` and `Policy.load` call the file format, which must know what a Policy is
    ("policy", "policy_file"),
    # a notebook asks a Policy for its picture
    ("policy", "policy_picture"),
}

FACADES = {"__init__"}
"""`capsyn/__init__.py` names what is public and imports it when it is first used."""

IMPORT_BY_NAME = {
    "__init__",  # the public names
    "problems",  # the built-in problems
    "problem_finder",  # the user's own
    "exports.export",  # the targets
    "cli_doctor",  # what capsyn needs
}

CASADI = {"problem", "transcription"}
"""The border, with the built-in problems behind it: the only places that know CasADi."""

MAX_LINES = 400


def modules():
    """Return the source files of all modules by name; ``__init__`` is the package itself."""
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] == "__init__" and len(parts) > 1:
            parts = parts[:-1]
        found[".".join(parts)] = path
    return found


MODULES = modules()
INNER = [name for name in MODULES if name not in FACADES]


def imported(name):
    """Yield the full names of what a module imports, inside functions and TYPE_CHECKING too."""
    for node in ast.walk(ast.parse(MODULES[name].read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: imports are absolute"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}".removeprefix("capsyn.")
                whole = inner in MODULES or node.module == "capsyn"  # never through the facade
                yield f"capsyn.{inner}" if whole else node.module


def test_every_module_is_in_the_list_once():
    assert len(set(ORDER)) == len(ORDER)
    assert set(INNER) == set(ORDER)


def test_contributors_find_every_module_in_the_order_of_the_list():
    text = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text()
    first_column = " ".join(re.findall(r"^\| (`.*?) \|", text, re.MULTILINE))
    told = re.findall(r"`(\w+)`", first_column)
    folders = set(re.findall(r"`(\w+)/`", first_column))
    assert folders == {name.split(".")[0] for name in ORDER if "." in name}
    commands = {name for name in ORDER if name.startswith("cli_")} - {"cli_options"}
    single = [name for name in ORDER if name.split(".")[0] not in folders]
    assert told == [name for name in single if name not in commands | {"__main__"}]


@pytest.mark.parametrize("name", INNER)
def test_imports_go_one_way(name):
    assert name in ORDER, "a new module: give it a place in the list"
    above = ORDER[: ORDER.index(name)]
    for full in imported(name):
        if full.split(".")[0] == "capsyn" and full != "capsyn.__version__":
            inner = full.removeprefix("capsyn.")
            assert inner in above or (name, inner) in EXCEPTIONS, f"{name} imports {inner}"


def test_exceptions_are_still_needed():
    for name, inner in EXCEPTIONS:
        assert f"capsyn.{inner}" in imported(name)
        tree = ast.parse(MODULES[name].read_text())
        at_the_top = [n.module for n in tree.body if isinstance(n, ast.ImportFrom)]
        assert f"capsyn.{inner}" not in at_the_top, "an exception is imported inside functions"


def test_imports_by_name_are_known():
    texts = {name: path.read_text() for name, path in MODULES.items()}
    dynamic = {name for name, text in texts.items() if "import_module" in text}
    assert dynamic == IMPORT_BY_NAME
    assert not [name for name, text in texts.items() if "__import__" in text]


def test_casadi_stays_at_the_border():
    users = {name for name in MODULES if any(m.split(".")[0] == "casadi" for m in imported(name))}
    assert CASADI <= users
    assert {name for name in users - CASADI if not name.startswith("problems.")} == set()


@pytest.mark.parametrize("name", MODULES)
def test_modules_are_short(name):
    lines = len(MODULES[name].read_text().splitlines())
    assert lines <= MAX_LINES, f"{name} has {lines} lines: split it"


def loaded_after(code):
    """Return the top-level packages that a fresh process has loaded after some code."""
    code += "\nimport sys; print(*{name.partition('.')[0] for name in sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def test_importing_the_package_loads_nothing_heavy():
    heavy = {"casadi", "scipy", "matplotlib", "typer", "rich", "safetensors", "numpy"}
    assert "capsyn" in (loaded := loaded_after("import capsyn"))
    assert not loaded & heavy


def test_a_policy_needs_no_casadi(tmp_path):
    code = (
        "import capsyn\n"
        "box = capsyn.Box([0], [1])\n"
        "made = capsyn.subdivide(lambda x: (x[:, 0] > 0.3).astype(int), box, 2, max_level=1)\n"
        f"made.save({str(tmp_path / 'p.cap')!r})\n"
        f"assert capsyn.Policy.load({str(tmp_path / 'p.cap')!r})([0.5]) == 1\n"
    )
    loaded = loaded_after(code)
    assert "safetensors" in loaded
    assert not loaded & {"casadi", "scipy", "matplotlib", "typer", "rich"}


@pytest.mark.parametrize("name", capsyn.__all__)
def test_public_names_resolve_and_are_documented(name):
    value = getattr(capsyn, name)
    assert value.__name__ == name and name in dir(capsyn)
    text = value.__dict__["__doc__"] if isinstance(value, type) else value.__doc__
    assert text and not text.startswith(f"{name}("), "a dataclass's own signature is no docstring"


def test_the_public_list_is_sorted_and_known_to_type_checkers():
    assert list(capsyn.__all__) == sorted(set(capsyn.__all__))
    checked = {
        alias.asname
        for node in ast.walk(ast.parse(MODULES["__init__"].read_text()))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("capsyn")
        for alias in node.names
    }
    assert checked == set(capsyn.__all__)
    with pytest.raises(AttributeError, match="module 'capsyn' has no attribute 'nothing'"):
        capsyn.nothing  # noqa: B018


def test_every_error_is_a_capsyn_error():
    found = [
        e for e in vars(errors).values() if isinstance(e, type) and e.__module__ == "capsyn.errors"
    ]
    raised = [e for e in found if issubclass(e, Exception) and not issubclass(e, Warning)]
    assert len(raised) >= 6 and all(issubclass(e, errors.CapsynError) for e in raised)


def test_every_module_can_be_imported_first():
    # a cycle shows only where a module in it is the first one that is imported
    for name in ("policy_file", "policy", "native.kernels", "synthesis", "problems"):
        assert loaded_after(f"import capsyn.{name}") >= {"capsyn"}
    assert importlib.import_module("capsyn.policy_file").load
