"""CasADi to programs: every operation, hybrid dynamics, NumPy ufuncs, vectorised lanes."""

from __future__ import annotations

import subprocess
import warnings

import casadi as ca
import numpy as np
import pytest

from capsyn import Box, Problem, problems
from capsyn.controllers.solver import bind_default, make_solver
from capsyn.errors import ProblemError
from capsyn.modelling.transcription import (
    candidate_insertion,
    program_from_casadi,
    transcribe,
    user_program,
)
from capsyn.native.compiler import COMMON_FLAGS, find_compiler, usual_flags
from capsyn.native.source import declarations, hand_written
from capsyn.programs.model import Model
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program
from support.lanes import run_lanes

CASADI = {
    "arithmetic": lambda x, y: x + y * x - x / y + 3 * x - (-y),
    "shortcuts": lambda x, y: x**2 + 1 / y + 2 * x * y,
    "less": lambda x, y: ca.if_else(x < y, x, y) + (x <= 0.4) * y,
    "greater": lambda x, y: ca.if_else(x > y, x, y) + (x >= 0.4) * y,
    "equal": lambda x, y: (ca.floor(x) == ca.floor(y)) * x + (ca.floor(x) != 0) * y,
    "logic": lambda x, y: ca.logic_and(x > 0, y < 1) * x + ca.logic_or(x < 0, y < 0) * y,
    "negation": lambda x, y: ca.logic_not(x < y) * y,
    "if_else": lambda x, y: ca.if_else(x * y > 0, ca.sin(x), ca.cos(y)),
    "extremes": lambda x, y: ca.fmin(x, y * y) * ca.fmax(x, y),
    "sign": lambda x, y: ca.sign(x - y) * x + ca.fabs(y),
    "trigonometric": lambda x, y: ca.sin(x) + ca.cos(y) * ca.tan(x * y),
    "inverse trigonometric": lambda x, y: ca.asin(x / 3) + ca.acos(y / 3) + ca.atan(x * y),
    "hyperbolic": lambda x, y: ca.sinh(x) + ca.cosh(y) * ca.tanh(x * y),
    "inverse hyperbolic": lambda x, y: ca.asinh(x) + ca.acosh(3 + y) + ca.atanh(x * y / 9),
    "atan2": lambda x, y: ca.atan2(x, y) + ca.hypot(x, y),
    "exponential": lambda x, y: ca.exp(x) + ca.expm1(y),
    "logarithm": lambda x, y: ca.log(3 + x) + ca.log1p(y * y) + ca.log10(4 + x),
    "powers": lambda x, y: x**3 + (3 + y) ** 0.7 + (3 + x) ** y + ca.sqrt(3 + y) + 2.0**x,
    "erf": lambda x, y: ca.erf(x) * y,
    "rounding": lambda x, y: ca.floor(3 * x) * y + ca.ceil(2 * y) * x,
    "fmod": lambda x, y: ca.fmod(3 * x, y),
    "remainder": lambda x, y: ca.remainder(3 * x, y),
    "copysign": lambda x, y: ca.copysign(x, y) * y,
}


def as_program(y: ca.SX, x: ca.SX) -> tuple[Program, ca.Function]:
    """Return a scalar expression, its gradient and Hessian as a program and as CasADi has them."""
    hessian, gradient = ca.hessian(y, x)
    rows = ca.densify(ca.vertcat(y, gradient, ca.densify(hessian)[:]))
    function = ca.Function("f", [x], [rows])
    return program_from_casadi("f", function, (("x", 2),), (("y", 7),)), function


@pytest.mark.parametrize("case", CASADI)
def test_operations_and_their_derivatives_have_the_value_of_casadi(case):
    x = ca.SX.sym("x", 2)
    program, function = as_program(CASADI[case](x[0], x[1]), x)
    states = np.random.default_rng(0).uniform(-2, 2, (2, 50))
    expected = function(states).full()
    assert np.isfinite(expected).all() and np.ptp(expected[0]) > 0.1
    np.testing.assert_allclose(program.evaluate(states)[0], expected, rtol=1e-12, atol=1e-12)


def test_together_the_cases_use_every_operation():
    x = ca.SX.sym("x", 2)
    used = {
        name
        for case in CASADI.values()
        for name, *_ in as_program(case(x[0], x[1]), x)[0].instructions
    }
    assert used == {*OPERATIONS, "const"}


@pytest.mark.parametrize(
    "operation, function", [("erfinv", ca.erfinv), ("printme", lambda a: a.printme(1))]
)
def test_an_operation_without_a_c_form_is_named(operation, function):
    problem = small_problem(lambda x, u: [function(x[0] / 9), u[0]])
    with pytest.raises(ProblemError, match=f"`dynamics` uses the operation '{operation}'"):
        transcribe(problem)


