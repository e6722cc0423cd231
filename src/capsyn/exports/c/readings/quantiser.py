"""The quantiser in C: from states or readings to lattice steps, with a status, and no library.

In double precision a step is estimated and, where the estimate is near a face, corrected by the
places of faces as capsyn computes them; the product is volatile, since a compiler may otherwise
contract it with the sum after it into one rounding. In single precision steps are looked up in a
table of faces, rounded up to floats: a float is at or beyond a face exactly when it is at or beyond
the rounded one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.cells.split_tree import SplitTree
from capsyn.errors import ProblemError
from capsyn.exports.c.language import (
    Part,
    double_literal,
    float_literal,
    round_up,
    rows,
    search,
    z_type,
)
from capsyn.exports.plan import Plan
from capsyn.modelling.domain import Box

MOST_FACES = 16_000
"""Most faces in tables of floats: 64 kB are what 16 bits can point at."""


def ranked(tree: SplitTree, domain: Box) -> tuple[SplitTree, list[np.ndarray]]:
    """Return a tree over those faces alone that it compares with, and the faces of each axis.

    A tree with oblique splits is the same, with all faces, up to `MOST_FACES`.
    """
    total = sum(tree.counts) - tree.n
    if len(tree.planes) and total > MOST_FACES:
        raise ProblemError(
            f"`arithmetic` float tabulates all {total:,} faces of a tree with oblique splits; more "
            f"than {MOST_FACES:,} are too many: take lattice, with readings int16 where there are "
            "no doubles"
        )
    numbers = [np.arange(1, count) for count in tree.counts]
    threshold = tree.threshold.copy()
    if not len(tree.planes):
        for i in range(tree.n):
            at = tree.split == i
            numbers[i], rank = np.unique(tree.threshold[at], return_inverse=True)
            threshold[at] = rank.ravel() + 1
    counts = tuple(len(k) + 1 for k in numbers)
    faces = [domain.faces(i, k, tree.counts[i]) for i, k in enumerate(numbers)]
    return SplitTree(counts, tree.split, threshold, tree.second, tree.planes), faces


@dataclass(frozen=True)
class StateQuantiser:
    """The function from states or readings in floating point to places, with what it needs.

    Parameters
    ----------
    plan : Plan
        What is exported.
    prefix : str
        What names of functions begin with.
    single : bool
        Whether states are floats, else doubles.
    direct : bool
        Whether places are states ``y`` in the domain's period, else lattice steps ``z``.
    faces : arrays, optional
        Faces of each axis, for steps by a table. Default: estimated steps.
    """

    plan: Plan
    prefix: str
    single: bool
    direct: bool
    faces: list[np.ndarray] | None

    @property
    def real(self) -> str:
        """Type of states."""
        return "float" if self.single else "double"

    def literal(self, value: float) -> str:
        """Return a literal of the type of states."""
        return float_literal(np.float32(value)) if self.single else double_literal(value)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lower and upper bounds, and last states in the domain; floats reach what doubles do."""
        lower, upper = self.plan.policy.domain.lower, self.plan.policy.domain.upper
        if self.single:
            return round_up(lower), round_up(upper), -round_up(-upper)
        return lower, upper, upper

    def wraps(self, i: int) -> bool:
        """Whether a state must be brought into its period to find its place."""
        periodic = self.plan.policy.domain.periodic[i]
        return periodic and (self.faces is None or len(self.faces[i]) > 0)

    def part(self, opening: str) -> Part:
        """Return the function ``opening(x, places)`` with the functions and tables that it calls.

        A state that is not finite has the places 0.
        """
        upper, n = self.prefix.upper(), self.plan.n
        finite = " && ".join(f"{self.prefix}_finite(x{i})" for i in range(n))
        zero = f"y[{{}}] = {self.literal(0.0)}" if self.direct else "z[{}] = 0"
        body = [
            *self._declarations(),
            f"    {self.prefix}_status status = {upper}_OK;",
            f"    if ({finite}) {{",
            *(line for i in range(n) for line in self._outside(i)),
            *(line for i in range(n) for line in self._place(i)),
            "    } else {",
            f"        status = {upper}_NOT_FINITE;",
            *(f"        {zero.format(i)};" for i in range(n)),
            "    }",
            "    return status;",
        ]
        text = self._functions() + "\n".join(["", opening, "{", *body, "}", ""])
        return Part(text, frozenset() if self.faces is None else frozenset({"FLOAT"}))

    def _functions(self) -> str:
        """Return the functions that it calls."""
        domain, counts = self.plan.policy.domain, self.plan.tree.cells.counts
        text = _finite(self.prefix, self.real)
        if self.plan.folded:
            text += _scaled(self.prefix, self.real)
        if any(self.wraps(i) for i in range(self.plan.n)):
            text += _wrap(self.prefix, self.real)
        if self.faces is not None:
            text += _rank(self.prefix, max(map(len, self.faces)) + 1)
        elif not self.direct:
            text += _step(self.prefix, z_type(counts), margin(domain, counts))
        return text

    def _declarations(self) -> list[str]:
        """Return the declarations of the states, and of the faces of each axis."""
        lines = [f"    const {self.real} x{i} = {self._state(i)};" for i in range(self.plan.n)]
        for i, values in enumerate(self.faces or ()):
            if len(values):
                entries = rows([float_literal(face) for face in round_up(values)])
                table = f"static const float faces{i}[{len(values)}] CAPSYN_ROM"
                lines.insert(i, f"    {table} = {{\n{entries}\n    }};")
        return lines

    def _state(self, i: int) -> str:
        """Return the state of an axis."""
        if not self.plan.folded:
            return f"x[{i}]"
        factors = f"{self.literal(self.plan.scale[i])}, {self.literal(self.plan.offset[i])}"
        return f"{self.prefix}_scaled(x[{i}], {factors})"

    def _outside(self, i: int) -> Iterator[str]:
        """Yield what tells states beyond the bounds of an axis."""
        if not self.plan.policy.domain.periodic[i]:
            lower, _, last = self.bounds
            least, most = self.literal(lower[i]), self.literal(last[i])
            yield f"        if ((x{i} < {least}) || (x{i} > {most})) {{"
            yield f"            status = {self.prefix.upper()}_OUTSIDE;"
            yield "        }"

    def _place(self, i: int) -> Iterator[str]:
        """Yield what gives the place of a finite state on an axis."""
        domain, count = self.plan.policy.domain, self.plan.tree.cells.counts[i]
        lower, upper, _ = self.bounds
        width = float(upper[i]) - float(lower[i]) if self.single else float(domain.widths[i])
        bounds = f"{self.literal(lower[i])}, {self.literal(width)}"
        step, state = f"{self.prefix}_axis_step", f"x{i}"
        if self.wraps(i):
            wrapped = f"{self.prefix}_wrapped({state}, {bounds}, {self.literal(upper[i])})"
            state = f"inner{i}"
            yield f"        const {self.real} {state} = {wrapped};"
        if self.direct:
            yield f"        y[{i}] = {state};"
        elif self.faces is None:
            scale = double_literal(count / domain.widths[i])
            yield f"        z[{i}] = {step}({state}, {bounds}, {scale}, {count});"
        elif len(self.faces[i]):
            yield f"        z[{i}] = {step}({state}, faces{i}, {len(self.faces[i]) + 1});"
        else:
            yield f"        z[{i}] = 0;"


