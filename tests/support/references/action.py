"""One whole action of sSAC or SAC for one state, in plain Python: slow, readable, independent.

Steps 1 to 5 of Section III-A of the paper, with the prediction, the adjoint and the derivatives of
`reference`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from capsyn import Problem, SsacSettings
from support.references import ssac as reference

Signal = Callable[[float, np.ndarray], np.ndarray]
"""Default control ``(now or the middle of a step, predicted state) -> u``."""


@dataclass(frozen=True)
class Action:
    """What happens, when, and what it is worth."""

    symbol: int
    control: np.ndarray
    application_time: float
    start: float
    duration: float
    gradient: float
    cost: float
    decrease: float
    base: np.ndarray
    schedule: np.ndarray


@functools.lru_cache(maxsize=8)
def _system(problem: Problem) -> reference.System:
    return reference.System.of(problem)


def find_action(
    problem: Problem,
    state: np.ndarray,
    signal: Signal,
    settings: SsacSettings,
    sac: bool = False,
    limits: tuple[np.ndarray, np.ndarray] | None = None,
) -> Action:
    """Return the action at a state [state units], with times from now."""
    now = np.asarray(signal(0.0, np.asarray(state, dtype=float)), dtype=float)
    system, m = _system(problem), problem.alphabet.m
    horizon, steps = problem.horizon, settings.steps
    h, values = horizon / steps, problem.alphabet.values
    weight = np.asarray(settings.control_weight) * np.ones((1, 1))
    weight = weight[0, 0] * np.eye(m) if weight.shape == (1, 1) else weight

    path, base, cost = [np.asarray(state, dtype=float)], [], 0.0
    for k in range(steps):
        base.append(np.asarray(signal((k + 0.5) * h, path[-1]), dtype=float))
        x, part = reference.step(system, path[-1], base[-1], h)
        path.append(x)
        cost += part
    cost += float(system.terminal(path[-1]))
    adjoint = [reference.vector(system.terminal_x(path[-1]))]
    for x, u in zip(reversed(path[:-1]), reversed(base)):
        adjoint.insert(0, reference.adjoint_step(system, x, u, h, adjoint[0]))

    wanted = settings.gamma * cost if settings.alpha_d is None else settings.alpha_d
    schedule = []
    for k in range(steps + 1):
        x, rho, u = path[k], adjoint[k], base[min(k, steps - 1)]

        def rate(u: np.ndarray, x: np.ndarray = x) -> np.ndarray:
            return reference.vector(system.f(x, u))

        if sac:
            drift = rate(np.zeros(m))
            h_rho = np.array([rho @ (rate(unit) - drift) for unit in np.eye(m)])
            size = np.outer(h_rho, h_rho)
            control = np.linalg.solve(size + weight.T, size @ u + h_rho * wanted)
            low, high = limits or (values.min(axis=0), values.max(axis=0))
            control = np.clip(control, low, high)
            schedule.append((control, rho @ (rate(control) - rate(u)), -2))
            continue
        gradients = np.array([rho @ (rate(value) - rate(u)) for value in values])
        efforts = np.array([value @ weight @ value for value in values])
        if settings.rule == "steepest":
            best = int(np.argmin(gradients + efforts))
        else:
            best = int(np.argmin((gradients - wanted) ** 2 + efforts))
        if settings.on_no_descent == "default" and gradients[best] >= 0:
            schedule.append((u, 0.0, -1))
        else:
            schedule.append((values[best], gradients[best], best))

    chosen = 0
    if settings.application_time == "search":
        chosen = min(
            range(steps + 1),
            key=lambda k: np.linalg.norm(schedule[k][0]) + schedule[k][1] + (k * h) ** 1.6,
        )
    control, gradient, symbol = schedule[chosen]
    tau = chosen * h
    start, duration, decrease = 0.0, 0.0, 0.0
    if gradient < 0:
        for attempt in range(settings.max_backtracks + 1):
            width = settings.initial_duration * settings.shrink**attempt
            window = max(tau - width, 0.0), min(tau + width, horizon)
            idle, acting = (
                total_cost(system, path[0], base, horizon, window, u) for u in (None, control)
            )
            enough = settings.descent * abs(idle) if attempt < settings.max_backtracks else 0.0
            if idle - acting > enough:
                start, duration, decrease = window[0], window[1] - window[0], idle - acting
                break
    controls = np.array([control for control, _, _ in schedule])
    return Action(symbol, control, tau, start, duration, gradient, cost, decrease, now, controls)


def total_cost(
    system: reference.System,
    x: np.ndarray,
    base: list[np.ndarray],
    horizon: float,
    window: tuple[float, float],
    control: np.ndarray | None,
) -> float:
    """Return the cost with a control in a window, on a grid with the window's ends as points."""
    steps = len(base)
    grid = sorted({*(k * horizon / steps for k in range(steps + 1)), *window})
    cost = 0.0
    for left, right in zip(grid, grid[1:]):
        middle = (left + right) / 2
        u = base[min(int(middle / horizon * steps), steps - 1)]
        if control is not None and window[0] < middle < window[1]:
            u = control
        x, part = reference.step(system, x, u, right - left)
        cost += part
    return cost + float(system.terminal(x))
