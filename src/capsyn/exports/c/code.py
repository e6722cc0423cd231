"""What the files of an export in C have in common."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import Features
from capsyn.cells.split_tree import SplitTree
from capsyn.exports.c.language import LONGEST_PREFIX, RESERVED, comment, literal, z_type
from capsyn.exports.c.memory import Memory, memory_of
from capsyn.exports.c.readings.counts import CountAxis, count_axes
from capsyn.exports.c.readings.single import check_single_precision, ranked, share_changed
from capsyn.exports.feature_texts import features_of
from capsyn.exports.identifiers import file_name, identifiers, renamed, wanted_name
from capsyn.exports.plan import Plan
from capsyn.programs.texts import calls_library


@dataclass(frozen=True)
class Code:
    """What the files of an export have in common, with the options of the target.

    Files and functions are called `prefix`, and should have been called `wanted`. The `tree`, or
    cells, is what is written: over the `faces` of each axis, where these are looked up in tables
    of floats. `axes` say how counts become steps; there are none where readings are real numbers.
    Where the next symbol depends on the symbol in force, leaves are rows of a `memory`.
    """

    plan: Plan
    style: str
    arithmetic: str
    readings: str
    tick: float
    prefix: str
    wanted: str
    tree: CellTree | SplitTree
    faces: list[np.ndarray] | None
    axes: list[CountAxis]
    memory: Memory | None

    @staticmethod
    def of(
        plan: Plan, style: str, arithmetic: str, readings: str, name: str | None, tick: float
    ) -> Code:
        """Return the code of a plan, its tree over faces where floats are looked up in tables."""
        wanted = wanted_name(name, plan.policy.name)
        prefix = file_name(name, wanted)[:LONGEST_PREFIX]
        (prefix,) = identifiers([prefix], RESERVED, fold=True)
        memory = None
        if plan.policy.remembers:
            memory = memory_of(plan.policy if plan.as_cells else plan.tree)
        tree, faces = plan.cells if memory is None else memory.cells, None
        if isinstance(tree, SplitTree) and tree.depth == 0:
            style = "nested"  # nothing to look up
        if arithmetic == "float":
            check_single_precision(plan, tree)
            if style != "nested" or tree.has_planes:
                tree, faces = ranked(tree, plan.policy.space)
        axes = [] if readings == "real" else count_axes(plan, readings)
        return Code(
            plan, style, arithmetic, readings, tick, prefix, wanted, tree, faces, axes, memory
        )

    @property
    def asked(self) -> str:
        """What the function from readings to a symbol is called."""
        return "decide" if self.memory is None else "next"

    @property
    def decision(self) -> str:
        """How that function is declared."""
        p, x = self.prefix, f"const {self.prefix}_reading x[{self.plan.n}]"
        if self.memory is None:
            return f"int16_t {p}_decide({x}, {p}_status *status)"
        return f"int16_t {p}_next({self.in_force}{x},\n    {p}_status *status)"

    @property
    def stateful(self) -> bool:
        """Whether there is a state between decisions."""
        return self.plan.has_state or self.plan.dwell > 0

    @property
    def waits(self) -> bool:
        """Whether that state counts time."""
        return self.plan.waits if self.plan.has_state else self.plan.dwell > 0

    @property
    def in_force(self) -> str:
        """The argument of what depends on the symbol in force, before others."""
        return "" if self.memory is None else "int16_t in_force, "

    @property
    def features(self) -> Features | None:
        """Features that decisions evaluate, in double precision; a grid evaluates none."""
        return None if self.style == "grid" else features_of(self.tree)

    @property
    def library(self) -> bool:
        """Whether the code calls functions of ``math.h``."""
        return self.features is not None and calls_library(self.features.program)

    @property
    def direct(self) -> bool:
        """Whether the tree compares states themselves."""
        lattice = self.arithmetic == "lattice" or self.tree.has_planes
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

    @property
    def guards(self) -> bool:
        """Whether some of the code needs doubles of 53 bits, and the rest does without."""
        return self.arithmetic == "lattice" and not self.axes and not self.features

    def guarded(self, text: str) -> str:
        """Return text for compilers whose double has 53 bits, if it needs them."""
        if not self.guards:
            return text
        guard = f"#ifndef {self.prefix.upper()}_NO_DOUBLE /* else only steps can be decided */"
        return f"\n{guard}\n{text}\n#endif\n"

    def literal(self, value: float) -> str:
        """Return a literal of the type of states."""
        return literal(value, self.real)