def _finite(prefix: str, real: str) -> str:
    most = "FLT_MAX" if real == "float" else "DBL_MAX"
    return f"""
static bool {prefix}_finite({real} x)
{{
    return (x >= -{most}) && (x <= {most});
}}
"""


def _scaled(prefix: str, real: str) -> str:
    return f"""
/* Return the state of a reading; volatile: rounded before the sum. */
static {real} {prefix}_scaled({real} reading, {real} scale, {real} offset)
{{
    const volatile {real} part = reading * scale;
    return part + offset;
}}
"""


def _wrap(prefix: str, real: str) -> str:
    f = "f" if real == "float" else ""
    return f"""
/* Return x brought into [lower, upper); every difference in the loop is exact. */
static {real} {prefix}_wrapped({real} x, {real} lower, {real} width, {real} upper)
{{
    {real} wrapped = x;
    if ((x < lower) || (x >= upper)) {{
        const bool negative = x < lower;
        {real} rest = x - lower;
        {real} part = width;
        uint16_t doublings = 0u;
        uint16_t i;
        bool less;
        if (negative) {{
            rest = -rest;
        }}
        less = part <= (0.5{f} * rest);
        while (less) {{
            part *= 2.0{f};
            ++doublings;
            less = part <= (0.5{f} * rest);
        }}
        for (i = 0u; i <= doublings; ++i) {{
            if (rest >= part) {{
                rest -= part;
            }}
            part *= 0.5{f};
        }}
        if (negative && (rest > 0.0{f})) {{
            rest = width - rest;
        }}
        wrapped = lower + rest;
        if (wrapped >= upper) {{
            wrapped = lower;
        }}
    }}
    return wrapped;
}}
"""


