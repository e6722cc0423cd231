"""What users' functions give on symbols: CasADi expressions, or one line; programs of them."""

from __future__ import annotations

import contextlib
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.interpolants import without_calls
from capsyn.programs.builder import ProgramBuilder, extended
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Ports, Program
from capsyn.validation import describe, one_line


@contextlib.contextmanager
def _numpy_functions() -> Iterator[None]:
    """Let NumPy ufuncs on CasADi values give CasADi values, without a warning, for a while."""
    options = ca.GlobalOptions
    before = options.getNumpyMode()
    options.setNumpyMode(-1)
    try:
        yield
    finally:
        options.setNumpyMode(before)


_MEANINGS = (
    ("truth value", "a symbol is neither true nor false: use casadi.if_else, fmin and fmax"),
    ("not iterable", "CasADi vectors cannot be unpacked: use x[0], x[1]"),
    ("Out of bounds", "an index is out of range"),
    ("out of bounds", "an index is out of range"),
    ("SX_get", "CasADi vectors are indexed by numbers: use x[0]"),
    (
        "'eval_sx' not defined",
        "it calls a CasADi function that has no symbolic form: make interpolants by "
        "casadi.interpolant, without `inline`",
    ),
)
"""What beginners' mistakes make CasADi and Python say, and what it means."""


def split_reading(z: ca.SX, inputs: Mapping[str, ca.SX], n: int) -> dict[str, ca.SX]:
    """Return the arguments of a user's function by name: x, `inputs` but p, w if any, and p."""
    told = {"w": z[n:]} if z.numel() > n else {}
    own = {name: value for name, value in inputs.items() if name != "p"}
    return {"x": z[:n], **own, **told, **{k: v for k, v in inputs.items() if k == "p"}}


def expression(
    name: str,
    function: Callable[..., Any],
    arguments: Mapping[str, ca.SX],
    size: int | None,
    *,
    rates: bool = False,
    parameters: bool = False,
) -> ca.SX:
    """Return what a user's function gives on symbols, as a dense column of `size` components.

    A `size` of None stands for any but 0.

    The arguments are CasADi columns by name (x, u, w, p), as many as the function takes, in order.
    `rates` says that the components are rates, one for each state; `parameters`, that the function
    may take parameters p that the user names elsewhere. Where it fails, or returns something else,
    a `ProblemError` names it in one line.
    """
    try:
        with _numpy_functions():
            value = function(*arguments.values())
    except Exception as error:  # whatever a user's function raises becomes one line
        reason = one_line(str(error)) or type(error).__name__
        reason = re.sub(r"^(Error in .*? at )?\S+\.[ch]pp:\d+: ", "", reason)  # CasADi's own places
        reason = next((text for words, text in _MEANINGS if words in reason), reason)
        if "positional argument" in reason:
            said = parameters and "p" not in arguments
            reason = f"it must be a function of {' and '.join(arguments)}" + (
                ("" if "w" in arguments else ", and of w where there is `exogenous`")
                + (", and of p where there are `parameters`" if said else "")
            )
        shapes = ", ".join(
            f"{symbol}: {argument.numel()}" for symbol, argument in arguments.items()
        )
        if parameters and "out of range" in reason:
            reason += "; it may take more parameters (`parameters`, --parameter) than are given"
        raise ProblemError(
            f"`{name}` failed on symbols with sizes ({shapes}): {one_line(reason)}"
        ) from error
    wanted = "a scalar" if size == 1 else f"{size or 'one or more'} components"
    wanted = f"{size} component(s), one per state" if rates else wanted
    try:
        with _numpy_functions():
            column = value
            if isinstance(value, (list, tuple, np.ndarray)):
                column = ca.vertcat(*list(value))
            column = ca.SX(column)
    except Exception:  # CasADi raises several types
        raise ProblemError(f"`{name}` must return {wanted}; got {describe(value)}") from None
    size = max(column.shape) if size is None else size
    if column.shape == (1, size):
        column = column.T
    if column.shape != (size, 1) or not size:
        raise ProblemError(f"`{name}` must return {wanted}; got shape {column.shape}")
    return without_calls(name, ca.densify(column), list(arguments.values()))


def casadi_function(name: str, arguments: Sequence[ca.SX], value: ca.SX) -> ca.Function:
    """Return the function of an `expression`; `ProblemError` if it uses other symbols."""
    function = ca.Function(name, list(arguments), [value], {"allow_free": True})
    foreign = function.get_free()
    if foreign:
        raise ProblemError(
            f"`{name}` must use only its arguments; it uses the undeclared symbol '{foreign[0]}'"
        )
    return function


