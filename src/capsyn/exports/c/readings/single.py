"""Single precision in C: what it can tell apart, and what it decides, as the exported code does."""

from __future__ import annotations

import dataclasses

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.errors import ProblemError
from capsyn.exports.c.language import round_up
from capsyn.exports.crossings import ranked_tree
from capsyn.exports.golden import Golden, decide
from capsyn.exports.plan import Plan
from capsyn.exports.sequence import Sequence, golden_sequence, run
from capsyn.modelling.domain import Box

SAMPLES = 20_000
"""Random states at which the effect of rounding is counted."""
LARGEST_PERIODIC = 1e31
"""Largest bound of a periodic axis: no float minus a bound overflows."""
MOST_FACES = 16_000
"""Most faces in tables of floats: 64 kB are what 16 bits can point at."""


def check_single_precision(
    plan: Plan,
    tree: CellTree | SplitTree,
    option: str = "`arithmetic` float",
    other: str = "double",
) -> None:
    """Raise `ProblemError` where single precision does not hold what the plan is made of.

    Errors name the `option` that asks for it, and the `other` value to take.
    """
    domain = plan.policy.space
    parts = {"`scale`": plan.scale, "`offset`": plan.offset, "controls": plan.policy.controls}
    for name, values in parts.items():
        with np.errstate(over="ignore"):
            single = np.asarray(values).astype(np.float32)
        lost = ~np.isfinite(single) | ((single == 0) & (values != 0))
        if lost.any():
            raise ProblemError(
                f"{option} needs {name} between 1.5e-45 and 3.4e38 in size, or 0; "
                f"got {float(values[lost][0])!r}; take {other}"
            )
    for i, count in enumerate(tree.counts):
        lower, upper = float(domain.lower[i]), float(domain.upper[i])
        bounds, largest = f"axis '{domain.names[i]}', in [{lower!r}, {upper!r}]", max(-lower, upper)
        if domain.periodic[i] and largest > LARGEST_PERIODIC:
            raise ProblemError(
                f"{option} needs bounds of a periodic axis within "
                f"+-{LARGEST_PERIODIC:g}; got {bounds}; take {other}"
            )
        apart = count < 1 << 25 and largest < 3e38
        if apart:
            faces = round_up(domain.faces(i, np.arange(count + 1), count))
            apart = bool((np.diff(faces) > 0).all())
        if not apart:
            raise ProblemError(
                f"{option} does not tell the {count} steps of {bounds} apart: "
                f"it has 24 bits; take {other}"
            )


def ranked(
    tree: CellTree | SplitTree, domain: Box
) -> tuple[CellTree | SplitTree, list[np.ndarray]]:
    """Return a tree over those faces alone that it compares with, and the faces of each axis.

    Cells and a tree with oblique splits are the same, with all faces, up to `MOST_FACES`.
    """
    total = sum(tree.counts) - tree.n
    if (isinstance(tree, CellTree) or tree.has_planes) and total > MOST_FACES:
        what = "cells" if isinstance(tree, CellTree) else "a tree with oblique splits"
        raise ProblemError(
            f"`arithmetic` float tabulates all {total:,} faces of {what}; more than "
            f"{MOST_FACES:,} are too many: take lattice, with readings int16 where there are "
            "no doubles"
        )
    smaller, numbers = ranked_tree(tree)
    return smaller, [domain.faces(i, k, tree.counts[i]) for i, k in enumerate(numbers)]


def decide_single(plan: Plan, readings: np.ndarray) -> Golden:
    """Return what the exported code must give for readings (K, n), rounded to floats here.

    That is the policy's decision at float states; see `_single_states`.
    """
    singles, states = _single_states(plan, readings)
    golden = decide(_unfolded(plan), states)
    return dataclasses.replace(golden, readings=singles)


def sequence_single(plan: Plan) -> Sequence:
    """Return `golden_sequence` as the exported code must give it, with readings that are floats."""
    found = golden_sequence(plan)
    flat = found.readings.reshape(-1, plan.n)
    singles, states = (a.reshape(found.readings.shape) for a in _single_states(plan, flat))
    return dataclasses.replace(run(_unfolded(plan), states, found.period), readings=singles)


def _unfolded(plan: Plan) -> Plan:
    """Return a plan whose readings are states."""
    return dataclasses.replace(plan, scale=np.ones(plan.n), offset=np.zeros(plan.n))


def _single_states(plan: Plan, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return readings (K, n) rounded to floats, and the states that the exported code makes them.

    Periodic ones are brought back, and readings made states, in single precision.
    """
    domain = plan.policy.space
    with np.errstate(over="ignore", invalid="ignore"):
        singles = readings.astype(np.float32)
        states = singles.copy()
        if plan.folded:
            states *= plan.scale.astype(np.float32)
            states += plan.offset.astype(np.float32)
    for i in np.flatnonzero(domain.periodic):
        states[:, i] = _wrapped(states[:, i], domain, int(i))
    return singles.astype(np.float64), states.astype(np.float64)


def _wrapped(x: np.ndarray, domain: Box, i: int) -> np.ndarray:
    """Return floats brought into the floats of a periodic axis, those that are not finite as is."""
    low, high = round_up(domain.lower[i : i + 1])[0], round_up(domain.upper[i : i + 1])[0]
    width = np.float32(float(high) - float(low))
    off = np.isfinite(x) & ~((x >= low) & (x < high))
    rest = np.fmod(x[off] - low, width)
    rest = low + np.where(rest < 0, rest + width, rest)
    wrapped = x.copy()
    wrapped[off] = np.where(rest >= high, low, rest)
    return wrapped


def share_changed(plan: Plan) -> float:
    """Return the share of random states in the domain whose symbol or status rounding changes."""
    states = plan.policy.space.sample(SAMPLES)
    readings = (states - plan.offset) / plan.scale
    exact, single = decide(plan, readings), decide_single(plan, readings)
    same = (exact.labels == single.labels) & (exact.statuses == single.statuses)
    return float(1 - same.mean())
