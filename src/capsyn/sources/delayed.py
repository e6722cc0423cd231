"""Decisions that take effect later: each is that of the state where the control in force leads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from capsyn.modelling.problem import Problem
from capsyn.policies.policy import Policy
from capsyn.simulation.plant import choose_substeps, plant_of

Answer = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""``(states (B, n), J labels in force) -> answers (B, J, ...)``."""


def delayed(answer: Answer, problem: Problem | Policy) -> Callable[[np.ndarray], np.ndarray]:
    """Return ``states (B, n) -> answers (B, N + 1, ...)``, ``T_d(j, x) = T(j, Phi_d(x, u_j))``.

    An `answer` T is asked where the states will be after the problem's delay under the control of
    each label in force, the default's last; it may be beyond the domain. They are integrated with
    as many Runge-Kutta steps as step doubling asks for.
    """
    plant = plant_of(lambda time, states: states, problem)
    controls = np.vstack([problem.alphabet.values, problem.default_control])
    none = np.zeros((0, 1))
    substeps = choose_substeps(plant, controls, none, problem.delay)
    unique, kinds = np.unique(controls, axis=0, return_inverse=True)
    groups = [np.flatnonzero(kinds.ravel() == k) for k in range(len(unique))]
    order = np.argsort(np.concatenate(groups))

    def answers(states: np.ndarray) -> np.ndarray:
        x = np.ascontiguousarray(states.T)
        still, cost, time = (
            np.zeros_like(x),
            np.zeros(len(states)),
            np.full(len(states), problem.delay),
        )
        found = []
        for control, labels in zip(unique, groups):
            u = np.repeat(control[:, None], len(states), axis=1)
            then = plant.advance(x, cost, u, none, still, time, substeps)[0]
            found.append(answer(np.ascontiguousarray(then.T), labels))
        return np.concatenate(found, axis=1)[:, order]

    return answers
