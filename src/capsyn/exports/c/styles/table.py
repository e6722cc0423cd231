"""C style ``table``: the tree as one stream of bits in depth-first order, read by windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capsyn.cells.split_tree import SplitTree
from capsyn.exports.c.language import Part, byte_rows, comment, constants, rows, z_type
from capsyn.exports.c.styles.mirrors import Mirror, middle
from capsyn.exports.c.styles.stream import Layout, Stream, stream


def table(tree: SplitTree, prefix: str, opening: str, of_rows: bool = False) -> Part:
    """Return the function ``opening(z)`` that gives the label of lattice steps, with its table.

    The tree must have splits. Labels may be numbers `of_rows`.
    """
    found = stream(tree, of_rows)
    if not found.mirrors:
        return _lookup(found, prefix, opening)
    z = z_type(tree.counts)
    part = _lookup(found, prefix, f"static int16_t {prefix}_half(const {z} z[{tree.n}])")
    text, reads = _mirrored(found.mirrors, tree, prefix, opening)
    return replace(part, text=part.text + text, reads=part.reads | reads)


def _lookup(found: Stream, prefix: str, opening: str) -> Part:
    """Return the function ``opening(z)`` that looks steps up in a stream, with its table."""
    form, data, tree = found.form, found.data, found.diagram.tree
    word = {2: "uint16_t", 3: "uint32_t", 4: "uint32_t", 8: "uint64_t"}[form.window]
    suffix = {"uint16_t": "u", "uint32_t": "uL", "uint64_t": "uLL"}[word]
    place = "uint16_t" if 8 * len(data) < 1 << 16 else "uint32_t"

    def field(shift: int, width: int) -> str:
        return f"((window >> {shift}u) & {(1 << width) - 1}{suffix})"

    text = f"\n{comment(_told(found))}\n" + _window(data, form.window, word, place, prefix)
    reads, cut = {"BYTE"}, ""
    if form.cuts:
        planes, kinds = _planes(tree, form, prefix)
        text, reads = text + planes, reads | kinds
        beyond = f"{prefix}_beyond(z, (uint16_t){field(1, form.threshold)})"
    else:
        z = z_type(tree.counts)
        cut = (
            f"        const u{z} limit = (u{z}){field(1 + form.axis, form.threshold)};\n"
            f"        const {z} threshold = ({z})limit;\n"
        )
        beyond = f"z[{field(1, form.axis) if form.axis else '0'}] >= threshold"
    some = 0 < form.skips < tree.depth
    skip = field(form.node, form.skip)
    if form.apart:
        skip = f"({prefix}_window(({place})(at - {form.skip}u)) & {(1 << form.skip) - 1}{suffix})"
    label = field(1, form.label) if form.label else "0u"
    depth = "    uint16_t depth = 0u;\n" if some else ""
    deeper = "        ++depth;\n" if some else ""
    refers = follow = ""
    if form.reference:
        refers = f"(window & {(2 << form.label) - 1}{suffix}) == {form.refers << 1}{suffix}"
        below = f"            depth = {form.skips}u;\n" if some else ""
        follow = (
            f"        if ({refers}) {{\n"
            f"            at = ({place}){field(1 + form.label, form.reference)};\n{below}"
            f"            window = {prefix}_window(at);\n        }}\n"
        )
    text += f"""
{opening}
{{
    {place} at = 0u;
{depth}    uint16_t label;
    {word} window = {prefix}_window(at);
    while ((window & 1u) == 1u) {{
{cut}        const bool beyond = {beyond};
{_advance(tree, form, prefix, place, skip, refers)}{deeper}        window = {prefix}_window(at);
{follow}    }}
    label = (uint16_t){label};
    return (int16_t)label;
}}
"""
    return Part(text, frozenset(reads))


def _mirrored(
    mirrors: tuple[Mirror, ...], tree: SplitTree, prefix: str, opening: str
) -> tuple[str, set[str]]:
    """Return the function ``opening(z)`` that looks up reflected steps, and what it reads."""
    z, tables, reads = z_type(tree.counts), "", set[str]()
    before, after = "", ""
    for mirror in mirrors:
        beyond = f"z[{mirror.pivot}] >= {middle(tree, mirror)}"
        lines = []
        for a in mirror.axes:  # whole numbers within the type, wherever z lies
            inner = f"y[{a}]" if a == mirror.pivot else f"((y[{a}] > 0) ? y[{a}] : 0)"
            lines.append(f"        y[{a}] = ({z})({tree.counts[a] - 1} - {inner});\n")
        before += f"    if ({beyond}) {{\n{''.join(lines)}    }}\n"
        if not mirror.turns:
            continue
        turned = f"{mirror.reversal} - label"
        if mirror.reversal is None:
            name = f"{prefix}_turned_{mirror.pivot}"
            entries = [max(label, 0) for label in mirror.turned]
            narrow = max(entries) < 1 << 8
            kind, integer = ("BYTE", "uint8_t") if narrow else ("INT16", "int16_t")
            tables += constants(name, integer, entries)
            turned = f"CAPSYN_{kind}(&{name}[label])"
            reads.add(kind)
        after += f"    if ({beyond}) {{\n        label = (int16_t)({turned});\n    }}\n"
    copies = "".join(f"    y[{a}] = z[{a}];\n" for a in range(tree.n))
    text = f"""
