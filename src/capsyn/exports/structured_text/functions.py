"""The functions that a block calls: turns of a period, lattice steps, and the tree."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.exports.structured_text.block import Block
from capsyn.exports.structured_text.cuts import cut
from capsyn.exports.structured_text.lines import comment
from capsyn.exports.structured_text.pou import Pou, Variable
from capsyn.exports.text import broken, signed_sum

NESTING = 8
"""Most IFs in one another; deeper subtrees are functions of their own."""


def functions(block: Block) -> list[Pou]:
    """Return the functions that a block calls, each after those that it calls itself."""
    made = [wrap(block)] if block.wraps else []
    if block.used and block.numbers is None:
        made.append(step(block))
    if block.used and not block.table:
        made += tree_functions(block)
    return made


def wrap(block: Block) -> Pou:
    """Return the function that brings a state into its period."""
    name = block.calls["wrap"]
    body = f"""\
{name} := x;
IF (x < lower) OR (x >= upper) THEN
    rest := x - lower;
    negative := rest < 0.0;
    IF negative THEN
        rest := -rest;
    END_IF;
    width := upper - lower;
    part := width;
    doublings := 0;
    half := 0.5 * rest;
    WHILE part <= half DO
        part := 2.0 * part;
        doublings := doublings + 1;
    END_WHILE;
    WHILE doublings >= 0 DO
        IF rest >= part THEN
            rest := rest - part;
        END_IF;
        part := 0.5 * part;
        doublings := doublings - 1;
    END_WHILE;
    IF negative AND (rest > 0.0) THEN
        rest := width - rest;
    END_IF;
    rest := lower + rest;
    IF rest >= upper THEN
        rest := lower;
    END_IF;
    {name} := rest;
END_IF;"""
    return Pou(
        name,
        block.real,
        ("x in [lower, upper) by whole turns, exactly: only differences that do not round",),
        tuple(Variable(text, block.real) for text in ("x", "lower", "upper")),
        (),
        (
            *(Variable(text, block.real) for text in ("rest", "width", "part", "half")),
            Variable("doublings", "DINT"),
            Variable("negative", "BOOL"),
        ),
        tuple(body.splitlines()),
    )


def step(block: Block) -> Pou:
    """Return the function that gives the lattice step of a state."""
    name = block.calls["step"]
    body = f"""\
width := upper - lower;
first := 0;
last := count - 1;
WHILE first < last DO
    middle := last - (last - first) / 2;
    face := DINT_TO_LREAL(middle) / DINT_TO_LREAL(count);
    face := width * face + 0.0;
    face := lower + face;
    IF face <= x THEN
        first := middle;
    ELSE
        last := middle - 1;
    END_IF;
END_WHILE;
{name} := first;"""
    return Pou(
        name,
        "DINT",
        (
            "The lattice step that holds x: the last k with face(k) <= x, 0 to count - 1, where",
            "face(k) = lower + (upper - lower) * (k / count), every operation rounded to LREAL:",
            "adding 0.0 keeps compilers from fusing the product with the sum that follows.",
        ),
        (*(Variable(text, "LREAL") for text in ("x", "lower", "upper")), Variable("count", "DINT")),
        (),
        (
            *(Variable(text, "DINT") for text in ("first", "last", "middle")),
            *(Variable(text, "LREAL") for text in ("width", "face")),
        ),
        tuple(body.splitlines()),
    )


def called(block: Block, name: str) -> str:
    """Return a call of a function of the tree."""
    arguments = (block.steps[i] for i in block.used)
    return f"{name}({', '.join(f'{step} := {step}' for step in arguments)})"


def tree_functions(block: Block) -> list[Pou]:
    """Return the functions of the nested style, each after those that it calls."""
    tree, cuts = block.nodes, cut_off(block.nodes)
    roots, made, waiting = {0: block.calls["tree"]}, [], [0]

    def emit(node: int, depth: int, into: str) -> Iterable[str]:
        indent = 4 * depth * " "
        if tree.split[node] == LEAF:
            yield f"{indent}{into} := {tree.threshold[node]};"
        elif node in cuts and depth:
            roots[node] = f"{block.calls['tree']}{len(roots)}"
            waiting.append(node)
            yield from broken(f"{indent}{into} := {called(block, roots[node])};")
        else:
            yield from comment([cut(block.plan, node)], len(indent))
            yield from broken(f"{indent}IF {_compared(block, node)} THEN")
            yield from emit(int(tree.second[node]), depth + 1, into)
            yield f"{indent}ELSE"
            yield from emit(node + 1, depth + 1, into)
            yield f"{indent}END_IF;"

    inputs = tuple(Variable(block.steps[i], "DINT") for i in block.used)
    while waiting:
        node = waiting.pop()
        name = roots[node]
        made.append(Pou(name, "INT", (), inputs, (), (), tuple(emit(node, 0, name))))
    return made[::-1]


def cut_off(tree: SplitTree) -> set[int]:
    """Return the nodes whose subtrees are functions of their own, as few as can be.

    From the leaves on, a subtree is cut off where it is `NESTING` high and its parent is higher.
    """
    heights, cuts = [0] * tree.node_count, set()
    for node in range(tree.node_count - 1, -1, -1):
        if tree.split[node] == LEAF:
            continue
        children = (node + 1, int(tree.second[node]))
        full = [child for child in children if heights[child] == NESTING]
        cuts.update(full)
        heights[node] = 1 + max(0 if child in full else heights[child] for child in children)
    return cuts


def _compared(block: Block, node: int) -> str:
    tree = block.nodes
    split, threshold = int(tree.split[node]), int(tree.threshold[node])
    if split < tree.n:
        return f"{block.steps[split]} >= {threshold}"
    return f"{signed_sum(*_products(block, split - tree.n))} >= {threshold}"


def _products(block: Block, row: int) -> tuple[list[int], Iterator[str]]:
    plane = block.nodes.planes[row].tolist()
    return plane, (
        step if abs(factor) == 1 else f"{abs(factor)} * {step}"
        for factor, step in zip(plane, block.steps)
    )
