"""Target ``c``: C99 without memory management, input, output or library calls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsyn.errors import ProblemError
from capsyn.exports import c_dwell
from capsyn.exports.c_grid import grid
from capsyn.exports.c_language import (
    KEYWORDS,
    LONGEST_PREFIX,
    Part,
    comment,
    double_literal,
    float_literal,
    macros,
    rows,
    z_type,
)
from capsyn.exports.c_nested import nested
from capsyn.exports.c_quantiser import (
    check_single_precision,
    quantiser,
    ranked,
    share_changed_by_single_precision,
)
from capsyn.exports.c_table import table
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name, identifiers
from capsyn.exports.plan import Files, Plan
from capsyn.split_tree import SplitTree
from capsyn.validation import one_of

STYLES = ("table", "nested", "grid")
ARITHMETICS = ("lattice", "double", "float")


def files(
    plan: Plan,
    golden: Golden,
    *,
    style: str = "table",
    arithmetic: str = "lattice",
    name: str | None = None,
    tick: float = 1e-6,
) -> Files:
    """Return a header, a source, a snippet for CMake and an example.

    Parameters
    ----------
    style : "table", "nested" or "grid"
        A stream of bits (smallest), nested conditions, or a dense table of labels (fastest; up to
        65,536 cells).
    arithmetic : "lattice", "double" or "float"
        What a decision is made on: lattice steps, which a function gives for states in double
        precision; states in double precision; or in single precision.
    name : str, optional
        What files and functions are called, made an identifier. Default: the policy's name.
    tick : float
        Unit of the time that a dwell time is measured in [s].
    """
    one_of("style", style, list(STYLES))
    one_of("arithmetic", arithmetic, list(ARITHMETICS))
    if plan.labels > 1 << 15:
        raise ProblemError(f"target c has 16-bit symbols; the policy has {plan.labels}")
    code = Code.of(plan, style, arithmetic, name, tick)
    prefix = code.prefix
    return {
        f"{prefix}.h": code.header().encode(),
        f"{prefix}.c": code.source().encode(),
        "example.c": code.example().encode(),
        "CMakeLists.txt": code.cmake().encode(),
    }


@dataclass(frozen=True)
class Code:
    """What the files of an export have in common; see `files`."""

    plan: Plan
    style: str
    arithmetic: str
    prefix: str
    wanted: str
    tick: float
    tree: SplitTree
    faces: list[np.ndarray] | None

    @staticmethod
    def of(plan: Plan, style: str, arithmetic: str, name: str | None, tick: float) -> Code:
        """Return the code of a plan, its tree over faces where floats are looked up in tables."""
        wanted = plan.policy.name if name is None else name
        prefix = file_name(name, wanted, KEYWORDS)
        (prefix,) = identifiers([prefix[:LONGEST_PREFIX]], KEYWORDS)
        tree, faces = plan.tree.cells, None
        if tree.depth == 0:
            style = "nested"  # nothing to look up
        if arithmetic == "float":
            check_single_precision(tree, plan.policy.domain)
            if style != "nested" or len(tree.planes):
                tree, faces = ranked(tree, plan.policy.domain)
        return Code(plan, style, arithmetic, prefix, wanted, tick, tree, faces)

    @property
    def direct(self) -> bool:
        """Whether the tree compares states themselves."""
        lattice = self.arithmetic == "lattice" or len(self.tree.planes)
        return self.style == "nested" and not lattice

    @property
    def real(self) -> str:
        """Type of states."""
        return "float" if self.arithmetic == "float" else "double"

    @property
    def integer(self) -> str:
        """Type of lattice steps."""
        return z_type(self.tree.counts)

    def about(self, role: str) -> str:
        """Return the comment that a file begins with."""
        return comment([*self.plan.header, f"Target c, {self.style}, {self.arithmetic}: {role}."])

    def header(self) -> str:
        """Return the header file."""
        plan, p, upper = self.plan, self.prefix, self.prefix.upper()
        names = identifiers(plan.symbol_names, fold=True)
        symbols = ",\n".join(
            f"    {upper}_SYMBOL_{name.upper()} = {k}" for k, name in enumerate(names)
        )
        n = plan.n
        inputs = len(plan.policy.alphabet.inputs)
        lattice = self.arithmetic == "lattice"
        text = f"""{self.about("header")}
{comment(self.notes())}
#ifndef {upper}_H
#define {upper}_H

