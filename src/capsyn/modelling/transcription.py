"""CasADi to programs: the integration step, its adjoint, costs, mode insertion gradients."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.expressions import (
    casadi_from_program,
    casadi_function,
    expression,
    extended_function,
    program_from_casadi,
    split_reading,
)
from capsyn.modelling.problem import Problem
from capsyn.modelling.targets import INSIDE, Target
from capsyn.programs.model import Model, Prediction, gathered_cost, model_ports
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Ports, Program

_JUMPS = frozenset(
    name
    for name, operation in OPERATIONS.items()
    if operation.boolean
    or name in ("floor", "ceil", "sign", "copysign", "select", "atan2", "fmod", "remainder")
)
"""Operations that may jump: their derivative does not tell how far."""


@dataclass(frozen=True, eq=False)
class ModelSystem:
    """The system of a model as CasADi functions, as tails need it; of a policy, say."""

    model: Model
    domain: Box
    exogenous: Box | None
    alphabet: Alphabet
    target: Target | None

    @property
    def running_cost(self) -> Program | None:
        """The running cost; None where it is 0 everywhere."""
        cost, end = self.model.running_cost, self.model.terminal_cost
        return cost if gathered_cost(cost, end) is cost else None

    def system(self) -> dict[str, ca.Function]:
        """Return ``motion(z, u)`` and ``running_cost(z)``, as those of a problem."""
        motion = casadi_from_program(self.model.dynamics)
        if self.discrete:
            z, u = (ca.SX.sym(name, size) for name, size in self.model.dynamics.inputs)
            motion = ca.Function("dynamics", [z, u], [motion(z, u) - z])
        return {"motion": motion, "running_cost": casadi_from_program(self.model.running_cost)}

    @property
    def discrete(self) -> bool:
        """Whether the dynamics are a map."""
        return self.model.sample_time is not None


def user_program(
    name: str,
    function: Callable[..., Any],
    inputs: Ports,
    outputs: Ports,
    *,
    told: int = 0,
    rates: bool = False,
    parameters: bool = False,
    discrete: bool = False,
) -> Program:
    """Return the program of a user's function, such as another plant's dynamics, or a set.

    The function takes one CasADi column per input and returns as many components as the first
    output has; a second output, if there is one, is the gradient of a scalar value with respect to
    the first input. The last `told` components of the first input, x, are exogenous: the function
    takes them as w, and returns no rates of them, which are 0, or if `discrete` no next ones: they
    stay. `name`, `rates`, `parameters` and errors are those of `expression`.
    """
    symbols = {port: ca.SX.sym(port, size) for port, size in inputs}
    (z, *_), n = symbols.values(), inputs[0][1] - told
    arguments = split_reading(z, {k: v for k, v in symbols.items() if v is not z}, n)
    size = outputs[0][1] - (told if rates else 0)
    value = expression(name, function, arguments, size, rates=rates, parameters=parameters)
    if rates:
        value = ca.vertcat(value, z[n:] if told and discrete else ca.SX.zeros(told))
    casadi_function(name, list(symbols.values()), value)  # no foreign symbols
    results = [ca.densify(value)] + ([_gradient(value, z)] if len(outputs) > 1 else [])
    whole = ca.Function(name, list(symbols.values()), results)
    return program_from_casadi(name, whole, inputs, outputs)


def flow_programs(dynamics: Program) -> tuple[Program, Program | None]:
    """Return programs whose bounds over boxes enclose flows of ``(x, u)`` or ``(x, u, p)`` to xdot.

    The first is ``(x, b, u[, p], t) -> x + t f(b, u, p), f(b, u, p)``: where b bounds all states on
    the way, bounds of the states at the times t and of their rates. The second is the mean-value
    form of second order, ``(x, c, b, u[, p], t) -> c + t f(c) + (I + t J(x)) (x - c) + t^2 / 2 J(b)
    f(b)`` with the Jacobian J of f and a point c of x: of the ends at t, tighter. It is None where
    f may jump, or bend where its derivative does not say so.
    """
    sizes = dict(dynamics.inputs)
    x, c, b = (ca.SX.sym(name, sizes["x"]) for name in "xcb")
    others = [ca.SX.sym(name, size) for name, size in dynamics.inputs[1:]]
    f, t = casadi_from_program(dynamics), ca.SX.sym("t")
    ports: Ports = (*((name, sizes["x"]) for name in "xcb"), *dynamics.inputs[1:], ("t", 1))
    outputs: Ports = (("end", sizes["x"]),)
    there, rates = ca.densify(x + t * f(b, *others)), ca.densify(f(b, *others))
    motion = ca.Function("motion", [x, b, *others, t], [there, rates])
    both: Ports = (*outputs, ("rates", sizes["x"]))
    first = program_from_casadi("motion", motion, (ports[0], *ports[2:]), both)
    if any(name in _JUMPS for name, *_ in dynamics.instructions):
        return first, None
    jacobian = ca.Function("jacobian", [x, *others], [ca.jacobian(f(x, *others), x)])
    bend = ca.jtimes(f(b, *others), b, f(b, *others))
    slope = ca.SX.eye(sizes["x"]) + t * jacobian(x, *others)
    end = c + t * f(c, *others) + ca.mtimes(slope, x - c) + t**2 / 2 * bend
    whole = ca.Function("end", [x, c, b, *others, t], [ca.densify(end)])
    return first, program_from_casadi("end", whole, ports, outputs)


def slopes_program(dynamics: Program) -> Program:
    """Return the Jacobian of rates ``(x, u) -> xdot``, or ``(x, u, p)``, in x, row by row."""
    inputs = [ca.SX.sym(name, size) for name, size in dynamics.inputs]
    rates = casadi_from_program(dynamics)(*inputs)
    slopes = ca.densify(ca.vec(ca.jacobian(rates, inputs[0]).T))
    function = ca.Function("slopes", inputs, [slopes])
    return program_from_casadi("slopes", function, dynamics.inputs, (("slopes", slopes.numel()),))


def terminal_program(function: Callable[..., Any], n: int, told: int) -> Program:
    """Return the program of a terminal cost of n states and so many exogenous inputs.

    It is one of a `Model`: ``z -> (cost, gradient)``, the gradient 0 along exogenous inputs.
    """
    z = ca.SX.sym("z", n + told)
    value = expression("tail", function, split_reading(z, {}, n), 1)
    name, ports = "terminal_cost", model_ports(n + told, 1, 1)
    whole = ca.Function(name, [z], [value, _gradient(value, z, n)])
    return program_from_casadi(name, whole, *ports[name])


def feature_program(
    features: Mapping[str, Callable[..., Any]], domain: Box, counts: Sequence[int], told: int = 0
) -> Program:
    """Return the program of features at the centres of lattice steps.

    It takes steps (n,) of a lattice of `counts` (n,) in the domain, whose last `told` axes are
    exogenous, and gives the values of all features (K,), each a function of x, or of x and w, by
    its name. Errors are those of `expression`.
    """
    z, reading = ca.SX.sym("z", domain.n), ca.SX.sym("reading", domain.n)
    centre = domain.lower + (z + 0.5) * (domain.widths / np.array(counts))
    arguments, values = split_reading(reading, {}, domain.n - told), list[ca.SX]()
    for name, function in features.items():
        value = expression(f"features[{name!r}]", function, arguments, 1)
        value = ca.substitute(value, reading, centre)
        foreign = ca.Function("feature", [z], [value], {"allow_free": True}).get_free()
        if foreign:
            raise ProblemError(
                f"`features[{name!r}]` must use only its arguments; it uses the undeclared symbol "
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
    t0 is the gradient of the discretised cost; that of exogenous inputs, whose rate is 0, stays 0
    and takes no work. Under a default law the prediction has programs of its own, with the total
    derivative of ``f(x, default(x, w), w)``. Of a discrete-time problem a step is its map.
    """
    functions, m, symbols = problem.functions(), problem.alphabet.m, len(problem.alphabet)
    controls = [ca.DM(value) for value in problem.alphabet.values]
    arguments, values = _programs(problem, functions, ca.SX.sym("u", m), controls)
    ports = model_ports(problem.space.n, m, symbols)
    programs = _transcribed(arguments, values, ports)
    prediction = None
    if problem.has_law:
        arguments, values = _programs(problem, functions, None, controls)
        own = Prediction.ports(problem.space.n, m, symbols)
        prediction = Prediction(**_transcribed(arguments, values, own))
    limits = None
    if "limits" in functions:
        size = (("limits", functions["limits"].numel_out(0)),)
        limits = program_from_casadi("limits", functions["limits"], (("x", problem.space.n),), size)
    time = problem.sample_time if problem.discrete else None
    return Model(**programs, prediction=prediction, limits=limits, sample_time=time)


