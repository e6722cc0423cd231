"""Interpolants of CasADi as programs: values, gradients, bounds, labels; what is refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import capsyn
from capsyn.cells.masks import several
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.ssac import batch_controller
from capsyn.errors import ProblemError
from capsyn.modelling.interpolants import MAX_COEFFICIENTS
from capsyn.modelling.transcription import transcribe, user_program
from capsyn.programs.continuity import jump_conditions
from capsyn.programs.intervals import evaluate_intervals
from capsyn.programs.program import Program

UNEVEN = np.array([-2.0, -1.7, -0.4, 0.0, 0.9, 1.0, 2.5])
EVEN = np.linspace(-1.0, 2.0, 7)
SHORT = np.array([0.0, 0.3, 1.0])


def table(kind: str, grids: list[np.ndarray], outputs: int = 1, **options) -> ca.Function:
    """Return an interpolant of random values."""
    sizes = (outputs, *map(len, grids))
    values = np.random.default_rng(5).normal(size=sizes)
    return ca.interpolant("table", kind, grids, values.ravel(order="F"), options)


TABLES = {
    "linear, uneven": table("linear", [UNEVEN]),
    "linear, two points": table("linear", [np.array([1.0, 3.0])]),
    "linear, looked up by arithmetic": table("linear", [EVEN], lookup_mode=["exact"]),
    "linear, 2-D": table("linear", [UNEVEN, EVEN], lookup_mode=["binary", "linear"]),
    "linear, 3-D, two outputs": table("linear", [SHORT, UNEVEN, SHORT], 2),
    "spline, uneven": table("bspline", [UNEVEN]),
    "spline, quadratic": table("bspline", [EVEN], degree=[2]),
    "spline, 2-D, two outputs": table("bspline", [UNEVEN, EVEN], 2, degree=[3, 2]),
    "spline, 3-D": table("bspline", [UNEVEN, SHORT, EVEN], degree=[2, 1, 3]),
    "spline, smooth": table("bspline", [EVEN], algorithm="smooth_linear"),
}


def value_and_gradient(function: ca.Function, output: int = 0, gradient: bool = True) -> Program:
    n = function.size1_in(0)
    outputs = (("value", 1), ("gradient", n))[: 1 + gradient]
    return user_program("table", lambda x: function(x)[output], (("x", n),), outputs)


def grid_of(function: ca.Function) -> list[np.ndarray]:
    """Return the grid points of each axis of one of `TABLES`."""
    name = next(name for name, known in TABLES.items() if known is function)
    return {
        "linear, uneven": [UNEVEN],
        "linear, two points": [np.array([1.0, 3.0])],
        "linear, 2-D": [UNEVEN, EVEN],
        "linear, 3-D, two outputs": [SHORT, UNEVEN, SHORT],
        "spline, uneven": [UNEVEN],
        "spline, 2-D, two outputs": [UNEVEN, EVEN],
        "spline, 3-D": [UNEVEN, SHORT, EVEN],
    }.get(name, [EVEN])


@pytest.mark.parametrize("name", TABLES)
def test_values_and_gradients_are_those_of_casadi(name):
    function, random = TABLES[name], np.random.default_rng(1)
    grids = grid_of(function)
    low, high = (np.array([grid[k] for grid in grids]) for k in (0, -1))
    points = random.uniform(low - 1, high + 1, (300, len(grids)))
    on_knots = np.stack([random.choice(grid, 60) for grid in grids], axis=1)
    # which cell has a knot is rounded where it is looked up by arithmetic; a spline of degree 1
    # that CasADi evaluates there reads beside its table
    if "arithmetic" not in name and "3-D" not in name:
        points[:60] = on_knots
    slopes = function.jacobian()
    for output in range(function.size1_out(0)):
        value, gradient = value_and_gradient(function, output).evaluate(points.T)
        for k, point in enumerate(points):
            wanted = np.array(function(point)).ravel()[output]
            assert value[0, k] == pytest.approx(wanted, rel=1e-10, abs=1e-10)
            wanted = np.array(slopes(point, 0))[output]
            assert gradient[:, k] == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def test_nothing_that_is_not_taken_leaks():
    for name in ("linear, 2-D", "spline, 2-D, two outputs"):
        far = np.array([[1e300, -1e300, 1e9], [0.0, 1e300, -1e9]])
        value, gradient = value_and_gradient(TABLES[name]).evaluate(far)
        assert np.isfinite(value[:, 2]).all() and np.isfinite(gradient).all()


@pytest.mark.parametrize("name, most", [("linear, uneven", 1.1), ("spline, uneven", 1.5),
                                        ("linear, 2-D", 8.0)])  # fmt: skip
def test_bounds_over_boxes_enclose_and_are_not_far(name, most):
    # of random values; of a smooth surface they are about twice too wide
    function, random = TABLES[name], np.random.default_rng(2)
    program = value_and_gradient(function, gradient=False)
    n = function.size1_in(0)
    for width in (0.01, 0.5):
        low = random.uniform(-0.9, 1.4, (n, 60))
        ((bottom, top),) = evaluate_intervals(program, (low, low + width))
        inside = low[..., None] + width * random.uniform(size=(n, 60, 300))
        values = program.evaluate(inside.reshape(n, -1))[0].reshape(60, 300)
        assert (bottom[0] <= values.min(axis=1)).all() and (values.max(axis=1) <= top[0]).all()
        if width == 0.01:
            assert np.median((top - bottom)[0] / np.ptp(values, axis=1)) < most


def test_an_interpolant_jumps_nowhere_but_a_spline_at_its_ends():
    for name in ("linear, uneven", "linear, 2-D", "linear, looked up by arithmetic"):
        program = jump_conditions(value_and_gradient(TABLES[name], gradient=False))
        assert not program.used_inputs() and len(program.results) == 1
    program = jump_conditions(value_and_gradient(TABLES["spline, uneven"], gradient=False))
    assert program.evaluate(np.array([[-2.1, -2.0, 2.5, 2.6]]))[0].tolist() == [[0, 1, 1, 0]]


def mass(n: int, pull, **changes) -> capsyn.Problem:
    """Return a chain of n integrators that something pulls back."""
    problem = capsyn.Problem(
        name="mass",
        dynamics=lambda x, u: [*(x[i + 1] for i in range(n - 1)), u[0] - pull(x)],
        domain=capsyn.Box([-1.5] * n, [1.9] * n),
        alphabet=[-1, 0, 1],
        default=0.0,
        horizon=1.0,
        running_cost=lambda x: ca.sumsqr(x),
        settings=capsyn.SsacSettings(rule="steepest", steps=4),
        partitions=3,
        max_level=1,
    )
    return problem.replace(**changes)


def hats(x, grid: np.ndarray) -> list:
    """Return the weights of grid points, written out with fmin and fmax; x is within the grid."""
    weights = []
    for k, point in enumerate(grid):
        sides = []
        if k > 0:
            sides.append((x - grid[k - 1]) / (point - grid[k - 1]))
        if k + 1 < len(grid):
            sides.append((grid[k + 1] - x) / (grid[k + 1] - point))
        weight = sides[0] if len(sides) == 1 else ca.fmin(*sides)
        weights.append(ca.fmax(weight, 0))
    return weights


@pytest.mark.parametrize("n", [1, 2, 3])
def test_labels_are_those_of_the_table_written_out(n):
    sizes = [(13,), (7, 5), (5, 4, 3)][n - 1]
    grids = [np.linspace(-3, 3.5, size) for size in sizes]
    values = np.random.default_rng(n).normal(size=[len(grid) for grid in grids])
    function = ca.interpolant("pull", "linear", grids, values.ravel(order="F"))

    def written_out(x, table=values, axis=0):
        if axis == n:
            return float(table)
        parts = (written_out(x, row, axis + 1) for row in table)
        return sum(weight * part for weight, part in zip(hats(x[axis], grids[axis]), parts))

    size = max(n, 2)
    problems = [mass(size, lambda x: function(x[:n])), mass(size, written_out)]
    controllers = [
        batch_controller(Formulation.of(each, transcribe(each)), "numpy") for each in problems
    ]
    states = problems[0].domain.sample(10_000, 3)
    masks = [controller.masks(states) for controller in controllers]
    sure = ~several(masks[0]) & ~several(masks[1])
    assert sure.mean() > 0.99
    one, two = (controller.symbols(states[sure]) for controller in controllers)
    assert (one == two).all() and len(np.unique(one)) > 1


def test_a_policy_of_an_interpolant_is_kept_and_compiled(tmp_path):
    problem = mass(2, lambda x: TABLES["linear, uneven"](x[0]))
    policy = capsyn.synthesize(problem)
    policy.save(tmp_path / "mass.cap")
    again = capsyn.Policy.load(tmp_path / "mass.cap")
    states = problem.domain.sample(200, 0)
    assert (again(states) == policy(states)).all()
    loop = capsyn.simulate(again, [1.0, 0.5], duration=1.0, rate=50)
    assert np.isfinite(loop.states).all()


def test_functions_that_are_called_are_written_out():
    spring = TABLES["linear, uneven"]
    y = ca.MX.sym("y")
    wrapped = ca.Function("wrapped", [y], [2 * spring(y) + ca.sin(y)])
    x = ca.SX.sym("x")
    kept = ca.Function("kept", [x], [ca.cos(x)], {"never_inline": True})
    program = user_program(
        "f", lambda x: wrapped(x) + ca.sum2(spring.map(2)(ca.horzcat(x, -x))) + kept(x),
        (("x", 1),), (("value", 1),),
    )  # fmt: skip
    at = 0.7
    wanted = 3 * float(spring(at)) + np.sin(at) + float(spring(-at)) + np.cos(at)
    assert program.evaluate([[at]])[0][0, 0] == pytest.approx(wanted, rel=1e-12)


def test_what_is_no_number_stays_none():
    for function in (TABLES["linear, uneven"], TABLES["spline, uneven"]):
        through = ca.Function("through", [y := ca.MX.sym("y")], [function(ca.sqrt(y))])
        program = user_program("f", through, (("x", 1),), (("value", 1),))
        value = program.evaluate(np.array([[-1.0, 0.25]]))[0][0]
        assert np.isnan(value[0]) and value[1] == pytest.approx(float(function(0.5)))


def test_functions_of_a_problem_may_be_used_again():
    problem = mass(2, lambda x: TABLES["linear, uneven"](x[0]))
    functions = problem.functions()
    again = problem.replace(dynamics=lambda x, u: functions["dynamics"](x, u))
    assert transcribe(again).adjoint == transcribe(problem).adjoint


class Own(ca.Callback):
    """A function that only Python can evaluate."""

    def __init__(self):
        ca.Callback.__init__(self)
        self.construct("own", {})

    def eval(self, arguments):
        return arguments


def test_what_cannot_be_written_out_is_refused_in_one_line():
    own, x = Own(), ca.SX.sym("x")
    stranger = ca.SX.sym("stranger")
    parametric = ca.interpolant("open", "linear", [EVEN], 1)
    side = int(MAX_COEFFICIENTS**0.5) + 1
    grid = np.linspace(0, 1, side)
    large = ca.interpolant("large", "linear", [grid, grid], np.zeros(side**2))
    slope = ca.Function("slope", [x], [ca.jacobian(TABLES["linear, uneven"](x), x)])
    hidden = ca.interpolant("hidden", "bspline", [EVEN], EVEN, {"inline": True})
    inline = ca.interpolant("inline", "linear", [EVEN], EVEN, {"inline": True})
    for pull, told in [
        (lambda x: own(x[0]), "`dynamics` calls the function 'own' of CasADi's class Callback"),
        (lambda x: parametric(x[0], EVEN), "'open', whose table is an argument"),
        (large, "'large', which has 2,025 coefficients; at most 2,000"),
        (lambda x: slope(x[0]), "'jac_table' of CasADi's class LinearInterpolantJac"),
        (lambda x: hidden(x[0]), "'hidden', whose table CasADi does not tell"),
        (lambda x: inline(x[0]), "without `inline`"),
        (lambda x: TABLES["linear, uneven"](x[0] + stranger), "undeclared symbol 'stranger'"),
    ]:
        with pytest.raises(ProblemError, match=told) as error:
            mass(2, pull)
        assert "\n" not in str(error.value)


def test_a_long_table_is_a_program_of_a_few_operations_a_point():
    grid = np.linspace(-3, 3, 200)
    pull = ca.interpolant("pull", "linear", [grid], np.sin(grid))
    model = transcribe(mass(2, lambda x: pull(x[0])))
    assert len(model.dynamics.instructions) < 8 * len(grid)
    assert len(model.adjoint.instructions) < 40 * len(grid)