_CASADI_NAMES = {
    getattr(ca, name): name.removeprefix("OP_").lower() for name in dir(ca) if name[:3] == "OP_"
}
_OPERATIONS = {code: name for code, name in _CASADI_NAMES.items() if name in OPERATIONS}
_OPERATIONS |= {ca.OP_CONSTPOW: "pow", ca.OP_IF_ELSE_ZERO: "select"}

_IN_CASADI: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "pow": operator.pow,
    "select": lambda condition, value: ca.if_else(condition, value, 0),
    "not": ca.logic_not,
    "and": ca.logic_and,
    "or": ca.logic_or,
}
"""Operations of programs that CasADi has under other names."""
_REWRITES: dict[int, Callable[[ProgramBuilder, int], int]] = {
    ca.OP_ASSIGN: lambda builder, a: a,
    ca.OP_SQ: lambda builder, a: builder.apply("mul", a, a),
    ca.OP_TWICE: lambda builder, a: builder.apply("add", a, a),
    ca.OP_INV: lambda builder, a: builder.apply("div", builder.constant(1.0), a),
}


def program_from_casadi(name: str, function: ca.Function, inputs: Ports, outputs: Ports) -> Program:
    """Return the program of a CasADi function with dense column inputs and outputs.

    An operation that programs do not have, or a NaN constant, is a `ProblemError`.
    """
    builder = ProgramBuilder()
    slots = [[builder.input() for _ in range(size)] for _, size in inputs]
    results = _instructions("default" if name == "law" else name, function, builder, slots)
    return builder.build(name, inputs, outputs, results)


def _instructions(
    own: str, function: ca.Function, builder: ProgramBuilder, slots: Sequence[Sequence[int]]
) -> list[int]:
    """Return the nonzeros of all outputs of a function, built of those of its inputs.

    `own` is what the user calls it.
    """
    function = function.expand() if not function.is_a("SXFunction") else function
    starts = np.cumsum([0] + [function.nnz_out(i) for i in range(function.n_out())])
    results: list[int] = [-1] * int(starts[-1])
    work: dict[int, int] = {}
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        into = function.instruction_output(k)
        operands = function.instruction_input(k)
        if code == ca.OP_INPUT:
            work[into[0]] = slots[operands[0]][operands[1]]
        elif code == ca.OP_OUTPUT:
            results[starts[into[0]] + into[1]] = work[operands[0]]
        elif code == ca.OP_CONST:
            number = function.instruction_constant(k)
            if np.isnan(number):
                raise ProblemError(
                    f"`{own}` contains the constant NaN; math.sin and float do not work on "
                    "symbols, CasADi's and NumPy's functions do"
                )
            work[into[0]] = builder.constant(number)
        elif code in _REWRITES:
            work[into[0]] = _REWRITES[code](builder, work[operands[0]])
        elif code in _OPERATIONS:
            work[into[0]] = builder.apply(_OPERATIONS[code], *(work[i] for i in operands))
        elif code == ca.OP_CALL:
            called = function.instructions_sx()[k].which_function()
            ends = np.cumsum([0] + [called.nnz_in(i) for i in range(called.n_in())])
            given = [[work[i] for i in operands[a:b]] for a, b in zip(ends, ends[1:])]
            work.update(zip(into, _instructions(own, called, builder, given)))
        else:
            operation = _CASADI_NAMES.get(code, str(code))
            raise ProblemError(f"`{own}` uses the operation '{operation}', which has no C form")
    return results


def casadi_from_program(program: Program) -> ca.Function:
    """Return the CasADi function of a program's first output."""
    symbols = [ca.SX.sym(name, size) for name, size in program.inputs]
    values = [symbol[i] for symbol in symbols for i in range(symbol.numel())]
    for name, *operands in program.instructions:
        if name == "const":
            values.append(ca.SX(operands[0]))
        else:
            operation = _IN_CASADI[name] if name in _IN_CASADI else getattr(ca, name)
            values.append(operation(*(values[k] for k in operands)))
    column = ca.vertcat(*(values[k] for k in program.first.results))
    return ca.Function(program.name, symbols, [ca.densify(column)])


def extended_function(function: ca.Function) -> ca.Function:
    """Return a function of columns whose roots of negative numbers are those of 0; `extended`."""
    inputs = tuple((f"i{k}", function.numel_in(k)) for k in range(function.n_in()))
    outputs = (("value", function.numel_out(0)),)
    program = program_from_casadi(function.name(), function, inputs, outputs)
    wider = extended(program)
    return function if wider is program else casadi_from_program(wider)
