"""Programs: evaluation, C lanes, JSON, simplification."""

from __future__ import annotations

import itertools
import json
import math
import warnings

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from capsyn.errors import PolicyFormatError
from capsyn.modelling.transcription import program_from_casadi
from capsyn.programs.builder import ProgramBuilder, bind
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import MAX_INSTRUCTIONS, Program, is_affine
from support.lanes import run_lanes

NAMES = list(OPERATIONS)
SPECIAL = [0.0, 1.0, 0.5, 2.5, 1.5, 3.0, 7.0, 1e-8, 5e-324, 1e6, 1e15 + 0.5, 1e300, np.pi, 710.0]
SPECIAL += [-value for value in SPECIAL] + [np.inf, -np.inf, np.nan]


def every_operation() -> Program:
    """Return a program with one output per operation, applied to its inputs a and b."""
    rows = tuple((name, *range(OPERATIONS[name].arity)) for name in NAMES)
    results = tuple(range(2, 2 + len(rows)))
    return Program("all", (("a", 1), ("b", 1)), (("y", len(rows)),), rows, results)


def operand_pairs() -> tuple[np.ndarray, np.ndarray]:
    """Return operands a, b (1, B): all pairs of special values, then random ones."""
    rng = np.random.default_rng(0)
    special = np.array(list(itertools.product(SPECIAL, SPECIAL))).T
    narrow, wide = rng.uniform(-1, 1, (2, 2000)), rng.normal(size=(2, 2000)) * [[50], [3]]
    a, b = np.concatenate([special, narrow, wide], axis=1)
    return a[None], b[None]


@pytest.mark.parametrize("precision, tolerance", [("double", 1e-12), ("single", 1e-6)])
def test_every_operation_is_the_same_in_numpy_and_in_c(precision, tolerance):
    a, b = operand_pairs()
    if precision == "single":
        a, b = (np.clip(v, -1e38, 1e38) for v in (a, b))
    dtype = np.float32 if precision == "single" else np.float64
    (expected,) = every_operation().evaluate(a, b, dtype=dtype)
    (actual,) = run_lanes(every_operation(), a, b, precision=precision)
    for name, want, got in zip(NAMES, expected, actual):
        with np.errstate(invalid="ignore"):
            error = np.abs(want - got)
        same = (want == got) & (np.signbit(want) == np.signbit(got))
        same |= (error <= tolerance * np.abs(want)) & (want != 0) & (got != 0)
        same |= np.isnan(want) & np.isnan(got)
        if name == "remainder":  # the compiler may contract a - b rint(a / b)
            same |= error <= 8 * np.finfo(dtype).eps * np.abs(a[0])
        assert same.all(), (name, a[0][~same][:5], b[0][~same][:5])


def test_operations_match_the_standard_library():
    a, b = np.random.default_rng(1).uniform(0.05, 0.95, (2, 1, 200)) * [[[1.0]], [[3.0]]]
    (rows,) = every_operation().evaluate(a, b)
    values = dict(zip(NAMES, rows))
    names = "sqrt fabs floor ceil copysign exp expm1 log log1p pow sin cos tan asin acos atan "
    names += "atan2 sinh cosh tanh asinh atanh hypot erf fmod remainder"
    for name in names.split():
        arguments = zip(*(a[0], b[0])[: OPERATIONS[name].arity])
        expected = [getattr(math, name)(*pair) for pair in arguments]
        np.testing.assert_allclose(values[name], expected, rtol=1e-13, atol=1e-15, err_msg=name)
    np.testing.assert_allclose(values["select"], b[0])
    assert np.isnan(values["acosh"]).all()


