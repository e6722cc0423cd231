"""The quantiser in C: from states or readings to lattice steps, with a status, and no library.

In double precision a step is estimated and, where the estimate is near a face, corrected by the
places of faces as capsyn computes them; the product is volatile, since a compiler may otherwise
contract it with the sum after it into one rounding. In single precision steps are looked up in a
table of faces, rounded up to floats: a float is at or beyond a face exactly when it is at or beyond
the rounded one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from capsyn.exports.c.code import Code
from capsyn.exports.c.language import Part, round_up, rows, search, with_called, z_type
from capsyn.modelling.domain import Box


def state_quantiser(code: Code, opening: str) -> Part:
    """Return the function ``opening(x, places)`` with the functions and tables that it calls.

    Places are states ``y`` in the domain's period where the tree compares these, else lattice steps
    ``z``: looked up in tables where there are faces, else estimated. Those of a state that is not
    finite are 0.
    """
    upper, n = code.prefix.upper(), code.plan.n
    finite = " && ".join(f"{code.prefix}_finite(x{i})" for i in range(n))
    zero = f"y[{{}}] = {code.literal(0.0)}" if code.direct else "z[{}] = 0"
    body = [
        *_declarations(code),
        f"    {code.prefix}_status status = {upper}_OK;",
        f"    if ({finite}) {{",
        *(line for i in range(n) for line in _outside(code, i)),
        *(line for i in range(n) for line in _place(code, i)),
        "    } else {",
        f"        status = {upper}_NOT_FINITE;",
        *(f"        {zero.format(i)};" for i in range(n)),
        "    }",
        "    return status;",
    ]
    text = with_called(_functions(code), "\n".join(["", opening, "{", *body, "}", ""]))
    return Part(text, frozenset({"FLOAT"} if any(map(len, code.faces or ())) else ()))


def _bounds(code: Code) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lower and upper bounds, and last states inside; floats reach what doubles do."""
    lower, upper = code.plan.policy.space.lower, code.plan.policy.space.upper
    if code.real == "float":
        return round_up(lower), round_up(upper), -round_up(-upper)
    return lower, upper, upper


def _wraps(code: Code, i: int) -> bool:
    """Return whether a state must be brought into its period to find its place."""
    periodic = code.plan.policy.space.periodic[i]
    return periodic and (code.faces is None or len(code.faces[i]) > 0)


def _functions(code: Code) -> list[str]:
    """Return what a quantiser may call, callees first."""
    domain, counts = code.plan.policy.space, code.tree.counts
    prefix, real, most = code.prefix, code.real, "FLT_MAX" if code.real == "float" else "DBL_MAX"
    finite = f"""
static bool {prefix}_finite({real} x)
{{
    return (x >= -{most}) && (x <= {most});
}}
"""
    scaled = f"""
/* Return the state of a reading; volatile: rounded before the sum. */
static {real} {prefix}_scaled({real} reading, {real} scale, {real} offset)
{{
    const volatile {real} part = reading * scale;
    return part + offset;
}}
"""
    steps = _step(prefix, code.integer, margin(domain, counts))
    if code.faces is not None:
        steps = [_rank(prefix, max(map(len, code.faces)) + 1)]
    return [finite, scaled, _wrap(prefix, real), *steps]


def _declarations(code: Code) -> list[str]:
    lines = [f"    const {code.real} x{i} = {_state(code, i)};" for i in range(code.plan.n)]
    for i, values in enumerate(code.faces or ()):
        if len(values):
            entries = rows([code.literal(face) for face in round_up(values)])
            table = f"static const float faces{i}[{len(values)}] CAPSYN_ROM"
            lines.insert(i, f"    {table} = {{\n{entries}\n    }};")
    return lines


def _state(code: Code, i: int) -> str:
    if not code.plan.folded:
        return f"x[{i}]"
    factors = f"{code.literal(code.plan.scale[i])}, {code.literal(code.plan.offset[i])}"
    return f"{code.prefix}_scaled(x[{i}], {factors})"


def _outside(code: Code, i: int) -> Iterator[str]:
    """Yield what tells states beyond the bounds of an axis."""
    if not code.plan.policy.space.periodic[i]:
        lower, _, last = _bounds(code)
        least, most = code.literal(lower[i]), code.literal(last[i])
        yield f"        if ((x{i} < {least}) || (x{i} > {most})) {{"
        yield f"            status = {code.prefix.upper()}_OUTSIDE;"
        yield "        }"


def _place(code: Code, i: int) -> Iterator[str]:
    """Yield what gives the place of a finite state on an axis."""
    domain, count = code.plan.policy.space, code.plan.counts[i]
    lower, upper, _ = _bounds(code)
    single = code.real == "float"
    width = float(upper[i]) - float(lower[i]) if single else float(domain.widths[i])
    bounds = f"{code.literal(lower[i])}, {code.literal(width)}"
    step, state = f"{code.prefix}_axis_step", f"x{i}"
    if _wraps(code, i):
        wrapped = f"{code.prefix}_wrapped({state}, {bounds}, {code.literal(upper[i])})"
        state = f"inner{i}"
        yield f"        const {code.real} {state} = {wrapped};"
    if code.direct:
        yield f"        y[{i}] = {state};"
    elif code.faces is None:
        scale = code.literal(count / domain.widths[i])
        yield f"        z[{i}] = {step}({state}, {bounds}, {scale}, {count});"
    elif len(code.faces[i]):
        yield f"        z[{i}] = {step}({state}, faces{i}, {len(code.faces[i]) + 1});"
    else:
        yield f"        z[{i}] = 0;"


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


def _step(prefix: str, integer: str, near: float) -> list[str]:
    least, most = (0.5, 0.5) if near < 0.5 else (0.0, 1.0)  # places that need no correction
    face = f"""
/* Return the place of a face; volatile: rounded before the sum. */
static double {prefix}_face(double lower, double width, {integer} k, {integer} count)
{{
    const volatile double part = width * ((double)k / (double)count);
    return lower + part;
}}
"""
    corrected = f"""
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
"""
    step = f"""
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
    return [face, corrected, step]


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
