"""Decisions of sSAC in an alphabet that is a part of a pool, by the controller of the pool."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from capsyn.cells.masks import holds
from capsyn.controllers.command import LEFT_DOMAIN, NOT_FINITE, TIME, Command, Decide, hold
from capsyn.controllers.ssac import BatchController
from capsyn.modelling.alphabet import Outside
from capsyn.modelling.domain import Box


def part_of(whole: BatchController, own: np.ndarray, prices: np.ndarray | None) -> BatchController:
    """Return sSAC among some symbols (N,) of a controller, with their prices (N + 1, N + 1)."""

    def solver(states: np.ndarray, horizon: float, steps: int) -> Any:
        cost, gradients, scales = whole.solver(states, horizon, steps)
        return cost, gradients[:, own], scales[:, own]

    given = whole.formulation
    formulation = dataclasses.replace(given, values=given.values[own], prices=prices)
    efforts = given.settings.efforts(np.vstack([formulation.values, given.default]))
    order = tuple(int(k) for k in np.argsort(efforts, kind="stable"))
    return BatchController(solver, whole.backend, formulation, efforts[:-1], order)


def decision(
    few: BatchController, own: np.ndarray, controls: np.ndarray, space: Box, outside: Outside
) -> Decide:
    """Return what a part of a pool decides in closed loops, as symbols of the pool.

    It has symbols `own` (N,) of the pool, whose controls, the default's last, are (K + 1, m).
    States outside the space have the decision of the nearest state in it, or the rule `outside`. Of
    ties with prices the symbol in force stays.
    """
    places = np.full(len(controls), len(own))
    places[own] = np.arange(len(own))

    def decide(time: float, measured: np.ndarray, in_force: np.ndarray) -> Command:
        finite = np.isfinite(measured).all(axis=1)
        out = ~space.contains(measured)
        masks = few.masks(nearest(space, np.where(finite[:, None], measured, 0.0)))
        now = places[np.where(in_force < 0, len(controls) - 1, in_force)]
        if few.in_force > 1:
            masks = masks[np.arange(len(now)), now]
        best = few.chosen(masks)
        if few.in_force > 1:
            best = np.where(holds(masks, now) & (now < len(own)), now, best)
        symbols = np.where(best < 0, -1, own[best])
        lost = ~finite | (out & (outside != "nearest"))
        symbols[lost] = outside if isinstance(outside, int) else -1
        ended = np.full(len(measured), TIME)
        if isinstance(outside, str):
            ended[lost] = LEFT_DOMAIN
            ended[~finite] = NOT_FINITE
        return dataclasses.replace(hold(controls[symbols], symbols), ended=ended, outside=out)

    return decide


def nearest(space: Box, states: np.ndarray) -> np.ndarray:
    """Return the states (B, n) of a box that are nearest to others, angles in their period."""
    around = np.array(space.periodic)
    wrapped = space.lower + np.mod(states - space.lower, space.widths)
    wrapped = np.where(wrapped >= space.upper, space.lower, wrapped)
    inside = (states >= space.lower) & (states < space.upper)
    clipped = np.clip(states, space.lower, space.upper)
    return np.where(inside | ~around, clipped, wrapped)