#include <float.h>
#include <stdint.h>
{self.no_double()}
#ifdef __cplusplus
extern "C" {{
#endif

#define {upper}_SYMBOLS {plan.labels}
#define {upper}_INPUTS {inputs}

/* Symbols, as functions give them. */
enum {{
{symbols}
}};

typedef enum {{
    {upper}_OK = 0,
    {upper}_OUTSIDE = 1,
    {upper}_NOT_FINITE = 2
}} {p}_status;

/* Controls of each symbol. */
extern const {self.real} {p}_controls[{upper}_SYMBOLS][{upper}_INPUTS];
"""
        if lattice:
            text += f"""
/* Return the symbol of lattice steps; steps beyond the lattice are taken as the nearest. */
int16_t {p}_symbol(const {self.integer} z[{n}]);
"""
        if plan.dwell:
            ticks = c_dwell.ticks_of(plan, self.tick)
            text += c_dwell.declarations(p, self.real, n, plan.dwell, self.tick, ticks)
        states = "readings" if plan.folded else "states"
        decisions = ""
        if lattice:
            decisions += f"""
/* Give the lattice steps of {states}; of those that are not finite 0. */
{p}_status {p}_quantise(const double x[{n}], {self.integer} z[{n}]);
"""
        decisions += f"""
/* Return the symbol of {states}. */
int16_t {p}_decide(const {self.real} x[{n}], {p}_status *status);
"""
        if plan.dwell:
            decisions += f"""
/* Return the symbol in force at tick `now`: that of {states}, or the one that must be held. */
int16_t {p}_step({p}_state *state, const {self.real} x[{n}], uint32_t now,
    {p}_status *status);
"""
        return f"""{text}{self.guarded(decisions)}
#ifdef __cplusplus
}}
#endif

#endif
"""

    def guarded(self, text: str) -> str:
        """Return text for compilers whose double has 53 bits, as what follows needs them."""
        if self.real == "float":
            return text
        if self.arithmetic == "double":
            return text
        guard = f"#ifndef {self.prefix.upper()}_NO_DOUBLE /* else only steps can be decided */"
        return f"\n{guard}\n{text}\n#endif\n"

    def no_double(self) -> str:
        """Return the test for compilers whose double does not have 53 bits, or not always."""
        if self.real == "float":
            return ""
        lacking = f"#define {self.prefix.upper()}_NO_DOUBLE"
        if self.arithmetic == "double":
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

    def notes(self) -> list[str]:
        """Return what a user must know, as lines."""
        plan = self.plan
        counts = ", ".join(map(str, plan.tree.cells.counts))
        lines = [
            f"Quantisation: the axes have {counts} equal steps. Step k of an axis with C steps "
            "holds the states face(k) <= x < face(k + 1), where face(k) = lower + (upper - lower) "
            "* (k / C), rounded as written in double precision; the upper bound belongs to the "
            "last step; periodic states are brought into [lower, upper) first. The tree compares "
            "steps: its symbol is the same for all states of a step, and quantising changes the "
            "symbol of 0 % of the states.",
        ]
        if self.arithmetic == "lattice":
            lines.append(f"Steps are {self.integer}: 0 to C - 1 fit.")
        if self.real == "float":
            share = share_changed_by_single_precision(plan)
            lines.append(
                "Single precision: the symbol is the policy's at the float state. Rounding states "
                f"to floats changed the symbol of {share:.3%} of 20,000 random states. A periodic "
                "state beyond its bounds is brought back in single precision."
            )
        lines.append(
            "Status: OUTSIDE of the domain, or NOT_FINITE, or OK. Symbols outside are those above."
        )
        if plan.policy.gaps:
            told = f"Symbol {plan.gap} of steps: no symbol, the state is OUTSIDE."
            lines.append(told if self.arithmetic == "lattice" else "Gaps are OUTSIDE, too.")
        if self.prefix != self.wanted:
            lines.append(f"Name '{self.wanted}' became {self.prefix}.")
        lines.append(
            "MISRA C:2012: deviations, of the category advisory only: 2.4 (symbols are for "
            "callers), 8.7 (callers may call every function of this file)."
        )
        names = identifiers(plan.symbol_names, fold=True)
        for k, name in enumerate(names):
            if name != plan.symbol_names[k]:
                lines.append(f"Symbol '{plan.symbol_names[k]}' became {name.upper()}.")
        return lines

    def source(self) -> str:
        """Return the source file."""
        parts = [self.decision(), self.quantiser()]
        reads = set().union(*(part.reads for part in parts))
        dwell, step = Part(""), ""
        if self.plan.dwell:
            dwell = c_dwell.functions(self.plan, self.prefix)
            reads |= dwell.reads
            step = self.step()
        states = parts[1].text + self.decide() + step
        if self.arithmetic == "lattice":
            states = self.guarded(states.rstrip("\n"))
        return f"""{self.about("source")}
#include "{self.prefix}.h"

#include <stdbool.h>

