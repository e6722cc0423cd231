"""The quantiser of integer readings in C: from counts to lattice steps, without floating point.

A state is ``count * scale + offset``, as everywhere, so that the step of a count never falls (or,
where the scale is negative, never rises) from one count to the next. It is found by
``(place * factor + addend) >> shift`` where such integers exist, else by a search in a table of the
counts at which the step changes. They are right at every count, since they are at the counts before
and behind each change.

Counts that the scale makes fall are turned around first, ``-1 - count``; below, "turned" counts are
those of which the state rises. On a periodic axis a turn must be a whole number of counts; counts
in other turns are brought into one by integer arithmetic.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from capsyn.errors import ProblemError
from capsyn.exports.c_language import Part, rows, z_type
from capsyn.exports.golden import GOLDEN, Golden, decide
from capsyn.exports.plan import Plan
from capsyn.random_streams import stream

READINGS = ("real", "int16", "int32")
"""What readings may be."""
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
    affine : (factor, addend, shift), optional
        The steps of places, where such integers exist.
    """

    falling: bool
    first: int
    top: int
    turn: int
    changes: np.ndarray
    inside: tuple[int, int]
    affine: tuple[int, int, int] | None

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
        if self.affine is None:
            return f"looked up in a table for p = {place}"
        factor, addend, shift = self.affine
        return f"(p * {factor} + {addend}) >> {shift} for p = {place}"


def count_axes(plan: Plan, readings: str) -> list[CountAxis]:
    """Return how counts become steps, for integers of a width.

    Raises
    ------
    ProblemError
        The integers do not reach the first and the last step of an axis, a count is wider than an
        axis, or a turn of a periodic axis is no whole number of counts.
    """
    return [_axis(plan, i, int(readings.removeprefix("int"))) for i in range(plan.n)]


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
        start = int(_least(states, np.array([lower]), near - 8, near + 8)[0])
        changes = _least(states, faces, start, start + turn - 1) - start
        first, top, inside = start % turn, turn - 1, (start, start + turn - 1)
    else:
        turn, low, high = 0, -(1 << (bits - 1)), (1 << (bits - 1)) - 1
        at = _least(states, faces, low, high)
        if len(at) and (at[0] == low or at[-1] > high):
            needed = 1 + int(np.ceil(most)).bit_length()
            raise _narrow(bits, name, lower, upper, needed)
        first = int(at[0]) - 1 if len(at) else 0
        top = int(at[-1]) - first if len(at) else 0
        changes = at - first
        bounds = np.array([lower, np.nextafter(upper, np.inf)])
        least, beyond = _least(states, bounds, low, high).tolist()
        inside = (least, beyond - 1)
    affine = _affine(changes, top)
    return CountAxis(falling, first, top, turn, changes, inside, affine)


def _narrow(bits: int, name: str, lower: float, upper: float, needed: int) -> ProblemError:
    return ProblemError(
        f"`readings` int{bits} does not reach every step of axis '{name}', [{lower:g}, {upper:g}]: "
        f"its counts need {needed} bits"
        + ("; take int32" if bits < needed <= 32 else "; take a larger `scale`")
    )


def _least(
    states: Callable[[np.ndarray], np.ndarray], bounds: np.ndarray, low: int, high: int
) -> np.ndarray:
    """Return the least whole numbers in [low, high] whose states reach bounds, else high + 1."""
    before = np.full(len(bounds), low - 1, dtype=np.int64)
    behind = np.full(len(bounds), high + 1, dtype=np.int64)
    while (behind - before > 1).any():
        middle = (before + behind) // 2
        reached = states(middle.astype(np.float64)) >= bounds
        open_ = behind - before > 1
        behind = np.where(open_ & reached, middle, behind)
        before = np.where(open_ & ~reached, middle, before)
    return behind


def _affine(changes: np.ndarray, top: int) -> tuple[int, int, int] | None:
    """Return (factor, addend, shift) that give the steps of places 0 .. top in 32 bits, or none.

    For a factor M and a shift S the addend A must hold ``M p + A >= k 2^S`` where step k begins,
    and ``M (p - 1) + A < (j + 1) 2^S`` where the step j before it ends. How far these bounds on A
    are apart is concave in M.
    """
    if top >= 1 << 31:
        return None
    later = np.unique(changes[(changes > 0) & (changes <= top)])
    begins, ends = np.append(0, later), np.append(later - 1, top)
    steps = np.searchsorted(changes, begins, side="right")
    last = int(steps[-1])
    for shift in range(32):
        if last << shift >= 1 << 32:
            break

        def bounds(factor: int, shift: int = shift) -> tuple[int, int]:
            least = int(((steps << shift) - factor * begins).max())
            return least, int((((steps + 1) << shift) - 1 - factor * ends).min())

        def room(factor: int) -> int:
            least, most = bounds(factor)
            return most - least

        low, high = 0, ((last + 1) << shift) // max(top, 1) + 1
        while low < high:
            middle = (low + high) // 2
            if room(middle + 1) > room(middle):
                low = middle + 1
            else:
                high = middle
        least, most = bounds(low)
        addend = max(least, 0)
        if addend <= most and low * top + addend < 1 << 32:
            return low, addend, shift
    return None


def golden_counts(plan: Plan, axes: list[CountAxis], readings: str) -> Golden:
    """Return golden vectors of counts: inside, around changes and bounds, anywhere, at limits."""
    limit = 1 << (int(readings.removeprefix("int")) - 1)
    rng = stream(0, GOLDEN)
    given, near = [], []
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
        given.append(-1 - turned if axis.falling else turned)
        near.append(-1 - inner if axis.falling else inner)
    found = decide(plan, np.column_stack(near).astype(np.float64))
    return dataclasses.replace(found, readings=np.column_stack(given))