def margin(domain: Box, counts: Sequence[int]) -> float:
    """Return how near to a whole number an estimated place tells its step no more; 1: always.

    With u the spacing of floats at the bounds, a face as computed is within 5 u of its place
    without rounding, and an estimate ``(x - lower) * scale`` within 5 u of its own.
    """
    u = np.spacing(np.maximum(abs(domain.lower), abs(domain.upper)))
    near = float(np.max(16 * u * np.asarray(counts) / domain.widths))
    return near if near < 0.5 else 1.0


def _step(prefix: str, integer: str, near: float) -> str:
    least, most = (0.5, 0.5) if near < 0.5 else (0.0, 1.0)  # places that need no correction
    return f"""
/* Return the place of a face; volatile: rounded before the sum. */
static double {prefix}_face(double lower, double width, {integer} k, {integer} count)
{{
    const volatile double part = width * ((double)k / (double)count);
    return lower + part;
}}

/* Return the step that holds x, which is step k or a neighbour. */
static {integer} {prefix}_corrected(double x, double lower, double width, {integer} k,
    {integer} count)
{{
    {integer} step = k;
    if ((k > 0) && (x < {prefix}_face(lower, width, k, count))) {{
        step = ({integer})(k - 1);
    }} else if ((k < (count - 1))
        && (x >= {prefix}_face(lower, width, ({integer})(k + 1), count))) {{
        step = ({integer})(k + 1);
    }} else {{
        /* the estimate is right */
    }}
    return step;
}}

/* Return the step that holds x; of states beyond the axis the nearest. */
static {integer} {prefix}_axis_step(double x, double lower, double width, double scale,
    {integer} count)
{{
    double place = (x - lower) * scale;
    double within;
    {integer} k;
    if (place < {least!r}) {{
        place = {least!r};
    }}
    if (place > ((double)count - {most!r})) {{
        place = (double)count - {most!r};
    }}
    k = ({integer})place;
    within = place - (double)k;
    if ((within < {near!r}) || (within > (1.0 - {near!r}))) {{
        k = {prefix}_corrected(x, lower, width, k, count);
    }}
    return k;
}}
"""


def _rank(prefix: str, count: int) -> str:
    integer = z_type((count,))
    return f"""
/* Return how many faces x has reached. */
static {integer} {prefix}_axis_step(float x, const float faces[], {integer} count)
{{
{search(integer, "count", "x >= CAPSYN_FLOAT(&faces[middle - 1])")}
    return low;
}}
"""
