"""How long one sSAC solve takes, against CasADi doing the same computation.

The computation: 24 Runge-Kutta steps of the cart-pendulum, the discrete adjoint, and the mode
insertion gradients of two symbols. Every engine gets the same 4,096 states, in one process, in
turn; the figures are the medians of several rounds.
"""

import dataclasses
import functools
import json
import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np

from capsyn import Box, Problem, SsacSettings, problems
from capsyn.modelling.transcription import runge_kutta_step, transcribe
from capsyn.native.compiler import zig_program
from capsyn.synthesis.synthesize import problem_controller

STEPS, STATES, ROUNDS = 24, 4096, 15


def casadi_function(problem, options):
    """Return CasADi's function (x) -> (J0, dJ_dlam), unrolled over all steps."""
    functions, x = problem.functions(), ca.SX.sym("x", problem.domain.n)
    default, dt = ca.DM(problem.default), ca.SX(problem.horizon / STEPS)
    end, total = x, ca.SX(0)
    for _ in range(STEPS):
        end, cost = runge_kutta_step(
            functions["dynamics"], functions["running_cost"], end, [default], dt
        )
        total += cost
    total += functions["terminal_cost"](end)
    rho, dynamics = ca.gradient(total, x), functions["dynamics"]
    gradients = [
        ca.dot(rho, dynamics(x, ca.DM(u)) - dynamics(x, default)) for u in problem.alphabet.values
    ]
    return ca.Function("solve", [x], [total, ca.vertcat(*gradients)], options)


def jax_solver(problem, states):
    """Return a compiled JAX solver of the same computation, or None where JAX is missing."""
    try:
        import jax
        import jax.numpy as jnp
    except ImportError:
        return None
    jax.config.update("jax_enable_x64", True)
    gravity, length = 9.81, 2.0

    def f(x, u):
        return jnp.stack([x[1], (gravity * jnp.sin(x[0]) + u * jnp.cos(x[0])) / length])

    def cost(x):
        dt = problem.horizon / STEPS

        def step(x, _):
            k1 = f(x, 0.0)
            k2 = f(x + dt / 2 * k1, 0.0)
            k3 = f(x + dt / 2 * k2, 0.0)
            k4 = f(x + dt * k3, 0.0)
            return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4), None

        x, _ = jax.lax.scan(step, x, None, length=STEPS)
        energy = 0.5 * length**2 * x[1] ** 2 + gravity * length * (jnp.cos(x[0]) - 1)
        return 0.5 * energy**2

    def solve(x):
        value, rho = jax.value_and_grad(cost)(x)
        change = [f(x, u) - f(x, 0.0) for u in problem.alphabet.values[:, 0]]
        return value, jnp.stack([rho @ df for df in change])

    compiled = jax.jit(jax.vmap(solve))
    data = jnp.asarray(states)
    return lambda: jax.block_until_ready(compiled(data))


def controller_of(problem, model, settings, backend):
    """Return the batch controller of a problem."""
    return problem_controller(problem.replace(settings=settings), model, backend)


def measure():
    """Return rows of microseconds per solve, and the ratios."""
    problem = problems.plain("cart-pendulum")
    model, states = transcribe(problem), problem.domain.sample(STATES, 0)
    engines = {}
    for precision in ("double", "single"):
        for backend in ("c", "numpy"):
            settings = dataclasses.replace(problem.settings, steps=STEPS, precision=precision)
            controller = controller_of(problem, model, settings, backend)
            engines[f"capsyn {backend}, {precision}, 1 thread"] = lambda c=controller: c.solve(
                states
            )
    flags = {"flags": ["-O3", "-march=native"]}
    jit = casadi_function(problem, {"jit": True, "compiler": "shell", "jit_options": flags})
    machine = casadi_function(problem, {})
    columns = ca.DM(states.T)
    engines["CasADi JIT (scalar C), 1 thread"] = functools.partial(jit.map(STATES), columns)
    engines["CasADi virtual machine, 1 thread"] = functools.partial(machine.map(STATES), columns)
    jax = jax_solver(problem, states)
    if jax:
        engines["JAX, all cores"] = jax
    compare(engines)
    seconds = {name: [] for name in engines}
    for run in engines.values():
        run()
    for _ in range(ROUNDS):
        for name, run in engines.items():
            started = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - started)
    micro = {name: 1e6 * float(np.median(values)) / STATES for name, values in seconds.items()}
    rows = [{"what": f"one solve: {k}", "value": v, "unit": "us"} for k, v in micro.items()]
    ours = micro["capsyn c, double, 1 thread"]
    for other, wanted in (
        ("CasADi JIT (scalar C), 1 thread", 0.65),
        ("CasADi virtual machine, 1 thread", 0.1),
    ):
        rows.append(
            {
                "what": f"one solve: capsyn c, double over {other}",
                "value": ours / micro[other],
                "unit": "ratio",
                "wanted": f"<= {wanted}",
            }
        )
    rows.append(thread_ratio(model, problem))
    rows += filter(None, [compiler_ratio(model, problem)])
    return rows + [told_ratio(steps) for steps in (4, 24)]