def counts_quantiser(plan: Plan, prefix: str, opening: str, axes: list[CountAxis]) -> Part:
    """Return the function ``opening(x, z)``, x being counts, with what it needs."""
    integer = z_type(plan.tree.cells.counts)
    limit = 1 << (15 if "const int16_t x[" in opening else 31)
    tables = {i: _table(axis) for i, axis in enumerate(axes) if axis.affine is None}
    wide = any(not -(1 << 15) <= entry < 1 << 15 for table in tables.values() for entry in table)
    kind = "INT32" if wide else "INT16"
    text = ""
    if any(axis.affine and axis.top and not axis.turn for axis in axes):
        text += _place(prefix)
    if any(axis.turn & (axis.turn - 1) for axis in axes if axis.turn):
        text += _turned(prefix)
    if any(axis.turn and not axis.turn & (axis.turn - 1) for axis in axes):
        text += _masked(prefix)
    if any(axis.affine and axis.top for axis in axes):
        text += _affine_step(prefix, integer)
    if tables:
        text += _table_step(prefix, integer, kind)
    declared, body = [], []
    for i, entries in tables.items():
        declared.append(
            f"    static const {kind.lower()}_t counts{i}[{len(entries)}] CAPSYN_ROM = {{\n"
            f"{rows(list(map(_literal, entries)))}\n    }};"
        )
    for i, axis in enumerate(axes):
        turned = "-1 - " if axis.falling else ""
        declared.append(f"    const int32_t r{i} = {turned}(int32_t)x[{i}];")
        least, most = axis.inside
        beyond = [f"(r{i} < {_literal(least)})"] * (least > -limit)
        beyond += [f"(r{i} > {_literal(most)})"] * (most < limit - 1)
        if beyond and not axis.turn:
            body.append(f"    if ({' || '.join(beyond)}) {{")
            body += [f"        status = {prefix.upper()}_OUTSIDE;", "    }"]
        step = _step(prefix, i, axis)
        if step == "0":
            declared[-1] += f"\n    (void)r{i};" if axis.turn or not beyond else ""
        body.append(f"    z[{i}] = {step};")
    declared.append(f"    {prefix}_status status = {prefix.upper()}_OK;")
    lines = "\n".join([*declared, *body, "    return status;"])
    return Part(f"{text}\n{opening}\n{{\n{lines}\n}}\n", frozenset([kind] if tables else []))


def _table(axis: CountAxis) -> list[int]:
    """Return the places, or without turns the turned counts, at which steps from 1 on begin."""
    return (axis.changes + (0 if axis.turn else axis.first)).tolist()


def _literal(value: int) -> str:
    return str(value) if value > -(1 << 31) else f"({value + 1} - 1)"


def _step(prefix: str, i: int, axis: CountAxis) -> str:
    """Return the expression of the step of ``r<i>``."""
    if not len(axis.changes):
        return "0"
    if axis.turn:
        place = f"{prefix}_turned(r{i}, {axis.first}, {axis.turn})"
        if not axis.turn & (axis.turn - 1):
            place = f"{prefix}_masked(r{i}, {axis.first}uL, {axis.turn - 1}uL)"
    elif axis.affine:
        bounds = f"{_literal(axis.first)}, {_literal(axis.first + axis.top)}"
        place = f"{prefix}_place(r{i}, {bounds})"
    else:
        place = f"r{i}"
    if axis.affine is None:
        return f"{prefix}_axis_rank({place}, counts{i}, {len(axis.changes) + 1})"
    factor, addend, shift = axis.affine
    return f"{prefix}_axis_step({place}, {factor}uL, {addend}uL, {shift}u)"


def _place(prefix: str) -> str:
    return f"""
/* Return how far a count is behind the first; of counts beyond either end those at the end. */
static int32_t {prefix}_place(int32_t count, int32_t first, int32_t last)
{{
    int32_t place = 0;
    if (count >= last) {{
        place = last - first;
    }} else if (count > first) {{
        place = count - first;
    }} else {{
        /* the first */
    }}
    return place;
}}
"""


def _turned(prefix: str) -> str:
    return f"""
/* Return how far a count is behind the first, in its turn. */
static int32_t {prefix}_turned(int32_t count, int32_t first, int32_t turn)
{{
    int32_t place = count % turn;
    if (place < 0) {{
        place += turn;
    }}
    place -= first;
    if (place < 0) {{
        place += turn;
    }}
    return place;
}}
"""


def _masked(prefix: str) -> str:
    return f"""
/* Return how far a count is behind the first, in its turn of 2^k counts. */
static int32_t {prefix}_masked(int32_t count, uint32_t first, uint32_t mask)
{{
    const uint32_t place = ((uint32_t)count - first) & mask;
    return (int32_t)place;
}}
"""


def _affine_step(prefix: str, integer: str) -> str:
    return f"""
/* Return the step of a place; the numbers were made so that it is right at every count. */
static {integer} {prefix}_axis_step(int32_t place, uint32_t factor, uint32_t addend,
    uint8_t shift)
{{
    const uint32_t step = (((uint32_t)place * factor) + addend) >> shift;
    return ({integer})step;
}}
"""


def _table_step(prefix: str, integer: str, kind: str) -> str:
    return f"""
/* Return how many steps begin at a count or before it. */
static {integer} {prefix}_axis_rank(int32_t count, const {kind.lower()}_t begins[],
    {integer} steps)
{{
    {integer} low = 0;
    {integer} high = steps;
    while ((high - low) > 1) {{
        const {integer} middle = ({integer})(low + ((high - low) / 2));
        if (count >= CAPSYN_{kind}(&begins[middle - 1])) {{
            low = middle;
        }} else {{
            high = middle;
        }}
    }}
    return low;
}}
"""
