"""Which switches the closed loop can take: the vector field on the faces between symbols.

On a face perpendicular to axis k, with symbol i below and j above, the loop moves along the axis
with ``f_k(x, u_i)`` on the lower side and ``f_k(x, u_j)`` on the upper one. Their signs tell what
happens there [1]_:

=================  =================  =========================================
``f_k(x, u_i)``    ``f_k(x, u_j)``    the loop
=================  =================  =========================================
> 0                >= 0               crosses upwards, a switch from i to j
<= 0               < 0                crosses downwards, a switch from j to i
> 0                < 0                slides in the face, chattering between both
< 0                > 0                leaves the face on either side (repelling)
=================  =================  =========================================

All statements are for continuous time. A loop that is sampled may jump over a thin region, and
chatters beside a sliding face instead of sliding in it. Trajectories that pass exactly through an
edge or corner of cells, so from one region to another that it touches in fewer than n - 1
dimensions, start from a set of measure zero and are not counted as switches.

References
----------
.. [1] A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, Kluwer, 1988,
   section 4.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.errors import ProblemError
from capsyn.faces import Faces, shared_faces
from capsyn.intervals import Interval, evaluate_intervals
from capsyn.policy import Policy
from capsyn.program import Program
from capsyn.program_builder import ProgramBuilder
from capsyn.validation import describe

UPWARD, DOWNWARD, SLIDING, REPELLING = range(4)
"""What the loop does at a point of a face."""
IMPOSSIBLE, UNDECIDED, POSSIBLE = range(3)
"""Whether it does so anywhere: proved nowhere, not known, or proved at some point."""

SAMPLES = {1: 1, 2: 8, 3: 4, 4: 3}
"""Sample points per axis on a face of n dimensions; 2 where there are more."""
PIECES = {2: 32, 3: 16}
"""Faces are cut into pieces no longer than an axis by so many; by 8 where there are more axes."""
SLOWEST = 1e-12
"""Rates up to so many widths of the domain per second count as none: bounds are rounded."""
CHUNK = 1 << 15
"""Points that are evaluated at once."""
BOXES = 1 << 12
"""Boxes whose bounds are evaluated at once: their values stay in the cache."""
DEPTH = 8
"""Most times that a face is halved along each of its axes."""
MAX_PARTS = 1 << 18
"""Most parts of undecided faces at one time."""


@dataclass(frozen=True, eq=False)
class Switching:
    """What the loop does on the faces between symbols, for N symbols and the default, F faces.

    Rates are of states spread evenly over the domain: how many per second, of one state, arrive at
    faces. A loop spends its time elsewhere than evenly, so they compare policies, and say what a
    loop does at first, not what it does at last.

    Parameters
    ----------
    faces : Faces
        The faces between cells of different symbols, large ones in pieces.
    labels : (F, 2)
        Symbols below and above, N for the default control.
    areas : (F,)
        Areas, in those of the domain's cross-sections: each axis is 1 long.
    found : (F, 3)
        Whether the loop reaches a face from below, from above, and slides in it: `IMPOSSIBLE`,
        `UNDECIDED` or `POSSIBLE`. The first and the last are proved by interval arithmetic.
    shares : (F, 4)
        Shares of a face where the loop crosses upwards, downwards, slides, and is repelled, from
        samples. The rest has no flow through it.
    switches : (N + 1, N + 1)
        Whether the loop can switch from a symbol (row) to another (column) on any face, crossing
        or chattering: `IMPOSSIBLE`, `UNDECIDED` or `POSSIBLE`.
    slidings : (N + 1, N + 1)
        Whether it slides between two symbols anywhere; symmetric.
    switch_rates : (N + 1, N + 1)
        Rates [1/s] of crossings from a symbol to another: the integral of ``|f_k|`` over where the
        loop crosses, divided by the domain's volume.
    sliding_rates : (N + 1, N + 1)
        Rates [1/s] of arrivals, from a symbol, at faces to another on which the loop then slides.
    areas_between, sliding_areas : (N + 1, N + 1)
        Areas of the faces between two symbols, and where the loop slides; symmetric.
    exit_rates : (N + 1,)
        Rates [1/s] at which states leave the domain under each symbol.
    volume_shares : (N + 1,)
        Shares of the domain's volume of each symbol.
    """

    faces: Faces
    labels: np.ndarray
    areas: np.ndarray
    found: np.ndarray
    shares: np.ndarray
    switches: np.ndarray
    slidings: np.ndarray
    switch_rates: np.ndarray
    sliding_rates: np.ndarray
    areas_between: np.ndarray
    sliding_areas: np.ndarray
    exit_rates: np.ndarray
    volume_shares: np.ndarray

    @property
    def rate(self) -> float:
        """Expected switches per second from an evenly spread state, without those of chattering."""
        return float(self.switch_rates.sum())

    @property
    def sliding_share(self) -> float:
        """Share of the area between symbols on which the loop slides; 0 where there is none."""
        total = float(self.areas_between.sum())
        return float(self.sliding_areas.sum()) / total if total else 0.0


def switching(policy: Policy) -> Switching:
    """Return what the closed loop of a policy does on the faces between its symbols.

    Parameters
    ----------
    policy : Policy
        A policy with a model. Its angles are taken to be angles of the model too: at the seam of a
        periodic axis the lower side of a face is at the domain's upper bound.

    Raises
    ------
    ProblemError
        No policy, one without a model, or one whose tree has oblique splits.
    """
    if not isinstance(policy, Policy):
        raise ProblemError(f"`policy` must be a Policy; got {describe(policy)}")
    if policy.model is None:
        raise ProblemError(
            f"`policy` must have a model to follow; '{policy.name}' was made without one"
        )
    cells, domain, number = policy.cells, policy.domain, len(policy.alphabet) + 1
    boxes = cells.boxes()
    label_at = np.zeros(boxes.places.max() + 1, dtype=np.int64)
    label_at[boxes.places] = boxes.labels
    faces = shared_faces(cells, lambda a, b: label_at[a] != label_at[b], domain.periodic)
    faces = _pieces(faces, cells.counts)
    labels = np.stack([label_at[faces.below], label_at[faces.above]], axis=1)
    low, high = domain.points(faces.lower, cells.counts), domain.points(faces.upper, cells.counts)

    shares, flows = np.empty((len(faces), 4)), np.empty((len(faces), 4))
    found = np.empty((len(faces), 3), dtype=np.int8)
    areas = np.empty(len(faces))
    exits = np.zeros(number)
    for axis in range(domain.n):
        own = np.flatnonzero(faces.axis == axis)
        at = low[own, axis]
        seam = faces.lower[own, axis] == 0
        sides = np.stack([np.where(seam, domain.upper[axis], at), at])
        some = _AxisFaces(policy, axis, low[own].T, high[own].T, sides, labels[own].T)
        areas[own] = some.areas
        shares[own], flows[own], points = some.sampled()
        found[own] = some.decided(points)
        exits += _exits(policy, axis, boxes.lower, boxes.upper, boxes.labels)

    def total(values: np.ndarray, downward: bool) -> np.ndarray:
        table = np.zeros((number, number))
        np.add.at(table, tuple(labels.T[::-1] if downward else labels.T), values)
        return table

    volumes = boxes.volumes()
    switches, slidings = _tables(labels, found, number)
    return Switching(
        faces=faces,
        labels=labels,
        areas=areas,
        found=found,
        shares=shares,
        switches=switches,
        slidings=slidings,
        switch_rates=total(flows[:, 0], False) + total(flows[:, 1], True),
        sliding_rates=total(flows[:, 2], False) + total(flows[:, 3], True),
        areas_between=total(areas, False) + total(areas, True),
        sliding_areas=total(areas * shares[:, SLIDING], False)
        + total(areas * shares[:, SLIDING], True),
        exit_rates=exits,
        volume_shares=np.bincount(boxes.labels, volumes, minlength=number) / volumes.sum(),
    )


def _pieces(faces: Faces, counts: Sequence[int]) -> Faces:
    """Return faces with the large ones cut into pieces: samples are so many on each."""
    lower, upper, source = faces.lower, faces.upper, np.arange(len(faces))
    for axis, count in enumerate(counts):
        longest = -(-count // PIECES.get(len(counts), 8))
        numbers = np.maximum(-(-(upper[:, axis] - lower[:, axis]) // longest), 1)
        row = np.repeat(np.arange(len(source)), numbers)
        place = np.arange(len(row)) - np.repeat(np.cumsum(numbers) - numbers, numbers)
        lower, upper, source = lower[row], upper[row], source[row]
        lower[:, axis] += place * longest
        upper[:, axis] = np.minimum(upper[:, axis], lower[:, axis] + longest)
    return Faces(faces.axis[source], lower, upper, faces.below[source], faces.above[source])


def _tables(labels: np.ndarray, found: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return whether symbols switch and slide on any of the faces, (N + 1, N + 1) each."""
    switches, slidings = np.zeros((2, number, number), dtype=np.int8)
    below, above = labels.T
    np.maximum.at(switches, (below, above), found[:, UPWARD])
    np.maximum.at(switches, (above, below), found[:, DOWNWARD])
    np.maximum.at(slidings, (below, above), found[:, SLIDING])
    return switches, np.maximum(slidings, slidings.T)


