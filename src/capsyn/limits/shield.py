"""Policies that keep their limits: in each cell the best label of those that may be taken there."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.masks import masks_of_members, several, singles, word_count
from capsyn.cells.merged import entry_count, grids_of, merged
from capsyn.cells.row_table import RowTable
from capsyn.controllers.ssac import BatchController, flow
from capsyn.errors import warn
from capsyn.limits.asked import KeepLimits, limited_loop, moved
from capsyn.limits.invariant import LimitedLoop, Viable, viable
from capsyn.limits.kept import Kept
from capsyn.modelling.grid import Grid
from capsyn.policies.policy import Policy

CHUNK = 1 << 16
"""Cells whose labels are chosen at a time."""
STEPS = 4
"""Runge-Kutta steps in which it is looked how far limits are broken in a period."""


def shielded(
    policy: Policy, controller: BatchController, asked: KeepLimits, backend: str = "auto"
) -> Policy:
    """Return a policy that keeps the limits of its model wherever its loop can.

    Its cells are those of the limits. In each it has the label of `policy` at the centre where that
    may be taken, else that which scores best of those that may. Where limits cannot be kept it has
    the label whose worst limit in the next period is least, its own if that is one of them.
    """
    loop = limited_loop(policy, asked, backend)
    found = viable(loop)
    labels = _labels(policy, controller, loop, found)
    sets = _free(policy, loop, found, labels)
    order, in_force = list(range(len(policy.controls))), labels.shape[1]
    table = RowTable(order, in_force)
    numbers = table.settle(table.numbers(labels))
    cells = _cells(loop, numbers, sets)
    ranges = dict(asked.parameters)
    said = {"sample_time": loop.period, "parameters": ranges}
    kept = _kept(loop, found, said)
    statistics = limit_figures(policy, loop, found) | said
    _warn(policy, loop, statistics)
    return dataclasses.replace(
        policy,
        cells=cells,
        transitions=None if in_force == 1 else table.labels(),
        kept=kept,
        statistics=policy.statistics | {"limits": statistics},
    )


def _labels(
    policy: Policy, controller: BatchController, loop: LimitedLoop, found: Viable
) -> np.ndarray:
    """Return the labels (C, J) int32 that cells have, by that in force."""
    labels = np.empty((loop.cells, loop.layers), dtype=np.int32)
    for start in range(0, loop.cells, CHUNK):
        cells = np.arange(start, min(start + CHUNK, loop.cells))
        states = centres(loop, cells)
        for j in range(loop.layers):
            before = np.full(len(cells), j, dtype=np.int32) if loop.layers > 1 else None
            labels[cells, j] = policy.leaves(states, True, in_force=before)
    for j in range(loop.layers):
        own, kept, allowed = labels[:, j], found.kept[j], found.allowed[j]
        fine = np.zeros(loop.cells, dtype=bool)
        for label in range(loop.candidates):
            fine |= allowed[label] & (own == label)
        other = np.flatnonzero(kept & ~fine)
        for start in range(0, len(other), CHUNK):
            some = other[start : start + CHUNK]
            scores = _scores(controller, loop, centres(loop, some), j)
            scores = np.where(allowed[:, some].T, scores, np.inf)
            labels[some, j] = np.argmin(scores, axis=1)
        lost = np.flatnonzero(~kept)
        for start in range(0, len(lost), CHUNK):
            some = lost[start : start + CHUNK]
            labels[some, j] = _least_bad(policy, loop, some, own[some], j)
    return labels


def centres(loop: LimitedLoop, cells: np.ndarray) -> np.ndarray:
    """Return the centres (A, n) of cells (A,)."""
    lower, upper = loop.boxes(cells)
    return np.asarray(((lower + upper) / 2).T)


def _scores(
    controller: BatchController, loop: LimitedLoop, states: np.ndarray, before: int
) -> np.ndarray:
    """Return what labels score (A, S) at states (A, n) with the price of a change, least is best.

    Numbers that are not finite are the largest there are.
    """
    formulation, candidates = controller.formulation, loop.candidates
    if loop.delay:
        states = flow(formulation, states, loop.controls[before])
    scores = -controller.smooth_scores(controller.solve(states))[:, 0, :candidates]
    if formulation.prices is not None:
        scores = scores + formulation.prices[before, :candidates]
    return np.where(np.isfinite(scores), scores, np.finfo(float).max)


def _least_bad(
    policy: Policy, loop: LimitedLoop, cells: np.ndarray, own: np.ndarray, before: int
) -> np.ndarray:
    """Return the labels (A,) from whose centres the worst limit in the next period is least.

    It is that of the model, at `STEPS` times; below 0 all are alike. Of several labels the cell's
    own is taken, else the first.
    """
    assert policy.model is not None and policy.model.limits is not None
    worst = np.zeros((loop.candidates, len(cells)))
    for label in range(loop.candidates):
        if loop.forbidden is not None and loop.forbidden[before, label]:
            worst[label] = np.nan
            continue
        x = centres(loop, cells).T
        for acts, duration, _ in loop.period_of(label if loop.layers == 1 else before, label):
            control = np.repeat(loop.controls[acts][:, None], len(cells), axis=1)
            for _ in range(STEPS):
                x = policy.model.step.evaluate(x, control, [duration / STEPS])[0]
                limits = policy.model.limits.evaluate(loop.space.wrap(x.T).T)[0].max(axis=0)
                worst[label] = np.maximum(worst[label], limits)
        worst[label, np.isnan(worst[label])] = np.inf
    least = worst == np.nanmin(worst, axis=0)
    place = np.minimum(own, loop.candidates - 1)
    stays = (own < loop.candidates) & least[place, np.arange(len(cells))]
    return np.where(stays, own, np.argmax(least, axis=0)).astype(np.int32)


def _free(policy: Policy, loop: LimitedLoop, found: Viable, labels: np.ndarray) -> np.ndarray:
    """Return the sets of labels (C, J, W) that cells may have, in `compress` with freedom.

    They are those that the policy's test points saw there, of those that may be taken; the cell's
    own alone where that was not seen, or limits cannot be kept.
    """
    count = len(policy.controls)
    sets = singles(labels, count)
    cells = policy.cells
    if not isinstance(cells, CellTree) or cells.affine is not None or not len(cells.mixed_cells):
        return sets
    place = np.full(len(cells.entries), -1, dtype=np.int64)
    place[cells.mixed_cells] = np.arange(len(cells.mixed_cells))
    for start in range(0, loop.cells, CHUNK):
        some = np.arange(start, min(start + CHUNK, loop.cells))
        steps = policy.space.locate(centres(loop, some), cells.counts)
        seen = place[cells.find(steps)]
        some, seen = some[seen >= 0], seen[seen >= 0]
        may = np.zeros((len(some), loop.layers, count), dtype=bool)
        may[..., : loop.candidates] = np.moveaxis(found.allowed[:, :, some], 2, 0)
        more = cells.mixed_labels[seen] & masks_of_members(may, word_count(count))
        own = ~((sets[some] & ~more) != 0).any(axis=-1, keepdims=True)
        sets[some] |= np.where(own, more, np.uint64(0))
    return sets


def _cells(loop: LimitedLoop, numbers: np.ndarray, sets: np.ndarray) -> CellTree:
    """Return cells of row numbers (C,) and sets of labels (C, J, W), merged where these are one."""
    free = np.flatnonzero(several(sets).any(axis=1))
    flat = sets[free].reshape(len(free), int(np.prod(sets.shape[1:])))
    kinds, kind = np.unique(flat, axis=0, return_inverse=True)
    every = np.zeros(loop.cells, dtype=np.int64)
    every[free] = 1 + kind.ravel()
    every += 1 + numbers.astype(np.int64) * (len(kinds) + 1)
    entries, grid, own = _merged(every, loop.counts)
    number, place = np.divmod(own - 1, len(kinds) + 1)
    mixed = np.flatnonzero((entries < 0) & (place > 0))
    seen = kinds[place[mixed] - 1].reshape(len(mixed), *sets.shape[1:])
    entries = np.where(entries < 0, -1 - number, entries)
    return CellTree(grid, entries.astype(np.int32), mixed.astype(np.int32), seen)


def _kept(loop: LimitedLoop, found: Viable, said: dict[str, Any]) -> Kept:
    """Return the set of states from which limits are kept."""
    every = found.kept.T
    if loop.layers == 1:
        rows, row = np.array([[False], [True]]), every[:, 0].astype(np.int64)
    else:
        rows, row = np.unique(every, axis=0, return_inverse=True)
    entries, grid, kinds = _merged(row.ravel() + 1, loop.counts)
    return Kept.of(np.where(entries < 0, -kinds, entries), grid, rows, **said)


def _merged(kinds: np.ndarray, counts: tuple[int, ...]) -> tuple[np.ndarray, Grid, np.ndarray]:
    """Return what `merged` does of kinds (C,) above 0, and the grid of fewest entries."""
    block = kinds.reshape(counts)
    grid = min(grids_of(counts), key=lambda grid: entry_count(block, grid))
    entries, own = merged(block, grid)
    return entries, grid, own


def limit_figures(policy: Policy, loop: LimitedLoop, found: Viable) -> dict[str, Any]:
    """Return what could be kept, as plain data.

    ``within`` is the share of the space, states and exogenous inputs, where limits hold; ``share``
    that part of it from which they are kept whatever symbol is in force, ``of_domain`` that part of
    the space. ``from`` are the ranges that those states are in: from others they are not kept, nor
    from those in ``lost`` that are not among them.
    """
    kept = np.asarray(found.kept[: max(loop.layers - 1, 1)].all(axis=0))
    within = int(found.within.sum())
    return {
        "within": within / loop.cells,
        "share": int(kept.sum()) / within if within else 0.0,
        "of_domain": float(kept.mean()),
        "from": _ranges(policy, loop, kept),
        "lost": _ranges(policy, loop, found.within & ~kept),
        "cells": list(loop.counts),
        "rounds": found.rounds,
    }


def _ranges(policy: Policy, loop: LimitedLoop, some: np.ndarray) -> dict[str, list[float]]:
    """Return the ranges of states and exogenous inputs, by name, in some cells (C,)."""
    if not some.any():
        return {}
    lower, upper = loop.boxes(np.flatnonzero(some))
    ends = zip(policy.space.names, lower.min(axis=1), upper.max(axis=1))
    return {name: [float(low), float(high)] for name, low, high in ends}


def _warn(policy: Policy, loop: LimitedLoop, figures: dict[str, Any]) -> None:
    """Warn where nothing is kept, or more might be with finer cells."""
    far = moved(policy, loop.period)
    widths = policy.space.widths / loop.counts
    coarse = np.flatnonzero((far > 0) & (widths > far))
    names = ", ".join(policy.space.names[i] for i in coarse)
    advice = (
        f"cells are wider than what most states move in a sample along {names}: finer ones, or a "
        "longer sample time, may keep limits from more states"
    )
    if not figures["share"]:
        what = "limits cannot be kept from any cell"
        warn(f"{what}: {advice}" if len(coarse) else what)
    elif len(coarse):
        warn(advice)
