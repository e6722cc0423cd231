"""sSAC for one state, written down as in the paper, in plain NumPy: slow, readable, independent.

Steps 1 to 3 of Section III-A at t0: predict under the default control, the adjoint backwards, the
mode insertion gradients, the symbol. Derivatives come from CasADi; the discrete adjoint is the
transposed Runge-Kutta step, stage by stage.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from capsyn import Problem


@dataclass(frozen=True)
class System:
    """Functions of a problem at a state and a control, as NumPy arrays."""

    f: ca.Function
    f_x: ca.Function
    running: ca.Function
    running_x: ca.Function
    terminal: ca.Function
    terminal_x: ca.Function

    @staticmethod
    def of(problem: Problem) -> System:
        """Return the functions of a problem."""
        x, u = ca.SX.sym("x", problem.domain.n), ca.SX.sym("u", problem.alphabet.m)
        functions = problem.functions()
        f = functions["dynamics"](x, u)
        running, terminal = (functions[name](x) for name in ("running_cost", "terminal_cost"))
        return System(
            ca.Function("f", [x, u], [f]),
            ca.Function("f_x", [x, u], [ca.jacobian(f, x)]),
            ca.Function("running", [x], [running]),
            ca.Function("running_x", [x], [ca.jacobian(running, x)]),
            ca.Function("terminal", [x], [terminal]),
            ca.Function("terminal_x", [x], [ca.jacobian(terminal, x)]),
        )


def vector(value: ca.DM) -> np.ndarray:
    """Return a CasADi row or column as (n,)."""
    return value.full().ravel()


def stages(system: System, x: np.ndarray, u: np.ndarray, h: float) -> tuple[list, list]:
    """Return the four states and the four rates of a classical Runge-Kutta step."""
    states, rates = [x], [vector(system.f(x, u))]
    for weight in (h / 2, h / 2, h):
        states.append(x + weight * rates[-1])
        rates.append(vector(system.f(states[-1], u)))
    return states, rates


def step(system: System, x: np.ndarray, u: np.ndarray, h: float) -> tuple[np.ndarray, float]:
    """Return the next state and the running cost of the step."""
    states, (k1, k2, k3, k4) = stages(system, x, u, h)
    l1, l2, l3, l4 = (float(system.running(state)) for state in states)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), h / 6 * (l1 + 2 * l2 + 2 * l3 + l4)


def adjoint_step(
    system: System, x: np.ndarray, u: np.ndarray, h: float, rho: np.ndarray
) -> np.ndarray:
    """Return the gradient of ``rho . x_next + cost`` by the step's state `x`."""
    states, _ = stages(system, x, u, h)
    a = [system.f_x(state, u).full() for state in states]
    dl = [vector(system.running_x(state)) for state in states]
    x4 = a[3].T @ (h / 6 * rho) + h / 6 * dl[3]
    x3 = a[2].T @ (h / 3 * rho + h * x4) + h / 3 * dl[2]
    x2 = a[1].T @ (h / 3 * rho + h / 2 * x3) + h / 3 * dl[1]
    x1 = a[0].T @ (h / 6 * rho + h / 2 * x2) + h / 6 * dl[0]
    return rho + x1 + x2 + x3 + x4


@dataclass(frozen=True)
class Result:
    """What sSAC knows of one state at t0."""

    cost: float
    adjoint: np.ndarray
    gradients: np.ndarray
    scales: np.ndarray


def solve(problem: Problem, state: np.ndarray, steps: int, rounding: float) -> Result:
    """Return ``J0``, eq. (3), ``rho(t0)``, eq. (7), and ``dJ/dlambda+`` at t0, eq. (6).

    `rounding` is what may be left, relative to ``J0`` and to the dynamics, where the adjoint or
    the change of dynamics should vanish.
    """
    system, u, h = System.of(problem), problem.default, problem.horizon / steps
    path, cost = [np.asarray(state, dtype=float)], 0.0
    for _ in range(steps):
        x, part = step(system, path[-1], u, h)
        path.append(x)
        cost += part
    cost += float(system.terminal(path[-1]))
    rho = vector(system.terminal_x(path[-1]))
    for x in path[-2::-1]:
        rho = adjoint_step(system, x, u, h, rho)
    rates = [vector(system.f(state, value)) for value in problem.alphabet.values]
    default_rate = vector(system.f(state, u))
    change = np.array(rates) - default_rate
    widths = problem.domain.upper - problem.domain.lower
    sensitivity = np.linalg.norm(widths * rho) + rounding * abs(cost)
    moves = np.linalg.norm(change / widths, axis=1)
    noise = rounding * np.linalg.norm(default_rate / widths)
    return Result(cost, rho, change @ rho, sensitivity * (moves + noise))


def scores(problem: Problem, result: Result) -> np.ndarray:
    """Return what eq. (8), or the steepest rule, minimises over the symbols."""
    settings = problem.settings
    weight = np.asarray(settings.control_weight) * np.ones((1, 1))
    if weight.shape == (1, 1):
        weight = weight[0, 0] * np.eye(problem.alphabet.m)
    efforts = np.array([u @ weight @ u for u in problem.alphabet.values])
    if settings.rule == "steepest":
        return result.gradients + efforts
    wanted = settings.gamma * result.cost if settings.alpha_d is None else settings.alpha_d
    return (result.gradients - wanted) ** 2 + efforts
