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

The symbols are those in force on the two sides. Of a policy that remembers several may be, and a
switch is where a symbol that stays on one side is followed by another on the other, see `Sides`.
Where that would stay on the first side, too, the loop does not slide, whatever the signs.

All statements are for continuous time and dynamics that are locally Lipschitz on each side of a
face. A loop that is sampled may jump over a thin region, and chatters beside a sliding face instead
of sliding in it. A trajectory may also go through an edge or corner of cells, from one region to
another that it touches in fewer than n - 1 dimensions. From crossings alone only a set of measure
zero does; sliding leads many there, so that switches around a face on which the loop may slide are
never called impossible.

References
----------
.. [1] A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, Kluwer, 1988,
   section 4.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.automata.face_rates import (
    DOWNWARD,
    IMPOSSIBLE,
    MAX_PARTS,
    POSSIBLE,
    REPELLING,
    SAMPLES,
    SLIDING,
    UNDECIDED,
    UPWARD,
    AxisFaces,
)
from capsyn.automata.row_faces import Rows, Sides
from capsyn.cells.boxes import Boxes, ragged
from capsyn.cells.faces import Faces, shared_faces
from capsyn.errors import ProblemError
from capsyn.modelling.discrete import refuse_map
from capsyn.policies.policy import Policy
from capsyn.validation import describe

PIECES = {2: 32, 3: 16}
"""Faces are cut into pieces no longer than an axis by so many; by 8 where there are more axes."""
MAX_SAMPLES = 1 << 22
"""On all faces; where there would be more, pieces are longer."""


@dataclass(frozen=True, eq=False)
class Switching:
    """What the loop does on the faces between symbols, for N symbols and the default, F faces.

    A face where several pairs of symbols may meet counts once for each. Exogenous inputs do not
    move: the faces between values of theirs are none of these, and rates are means over them.

    Rates are of states spread evenly over the domain: how many per time unit, of one state, arrive
    at faces. A loop spends its time elsewhere than evenly, so they compare policies, and say what a
    loop does at first, not what it does at last. Where several symbols may be in force they are
    equally likely.

    The statuses tell whether the loop reaches a face from below, from above, and slides in it:
    `IMPOSSIBLE`, `UNDECIDED` or `POSSIBLE`. The first and the last are proved by interval
    arithmetic. The shares of a face, from samples, are where the loop crosses upwards, downwards,
    slides, and is repelled; the rest has no flow through it. Tables of two
    symbols, (N + 1, N + 1), have the one that the loop comes from in the row. Rates of switches are
    the integral of ``|f_k|`` over where the loop crosses, divided by the domain's volume.
    """

    faces: Faces  # between cells of different symbols, large ones in pieces
    labels: np.ndarray  # (F, 2): symbols below and above, N for the default control
    areas: np.ndarray  # (F,): in those of the domain's cross-sections: each axis is 1 long
    statuses: np.ndarray  # (F, 3)
    shares: np.ndarray  # (F, 4)
    switches: np.ndarray  # whether it can switch on any face, crossing or chattering, likewise
    slidings: np.ndarray  # whether it slides between two symbols anywhere; symmetric
    switch_rates: np.ndarray  # of crossings from a symbol to another [1 / time unit]
    sliding_rates: np.ndarray  # of arrivals at faces on which the loop then slides [1 / time unit]
    areas_between: np.ndarray  # of the faces between two symbols; symmetric
    sliding_areas: np.ndarray  # where the loop slides; symmetric
    exit_rates: np.ndarray  # (N + 1,): at which states leave the domain under each symbol, likewise
    volume_shares: np.ndarray  # (N + 1,): of the domain's volume of each symbol

    @property
    def rate(self) -> float:
        """Expected switches per time unit from an evenly spread state, but not of chattering."""
        return float(self.switch_rates.sum())

    @property
    def sliding_share(self) -> float:
        """Share of the area between symbols on which the loop slides; 0 where there is none."""
        total = float(self.areas_between.sum())
        return float(self.sliding_areas.sum()) / total if total else 0.0