def compare(engines):
    """Stop unless all engines in double precision give the same gradients."""
    ours = engines["capsyn c, double, 1 thread"]()
    for name, run in engines.items():
        if "CasADi" in name:
            gradients = np.array(run()[1]).T
            if np.abs(gradients - ours.gradients).max() > 1e-9 * np.abs(gradients).max():
                raise SystemExit(f"{name} computes something else")


def thread_ratio(model, problem):
    """Return how many times faster two threads solve than one."""
    settings = dataclasses.replace(problem.settings, steps=STEPS)
    controller = controller_of(problem, model, settings, "c")
    parts = np.split(problem.domain.sample(2**20, 1), 64)
    times = {1: [], 2: []}
    for _ in range(7):
        for threads in times:
            with ThreadPoolExecutor(threads) as pool:
                started = time.perf_counter()
                list(pool.map(controller.solve, parts))
                times[threads].append(time.perf_counter() - started)
    ratio = float(np.median(np.array(times[1]) / np.array(times[2])))
    return {
        "what": "solving: two threads over one",
        "value": ratio,
        "unit": "ratio",
        "wanted": ">= 1.8",
    }


def compiler_ratio(model, problem):
    """Return how many times longer a solve by zig's kernel takes than by GCC's; None without."""
    settings = dataclasses.replace(problem.settings, steps=STEPS)
    states, controllers = problem.domain.sample(STATES, 0), {}
    commands = {"gcc": shutil.which("gcc"), "zig": zig_program() and f"'{zig_program()}' cc"}
    own = os.environ.get("CC", "")
    try:
        for name, command in commands.items():
            if command is None:
                return None
            os.environ["CC"] = command
            controllers[name] = controller_of(problem, model, settings, "c")
            controllers[name].solve(states)
    finally:
        os.environ["CC"] = own
    seconds = {name: [] for name in controllers}
    for _ in range(20 * ROUNDS):
        for name, controller in controllers.items():
            started = time.perf_counter()
            controller.solve(states)
            seconds[name].append(time.perf_counter() - started)
    return {
        "what": "one solve: kernel of zig over that of GCC",
        "value": float(np.median(np.array(seconds["zig"]) / np.array(seconds["gcc"]))),
        "unit": "ratio",
        "wanted": "<= 1.5",
    }


def rooms(**changes):
    """Return two rooms that one compressor cools: the setpoint and the weather are told."""

    def rates(x, u, w):
        cold, between = 0.05 * u[0], (x[1] - x[0]) / 400
        return [
            (w[1] - x[0]) / 300 + between - cold * (1 - 0.5 * u[1]),
            (w[1] - x[1]) / 500 - between + 0.004 - cold * 0.5 * u[1],
        ]

    return Problem(
        name="rooms",
        dynamics=rates,
        domain=Box([18, 18], [28, 28], names=["T1", "T2"]),
        exogenous=Box([20, 20], [25, 38], names=["setpoint", "outdoor"]),
        alphabet=[[0, 0], [1, 0], [1, 1], [2, 0], [2, 1]],
        default=[0.5, 0.5],
        horizon=20.0,
        running_cost=lambda x, w: (x[0] - w[0]) ** 2 + 10 * ca.fmax(x[1] - 25.5, 0) ** 2,
        **changes,
    )


def told_ratio(steps):
    """Return how many times longer a solve with two exogenous inputs takes than with constants."""
    told = rooms(settings=SsacSettings(steps=steps))
    w = [22.3, 31.0]
    fixed = told.replace(
        exogenous=None,
        partitions=9,
        refinement=2,
        dynamics=lambda x, u: told.dynamics(x, u, w),
        running_cost=lambda x: told.running_cost(x, w),
    )
    x = told.domain.sample(STATES, 0)
    states = {"told": np.hstack([x, np.tile(w, (STATES, 1))]), "fixed": x}
    controllers = {
        name: problem_controller(problem, transcribe(problem), "c")
        for name, problem in (("told", told), ("fixed", fixed))
    }
    seconds = {name: [] for name in states}
    for _ in range(20 * ROUNDS):
        for name, controller in controllers.items():
            started = time.perf_counter()
            controller.solve(states[name])
            seconds[name].append(time.perf_counter() - started)
    return {
        "what": f"one solve of {steps} steps: two exogenous inputs over constants",
        "value": float(np.median(np.array(seconds["told"]) / np.array(seconds["fixed"]))),
        "unit": "ratio",
        "wanted": "<= 1.15",
    }


if __name__ == "__main__":
    print(json.dumps(measure()))
