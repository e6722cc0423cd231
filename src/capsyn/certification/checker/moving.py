"""Sets of states on their way, as the checker follows them: what they meet, and where they end."""

from __future__ import annotations

import numpy as np

from capsyn.certification.checker.cells import Claims, truth
from capsyn.certification.checker.flows import Ends
from capsyn.certification.checker.sets import SLACK, around, clip, corners, within

UNKNOWN, AVOIDED, LEFT, BEYOND, CHANGES, UNLABELLED = range(1, 7)
REASONS = (
    "",
    "has no enclosure",
    "may enter what is to be avoided",
    "leaves the domain",
    "ends beyond its piece",
    "is long, and its label may change on the way",
    "has no label on the way",
)
POOR = 0.015
"""Growth of an error, in widths of a set, from which faces may do better."""
CLOSELY = 4
"""Parts of a tube along each axis, where the whole is not enough."""
NARROWER, AFFINE, FACES = range(3)
"""Which of two enclosures goes on where there is more to come."""


class Moving:
    """B sets that move under controls, each for times of its own; `why` some fail, 0 of others."""

    def __init__(self, claims: Claims, points: np.ndarray, error: np.ndarray, choice: int) -> None:
        self.claims, self.points, self.error, self.choice = claims, points, error, choice
        low, high = around(points, error)
        kept = ~np.array(claims.space.periodic) & (not claims.nearest)
        # of all that they have met; what is beyond the domain is no state
        self.low = np.where(kept, np.clip(low, claims.space.lower, claims.space.upper), low)
        self.high = np.where(kept, np.clip(high, claims.space.lower, claims.space.upper), high)
        self.why = np.zeros(len(points), dtype=int)
        # of the last move: the box around the set before, the tube, control and time
        n, m = error.shape[1], claims.controls.shape[1]
        self.last = np.zeros((len(points), 4 * n + m + 1))

    def fail(self, some: np.ndarray, bad: np.ndarray, why: int) -> None:
        """Tell why some (bad) fail."""
        rows = some[bad]
        self.why[rows] = np.where(self.why[rows] > 0, self.why[rows], why)

    def move(self, u: np.ndarray, times: np.ndarray, more: np.ndarray | bool) -> None:
        """Move under controls (B, m) for times (B,); one set goes on where `more` comes."""
        some = np.flatnonzero(times > 0)
        u, times, flow = u[some], times[some], self.claims.flow
        before = self.points[some], self.error[some]
        start = around(*before)
        wider, tube = flow.tube(*start, u, times)
        self.last[some] = np.concatenate([*start, *tube, u, times[:, None]], axis=1)
        self.fail(some, np.isnan(wider[0] + wider[1]).any(axis=1), UNKNOWN)
        self.fail(some, truth(self.claims.avoid, *tube)[1], AVOIDED)
        parts = 1 if self.choice == NARROWER else CLOSELY
        points, error = flow.affine(*before, u, times, wider, parts)
        ratio = (error - before[1]) / (start[1] - start[0] + 1e-3 * flow.widths)
        goes_on = np.broadcast_to(more, len(self.points))[some]
        goes_on = goes_on & ((ratio.max(axis=1) > POOR) | (self.choice == FACES))
        none = np.isnan(error + points.sum(axis=1)).any(axis=1)
        poor = np.flatnonzero(none | (goes_on & (self.choice != AFFINE)))
        boxes = self._faces(some[poor])
        wide = ((b - a) / flow.widths for a, b in (around(points[poor], error[poor]), boxes))
        one, other = (x.sum(axis=1) for x in wide)
        better = ~(one <= other) | (self.choice == FACES)
        points[poor[better]] = corners(*boxes, points.shape[1])[better]
        error[poor[better]] = 0.0
        points = self._keep(some, points, error)
        ends, _, _ = self._known(some)
        self.low[some] = np.minimum(self.low[some], ends[2])
        self.high[some] = np.maximum(self.high[some], ends[3])
        longer = points.shape[1] - self.points.shape[1]
        same = self.points[:, :1].repeat(longer, axis=1)
        self.points, self.error = np.concatenate([self.points, same], axis=1), self.error.copy()
        self.points[some], self.error[some] = points, error

    def _known(self, some: np.ndarray) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """Return the ends of boxes of some sets before and in their last move, control and time."""
        n, last = self.error.shape[1], self.last[some]
        return [last[:, k * n : (k + 1) * n] for k in range(4)], last[:, 4 * n : -1], last[:, -1]

    def _faces(self, some: np.ndarray) -> Ends:
        """Return boxes of some sets after their last move."""
        ends, u, times = self._known(some)
        return self.claims.flow.faces(ends[0], ends[1], ends[2], ends[3], u, times)

    def end(self, points: np.ndarray, error: np.ndarray) -> None:
        """Fail those that are not in other sets, neither as they are nor as faces bound them."""
        inside = within(self.points, self.error, points, error)
        left = np.flatnonzero(~inside)
        none = np.zeros_like(error[left])
        boxes = self._keep(left, corners(*self._faces(left), points.shape[1]), none)
        inside[left] = within(boxes, none, points[left], error[left])
        self.fail(np.arange(len(inside)), ~inside, BEYOND)

    def _keep(self, some: np.ndarray, points: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Return some sets without what is beyond faces that no motion crosses outwards.

        Their tubes are cut there, too. No motion does that goes inwards beyond the face, as far as
        the tube reaches; or on it, where rates have slopes.
        """
        space, flow, n = self.claims.space, self.claims.flow, error.shape[1]
        for axis in np.flatnonzero(~np.array(space.periodic)).tolist():
            for side, sign in enumerate((-1.0, 1.0)):
                face = float((space.lower, space.upper)[side][axis])
                ends, u, _ = self._known(some)
                tube = ends[2], ends[3]
                beyond = sign * tube[side][:, axis] - sign * face
                far = np.fmax(beyond, sign * around(points, error)[side][:, axis] - sign * face)
                if self.claims.nearest:
                    self.fail(some, ~(far <= space.widths[axis]), LEFT)
                    continue
                out = np.flatnonzero(beyond > 0)
                slab = tube[0][out].copy(), tube[1][out].copy()
                slab[1 - side][:, axis] = face
                along, signs = np.full(len(out), axis), np.full(len(out), sign)
                shut = flow.most(*slab, u[out], along, signs, 0.0) <= 0
                slab[side][:, axis] = face
                wall = np.flatnonzero(~shut)
                smooth = flow.slopes(tube[0][out[wall]], tube[1][out[wall]], u[out[wall]])
                low, high = slab[0][wall], slab[1][wall]
                worst = flow.most(low, high, u[out[wall]], along[wall], signs[wall], 0.0)
                shut[wall] = (worst <= 0) & np.isfinite(smooth).all(axis=(0, 2, 3))
                self.fail(some[out], ~shut, LEFT)
                self.last[some[out], (2 + side) * n + axis] = face
                cut = far > 0
                a, limit = np.zeros_like(error), np.full(len(some), np.inf)
                a[cut, axis] = sign
                limit[cut] = sign * face + error[cut, axis] + SLACK * abs(face)
                points, _ = clip(points, a, limit)
        return points
