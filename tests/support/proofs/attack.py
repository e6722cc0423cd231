"""Attacks on proofs: loops that try to come late, to get where they must not, to stray.

The simulation is its own: steps of the classical Runge-Kutta method by NumPy, labels by a lookup of
the policy, holds and delays as the documentation of the closed loop has them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from unittest import mock

import numpy as np

from capsyn.certification.certify import simulated_arrival
from capsyn.certification.question import Asked, Question, question
from capsyn.reach import arrive as arriving
from capsyn.reach import stay as staying
from capsyn.reach.arrive import NOT_TRIED, arrive
from capsyn.reach.kernel import Follower
from capsyn.reach.stay import Staying, stay
from support.proofs.random_loops import Case

TOLERANCE = 1e-7
"""By how much a claim must be broken to count, in states; steps err by less."""
FINER = 16
"""Times as many steps with which what seems to break a claim is tried again."""
STAYING, LASTING = 5, 600
"""One of so many loops is followed once it has arrived, and for how many samples at most."""


@dataclass
class Proof:
    """What is proved of a case: boxes with labels in force arrive in time, and what then is so."""

    asked: Question
    lower: np.ndarray  # (C, n)
    upper: np.ndarray
    held: np.ndarray  # (C,)
    bound: np.ndarray  # (C,)
    share: float
    staying: Staying | None
    settled: int  # samples after which the ripple holds
    window: int  # samples over which switches are counted


@dataclass(frozen=True)
class Violation:
    """A loop that breaks a claim: what, by how much, and where it began."""

    what: str
    by: float
    start: np.ndarray
    held: int


@contextmanager
def little_effort() -> Iterator[list[tuple[int, int]]]:
    """Let proofs give up early; what is proved is as sound. Yield the horizons of staying."""
    horizons: list[tuple[int, int]] = []
    image = staying._Search.image

    def told(self: Any, grid: Any, horizon: int, record: int) -> Any:
        horizons.append((horizon, record))
        return image(self, grid, horizon, record)

    with (
        mock.patch.object(staying._Search, "image", told),
        mock.patch("capsyn.simulation.experiment.choose_substeps", lambda *_: 2),
        mock.patch.multiple(arriving, EFFORT=400, EASY=100, VAIN=3000, MOST_BISECTIONS=1),
        mock.patch.multiple(
            staying, EFFORT=1500, FINENESS=144, FINEST=1 << 11, FEW=64, ROUNDS=14,
            LONGEST_HORIZON=200,
        ),
    ):  # fmt: skip
        yield horizons


def asked_of(case: Case) -> Question:
    arguments = Asked(
        case.initial, case.target, None, case.avoid, 1 / case.period, case.delay, case.noise,
        case.ranges or None, case.told or None, case.family.symbolic, case.dwell, case.counts,
    )  # fmt: skip
    return question(case.policy, arguments, 1, 0)


def prove(case: Case, stays: bool = True) -> Proof:
    """Return what is proved of a case, as `capsyn.certify` does; of staying if so."""
    with little_effort() as horizons:
        asked = asked_of(case)
        follower = Follower.build(asked.loop, asked.cells, 1)
        never = math.inf
        arrival = arrive(follower, simulated_arrival(asked), asked.starts, asked.box, never)
        remains = stay(asked.loop, 1, never) if stays else None
    loop, cells = asked.loop, asked.cells
    parts = [(w.lower, w.upper, w.held, w.bound) for w in arrival.waves]
    layer, cell = np.nonzero(np.isfinite(arrival.bound))
    some = (arrival.twins[layer, cell] != layer) | (arrival.bound[layer, cell] == 0)
    layer, cell = layer[some], cell[some]
    held = layer if loop.layered else np.full_like(layer, loop.labels - 1)
    parts.append((*cells.boxes(cell), held, arrival.bound[layer, cell]))
    hold = int(loop.holds.max())
    settled = sum(horizon + hold for horizon, _ in horizons)
    window = max([record for _, record in horizons], default=0) + hold
    lower, upper, held, bound = (np.concatenate(column) for column in zip(*parts))
    tried = arrival.status != NOT_TRIED
    share = float((arrival.share * asked.starts).sum() / max(asked.starts.sum(), 1e-300))
    assert tried.any() or not len(arrival.waves)
    return Proof(asked, lower, upper, held, bound, share, remains, settled, window)


@dataclass
class Loops:
    """B loops on their way, and what each of them is up to: states, labels, errors, parameters."""

    x: np.ndarray  # (n, B)
    label: np.ndarray  # (B,) in force
    held: np.ndarray  # (B,) samples so far; many where it is free
    begins: np.ndarray  # (B,): the first decision is yet to come, and is not waited for
    noisy: np.ndarray  # (B,): 0 none, 1 a constant corner, 2 corners, 3 anything
    varies: np.ndarray  # (B,): parameters: 0 the middle, 1 a constant corner, 2 corners, 3 anything
    noise: np.ndarray  # (n, B) of those with a constant corner
    p: np.ndarray  # (P, B) likewise

    def some(self, rows: np.ndarray) -> Loops:
        return Loops(*(value[..., rows] for value in vars(self).values()))


class Attack:
    """Loops of a case by NumPy."""

    def __init__(self, case: Case, proof: Proof, finer: int, seed: Any) -> None:
        self.case, self.proof = case, proof
        self.loop = proof.asked.loop
        self.rng = np.random.default_rng(seed)
        self.tree = case.policy
        experiment = proof.asked.experiment.loop
        self.holds, self.kinds = experiment.holds.symbols, experiment.holds.kinds
        self.forbidden = experiment.holds.forbidden
        self.controls = np.vstack([case.policy.alphabet.values, case.policy.default])
        cell = case.policy.domain.widths / np.array(case.counts)[: case.family.n]
        speed = max(abs(self._rates(u)).max() for u in self.controls)
        motion = case.period * speed / cell.min()
        self.steps = finer * int(np.clip(np.ceil(4 * motion), 1, 8))
        self.tolerance = TOLERANCE
        if case.family.jumps:
            self.tolerance += 2 * speed * case.period / self.steps
        self.space = proof.asked.loop.space
        self.sides = self.space.lower, self.space.upper
        self.periodic = np.array(self.space.periodic)

    def _rates(self, u: np.ndarray) -> np.ndarray:
        x = self.proof.asked.loop.space.sample(256, 0).T
        p = np.array([[(a + b) / 2] for a, b in self.case.ranges.values()])
        return self.case.family(x, u[:, None], p)

    def begin(self, x: np.ndarray, label: np.ndarray) -> Loops:
        """Return loops from states (B, n) with labels in force; half of the default's begin."""
        count, rng = len(label), self.rng
        first = (label == self.loop.labels - 1) & (rng.random(count) < 0.5)
        ends = np.array(list(self.case.ranges.values())).reshape(-1, 2)
        corner = rng.integers(0, 2, (len(ends), count))
        middle = ends.mean(axis=1)[:, None]
        varies = rng.integers(0, 4, count)
        p = np.where(varies == 0, middle, np.take_along_axis(ends, corner, axis=1))
        noise = self._corners(count)
        return Loops(
            x.T.copy(), label.copy(), np.where(first, 0, 1 << 20), first,
            rng.integers(0, 4, count), varies, noise, p,
        )  # fmt: skip

    def _corners(self, count: int) -> np.ndarray:
        n = self.loop.space.n
        error = np.zeros((n, 1))
        error[: self.case.family.n, 0] = self.case.noise
        return error * self.rng.choice([-1.0, 1.0], (n, count))

    def draw(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return errors (n, B) and places of parameters (P, B) that a sample may have."""
        ends = np.array(list(self.case.ranges.values())).reshape(-1, 2)
        return self._corners(count), self.rng.random((2, len(ends), count))

    def sample(self, loops: Loops, error: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, ...]:
        """Go on for a sample, in place; return (lost, outside, avoided, lower, upper, switched).

        `lost` are loops (B,) without a label, 2 while one is held; `outside` is how far they are
        beyond the domain, `avoided` how near to what is to be avoided; then come extents (n, B).
        """
        case = self.case
        noise = np.where(loops.noisy == 1, loops.noise, error)
        noise = noise * (loops.noisy > 0)
        noise[:, loops.noisy == 3] *= place[0, :1, loops.noisy == 3].T if len(place[0]) else 1.0
        measured = (loops.x + noise).T
        near = 1e-9 * self.space.widths
        for i in np.flatnonzero(~self.periodic):
            low, high = self.sides[0][i], self.sides[1][i]
            clipped = np.clip(measured[:, i], low, high)
            close = np.abs(measured[:, i] - clipped) <= near[i]
            measured[close, i] = clipped[close]
        now = loops.label
        nearest = self.tree.outside == "nearest"
        wanted = self.tree.leaves(measured, nearest, "auto", now.astype(np.int32)).astype(int)
        lost = np.where(wanted >= 0, 0, np.where(self.loop_holds(now) > loops.held, 2, 1))
        wanted[lost > 0] = now[lost > 0]
        change = self.kinds[wanted] != self.kinds[now]
        waits = ~loops.begins & ((self.loop_holds(now) > loops.held) | self.forbidden[now, wanted])
        taken = np.where(waits & change, now, wanted)
        switched = self.kinds[taken] != self.kinds[now]
        loops.held[:] = np.where(switched | loops.begins, 1, loops.held + 1)
        loops.begins[:] = False
        before, after = self.controls[now].T, self.controls[taken].T
        loops.label[:] = taken
        ends = np.array(list(case.ranges.values())).reshape(-1, 2)
        span, low = (ends[:, 1] - ends[:, 0])[:, None], ends[:, :1]
        outside, avoided = np.zeros(len(now)), case.avoided(loops.x)
        lower, upper = loops.x.copy(), loops.x.copy()
        for part, (u, time) in enumerate(((before, case.delay), (after, case.period - case.delay))):
            if time <= 0:
                continue
            p = np.where(loops.varies == 2, low + span * np.rint(place[part]), loops.p)
            p = np.where(loops.varies == 3, low + span * place[part], p)
            steps = max(1, math.ceil(self.steps * time / case.period))
            for _ in range(steps):
                self._step(loops.x, u, p, time / steps)
                avoided = np.minimum(avoided, case.avoided(loops.x))
                lower, upper = np.minimum(lower, loops.x), np.maximum(upper, loops.x)
        for i in np.flatnonzero(~self.periodic[: case.family.n]):
            outside = np.maximum(outside, self.sides[0][i] - loops.x[i])
            outside = np.maximum(outside, loops.x[i] - self.sides[1][i])
        return lost, outside, avoided, lower, upper, switched

    def loop_holds(self, labels: np.ndarray) -> np.ndarray:
        return self.holds[labels]

    def _step(self, x: np.ndarray, u: np.ndarray, p: np.ndarray, h: float) -> None:
        f = self.case.family
        k1 = f(x, u, p)
        k2 = f(x + h / 2 * k1, u, p)
        k3 = f(x + h / 2 * k2, u, p)
        k4 = f(x + h * k3, u, p)
        x += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def attack(case: Case, proof: Proof, count: int, seed: Any = 0) -> list[Violation]:
    """Return loops that break a claim, of `count` that try to; each is told by finer steps."""
    if not len(proof.held):
        return []
    found = _attack(Attack(case, proof, 1, seed), count)
    return _attack(Attack(case, proof, FINER, seed), count) if found else []


def _attack(a: Attack, count: int) -> list[Violation]:
    arrived, found = _arrive(a, count)
    if a.proof.staying is not None:
        found += _stay(a, arrived, count // STAYING)
    return found


def _starts(a: Attack, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states (B, n) in proved boxes, many on faces and corners; labels; and bounds."""
    proof, rng = a.proof, a.rng
    box = rng.integers(0, len(proof.held), count)
    lower, upper = proof.lower[box], proof.upper[box]
    last = (upper == a.sides[1]) & ~a.periodic
    upper = np.where(last, upper, np.nextafter(upper, -np.inf))  # it belongs to the next cell
    place = rng.choice(
        [0.0, 1.0, 0.5, 1e-9, 1 - 1e-9], lower.shape, p=[0.25, 0.25, 0.4, 0.05, 0.05]
    )
    place[place == 0.5] = rng.random(int((place == 0.5).sum()))
    x = np.where(place == 1, upper, np.clip(lower + place * (upper - lower), lower, upper))
    return x, proof.held[box].astype(int), proof.bound[box]


def _arrive(a: Attack, count: int) -> tuple[list[Loops], list[Violation]]:
    case, found, arrived = a.case, [], []
    start, label, bound = _starts(a, count)
    loops = a.begin(start, label)
    last = np.rint(bound * (1 + 1e-9) / case.period).astype(int)
    rows = np.arange(count)
    for k in range(int(last.max()) + 1):
        there = case.inside(loops.x) <= a.tolerance
        if there.any():
            arrived.append(loops.some(there))
        late = ~there & (k >= last[rows])
        _report(found, "late", case.inside(loops.x), late, start[rows], label[rows])
        left = ~(there | late)
        loops, rows = loops.some(left), rows[left]
        error, place = a.draw(count)
        if not len(rows):
            break
        lost, outside, avoided, *_ = a.sample(loops, error[:, rows], place[..., rows])
        far = 0 if a.tree.outside != "nearest" else np.inf
        at = start[rows], label[rows]
        _report(found, "no label", outside, lost == 1, *at)
        _report(found, "no label in a hold", outside, lost == 2, *at)
        _report(found, "outside", outside, outside > far + a.tolerance, *at)
        _report(found, "avoid", -avoided, avoided < -a.tolerance, *at)
    return arrived, found


def _report(
    found: list[Violation], what: str, by: np.ndarray, broken: np.ndarray, start: np.ndarray,
    label: np.ndarray,
) -> None:  # fmt: skip
    for k in np.flatnonzero(broken)[:3]:
        found.append(Violation(what, float(by[k]), start[k], int(label[k])))


def _stay(a: Attack, arrived: list[Loops], count: int) -> list[Violation]:
    """Follow loops that have arrived; those between decisions may swing before the next one."""
    case, stays, found = a.case, a.proof.staying, []
    loops = _in_target(a, arrived, count)
    if not len(loops.label):
        return []
    start, label = loops.x.T.copy(), loops.label.copy()
    free = (loops.held >= a.loop_holds(loops.label)) | loops.begins
    size = len(label)
    switches, samples = np.zeros(size), 0
    for k in range(min(LASTING, a.proof.settled + 4 * a.proof.window)):
        lost, _, avoided, lower, upper, switched = a.sample(loops, *a.draw(size))
        _report(found, "no label later", avoided, free & (lost == 1), start, label)
        _report(found, "avoid later", -avoided, free & (avoided < -a.tolerance), start, label)
        by = _beyond(a, lower, upper, stays.swing)
        _report(found, "swing", by, free & (by > a.tolerance), start, label)
        _report(found, "swing in a hold", by, ~free & (by > a.tolerance), start, label)
        if k >= a.proof.settled and not np.isnan(stays.switch_rate):
            by = _beyond(a, lower, upper, stays.ripple)
            _report(found, "ripple", by, by > a.tolerance, start, label)
            switches, samples = switches + switched, samples + 1
    most = stays.switch_rate * case.period * (samples + 2 * a.proof.window) * (1 + 1e-9)
    _report(found, "switches", switches - most, switches > most + 1e-9, start, label)
    return found


def _beyond(
    a: Attack, lower: np.ndarray, upper: np.ndarray, ends: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return how far extents (n, B) are beyond bounds at most, a period apart where that is so."""
    by = np.zeros(lower.shape[1])
    for i in range(len(lower)):
        shift = 0.0
        if a.periodic[i]:
            width, middle = a.space.widths[i], (ends[0][i] + ends[1][i]) / 2
            shift = width * np.rint(((lower[i] + upper[i]) / 2 - middle) / width)
            if ends[1][i] - ends[0][i] >= width:
                continue
        by = np.maximum(by, ends[0][i] - (lower[i] - shift))
        by = np.maximum(by, (upper[i] - shift) - ends[1][i])
    return by


def _in_target(a: Attack, arrived: list[Loops], count: int) -> Loops:
    """Return loops that have arrived, and as many that begin in the target."""
    x = a.space.sample(40 * count, a.rng.integers(1 << 30))
    for name, (low, high) in a.case.told.items():
        del name
        x[:, -1] = a.rng.uniform(low, high, len(x))
    x = x[a.case.inside(x.T) < -a.tolerance][: count // 2]
    own = a.begin(x, a.rng.integers(0, a.loop.labels, len(x)))
    columns = zip(*(vars(one).values() for one in [*arrived, own]))
    whole = Loops(*(np.concatenate(column, axis=-1) for column in columns))
    size = len(whole.label)
    return whole.some(a.rng.permutation(size)[:count] if size > count else np.arange(size))
