"""States from which a simulated loop fails, and how: what a proof leaves open, tried out."""

from __future__ import annotations

import numpy as np

from capsyn.certification.question import Question
from capsyn.controllers.command import LEFT_DOMAIN, NOT_FINITE
from capsyn.reach.half_spaces import HalfSpaces

MOST_TRIED = 512
"""Most states that are simulated."""
LONGER = 5
"""Times as long as loops may take to arrive, for those that seem not to."""
STILL, ROUND = 1e-3, 0.25
"""Share of the domain within which a loop stands still in its last half, or goes round."""
BEGINS = "begins in avoid"
LASTING = ("stands still", "goes round", "does not arrive")
"""How loops fail that go on."""
NEWTON = 12
"""Steps to a state of rest."""
SNAP = 1e-9
"""Share of the domain by which a state of rest is moved onto a face."""


def refute(asked: Question, cells: np.ndarray) -> tuple[np.ndarray, tuple[str, ...], np.ndarray]:
    """Return states (R, n) from which a simulated loop fails, how each does, and cells (R,).

    Tried are states of rest in open `cells` (C,), and the middles of some.
    """
    if not len(cells):
        return np.empty((0, asked.loop.space.n)), (), np.empty(0, dtype=int)
    few = cells[np.linspace(0, len(cells) - 1, min(len(cells), MOST_TRIED)).astype(int)]
    lower, upper = asked.cells.boxes(few)
    middles = np.clip((lower + upper) / 2, *asked.box)
    rests, homes = states_of_rest(asked, cells)
    states = np.concatenate([rests, middles])
    home = np.concatenate([homes, few])
    own = np.arange(len(states)) < len(rests)
    begins = asked.begins(states)
    states, home, own = states[begins], home[begins], own[begins]
    failures = _failures(asked, states)
    resting = own & np.isin(failures, LASTING)
    failures[resting] = "stands still"  # a root of f under its own label
    (avoided,) = asked.loop.avoid.evaluate(states.T)
    failures[avoided[0] != 0] = BEGINS
    failed = np.flatnonzero(failures != "")
    failed = failed[np.argsort(failures[failed] == BEGINS, kind="stable")]
    return states[failed], tuple(failures[failed].tolist()), home[failed]


def states_of_rest(asked: Question, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return states (R, n) in cells (C,) that their own label keeps at rest, and their cells (R,).

    They are roots of f under each label, by Newton's method from the middles of the cells; those
    near a face of a label are moved onto it.
    """
    loop, n = asked.loop, asked.loop.moving
    lower, upper = asked.cells.boxes(cells)
    widths = loop.space.widths
    found, home = [np.empty((0, loop.space.n))], [np.empty(0, dtype=int)]
    for label, control in enumerate(loop.controls):
        x = ((lower + upper) / 2).T.copy()
        inputs = [np.repeat(control[:, None], len(cells), axis=1)]
        if len(asked.middle):
            inputs.append(np.repeat(asked.middle[:, None], len(cells), axis=1))
        with np.errstate(all="ignore"):
            for _ in range(NEWTON):
                (rates,) = loop.rates.evaluate(x, *inputs)
                (jacobian,) = loop.slopes.evaluate(x, *inputs)
                matrices = jacobian.reshape(-1, loop.space.n, len(cells))[:n, :n].transpose(2, 0, 1)
                step = (np.linalg.pinv(np.nan_to_num(matrices)) @ rates[:n].T[:, :, None])[:, :, 0]
                x[:n] -= np.nan_to_num(step).T
            (rates,) = loop.rates.evaluate(x, *inputs)
        states = x.T
        near = ((states >= lower - SNAP * widths) & (states <= upper + SNAP * widths)).all(axis=1)
        still = near & (np.abs(rates[:n].T) <= 1e-9 * widths[:n] / loop.period).all(axis=1)
        states = _on_faces(loop.tree, states[still], SNAP * widths)
        own = asked.policy.leaves(states, True, "numpy", np.full(len(states), label, np.int32))
        found.append(states[own == label])
        home.append(cells[still][own == label])
    states, homes = np.concatenate(found), np.concatenate(home)
    _, first = np.unique(np.round(states / (1e-6 * widths)), axis=0, return_index=True)
    return states[first], homes[first]


def _on_faces(tree: HalfSpaces, states: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return states (B, n), coordinates within `reach` of a face of labels moved onto it."""
    axial = (tree.row < 0) & ((tree.normal != 0).sum(axis=1) == 1)
    states = states.copy()
    for axis in range(states.shape[1]):
        nodes = axial & (tree.normal[:, axis] == 1)
        faces = np.unique(np.append(tree.above[nodes], np.inf))
        place = np.searchsorted(faces, states[:, axis])
        for k in (place - 1, place):
            face = faces[np.clip(k, 0, len(faces) - 1)]
            close = np.abs(states[:, axis] - face) <= reach[axis]
            states[close, axis] = face[close]
    return states


def _failures(asked: Question, states: np.ndarray) -> np.ndarray:
    """Return how simulated loops fail from states (B, n), an empty string where they do not."""
    trials, _ = asked.simulated(states, LONGER * asked.experiment.loop.samples)
    failed = trials["arrived"] < 0
    out = np.isin(trials["ended"], (LEFT_DOMAIN, NOT_FINITE))
    names = np.where(failed, "does not arrive", "").astype(object)
    names[failed & out] = "leaves the domain"
    lasting = np.flatnonzero(failed & ~out)
    if len(lasting):
        names[lasting] = _ways(asked, trials["state"][lasting])
    if asked.conditions["avoid"] is not None:
        for k in np.flatnonzero(names == ""):
            if _enters_avoid(asked, states[k], int(trials["end"][k])):
                names[k] = "enters avoid"
    return names


def _ways(asked: Question, states: np.ndarray) -> list[str]:
    """Return what loops do that have gone on to states (B, n), followed for a little longer."""
    _, record = asked.simulated(states, min(asked.experiment.loop.samples, 4096), recorded=True)
    assert record is not None
    spread = (record.states.max(axis=1) - record.states.min(axis=1)) / asked.loop.space.widths
    ends = np.abs(record.states[:, -1] - record.states[:, 0]) / asked.loop.space.widths
    still, back = spread.max(axis=1) <= STILL, ends.max(axis=1) <= ROUND * spread.max(axis=1)
    return np.where(still, "stands still", np.where(back, "goes round", "does not arrive")).tolist()


def _enters_avoid(asked: Question, state: np.ndarray, end: int) -> bool:
    """Return whether a simulated loop is in what it must avoid at a sample before its end."""
    _, record = asked.simulated(state[None], max(1, min(end, 1 << 16)), recorded=True)
    assert record is not None
    states = record.states[0][np.isfinite(record.states[0]).all(axis=1)]
    (inside,) = asked.loop.avoid.evaluate(states.T)
    return bool((inside != 0).any())