/* The tree is that of one half: steps beyond the middle are reflected. */
{opening}
{{
{tables}    {z} y[{tree.n}];
    int16_t label;
{copies}{before}    label = {prefix}_half(y);
{after}    return label;
}}
"""
    return text, reads


def _told(found: Stream) -> list[str]:
    """Return what the bits are, as lines."""
    figures = found.figures
    text = f"The tree is written as {figures['nodes']} nodes"
    if figures["references"]:
        text += f", {figures['references']} of them references to subtrees that stand elsewhere"
    if figures["mirrors"]:
        halves = "; ".join(", ".join(map(str, axes)) for axes in figures["mirrors"])
        text += f", without what follows from reflection (axes {halves})"
    return [f"{text}. A decision reads at most {figures['nodes_read']}."]


def _window(data: bytes, size: int, word: str, place: str, prefix: str) -> str:
    more = "".join(
        f"    window |= ({word})(({word})CAPSYN_BYTE(&{prefix}_bits[byte + {i}u]) << {8 * i}u);\n"
        for i in range(1, size)
    )
    return f"""
/* Return the bits of the tree from bit `at` on, the first of them lowest. */
static {word} {prefix}_window({place} at)
{{
    static const uint8_t {prefix}_bits[{len(data)}] CAPSYN_ROM = {{
{byte_rows(data)}
    }};
    const {place} byte = ({place})(at >> 3u);
    {word} window = CAPSYN_BYTE(&{prefix}_bits[byte]);
{more}    return ({word})(window >> (at & 7u));
}}
"""


def _planes(tree: SplitTree, form: Layout, prefix: str) -> tuple[str, set[str]]:
    unit = np.eye(tree.n, dtype=np.int64)
    planes = [unit[s] if s < tree.n else tree.planes[s - tree.n] for s, _ in form.cuts]
    kind = "INT16" if max(int(abs(plane).max()) for plane in planes) < 1 << 15 else "INT32"
    integer = {"INT16": "int16_t", "INT32": "int32_t"}[kind]
    entries = ["{" + ", ".join(map(str, plane.tolist())) + "}" for plane in planes]
    text = f"""
/* Return whether steps lie beyond a plane. */
static bool {prefix}_beyond(const {z_type(tree.counts)} z[{tree.n}], uint16_t row)
{{
    static const {integer} {prefix}_planes[{len(entries)}][{tree.n}] CAPSYN_ROM = {{
{rows(entries)}
    }};
    static const int32_t {prefix}_limits[{len(entries)}] CAPSYN_ROM = {{
{rows([str(limit) for _, limit in form.cuts])}
    }};
    int32_t sum = 0;
    uint16_t i;
    for (i = 0u; i < {tree.n}u; ++i) {{
        sum += (int32_t)CAPSYN_{kind}(&{prefix}_planes[row][i]) * (int32_t)z[i];
    }}
    return sum >= CAPSYN_INT32(&{prefix}_limits[row]);
}}
"""
    return text, {kind, "INT32"}


def _advance(tree: SplitTree, form: Layout, prefix: str, place: str, skip: str, refers: str) -> str:
    """Return the statements that go on to the first or the second child."""
    jump = f"if (beyond) {{\n    at += ({place}){skip};\n}}\n"
    if form.skips >= tree.depth:
        lines = f"at += {form.node + form.skip}u;\n{jump}"
    else:
        over = _pass_over(form, prefix, place, refers)
        lines = f"at += {form.node}u;\n"
        if form.skips:
            inner = f"at += {form.skip}u;\n{jump}"
            inner = "".join(f"    {line}\n" for line in inner.splitlines())
            lines += f"if (depth < {form.skips}u) {{\n{inner}}} else {over}"
        else:
            lines += over
    return "".join(f"        {line}\n" for line in lines.splitlines())


def _pass_over(form: Layout, prefix: str, place: str, refers: str) -> str:
    """Return the statement that passes over the first subtree where that is asked for."""
    look, inner, reference = "", f"({prefix}_window(at) & 1u) == 1u", ""
    if refers:
        look, inner = f"        window = {prefix}_window(at);\n", "(window & 1u) == 1u"
        onward = f"                at += {form.reference}u;\n"
        reference = f"            if ({refers}) {{\n{onward}            }}\n"
    return f"""if (beyond) {{
    {place} open = 1u; /* pass over the first subtree */
    while (open > 0u) {{
{look}        if ({inner}) {{
            at += {form.node}u;
            ++open;
        }} else {{
            at += {1 + form.label}u;
            --open;
{reference}        }}
    }}
}} else {{
    /* the first subtree comes next */
}}
"""