@pytest.mark.parametrize("backend", ["numpy", "c"])
def test_logic_sign_and_extremes_at_zero_and_nan(backend):
    a = np.array([[0.0, 2.0, -3.0, np.nan, 1.0, np.nan]])
    b = np.array([[0.0, 1.0, -3.0, 4.0, np.nan, np.nan]])
    program = every_operation()
    (rows,) = program.evaluate(a, b) if backend == "numpy" else run_lanes(program, a, b)
    nan, expected = np.nan, {}
    expected |= {"lt": [0, 0, 0, 0, 0, 0], "le": [1, 0, 1, 0, 0, 0]}
    expected |= {"eq": [1, 0, 1, 0, 0, 0], "ne": [0, 1, 0, 1, 1, 1]}
    expected |= {"not": [1, 0, 0, 0, 0, 0], "and": [0, 1, 1, 1, 1, 1], "or": [0, 1, 1, 1, 1, 1]}
    expected |= {"sign": [0, 1, -1, nan, 1, nan], "select": [0, 1, -3, 4, nan, nan]}
    expected |= {"fmin": [0, 1, -3, 4, 1, nan], "fmax": [0, 2, -3, 4, 1, nan]}
    for name, row in expected.items():
        np.testing.assert_array_equal(rows[NAMES.index(name)], row, err_msg=name)


def test_evaluate_broadcasts_keeps_the_dtype_and_never_warns():
    program = every_operation()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (rows,) = program.evaluate([[0.0, -1.0, 1e300]], [2.0], dtype=np.float32)
        (column,) = program.evaluate([-1.0], [2.0])
        assert rows.dtype == np.float32 and rows.shape == (len(NAMES), 3)
        assert column.shape == (len(NAMES),)
        (grid,) = program.evaluate(np.full((1, 4, 1), -1.0), np.full((1, 5), 2.0))
        np.testing.assert_array_equal(grid, np.broadcast_to(column[:, None, None], grid.shape))
        assert program.evaluate(np.empty((1, 0)), [2.0])[0].shape == (len(NAMES), 0)


def test_evaluate_does_not_change_its_inputs_nor_reuse_its_outputs():
    program = Program("p", (("x", 1),), (("y", 2),), (("neg", 0), ("add", 0, 1)), (0, 1))
    x = np.array([[1.0, 2.0]])
    (first,) = program.evaluate(x)
    first += 10
    (second,) = program.evaluate(x)
    np.testing.assert_array_equal(x, [[1, 2]])
    np.testing.assert_array_equal(second, [[1, 2], [-1, -2]])


def test_evaluate_refuses_inputs_of_another_size_or_number():
    program = Program("p", (("x", 2),), (("y", 1),), (("add", 0, 1),), (2,))
    for wrong in (np.zeros((1, 5)), np.zeros((3, 5)), 1.0):
        with pytest.raises(ValueError, match="`x` must have shape"):
            program.evaluate(wrong)
    with pytest.raises(ValueError):
        program.evaluate([1.0, 2.0], [3.0])


def test_json_round_trip_is_equality_down_to_infinities():
    builder = ProgramBuilder()
    x = builder.input()
    rows = [builder.constant(v) for v in (np.inf, -np.inf, 0.1, 5e-324, 3)]
    program = builder.build("p", (("x", 1),), (("y", 6),), [*rows, builder.apply("exp", x)])
    text = json.dumps(program.to_json(), allow_nan=False)
    assert Program.from_json(json.loads(text)) == program
    whole = every_operation()
    assert Program.from_json(json.loads(json.dumps(whole.to_json()))) == whole