class _AxisFaces:
    """Faces perpendicular to one axis, and the rates along it on their two sides.

    Parameters
    ----------
    policy : Policy
        The policy.
    axis : int
        The axis.
    low, high : (n, F)
        Corners of the faces [state units].
    sides : (2, F)
        Their coordinates on the axis, below and above; they differ at seams.
    labels : (2, F)
        Symbols below and above.
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
        widths = policy.domain.widths
        self.controls = policy.controls[labels]
        self.others = [i for i in range(len(widths)) if i != axis]
        self.areas = np.prod((high - low)[self.others] / widths[self.others, None], axis=0)
        self.width = float(widths[axis])
        assert policy.model is not None
        self.program = axis_rate(policy.model.dynamics, axis)

    def sampled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what samples of the midpoint rule on every face show.

        Returns
        -------
        shares : (F, 4)
            Shares of each face where the loop crosses upwards, downwards, slides, is repelled.
        flows : (F, 4)
            Rates [1/s] of crossings upwards and downwards, and of arrivals at where it slides, from
            below and from above.
        points : (3, n, F)
            Where it crosses upwards, downwards and slides the most.
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
        """Return the rates (F, Q) on one side [domain widths / s], 0 if too slow or undefined."""
        states[self.axis] = self.sides[side, part, None]
        control = self.controls[side, part].T[:, :, None]
        rates = self.program.evaluate(states, control)[0][0] / self.width
        return np.where(np.isfinite(rates) & (np.abs(rates) > SLOWEST), rates, 0.0)

    def decided(self, points: np.ndarray) -> np.ndarray:
        """Return `Switching.found` (F, 3).

        Faces that the given points (3, n, F) do not decide are halved until bounds do.
        """
        count = self.low.shape[1]
        found = np.zeros((count, 3), dtype=bool)
        everything = np.arange(count)
        for k in range(3):
            found[:, k] = self._occurs(points[k], points[k], everything)[0][:, k]
        face = np.flatnonzero(~found.all(axis=1))
        low, high = self.low[:, face], self.high[:, face]
        for turn in range(DEPTH * len(self.others)):
            shown, excluded = self._occurs(low, high, face)
            np.logical_or.at(found, face, shown)
            busy = (~found[face] & ~excluded).any(axis=1)
            face, low, high = face[busy], low[:, busy], high[:, busy]
            if not len(face) or 2 * len(face) > MAX_PARTS:
                break
            cut = self.others[turn % len(self.others)]
            half, middle = len(face), low[cut] + (high[cut] - low[cut]) / 2
            low, high, face = np.tile(low, 2), np.tile(high, 2), np.tile(face, 2)
            high[cut, :half] = low[cut, half:] = middle
        shown, excluded = self._occurs(low, high, face)
        np.logical_or.at(found, face, shown)
        left = np.zeros((count, 3), dtype=bool)
        np.logical_or.at(left, face, ~excluded)
        return np.where(found, POSSIBLE, np.where(left, UNDECIDED, IMPOSSIBLE)).astype(np.int8)

    def _occurs(
        self, low: np.ndarray, high: np.ndarray, face: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return where each of the three is certain everywhere, and nowhere, in parts of faces.

        Parameters
        ----------
        low, high : (n, B)
            Corners of the parts.
        face : (B,)
            The faces that they are parts of.
        """
        (low_b, high_b), (low_a, high_a) = (self._bounds(k, low, high, face) for k in range(2))
        slow = SLOWEST * self.width
        up, down = low_b > slow, high_a < -slow
        no_up, no_down = high_b <= slow, low_a >= -slow
        return np.stack([up, down, up & down], axis=1), np.stack(
            [no_up, no_down, no_up | no_down], axis=1
        )

    def _bounds(self, side: int, low: np.ndarray, high: np.ndarray, face: np.ndarray) -> Interval:
        """Return bounds (B,) of the rates on one side; both NaN where they may be undefined."""
        lower, upper = np.empty(len(face)), np.empty(len(face))
        for start in range(0, len(face), BOXES):
            part = slice(start, start + BOXES)
            corners = low[:, part].copy(), high[:, part].copy()
            for corner in corners:
                corner[self.axis] = self.sides[side, face[part]]
            control = self.controls[side, face[part]].T
            ((least, most),) = evaluate_intervals(self.program, corners, (control, control))
            lower[part], upper[part] = least[0], most[0]
        return lower, upper


