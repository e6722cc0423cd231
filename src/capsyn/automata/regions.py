"""Regions of a policy: the states of each symbol, as connected partitions and as few boxes."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from capsyn.automata.rectangles import fewest_rectangles
from capsyn.cells.boxes import Boxes, digits_of, ragged
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.faces import shared_faces
from capsyn.cells.split_tree import SplitTree
from capsyn.modelling.domain import Box

MAX_COLUMNS = 1 << 21
"""Most columns that cells are cut into before they are merged again."""
MAX_ORDERS = 24
"""Most orders of the axes that are tried."""
MAX_KEY = 1 << 62
"""Sort keys are packed into integers below it."""


@dataclass(frozen=True, eq=False)
class Partitions:
    """The connected partitions L of Definition 2: maximal connected sets of cells of one symbol.

    Cells are connected through the (n-1)-dimensional faces that they share, those across the seam
    of a periodic axis included; cells that touch in an edge or a corner only are not. Partitions
    are in the order of their symbols, those of one symbol from the largest to the smallest.
    """

    places: np.ndarray  # (M,): the cells, as ``find`` gives them, ascending
    members: np.ndarray  # (M,): the partition that each cell belongs to
    labels: np.ndarray  # (P,): symbol of each partition, N for the default control
    shares: np.ndarray  # (P,): of the domain's volume

    def __len__(self) -> int:
        return len(self.labels)

    def of(self, places: np.ndarray) -> np.ndarray:
        """Return the partitions (B,) of cells (B,), given as places."""
        return self.members[np.searchsorted(self.places, places)]


@dataclass(frozen=True, eq=False)
class Region:
    """The region A of a symbol: all states that get it, as boxes that tile it.

    Of a policy that remembers: all that get it while another symbol, or it itself, is in force.
    """

    label: int  # the symbol, N for the default control
    lower: np.ndarray  # (K, n): corners of the boxes, ``lower <= z < upper``, in finest cells
    upper: np.ndarray  # (K, n)
    partitions: np.ndarray  # (K,): the connected partition that each box belongs to
    cells: int  # of the policy that the boxes were merged from
    share: float  # of the domain's volume
    source: int | None = None  # the symbol in force, where that matters

    def __len__(self) -> int:
        return len(self.lower)

    def bounds(self, domain: Box, counts: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners (K, n) and (K, n) of the boxes [state units].

        A state is in a box where ``lower <= state < upper`` on every axis; on an ordinary axis the
        domain's upper bound belongs to the boxes that end there.
        """
        return domain.points(self.lower, counts), domain.points(self.upper, counts)


