"""Policies with models whose switching is known: relays on axis-aligned cells."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from capsyn import Alphabet, Box, Policy, Problem, subdivide
from capsyn.modelling.transcription import transcribe


def relay(
    dynamics: Callable[[Any, Any], Any],
    box: Box,
    label: Callable[[np.ndarray], np.ndarray],
    alphabet: Sequence[float] | Alphabet = (1.0, -1.0),
    default: float = 0.0,
    partitions: Any = 4,
    max_level: int = 0,
    in_force: bool = False,
    exogenous: Box | None = None,
) -> Policy:
    """Return a policy with a model; `label` gives symbols of states (B, n), -1 the default.

    They are symbols (B, N + 1) of each symbol `in_force`, if so; where there are `exogenous`
    inputs, of readings, and dynamics take them as w.
    """
    problem = Problem(
        "relay",
        dynamics,
        box,
        alphabet,
        default,
        1.0,
        running_cost=lambda x, *w: ca.sumsqr(x),
        exogenous=exogenous,
    )
    grid = {"partitions": partitions, "max_level": max_level}
    policy = subdivide(
        label, problem.space, problem.alphabet, **grid, in_force=in_force, name="relay"
    )
    return dataclasses.replace(
        policy,
        domain=box,
        exogenous=problem.exogenous,
        default=np.array([default]),
        model=transcribe(problem),
    )


def below(axis: int = 0, at: float = 0.0) -> Callable[[np.ndarray], np.ndarray]:
    """Return the labels 0 below a plane and 1 above it.

    Where the plane is a face of cells, they get the label of the side that they are on: most of
    their test points, all but the vertices in the plane, have it.
    """
    return lambda x: (x[:, axis] > at).astype(int)


def hysteresis(x: np.ndarray) -> np.ndarray:
    """Return what follows symbols 0 and 1 and the start: 0 stays up to x1 = 1/3, 1 down to -1/3."""
    up, down, start = (x[:, 0] > at for at in (1 / 3, -1 / 3, 0.0))
    return np.stack([up, down, start], axis=1).astype(int)