@dataclass(frozen=True)
class SlidingFace:
    """A face between two cells on which the loop slides: both sides push into it."""

    axis: int  # state that is constant on the face
    lower: tuple[float, ...]  # n bounds [state units]
    upper: tuple[float, ...]  # the other bounds, equal on that axis
    below: int  # the symbols on its two sides, N for the default
    above: int
    share: float  # of the face on which the loop slides, from samples


def known_switching(policy: Policy) -> Switching | None:
    """Return which switches the vector field excludes; None where that says nothing.

    That is so without a model, of a map, which jumps over faces, and where inputs have least times
    of their own: while some are held the loop takes other symbols than the policy wants.
    """
    known = policy.model is not None and not policy.discrete
    known = known and not policy.rules.input_holds.any()
    return switching(policy) if known else None


def switching(policy: Policy) -> Switching:
    """Return what the closed loop of a policy with a model does on the faces between its symbols.

    Its angles are taken to be angles of the model too: at the seam of a periodic axis the lower
    side of a face is at the domain's upper bound. No policy, one without a model, or one whose tree
    has oblique splits is a `ProblemError`.
    """
    if not isinstance(policy, Policy):
        raise ProblemError(f"`policy` must be a Policy; got {describe(policy)}")
    if policy.model is None:
        raise ProblemError(
            f"`policy` must have a model to follow; '{policy.name}' was made without one"
        )
    refuse_map(policy, "policy", "its loop jumps over the faces between symbols")
    cells, domain, number = policy.cells, policy.space, len(policy.alphabet) + 1
    boxes, rows = cells.boxes(), Rows.of(policy)
    row_at = np.zeros(boxes.places.max() + 1, dtype=np.int64)
    row_at[boxes.places] = boxes.labels
    met = shared_faces(cells, lambda a, b: row_at[a] != row_at[b], domain.periodic)
    n = policy.domain.n
    met = Faces(*(column[met.axis < n] for column in vars(met).values()))
    met = _pieces(met, cells.counts)
    beside = np.stack([row_at[met.below], row_at[met.above]], axis=1)
    sides = Sides.of(rows, beside)
    columns = (met.axis, met.lower, met.upper, met.below, met.above)
    faces, labels = Faces(*(column[sides.face] for column in columns)), sides.labels
    areas, statuses, shares, flows = _looked_at(policy, faces, labels)
    _one_way(sides, statuses, shares, flows)
    flows *= rows.weights[sides.rows][:, [0, 1, 0, 1]]
    exits = np.sum([_exits(policy, rows, axis, boxes) for axis in range(n)], axis=0)

    def total(values: np.ndarray, downward: bool) -> np.ndarray:
        table = np.zeros((number, number))
        for places, before, after in _hops(rows, sides, downward):
            np.add.at(table, (before, after), values[places])
        return table

    def between(values: np.ndarray) -> np.ndarray:
        table = np.zeros((number, number))
        np.add.at(table, tuple(labels.T), values)
        return table + table.T

    switches, slidings = _tables(rows, sides, boxes.labels, statuses)
    slides = np.flatnonzero(statuses[:, SLIDING] != IMPOSSIBLE)
    round_trip = np.where(domain.periodic, cells.counts, 0)
    around = _around_sliding(met, beside, rows, sides, slides, round_trip)
    around |= _from_outside(policy, rows, boxes)
    switches[around & (switches == IMPOSSIBLE)] = UNDECIDED
    return Switching(
        faces=faces,
        labels=labels,
        areas=areas,
        statuses=statuses,
        shares=shares,
        switches=switches,
        slidings=slidings,
        switch_rates=total(flows[:, 0], False) + total(flows[:, 1], True),
        sliding_rates=total(flows[:, 2], False) + total(flows[:, 3], True),
        areas_between=between(areas),
        sliding_areas=between(areas * shares[:, SLIDING]),
        exit_rates=exits,
        volume_shares=policy.volume_shares,
    )


