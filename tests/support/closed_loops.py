"""Small problems and policies for tests of closed loops, and an independent closed loop."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from capsyn import Alphabet, Box, Policy, Problem, SsacSettings, Switching, problems
from capsyn.cells.cell_tree import CellTree
from capsyn.modelling.grid import Grid
from capsyn.modelling.transcription import transcribe, transcribe_target
from capsyn.verification.outcome import MonteCarlo

BACKENDS = ["c", "numpy"]


def grid(labels: Sequence[int], partitions: Sequence[int]) -> CellTree:
    """Return a tree without splits from the labels of its cells, in C order; N is the default."""
    entries = (-1 - np.asarray(labels)).astype(np.int32)
    none = np.zeros(0, np.int32), np.zeros(0, np.uint64)
    return CellTree(Grid(tuple(partitions), (2,) * len(partitions), 0), entries, *none)


def grid_policy(
    problem: Problem, labels: Sequence[int], partitions: Sequence[int], **changes: Any
) -> Policy:
    """Return a policy of a problem with the given labels."""
    policy = Policy(
        problem.name,
        problem.domain,
        problem.alphabet,
        problem.default,
        grid(labels, partitions),
        outside=problem.outside,
        min_dwell=problem.min_dwell,
        target=transcribe_target(problem),
        horizon=problem.horizon,
        settings=problem.settings,
        model=transcribe(problem),
    )
    return dataclasses.replace(policy, **changes)


def random_grid_policy(problem: Problem, partitions: int = 4, seed: int = 0) -> Policy:
    """Return a policy of a problem with random labels, the default among them."""
    sizes = (partitions,) * problem.domain.n
    labels = np.random.default_rng(seed).integers(0, len(problem.alphabet) + 1, math.prod(sizes))
    return grid_policy(problem, labels, sizes)


def relay_problem(**changes: Any) -> Problem:
    """Return ``xdot = u``, u in {1, -1}, on [-1, 1]."""
    fields = {
        "name": "relay",
        "dynamics": lambda x, u: [u[0]],
        "domain": Box([-1], [1], names=["x"]),
        "alphabet": [1.0, -1.0],
        "default": 0.0,
        "horizon": 0.5,
        "running_cost": lambda x: x[0] ** 2,
        "settings": SsacSettings(steps=4),
    }
    return Problem(**fields | changes)


def relay(labels: Sequence[int] = (0, 1), **changes: Any) -> Policy:
    """Return a policy of ``xdot = u`` that has the labels from left to right."""
    problem = relay_problem()
    return grid_policy(problem, labels, [len(labels)], **changes)


def linear_problem(n: int = 3, seed: int = 0) -> Problem:
    """Return a random linear system with as many inputs as states: no library functions."""
    a = np.random.default_rng(seed).normal(size=(n, n))
    return Problem(
        name="linear",
        dynamics=lambda x, u: ca.mtimes(a, x) + u,
        domain=Box(-np.ones(n), np.ones(n)),
        alphabet=np.eye(n),
        default=-0.3 * np.ones(n),
        horizon=0.5,
        running_cost=lambda x: ca.sumsqr(x),
        terminal_cost=lambda x: 2 * ca.sumsqr(x),
        settings=SsacSettings(steps=5, sample_time=0.1),
        outside="nearest",
    )


def tank_interior() -> Problem:
    """Return the double tank with a domain in which nothing is switched."""
    return problems.plain("double-tank-a").replace(
        domain=Box([0.6, 0.1], [0.9, 0.3], names=["x1", "x2"]),
        outside="nearest",
        settings=SsacSettings(steps=10),
    )


def smooth_problems() -> dict[str, Problem]:
    """Return problems whose dynamics are smooth where they are simulated."""
    pendulum = problems.plain("cart-pendulum").replace(
        running_cost=lambda x: ca.cos(x[0]) + x[1] ** 2
    )
    return {"linear": linear_problem(), "pendulum": pendulum, "tank": tank_interior()}


@functools.lru_cache(maxsize=8)
def _functions(problem: Problem) -> dict[str, ca.Function]:
    return problem.functions()


Timeline = list[tuple[float, np.ndarray]]
"""When each control begins [s], and the control, in order of time."""


def integrate(
    problem: Problem,
    state: np.ndarray,
    timeline: Timeline,
    start: float,
    stop: float,
    push: Callable[[float], np.ndarray] | np.ndarray | float = 0.0,
    dynamics: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> tuple[np.ndarray, float]:
    """Return the state at `stop` and the running cost, by a high-order method of SciPy."""
    functions = _functions(problem)

    def default_dynamics(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return functions["dynamics"](x, u).full().ravel()

    f = dynamics or default_dynamics
    begins = [time for time, _ in timeline]
    edges = sorted({start, stop, *(time for time in begins if start < time < stop)})
    y = np.append(state, 0.0)
    for left, right in zip(edges, edges[1:]):
        middle = (left + right) / 2
        u = timeline[int(np.searchsorted(begins, middle, side="right")) - 1][1]
        shove = push(middle) if callable(push) else push

        def slope(_: float, y: np.ndarray, u=u, shove=shove) -> np.ndarray:
            return np.append(f(y[:-1], u) + shove, float(functions["running_cost"](y[:-1])))

        y = solve_ivp(slope, (left, right), y, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return y[:-1], float(y[-1])


def assert_same_trials(one: MonteCarlo, two: MonteCarlo, count: int | None = None) -> None:
    for name, a in vars(one).items():
        b = getattr(two, name)
        if name in ("parameters", "figures"):
            assert list(a) == list(b)
            assert all(np.array_equal(a[key][:count], b[key], equal_nan=True) for key in a)
        elif isinstance(a, np.ndarray):
            assert a.dtype == b.dtype and np.array_equal(
                a[:count], b, equal_nan=a.dtype.kind == "f"
            ), name
        elif count is None:
            assert a == b, name


def two_inputs(**changes: Any) -> Problem:
    """Return a problem of a point with two inputs, prices, least times and a forbidden pair."""
    names = ["rest", "up", "left", "both"]
    switching = Switching(
        price=0.02, hold={"up": 0.05, "both": 0.03, "x": 0.4}, forbidden=[("up", "left")]
    )
    given: dict[str, Any] = {
        "name": "point",
        "dynamics": lambda x, u: [x[1], 2 * u[0] - 2 * u[1] - 0.5 * ca.sin(3 * x[0])],
        "domain": Box([-1, -2], [1, 2], names=["place", "speed"]),
        "alphabet": Alphabet(
            [[a, b] for a, b in itertools.product([0, 1], repeat=2)], names=names, inputs=["x", "y"]
        ),
        "default": [0.5, 0.5],
        "horizon": 0.5,
        "running_cost": lambda x: x[0] ** 2 + 0.1 * x[1] ** 2,
        "partitions": 12,
        "max_level": 2,
        "outside": 0,
        "switching": switching,
    }
    return Problem(**given | changes)
