"""Target ``c``: C99 without memory management, input, output or library calls."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from capsyn.cells.split_tree import SplitTree
from capsyn.errors import ProblemError, warn
from capsyn.exports.c import dwell as c_dwell
from capsyn.exports.c.cmake import cmake
from capsyn.exports.c.language import (
    LONGEST_PREFIX,
    RESERVED,
    Part,
    comment,
    double_literal,
    float_literal,
    macros,
    rows,
    z_type,
)
from capsyn.exports.c.notes import heavy_tables, notes, told
from capsyn.exports.c.readings import counts as c_counts
from capsyn.exports.c.readings.quantiser import quantiser, ranked
from capsyn.exports.c.readings.single import check_single_precision, decide_single, share_changed
from capsyn.exports.c.styles.grid import grid
from capsyn.exports.c.styles.nested import nearest, nested
from capsyn.exports.c.styles.table import table
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name, identifiers, renamed
from capsyn.exports.made import Made
from capsyn.exports.plan import Plan
from capsyn.validation import finite_number, one_of

STYLES = ("table", "nested", "grid")
ARITHMETICS = ("lattice", "double", "float")


def files(
    plan: Plan,
    golden: Golden,
    *,
    style: str = "table",
    arithmetic: str = "lattice",
    readings: str = "real",
    name: str | None = None,
    tick: float = 1e-6,
) -> Made:
    """Return a header, a source, a snippet for CMake and an example.

    Parameters
    ----------
    style : "table", "nested" or "grid"
        A stream of bits (smallest), nested conditions, or a dense table of labels (fastest; up to
        65,536 cells).
    arithmetic : "lattice", "double" or "float"
        What a decision is made on: lattice steps, which a function gives for states in double
        precision; states in double precision; or in single precision.
    readings : "real", "int16" or "int32"
        What functions take: real numbers, or counts of a sensor, whole numbers of 16 or 32 bits.
        Scale and offset then go into a multiplication and a shift of whole numbers, a short list
        of counts or a table of the counts at which the step changes (a `CapsynWarning` says where
        tables take more than the tree), and nothing needs floating point. At every count of the
        integer the symbol is that of the state ``count * scale + offset``; on a
        periodic axis, where a turn must be a whole number of counts (within 0.001), that of the
        count in the turn that begins at the lower bound. The integer must reach the first and the
        last step of every axis. Counts may be coarser than steps, but not than a whole axis; the
        header says how many steps no count gives. Needs ``arithmetic`` lattice.
    name : str, optional
        What files and functions are called, made an identifier. Default: the policy's name.
    tick : float
        Unit of the time that a dwell time is measured in [s].
    """
    one_of("style", style, list(STYLES))
    one_of("arithmetic", arithmetic, list(ARITHMETICS))
    one_of("readings", readings, list(c_counts.READINGS))
    if readings != "real" and arithmetic != "lattice":
        raise ProblemError(f"`readings` {readings} needs `arithmetic` lattice; got {arithmetic}")
    tick = finite_number("tick", tick, above=0.0)
    if plan.labels > 1 << 15:
        raise ProblemError(f"target c has 16-bit symbols; the policy has {plan.labels}")
    code = Code.of(plan, style, arithmetic, readings, name, tick)
    prefix = code.prefix
    written = {
        f"{prefix}.h": code.header().encode(),
        f"{prefix}.c": code.source().encode(),
        "example.c": code.example().encode(),
        "CMakeLists.txt": cmake(plan, prefix).encode(),
    }
    vectors = decide_single(plan, golden.readings) if arithmetic == "float" else None
    if code.axes:
        vectors = c_counts.golden_counts(plan, code.axes, readings)
        if heavy := heavy_tables(plan, code.axes, readings, f"{prefix}_symbol"):
            warn(heavy)
    return Made(
        written, code.renamed, told(code.tree.counts, code.faces, code.axes), code.changed, vectors
    )


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
    readings: str
    axes: list[c_counts.CountAxis]

    @staticmethod
    def of(
        plan: Plan, style: str, arithmetic: str, readings: str, name: str | None, tick: float
    ) -> Code:
        """Return the code of a plan, its tree over faces where floats are looked up in tables."""
        wanted = plan.policy.name if name is None else name
        prefix = file_name(name, wanted)[:LONGEST_PREFIX]
        (prefix,) = identifiers([prefix], RESERVED, fold=True)
        tree, faces = plan.tree.cells, None
        if tree.depth == 0:
            style = "nested"  # nothing to look up
        if arithmetic == "float":
            check_single_precision(plan, tree)
            if style != "nested" or len(tree.planes):
                tree, faces = ranked(tree, plan.policy.domain)
        axes = [] if readings == "real" else c_counts.count_axes(plan, readings)
        return Code(plan, style, arithmetic, prefix, wanted, tick, tree, faces, readings, axes)

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
    def reading(self) -> str:
        """Type of what decisions are asked for."""
        return self.real if self.readings == "real" else f"{self.readings}_t"

    @property
    def integer(self) -> str:
        """Type of lattice steps."""
        return z_type(self.tree.counts)

    @property
    def symbols(self) -> list[str]:
        """Names of the symbols in capital letters."""
        return [name.upper() for name in identifiers(self.plan.symbol_names, fold=True)]

    @property
    def renamed(self) -> dict[str, str]:
        """Names that are no identifiers, and what they became."""
        symbols = zip(self.plan.symbol_names, self.symbols)
        changed = {old: new for old, new in symbols if old.upper() != new}
        return renamed([self.wanted], [self.prefix]) | changed

    @functools.cached_property
    def changed(self) -> float | None:
        """Share of states whose symbol rounding changes; None where none can."""
        return share_changed(self.plan) if self.real == "float" else None

    def about(self, role: str) -> str:
        """Return the comment that a file begins with."""
        return comment([*self.plan.header, f"Target c, {self.style}, {self.arithmetic}: {role}."])

    def header(self) -> str:
        """Return the header file."""
        plan, p, upper = self.plan, self.prefix, self.prefix.upper()
        symbols = ",\n".join(f"    {upper}_SYMBOL_{s} = {k}" for k, s in enumerate(self.symbols))
        n = plan.n
        inputs = len(plan.policy.alphabet.inputs)
        lattice = self.arithmetic == "lattice"
        includes = "#include <stdint.h>" if self.axes else "#include <float.h>\n#include <stdint.h>"
        text = f"""{self.about("header")}
{comment(notes(self.plan, self.arithmetic, self.axes, self.renamed, self.changed))}
#ifndef {upper}_H
#define {upper}_H