def test_a_nan_constant_is_refused():
    with pytest.raises(ProblemError, match="`dynamics` contains the constant NaN"):
        transcribe(small_problem(lambda x, u: [x[1] * np.nan, u[0]]))


def small_problem(dynamics, **changes) -> Problem:
    """Return a problem of two states and one input."""
    options = {
        "name": "small",
        "dynamics": dynamics,
        "domain": Box([-2, -2], [2, 2]),
        "alphabet": [-1.0, 1.0],
        "default": 0.0,
        "horizon": 0.5,
        "terminal_cost": lambda x: x[0] ** 2 + x[1] ** 2,
    }
    return Problem(**options | changes)


def numpy_dynamics(x, u):
    a, b = x[0], x[1]
    waves = np.sin(a) + np.cos(b) + np.tan(a / 9) + np.arctan2(a, 3 + b) + np.arctan(a)
    growth = np.exp(-a) + np.log(3 + b) + np.sqrt(3 + a) + np.power(3 + a, 2) + np.tanh(b)
    bends = np.abs(a) + np.fabs(b) + np.sign(a) + np.fmin(a, b) + np.fmax(a, b) + np.floor(a)
    return np.array([waves + growth + np.square(b) - a, bends + np.hypot(a, b) + u[0]])


def casadi_dynamics(x, u):
    a, b = x[0], x[1]
    waves = ca.sin(a) + ca.cos(b) + ca.tan(a / 9) + ca.atan2(a, 3 + b) + ca.atan(a)
    growth = ca.exp(-a) + ca.log(3 + b) + ca.sqrt(3 + a) + (3 + a) ** 2 + ca.tanh(b)
    bends = ca.fabs(a) + ca.fabs(b) + ca.sign(a) + ca.fmin(a, b) + ca.fmax(a, b) + ca.floor(a)
    return ca.vertcat(waves + growth + b**2 - a, bends + ca.hypot(a, b) + u[0])


def test_numpy_functions_work_on_states_without_a_warning(capfd):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = transcribe(small_problem(numpy_dynamics))
    assert capfd.readouterr() == ("", "")
    states = np.random.default_rng(0).uniform(-2, 2, (2, 20))
    expected = transcribe(small_problem(casadi_dynamics)).dynamics.evaluate(states, [1.0])
    np.testing.assert_allclose(model.dynamics.evaluate(states, [1.0]), expected, rtol=1e-14)


@pytest.mark.skipif(not hasattr(ca.GlobalOptions, "getNumpyMode"), reason="CasADi before 3.8")
def test_the_numpy_mode_is_restored_even_after_an_error():
    before = ca.GlobalOptions.getNumpyMode()
    try:
        ca.GlobalOptions.setNumpyMode(1)
        with pytest.raises(ProblemError, match="no such thing"):
            small_problem(lambda x, u: (_ for _ in ()).throw(RuntimeError("no such thing")))
        assert ca.GlobalOptions.getNumpyMode() == 1
    finally:
        ca.GlobalOptions.setNumpyMode(before)


def falling(x, u):
    """Return dynamics with a square root whose argument is negative in the other branch."""
    return [ca.if_else(x[0] > 0, -ca.sqrt(x[0]), -x[0]) + 0.1 * u[0], ca.sin(x[0]) - x[1] * u[0]]


REGIONS = {
    "above": (lambda x, u: [-ca.sqrt(x[0]) + 0.1 * u[0], ca.sin(x[0]) - x[1] * u[0]], (1.0, 2.0)),
    "below": (lambda x, u: [-x[0] + 0.1 * u[0], ca.sin(x[0]) - x[1] * u[0]], (-2.0, -1.0)),
}


