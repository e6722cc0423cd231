"""Where a system can rest: mixtures of symbols whose mean rate is zero."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box

REST = 1e-7
"""Largest rate at rest, relative to the largest of any symbol, in widths of the domain."""
NEARLY = 1e-4
"""The same of goals that are given by a few digits, or whose rates no symbol has directly."""
MOST_SYMBOLS = 256
"""Most symbols of an alphabet for which the cheapest place to rest is sought."""
STARTS = 4
"""Random starts of that search, beside the middle of the domain."""


class System(Protocol):
    """What tails need of a problem."""

    @property
    def domain(self) -> Box:
        """States."""

    @property
    def exogenous(self) -> Box | None:
        """Exogenous inputs."""

    @property
    def alphabet(self) -> Any:
        """The symbols."""

    @property
    def running_cost(self) -> Any:
        """Cost per time; None where there is none."""

    @property
    def target(self) -> Any:
        """What "arrived" means."""

    def system(self) -> dict[str, Any]:
        """Return CasADi functions of the reading: ``motion(z, u)`` and ``running_cost(z)``.

        The motion is the rates, or of a map what a sample adds to the state.
        """

    @property
    def discrete(self) -> bool:
        """Whether the dynamics are a map."""


def rates(system: System, x: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return the motion (N, n) at a state under each symbol [state units / time unit or sample]."""
    function, n = system.system()["motion"], system.domain.n
    return np.array(function(np.concatenate([x, w]), system.alphabet.values.T)).T[:, :n]


def mixture(system: System, x: np.ndarray, w: np.ndarray) -> np.ndarray | None:
    """Return shares (N,) of the symbols under which a state rests, of least controls; else None."""
    from scipy.optimize import linprog

    values = system.alphabet.values
    scaled = rates(system, x, w).T / system.domain.widths[:, None]
    if not np.isfinite(scaled).all():
        return None
    scaled = scaled / (np.abs(scaled).max() or 1.0)
    size = ((values / (np.abs(values).max(axis=0) + (values == 0).all(axis=0))) ** 2).sum(axis=1)
    whole = np.ones((1, len(values)))
    exact = linprog(size, A_eq=np.vstack([scaled, whole]), b_eq=[*np.zeros(len(scaled)), 1.0])
    if exact.status == 0:
        return np.asarray(exact.x)
    both = np.vstack([scaled, -scaled])
    near = linprog(size, both, np.full(len(both), NEARLY), A_eq=whole, b_eq=[1.0])
    return np.asarray(near.x) if near.status == 0 else None


def cheapest_rest(
    system: System, known: dict[int, float], w: np.ndarray, near: np.ndarray | None = None
) -> np.ndarray:
    """Return the state (n,) of least running cost among those where the system can rest.

    `known` are components of it by axis. The search starts at the state `near`; without it from
    several. A `ProblemError` says that none is found.
    """
    from scipy.optimize import minimize

    domain, values = system.domain, system.alphabet.values
    n, count = domain.n, len(values)
    if count > MOST_SYMBOLS:
        raise ProblemError(
            f"`tail` needs a target with a centre, or a goal, where there are more than "
            f"{MOST_SYMBOLS} symbols; got {count}"
        )
    functions = system.system()
    cost, dynamics = functions["running_cost"], functions["motion"]
    slope, change = cost.jacobian(), dynamics.jacobian()
    lower, widths = domain.lower, domain.widths

    def split(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.concatenate([lower + y[:n] * widths, w]), y[n:]

    def slopes(y: np.ndarray) -> np.ndarray:
        z, _ = split(y)
        return np.concatenate([np.array(slope(z, 0)).ravel()[:n] * widths, np.zeros(count)])

    middle = lower + widths / 2
    unit = float(np.abs(rates(system, middle, w) / widths).max()) or 1.0

    def constraints(y: np.ndarray) -> np.ndarray:
        z, shares = split(y)
        mean = np.array(dynamics(z, values.T))[:n] @ shares
        return np.append(mean / widths / unit, shares.sum() - 1)

    def constraint_slopes(y: np.ndarray) -> np.ndarray:
        z, shares = split(y)
        by_share = np.array(dynamics(z, values.T))[:n]
        each = np.array(change(z, values.T, 0)[0])[:n].reshape(n, count, len(z))[:, :, :n]
        by_state = np.einsum("ikj,k->ij", each, shares)
        top = np.hstack([by_state * widths, by_share]) / widths[:, None] / unit
        return np.vstack([top, np.append(np.zeros(n), np.ones(count))])

    bounds = [(0.0, 1.0)] * (n + count)
    for axis, value in known.items():
        place = (value - lower[axis]) / widths[axis]
        bounds[axis] = (place, place)
    samples = [middle, *domain.sample(STARTS, 0)]
    scale = float(np.ptp([float(cost(np.concatenate([x, w]))) for x in samples])) or 1.0
    best, least = None, np.inf
    for start in samples if near is None else [near]:
        found = minimize(
            lambda y: float(cost(split(y)[0])) / scale,
            np.concatenate([(start - lower) / widths, np.full(count, 1 / count)]),
            jac=lambda y: slopes(y) / scale,
            bounds=bounds,
            constraints={"type": "eq", "fun": constraints, "jac": constraint_slopes},
            method="SLSQP",
            options={"ftol": 1e-12, "maxiter": 80},
        )
        rests = np.isfinite(found.x).all() and np.abs(constraints(found.x)).max() <= REST
        if rests and found.fun < least - 1e-9:
            best, least = np.round(found.x[:n], 7), found.fun
    if best is None:
        raise ProblemError(
            "`tail` must have a goal where the system can rest: no mixture of the symbols holds "
            f"any state of the domain{_of(known, domain)}"
        )
    return np.asarray(lower + best * widths)


def _of(known: dict[int, float], domain: Box) -> str:
    parts = ", ".join(f"{domain.names[axis]} = {value:g}" for axis, value in known.items())
    return f" with {parts}" if parts else ""
