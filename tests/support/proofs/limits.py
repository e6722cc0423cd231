"""Small problems with limits, and their loops, attacked sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn import Box, Problem, SsacSettings

PERIOD = 0.1


def double_integrator(**more: Any) -> Problem:
    """Return the problem of a position that must not pass 1, with accelerations -1, 0 and 1.

    In continuous time it is kept from the states where ``x + max(v, 0)^2 / 2 <= 1``.
    """
    known: dict[str, Any] = {
        "name": "double-integrator",
        "dynamics": lambda x, u: [x[1], u[0]],
        "domain": Box([-2.0, -1.5], [2.0, 1.5], names=["position", "speed"]),
        "alphabet": [-1.0, 0.0, 1.0],
        "default": 0.0,
        "horizon": 1.0,
        "running_cost": lambda x: (x[0] - 0.9) ** 2 + 0.1 * x[1] ** 2,
        "settings": SsacSettings(rule="steepest", steps=16, sample_time=PERIOD),
        "limits": lambda x: [x[0] - 1.0, -1.8 - x[0], x[1] - 1.4, -1.4 - x[1]],
        "max_level": 3,
        "outside": "nearest",
    }
    return Problem(**known | more)


def worst_limit(
    policy: Any,
    x: np.ndarray,
    samples: int,
    *,
    w: Any = None,
    dynamics: Any = None,
    parameters: Any = (),
    delay: float = 0.0,
    parts: int = 8,
    rng: np.random.Generator | None = None,
) -> np.ndarray:
    """Return the largest limit (B,) that loops of a policy meet from states (B, n).

    The symbols in force at the start are random where the policy remembers, and free to change; a
    least time is waited for. `dynamics` (x (n, B), u (m, B), p) gives rates; default: the model's.
    """
    rng, count = rng or np.random.default_rng(0), len(x)
    period, labels = policy.settings.sample_time, len(policy.controls)
    holds = np.maximum(np.ceil(policy.rules.holds / period - 1e-9).astype(int), 1)
    now = np.full(count, labels - 1)
    if policy.remembers or policy.delay:
        now = rng.integers(labels - 1, size=count)
    held, worst = np.full(count, 1 << 30), np.full(count, -np.inf)
    told = np.zeros((0, count)) if w is None else np.asarray(w, dtype=float).T
    z = np.vstack([x.T, told])

    def rates(y: np.ndarray, u: np.ndarray) -> np.ndarray:
        if dynamics is None:
            return policy.model.dynamics.evaluate(y, u)[0]
        return np.vstack([dynamics(y, u, parameters), np.zeros_like(told)])

    def follow(y: np.ndarray, u: np.ndarray, time: float) -> np.ndarray:
        nonlocal worst
        h = time / parts
        for _ in range(parts):
            k1 = rates(y, u)
            k2 = rates(y + h / 2 * k1, u)
            k3 = rates(y + h / 2 * k2, u)
            k4 = rates(y + h * k3, u)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            worst = np.maximum(worst, policy.model.limits.evaluate(y)[0].max(axis=0))
        return y

    worst = np.maximum(worst, policy.model.limits.evaluate(z)[0].max(axis=0))
    for _ in range(samples):
        symbols = policy(z.T, current=now)
        wanted = np.where(symbols < 0, labels - 1, symbols)
        free = held >= holds[now]
        taken = np.where(free, wanted, now)
        held = np.where(taken != now, 1, held + 1)
        before, now = now, taken
        if policy.delay:
            z = follow(z, policy.controls[before].T, policy.delay)
        z = follow(z, policy.controls[now].T, period - policy.delay)
    return worst
