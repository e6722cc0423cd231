"""The functions that a block calls: turns of a period, lattice steps, and the tree."""

from __future__ import annotations

from collections.abc import Iterable

from capsyn.cells.split_tree import LEAF
from capsyn.exports.structured_text.block import Block
from capsyn.exports.text import broken, signed_sum

NESTING = 8
"""Most IFs in one another; deeper subtrees are functions of their own."""


def wrap(block: Block) -> list[str]:
    """Return the function that brings a state into its period."""
    return f"""\
(* x brought into [low, high) by whole turns, exactly: only differences that do not round *)
FUNCTION {block.calls["wrap"]} : LREAL
VAR_INPUT
    x : LREAL;
    low : LREAL;
    high : LREAL;
END_VAR
VAR
    rest : LREAL;
    turns : LREAL;
    doublings : DINT;
    negative : BOOL;
END_VAR
{block.calls["wrap"]} := x;
IF (x < low) OR (x >= high) THEN
    rest := x - low;
    negative := rest < 0.0;
    IF negative THEN
        rest := -rest;
    END_IF;
    turns := high - low;
    doublings := 0;
    WHILE turns <= 0.5 * rest DO
        turns := 2.0 * turns;
        doublings := doublings + 1;
    END_WHILE;
    WHILE doublings >= 0 DO
        IF rest >= turns THEN
            rest := rest - turns;
        END_IF;
        turns := 0.5 * turns;
        doublings := doublings - 1;
    END_WHILE;
    IF negative AND (rest > 0.0) THEN
        rest := (high - low) - rest;
    END_IF;
    rest := low + rest;
    IF rest >= high THEN
        rest := low;
    END_IF;
    {block.calls["wrap"]} := rest;
END_IF;
END_FUNCTION""".splitlines()


def step(block: Block) -> list[str]:
    """Return the function that gives the lattice step of a state."""
    return f"""\
(* The lattice step that holds x: the last k with face(k) <= x, from 0 to count - 1, where *)
(* face(k) = low + (high - low) * (k / count), every operation rounded to LREAL. *)
FUNCTION {block.calls["step"]} : DINT
VAR_INPUT
    x : LREAL;
    low : LREAL;
    high : LREAL;
    count : DINT;
END_VAR
VAR
    first : DINT;
    last : DINT;
    middle : DINT;
    face : LREAL;
END_VAR
first := 0;
last := count - 1;
WHILE first < last DO
    middle := last - (last - first) / 2;
    face := DINT_TO_LREAL(middle) / DINT_TO_LREAL(count);
    face := (high - low) * face;
    face := low + face;
    IF face <= x THEN
        first := middle;
    ELSE
        last := middle - 1;
    END_IF;
END_WHILE;
{block.calls["step"]} := first;
END_FUNCTION""".splitlines()


def tree_functions(block: Block) -> list[str]:
    """Return the functions of the nested style, each after those that it calls."""
    tree = block.plan.tree.cells
    roots, functions = {0: block.calls["tree"]}, []
    waiting = [0]
    arguments = ", ".join(block.steps)

    def emit(node: int, depth: int, into: str) -> Iterable[str]:
        indent = 4 * depth * " "
        if tree.split[node] == LEAF:
            yield f"{indent}{into} := {tree.threshold[node]};"
        elif depth == NESTING:
            roots[node] = f"{block.calls['tree']}{len(roots)}"
            waiting.append(node)
            yield from broken(f"{indent}{into} := {roots[node]}({arguments});")
        else:
            yield from broken(f"{indent}IF {_compared(block, node)} THEN")
            yield from emit(int(tree.second[node]), depth + 1, into)
            yield f"{indent}ELSE"
            yield from emit(node + 1, depth + 1, into)
            yield f"{indent}END_IF;"

    while waiting:
        node = waiting.pop()
        lines = ["", f"FUNCTION {roots[node]} : INT", "VAR_INPUT"]
        lines += [f"    {step} : DINT;" for step in block.steps]
        lines += ["END_VAR", *emit(node, 0, roots[node]), "END_FUNCTION"]
        functions.append(lines)
    return [line for lines in reversed(functions) for line in lines]


def _compared(block: Block, node: int) -> str:
    tree = block.plan.tree.cells
    split, threshold = int(tree.split[node]), int(tree.threshold[node])
    if split < tree.n:
        return f"{block.steps[split]} >= {threshold}"
    plane = tree.planes[split - tree.n].tolist()
    products = (f"{abs(factor)} * {step}" for factor, step in zip(plane, block.steps))
    return f"{signed_sum(plane, products) or '0'} >= {threshold}"