MALFORMED = {
    "not a dict": None,
    "a list": [],
    "no results": {"results": None},
    "name is a number": {"name": 3},
    "ports are not pairs": {"inputs": [["x"]]},
    "port name is no identifier": {"inputs": [["x; system()", 2]]},
    "port name is not ASCII": {"inputs": [["\u00e9", 2]]},
    "port name is a number": {"inputs": [[1, 2]]},
    "port size is zero": {"inputs": [["x", 0]]},
    "port size is true": {"outputs": [["y", True]]},
    "port size is a float": {"inputs": [["x", 2.0]]},
    "port size is huge": {"inputs": [["x", 10**9]]},
    "instructions are a dict": {"instructions": {}},
    "an instruction is a number": {"instructions": [5]},
    "an instruction is empty": {"instructions": [[]]},
    "an instruction is null": {"instructions": [None]},
    "unknown operation": {"instructions": [["system", 0]]},
    "an operation that cannot be hashed": {"instructions": [[["add"], 0, 1]]},
    "too few operands": {"instructions": [["add", 0]]},
    "too many operands": {"instructions": [["neg", 0, 1]]},
    "operand is negative": {"instructions": [["neg", -1]]},
    "operand is itself": {"instructions": [["neg", 2]]},
    "operand is a float": {"instructions": [["neg", 0.0]]},
    "operand is true": {"instructions": [["neg", True]]},
    "operand is text": {"instructions": [["neg", "v0"]]},
    "constant is missing": {"instructions": [["const"]]},
    "constant is code": {"instructions": [["const", "1;system()"]]},
    "constant is nan text": {"instructions": [["const", "nan"]]},
    "constant is NaN": {"instructions": [["const", math.nan]]},
    "constant is true": {"instructions": [["const", True]]},
    "constant is null": {"instructions": [["const", None]]},
    "constant is too big for a double": {"instructions": [["const", 10**400]]},
    "constant of two numbers": {"instructions": [["const", 1, 2]]},
    "too few results": {"results": []},
    "too many results": {"results": [0, 1]},
    "result is out of range": {"results": [99]},
    "result is negative": {"results": [-1]},
    "result is a float": {"results": [0.0]},
    "too many instructions": {"instructions": [["const", 0]] * (MAX_INSTRUCTIONS + 1)},
}


@pytest.mark.parametrize("case", MALFORMED)
def test_from_json_refuses_malformed_data(case):
    good = {
        "name": "p",
        "inputs": [["x", 2]],
        "outputs": [["y", 1]],
        "instructions": [["add", 0, 1]],
        "results": [2],
    }
    change = MALFORMED[case]
    assert Program.from_json(good).evaluate([1.0, 2.0])[0] == [3.0]
    with pytest.raises(PolicyFormatError, match="malformed"):
        Program.from_json(good | change if isinstance(change, dict) else change)


@pytest.mark.parametrize("key", ["name", "inputs", "outputs", "instructions", "results"])
def test_from_json_refuses_missing_keys(key):
    data = every_operation().to_json()
    del data[key]
    with pytest.raises(PolicyFormatError):
        Program.from_json(data)


def test_bind_equals_evaluation_with_the_constant():
    x, u, p = ca.SX.sym("x", 2), ca.SX.sym("u", 2), ca.SX.sym("p")
    y = ca.vertcat(ca.sin(x[0] * u[0]) + p, ca.if_else(u[1] > x[1], x[0] / u[1], u[0] ** 2), u[1])
    function = ca.Function("f", [x, u, p], [y, ca.densify(ca.jacobian(y, x))[:]])
    program = program_from_casadi(
        "f", function, (("x", 2), ("u", 2), ("p", 1)), (("y", 3), ("j", 6))
    )
    states = np.random.default_rng(2).normal(size=(2, 50))
    for u_value in ([0.3, -1.2], [0.0, 0.5], [1.0, -1.0]):
        bound = bind(program, u=u_value, p=2.0)
        assert bound.inputs == (("x", 2),) and bound.outputs == program.outputs
        for got, want in zip(bound.evaluate(states), program.evaluate(states, u_value, [2.0])):
            np.testing.assert_allclose(got, want, rtol=1e-15, atol=0)
        names = [name for name, *_ in bound.instructions]
        assert len(names) - names.count("const") < len(program.instructions)
    everything = bind(program, x=[0.1, 0.2], u=[0.3, 0.4], p=0.5)
    assert {name for name, *_ in everything.instructions} == {"const"}


def test_equal_operations_are_shared_and_unused_ones_dropped():
    builder = ProgramBuilder()
    x, y = builder.input(), builder.input()
    a, b = builder.apply("add", x, y), builder.apply("add", y, x)
    assert a == b
    assert builder.apply("sub", x, y) != builder.apply("sub", y, x)
    builder.apply("exp", builder.apply("sin", x))
    product = builder.apply("mul", a, builder.constant(2.0))
    program = builder.build("p", (("x", 2),), (("y", 2),), [product, product])
    assert program.instructions == (("add", 0, 1), ("const", 2.0), ("mul", 2, 3))
    assert program.results == (4, 4)


