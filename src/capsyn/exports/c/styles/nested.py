"""C style ``nested``: the tree as nested conditions, cut into functions before it gets deep."""

from __future__ import annotations

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.exports.c.language import Part, literal, round_up, z_type
from capsyn.modelling.domain import Box

LEVELS = 20
"""Nested conditions of a function; C99 promises 127, clang refuses more than 255."""


def nested(
    tree: SplitTree, domain: Box, prefix: str, opening: str, argument: str, arithmetic: str
) -> Part:
    """Return the function ``opening(z or x)`` that gives the label.

    It compares lattice steps ``z`` if `arithmetic` is "lattice", else states ``x`` with the places
    of faces. `argument` is the declaration of these, for the functions of subtrees.
    """
    name = "z" if arithmetic == "lattice" else "x"

    def condition(node: int) -> str:
        split, threshold = int(tree.split[node]), int(tree.threshold[node])
        if split >= tree.n:
            plane = tree.planes[split - tree.n].tolist()
            factors = ["" if a == 1 else f"{a} * " for a in plane]  # 1 * would be dead code
            terms = [f"({factors[j]}(int32_t)z[{j}])" for j, a in enumerate(plane) if a]
            return f"({' + '.join(terms) or '0'}) < {threshold}"
        if arithmetic == "lattice":
            return f"z[{split}] < {threshold}"
        face = domain.faces(split, np.array([threshold]), tree.counts[split])
        face = face if arithmetic == "double" else round_up(face)
        return f"x[{split}] < {literal(face[0], arithmetic)}"

    def body(root: int) -> tuple[str, list[int]]:
        """Return the statements of a subtree, and the roots of those that it calls."""
        lines, calls = [], []
        todo: list[tuple[int | str, int]] = [(root, 1)]
        while todo:
            item, level = todo.pop()
            pad = "    " * level
            if isinstance(item, str):
                lines.append(pad + item)
            elif tree.split[item] == LEAF:
                lines.append(f"{pad}symbol = {int(tree.threshold[item])};")
            elif level > LEVELS:
                calls.append(item)
                lines.append(f"{pad}symbol = {prefix}_node_{item}({name});")
            else:
                lines.append(f"{pad}if ({condition(item)}) {{")
                todo += [("}", level), (int(tree.second[item]), level + 1)]
                todo += [("} else {", level), (item + 1, level + 1)]
        text = "\n".join(lines)
        if f"{name}[" not in text and not calls:
            text = f"    (void){name};\n{text}"
        return text, calls

    functions, roots = [], [0]
    while roots:
        root = roots.pop()
        text, calls = body(root)
        head = f"static int16_t {prefix}_node_{root}({argument})" if root else opening
        functions.append(f"\n{head}\n{{\n    int16_t symbol;\n{text}\n    return symbol;\n}}\n")
        roots += calls
    return Part("".join(reversed(functions)))


def nearest(tree: CellTree | SplitTree, prefix: str, opening: str, before: str = "") -> str:
    """Return the function ``opening(z)`` that gives ``<prefix>_within`` steps within the lattice.

    A tree that compares axes alone gives the symbol of the nearest step anyway, cells and a tree
    with planes do not. What is passed on `before` the steps has a comma behind it.
    """
    integer = z_type(tree.counts)
    lines = [
        f"    inner[{i}] = {prefix}_nearest(z[{i}], {count - 1});"
        for i, count in enumerate(tree.counts)
    ]
    body = "\n".join(lines)
    return f"""
static {integer} {prefix}_nearest({integer} step, {integer} last)
{{
    {integer} inner = step;
    if (step < 0) {{
        inner = 0;
    }} else if (step > last) {{
        inner = last;
    }} else {{
        /* in the lattice */
    }}
    return inner;
}}

{opening}
{{
    {integer} inner[{tree.n}];
{body}
    return {prefix}_within({before}inner);
}}
"""
