"""The bits of C style ``table``: a tree, or a diagram, in depth-first order.

A node is ``1 cut [skip] first second`` or ``0 label``; fields have their lowest bit first. A cut is
an axis and a threshold or, where the tree has oblique splits, a row of a table of planes. A skip is
the number of bits of the first subtree; only nodes above a certain depth carry one: below, a first
subtree is passed over node by node. In a diagram the label after the last one is that of a
reference: the bit where the subtree begins that stands there follows. A window of some bytes from
any bit on holds a whole node.
"""

from __future__ import annotations

import bisect
import functools
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.exports.c.styles.diagram import Diagram, ordered
from capsyn.exports.c.styles.mirrors import Mirror, half, mirrors

MOST_READ, READS_PER_LEVEL, OF_ROWS = 64, 7, 10
"""Nodes that a decision reads at most, if the tree's depth lets it: so many, or per level. Those of
a tree of rows are more: with boundaries for each symbol in force skips would take many bits."""
WINDOW_BITS = {2: 9, 3: 17, 4: 25, 8: 57}
"""Bits that a window of some bytes holds from any bit on."""
MIRRORED_AXIS, TURNED_LABELS, REFERRING = 64, 24, 96
"""Bytes of code, or more, that an axis of a mirror takes, its labels that change, references."""


@dataclass(frozen=True)
class Layout:
    """How nodes are written: those above depth `skips` carry a skip.

    `axis`, `threshold` (or the row of a plane), `label`, `skip` and `reference` are bits of the
    fields; the label of a reference is `refers`. `starts` (K + 1,) are the bits where nodes begin
    and where the last ends. `cuts`, pairs of a split and a threshold, are the rows of the table of
    planes, where the tree has oblique splits.
    """

    skips: int
    axis: int
    threshold: int
    label: int
    skip: int
    reference: int
    refers: int
    starts: np.ndarray
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
        most = max(*needs, 1 + self.label + self.reference)
        return min(b for b, bits in WINDOW_BITS.items() if bits >= most)


@dataclass(frozen=True, eq=False)
class Stream:
    """What style ``table`` writes of a tree: a diagram, of one half for each mirror, as `data`."""

    mirrors: tuple[Mirror, ...]
    diagram: Diagram
    form: Layout
    data: bytes

    @property
    def code(self) -> int:
        """Bytes of code, or more, beside those of a tree as it is."""
        axes = sum(len(mirror.axes) for mirror in self.mirrors)
        turns = sum(mirror.turns for mirror in self.mirrors)
        refers = self.diagram.references > 0
        return MIRRORED_AXIS * axes + TURNED_LABELS * turns + REFERRING * refers

    @property
    def figures(self) -> dict[str, Any]:
        """What is written, as plain data.

        ``bytes``; ``nodes``, and how many of them are ``references`` to others; ``mirrors``, of
        each the axes that are reflected; most ``comparisons`` of a decision, with one for each
        mirror, and ``nodes_read``, of which those of subtrees that are passed over.
        """
        diagram = self.diagram
        return {
            "bytes": len(self.data),
            "nodes": diagram.tree.node_count,
            "references": diagram.references,
            "mirrors": [list(mirror.axes) for mirror in self.mirrors],
            "comparisons": diagram.comparisons + len(self.mirrors),
            "nodes_read": diagram.nodes_read(self.form.skips),
        }


def most_read(tree: SplitTree, of_rows: bool = False) -> int:
    """Return how many nodes a decision may read, which the skips see to."""
    return max(MOST_READ, (OF_ROWS if of_rows else READS_PER_LEVEL) * tree.depth)


def best_skips(tree: SplitTree, most: int) -> int:
    """Return the least depth of skips where a tree has at most so many nodes read, else its own."""
    if tree.has_planes:
        return tree.depth
    # the more nodes carry skips, the fewer are read
    diagram = Diagram.of(tree)
    return bisect.bisect_left(
        range(tree.depth), True, key=lambda skips: diagram.nodes_read(skips) <= most
    )


