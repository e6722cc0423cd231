"""A tree as a circuit: ifs in blocks of their own, or stages with registers between them.

It compares wires ``z0 .. z<n-1>``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from capsyn.cells.split_tree import LEAF
from capsyn.exports.text import broken, signed_sum
from capsyn.exports.verilog.module import Module
from capsyn.exports.verilog.ports import width_of
from capsyn.exports.verilog.words import signed

NESTING = 8
"""Most ifs in one another; deeper subtrees are blocks of their own."""
_Leaf = Callable[[int, int], str | None]


def _test(module: Module, node: int, end: str) -> str:
    """Return the comparison of a node; `end` is that of the names of a stage."""
    split, threshold = int(module.tree.split[node]), int(module.tree.threshold[node])
    if split >= module.plan.n:
        width = _sum_bits(module, node)
        return f"s{split - module.plan.n} >= {signed(threshold, width)}"
    if module.direct and module.ports:
        face = module.ports[split].face(threshold)
        return f"z{split}{end} >= {signed(face, module.inner_widths[split])}"
    return f"z{split}{end} >= {module.inner_widths[split]}'d{threshold}"


def _sum_bits(module: Module, node: int) -> int:
    row = module.tree.planes[int(module.tree.split[node]) - module.plan.n].tolist()
    most = sum(abs(c) * count for c, count in zip(row, module.tree.counts))
    return width_of(max(most, abs(int(module.tree.threshold[node])))) + 2


def _sum(module: Module, node: int, end: str) -> list[str]:
    """Return the wire of the sum that an oblique node compares."""
    row = int(module.tree.split[node]) - module.plan.n
    bits, plane = _sum_bits(module, node), module.tree.planes[row].tolist()
    wide = (
        f"$signed({{{bits - width}'d0, z{i}{end}}})" for i, width in enumerate(module.inner_widths)
    )
    products = (f"{bits}'sd{abs(factor)} * {step}" for factor, step in zip(plane, wide))
    total = signed_sum(plane, products) or signed(0, bits)
    return broken(f"    wire signed [{bits - 1}:0] s{row} = {total};")


def combinational(module: Module) -> list[str]:
    """Return the whole tree without registers."""
    tree, top = module.tree, module.row_bits - 1
    lines = [f"    wire [{top}:0] decided;"]
    for node in (tree.split >= module.plan.n).nonzero()[0].tolist():
        lines += _sum(module, node, "")
    if tree.split[0] == LEAF:
        lines.append(f"    assign decided = {module.row_bits}'d{tree.threshold[0]};")
    else:
        parts, waiting, blocks = {0: "part0"}, [0], []

        def leaf(node: int, depth: int) -> str | None:
            if tree.split[node] == LEAF:
                return f"{module.row_bits}'d{tree.threshold[node]}"
            if depth < NESTING:
                return None
            parts[node] = f"part{len(parts)}"
            waiting.append(node)
            return parts[node]

        while waiting:
            node = waiting.pop()
            rows = [f"    reg [{top}:0] {parts[node]};", "    always @* begin"]
            blocks.append(rows + list(_ifs(module, node, parts[node], "", leaf, 2)) + ["    end"])
        lines += [line for block in reversed(blocks) for line in block]
        lines.append("    assign decided = part0;")
    lines += ["    wire outside_end = outside_now;"] * bool(module.ports)
    return lines + ["    wire valid_end = valid_in;"] * module.clocked


def _ifs(module: Module, node: int, into: str, end: str, leaf: _Leaf, level: int) -> Iterator[str]:
    """Yield the ifs of a subtree; `leaf` gives the values of nodes where they end."""
    indent = "    " * level

    def branch(child: int) -> Iterator[str]:
        value = leaf(child, level - 1)
        if value is not None:
            yield f"{indent}    {into} = {value};"
        else:
            yield from _ifs(module, child, into, end, leaf, level + 1)

    yield f"{indent}if ({_test(module, node, end)}) begin"
    yield from branch(int(module.tree.second[node]))
    yield f"{indent}end else begin"
    yield from branch(node + 1)
    yield f"{indent}end"


def pipelined(module: Module, used: list[int]) -> list[str]:
    """Return the stages: each goes some levels down, from a label or a subtree to another."""
    tree, labels, depths = module.tree, module.rows, module.tree.depths
    inner, stages = tree.split != LEAF, (depths // module.levels).tolist()
    nodes = inner.nonzero()[0].tolist()
    heads = [
        (inner & (depths == stage * module.levels)).nonzero()[0].tolist()
        for stage in range(module.stages + 1)
    ]
    bits = [width_of(labels + len(nodes) - 1) for nodes in heads]
    last = {
        i: max((stages[node] for node in nodes if _uses(module, node, i)), default=0) for i in used
    }
    sign = " signed" if module.direct else ""
    lines, clock = [], ["    always @(posedge clk) begin"]
    for i in used:
        for stage in range(last[i] + 1):
            lines.append(f"    reg{sign} [{module.inner_widths[i] - 1}:0] z{i}_{stage};")
            clock.append(f"        z{i}_{stage} <= z{i}{f'_{stage - 1}' if stage else ''};")
    root = f"{bits[0]}'d{labels}" if inner[0] else f"{bits[0]}'d{tree.threshold[0]}"
    lines.append(f"    wire [{bits[0] - 1}:0] at_0 = {root};")
    for stage in range(module.stages):
        lines += _stage(module, stage, heads, bits)
        clock.append(f"        at_{stage + 1} <= next_{stage};")
    delay = module.stages + 1
    if module.ports:
        lines.append(f"    reg [{delay - 1}:0] outside_then;")
        clock.append(f"        outside_then <= {{outside_then[{delay - 2}:0], outside_now}};")
        lines.append(f"    wire outside_end = outside_then[{delay - 1}];")
    lines.append(f"    reg [{delay - 1}:0] valid_then;")
    clock.append(
        f"        valid_then <= rst ? {delay}'d0 : {{valid_then[{delay - 2}:0], valid_in}};"
    )
    lines.append(f"    wire valid_end = valid_then[{delay - 1}];")
    lines.append(f"    wire [{module.row_bits - 1}:0] decided = at_{module.stages};")
    return [*lines, *clock, "    end"]


def _uses(module: Module, node: int, axis: int) -> bool:
    split = int(module.tree.split[node])
    if split >= module.plan.n:
        return bool(module.tree.planes[split - module.plan.n, axis])
    return split == axis


def _stage(module: Module, stage: int, heads: list[list[int]], bits: list[int]) -> list[str]:
    tree, labels, width, after = module.tree, module.rows, *bits[stage : stage + 2]
    names = {node: labels + k for k, node in enumerate(heads[stage + 1])}
    lines = [f"    reg [{after - 1}:0] at_{stage + 1};"]
    if tree.split[0] == LEAF:
        return [*lines, f"    wire [{after - 1}:0] next_{stage} = at_{stage};"]
    here = (tree.depths // module.levels == stage) & (tree.split >= module.plan.n)
    for node in here.nonzero()[0].tolist():
        lines += _sum(module, node, f"_{stage}")

    def leaf(node: int, _: int) -> str | None:
        if tree.split[node] == LEAF:
            return f"{after}'d{tree.threshold[node]}"
        return f"{after}'d{names[node]}" if node in names else None

    lines += [f"    reg [{after - 1}:0] next_{stage};", "    always @* begin"]
    lines.append(f"        case (at_{stage})")
    for k, node in enumerate(heads[stage]):
        lines.append(f"            {width}'d{labels + k}: begin")
        lines += _ifs(module, node, f"next_{stage}", f"_{stage}", leaf, 4)
        lines.append("            end")
    kept = f"at_{stage}[{after - 1}:0]"
    if after >= width:
        kept = f"{{{after - width}'d0, at_{stage}}}" if after > width else f"at_{stage}"
    return [
        *lines,
        f"            default: next_{stage} = {kept};",
        "        endcase",
        "    end",
    ]
