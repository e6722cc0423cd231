"""What a function block is made of: its names."""

from __future__ import annotations

from dataclasses import dataclass

from capsyn.exports.identifiers import identifiers, renamed, wanted_name
from capsyn.exports.plan import Plan
from capsyn.exports.structured_text import cells as cells_text
from capsyn.exports.structured_text.lines import KEYWORDS

LONGEST_NAME = 32
"""Most characters of a name that are kept."""
FIXED = ("symbol", "status", "cycle")
"""Names that are the same in every block."""
LOCAL = ("z", "wanted", "started", "elapsed", "node", "value", "axis", "i")
TABLES = ("splits", "thresholds", "seconds", "planes")


@dataclass(frozen=True, eq=False)
class Block:
    """A function block that decides, with its name and those of its variables.

    `table` is whether loops walk through the tree, or the cells, as arrays, else IF statements in
    functions.
    `readings` (n) become `states` (n) and these `steps` (n) by the functions that it `calls`.
    `renamed` are names that are no identifiers, and what they became.
    """

    plan: Plan
    table: bool
    name: str
    readings: tuple[str, ...]
    states: tuple[str, ...]
    steps: list[str]
    controls: tuple[str, ...]
    calls: dict[str, str]
    renamed: dict[str, str]

    @staticmethod
    def of(plan: Plan, style: str, name: str | None) -> Block:
        """Return the block of a plan; for the arguments see the options of the target."""
        wanted = wanted_name(name, plan.policy.name)
        (block,) = identifiers([wanted[:LONGEST_NAME]], KEYWORDS, fold=True)
        n, calls = plan.n, {part: f"{block}_{part}" for part in ("wrap", "step", "tree")}
        steps = [f"z{i}" for i in range(n)]
        trees = [*cells_text.LOCAL, *cells_text.TABLES]
        if not plan.as_cells:
            trees = [f"{calls['tree']}{k}" for k in range(1, plan.tree.node_count)]
        kept = {*KEYWORDS, *FIXED, *LOCAL, *TABLES, *steps, block, *calls.values(), *trees}
        names = [*plan.policy.domain.names, *plan.policy.alphabet.inputs]
        chosen = identifiers([text[:LONGEST_NAME] for text in names], kept, fold=True)
        states = identifiers([f"state_{i}" for i in range(n)], {*kept, *chosen}, fold=True)
        new_names = renamed([wanted, *names], [block, *chosen])
        readings, controls = chosen[:n], chosen[n:]
        table = style != "nested"
        return Block(plan, table, block, readings, states, steps, controls, calls, new_names)
