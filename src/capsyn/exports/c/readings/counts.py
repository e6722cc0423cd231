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
from capsyn.exports.c.language import Part, rows, z_type
from capsyn.exports.c.readings.lines import Line, line_of
from capsyn.exports.c.readings.places import (
    line_name,
    line_step,
    listed,
    masked,
    placed,
    table_step,
    turned,
)
from capsyn.exports.crossings import least_reaching
from capsyn.exports.golden import GOLDEN, Golden, decide
from capsyn.exports.plan import Plan
from capsyn.random_streams import stream

READINGS = ("real", "int16", "int32")
"""What readings may be."""
WHOLE = 1e-3
"""Counts by which a turn may miss a whole number."""
MOST_IN_LINE = 70
"""Characters of a function's name and arguments that stay in one line."""


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
    bits = _bits(readings)
    return [_axis(plan, i, bits) for i in (range(plan.n) if numbers is None else numbers)]


def _bits(readings: str) -> int:
    """Return the width of counts."""
    return int(readings.removeprefix("int"))


def _limit(readings: str) -> int:
    """Return how many counts there are from 0 on."""
    return 1 << (_bits(readings) - 1)


def _axis(plan: Plan, i: int, bits: int) -> CountAxis:
    domain, steps = plan.policy.domain, plan.tree.cells.counts[i]
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
            f"`readings` int{bits} does not reach axis '{name}', [{lower:g}, {upper:g}]: its "
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
            raise _narrow(bits, name, lower, upper, turn.bit_length())
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
            raise _narrow(bits, name, lower, upper, needed)
        first = int(at[0]) - 1 if len(at) else 0
        top = int(at[-1]) - first if len(at) else 0
        changes = at - first
        bounds = np.array([lower, np.nextafter(upper, np.inf)])
        least, beyond = least_reaching(states, bounds, low, high).tolist()
        inside = (least, beyond - 1)
    axis = CountAxis(falling, first, top, turn, changes, inside, None)
    coarse = not turn and len(changes) > top
    return dataclasses.replace(axis, line=line_of(changes, top, coarse, axis.entry))


def _narrow(bits: int, name: str, lower: float, upper: float, needed: int) -> ProblemError:
    return ProblemError(
        f"`readings` int{bits} does not reach every step of axis '{name}', [{lower:g}, {upper:g}]: "
        f"its counts need {needed} bits"
        + ("; take int32" if bits < needed <= 32 else "; take a larger `scale`")
    )


def golden_counts(plan: Plan, axes: list[CountAxis], readings: str) -> Golden:
    """Return golden vectors of counts: inside, around changes and bounds, anywhere, at limits."""
    limit = _limit(readings)
    rng = stream(0, GOLDEN)
    counts, in_turn = [], []
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
        inner = least + (turned - least) % axis.turn if axis.turn else turned
        counts.append(-1 - turned if axis.falling else turned)
        in_turn.append(-1 - inner if axis.falling else inner)
    golden = decide(plan, np.column_stack(in_turn).astype(np.float64))
    return dataclasses.replace(golden, readings=np.column_stack(counts))


