"""The house: which module may import which, how full a room may be, and what an import costs."""

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import capsyn
from capsyn import errors
from support import javascript

ROOT = Path(capsyn.__file__).parent
TOP = Path(__file__).parents[2]

ORDER = """
errors validation random_streams statistics version notebook

programs: operations program texts builder patterns ends intervals interval_text
    expansion continuity model step_doubling
native: compiler build compiled source bounds
modelling: domain alphabet exogenous settings targets grid time_unit switching discrete
modelling.tails: tail equilibrium riccati
modelling: interpolants expressions problem transcription
execution: files interrupts processors memory answers checkpoint cluster
problems: cart_pendulum cart_pole double_tank planar_quadrotor spacecraft double_pendulum
    boost_converter inverter building docking quadrotor
cells: masks row_table affine_leaves boxes cell_tree split_tree feature_tree cut faces packing work
    run_lengths merged
limits: kept
policies: lookup guarantee evidence colors in_force picture checks file cut derived policy
    report
controllers: command formulation solver steps one_step ssac action_kernel actions sac online
controllers.unsolved: diagnosis inside
subdivision: cell_points propositions limits split_axes affine_fit growing_cells plan
    lattice_points cell_blocks ledger constant rounds subdivide
automata: rectangles regions face_rates row_faces switching table_html automaton
simulation: plant options exogenous kernel closed_loop policy_loop trial_job experiment figures
    shown simulate tracking
improvement: charged_loop judged quadratic_fit refits rollouts rounds improve
limits: tubes invariant asked shield telling
synthesis: remote_labels labelling synthesize fitted_tail
sources: delayed sequence_costs finite_control_set callables table text
sources.tables: numbers lines columns axes points symbols csv_file json_text storm prism regressors
    stratego
sources: scots grid_files
optima: grid task sweeps loops iteration comparison optimum
verification: bisection loop_derivative lyapunov tally agreement trials outcome
    conditions monte_carlo switching_curve sentences
certification: cell_map certificate
integrations: single_lookup stepping evaluation gymnasium control
compression: rows optimal induction freedom coarsening affine_tree
compression.fitted: surface plane_tree oblique
compression.features: growing space cell_fit controller_fit
compression: proof judge trees
compression.looped: loops choice growing fitting by_loop
compression: lost compress curve complexity
reach: half_spaces loop kernel twins arrive stay
certification: question refute proof_file certify
certification.checker: bounds sets flows cells moving pieces
certification: check
tuning: free family figures goal study advice same_study tune
alphabets: names candidates symmetries gains spread pace judged asked
alphabets.loops: chooser by_numpy stand_in alphabet_loops
alphabets.search: objective storage scores exchange rollout_gains moving starts
    best_alphabets
plots: figure symbols policy pieces trajectory transition_matrix automaton curve switching optimum
    certificate alphabet
exports: crossings text plan constants golden sequence target certificate identifiers
    feature_texts
exports.c: language styles.mirrors styles.diagram styles.stream styles.table styles.nested
    styles.grid styles.cells readings.single readings.lines readings.counts features memory code
    readings.places readings.quantiser notes dwell timers header source packages sizes
    timing.programs timing.emulators timing.states timing.slowest target code_size
exports.structured_text: words lines pou cells block cuts functions steps memory hold source
    dialects.siemens dialects.plcopen target
exports.verilog: words ports module tree memory bench source target
exports.javascript: target
exports.policy_json: target
exports.fmu: times description build target
exports: python_module dot export
alphabets: study document judge choose
explorer: packed memory_data policy_data program_javascript expression formulas facts page_data
    explore
paper: cases figures pendulum tanks reproduction
cli: options console printed problem_finder loop
cli.better: optimum
cli.proofs: proved trials certify
cli: paper evidence compression export look
    import_table doctor
cli.better: improve switching searches tune given_alphabet alphabet
cli.making: source simulate synth
cli: app

__main__
"""
"""Every module in order, wing by wing: each imports only what stands before it, inside functions
and for type checkers, too. The first line has what any wing may import."""

IMPORT_BY_NAME = {
    "capsyn",  # the public names
    "problems",  # the built-in problems
    "cli.problem_finder",  # the user's own
    "exports.export",  # each of them
    "cli.doctor",  # what capsyn needs
}

