"""CasADi to programs: the integration step, its adjoint, costs, mode insertion gradients."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.problem import Problem, casadi_function, expression
from capsyn.modelling.targets import INSIDE, Target
from capsyn.programs.builder import ProgramBuilder
from capsyn.programs.model import Model, model_ports
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Ports, Program

_CASADI_NAMES = {
    getattr(ca, name): name.removeprefix("OP_").lower() for name in dir(ca) if name[:3] == "OP_"
}
_OPERATIONS = {code: name for code, name in _CASADI_NAMES.items() if name in OPERATIONS}
_OPERATIONS |= {ca.OP_CONSTPOW: "pow", ca.OP_IF_ELSE_ZERO: "select"}

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
    function = function.expand() if not function.is_a("SXFunction") else function
    builder = ProgramBuilder()
    slots = [[builder.input() for _ in range(size)] for _, size in inputs]
    starts = np.cumsum([0] + [size for _, size in outputs])
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
                    f"`{name}` contains the constant NaN; math.sin and float do not work on "
                    "symbols, CasADi's and NumPy's functions do"
                )
            work[into[0]] = builder.constant(number)
        elif code in _REWRITES:
            work[into[0]] = _REWRITES[code](builder, work[operands[0]])
        elif code in _OPERATIONS:
            work[into[0]] = builder.apply(_OPERATIONS[code], *(work[i] for i in operands))
        else:
            operation = _CASADI_NAMES.get(code, str(code))
            raise ProblemError(f"`{name}` uses the operation '{operation}', which has no C form")
    return builder.build(name, inputs, outputs, results)


def user_program(
    name: str,
    function: Callable[..., Any],
    inputs: Ports,
    outputs: Ports,
    *,
    rates: bool = False,
    parameters: bool = False,
) -> Program:
    """Return the program of a user's function, such as another plant's dynamics, or a set.

    The function takes one CasADi column per input and returns as many components as the first
    output has; a second output, if there is one, is the gradient of a scalar value with respect to
    the first input. `name`, `rates`, `parameters` and errors are those of `expression`.
    """
    arguments = [ca.SX.sym(port, size) for port, size in inputs]
    value = expression(name, function, arguments, outputs[0][1], rates=rates, parameters=parameters)
    casadi_function(name, arguments, value)  # no foreign symbols
    results = [value] + ([_gradient(value, arguments[0])] if len(outputs) > 1 else [])
    return program_from_casadi(name, ca.Function(name, arguments, results), inputs, outputs)


def feature_program(
    features: Mapping[str, Callable[[Any], Any]], domain: Box, counts: Sequence[int]
) -> Program:
    """Return the program of features at the centres of lattice steps.

    It takes steps (n,) of a lattice of `counts` (n,) in the domain and gives the values of all
    features (K,), each a function of the state by its name. Errors are those of `expression`.
    """
    z = ca.SX.sym("z", domain.n)
    x = domain.lower + (z + 0.5) * (domain.widths / np.array(counts))
    values = []
    for name, function in features.items():
        value = expression(f"features[{name!r}]", function, [x], 1)
        foreign = ca.Function("feature", [z], [value], {"allow_free": True}).get_free()
        if foreign:
            raise ProblemError(
                f"`features[{name!r}]` must use only its argument; it uses the undeclared symbol "
                f"'{foreign[0]}'"
            )
        values.append(value)
    ports = (("z", domain.n),), (("features", len(values)),)
    column = ca.densify(ca.vertcat(*values))
    return program_from_casadi("features", ca.Function("features", [z], [column]), *ports)


def transcribe(problem: Problem) -> Model:
    """Return the model of a problem as programs; `ProblemError` where they lack an operation.

    The step is the classical fourth-order Runge-Kutta method; the running cost is integrated along
    with the state. The adjoint is the reverse derivative of that very step, so that the adjoint at
    t0 is the gradient of the discretised cost.
    """
    functions = problem.functions()
    n, m = problem.domain.n, problem.alphabet.m
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", m)
    dt, rho = ca.SX.sym("dt"), ca.SX.sym("rho", n)
    total, rounding = ca.SX.sym("cost"), ca.SX.sym("rounding")
    dynamics, running = functions["dynamics"], functions["running_cost"]
    end, cost = runge_kutta_step(dynamics, running, x, u, dt)
    terminal = functions["terminal_cost"](x)
    change = [dynamics(x, ca.DM(value)) - dynamics(x, u) for value in problem.alphabet.values]
    widths = ca.DM(problem.domain.widths)
    sensitivity = ca.norm_2(widths * rho) + rounding * ca.fabs(total)
    noise = rounding * ca.norm_2(dynamics(x, u) / widths)
    sizes = [sensitivity * (ca.norm_2(df / widths) + noise) for df in change]
    arguments: dict[str, Sequence[ca.SX]] = {
        "dynamics": [x, u],
        "step": [x, u, dt],
        "adjoint": [x, u, dt, rho],
        "running_cost": [x],
        "terminal_cost": [x],
        "insertion": [x, u, rho, total, rounding],
    }
    values: dict[str, Sequence[ca.SX]] = {
        "dynamics": [dynamics(x, u)],
        "step": [end, cost],
        "adjoint": [_gradient(ca.dot(rho, end) + cost, x)],
        "running_cost": [running(x)],
        "terminal_cost": [terminal, _gradient(terminal, x)],
        "insertion": [ca.vertcat(*(ca.dot(rho, df) for df in change)), ca.vertcat(*sizes)],
    }
    ports = model_ports(n, m, len(problem.alphabet))
    programs = {
        name: program_from_casadi(
            name,
            ca.Function(name, arguments[name], list(map(ca.densify, values[name]))),
            *ports[name],
        )
        for name in ports
    }
    return Model(**programs)


def transcribe_target(problem: Problem) -> Target | None:
    """Return the target of a problem; a function of the state becomes a program."""
    target = problem.target
    if target is None or isinstance(target, (Ball, Box)):
        return target
    return target_condition(target, problem.domain.n)


def target_condition(function: Callable[[Any], Any], n: int) -> Program:
    """Return the program of a target that a user's function of `n` states decides.

    A function that fails, or returns no condition, is a `ProblemError`.
    """
    program = user_program("target", function, (("x", n),), INSIDE)
    result = program.results[0] - program.input_count
    name = program.instructions[result][0] if result >= 0 else ""
    if name not in OPERATIONS or not OPERATIONS[name].boolean:
        raise ProblemError("`target` must return a condition on the state, such as x[0] < 0.1")
    return program


def runge_kutta_step(
    dynamics: ca.Function, running_cost: ca.Function, x: ca.SX, u: ca.SX, dt: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return the state after one classical Runge-Kutta step, and the running cost it gathers."""
    half = dt / 2
    x1 = x
    k1 = dynamics(x1, u)
    x2 = x + half * k1
    k2 = dynamics(x2, u)
    x3 = x + half * k2
    k3 = dynamics(x3, u)
    x4 = x + dt * k3
    k4 = dynamics(x4, u)
    costs = [running_cost(point) for point in (x1, x2, x3, x4)]
    weight = dt / 6
    end = x + weight * (k1 + 2 * k2 + 2 * k3 + k4)
    return end, weight * (costs[0] + 2 * costs[1] + 2 * costs[2] + costs[3])


def _gradient(scalar: ca.SX, x: ca.SX) -> ca.SX:
    return ca.densify(ca.gradient(scalar, x))