def candidate_insertion(problem: Problem) -> Program:
    """Return the insertion of `transcribe` for one control `v` (m,) that is an input, the last.

    It is ``(x, u, rho, cost, rounding, v) -> (gradient, scale)``; under a default law, which it
    then follows, without `u`. Of exogenous inputs x is the reading, as in `Model`.
    """
    m, law = problem.alphabet.m, problem.has_law
    v = ca.SX.sym("v", m)
    u = None if law else ca.SX.sym("u", m)
    arguments, values = _programs(problem, problem.functions(), u, [v])
    inputs, outputs = (Prediction.ports if law else model_ports)(problem.space.n, m, 1)["insertion"]
    own = {"insertion": ((*inputs, ("v", m)), outputs)}
    return _transcribed({"insertion": [*arguments["insertion"], v]}, values, own)["insertion"]


def _transcribed(
    arguments: dict[str, Sequence[ca.SX]],
    values: dict[str, Sequence[ca.SX]],
    ports: dict[str, tuple[Any, Any]],
) -> dict[str, Program]:
    """Return the programs of those ports, by name."""
    return {
        name: program_from_casadi(
            name,
            ca.Function(name, arguments[name], list(map(ca.densify, values[name]))),
            *ports[name],
        )
        for name in ports
    }


def _programs(
    problem: Problem,
    functions: dict[str, ca.Function],
    u: ca.SX | None,
    controls: Sequence[ca.SX | ca.DM],
) -> tuple[dict[str, Sequence[ca.SX]], dict[str, Sequence[ca.SX]]]:
    """Return arguments and values of the programs of a model, under u or, of None, the law.

    The insertion is that of `controls`.
    """
    n, size = problem.domain.n, problem.space.n
    z, dt, whole = ca.SX.sym("z", size), ca.SX.sym("dt"), ca.SX.sym("rho", size)
    rho = ca.vertcat(whole[:n], ca.SX.zeros(size - n))
    total, rounding = ca.SX.sym("cost"), ca.SX.sym("rounding")
    given, running = functions["dynamics"], functions["running_cost"]
    if u is None:
        law, inputs = functions["default"], []
        dynamics = ca.Function("law", [z], [given(z, law(z))])
    else:
        law, inputs, dynamics = None, [u], given
    moved, gathered = dynamics, running
    if problem.discrete:  # the map itself: between samples there is nothing to keep in range
        end, cost = moved(z, *inputs), gathered(z)
    else:
        moved, gathered = extended_function(dynamics), extended_function(running)
        end, cost = runge_kutta_step(moved, gathered, z, inputs, dt)
    terminal, rates = functions["terminal_cost"](z), dynamics(z, *inputs)
    change = [given(z, control) - rates for control in controls]
    widths = ca.DM(problem.space.widths)
    sensitivity = ca.norm_2(widths * rho) + rounding * ca.fabs(total)
    noise = rounding * ca.norm_2(rates / widths)
    sizes = [sensitivity * (ca.norm_2(df / widths) + noise) for df in change]
    if gathered is not running:  # not finite where the cost itself is not, else the same
        sizes = [size * (1 + 1e-300 * running(z)) for size in sizes]
    arguments: dict[str, Sequence[ca.SX]] = {
        "law": [z],
        "dynamics": [z, *inputs],
        "step": [z, *inputs, dt],
        "adjoint": [z, *inputs, dt, whole],
        "running_cost": [z],
        "terminal_cost": [z],
        "insertion": [z, *inputs, whole, total, rounding],
    }
    values: dict[str, Sequence[ca.SX]] = {
        "law": [] if law is None else [law(z)],
        "dynamics": [rates],
        "step": [end, cost],
        "adjoint": [_gradient(ca.dot(rho, end) + cost, z, n)],
        "running_cost": [running(z)],
        "terminal_cost": [terminal, _gradient(terminal, z, n)],
        "insertion": [ca.vertcat(*(ca.dot(rho, df) for df in change)), ca.vertcat(*sizes)],
    }
    return arguments, values