def _looked_at(policy: Policy, faces: Faces, labels: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return areas (F,), statuses (F, 3), shares and flows (F, 4) of faces with labels (F, 2)."""
    domain, counts = policy.space, policy.cells.counts
    low, high = domain.points(faces.lower, counts), domain.points(faces.upper, counts)
    shares, flows = np.empty((len(faces), 4)), np.empty((len(faces), 4))
    areas, statuses = np.empty(len(faces)), np.empty((len(faces), 3), dtype=np.int8)
    for axis in range(policy.domain.n):
        own = np.flatnonzero(faces.axis == axis)
        at = low[own, axis]
        seam = faces.lower[own, axis] == 0
        ends = np.stack([np.where(seam, domain.upper[axis], at), at])
        some = AxisFaces(policy, axis, low[own].T, high[own].T, ends, labels[own].T)
        areas[own] = some.areas
        shares[own], flows[own], points = some.sampled()
        statuses[own] = some.decided(points)
    return areas, statuses, shares, flows


def _one_way(sides: Sides, statuses: np.ndarray, shares: np.ndarray, flows: np.ndarray) -> None:
    """Correct what is said of faces that only switch one way: they cross wherever they arrive."""
    for way, other, switches in ((UPWARD, DOWNWARD, sides.down), (DOWNWARD, UPWARD, sides.up)):
        only = np.flatnonzero(~switches)[:, None]
        statuses[only, [other, SLIDING]] = IMPOSSIBLE
        shares[only, way] += shares[only, SLIDING]
        flows[only, way] += flows[only, SLIDING + way]
        shares[only, [other, SLIDING, REPELLING]] = 0.0
        flows[only, [other, SLIDING, SLIDING + 1]] = 0.0


def _pieces(faces: Faces, counts: Sequence[int]) -> Faces:
    """Return faces with the large ones cut into pieces: samples are so many on each."""
    n = len(counts)
    per_axis = PIECES.get(n, 8)
    while True:
        longest = -(-np.array(counts) // per_axis)
        numbers = np.maximum(-(-(faces.upper - faces.lower) // longest), 1)
        samples = np.prod(numbers, axis=1, dtype=float).sum() * SAMPLES.get(n, 2) ** (n - 1)
        if per_axis == 1 or samples <= MAX_SAMPLES:
            break
        per_axis //= 2
    lower, upper, source = faces.lower, faces.upper, np.arange(len(faces))
    for axis in range(n):
        row, place = ragged(numbers[source, axis])
        lower, upper, source = lower[row], upper[row], source[row]
        lower[:, axis] += place * longest[axis]
        upper[:, axis] = np.minimum(upper[:, axis], lower[:, axis] + longest[axis])
    return Faces(faces.axis[source], lower, upper, faces.below[source], faces.above[source])


def _hops(rows: Rows, sides: Sides, downward: bool) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield the switches of crossing faces: places among `sides`, and the labels from and to."""
    here = np.flatnonzero(sides.down if downward else sides.up)
    own, other = (1, 0) if downward else (0, 1)
    for places, before, after in rows.hops(sides.rows[here, other], sides.labels[here, own]):
        yield here[places], before, after


def _tables(
    rows: Rows, sides: Sides, numbers: np.ndarray, statuses: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return whether symbols switch and slide on any of the faces, (N + 1, N + 1) each.

    In cells of rows (M,) a start may take several switches one after the other.
    """
    count = rows.next.shape[1]
    switches, slidings = np.zeros((2, count, count), dtype=np.int8)
    for downward, way in ((False, UPWARD), (True, DOWNWARD)):
        for places, before, after in _hops(rows, sides, downward):
            np.maximum.at(switches, (before, after), statuses[places, way])
            np.maximum.at(slidings, (before, after), statuses[places, SLIDING])
    used = np.unique(numbers)
    place, label = rows.residents(used)
    for row, labels in (
        (used, rows.next[used, -1]),
        (used[place], label),  # of which those that take turns for ever
    ):
        for _, before, after in rows.hops(row, labels):
            switches[before, after] = POSSIBLE
    turns = rows.next[used[place], label]
    slidings[label[turns != label], turns[turns != label]] = POSSIBLE
    return switches, np.maximum(slidings, slidings.T)


def _around_sliding(
    faces: Faces,
    beside: np.ndarray,
    rows: Rows,
    sides: Sides,
    slides: np.ndarray,
    ends: np.ndarray,
) -> np.ndarray:
    """Return which switches (N + 1, N + 1) sliding may lead to through edges and corners.

    Sliding gathers states on the edges of a face, where other cells meet: those across another face
    of one of its two cells that touches it. Faces have rows `beside` (F, 2); the loop may slide on
    `slides` (S,) of `sides`; `ends` (n,) are the finest cells along periodic axes, whose ends meet,
    and 0 along others.
    """
    number, count = rows.next.shape
    table = np.zeros((count, count), dtype=bool)
    cells, places = np.concatenate([faces.below, faces.above]), np.tile(np.arange(len(faces)), 2)
    order = np.argsort(cells, kind="stable")
    cells, places = cells[order], places[order]
    beyond = np.concatenate([beside[:, 1], beside[:, 0]])[order]  # the row there, from the cell
    for side in (faces.below, faces.above):
        cell = side[sides.face[slides]]
        start, stop = (np.searchsorted(cells, cell, end) for end in ("left", "right"))
        for part in _chunks(stop - start, MAX_PARTS):
            slide, within = ragged(stop[part] - start[part])
            entry, place = slides[part][slide], start[part][slide] + within
            face, other = sides.face[entry], places[place]
            low, high = faces.lower[face], faces.upper[face]
            low_other, high_other = faces.lower[other], faces.upper[other]
            touch = (low <= high_other) & (low_other <= high)
            touch |= (ends > 0) & (low == 0) & (high_other == ends)
            touch |= (ends > 0) & (low_other == 0) & (high == ends)
            touch = touch.all(axis=1)
            entry, far = entry[touch], beyond[place[touch]]
            for way in range(2):
                own, near = sides.labels[entry, way], sides.rows[entry, way]
                both = np.unique(own * number + far)
                moves = [(both % number, both // number)]
                pairs = np.unique(far * number + near)
                resident, label = rows.residents(pairs // number)
                moves.append((pairs[resident] % number, label))
                for numbers, labels in moves:
                    for _, before, after in rows.hops(numbers, labels):
                        table[before, after] = True
    return table


def _chunks(sizes: np.ndarray, most: int) -> Iterator[slice]:
    """Yield slices over sizes (K,) whose sums are at most a number, or of one size."""
    ends = np.cumsum(sizes)
    start = 0
    while start < len(sizes):
        before = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, before + most, "right")), start + 1)
        yield slice(start, stop)
        start = stop


def _from_outside(policy: Policy, rows: Rows, boxes: Boxes) -> np.ndarray:
    """Return which switches (N + 1, N + 1) the safe symbol takes where the loop comes back in."""
    table = np.zeros((rows.next.shape[1],) * 2, dtype=bool)
    if policy.remembers and not isinstance(policy.outside, str):
        outer = (boxes.lower == 0) | (boxes.upper == policy.cells.counts)
        outer = (outer & ~np.array(policy.space.periodic))[:, : policy.domain.n]
        numbers = np.unique(boxes.labels[outer.any(axis=1)])
        for _, before, after in rows.hops(numbers, np.full(len(numbers), policy.outside)):
            table[before, after] = True
    return table


def _exits(policy: Policy, rows: Rows, axis: int, boxes: Boxes) -> np.ndarray:
    """Return the rates (N + 1,) at which states leave the domain on one axis by symbol."""
    domain, counts = policy.space, policy.cells.counts
    rates = np.zeros(len(policy.alphabet) + 1)
    if domain.periodic[axis]:
        return rates
    ends = (boxes.lower[:, axis] == 0, 1), (boxes.upper[:, axis] == counts[axis], 0)
    for outer, side in ends:
        numbers = boxes.labels[outer]
        place, label = rows.residents(numbers)
        low, high = (
            domain.points(corner[outer][place], counts) for corner in (boxes.lower, boxes.upper)
        )
        at = (high if side == 0 else low)[:, axis]
        both = np.stack([label] * 2)
        faces = AxisFaces(policy, axis, low.T, high.T, np.stack([at, at]), both)
        _, flows, _ = faces.sampled()
        flow = flows[:, side] * rows.weights[numbers[place]]
        rates += np.bincount(label, flow, minlength=len(rates))
    return rates