def counts_quantiser(
    plan: Plan, prefix: str, opening: str, axes: list[CountAxis], readings: str
) -> Part:
    """Return the function ``opening(x, z)``, x being counts, with what it needs."""
    integer = z_type(plan.tree.cells.counts)
    limit = _limit(readings)
    tables = {name: table for i, axis in enumerate(axes) for name, table in _tables(i, axis)}
    wide = any(not -(1 << 15) <= entry < 1 << 15 for table in tables.values() for entry in table)
    kind = "INT32" if wide else "INT16"
    lines = [axis.line for axis in axes if axis.line and axis.top]
    text = ""
    if any(axis.line and axis.top and not axis.turn for axis in axes):
        text += placed(prefix)
    if any(axis.turn & (axis.turn - 1) for axis in axes if axis.turn):
        text += turned(prefix)
    if any(axis.turn and not axis.turn & (axis.turn - 1) for axis in axes):
        text += masked(prefix)
    for form in sorted({(line.wide, line.last > 0) for line in lines}):
        text += line_step(prefix, integer, *form)
    if any(line.listed for line in lines):
        text += listed(prefix, integer, kind)
    if any(axis.line is None for axis in axes):
        text += table_step(prefix, integer, kind)
    declared, body = [], []
    for name, entries in tables.items():
        declared.append(
            f"    static const {kind.lower()}_t {name}[{len(entries)}] CAPSYN_ROM = {{\n"
            f"{rows(list(map(_literal, entries)))}\n    }};"
        )
    for i, axis in enumerate(axes):
        around = "-1 - " if axis.falling else ""
        declared.append(f"    const int32_t r{i} = {around}(int32_t)x[{i}];")
        least, most = axis.inside
        beyond = [f"(r{i} < {_literal(least)})"] * (least > -limit)
        beyond += [f"(r{i} > {_literal(most)})"] * (most < limit - 1)
        if beyond and not axis.turn:
            body.append(f"    if ({' || '.join(beyond)}) {{")
            body += [f"        status = {prefix.upper()}_OUTSIDE;", "    }"]
        place = _place_of(prefix, i, axis)
        if axis.line and axis.line.listed:  # asked more than once
            declared.append(f"    const int32_t p{i} = {place};")
            place = f"p{i}"
        step = _step(prefix, i, axis, place, integer)
        if step == "0":
            declared[-1] += f"\n    (void)r{i};" if axis.turn or not beyond else ""
        body.append(f"    z[{i}] = {step};")
    declared.append(f"    {prefix}_status status = {prefix.upper()}_OK;")
    function = "\n".join([*declared, *body, "    return status;"])
    return Part(f"{text}\n{opening}\n{{\n{function}\n}}\n", frozenset([kind] if tables else []))


def _tables(i: int, axis: CountAxis) -> list[tuple[str, list[int]]]:
    """Return the tables of an axis and their names."""
    if axis.line is None:
        tables = [(f"counts{i}", axis.changes)]
    else:
        tables = [(f"less{i}", np.array(axis.line.less)), (f"more{i}", np.array(axis.line.more))]
    return [(name, (places + axis.begin).tolist()) for name, places in tables if len(places)]


def _literal(value: int) -> str:
    return str(value) if value > -(1 << 31) else f"({value + 1} - 1)"


def _place_of(prefix: str, i: int, axis: CountAxis) -> str:
    """Return the expression of what the step of ``r<i>`` is found from."""
    if axis.turn & (axis.turn - 1):
        return f"{prefix}_turned(r{i}, {axis.first}, {axis.turn})"
    if axis.turn:
        return f"{prefix}_masked(r{i}, {axis.first}uL, {axis.turn - 1}uL)"
    if axis.line is None:
        return f"r{i}"
    return f"{prefix}_place(r{i}, {_literal(axis.first)}, {_literal(axis.first + axis.top)})"


def _step(prefix: str, i: int, axis: CountAxis, place: str, integer: str) -> str:
    """Return the expression of the step at a place."""
    line = axis.line
    if not len(axis.changes):
        return "0"
    begin = axis.begin if line or axis.turn else 0  # a table without turns is asked of counts
    count = f"{place} {'-' if begin < 0 else '+'} {abs(begin)}" if begin else place
    if line is None:
        return f"{prefix}_axis_rank({count}, counts{i}, {len(axis.changes) + 1})"
    function = f"{prefix}_{line_name(line.wide, line.last > 0)}"
    addend = f"{line.addend}{'uLL' if line.wide else 'uL'}"
    last = f", {line.last}" if line.last else ""
    numbers = f"{line.factor}uL, {addend}, {line.shift}u{last}"
    gap = "\n        " if len(function + place + numbers) > MOST_IN_LINE else " "
    step = f"{function}({place},{gap}{numbers})"
    for sign, name, places in (("-", "less", line.less), ("+", "more", line.more)):
        if places:
            step += f"\n        {sign} {prefix}_axis_listed({count}, {name}{i}, {len(places)})"
    return f"({integer})({step})" if line.listed else step