@pytest.mark.parametrize("backend", ["numpy", "c"])
@pytest.mark.parametrize("region", REGIONS)
def test_a_root_in_the_branch_not_taken_leaves_no_nan(region, backend):
    smooth_dynamics, (low, high) = REGIONS[region]
    rng = np.random.default_rng(0)
    states = np.column_stack([rng.uniform(low, high, 100), rng.uniform(-2, 2, 100)])
    cost = {"running_cost": lambda x: ca.if_else(x[0] > 0, ca.sqrt(x[0]), x[0] ** 2) + x[1] ** 2}
    smooth = {"running_cost": lambda x: (ca.sqrt(x[0]) if low > 0 else x[0] ** 2) + x[1] ** 2}
    model = transcribe(small_problem(falling, **cost))
    reference = transcribe(small_problem(smooth_dynamics, **smooth))
    inputs = {"x": states.T, "u": np.full((1, 100), 0.3), "dt": np.full((1, 100), 0.05)}
    inputs["rho_next"] = rng.normal(size=(2, 100))
    for name in ("dynamics", "step", "adjoint", "running_cost"):
        program, smooth_program = getattr(model, name), getattr(reference, name)
        arguments = [inputs[port] for port, _ in program.inputs]
        evaluate = Program.evaluate if backend == "numpy" else run_lanes
        for got, want in zip(evaluate(program, *arguments), smooth_program.evaluate(*arguments)):
            np.testing.assert_allclose(got, want, rtol=1e-12, atol=1e-14, err_msg=name)
    solutions = []
    for m in (model, reference):
        solver, used = make_solver(bind_default(m, np.array([0.3])), "double", backend)
        assert used == backend
        solutions.append(solver(states, 0.5, 10))
    for got, want in zip(*solutions):
        assert np.isfinite(want).all()
        np.testing.assert_allclose(got, want, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("backend", ["numpy", "c"])
def test_a_root_is_finite_on_the_switch_itself_and_across_it(backend):
    model = bind_default(transcribe(small_problem(falling)), np.array([-1.0]))
    solver, _ = make_solver(model, "double", backend)
    states = np.column_stack([np.linspace(-0.02, 0.1, 61), np.ones(61)])
    states[10, 0] = 0.0
    for values in solver(states, 0.5, 20):
        assert np.isfinite(values).all()


def kernel_source(model: Model) -> str:
    """Return the C source of a model whose control is bound, as `SsacKernel.build` makes it."""
    names = ("step", "adjoint", "terminal_cost", "insertion")
    programs = [getattr(model, name) for name in names]
    lanes = [p.to_c(name, uniform=["dt", "rounding"]) for name, p in zip(names, programs)]
    sizes = f"#define STATES {model.step.outputs[0][1]}\n"
    sizes += f"#define SYMBOLS {model.insertion.outputs[0][1]}\n#define FIRST 0\n"
    return (
        declarations(programs, "double", 64)
        + sizes
        + "".join(lanes)
        + hand_written("controllers/ssac.c")
    )


def scalar_loops(source: str, directory) -> list[str]:
    """Return the lines of C loops over lanes that GCC does not report as vectorised."""
    if (
        "Free Software Foundation"
        not in subprocess.run(
            [*find_compiler().command, "--version"], capture_output=True, text=True
        ).stdout
    ):
        pytest.skip("only GCC reports which loops it has vectorised")
    (directory / "kernel.c").write_text(source)
    command = [
        *find_compiler().command,
        *usual_flags(find_compiler()),
        *COMMON_FLAGS,
        "-ffp-contract=fast",
    ]
    run = subprocess.run(
        [*command, "-fopt-info-vec", "-o", "kernel.so", "kernel.c", "-lm"],
        cwd=directory,
        capture_output=True,
        text=True,
        check=True,
    )
    notes = [note for note in run.stderr.splitlines() if "loop vectorized" in note]
    vectorised = {int(note.split(":")[1]) for note in notes}
    lines = source.splitlines()
    loops = [k for k, line in enumerate(lines, 1) if line.strip().startswith("EACH_LANE")]
    ends = [next(k for k in range(start, len(lines)) if "}" in lines[k]) for start in loops]
    assert loops
    return [
        "\n".join(lines[start - 3 : start + 3])
        for start, end in zip(loops, ends)
        if not vectorised.intersection(range(start, end + 1))
    ]


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-b", "switched and rare"])
def test_the_loops_over_lanes_of_a_kernel_stay_vectorised(name, tmp_path):
    def rare(x, u):
        fast = ca.erf(x[0]) + ca.fmod(x[1], 0.7) + ca.atan2(x[0], x[1]) + ca.sign(x[0])
        slow = ca.remainder(x[0], 0.7) + ca.floor(x[1]) + ca.expm1(x[0]) + x[1] ** 3.3
        return [ca.if_else(x[0] > x[1], fast, slow), ca.fmin(x[0], ca.copysign(x[1], u[0]))]

    problem = problems.plain(name) if name in problems.names() else small_problem(rare)
    default = np.full(problem.alphabet.m, 0.4)
    source = kernel_source(bind_default(transcribe(problem), default))
    assert scalar_loops(source, tmp_path) == []


def test_the_lanes_of_every_operation_stay_vectorised(tmp_path):
    ports = (("a", 1), ("b", 1)), (("y", 1),)
    rows = {name: (name, *range(operation.arity)) for name, operation in OPERATIONS.items()}
    programs = {name: Program(name, *ports, (row,), (2,)) for name, row in rows.items()}
    lanes = [program.to_c(f"run_{name}") for name, program in programs.items()]
    source = declarations(programs.values(), "double", 64) + "".join(lanes)
    assert scalar_loops(source.replace("static void run_", "void run_"), tmp_path) == []


def test_single_precision_lanes_never_compute_in_double(tmp_path):
    rows = tuple((name, *range(operation.arity)) for name, operation in OPERATIONS.items())
    results = tuple(range(2, 2 + len(rows)))
    program = Program("all", (("a", 1), ("b", 1)), (("y", len(rows)),), rows, results)
    source = declarations([program], "single", 64) + program.to_c("run")
    (tmp_path / "run.c").write_text(source.replace("static void run", "void run"))
    command = [*find_compiler().command, "-std=gnu11", "-O1", "-fopenmp-simd", "-c", "run.c"]
    run = subprocess.run(
        [*command, "-Wdouble-promotion", "-Wfloat-conversion", "-Werror", "-Wno-pass-failed"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr


def test_a_users_function_is_a_program_of_its_columns():
    ports = (("x", 2), ("u", 1), ("p", 2)), (("xdot", 2),)
    program = user_program(
        "model", lambda x, u, p: [x[1] * p[0], np.sin(x[0]) + u[0] * p[1]], *ports
    )
    x, u, p = np.random.default_rng(0).normal(size=(3, 2, 9))
    (found,) = program.evaluate(x, u[:1], p)
    np.testing.assert_allclose(found, [x[1] * p[0], np.sin(x[0]) + u[0] * p[1]], rtol=1e-14)
    assert (program.inputs, program.outputs) == ports


def test_a_users_scalar_comes_with_its_gradient_where_it_is_asked_for():
    ports = (("x", 3),), (("value", 1), ("gradient", 3))
    program = user_program("value", lambda x: x[0] ** 2 * ca.cos(x[2]) + x[1], *ports)
    x = np.random.default_rng(0).normal(size=(3, 9))
    value, gradient = program.evaluate(x)
    np.testing.assert_allclose(value[0], x[0] ** 2 * np.cos(x[2]) + x[1])
    wanted = [2 * x[0] * np.cos(x[2]), np.ones(9), -(x[0] ** 2) * np.sin(x[2])]
    np.testing.assert_allclose(gradient, wanted, atol=1e-14)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: [x, x], "`target` must return a scalar; got shape (4, 1)"),
        (lambda x: "far", "`target` must return a scalar; got 'far'"),
        (lambda x: x[7], "`target` failed on symbols with sizes (x: 2): an index is out of range"),
        (lambda x: x[0] if x[0] > 0 else 1, "`target` failed on symbols with sizes (x: 2): a symb"),
        (lambda x: ca.SX.sym("secret"), "`target` must use only its arguments; it uses the unde"),
        (lambda x: x[0] * float("nan"), "`target` contains the constant NaN"),
        (lambda x, u: x[0], "`target` failed on symbols with sizes (x: 2): "),
    ],
)
def test_a_users_function_that_cannot_be_used_is_named(function, message):
    with pytest.raises(ProblemError) as caught:
        user_program("target", function, (("x", 2),), (("inside", 1),))
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


