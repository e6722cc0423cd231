"""What candidates gain when they are held for a while and a good alphabet then takes over."""

from __future__ import annotations

import numpy as np

from capsyn.alphabets.loops.alphabet_loops import LoopFigures
from capsyn.alphabets.search.scores import Members, Scores
from capsyn.random_streams import stream

STATES = 100
"""States of loops at which candidates are tried."""
HELD = 1 / 5
"""How long they are held, in horizons."""
VISITED = 34
"""Purpose of the random numbers that choose the states."""


def rollout_gains(scores: Scores, base: Members, pool: Members, seed: int) -> np.ndarray:
    """Return what candidates (K,) of a pool gain at states that loops of a base visit, (B, K) >= 0.

    A candidate is held for a fifth of the horizon, in whole samples, then the base takes over. What
    it gains is its objective less that of the worst candidate there. States from which a loop is
    lost gain nothing.
    """
    loops = scores.loops
    experiment, held_for = loops.test.experiment, loops.formulation.horizon * HELD
    plant, period = loops.test.charging(loops.cost).plant, experiment.loop.period
    if plant.sample_time is not None:
        held_for *= plant.sample_time  # horizons of maps are samples
    samples = max(1, round(held_for / period))
    states, _ = loops.visited(base)
    if not len(states):
        return np.zeros((0, len(pool)))
    chosen = stream(seed, VISITED).choice(len(states), min(STATES, len(states)), replace=False)
    x = np.repeat(states[np.sort(chosen)], len(pool), axis=0).T
    controls = np.tile(loops.pool.values[list(pool)], (len(chosen), 1))
    trials = np.repeat(loops.test.trials[:1], x.shape[1])
    trials["alphabet"] = 0
    parameters, push = trials["parameters"].T, trials["push"].T
    cost, time = np.zeros(x.shape[1]), np.full(x.shape[1], period)
    for _ in range(samples):
        x, cost = plant.advance(
            x, cost, controls.T, parameters, push, time, experiment.loop.substeps
        )
    trials["state"], trials["cost"] = x.T, cost
    loops.advance([np.array(base)], trials, None)
    figures, lost = loops.figures(trials)
    scale = samples * (1.0 if plant.sample_time is not None else period)
    figures["effort"] = figures["effort"] + scale * (controls**2).sum(axis=1)
    figures["fuel"] = figures["fuel"] + scale * np.abs(controls).sum(axis=1)
    figures["time"] = figures["time"] + samples * period
    values = scores.objective.values(LoopFigures(figures, lost, [])).reshape(-1, len(pool))
    values = values[np.isfinite(values).all(axis=1)]
    return np.asarray(values.max(axis=1, keepdims=True, initial=-np.inf) - values)
