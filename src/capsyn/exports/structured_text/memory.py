"""What follows the symbol in force: rows of transitions, and inputs that are held on their own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.exports.plan import Plan
from capsyn.exports.structured_text.block import Block
from capsyn.exports.structured_text.lines import indented
from capsyn.exports.structured_text.pou import Pou, Variable, table
from capsyn.exports.text import WIDTH, broken


def has_rows(plan: Plan) -> bool:
    """Return whether leaves may be rows, in which the next symbol depends on that in force."""
    return len(plan.transitions) > plan.labels


def row_table(block: Block) -> list[Variable]:
    """Return the table of rows, if there is one: those that are not constant, after each other."""
    if not (has_rows(block.plan) and block.table):
        return []
    return [table("transitions", block.plan.transitions[block.plan.labels :].ravel())]


def followed(block: Block, now: str) -> list[str]:
    """Return what makes the row ``wanted`` the symbol that follows that in force, ``now``."""
    plan = block.plan
    if not has_rows(plan):
        return []
    if not block.table:
        call = f"{block.calls['row']}(row := wanted, in_force := {now})"
        return broken(f"wanted := {call};", WIDTH - 8)
    place = f"INT_TO_DINT(wanted - {plan.labels}) * {plan.labels} + INT_TO_DINT({now})"
    return [f"IF wanted > {plan.default} THEN", f"    wanted := transitions[{place}];", "END_IF;"]


def row_function(block: Block) -> list[Pou]:
    """Return the function that does it where there is no table, if rows are any."""
    if block.table or not has_rows(block.plan):
        return []
    name, used = block.calls["row"], used_rows(block.plan, block.nodes)
    body = [f"{name} := row;"]
    if used:
        body += ["CASE row OF"]
        for k in used:
            body += [f"    {k}:", *indented(_row(name, block.plan.transitions[k].tolist()), 2)]
        body += ["END_CASE;"]
    inputs = (Variable("row", "INT"), Variable("in_force", "INT"))
    about = ("What follows the symbol in force in a row; rows beyond those here have one symbol.",)
    return [Pou(name, "INT", about, inputs, (), (), tuple(body))]


def row_cases(row: list[int]) -> tuple[int, dict[str, list[int]]]:
    """Return the symbol that is next most often, and all others by the symbols in force.

    Of those that stay it is ``in_force``.
    """
    others = Counter(label for j, label in enumerate(row) if label != j)
    base = (others or Counter(row)).most_common(1)[0][0]
    cases: dict[str, list[int]] = {}
    for j, label in enumerate(row):
        if label != base:
            cases.setdefault("in_force" if label == j else str(label), []).append(j)
    return base, cases


def used_rows(plan: Plan, tree: SplitTree) -> list[int]:
    """Return the rows of a tree's leaves that are not constant."""
    rows = np.unique(tree.threshold[tree.split == LEAF])
    return rows[rows >= plan.labels].tolist()


def _row(name: str, row: list[int]) -> Iterator[str]:
    base, cases = row_cases(row)
    yield f"{name} := {base};"
    for text, labels in cases.items():
        tests = [f"in_force = {j}" for j in labels]
        if len(tests) > 1:
            tests = [f"({test})" for test in tests]
        yield from broken(f"IF {' OR '.join(tests)} THEN", WIDTH - 8)
        yield f"    {name} := {text};"
        yield "END_IF;"


def held_inputs(plan: Plan) -> list[int]:
    """Return the inputs that have least times of their own."""
    return np.flatnonzero(plan.policy.rules.input_holds).tolist()


def input_levels(plan: Plan) -> np.ndarray:
    """Return which value each label gives each held input, and all others together, (N + 1, C).

    Values of a column are numbered from 0 on; two labels of the same row have the same control.
    """
    controls = plan.policy.controls
    held = held_inputs(plan)
    others = np.delete(controls, held, axis=1)
    parts = [controls[:, [i]] for i in held] + [others] * (others.shape[1] > 0)
    levels = [np.unique(part, axis=0, return_inverse=True)[1].ravel() for part in parts]
    return np.stack(levels, axis=1)