def test_constants_are_exact_in_c():
    numbers = [0.1, -1 / 3, np.pi, 5e-324, 1.7976931348623157e308, 1e-9, np.inf, -np.inf, -7.0]
    rows = tuple(("const", number) for number in numbers)
    results = tuple(range(1, 1 + len(rows)))
    program = Program("p", (("x", 1),), (("y", len(rows)),), rows, results)
    np.testing.assert_array_equal(run_lanes(program, np.zeros((1, 1)))[0][:, 0], numbers)


def test_neutral_elements_and_constants_are_folded():
    builder = ProgramBuilder()
    x = builder.input()
    zero, one, minus = (builder.constant(v) for v in (0.0, 1.0, -1.0))
    apply = builder.apply
    assert apply("add", x, zero) == apply("sub", x, zero) == apply("mul", one, x) == x
    assert apply("div", x, one) == apply("neg", apply("neg", x)) == x
    assert apply("mul", x, zero) == apply("div", zero, x) == apply("select", zero, x) == zero
    assert apply("mul", minus, x) == apply("sub", zero, x) == apply("neg", x)
    assert apply("select", one, x) == x
    selected = apply("select", apply("lt", x, zero), apply("exp", x))
    assert apply("select", apply("lt", x, zero), selected) == selected
    assert apply("exp", zero) == one == apply("cos", builder.constant(-0.0))


def test_selections_move_outwards_so_that_what_they_hide_stays_hidden():
    builder = ProgramBuilder()
    x, y, z = (builder.input() for _ in range(3))
    apply = builder.apply
    condition = apply("lt", x, y)
    one, two = apply("select", condition, apply("sqrt", y)), apply("select", condition, z)
    root, other = apply("sqrt", y), apply("select", apply("le", x, y), z)
    for name in ("add", "sub"):
        assert apply(name, one, two) == apply("select", condition, apply(name, root, z))
    assert apply("mul", x, one) == apply("select", condition, apply("mul", root, x))
    assert apply("mul", condition, z) == two
    assert apply("div", one, z) == apply("select", condition, apply("div", root, z))
    assert apply("neg", two) == apply("select", condition, apply("neg", z))
    unlike = builder.build("p", (("x", 3),), (("y", 1),), [apply("add", two, other)])
    np.testing.assert_array_equal(
        unlike.evaluate([[1.0, 2, 3], [2, 2, 2], [5, 5, 5]]), [[[10, 5, 0]]]
    )


def shared_root(x):
    root = ca.sqrt(x)
    return ca.if_else(x > 0, root * ca.sin(root) + ca.exp(root), x)


@pytest.mark.parametrize("backend", ["numpy", "c"])
@pytest.mark.parametrize(
    "expression",
    [
        lambda x: ca.if_else(x > 0, ca.sqrt(x), -x),
        lambda x: ca.sqrt(ca.fmax(x, 0)),
        lambda x: ca.if_else(x > 0, ca.if_else(x > 1, ca.log(x - 1), ca.log(x)), x**2),
        lambda x: ca.if_else(x > 0, x * ca.log(x) / (x + x**0.5), 0) ** 2 * x,
        lambda x: (x > 0) * ca.sqrt(x) - (x > 0) * ca.log(x),
        lambda x: ca.exp(-ca.if_else(x > 0, ca.sqrt(x), ca.sin(x))) * x,
        shared_root,
    ],
)
def test_nan_does_not_leak_from_a_branch_that_is_not_taken(expression, backend):
    x = ca.SX.sym("x")
    y = expression(x)
    first = ca.jtimes(y, x, ca.SX(1), True)  # in reverse mode, as adjoints are
    second = ca.jtimes(first, x, ca.SX(1), True)
    function = ca.Function("f", [x], [ca.densify(ca.vertcat(y, first, second))])
    program = program_from_casadi("f", function, (("x", 1),), (("y", 3),))
    states = np.array([[-3.0, -1.0, -0.2, 0.3, 0.7, 1.4, 2.0]])
    (rows,) = program.evaluate(states) if backend == "numpy" else run_lanes(program, states)
    assert np.isfinite(rows).all()
    h = 1e-6 * np.abs(states)
    (after,), (before,) = program.evaluate(states + h), program.evaluate(states - h)
    np.testing.assert_allclose((after - before)[:2] / (2 * h), rows[1:], rtol=1e-5, atol=1e-7)


