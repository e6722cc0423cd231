"""A quadratic cost to go around a goal, by least squares on what closed loops cost."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from capsyn.controllers.command import TIME
from capsyn.execution.processors import pool_of
from capsyn.improvement.charged_loop import ChargedLoop
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.tails.tail import Tail
from capsyn.modelling.targets import placed
from capsyn.modelling.transcription import user_program
from capsyn.random_streams import derived_seed, stream
from capsyn.validation import read_only

NEAREST = 0.05
"""Share of the way from the goal to a random state that the nearest starts are at."""
STOPS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.35)
"""Shares of a loop's time at which its state, and what it costs from there on, are looked at."""
LEAST = 1e-9
"""Least eigenvalue of a fitted matrix, relative to its largest."""


@dataclass(frozen=True, eq=False)
class Starts:
    """Where loops start that tell the cost to go: random states, drawn towards the goal.

    The distance from the goal is scaled by log-uniform numbers from `NEAREST` to 1.
    """

    domain: Box
    exogenous: Box | None
    space: Box  # of both
    tail: Tail  # whose goal is that, with a matrix that does not matter
    initial: Ball | Box | None  # where the unscaled states are; None: the domain

    def goals(self, z: np.ndarray) -> np.ndarray:
        """Return the goals (B, n) of readings (B, n + k)."""
        goal, n = self.tail.goal, self.domain.n
        if not callable(goal):
            return np.broadcast_to(goal, (len(z), n))
        told = z.shape[1] - n
        program = user_program(
            "goal", lambda x, w: goal(w), (("x", n + told),), (("goal", n),), told=told
        )
        return program.evaluate(z.T)[0].T

    def offsets(self, z: np.ndarray) -> np.ndarray:
        """Return the distances (B, n) of readings (B, n + k) from their goals, the shorter way."""
        off, periods = z[:, : self.domain.n] - self.goals(z), self.domain.periods
        around = np.where(periods > 0, periods, 1.0)
        return np.where(periods > 0, off - around * np.rint(off / around), off)

    def draw(self, count: int, seed: int) -> np.ndarray:
        """Return starts (count, n + k)."""
        z = placed(self.space.sample(count, seed), self.initial, self.domain, derived_seed(seed, 1))
        shares = np.exp(stream(seed, 2).uniform(np.log(NEAREST), 0.0, (count, 1)))
        z[:, : self.domain.n] = self.goals(z) + shares * self.offsets(z)
        return z


def costs_to_go(
    loop: ChargedLoop, states: np.ndarray, samples: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return readings (S, n) that loops visit, what they cost from there on, and for how long.

    Loops go from readings (B, n) for so many samples; they are looked at after shares `STOPS` of
    their time. The costs (S,) are infinite of those that end before; times (S,) are shares.
    """
    stops = sorted({round(share * samples) for share in STOPS})

    def part(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        trials, seen, spent = loop.new(states), [], []
        for k, stop in enumerate(stops):
            seen.append(trials["state"].copy())
            spent.append(trials["cost"].copy())
            costs = loop.costs(trials, ([*stops, samples])[k + 1] - stop)
            trials["end"][trials["ended"] == TIME] = -1  # they go on
        with np.errstate(invalid="ignore"):
            return np.stack(seen), costs - np.stack(spent)

    size = max(8, -(-len(states) // (8 * loop.threads)))
    parts = [states[k : k + size] for k in range(0, len(states), size)]
    with pool_of(loop.threads) as pool:
        seen, rest = (np.concatenate(v, axis=1) for v in zip(*pool.map(part, parts)))
    left = np.repeat(1 - np.array(stops) / samples, len(states))
    return seen.reshape(-1, states.shape[1]), rest.ravel(), left


def fitted(
    starts: Starts, states: np.ndarray, costs: np.ndarray, times: np.ndarray, delta: float
) -> Tail | None:
    """Return the tail whose values fit costs (B,) from readings (B, n + k) best; None: nothing to.

    What is least is the sum of the squares of ``(V + c time - cost) / (cost + delta m)``, with the
    median m of the costs; c is what loops cost that stay at the goal, for times (B,). Of V the part
    that is not positive semidefinite is left out.
    """
    domain, half = starts.domain, starts.domain.widths / 2
    told = states[:, domain.n :]
    own = starts.space.contains(states) & np.isfinite(costs)
    own &= np.isfinite(told).all(axis=1)
    states, costs, times = states[own], costs[own], times[own]
    upper = np.triu_indices(domain.n)
    if len(costs) <= len(upper[0]) + 1 or not np.median(costs) > 0:
        return None
    columns = squares(starts.offsets(states) / half, domain.periods / half)
    factors = np.where(upper[0] == upper[1], 1.0, 2.0)
    rows = np.column_stack([columns[:, upper[0], upper[1]] * factors, times])
    weights = 1 / (costs + delta * np.median(costs))
    found = np.linalg.lstsq(rows * weights[:, None], costs * weights, rcond=None)[0]
    matrix = np.zeros((domain.n, domain.n))
    matrix[upper] = found[:-1]
    matrix = matrix + np.triu(matrix, 1).T
    values, axes = np.linalg.eigh(matrix)
    if not values[-1] > 0:
        return None
    matrix = axes * np.maximum(values, LEAST * values[-1]) @ axes.T
    matrix = (matrix + matrix.T) / 2
    return dataclasses.replace(starts.tail, matrix=read_only(matrix / np.outer(half, half)))


def squares(offsets: np.ndarray, periods: np.ndarray) -> np.ndarray:
    """Return what the elements of P count in a tail, (B, n, n), at distances (B, n); see `Tail`."""
    around = periods > 0
    scale = np.where(around, periods, 1.0) / (2 * np.pi)
    angles = offsets / scale
    off = np.where(around, scale * np.sin(angles), offsets)
    columns = off[:, :, None] * off[:, None, :]
    own = np.arange(offsets.shape[1])
    columns[:, own, own] += np.where(around, (scale * (1 - np.cos(angles))) ** 2, 0.0)
    return columns