def transcribe_target(problem: Problem) -> Target | None:
    """Return the target of a problem; a function of the state becomes a program."""
    target = problem.target
    if target is None or isinstance(target, (Ball, Box)):
        return target
    return target_condition(target, problem.domain.n, problem.space.n - problem.domain.n)


def target_condition(
    function: Callable[..., Any], n: int, told: int = 0, name: str = "target"
) -> Program:
    """Return the program of a set, the argument `name`, that a function of `n` states decides.

    Its x are states and, after them, `told` exogenous inputs, which the function takes as w. A
    function that fails, or returns no condition, is a `ProblemError`.
    """
    program = user_program(name, function, (("x", n + told),), INSIDE, told=told)
    result = program.results[0] - program.input_count
    last = program.instructions[result][0] if result >= 0 else ""
    if last not in OPERATIONS or not OPERATIONS[last].boolean:
        raise ProblemError(f"`{name}` must return a condition on the state, such as x[0] < 0.1")
    return program


def runge_kutta_step(
    dynamics: ca.Function, running_cost: ca.Function, x: ca.SX, inputs: Sequence[ca.SX], dt: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return the state after one classical Runge-Kutta step, and the running cost it gathers.

    The rates are ``dynamics(x, *inputs)``.
    """
    half = dt / 2
    x1 = x
    k1 = dynamics(x1, *inputs)
    x2 = x + half * k1
    k2 = dynamics(x2, *inputs)
    x3 = x + half * k2
    k3 = dynamics(x3, *inputs)
    x4 = x + dt * k3
    k4 = dynamics(x4, *inputs)
    costs = [running_cost(point) for point in (x1, x2, x3, x4)]
    weight = dt / 6
    end = x + weight * (k1 + 2 * k2 + 2 * k3 + k4)
    return end, weight * (costs[0] + 2 * costs[1] + 2 * costs[2] + costs[3])


def _gradient(scalar: ca.SX, x: ca.SX, n: int | None = None) -> ca.SX:
    """Return the gradient of a scalar, 0 but for the first n components of x where n is given."""
    gradient = ca.densify(ca.gradient(scalar, x))
    if n is None or n == x.numel():
        return gradient
    return ca.densify(ca.vertcat(gradient[:n], ca.SX.zeros(x.numel() - n)))