def connected_partitions(
    cells: CellTree | SplitTree,
    periodic: Sequence[bool] | None = None,
    following: np.ndarray | None = None,
) -> Partitions:
    """Return the connected partitions of cells, or of leaves of a tree without oblique splits.

    The ends of `periodic` axes meet; by default there are none. Labels are those that `following`
    (R,) has for each row; by default leaf numbers themselves.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    boxes = cells.boxes()
    order = np.argsort(boxes.places)
    places, labels = boxes.places[order], _labels(boxes, following)[order]
    label_at = np.empty(places[-1] + 1, dtype=labels.dtype)
    label_at[places] = labels
    faces = shared_faces(cells, lambda a, b: label_at[a] == label_at[b], periodic)
    rows = np.searchsorted(places, faces.below), np.searchsorted(places, faces.above)
    graph = coo_array((np.ones(len(faces), dtype=bool), rows), shape=(len(places),) * 2)
    count, component = connected_components(graph, directed=False)
    first = np.full(count, len(places))
    np.minimum.at(first, component, np.arange(len(places)))
    volumes = np.bincount(component, boxes.volumes()[order], minlength=count)
    rank = np.lexsort((first, -volumes, labels[first]))
    number = np.empty(count, dtype=np.int64)
    number[rank] = np.arange(count)
    shares = volumes[rank] / np.prod(np.array(cells.counts, dtype=float))
    return Partitions(places, number[component], labels[first][rank], shares)


def _labels(boxes: Boxes, following: np.ndarray | None) -> np.ndarray:
    """Return what follows in boxes (M,): what `following` (R,) has for their rows, or these."""
    return boxes.labels if following is None else following[boxes.labels]


def regions(
    cells: CellTree | SplitTree,
    partitions: Partitions,
    following: np.ndarray | None = None,
) -> list[Region]:
    """Return the regions of the symbols that cells have, in the order of the symbols.

    Partitions and labels are those of `connected_partitions`.
    """
    boxes = cells.boxes()
    found = _labels(boxes, following)
    lower, upper, labels = merged_boxes(boxes.lower, boxes.upper, found, cells.counts)
    members = partitions.of(cells.find(lower))
    cell_counts = np.bincount(found)
    areas = []
    for label in np.unique(labels).tolist():
        own = labels == label
        share = float(partitions.shares[partitions.labels == label].sum())
        areas.append(
            Region(label, lower[own], upper[own], members[own], int(cell_counts[label]), share)
        )
    return areas


def guards(
    cells: CellTree | SplitTree,
    periodic: Sequence[bool],
    transitions: np.ndarray,
    sources: Sequence[int],
) -> list[Region]:
    """Return where which symbol follows each source, by source and then by symbol.

    What follows are rows (R, N + 1) of labels in force, whose numbers are those of leaves.
    """
    used = np.unique(cells.constant_leaves(len(transitions)))
    known: dict[bytes, list[Region]] = {}  # symbols may have the same followers everywhere
    found = []
    for source in sources:
        following = transitions[:, source]
        key = following[used].tobytes()
        if key not in known:
            partitions = connected_partitions(cells, periodic, following)
            known[key] = regions(cells, partitions, following)
        found += [dataclasses.replace(region, source=source) for region in known[key]]
    return found


def merged_boxes(
    lower: np.ndarray, upper: np.ndarray, labels: np.ndarray, counts: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return fewer boxes that cover the same points of the lattice with the same labels.

    Of two axes these are the fewest that there can be; of more, to find the fewest is hard. There,
    two boxes with one label that share a whole face are merged, all such pairs along one axis at a
    time, until there are none. This is tried in the orders of the axes, from the boxes as they are
    and from columns of the lattice, one finest cell thick; of every label the fewest boxes are
    kept.

    Boxes (M, n), ``lower <= z < upper`` in finest cells, with labels (M,) of 0 or more do not
    overlap, neither those that come nor those that go; these are by labels and then by lower
    corners.
    """
    n = lower.shape[1]
    start = _Boxes(lower.astype(np.int32), upper.astype(np.int32), labels.astype(np.int32))
    best = (_fewest_in_the_plane(start) if n == 2 else None) or _fewest_of_orders(start, counts)
    rank = np.lexsort((*best.lower.T[::-1], best.labels))
    best = best.take(rank)
    return best.lower.astype(np.int64), best.upper.astype(np.int64), best.labels


class _Boxes(NamedTuple):
    """Boxes (M, n) int32 with labels (M,)."""

    lower: np.ndarray
    upper: np.ndarray
    labels: np.ndarray

    def take(self, rows: np.ndarray) -> _Boxes:
        return _Boxes(*(column[rows] for column in self))


def _fewest_in_the_plane(boxes: _Boxes) -> _Boxes | None:
    """Return the fewest boxes (K, 2) that there can be; None where there are too many points."""
    ticks = [np.unique(np.stack([boxes.lower[:, i], boxes.upper[:, i]])) for i in range(2)]
    shape = len(ticks[0]), len(ticks[1])
    if shape[0] * shape[1] > MAX_COLUMNS:
        return None
    parts = []
    for label in np.unique(boxes.labels):
        own = boxes.take(boxes.labels == label)
        low, high = (
            [np.searchsorted(ticks[i], corner[:, i]) for i in range(2)]
            for corner in (own.lower, own.upper)
        )
        image = np.zeros(shape, dtype=np.int32)
        for first, second, sign in (low, low, 1), (low, high, -1), (high, low, -1), (high, high, 1):
            np.add.at(image, (first[0], second[1]), sign)
        inside = image.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
        corners = [
            np.stack([ticks[i][corner[:, i]] for i in range(2)], axis=1)
            for corner in fewest_rectangles(inside)
        ]
        parts.append(_Boxes(corners[0], corners[1], np.full(len(corners[0]), label)))
    return _joined(parts)


