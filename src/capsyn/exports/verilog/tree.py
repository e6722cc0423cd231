"""A tree as a circuit: ifs in blocks of their own, or stages with registers between them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.exports.text import broken, signed_sum
from capsyn.exports.verilog.module import Module
from capsyn.exports.verilog.ports import width_of
from capsyn.exports.verilog.words import signed

NESTING = 8
"""Most ifs in one another; deeper subtrees are blocks of their own."""
_Leaf = Callable[[int, int], str | None]


@dataclass(frozen=True, eq=False)
class TreeCircuit:
    """Text of the tree of a module, which compares wires ``z0 .. z<n-1>``."""

    module: Module

    @property
    def tree(self) -> SplitTree:
        """Its nodes."""
        return self.module.tree

    def _test(self, node: int, end: str) -> str:
        """Return the comparison of a node; `end` is that of the names of a stage."""
        split, threshold = int(self.tree.split[node]), int(self.tree.threshold[node])
        if split >= self.module.plan.n:
            width = self._sum_bits(node)
            return f"s{split - self.module.plan.n} >= {signed(threshold, width)}"
        if self.module.direct and self.module.ports:
            face = self.module.ports[split].face(threshold)
            return f"z{split}{end} >= {signed(face, self.module.inner_widths[split])}"
        return f"z{split}{end} >= {self.module.inner_widths[split]}'d{threshold}"

    def _sum_bits(self, node: int) -> int:
        row = self.tree.planes[int(self.tree.split[node]) - self.module.plan.n].tolist()
        most = sum(abs(c) * count for c, count in zip(row, self.tree.counts))
        return width_of(max(most, abs(int(self.tree.threshold[node])))) + 2

    def _sum(self, node: int, end: str) -> list[str]:
        """Return the wire of the sum that an oblique node compares."""
        row = int(self.tree.split[node]) - self.module.plan.n
        bits, plane = self._sum_bits(node), self.tree.planes[row].tolist()
        wide = (
            f"$signed({{{bits - width}'d0, z{i}{end}}})"
            for i, width in enumerate(self.module.inner_widths)
        )
        products = (f"{bits}'sd{abs(factor)} * {step}" for factor, step in zip(plane, wide))
        total = signed_sum(plane, products) or signed(0, bits)
        return broken(f"    wire signed [{bits - 1}:0] s{row} = {total};")

    def combinational(self) -> list[str]:
        """Return the whole tree without registers."""
        tree, top = self.tree, self.module.symbol_bits - 1
        lines = [f"    wire [{top}:0] decided;"]
        for node in (tree.split >= self.module.plan.n).nonzero()[0].tolist():
            lines += self._sum(node, "")
        if tree.split[0] == LEAF:
            lines.append(f"    assign decided = {self.module.symbol_bits}'d{tree.threshold[0]};")
        else:
            parts, waiting, blocks = {0: "part0"}, [0], []

            def leaf(node: int, depth: int) -> str | None:
                if tree.split[node] == LEAF:
                    return f"{self.module.symbol_bits}'d{tree.threshold[node]}"
                if depth < NESTING:
                    return None
                parts[node] = f"part{len(parts)}"
                waiting.append(node)
                return parts[node]

            while waiting:
                node = waiting.pop()
                rows = [f"    reg [{top}:0] {parts[node]};", "    always @* begin"]
                blocks.append(rows + list(self._ifs(node, parts[node], "", leaf, 2)) + ["    end"])
            lines += [line for block in reversed(blocks) for line in block]
            lines.append("    assign decided = part0;")
        lines += ["    wire outside_end = outside_now;"] * bool(self.module.ports)
        return lines + ["    wire valid_end = valid_in;"] * self.module.clocked

    def _ifs(self, node: int, into: str, end: str, leaf: _Leaf, level: int) -> Iterator[str]:
        """Yield the ifs of a subtree; `leaf` gives the values of nodes where they end."""
        indent = "    " * level

        def branch(child: int) -> Iterator[str]:
            value = leaf(child, level - 1)
            if value is not None:
                yield f"{indent}    {into} = {value};"
            else:
                yield from self._ifs(child, into, end, leaf, level + 1)

        yield f"{indent}if ({self._test(node, end)}) begin"
        yield from branch(int(self.tree.second[node]))
        yield f"{indent}end else begin"
        yield from branch(node + 1)
        yield f"{indent}end"

    def pipelined(self, used: list[int]) -> list[str]:
        """Return the stages: each goes some levels down, from a label or a subtree to another."""
        tree, labels, depths = self.tree, self.module.plan.labels, self.tree.depths
        inner = tree.split != LEAF
        heads = [
            (inner & (depths == stage * self.module.levels)).nonzero()[0].tolist()
            for stage in range(self.module.stages + 1)
        ]
        bits = [width_of(labels + len(nodes) - 1) for nodes in heads]
        last = {
            i: max(
                (
                    int(depths[node]) // self.module.levels
                    for node in inner.nonzero()[0]
                    if self._uses(node, i)
                ),
                default=0,
            )
            for i in used
        }
        sign = " signed" if self.module.direct else ""
        lines, clock = [], ["    always @(posedge clk) begin"]
        for i in used:
            for stage in range(last[i] + 1):
                lines.append(f"    reg{sign} [{self.module.inner_widths[i] - 1}:0] z{i}_{stage};")
                clock.append(f"        z{i}_{stage} <= z{i}{f'_{stage - 1}' if stage else ''};")
        root = f"{bits[0]}'d{labels}" if inner[0] else f"{bits[0]}'d{tree.threshold[0]}"
        lines.append(f"    wire [{bits[0] - 1}:0] at_0 = {root};")
        for stage in range(self.module.stages):
            lines += self._stage(stage, heads, bits)
            clock.append(f"        at_{stage + 1} <= next_{stage};")
        delay = self.module.stages + 1
        if self.module.ports:
            lines.append(f"    reg [{delay - 1}:0] outside_then;")
            clock.append(f"        outside_then <= {{outside_then[{delay - 2}:0], outside_now}};")
            lines.append(f"    wire outside_end = outside_then[{delay - 1}];")
        lines.append(f"    reg [{delay - 1}:0] valid_then;")
        clock.append(
            f"        valid_then <= rst ? {delay}'d0 : {{valid_then[{delay - 2}:0], valid_in}};"
        )
        lines.append(f"    wire valid_end = valid_then[{delay - 1}];")
        lines.append(
            f"    wire [{self.module.symbol_bits - 1}:0] decided = at_{self.module.stages};"
        )
        return [*lines, *clock, "    end"]

    def _uses(self, node: int, axis: int) -> bool:
        split = int(self.tree.split[node])
        if split >= self.module.plan.n:
            return bool(self.tree.planes[split - self.module.plan.n, axis])
        return split == axis

    def _stage(self, stage: int, heads: list[list[int]], bits: list[int]) -> list[str]:
        tree, labels, width, after = (
            self.tree,
            self.module.plan.labels,
            bits[stage],
            bits[stage + 1],
        )
        names = {node: labels + k for k, node in enumerate(heads[stage + 1])}
        lines = [f"    reg [{after - 1}:0] at_{stage + 1};"]
        if tree.split[0] == LEAF:
            return [*lines, f"    wire [{after - 1}:0] next_{stage} = at_{stage};"]
        here = (tree.depths // self.module.levels == stage) & (tree.split >= self.module.plan.n)
        for node in here.nonzero()[0].tolist():
            lines += self._sum(node, f"_{stage}")

        def leaf(node: int, _: int) -> str | None:
            if tree.split[node] == LEAF:
                return f"{after}'d{tree.threshold[node]}"
            return f"{after}'d{names[node]}" if node in names else None

        lines += [f"    reg [{after - 1}:0] next_{stage};", "    always @* begin"]
        lines.append(f"        case (at_{stage})")
        for k, node in enumerate(heads[stage]):
            lines.append(f"            {width}'d{labels + k}: begin")
            lines += self._ifs(node, f"next_{stage}", f"_{stage}", leaf, 4)
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
