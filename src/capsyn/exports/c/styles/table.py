"""C style ``table``: the tree as one stream of bits in depth-first order, read by windows.

A node is ``1 cut [skip] first second`` or ``0 label``; fields have their lowest bit first. A cut is
an axis and a threshold or, where the tree has oblique splits, a row of a table of planes. A skip is
the number of bits of the first subtree; only nodes above a certain depth carry one: below, a first
subtree is passed over node by node. A window of some bytes from any bit on holds a whole node.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass

import numpy as np

from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.exports.c.language import Part, byte_rows, rows, z_type

MOST_READ, READS_PER_LEVEL = 64, 7
"""Nodes that a decision reads at most, if the tree's depth lets it: so many, or per level."""
WINDOW_BITS = {2: 9, 3: 17, 4: 25, 8: 57}
"""Bits that a window of some bytes holds from any bit on."""


@dataclass(frozen=True)
class Layout:
    """How the nodes of a tree are written: those above depth `skips` carry a skip.

    `axis`, `threshold` (or the row of a plane), `label` and `skip` are bits of the fields; `sizes`
    (K,) those of the first subtree of each inner node. `cuts`, pairs of a split and a threshold,
    are the rows of the table of planes, where the tree has oblique splits.
    """

    skips: int
    axis: int
    threshold: int
    label: int
    skip: int
    sizes: np.ndarray
    cuts: tuple[tuple[int, int], ...]

    @property
    def node(self) -> int:
        """Bits of an inner node without its skip."""
        return 1 + self.axis + self.threshold

    @property
    def apart(self) -> bool:
        """Whether a skip takes a window of its own."""
        both = self.node + self.skip
        return self.node <= 25 < both <= 50 or both > WINDOW_BITS[8]

    @property
    def window(self) -> int:
        """Bytes of a window."""
        needs = (self.node, self.skip) if self.apart else (self.node + self.skip,)
        return min(b for b, bits in WINDOW_BITS.items() if bits >= max(*needs, 1 + self.label))


def nodes_read(tree: SplitTree, skips: int) -> int:
    """Return the nodes that a decision reads at most where nodes above a depth carry skips."""
    read = np.ones(tree.node_count, dtype=np.int64)
    nodes = np.zeros(1, dtype=np.int32)
    for depth in range(tree.depth):
        nodes = nodes[tree.split[nodes] != LEAF]
        first, second = tree.first[nodes], tree.second[nodes]
        read[first] = read[second] = read[nodes] + 1
        if depth >= skips:
            read[second] += second - first
        nodes = np.concatenate([first, second])
    return int(read.max())


def best_skips(tree: SplitTree) -> int:
    """Return the least depth of skips with few enough nodes read, else the tree's own."""
    if len(tree.planes):
        return tree.depth
    # the more nodes carry skips, the fewer are read
    depths, most = range(tree.depth), most_read(tree)
    return bisect.bisect_left(depths, True, key=lambda skips: nodes_read(tree, skips) <= most)


def most_read(tree: SplitTree) -> int:
    """Return how many nodes a decision may read, which the skips see to."""
    return max(MOST_READ, READS_PER_LEVEL * tree.depth)


def layout(tree: SplitTree, skips: int, skip: int = 0) -> Layout:
    """Return how the nodes of a tree are written, with at least some bits for a skip."""
    inner = tree.split != LEAF
    cuts: tuple[tuple[int, int], ...] = ()
    axis, threshold = (tree.n - 1).bit_length(), int(tree.threshold[inner].max(initial=0))
    if len(tree.planes):
        cuts = tuple(sorted(set(zip(tree.split[inner].tolist(), tree.threshold[inner].tolist()))))
        axis, threshold = 0, len(cuts) - 1
    label = int(tree.threshold[~inner].max()).bit_length()
    node = 1 + axis + threshold.bit_length()
    carries = inner & (tree.depths < skips)
    while True:
        own = np.where(inner, node + skip * carries, 1 + label)
        ends = np.concatenate([[0], np.cumsum(own)])
        sizes = np.where(inner, ends[tree.second] - ends[tree.first], 0)
        if int(sizes[carries].max(initial=0)).bit_length() <= skip:
            return Layout(skips, axis, threshold.bit_length(), label, skip, sizes, cuts)
        skip += 1


