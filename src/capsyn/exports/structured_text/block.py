"""What a function block is made of: its types, its tree and its names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.exports.c.readings.counts import CountAxis, count_axes
from capsyn.exports.crossings import ranked_tree
from capsyn.exports.identifiers import identifiers, renamed, wanted_name
from capsyn.exports.plan import Plan
from capsyn.exports.structured_text import cells as cells_text
from capsyn.exports.structured_text.lines import real
from capsyn.exports.structured_text.words import KEYWORDS

LONGEST_NAME = 32
"""Most characters of a name that are kept."""
FIXED = ("symbol", "status", "cycle")
"""Names that are the same in every block."""
LOCAL = (
    "z wanted started rest node value axis i first last middle splits thresholds seconds planes"
).split()
REMEMBERED = (
    "in_force now row remaining off mixed place own asked other same levels transitions prices "
    "ratios ratio"
).split()
"""Those of blocks that remember, too."""


@dataclass(frozen=True, eq=False)
class Block:
    """A function block that decides, with its types, its tree and the names of its variables.

    `table` is whether loops walk through the tree, or the cells, as arrays, else IF statements in
    functions.
    Numbers are of type `real`, inputs of type `reading`. Where `numbers` says which faces of each
    axis are looked up in tables, the `tree` is over these, else it is the policy's; `axes` say how
    counts become steps, there are none where readings are real numbers. `readings` (n) become
    `states` (n), which where they are the same have the same name, and these `steps` (n) by the
    functions that it `calls`. `renamed` are names that are no identifiers, and what they became.
    Where readings or controls are called as variables of its own, `yielding` says what becomes of
    both names: these give way.
    """

    plan: Plan
    table: bool
    real: str
    reading: str
    tree: CellTree | SplitTree
    numbers: list[np.ndarray] | None
    axes: list[CountAxis]
    name: str
    readings: tuple[str, ...]
    states: tuple[str, ...]
    steps: list[str]
    controls: tuple[str, ...]
    calls: dict[str, str]
    renamed: dict[str, str]
    yielding: dict[str, str]

    @staticmethod
    def of(plan: Plan, style: str, real_kind: str, readings: str, name: str | None) -> Block:
        """Return the block of a plan; for the arguments see the options of the target."""
        axes = [] if readings == "real" else count_axes(plan, readings)
        tree: CellTree | SplitTree = plan.cells
        numbers = None
        if axes or real_kind == "REAL":
            tree, numbers = ranked_tree(tree)
        wanted = wanted_name(name, plan.policy.name)
        n, steps = plan.n, [f"z{i}" for i in range(plan.n)]
        local = {*LOCAL, *steps, *(f"faces{i}" for i in range(n))}
        local |= {*cells_text.LOCAL, *cells_text.TABLES} if isinstance(tree, CellTree) else set()
        parts = ["wrap", "step", "tree"]
        if plan.has_state:
            local |= {*REMEMBERED, *(f"rest{i}" for i in range(plan.policy.alphabet.m))}
            parts += ["row", "next"]
        kept = {*KEYWORDS, *FIXED, *local}
        (block,) = identifiers([wanted[:LONGEST_NAME]], kept, fold=True)
        calls = {part: f"{block}_{part}" for part in parts}
        kept |= {block, *calls.values()}
        if isinstance(tree, SplitTree):
            kept |= {f"{calls['tree']}{k}" for k in range(1, tree.node_count)}
        names = [*plan.policy.space.names, *plan.policy.alphabet.inputs]
        chosen = identifiers([text[:LONGEST_NAME] for text in names], kept, fold=True)
        states = identifiers([f"state_{i}" for i in range(n)], {*kept, *chosen}, fold=True)
        yielding = _yielding([text[:LONGEST_NAME] for text in names], chosen, local)
        shown = [yielding.get(text, text) for text in chosen]
        new_names = renamed([wanted, *names], [block, *shown])
        table, reading = style == "cells" or (style == "table" and tree.depth > 0), readings
        if axes:
            same = [reading == "DINT" and not (axis.falling or axis.turn) for axis in axes]
        else:
            periodic, reading = plan.policy.space.periodic, real_kind
            same = [not (_raw(plan, i) or periodic[i]) for i in range(n)]
        states = tuple(r if is_same else s for s, r, is_same in zip(states, chosen, same))
        return Block(
            plan, table, real_kind, reading, tree, numbers, axes, block, chosen[:n], states, steps,
            chosen[n:], calls, new_names, yielding,
        )  # fmt: skip

    @property
    def used(self) -> list[int]:
        """Axes that the tree compares along, or that cells have several steps along."""
        if isinstance(self.tree, CellTree):
            return [i for i, count in enumerate(self.tree.counts) if count > 1]
        along = np.zeros(self.tree.n, dtype=bool)
        split = self.tree.split[self.tree.split != LEAF]
        along[split[split < self.tree.n]] = True
        return np.flatnonzero(along | (self.tree.planes != 0).any(axis=0)).tolist()

    @property
    def nodes(self) -> SplitTree:
        """The tree, where cells are not written as they are."""
        assert isinstance(self.tree, SplitTree)
        return self.tree

    @property
    def raw(self) -> list[bool]:
        """Whether a reading is another number than its state, (n,)."""
        return [_raw(self.plan, i) for i in range(self.plan.n)]

    @property
    def wraps(self) -> list[int]:
        """Axes along which a state is brought into its period by a function."""
        return [i for i in self.used if self.plan.policy.space.periodic[i] and not self.axes]

    def literal(self, value: float) -> str:
        """Return a literal of the type of numbers."""
        return real(value, self.real)


def _yielding(names: Sequence[str], chosen: Sequence[str], local: set[str]) -> dict[str, str]:
    """Return what becomes of identifiers where names are those of local variables, and of these."""
    swaps: dict[str, str] = {}
    for plain, new in zip((identifiers([name])[0] for name in names), chosen):
        word = plain.lower()
        if new != plain and word in local and word not in KEYWORDS and word not in swaps:
            swaps |= {new: plain, word: new.lower()}
    return swaps


def _raw(plan: Plan, i: int) -> bool:
    return bool(plan.scale[i] != 1 or plan.offset[i] != 0)