{includes}
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
            text += c_dwell.declarations(p, plan.dwell, self.tick, ticks)
        states = "readings" if plan.folded or self.axes else "states"
        lost = "" if self.axes else "; of those that are not finite 0"
        decisions = ""
        if lattice:
            decisions += f"""
/* Give the lattice steps of {states}{lost}. */
{p}_status {p}_quantise(const {self.reading} x[{n}], {self.integer} z[{n}]);
"""
        decisions += f"""
/* Return the symbol of {states}. */
int16_t {p}_decide(const {self.reading} x[{n}], {p}_status *status);
"""
        if plan.dwell:
            decisions += f"""
/* Return the symbol in force at tick `now`: that of {states}, or the one that must be held. */
int16_t {p}_step({p}_state *state, const {self.reading} x[{n}], uint32_t now,
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
        if self.arithmetic != "lattice" or self.axes:
            return text
        guard = f"#ifndef {self.prefix.upper()}_NO_DOUBLE /* else only steps can be decided */"
        return f"\n{guard}\n{text}\n#endif\n"

    def no_double(self) -> str:
        """Return the test for compilers whose double does not have 53 bits, or not always."""
        if self.real == "float" or self.axes:
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
        if self.style == "grid":
            return grid(self.tree, p, opening)
        public, planes = opening, not static and len(self.tree.planes)
        if planes:
            opening = f"static int16_t {p}_within({argument})"
        if self.style == "table":
            part = table(self.tree, p, opening)
        else:
            compares = self.arithmetic if self.direct else "lattice"
            part = nested(self.tree, self.plan.policy.domain, p, opening, argument, compares)
        if planes:
            part = replace(part, text=part.text + nearest(self.tree, p, public))
        return part

    def quantiser(self) -> Part:
        """Return the function from states to lattice steps, or to states in the period."""
        n, p, single = self.plan.n, self.prefix, self.real == "float"
        places = f"{self.real} y[{n}]" if self.direct else f"{self.integer} z[{n}]"
        static = "" if self.arithmetic == "lattice" else "static "
        opening = f"{static}{p}_status {p}_quantise(const {self.reading} x[{n}], {places})"
        if self.axes:
            return c_counts.counts_quantiser(self.plan, p, opening, self.axes)
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
            safe = "" if plan.safe == plan.gap else f"            symbol = {plan.safe};\n"
            gap = f"        if (symbol == {plan.gap}) {{\n{safe}"
            gap += f"            *status = {upper}_OUTSIDE;\n        }}\n"
        return f"""
int16_t {p}_decide(const {self.reading} x[{plan.n}], {p}_status *status)
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
int16_t {p}_step({p}_state *state, const {self.reading} x[{n}], uint32_t now,
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
        values = ", ".join(str(round(v)) if self.axes else self.literal(v) for v in middle)
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
    const {self.reading} x[{plan.n}] = {{{values}}};
    {p}_status status;
    int16_t symbol;
{declare}{call}    (void)printf("symbol %d, status %d\\n", (int)symbol, (int)status);
    (void)printf("control %g\\n", {first});
    return 0;
}}
"""
