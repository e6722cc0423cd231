"""The quantiser in C: from states or readings to lattice steps, with a status, and no library.

In double precision a step is estimated and, where the estimate is near a face, corrected by the
places of faces as capsyn computes them; the product is volatile, since a compiler may otherwise
contract it with the sum after it into one rounding. In single precision steps are looked up in a
table of faces, rounded up to floats: a float is at or beyond a face exactly when it is at or beyond
the rounded one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capsyn.cells.split_tree import SplitTree
from capsyn.errors import ProblemError
from capsyn.exports.c.language import Part, double_literal, float_literal, round_up, rows, z_type
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


def quantiser(
    plan: Plan, prefix: str, opening: str, single: bool, faces: list[np.ndarray] | None
) -> Part:
    """Return the function ``opening(x, places)`` with what it needs.

    Parameters
    ----------
    single : bool
        Whether states are floats, else doubles.
    faces : arrays, optional
        Faces of each axis, for steps by a table. Default: estimated steps, or, where `opening`
        fills in states ``y``, states in the domain's period.
    """
    domain, n = plan.policy.domain, plan.n
    real = "float" if single else "double"
    counts = plan.tree.cells.counts
    states = " y[" in opening

    def literal(value: float) -> str:
        return float_literal(np.float32(value)) if single else double_literal(value)

    lower, upper = (round_up(domain.lower), round_up(domain.upper)) if single else (
        domain.lower, domain.upper,
    )  # fmt: skip
    last = -round_up(-domain.upper) if single else domain.upper
    text, reads = _finite(prefix, real), set()
    if plan.folded:
        text += _scaled(prefix, real)
    if any(domain.periodic[i] and (faces is None or len(faces[i])) for i in range(n)):
        text += _wrap(prefix, real)
    if faces is not None:
        text += _rank(prefix, max(len(k) for k in faces) + 1)
        reads.add("FLOAT")
    elif not states:
        text += _step(prefix, z_type(counts), margin(domain, counts))
    body = []
    for i in range(n):
        value = f"x[{i}]"
        if plan.folded:
            factors = f"{literal(plan.scale[i])}, {literal(plan.offset[i])}"
            value = f"{prefix}_scaled({value}, {factors})"
        body.append(f"    const {real} x{i} = {value};")
    for i, values in enumerate(faces or ()):
        if len(values):
            entries = rows([float_literal(face) for face in round_up(values)])
            table = (
                f"static const float faces{i}[{len(values)}] CAPSYN_ROM = {{\n{entries}\n    }};"
            )
            body.insert(i, f"    {table}")
    finite = " && ".join(f"{prefix}_finite(x{i})" for i in range(n))
    body += [
        f"    {prefix}_status status = {prefix.upper()}_OK;",
        f"    if ({finite}) {{",
    ]
    for i in range(n):
        if not domain.periodic[i]:
            body += [
                f"        if ((x{i} < {literal(lower[i])}) || (x{i} > {literal(last[i])})) {{",
                f"            status = {prefix.upper()}_OUTSIDE;",
                "        }",
            ]
    for i in range(n):
        value = f"x{i}"
        width = float(upper[i]) - float(lower[i]) if single else float(domain.widths[i])
        bounds = f"{literal(lower[i])}, {literal(width)}"
        if domain.periodic[i]:
            call = f"{prefix}_wrapped(x{i}, {bounds}, {literal(upper[i])})"
            if states or faces is None or len(faces[i]):
                body.append(f"        const {real} inner{i} = {call};")
                value = f"inner{i}"
        if states:
            body.append(f"        y[{i}] = {value};")
        elif faces is None:
            scale = double_literal(counts[i] / domain.widths[i])
            call = f"{prefix}_axis_step({value}, {bounds}, {scale}, {counts[i]})"
            body.append(f"        z[{i}] = {call};")
        elif len(faces[i]):
            call = f"{prefix}_axis_step({value}, faces{i}, {len(faces[i]) + 1})"
            body.append(f"        z[{i}] = {call};")
        else:
            body.append(f"        z[{i}] = 0;")
    body += ["    } else {", f"        status = {prefix.upper()}_NOT_FINITE;"]
    zero = f"y[{{}}] = {literal(0.0)}" if states else "z[{}] = 0"
    body += [f"        {zero.format(i)};" for i in range(n)]
    body += ["    }", "    return status;"]
    lines = "\n".join(body)
    return Part(f"{text}\n{opening}\n{{\n{lines}\n}}\n", frozenset(reads))


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
    {integer} low = 0;
    {integer} high = count;
    while ((high - low) > 1) {{
        const {integer} middle = ({integer})(low + ((high - low) / 2));
        if (x >= CAPSYN_FLOAT(&faces[middle - 1])) {{
            low = middle;
        }} else {{
            high = middle;
        }}
    }}
    return low;
}}
"""