def arithmetic(leaves: st.SearchStrategy) -> st.SearchStrategy:
    """Return expressions of operations that round alike in CasADi and NumPy."""

    def extend(inner: st.SearchStrategy) -> st.SearchStrategy:
        one = ["sqrt", "fabs", "floor", "ceil", "sign", "neg", "sq", "inv"]
        two = ["plus", "minus", "times", "rdivide", "fmin", "fmax", "fmod", "copysign"]
        two += ["lt", "le", "eq", "ne", "logic_and", "logic_or"]
        return st.one_of(
            st.tuples(st.sampled_from(one), inner),
            st.tuples(st.sampled_from(two), inner, inner),
            st.tuples(st.just("if_else"), inner, inner, inner),
        )

    return st.recursive(leaves, extend, max_leaves=6)


def smooth(leaves: st.SearchStrategy) -> st.SearchStrategy:
    one = "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh exp expm1 log log1p erf"
    two = ["plus", "minus", "times", "rdivide", "power", "atan2", "hypot"]

    def extend(inner: st.SearchStrategy) -> st.SearchStrategy:
        return st.one_of(
            st.tuples(st.sampled_from(one.split()), inner),
            st.tuples(st.sampled_from(two), inner, inner),
        )

    return st.recursive(leaves, extend, max_leaves=4)


LEAVES = st.sampled_from(["x", "y"]) | st.sampled_from([-2.0, -1.0, 0.0, 0.5, 1.0, 3.0])


def build(tree, symbols):
    if not isinstance(tree, tuple):
        return symbols.get(tree, tree) if isinstance(tree, str) else ca.SX(tree)
    name, *operands = tree
    values = [build(operand, symbols) for operand in operands]
    if name in ("rdivide", "inv", "power", "atan2", "copysign"):
        values = [value + 1e-300 for value in values]  # programs do not keep the sign of a zero
    special = {"neg": lambda a: -a, "inv": lambda a: 1 / a, "sq": lambda a: a**2}
    return special.get(name, getattr(ca, name, None))(*values)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(smooth(arithmetic(LEAVES)))
def test_random_expressions_keep_their_casadi_value(tree):
    symbols = {"x": ca.SX.sym("x"), "y": ca.SX.sym("y")}
    expression = build(tree, symbols)
    function = ca.Function("f", [ca.vertcat(*symbols.values())], [ca.densify(expression)])
    points = np.random.default_rng(3).uniform(-2, 2, (2, 24))
    points[:, :4] = np.round(points[:, :4])
    wanted, nudged = (function(p).full()[0] for p in (points, points * (1 + 1e-13)))
    codes = range(function.n_instructions())
    constants = [k for k in codes if function.instruction_id(k) == ca.OP_CONST]
    assume(not any(np.isnan(function.instruction_constant(k)) for k in constants))
    program = program_from_casadi("f", function, (("x", 2),), (("y", 1),))
    (actual,) = program.evaluate(points)
    with np.errstate(invalid="ignore"):
        well_conditioned = np.abs(nudged - wanted) <= 1e-10 * (1 + np.abs(wanted))
    good = np.isfinite(wanted) & well_conditioned
    np.testing.assert_allclose(actual[0][good], wanted[good], rtol=1e-9, atol=1e-9)