def _exits(
    policy: Policy, axis: int, lower: np.ndarray, upper: np.ndarray, labels: np.ndarray
) -> np.ndarray:
    """Return the rates (N + 1,) [1/s] at which states leave the domain on one axis by symbol."""
    domain, counts = policy.domain, policy.cells.counts
    rates = np.zeros(len(policy.alphabet) + 1)
    if domain.periodic[axis]:
        return rates
    for outer, side in ((lower[:, axis] == 0, 1), (upper[:, axis] == counts[axis], 0)):
        low, high = (domain.points(corner[outer], counts) for corner in (lower, upper))
        at = (high if side == 0 else low)[:, axis]
        both = np.stack([labels[outer]] * 2)
        faces = _AxisFaces(policy, axis, low.T, high.T, np.stack([at, at]), both)
        _, flows, _ = faces.sampled()
        rates += np.bincount(both[0], flows[:, side], minlength=len(rates))
    return rates


def axis_rate(dynamics: Program, axis: int) -> Program:
    """Return the program ``(x, u) -> rate`` of one component of the dynamics."""
    builder = ProgramBuilder()
    ports = [[builder.input() for _ in range(size)] for _, size in dynamics.inputs]
    results = builder.call(dynamics, *ports)
    return builder.build("rate", dynamics.inputs, (("rate", 1),), [results[axis]])
