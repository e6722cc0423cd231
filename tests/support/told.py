"""What is told exogenous inputs: a problem of two rooms, and random policies."""

import dataclasses

import casadi as ca
import numpy as np

from capsyn import Box, Problem, SsacSettings

LOSS_1, LOSS_2, EXCHANGE, GAIN, COLD = 1 / 300, 1 / 500, 1 / 400, 0.004, 0.05


def rates(x, u, w):
    """Return the rates of two rooms [K / min] that w[1], outdoors, warms and u[0] cools."""
    cold = COLD * u[0]
    return [
        LOSS_1 * (w[1] - x[0]) + EXCHANGE * (x[1] - x[0]) - cold * (1 - 0.5 * u[1]),
        LOSS_2 * (w[1] - x[1]) + EXCHANGE * (x[0] - x[1]) + GAIN - cold * 0.5 * u[1],
    ]


def discomfort(x, w):
    """Return the running cost around the setpoint w[0] of the first room."""
    return (x[0] - w[0]) ** 2 + 10 * ca.fmax(x[1] - 25.5, 0) ** 2


STATES = Box([18, 18], [28, 28], names=["T1", "T2"], units=["degC"] * 2)
TOLD = Box([20, 20], [25, 38], names=["setpoint", "outdoor"], units=["degC"] * 2)
ROOMS = Problem(
    name="rooms",
    dynamics=rates,
    domain=STATES,
    exogenous=TOLD,
    alphabet=[[0, 0], [1, 0], [1, 1], [2, 0], [2, 1]],
    default=[0.5, 0.5],
    horizon=20.0,
    running_cost=discomfort,
    settings=SsacSettings(rule="steepest", control_weight=0.02, steps=4),
    outside="nearest",
    time_unit="min",
    partitions=3,
    max_level=1,
)


def fixed(problem, w, **changes):
    """Return the problem of the states alone where exogenous inputs are constants."""
    w, told, replaced = ca.DM(w), problem.domain.n, {}
    for name in ("dynamics", "running_cost", "terminal_cost", "target", "default"):
        function = getattr(problem, name)
        if callable(function):
            replaced[name] = lambda *z, function=function: function(*z, w)
    return problem.replace(
        exogenous=None,
        partitions=problem.partitions[:told],
        refinement=problem.refinement[:told],
        **replaced | changes,
    )


def smuggled(problem):
    """Return the problem with its exogenous inputs as states of rate 0."""
    n, k = problem.domain.n, problem.exogenous.n

    def of_state(function):
        return lambda z: function(z[:n], z[n:])

    changes = {
        name: of_state(getattr(problem, name))
        for name in ("running_cost", "terminal_cost", "target", "default")
        if callable(getattr(problem, name))
    }
    return problem.replace(
        domain=problem.space,
        exogenous=None,
        dynamics=lambda z, u: [
            *problem.dynamics(z[:n], u, z[n:]),
            *[0] * k,
        ],
        **changes,
    )


def told(policy, count):
    """Return a policy whose last `count` axes are exogenous inputs."""
    domain, n = policy.domain, policy.domain.n - count
    parts = [
        Box(domain.lower[i], domain.upper[i], domain.names[i], domain.units[i], domain.periodic[i])
        for i in (slice(None, n), slice(n, None))
    ]
    return dataclasses.replace(policy, domain=parts[0], exogenous=parts[1])


def values_to_fix(policy, count, seed=0):
    """Return exogenous inputs (count, k): corners, faces of cells and values beside, and others."""
    box, counts = policy.exogenous, policy.cells.counts[policy.domain.n :]
    rng = np.random.default_rng([21, seed])
    steps = np.stack([rng.integers(0, c + 1, count) for c in counts], axis=1)
    w = box.points(steps, counts)
    w = np.where(rng.random(w.shape) < 0.3, box.sample(count, seed), w)
    beside = np.clip(np.nextafter(w, rng.choice([-np.inf, np.inf], w.shape)), box.lower, box.upper)
    w = np.where(rng.random(w.shape) < 0.3, beside, w)
    return np.vstack([box.lower, box.upper, w])[:count]