{macros(reads)}{self.controls()}{parts[0].text}{dwell.text}{states}"""

    def controls(self) -> str:
        """Return the table of controls."""
        p, upper = self.prefix, self.prefix.upper()
        entries = [
            "{" + ", ".join(self.literal(v) for v in row) + "}" for row in self.plan.policy.controls
        ]
        return (
            f"\nconst {self.real} {p}_controls[{upper}_SYMBOLS][{upper}_INPUTS] CAPSYN_ROM = {{\n"
            f"{rows(entries, 4)}\n}};\n"
        )

    def literal(self, value: float) -> str:
        """Return a literal of the type of states."""
        return float_literal(np.float32(value)) if self.real == "float" else double_literal(value)

    def decision(self) -> Part:
        """Return the function that gives the symbol of lattice steps or of states."""
        n, p = self.plan.n, self.prefix
        argument = f"const {self.real} x[{n}]" if self.direct else f"const {self.integer} z[{n}]"
        static = "" if self.arithmetic == "lattice" else "static "
        opening = f"{static}int16_t {p}_symbol({argument})"
        if self.style == "table":
            return table(self.tree, p, opening)
        if self.style == "grid":
            return grid(self.tree, p, opening)
        compares = self.arithmetic if self.direct else "lattice"
        return nested(self.tree, self.plan.policy.domain, p, opening, argument, compares)

    def quantiser(self) -> Part:
        """Return the function from states to lattice steps, or to states in the period."""
        n, p, single = self.plan.n, self.prefix, self.real == "float"
        places = f"{self.real} y[{n}]" if self.direct else f"{self.integer} z[{n}]"
        static = "" if self.arithmetic == "lattice" else "static "
        opening = f"{static}{p}_status {p}_quantise(const {self.real} x[{n}], {places})"
        return quantiser(self.plan, p, opening, single, self.faces)

    def decide(self) -> str:
        """Return the function that gives the symbol of states."""
        plan, p, upper = self.plan, self.prefix, self.prefix.upper()
        if plan.nearest:
            known = f"*status != {upper}_NOT_FINITE"
        else:
            known = f"*status == {upper}_OK"
        gap = ""
        if plan.policy.gaps:
            gap = f"        if (symbol == {plan.gap}) {{\n            symbol = {plan.safe};\n"
            gap += f"            *status = {upper}_OUTSIDE;\n        }}\n"
        return f"""
int16_t {p}_decide(const {self.real} x[{plan.n}], {p}_status *status)
{{
    {self.real if self.direct else self.integer} places[{plan.n}];
    int16_t symbol = {plan.safe};
    *status = {p}_quantise(x, places);
    if ({known}) {{
        symbol = {p}_symbol(places);
{gap}    }}
    return symbol;
}}
"""

    def step(self) -> str:
        """Return the function that gives the symbol of states, dwell time allowing."""
        p, n = self.prefix, self.plan.n
        return f"""
int16_t {p}_step({p}_state *state, const {self.real} x[{n}], uint32_t now,
    {p}_status *status)
{{
    const int16_t symbol = {p}_decide(x, status);
    return {p}_hold(state, symbol, now);
}}
"""

    def example(self) -> str:
        """Return a program that decides at the middle of the domain."""
        plan, p, domain = self.plan, self.prefix, self.plan.policy.domain
        middle = ((domain.lower + domain.widths / 2) - plan.offset) / plan.scale
        values = ", ".join(self.literal(v) for v in middle)
        declare = f"    {p}_state state;\n" if plan.dwell else ""
        call = f"    symbol = {p}_decide(x, &status);\n"
        if plan.dwell:
            call = f"    {p}_init(&state);\n    symbol = {p}_step(&state, x, 0u, &status);\n"
        first = ("(double)" if self.real == "float" else "") + f"{p}_controls[symbol][0]"
        return f"""{self.about("example")}
#include <stdio.h>

#include "{p}.h"

int main(void)
{{
    const {self.real} x[{plan.n}] = {{{values}}};
    {p}_status status;
    int16_t symbol;
{declare}{call}    (void)printf("symbol %d, status %d\\n", (int)symbol, (int)status);
    (void)printf("control %g\\n", {first});
    return 0;
}}
"""

    def cmake(self) -> str:
        """Return the snippet for CMake."""
        p = self.prefix
        about = "\n".join(f"# {line}" for line in self.plan.header)
        return f"""{about}
cmake_minimum_required(VERSION 3.10)
project({p} C)
add_library({p} STATIC {p}.c)
set_target_properties({p} PROPERTIES C_STANDARD 99 C_STANDARD_REQUIRED ON)
target_include_directories({p} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
# what a program does not use is left out by -Wl,--gc-sections
target_compile_options({p} PRIVATE -ffunction-sections -fdata-sections)
"""