def table_bytes(tree: SplitTree) -> int:
    """Return the bytes of the tables of a tree; those of planes have 32-bit entries at most."""
    form = layout(tree, best_skips(tree))
    most = int(np.abs(tree.planes).max(initial=0))
    return len(encode(tree, form)) + len(form.cuts) * ((2 if most < 1 << 15 else 4) * tree.n + 4)


def encode(tree: SplitTree, form: Layout) -> bytes:
    """Return the stream of bits, padded so that windows never read beyond it."""
    at = value = 0

    def put(number: int, width: int) -> None:
        nonlocal at, value
        value |= number << at
        at += width

    places = {cut: row for row, cut in enumerate(form.cuts)}
    split, threshold = tree.split.tolist(), tree.threshold.tolist()
    depths, sizes = tree.depths.tolist(), form.sizes.tolist()
    pieces = []
    for i in range(tree.node_count):
        if split[i] == LEAF:
            put(threshold[i] << 1, 1 + form.label)
        else:
            put(1, 1)
            if places:
                put(places[split[i], threshold[i]], form.threshold)
            else:
                put(split[i], form.axis)
                put(threshold[i], form.threshold)
            if depths[i] < form.skips:
                put(sizes[i], form.skip)
        while at >= 8:  # whole bytes leave
            pieces.append(value & 255)
            value, at = value >> 8, at - 8
    return bytes(pieces) + bytes([value]) * (at > 0) + bytes(form.window - 1)


def table(tree: SplitTree, prefix: str, opening: str) -> Part:
    """Return the function ``opening(z)`` that gives the label of lattice steps, with its table.

    The tree must have splits.
    """
    form = layout(tree, best_skips(tree))
    data = encode(tree, form)
    word = {2: "uint16_t", 3: "uint32_t", 4: "uint32_t", 8: "uint64_t"}[form.window]
    suffix = {"uint16_t": "u", "uint32_t": "uL", "uint64_t": "uLL"}[word]
    place = "uint16_t" if 8 * len(data) < 1 << 16 else "uint32_t"

    def field(shift: int, width: int) -> str:
        return f"((window >> {shift}u) & {(1 << width) - 1}{suffix})"

    text = _window(data, form.window, word, place, prefix)
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
    text += f"""
{opening}
{{
    {place} at = 0u;
{depth}    uint16_t label;
    {word} window = {prefix}_window(at);
    while ((window & 1u) == 1u) {{
{cut}        const bool beyond = {beyond};
{_advance(tree, form, prefix, place, skip)}{deeper}        window = {prefix}_window(at);
    }}
    label = (uint16_t){label};
    return (int16_t)label;
}}
"""
    return Part(text, frozenset(reads))


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


def _advance(tree: SplitTree, form: Layout, prefix: str, place: str, skip: str) -> str:
    """Return the statements that go on to the first or the second child."""
    jump = f"if (beyond) {{\n    at += ({place}){skip};\n}}\n"
    if form.skips >= tree.depth:
        lines = f"at += {form.node + form.skip}u;\n{jump}"
    else:
        over = f"""if (beyond) {{
    {place} open = 1u; /* pass over the first subtree */
    while (open > 0u) {{
        if (({prefix}_window(at) & 1u) == 1u) {{
            at += {form.node}u;
            ++open;
        }} else {{
            at += {1 + form.label}u;
            --open;
        }}
    }}
}} else {{
    /* the first subtree comes next */
}}
"""
        lines = f"at += {form.node}u;\n"
        if form.skips:
            inner = f"at += {form.skip}u;\n{jump}"
            inner = "".join(f"    {line}\n" for line in inner.splitlines())
            lines += f"if (depth < {form.skips}u) {{\n{inner}}} else {over}"
        else:
            lines += over
    return "".join(f"        {line}\n" for line in lines.splitlines())
