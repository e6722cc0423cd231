"""The rates along an axis on both sides of faces: from samples, and proved by bounds."""

from __future__ import annotations

import itertools

import numpy as np

from capsyn.policies.policy import Policy
from capsyn.programs.builder import ProgramBuilder
from capsyn.programs.ends import Interval
from capsyn.programs.intervals import evaluate_intervals
from capsyn.programs.program import Program

UPWARD, DOWNWARD, SLIDING, REPELLING = range(4)
"""What the loop does at a point of a face."""
IMPOSSIBLE, UNDECIDED, POSSIBLE = range(3)
"""Whether it does so anywhere: proved nowhere, not known, or proved at some point."""

SAMPLES = {1: 1, 2: 8, 3: 4, 4: 3}
"""Sample points per axis on a face of n dimensions; 2 where there are more."""
SLOWEST = 1e-12
"""Rates up to so many widths of the domain per time unit count as none: bounds are rounded."""
CHUNK = 1 << 15
"""Points that are evaluated at once."""
BOXES = 1 << 12
"""Boxes whose bounds are evaluated at once: their values stay in the cache."""
DEPTH = 8
"""Most times that a face is halved along each of its axes."""
MAX_PARTS = 1 << 18
"""Most parts of undecided faces at one time."""


class AxisFaces:
    """Faces perpendicular to one axis, and the rates along it on their two sides.

    `low` and `high` (n, F) are corners of the faces, `sides` (2, F) their coordinates on the axis,
    below and above, which differ at seams [state units]; `labels` (2, F) are the symbols there.
    """

    def __init__(
        self,
        policy: Policy,
        axis: int,
        low: np.ndarray,
        high: np.ndarray,
        sides: np.ndarray,
        labels: np.ndarray,
    ) -> None:
        self.axis, self.low, self.high, self.sides = axis, low, high, sides
        widths = policy.space.widths
        self.controls = policy.controls[labels]
        self.others = [i for i in range(len(widths)) if i != axis]
        self.areas = np.prod((high - low)[self.others] / widths[self.others, None], axis=0)
        self.width = float(widths[axis])
        assert policy.model is not None
        self.program = axis_rate(policy.model.dynamics, axis)

    def sampled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what samples of the midpoint rule on every face show: shares, flows and points.

        Shares (F, 4) of each face where the loop crosses upwards, downwards, slides, is repelled;
        flows (F, 4): rates [1 / time unit] of crossings upwards and downwards, and of arrivals at
        where it slides, from below and from above; points (3, n, F) where it crosses upwards,
        downwards and slides the most.
        """
        n, count = self.low.shape
        each = SAMPLES.get(n, 2)
        grid = (np.array(list(itertools.product(range(each), repeat=n - 1))) + 0.5) / each
        unit = np.insert(grid, self.axis, 0.5, axis=1).T
        shares, flows = np.zeros((count, 4)), np.zeros((count, 4))
        points = np.empty((3, n, count))
        step = max(1, CHUNK // unit.shape[1])
        for start in range(0, count, step):
            part = slice(start, start + step)
            low, high = self.low[:, part, None], self.high[:, part, None]
            states = low + unit[:, None, :] * (high - low)
            below, above = (self._rates(side, states, part) for side in range(2))
            up, down = (below > 0) & (above >= 0), (below <= 0) & (above < 0)
            slides, repels = (below > 0) & (above < 0), (below < 0) & (above > 0)
            cases = (up, down, slides, repels)
            shares[part] = np.stack([case.mean(axis=1) for case in cases], axis=1)
            speeds = (below * up, -above * down, below * slides, -above * slides)
            flow = np.stack([speed.mean(axis=1) for speed in speeds], axis=1)
            flows[part] = flow * self.areas[part, None]
            rows = np.arange(states.shape[1])
            for k, speed in enumerate((below, -above, np.minimum(below, -above))):
                points[k][:, part] = states[:, rows, speed.argmax(axis=1)]
        return shares, flows, points

    def _rates(self, side: int, states: np.ndarray, part: slice) -> np.ndarray:
        """Return the rates (F, Q) on one side [widths / time unit], 0 if too slow or undefined."""
        states[self.axis] = self._beside(side)[part, None]
        control = self.controls[side, part].T[:, :, None]
        rates = self.program.evaluate(states, control)[0][0] / self.width
        return np.where(np.isfinite(rates) & (np.abs(rates) > SLOWEST), rates, 0.0)

    def decided(self, points: np.ndarray) -> np.ndarray:
        """Return `Switching.statuses` (F, 3).

        Faces that the given points (3, n, F) do not decide are halved until bounds do.
        """
        count = self.low.shape[1]
        occurring = np.zeros((count, 3), dtype=bool)
        everything = np.arange(count)
        for k in range(3):
            occurring[:, k] = self._occurs(points[k], points[k], everything)[0][:, k]
        face = np.flatnonzero(~occurring.all(axis=1))
        low, high = self.low[:, face], self.high[:, face]
        for turn in range(DEPTH * len(self.others)):
            shown, excluded = self._occurs(low, high, face)
            np.logical_or.at(occurring, face, shown)
            busy = (~occurring[face] & ~excluded).any(axis=1)
            face, low, high = face[busy], low[:, busy], high[:, busy]
            if not len(face) or 2 * len(face) > MAX_PARTS:
                break
            cut = self.others[turn % len(self.others)]
            half, middle = len(face), low[cut] + (high[cut] - low[cut]) / 2
            low, high, face = np.tile(low, 2), np.tile(high, 2), np.tile(face, 2)
            high[cut, :half] = low[cut, half:] = middle
        shown, excluded = self._occurs(low, high, face)
        np.logical_or.at(occurring, face, shown)
        left = np.zeros((count, 3), dtype=bool)
        np.logical_or.at(left, face, ~excluded)
        return np.where(occurring, POSSIBLE, np.where(left, UNDECIDED, IMPOSSIBLE)).astype(np.int8)

    def _occurs(
        self, low: np.ndarray, high: np.ndarray, face: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return where each of the three is certain everywhere, and nowhere, in parts of faces.

        The parts have corners (n, B) and are of the faces (B,).
        """
        (low_b, high_b), (low_a, high_a) = (self._bounds(k, low, high, face) for k in range(2))
        slow = SLOWEST * self.width
        up, down = low_b > slow, high_a < -slow
        no_up, no_down = high_b <= slow, low_a >= -slow
        return np.stack([up, down, up & down], axis=1), np.stack(
            [no_up, no_down, no_up | no_down], axis=1
        )

    def _beside(self, side: int) -> np.ndarray:
        """Return coordinates (F,) of the states next to the faces on a side of theirs."""
        return np.nextafter(self.sides[side], np.inf if side else -np.inf)

    def _bounds(self, side: int, low: np.ndarray, high: np.ndarray, face: np.ndarray) -> Interval:
        """Return bounds (B,) of the rates on one side; both NaN where they may be undefined.

        Where the parts are points, of the states next to the face; else of the face, too: dynamics
        that switch just there are then not decided.
        """
        exact = low is high
        beside = self._beside(side)
        lower, upper = np.empty(len(face)), np.empty(len(face))
        for start in range(0, len(face), BOXES):
            part = slice(start, start + BOXES)
            corners = low[:, part].copy(), high[:, part].copy()
            corners[side][self.axis] = beside[face[part]]
            corners[1 - side][self.axis] = (beside if exact else self.sides[side])[face[part]]
            control = self.controls[side, face[part]].T
            ((least, most),) = evaluate_intervals(self.program, corners, (control, control))
            lower[part], upper[part] = least[0], most[0]
        return lower, upper


def axis_rate(dynamics: Program, axis: int) -> Program:
    """Return the program ``(x, u) -> rate`` of one component of the dynamics."""
    builder = ProgramBuilder()
    ports = [[builder.input() for _ in range(size)] for _, size in dynamics.inputs]
    results = builder.call(dynamics, *ports)
    return builder.build("rate", dynamics.inputs, (("rate", 1),), [results[axis]])
