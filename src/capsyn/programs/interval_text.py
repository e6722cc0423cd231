"""Programs as C functions of boxes: the compiled form of `evaluate_intervals`."""

from __future__ import annotations

from capsyn.programs.patterns import alternatives, exhaustive, smoothed_root
from capsyn.programs.program import Program, c_number


def _rising(
    name: str, zero: str = "UNDEFINED", bottom: str = "-INFINITY", top: str = "INFINITY"
) -> str:
    return f"rising(m_{name}({{0}}.lo), m_{name}({{0}}.hi), {{0}}, {zero}, {bottom}, {top})"


def _with_poles(name: str, zero: str) -> str:
    return f"with_poles(m_{name}({{0}}.lo), m_{name}({{0}}.hi), {{0}}, {zero})"


def _corners(name: str, one: str = "{0}", two: str = "{1}") -> str:
    pairs = (f"{one}.{i}, {two}.{j}" for i in ("lo", "hi") for j in ("lo", "hi"))
    return f"corners({', '.join(f'm_{name}({pair})' for pair in pairs)})"


def _wave(name: str, peak: float) -> str:
    return f"wave(m_{name}({{0}}.lo), m_{name}({{0}}.hi), {{0}}, {peak})"


LIBRARY_FORMS = {
    "sqrt": _rising("sqrt", "0", "0"),
    "exp": _rising("exp", bottom="0"),
    "expm1": _rising("expm1", "0", "-1"),
    "log": _with_poles("log", "1"),
    "log1p": _with_poles("log1p", "0"),
    "pow": f"power({_corners('pow', 'base_of({0}, {1})')}, base_of({{0}}, {{1}}), {{1}})",
    "sin": f"odd({_wave('sin', 0.25)}, {{0}}, 3)",
    "cos": _wave("cos", 0.0),
    "tan": "poles_of_tan(m_tan({0}.lo), m_tan({0}.hi), {0})",
    "asin": _rising("asin", "0", "-PI_UP / 2", "PI_UP / 2"),
    "acos": "rising(m_acos({0}.hi), m_acos({0}.lo), {0}, UNDEFINED, 0, PI_UP)",
    "atan": _rising("atan", "0", "-PI_UP / 2", "PI_UP / 2"),
    "atan2": f"angle({_corners('atan2')}, {{0}}, {{1}})",
    "sinh": _rising("sinh", "0"),
    "cosh": "rising(m_cosh(magnitude({0}).lo), m_cosh(magnitude({0}).hi), magnitude({0}),"
    " UNDEFINED, 1, INFINITY)",
    "tanh": _rising("tanh", "0", "-1", "1"),
    "asinh": _rising("asinh", "0"),
    "acosh": _rising("acosh", bottom="0"),
    "atanh": _with_poles("atanh", "0"),
    "hypot": "length(m_hypot(magnitude({0}).lo, magnitude({1}).lo),"
    " m_hypot(magnitude({0}).hi, magnitude({1}).hi), magnitude({0}), magnitude({1}))",
    "erf": _rising("erf", "0", "-1", "1"),
}
"""Bounds of library functions in C; those of other operations are called ``i_NAME``."""


def interval_c(program: Program, function: str, inexact: frozenset[int] = frozenset()) -> str:
    """Return a C function that bounds a program over ``LANES`` boxes at once.

    Its arguments are the lower and the upper ends of all inputs, one after the other, ``const
    double (*)[LANES]``, and then those of all outputs. The text needs ``programs/intervals.c``
    before it, and what `capsyn.native.source.declarations` gives for the program. Values that are
    `inexact` are widened.
    """
    body = [
        f"        const interval v{k} = sound((interval){{lower[{k}][lane], upper[{k}][lane]}});"
        for k in range(program.input_count)
    ]
    for i, (name, *operands) in enumerate(program.instructions, start=program.input_count):
        if name == "const":
            number = c_number(operands[0])
            text = (
                f"widened({number}, {number}, ULP)" if i in inexact else f"{{{number}, {number}}}"
            )
        else:
            text = _operation(program, name, operands)
        body.append(f"        const interval v{i} = {text};")
    for k, value in enumerate(program.results):
        body.append(f"        low[{k}][lane] = v{value}.lo;")
        body.append(f"        high[{k}][lane] = v{value}.hi;")
    parameters = [f"const double (*restrict {name})[LANES]" for name in ("lower", "upper")]
    parameters += [f"double (*restrict {name})[LANES]" for name in ("low", "high")]
    return "\n".join(
        [f"static void {function}({', '.join(parameters)})", "{", "    EACH_LANE {", *body,
         "    }", "}", ""]
    )  # fmt: skip


def _operation(program: Program, name: str, operands: list[int]) -> str:
    """Return the bounds of an operation, undefined where those of an operand are."""
    names = [f"v{k}" for k in operands]
    chosen = alternatives(program, *operands) if name == "add" else None
    if chosen:
        return f"i_either({', '.join(f'v{k}' for k in chosen)})"
    root = smoothed_root(program, *operands) if name == "div" else None
    if root:
        text = f"i_smoothed({names[0]}, {c_number(root[0])}, {root[1]})"
    elif name == "mul" and operands[0] == operands[1]:
        text = f"i_square({names[0]})"
    elif name in LIBRARY_FORMS:
        text = LIBRARY_FORMS[name].format(*names)
    else:
        text = f"i_{name}({', '.join(names)})"
    if name == "add" and exhaustive(program, *operands):
        text = f"clip({text}, 1, 2)"
    if name == "select":  # the branch that is not taken may be undefined
        return text
    return f"undefined({' | '.join(f'unknown({v})' for v in sorted(set(names)))}, sound({text}))"