AFFINE = {
    "linear": lambda x, u: 3 * u[0] - u[1],
    "times states": lambda x, u: ca.sin(x[0]) * u[0] + x[1] ** 2 * u[1] + ca.exp(x[0]),
    "over states": lambda x, u: (u[0] + x[0]) / (1 + x[1] ** 2),
    "without": lambda x, u: ca.sqrt(x[0]) + x[1],
    "constant": lambda x, u: 2.5,
    "switched by states": lambda x, u: ca.if_else(x[0] > 0, u[0] * x[1], -u[1]),
    "negated": lambda x, u: -(u[0] - x[0]),
}
NOT_AFFINE = {
    "product": lambda x, u: u[0] * u[1],
    "square": lambda x, u: u[0] ** 2,
    "cube less a cube": lambda x, u: u[0] * u[0] * u[0] - x[0],
    "function": lambda x, u: ca.sin(u[0]),
    "denominator": lambda x, u: x[0] / (u[0] + 2),
    "saturated": lambda x, u: ca.fmin(u[0], 1),
    "switched by the input": lambda x, u: ca.if_else(u[0] > 0, x[0], x[1]),
    "size": lambda x, u: ca.fabs(u[0]),
    "exponent": lambda x, u: (1 + x[0] ** 2) ** u[0],
    "product in a branch": lambda x, u: ca.if_else(x[0] > 0, u[0] * u[1], 0),
}


def of_states_and_inputs(expression):
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 2)
    # one affine component beside: every result counts
    column = ca.densify(ca.vertcat(x[0] + u[1], ca.SX(expression(x, u))))
    ports = (("x", 2), ("u", 2)), (("y", 2),)
    return program_from_casadi("f", ca.Function("f", [x, u], [column]), *ports)


@pytest.mark.parametrize("name", [*AFFINE, *NOT_AFFINE])
def test_programs_tell_whether_they_are_affine_in_an_input(name):
    program = of_states_and_inputs((AFFINE | NOT_AFFINE)[name])
    assert is_affine(program, "u") == (name in AFFINE)
    if name in AFFINE:  # and then the second difference vanishes
        rng = np.random.default_rng(0)
        x, u, du = rng.uniform(0.1, 1, (3, 2, 50))
        (a,), (b,), (c,) = (program.evaluate(x, u + k * du) for k in (-1, 0, 1))
        np.testing.assert_allclose(a - 2 * b + c, 0, atol=1e-12)


def test_a_program_is_affine_in_one_input_and_not_in_another():
    program = of_states_and_inputs(lambda x, u: x[0] ** 2 * u[0])
    assert is_affine(program, "u") and not is_affine(program, "x")


def test_a_call_gives_the_results_of_the_other_program():
    inner = of_states_and_inputs(lambda x, u: ca.sin(x[0]) * u[0] + 2.5)
    builder = ProgramBuilder()
    a, b, c = (builder.input() for _ in range(3))
    once = builder.call(inner, [a, b], [c, builder.constant(2.0)])
    twice = builder.call(inner, once, [builder.apply("add", a, b), c])
    program = builder.build("outer", (("z", 3),), (("y", 4),), [*once, *twice])
    z = np.random.default_rng(1).normal(size=(3, 20))
    (found,) = program.evaluate(z)
    (first,) = inner.evaluate(z[:2], np.stack([z[2], np.full(20, 2.0)]))
    (second,) = inner.evaluate(first, np.stack([z[0] + z[1], z[2]]))
    assert np.array_equal(found, np.vstack([first, second]))


def test_a_call_folds_constants_and_shares_what_is_equal():
    inner = of_states_and_inputs(lambda x, u: ca.sin(x[0]) * u[0] + 2.5)
    builder = ProgramBuilder()
    a = builder.input()
    zero, one = builder.constant(0.0), builder.constant(1.0)
    results = builder.call(inner, [a, a], [zero, one])
    assert builder.call(inner, [a, a], [zero, one]) == results
    program = builder.build("outer", (("z", 1),), (("y", 2),), results)
    assert not any(name == "sin" for name, *_ in program.instructions)
    assert program.evaluate(np.array([3.0]))[0].tolist() == [4.0, 2.5]
