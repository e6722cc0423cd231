"""What a module is made of, and what it looks like from outside."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass

from capsyn.cells.split_tree import SplitTree
from capsyn.errors import ProblemError
from capsyn.exports.identifiers import identifiers, renamed, wanted_name
from capsyn.exports.plan import Plan
from capsyn.exports.verilog.ports import Port, changed_share, width_of
from capsyn.exports.verilog.words import KEYWORDS
from capsyn.validation import whole_number

STAGE_LEVELS = 4
"""Levels of the tree in a stage of the pipeline, by default."""
MOST_LEVELS = 16
"""Most levels in a stage."""
LONGEST_NAME = 32
"""Most characters of a name that are kept."""
FIXED = frozenset(
    "clk rst valid_in valid_out symbol outside wanted held started CLOCK_HZ DWELL_CYCLES changes "
    "symbol_held outside_held valid_held decided outside_now outside_end outside_then valid_end "
    "valid_then".split()
)
"""Names that are the module's own."""
REMEMBERED = frozenset(
    "in_force follows gap core since kind level label least asked alike taken switches mixed "
    "level_now level_asked level_mixed level_taken unused_levels unused_in_force "
    "HOLD_OFF_CYCLES".split()
)
"""Those of modules that remember, too."""


@dataclass(frozen=True, eq=False)
class Module:
    """A circuit that decides, with its name and those of its inputs (n).

    `ports` (n) are those of fixed-point inputs; None: inputs are lattice steps. `clock` is the
    default frequency [Hz]. `renamed` are names that are no identifiers, and what they became. Each
    of the `stages` of the pipeline, 0 for none, has so many `levels` of the tree.
    """

    plan: Plan
    ports: tuple[Port, ...] | None
    clock: int
    name: str
    inputs: tuple[str, ...]
    renamed: dict[str, str]
    stages: int
    levels: int

    @staticmethod
    def of(
        plan: Plan,
        ports: tuple[Port, ...] | None,
        pipeline: bool | int,
        clock: int,
        name: str | None,
    ) -> Module:
        """Return the module of a plan; for the arguments see the options of the target."""
        wanted = wanted_name(name, plan.policy.name)
        fixed = {*FIXED, *(_remembered(plan) if plan.has_state else ())}
        (module,) = identifiers([wanted[:LONGEST_NAME]], {*KEYWORDS, *fixed})
        states, end = plan.policy.space.names, "" if ports else "_step"
        names = [text[:LONGEST_NAME] + end for text in states]
        own = {module, f"{module}_tb", *fixed, *filter(_is_inner, names)}
        own |= {f"{module}_next", f"{module}_sequence_tb"} if plan.has_state else set()
        inputs = identifiers(names, {*KEYWORDS, *own})
        changed = {state: port for state, name, port in zip(states, names, inputs) if port != name}
        depth, stages = max(1, plan.tree.depth), _stages(pipeline, max(1, plan.tree.depth))
        levels = math.ceil(depth / stages) if stages else depth
        stages = math.ceil(depth / levels) if stages else 0
        new_names = renamed([wanted], [module]) | changed
        return Module(plan, ports, clock, module, inputs, new_names, stages, levels)

    @property
    def tree(self) -> SplitTree:
        """The nodes of its tree."""
        return self.plan.tree.cells

    @property
    def symbol_bits(self) -> int:
        """Bits of the symbol."""
        return width_of(self.plan.default)

    @property
    def row_bits(self) -> int:
        """Bits of the number of a leaf, which is that of a row of transitions, or a symbol."""
        return width_of(self.rows - 1)

    @property
    def rows(self) -> int:
        """Numbers that leaves may have."""
        return len(self.plan.transitions)

    @property
    def has_state(self) -> bool:
        """Whether it has a core, which tells what follows a symbol in force."""
        return self.plan.has_state

    @property
    def core(self) -> str:
        """Name of the module that looks a state up."""
        return f"{self.name}_next" if self.has_state else self.name

    @property
    def direct(self) -> bool:
        """Whether the tree compares numbers of fixed-point ports; sums of a plane need steps."""
        return self.ports is not None and not len(self.tree.planes)

    @property
    def step_widths(self) -> list[int]:
        """Bits of the lattice steps."""
        return [width_of(count - 1) for count in self.tree.counts]

    @property
    def widths(self) -> list[int]:
        """Bits of the inputs."""
        return self.step_widths if self.ports is None else [port.bits for port in self.ports]

    @property
    def inner_widths(self) -> list[int]:
        """Bits of what the tree compares."""
        return self.widths if self.direct else self.step_widths

    @property
    def dwell(self) -> bool:
        """Whether it is one module with a minimum dwell time."""
        return self.plan.dwell > 0 and not self.has_state

    @property
    def tells(self) -> bool:
        """Whether it tells that a state is outside."""
        return self.ports is not None or self.plan.policy.gaps

    @property
    def clocked(self) -> bool:
        """Whether what looks a state up has a clock."""
        return self.stages > 0 or self.dwell

    @functools.cached_property
    def changed(self) -> float | None:
        """Share of states whose symbol the rounding of the ports changes; None without any."""
        return changed_share(self.plan, self.ports) if self.ports else None


def _remembered(plan: Plan) -> set[str]:
    """Return the names that a module has for remembering."""
    names = [f"{name}_{{}}" for name in ("held", "locked")] + ["HOLD_{}_CYCLES", "INPUT_{}_CYCLES"]
    numbers = range(max(plan.labels, plan.policy.alphabet.m))
    return {*REMEMBERED, *(name.format(k) for name in names for k in numbers)}


def _stages(pipeline: bool | int, depth: int) -> int:
    if pipeline is True:
        return math.ceil(depth / STAGE_LEVELS)
    stages = 0 if pipeline is False else whole_number("pipeline", pipeline, least=1, most=1000)
    if stages and depth > MOST_LEVELS * stages:
        least = math.ceil(depth / MOST_LEVELS)
        raise ProblemError(
            f"`pipeline` must be {least} stages at least for a tree of {depth} levels; got {stages}"
        )
    return stages


def _is_inner(text: str) -> bool:
    """Return whether a name may be one of the module's own wires."""
    return bool(re.fullmatch(r"(z|v|w|c|p|s|at|next|part|unused)_?\d+(_\d+)?", text))