def _fewest_of_orders(boxes: _Boxes, counts: Sequence[int]) -> _Boxes:
    """Return the fewest boxes that merging finds."""
    best, n = boxes, len(counts)
    for order in itertools.islice(itertools.permutations(range(n)), MAX_ORDERS):
        for candidate in _starts(boxes, order[0]):
            best = _fewer(best, _merged(candidate, order, counts))
    return best


def _joined(parts: Sequence[_Boxes]) -> _Boxes:
    return _Boxes(*map(np.concatenate, zip(*parts)))


def _starts(boxes: _Boxes, axis: int) -> Iterator[_Boxes]:
    """Yield the boxes, and the columns along an axis where these are not too many."""
    yield boxes
    sizes = boxes.upper - boxes.lower
    sizes[:, axis] = 1
    areas = np.prod(sizes, axis=1, dtype=float)
    if areas.sum() > MAX_COLUMNS:
        return
    source, number = ragged(areas.astype(np.int64))
    columns = boxes.take(source)
    lower = columns.lower + digits_of(number, sizes[source]).astype(np.int32)
    upper = lower + 1
    upper[:, axis] = columns.upper[:, axis]
    yield _Boxes(lower, upper, columns.labels)


def _fewer(one: _Boxes, two: _Boxes) -> _Boxes:
    """Return, of two covers of the same points, for each label the one with fewer boxes."""
    count = 1 + max(one.labels.max(), two.labels.max())
    better = np.bincount(two.labels, minlength=count) < np.bincount(one.labels, minlength=count)
    return _joined([one.take(~better[one.labels]), two.take(better[two.labels])])


def _merged(boxes: _Boxes, order: Sequence[int], counts: Sequence[int]) -> _Boxes:
    """Return boxes merged along the axes in turn until no two can be."""
    idle, turn = 0, 0
    while idle < len(order):
        merged = _merged_along(boxes, order[turn % len(order)], counts)
        idle = idle + 1 if len(merged.labels) == len(boxes.labels) else 1
        boxes, turn = merged, turn + 1
    return boxes


def _merged_along(boxes: _Boxes, axis: int, counts: Sequence[int]) -> _Boxes:
    """Return boxes with all runs along one axis merged whose cross-sections are the same."""
    columns = [(boxes.labels, int(boxes.labels.max()) + 1)]
    for i, count in enumerate(counts):
        if i != axis:
            columns += [(boxes.lower[:, i], count + 1), (boxes.upper[:, i], count + 1)]
    keys = _packed([*columns, (boxes.lower[:, axis], counts[axis] + 1)])
    rank = np.argsort(keys[0]) if len(keys) == 1 else np.lexsort(keys[::-1])
    low, high = boxes.lower[rank, axis], boxes.upper[rank, axis]
    joined = high[:-1] == low[1:]
    for key in _packed(columns):
        sections = key[rank]
        joined &= sections[1:] == sections[:-1]
    if not joined.any():
        return boxes
    starts = np.flatnonzero(np.append(True, ~joined))
    ends = np.append(starts[1:], len(rank)) - 1
    merged = boxes.take(rank[starts])
    merged.upper[:, axis] = high[ends]
    return merged


def _packed(columns: Sequence[tuple[np.ndarray, int]]) -> list[np.ndarray]:
    """Return columns (M,) of numbers below given bounds as few integer columns, in their order."""
    packed: list[np.ndarray] = []
    room = 0
    for column, bound in columns:
        if packed and room * bound < MAX_KEY:
            packed[-1] *= bound
            packed[-1] += column
            room *= bound
        else:
            packed.append(column.astype(np.int64))
            room = bound
    return packed