CASADI = {
    "modelling.interpolants",
    "modelling.expressions",
    "modelling.problem",
    "modelling.transcription",
}
"""The border, with the built-in problems behind it: the only places that know CasADi."""

MAX_LINES, MAX_CODE, MAX_FILES, MAX_PARAMETERS, MAX_TEST_LINES = 400, 60, 14, 8, 800
TESTS = sorted((TOP / "tests").rglob("*.py"))


def listed(text):
    """Return the modules in a text such as `ORDER`, in order."""
    names, wing = [], ""
    for line in text.strip().splitlines():
        opens = re.match(r"([\w.]+): ", line)
        wing = opens[1] + "." if opens else wing if line.startswith(" ") else ""
        names += [wing + name for name in line[opens.end() if opens else 0 :].split()]
    return names


def modules():
    """Return the source files of all modules by name; packages under their own."""
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts) or "capsyn"] = path
    return found


MODULES = modules()
PACKAGES = {name for name, path in MODULES.items() if path.name == "__init__.py"}
PLACES = listed(ORDER)


def imported(name):
    """Yield the modules of capsyn, and the other packages, that a module imports anywhere."""
    for node in ast.walk(ast.parse(MODULES[name].read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: imports are absolute"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}".removeprefix("capsyn.")
                yield f"capsyn.{inner}" if inner in MODULES else node.module


def test_every_module_is_in_the_list_once():
    assert len(set(PLACES)) == len(PLACES)
    assert set(MODULES) - PACKAGES == set(PLACES)


@pytest.mark.parametrize("name", PLACES)
def test_imports_go_one_way(name):
    before = PLACES[: PLACES.index(name)]
    for full in imported(name):
        if full.split(".")[0] == "capsyn":
            inner = full.removeprefix("capsyn.")
            wing = inner in PACKAGES and any(place.startswith(f"{inner}.") for place in before)
            assert inner in before or wing, f"{name} imports {inner}"
            # a wing's package stands for all of it
            assert not name.startswith(f"{inner}."), f"{name} imports the wing that it is in"
    assert "capsyn" not in imported(name), "not through the facade"


@pytest.mark.parametrize("name", sorted(PACKAGES - {"capsyn"}))
def test_packages_import_their_own_modules_and_those_below(name):
    last = max(i for i, place in enumerate(PLACES) if place.startswith(f"{name}."))
    for full in imported(name):
        if full.split(".")[0] == "capsyn":
            assert full.removeprefix("capsyn.") in PLACES[: last + 1]


def test_files_of_other_wings_are_read_by_those_that_stand_after_them():
    for name in PLACES:
        text = MODULES[name].read_text()
        wings = re.findall(r'hand_written\("(\w+)/', text)
        wings += re.findall(r'resources\.files\("capsyn\.(\w+)', text)
        for wing in wings:
            first = next(i for i, place in enumerate(PLACES) if place.startswith(f"{wing}."))
            assert PLACES.index(name) >= first, f"{name} reads a file of {wing}"


def test_imports_by_name_are_known():
    texts = {name: path.read_text() for name, path in MODULES.items()}
    dynamic = {name for name, text in texts.items() if "import_module" in text}
    assert dynamic == IMPORT_BY_NAME
    assert not [name for name, text in texts.items() if "__import__" in text]


def test_casadi_stays_at_the_border():
    users = {name for name in MODULES if any(m.split(".")[0] == "casadi" for m in imported(name))}
    assert CASADI <= users
    assert {name for name in users - CASADI if not name.startswith("problems.")} == set()


def test_wings_are_named_in_the_order_of_the_list_for_contributors():
    text = (TOP / "CONTRIBUTING.md").read_text()
    drawn = re.findall(r"^[ \d]{4}(\w+)/ ", text, re.MULTILINE)
    assert drawn == list(dict.fromkeys(place.split(".")[0] for place in PLACES if "." in place))


def folders():
    """Yield the folders of the package and of the tests, with their files."""
    for top in (ROOT, TOP / "tests"):
        for folder in [top, *(path for path in top.rglob("*") if path.is_dir())]:
            if "__pycache__" not in folder.parts:
                yield folder, [path for path in folder.iterdir() if path.is_file()]


def test_no_room_is_crowded():
    crowded = {str(folder): len(files) for folder, files in folders() if len(files) > MAX_FILES}
    assert not crowded
    root = [name for name in PLACES if "." not in name] + ["__init__"]
    assert len(root) <= 8


@pytest.mark.parametrize("name", MODULES)
def test_modules_are_short(name):
    lines = len(MODULES[name].read_text().splitlines())
    assert lines <= MAX_LINES, f"{name} has {lines} lines: split it"


@pytest.mark.parametrize("path", TESTS, ids=lambda path: str(path.relative_to(TOP / "tests")))
def test_test_files_are_short_and_import_no_other(path):
    text = path.read_text()
    lines = len(text.splitlines())
    assert lines <= MAX_TEST_LINES, f"{lines} lines: split it"
    for node in ast.walk(ast.parse(text)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        tests = [name for name in names if re.search(r"(^|\.)test_", name)]
        assert not tests, "what tests share stands in tests/support"


def code_lines(source, node):
    """Return the lines of a function that are neither blank, comment nor docstring."""
    texts = [
        n.body[0]
        for n in ast.walk(node)
        if isinstance(n, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(n) is not None
    ]
    told = {line for text in texts for line in range(text.lineno, text.end_lineno + 1)}
    lines = source.splitlines()
    return sum(
        bool(lines[k - 1].strip()) and not lines[k - 1].strip().startswith("#")
        for k in range(node.lineno, node.end_lineno + 1)
        if k not in told
    )


def functions(name):
    """Yield the functions of a module with their numbers of code lines."""
    source = MODULES[name].read_text()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            yield node, code_lines(source, node)


@pytest.mark.parametrize("name", MODULES)
def test_functions_are_short(name):
    long = {node.name: lines for node, lines in functions(name) if lines > MAX_CODE}
    assert not long


def test_javascript_functions_are_short():
    for path in sorted((ROOT / "explorer" / "page").rglob("*.js")):
        long = {name: n for name, n in javascript.functions(path.read_text()) if n > MAX_CODE}
        assert not long, path.name


PAGE = """
policy dom loop state map series automaton drawing controls panels main
"""
"""Folders of the explorer's page in order: each imports only from those before it."""


def page_imports():
    """Return what each JavaScript module of the explorer's page imports, by their places."""
    page = ROOT / "explorer" / "page"

    def targets(path):
        for text in javascript.imports(path.read_text()):
            both = text.removeprefix("#page/")  # one module, or that of memory in its place
            places = [path.parent / text] if both == text else [page / both, page / "memory" / both]
            yield from (place.resolve() for place in places)

    return {
        path.relative_to(page): [
            target.relative_to(page) for target in targets(path) if target.is_relative_to(page)
        ]
        for path in sorted(page.rglob("*.js"))
    }


def page_place(path):
    """Return the place of a module's folder in the order; those of memory have that of the same."""
    folder = path.parts[1] if path.parts[0] == "memory" else path.parts[0]
    return PAGE.split().index(folder.removesuffix(".js"))


def test_javascript_imports_go_one_way():
    graph = page_imports()
    assert {page_place(path) for path in graph} == set(range(len(PAGE.split())))
    for path, targets in graph.items():
        for target in targets:
            assert target in graph, f"{path} imports {target}"
            assert page_place(target) <= page_place(path), f"{path} imports {target}"


def test_javascript_modules_do_not_import_each_other_in_a_circle():
    graph = page_imports()
    assert sum(map(len, graph.values())) > len(graph)
    while graph:
        free = [path for path, targets in graph.items() if not set(targets) & set(graph)]
        assert free, f"in or above a circle: {sorted(map(str, graph))}"
        graph = {path: targets for path, targets in graph.items() if path not in free}


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
        for node in ast.walk(ast.parse(MODULES["capsyn"].read_text()))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("capsyn.")
        for alias in node.names
    }
    assert checked == {*capsyn.__all__, "__version__"}
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
    for name in ("policies.file", "policies.policy", "simulation.kernel", "problems", "plots"):
        assert loaded_after(f"import capsyn.{name}") >= {"capsyn"}
    assert importlib.import_module("capsyn.policies.file").load
