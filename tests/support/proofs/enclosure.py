"""Whether the pieces of a proof hold what loops do from one decision to the next, step by step.

It finds what an attack of whole loops meets by luck only: a slab too small, a remainder left out, a
vertex that is dropped.
"""

from __future__ import annotations

import numpy as np

from capsyn.reach.kernel import Follower
from support.proofs.attack import Attack, Proof, Violation
from support.proofs.random_loops import Case

STARTS, ROOM, EFFORT = 12, 3000, 300
"""Boxes that are followed, and records and flows of each."""
POINTS = 6
"""Of each piece."""
NEAR = 1e-9
"""By how much a state must be outside to count."""


def enclosed(case: Case, proof: Proof, seed: int = 0) -> list[Violation]:
    """Return states that the pieces from some proved boxes lose on their way."""
    attack = Attack(case, proof, 8, seed)
    follower = Follower.build(proof.asked.loop, proof.asked.cells, 1)
    moving = np.flatnonzero(proof.bound > 0)
    found: list[Violation] = []
    for k in attack.rng.permutation(moving)[:STARTS]:
        box = slice(k, k + 1)
        _, told = follower.tell(proof.lower[box], proof.upper[box], proof.held[box], EFFORT, ROOM)
        _check(attack, told.pieces, told.flows, found)
    return found


def _check(a: Attack, pieces: np.ndarray, flows: np.ndarray, found: list[Violation]) -> None:
    known = pieces["id"] == np.arange(len(pieces))
    known[0] = pieces["count"][0] > 0
    known &= pieces["count"] > 0
    flows = flows[flows["count"] > 0]
    flows = flows[known[flows["end"]]]
    n = a.loop.space.n
    _flows_hold(a, pieces, flows, found)
    merged = np.flatnonzero(known & (pieces["merged"] >= 0))
    for k in merged:
        whole = pieces[pieces["merged"][k]]
        points = _points(a, pieces[k], n)
        _lost("merged", points, _beyond(whole, points, n), found)
    last = flows["start"][-1] if len(flows) else -1
    for start in np.unique(flows["start"]):
        if start != last:  # of which all parts have flowed
            _labels_hold(a, pieces[start], flows[flows["start"] == start], found)


def _flows_hold(a: Attack, pieces: np.ndarray, flows: np.ndarray, found: list[Violation]) -> None:
    n, case = a.loop.space.n, a.case
    for samples in np.unique(flows["samples"]):
        some = flows[flows["samples"] == samples]
        points = np.concatenate([_points(a, flow, n) for flow in some])
        owner = np.repeat(np.arange(len(some)), POINTS)
        before = a.controls[pieces["held"][some["start"]]][owner].T
        after = a.controls[some["label"]][owner].T
        ends = np.array(list(case.ranges.values())).reshape(-1, 2)
        corner = a.rng.integers(0, 2, (len(ends), len(points)))
        p = np.take_along_axis(ends, corner, axis=1)
        x = points.T.copy()
        for u, time in ((before, case.delay), (after, samples * case.period - case.delay)):
            steps = int(np.ceil(a.steps * max(samples, 1) * 1.0))
            for _ in range(steps if time > 0 else 0):
                a._step(x, u, p, time / steps)
        for k, flow in enumerate(some):
            mine = owner == k
            by = _beyond(pieces[flow["end"]], x.T[mine], n)
            _lost("flow", points[mine], by - a.tolerance * a.case.family.jumps, found)


def _labels_hold(a: Attack, piece: np.ndarray, flows: np.ndarray, found: list[Violation]) -> None:
    """Report states of a piece that no part with their label holds, or that are not held on."""
    n, loop = a.loop.space.n, a.loop
    points = np.concatenate([_points(a, piece, n) for _ in range(4)])
    error = loop.noise * a.rng.choice([-1.0, 0.0, 1.0], points.shape)
    measured = points + error
    inner = ((measured >= a.sides[0]) & (measured <= a.sides[1]) | a.periodic).all(axis=1)
    inner &= ((points >= a.sides[0]) & (points <= a.sides[1]) | a.periodic).all(axis=1)
    points, measured = points[inner], measured[inner]
    if not len(points):
        return
    held = int(piece["held"])
    now = np.full(len(points), held, np.int32)
    if piece["samples"] == 0:  # its cell is half open
        return
    label = a.tree.leaves(measured, a.tree.outside == "nearest", "auto", now)
    by = np.full(len(points), np.inf)
    for flow in flows:
        change = a.kinds[flow["label"]] != a.kinds[held]
        waits = change and a.holds[flow["label"]] > 1
        if waits and flow["samples"] != a.holds[flow["label"]]:
            continue
        mine = label == flow["label"]
        by[mine] = np.minimum(by[mine], _beyond(flow, points[mine], n))
    _lost("label", points, by, found)


def _lost(what: str, points: np.ndarray, by: np.ndarray, found: list[Violation]) -> None:
    for k in np.flatnonzero(by > NEAR)[:2]:
        found.append(Violation(what, float(by[k]), points[k], -1))


def _shape(piece: np.ndarray, n: int) -> np.ndarray:
    return piece["v"][: n * piece["count"]].reshape(-1, n)


def _points(a: Attack, piece: np.ndarray, n: int) -> np.ndarray:
    """Return states (POINTS, n) of a piece with its error, most of them at its corners."""
    shape, rng = _shape(piece, n), a.rng
    if n == 2:
        points = shape[rng.integers(0, len(shape), POINTS)]
        points[-1] = rng.dirichlet(np.ones(len(shape))) @ shape
    else:
        points = np.where(rng.random((POINTS, n)) < 0.5, shape[0], shape[1])
    return points + piece["error"] * rng.choice([-1.0, 1.0], points.shape)


def _beyond(piece: np.ndarray, points: np.ndarray, n: int) -> np.ndarray:
    """Return how far points (B, n) are out of a piece with its error, along some normal."""
    shape, error = _shape(piece, n), piece["error"]
    low, high = shape.min(axis=0) - error, shape.max(axis=0) + error
    by = np.maximum(low - points, points - high).max(axis=1)
    if n == 2 and len(shape) > 2:
        edge = np.roll(shape, -1, axis=0) - shape
        size = np.hypot(*edge.T)
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)[size > 1e-6]
        normal /= size[size > 1e-6, None]
        out = points @ normal.T - (normal * shape[size > 1e-6]).sum(axis=1)
        by = np.maximum(by, (out - np.abs(normal) @ error).max(axis=1, initial=-np.inf))
    return by