CANDIDATES = {
    "affine": lambda: problems.plain("cart-pendulum"),
    "not affine": lambda: small_problem(
        lambda x, u: [ca.sin(x[1] * u[0]), u[0] ** 2 * x[0]], default=0.3
    ),
    "law, exogenous": lambda: problems.plain("building"),
    "roots": lambda: problems.plain("double-tank-b"),
    "map": lambda: small_problem(
        lambda x, u: [x[0] + 0.1 * x[1], 0.9 * x[1] + u[0] * ca.cos(x[0])],
        discrete=True, sample_time=0.1, horizon=5,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CANDIDATES)
def test_the_insertion_of_one_control_is_that_of_the_models_symbols(case):
    problem = CANDIDATES[case]()
    model, found = transcribe(problem), candidate_insertion(problem)
    law = model.prediction is not None
    program = model.prediction.insertion if law else model.insertion
    size = (("gradients", 1), ("scales", 1))
    assert (found.inputs, found.outputs) == ((*program.inputs, ("v", problem.alphabet.m)), size)
    rng = np.random.default_rng(0)
    states, rho = problem.space.sample(50).T, rng.normal(size=(problem.space.n, 50))
    control = [] if law else [problem.default_control + rng.normal(size=problem.alphabet.m)]
    arguments = [states, *control, rho, rng.random((1, 50)), [1e-9]]
    gradients, scales = program.evaluate(*arguments)
    assert np.isfinite(gradients).all() and (scales > 0).any()
    for symbol, value in enumerate(problem.alphabet.values):
        gradient, scale = found.evaluate(*arguments, value)
        np.testing.assert_allclose(scale[0], scales[symbol], rtol=1e-9, atol=1e-14)
        assert (np.abs(gradient[0] - gradients[symbol]) <= 1e-9 * scale[0] + 1e-14).all()
