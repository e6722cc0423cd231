"""The quantiser of integer readings in C: from counts to lattice steps, without floating point.

A state is ``count * scale + offset``, as everywhere, so that the step of a count never falls (or,
where the scale is negative, never rises) from one count to the next. It is found by
``(place * factor + addend) >> shift``, in 32 bits or in 64, and a list of the counts at which that
is one off; where a table of the counts at which the step changes takes fewer bytes, by a search in
it. Both are right at every count, since they are at the counts before and behind each change.

Counts that the scale makes fall are turned around first, ``-1 - count``; below, "turned" counts are
those of which the state rises. On a periodic axis a turn must be a whole number of counts; counts
in other turns are brought into one by integer arithmetic.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.errors import ProblemError
from capsyn.exports import sequence as golden_sequences
from capsyn.exports.c.readings.lines import Line, line_of
from capsyn.exports.crossings import least_reaching
from capsyn.exports.golden import GOLDEN, Golden, decide
from capsyn.exports.plan import Plan
from capsyn.random_streams import stream

READINGS = ("real", "int16", "int32")
"""What readings may be."""
BITS = {"int16": 16, "int32": 32, "INT": 16, "DINT": 32}
"""Bits of counts, by the names of their types in C and in Structured Text."""
WHOLE = 1e-3
"""Counts by which a turn may miss a whole number."""


@dataclass(frozen=True)
class CountAxis:
    """How counts of one axis become steps.

    Parameters
    ----------
    falling : bool
        Whether the state falls as the count rises: counts are turned around.
    first, top : int
        Turned counts from ``first`` on are places 0 .. top; others are taken as the nearest place,
        or, where ``turn`` is given, brought into the turn.
    turn : int
        Counts of a turn of a periodic axis; 0 on others.
    changes : (C - 1,)
        The least place of each step from 1 on, ``top + 1`` where there is none.
    inside : (int, int)
        The least and the largest turned count in the domain; on a periodic axis in the turn that
        begins at the lower bound.
    line : Line, optional
        Whole numbers that give the steps of places. None: a table of the changes does.
    """

    falling: bool
    first: int
    top: int
    turn: int
    changes: np.ndarray
    inside: tuple[int, int]
    line: Line | None

    @property
    def missed(self) -> int:
        """Steps that no count gives."""
        reached = self.changes[self.changes <= self.top]
        return len(self.changes) - len(np.unique(reached[reached > 0]))

    @property
    def text(self) -> str:
        """The rule in one line."""
        first = self.first + self.falling
        place = "-r" if self.falling else "r"
        place += f" {'-' if first >= 0 else '+'} {abs(first)}" if first else ""
        place = f"({place}) mod {self.turn}" if self.turn else f"({place}) within 0 .. {self.top}"
        if self.line is None:
            return f"looked up in a table of {len(self.changes)} counts for p = {place}"
        return f"{self.line.text}, for p = {place}"

    @property
    def begin(self) -> int:
        """What place 0 is in tables, which then are of 16 bits if they can be."""
        if not self.turn:
            return self.first
        return -(1 << 15) if 1 << 15 <= self.top < 1 << 16 else 0

    @property
    def entry(self) -> int:
        """Bytes of an entry of a table."""
        return 2 if -(1 << 15) <= self.begin and self.begin + self.top < 1 << 15 else 4

    @property
    def table_bytes(self) -> int:
        """Bytes of the table, or of the lists."""
        return self.entry * (len(self.changes) if self.line is None else self.line.listed)


def count_axes(plan: Plan, readings: str, numbers: Sequence[int] | None = None) -> list[CountAxis]:
    """Return how counts of all axes, or of some numbers, become steps, for integers of a width.

    Raises
    ------
    ProblemError
        The integers do not reach the first and the last step of an axis, a count is wider than an
        axis, or a turn of a periodic axis is no whole number of counts.
    """
    return [_axis(plan, i, readings) for i in (range(plan.n) if numbers is None else numbers)]


def limit_of(readings: str) -> int:
    """Return how many counts there are from 0 on."""
    return 1 << (BITS[readings] - 1)


def _axis(plan: Plan, i: int, readings: str) -> CountAxis:
    bits = BITS[readings]
    domain, steps = plan.policy.space, plan.counts[i]
    scale, offset = float(plan.scale[i]), float(plan.offset[i])
    lower, upper, name = float(domain.lower[i]), float(domain.upper[i]), domain.names[i]
    falling = scale < 0

    def states(place: np.ndarray) -> np.ndarray:
        """Return the states of turned counts, held as floats."""
        return (-1 - place if falling else place) * scale + offset

    width = float(domain.widths[i])
    if abs(scale) > width:
        raise ProblemError(
            f"`scale` is coarser than axis '{name}': a count of {abs(scale):g} in a width of "
            f"{width:g}"
        )
    # counts that reach the bounds
    ends = [(bound - offset) / scale for bound in (lower, upper)]
    most = max(map(abs, ends))
    if most > 1 << 50:
        raise ProblemError(
            f"`readings` {readings} does not reach axis '{name}', [{lower:g}, {upper:g}]: its "
            f"bounds are at counts of up to {most:.4g}"
        )
    faces = domain.faces(i, np.arange(1, steps), steps)
    if domain.periodic[i]:
        turn = round(abs(width / scale))
        if abs(turn - abs(width / scale)) > WHOLE:
            raise ProblemError(
                f"`scale` must make a turn of the periodic axis '{name}' a whole number of counts; "
                f"got {abs(width / scale):.10g}"
            )
        if turn > 1 << min(bits, 31):
            raise _narrow(readings, name, lower, upper, turn.bit_length())
        near = int(min(-1 - e if falling else e for e in ends))
        start = int(least_reaching(states, np.array([lower]), near - 8, near + 8)[0])
        end = start + turn - 1
        seam = int(states(np.array([float(end)]))[0] >= upper)  # rounded: the lower bound again
        changes = least_reaching(states, faces, start, end - seam) - start + seam
        first, top, inside = (start - seam) % turn, turn - 1, (start, end)
    else:
        turn, low, high = 0, -(1 << (bits - 1)), (1 << (bits - 1)) - 1
        at = least_reaching(states, faces, low, high)
        if len(at) and (at[0] == low or at[-1] > high):
            needed = 1 + int(np.ceil(most)).bit_length()
            raise _narrow(readings, name, lower, upper, needed)
        first = int(at[0]) - 1 if len(at) else 0
        top = int(at[-1]) - first if len(at) else 0
        changes = at - first
        bounds = np.array([lower, np.nextafter(upper, np.inf)])
        least, beyond = least_reaching(states, bounds, low, high).tolist()
        inside = (least, beyond - 1)
    axis = CountAxis(falling, first, top, turn, changes, inside, None)
    coarse = not turn and len(changes) > top
    return dataclasses.replace(axis, line=line_of(changes, top, coarse, axis.entry))


def _narrow(readings: str, name: str, lower: float, upper: float, needed: int) -> ProblemError:
    wider = "int32" if readings.startswith("int") else "DINT"
    return ProblemError(
        f"`readings` {readings} does not reach every step of axis '{name}', "
        f"[{lower:g}, {upper:g}]: its counts need {needed} bits"
        + (f"; take {wider}" if BITS[readings] < needed <= 32 else "; take a larger `scale`")
    )


def golden_counts(plan: Plan, axes: list[CountAxis], readings: str) -> Golden:
    """Return golden vectors of counts: inside, around changes and bounds, anywhere, at limits."""
    limit = limit_of(readings)
    rng = stream(0, GOLDEN)
    counts = []
    for axis in axes:
        least, most = axis.inside
        begins = axis.changes[axis.changes <= axis.top] + (least if axis.turn else axis.first)
        beside = np.concatenate([begins, [least, most + 1]])
        turned = np.concatenate(
            [
                rng.integers(least, most + 1, 1000),
                rng.choice(beside, 1000) + rng.integers(-2, 2, 1000),
                rng.integers(-limit, limit, 400),
            ]
        )
        if axis.turn:  # in all turns
            turned = (turned + limit) % axis.turn - limit
            turned += axis.turn * rng.integers(2 * limit // axis.turn, size=len(turned))
        limits = np.resize([-limit, 1 - limit, -1, 0, limit - 2, limit - 1], 100)
        turned = rng.permutation(np.concatenate([np.clip(turned, -limit, limit - 1), limits]))
        counts.append(-1 - turned if axis.falling else turned)
    golden = decide(plan, _in_turn(axes, np.column_stack(counts)))
    return dataclasses.replace(golden, readings=np.column_stack(counts))


def sequence_counts(plan: Plan, axes: list[CountAxis], readings: str) -> golden_sequences.Sequence:
    """Return the golden sequence at counts; where a reading is lost they are anything."""
    limit = limit_of(readings)
    found = golden_sequences.golden_sequence(plan)
    counts = np.clip(np.rint(np.nan_to_num(found.readings)), -limit, limit - 1).astype(np.int64)
    made = golden_sequences.run(plan, _in_turn(axes, counts), found.period)
    return dataclasses.replace(made, readings=counts)


def _in_turn(axes: list[CountAxis], counts: np.ndarray) -> np.ndarray:
    """Return counts (..., n) as floats, those of periodic axes brought into one turn."""
    inner = np.empty(counts.shape)
    for i, axis in enumerate(axes):
        turned, least = -1 - counts[..., i] if axis.falling else counts[..., i], axis.inside[0]
        turned = least + (turned - least) % axis.turn if axis.turn else turned
        inner[..., i] = -1 - turned if axis.falling else turned
    return inner