def layout(diagram: Diagram, skips: int, skip: int = 0) -> Layout:
    """Return how the nodes of a diagram are written, with at least some bits for a skip."""
    tree = diagram.tree
    inner, refers = tree.split != LEAF, diagram.target >= 0
    cuts: tuple[tuple[int, int], ...] = ()
    axis, threshold = (tree.n - 1).bit_length(), int(tree.threshold[inner].max(initial=0))
    if tree.has_planes:
        cuts = tuple(sorted(set(zip(tree.split[inner].tolist(), tree.threshold[inner].tolist()))))
        axis, threshold = 0, len(cuts) - 1
    last = int(tree.threshold[~inner].max())
    label, reference = (last + int(refers.any())).bit_length(), 0
    node = 1 + axis + threshold.bit_length()
    carries = inner & (tree.depths < skips)
    while True:
        own = np.where(inner, node + skip * carries, 1 + label + reference * refers)
        starts = np.concatenate([[0], np.cumsum(own)])
        jumps = (starts[tree.second] - starts[tree.first])[carries]
        needs = int(jumps.max(initial=0)).bit_length()
        farthest = int(starts[diagram.target[refers]].max(initial=0)).bit_length()
        if needs <= skip and farthest <= reference:
            bits = threshold.bit_length()
            return Layout(skips, axis, bits, label, skip, reference, last + 1, starts, cuts)
        skip, reference = max(skip, min(needs, skip + 1)), max(farthest, reference)


def encode(diagram: Diagram, form: Layout) -> bytes:
    """Return the stream of bits, padded so that windows never read beyond it."""
    at = value = 0

    def put(number: int, width: int) -> None:
        nonlocal at, value
        value |= number << at
        at += width

    tree = diagram.tree
    places = {cut: row for row, cut in enumerate(form.cuts)}
    split, threshold, target = tree.split.tolist(), tree.threshold.tolist(), diagram.target.tolist()
    depths, starts = tree.depths.tolist(), form.starts.tolist()
    jumps = (form.starts[tree.second] - form.starts[tree.first]).tolist()
    pieces = []
    for i in range(tree.node_count):
        if target[i] >= 0:
            put(form.refers << 1, 1 + form.label)
            put(starts[target[i]], form.reference)
        elif split[i] == LEAF:
            put(threshold[i] << 1, 1 + form.label)
        else:
            put(1, 1)
            if places:
                put(places[split[i], threshold[i]], form.threshold)
            else:
                put(split[i], form.axis)
                put(threshold[i], form.threshold)
            if depths[i] < form.skips:
                put(jumps[i], form.skip)
        while at >= 8:  # whole bytes leave
            pieces.append(value & 255)
            value, at = value >> 8, at - 8
    return bytes(pieces) + bytes([value]) * (at > 0) + bytes(form.window - 1)


@functools.lru_cache(maxsize=1)
def stream(tree: SplitTree, of_rows: bool = False) -> Stream:
    """Return the stream of a tree that takes fewest bytes, with the code for what is special.

    Leaves `of_rows` are those of transitions.
    """
    most = most_read(tree, of_rows)
    found, best = _smallest(tree, (), most), tree
    for mirror in mirrors(tree):
        halved = half(best, mirror)
        if not halved.depth:
            continue
        found = min(found, _smallest(halved, (*found.mirrors, mirror), most), key=_size)
        best = halved if mirror in found.mirrors else best
    return found


def table_bytes(tree: SplitTree, of_rows: bool = False) -> int:
    """Return the bytes of the tables of a tree; those of planes have 32-bit entries at most."""
    written = stream(tree, of_rows)
    most = int(np.abs(tree.planes).max(initial=0))
    plane = (2 if most < 1 << 15 else 4) * tree.n + 4
    return len(written.data) + len(written.form.cuts) * plane


def _size(stream: Stream) -> int:
    return len(stream.data) + stream.code


def _smallest(tree: SplitTree, mirrors: tuple[Mirror, ...], most: int) -> Stream:
    """Return the smaller stream of a tree as it is, or as an ordered diagram."""
    plain = Diagram.of(tree)
    form = layout(plain, best_skips(tree, most))
    own = Stream(mirrors, plain, form, encode(plain, form))
    rows = ordered(tree)
    if rows is None:
        return own
    for skips in itertools.count():
        diagram = rows.written(skips)
        if diagram.nodes_read(skips) <= most or skips == diagram.tree.depth:
            break
    form = layout(diagram, skips)
    shared = Stream(mirrors, diagram, form, encode(diagram, form))
    return min(own, shared, key=_size)
