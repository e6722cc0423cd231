"""The header of an export in C."""

from __future__ import annotations

from capsyn.exports.c import dwell, timers
from capsyn.exports.c.code import Code
from capsyn.exports.c.language import comment
from capsyn.exports.c.notes import notes
from capsyn.exports.text import spoken


def header(code: Code) -> str:
    """Return the header file."""
    plan, p, upper = code.plan, code.prefix, code.prefix.upper()
    symbols = ",\n".join(f"    {upper}_SYMBOL_{s} = {k}" for k, s in enumerate(code.symbols))
    bare = code.axes and not code.features
    includes = "#include <stdint.h>" if bare else "#include <float.h>\n#include <stdint.h>"
    return f"""{code.about("header")}
{comment(notes(code))}
#ifndef {upper}_H
#define {upper}_H

{includes}
{_no_double(code)}
#ifdef __cplusplus
extern "C" {{
#endif

#define {upper}_SYMBOLS {plan.labels}
#define {upper}_INPUTS {plan.policy.alphabet.m}

/* Symbols, as functions give them. */
enum {{
{symbols}
}};
{_none(code)}
typedef enum {{
    {upper}_OK = 0,
    {upper}_OUTSIDE = 1,
    {upper}_NOT_FINITE = 2
}} {p}_status;

/* What decisions are asked for{_order(code)}. */
typedef {code.reading} {p}_reading;

/*
 * Return one input of the control of a symbol. Of a number that is no symbol it is that of symbol
 * {plan.safe}, and of an input that does not exist 0.
 */
{code.real} {p}_control(int16_t symbol, uint16_t input);
{_of_steps(code)}{code.guarded(_of_states(code))}
#ifdef __cplusplus
}}
#endif

#endif
"""


def _order(code: Code) -> str:
    """Return what stands where in arrays of readings, where they are not of states alone."""
    told = code.plan.policy.exogenous
    states = f": {code.plan.policy.domain.n} state(s), then "
    return "" if told is None else f"{states}{told.n} exogenous input(s)"


def _none(code: Code) -> str:
    """Return the label that is in force before the first decision, where that matters."""
    if code.memory is None:
        return ""
    return f"""
/* In force before the first decision. */
enum {{
    {code.prefix.upper()}_NONE = {code.plan.default}
}};
"""


def _of_steps(code: Code) -> str:
    """Return the declarations of what lattice steps are enough for, and of the dwell time."""
    plan, text = code.plan, ""
    if code.arithmetic == "lattice":
        nearest = "teps beyond the lattice are taken as the nearest."
        told = f"/* Return the symbol of lattice steps; s{nearest} */"
        if code.memory is not None:
            told = comment([_follows(code, "at lattice steps"), f"S{nearest}"])
        text = f"""
{told}
int16_t {code.prefix}_symbol({code.in_force}const {code.integer} z[{plan.n}]);
"""
    if plan.has_state:
        text += timers.declarations(code)
    elif plan.dwell:
        text += dwell.declarations(code)
    return text


def _of_states(code: Code) -> str:
    """Return the declarations of what is asked for states or readings."""
    plan, p, n = code.plan, code.prefix, code.plan.n
    states = "readings" if plan.folded or code.axes else spoken(plan.policy, "states")
    lost = "" if code.axes else "; of those that are not finite 0"
    text = ""
    if code.arithmetic == "lattice":
        text += f"""
/* Give the lattice steps of {states}{lost}. */
{p}_status {p}_quantise(const {p}_reading x[{n}], {code.integer} z[{n}]);
"""
    told = f"/* Return the symbol of {states}. */"
    if code.memory is not None:
        told = comment([_follows(code, f"at {states}")])
    text += f"""
{told}
{code.decision};
"""
    if plan.has_state:
        told = f"in force from now on: what follows at {states}"
        if code.waits:
            told = f"in force at tick `now`: what follows at {states}, or what must be held"
        text += f"""
/* Return the symbol {told}. */
{timers.step_opening(code)};
"""
    elif plan.dwell:
        text += f"""
/* Return the symbol in force at tick `now`: that of {states}, or the one that must be held. */
int16_t {p}_step({p}_state *state, const {p}_reading x[{n}],
    uint32_t now, {p}_status *status);
"""
    return text


def _follows(code: Code, where: str) -> str:
    """Return what is said of functions that need the symbol in force."""
    return (
        f"Return the symbol that follows `in_force` {where}. A number that is no symbol stands for "
        f"{code.prefix.upper()}_NONE."
    )


def _no_double(code: Code) -> str:
    """Return the test for compilers whose double does not have 53 bits, or not always."""
    if code.real == "float" or (code.axes and not code.features):
        return ""
    lacking = f"#define {code.prefix.upper()}_NO_DOUBLE"
    if code.arithmetic == "double" or code.features:
        lacking = '#error "double precision is needed: export lattice or float"'
    return f"""
#ifdef DBL_MANT_DIG
#if DBL_MANT_DIG != 53
{lacking}
#endif
#endif
#ifdef FLT_EVAL_METHOD
#if (FLT_EVAL_METHOD == 2) || (FLT_EVAL_METHOD < 0)
{lacking}
#endif
#endif
"""
