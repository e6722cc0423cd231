"""The fewest rectangles that tile a region of the plane.

A corner of the region where three of the four cells around it are inside is concave. A partition
into rectangles needs a cut from each of them; only cuts along a chord, which joins two concave
corners, serve two at once. So the fewest rectangles come from the most chords that do not meet: an
independent set of the bipartite graph of horizontal and vertical chords, found by a matching [1]_.

References
----------
.. [1] T. Ohtsuki, Minimum dissection of rectilinear regions, Proc. IEEE International Symposium on
   Circuits and Systems, 1982.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MAX_PAIRS = 1 << 24
"""Most pairs of chords; where there are more, none is used, and the rectangles are a few more."""


def fewest_rectangles(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (K, 2) and (K, 2) of the fewest rectangles that tile cells of the plane.

    `inside` (A, B) are the cells of a region, which may have holes and many parts.
    """
    cells = np.pad(inside, 1)
    none = np.zeros((cells.shape[0] + 1, cells.shape[1] + 1), dtype=bool)
    rows, columns = _runs(cells, none), _runs(cells.T, none.T)
    across, down = rows.take(rows.first & rows.last), columns.take(columns.first & columns.last)
    across, down = _independent(across, down)
    served = across.ends(none.shape) | down.ends(none.shape[::-1]).T
    walls = down.painted(none.shape[::-1]).T
    # the other concave corners: a cut along the row, as far as there is no chord in its way
    crossed = none.copy()
    crossed[1:] = walls[:-1] & walls[1:]
    cuts = _runs(cells, crossed)
    needed = cuts.first & ~served[cuts.line, cuts.start] | cuts.last & ~served[cuts.line, cuts.stop]
    levels = across.painted(none.shape) | cuts.take(needed).painted(none.shape)
    return _components(cells, levels, walls)


@dataclass(frozen=True, eq=False)
class _Runs:
    """Segments (R,) of grid lines inside the region, ``start <= x <= stop`` on ``line``.

    `first` and `last` tell whether they start and stop at a concave corner.
    """

    line: np.ndarray
    start: np.ndarray
    stop: np.ndarray
    first: np.ndarray
    last: np.ndarray

    def take(self, some: np.ndarray) -> _Runs:
        return _Runs(*(getattr(self, name)[some] for name in self.__dataclass_fields__))

    def painted(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return which unit segments of an image's grid lines they cover."""
        change = np.zeros(shape, dtype=np.int32)
        np.add.at(change, (self.line, self.start), 1)
        np.add.at(change, (self.line, self.stop), -1)
        return np.cumsum(change, axis=1) > 0

    def ends(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the grid points at which they start or stop."""
        points = np.zeros(shape, dtype=bool)
        points[self.line, self.start] = points[self.line, self.stop] = True
        return points


def _runs(cells: np.ndarray, crossed: np.ndarray) -> _Runs:
    """Return the longest segments of grid lines, along rows, with the region on both sides.

    They stop at points that are `crossed`. Grid line k and grid point k lie before cell k.
    """
    both, one = cells[:-1] & cells[1:], cells[:-1] ^ cells[1:]
    broken = crossed[1:-1, 1:-1]
    joined = both[:, :-1] & both[:, 1:] & ~broken
    line, start = np.nonzero(both[:, 1:] & ~joined)
    _, stop = np.nonzero(both[:, :-1] & ~joined)  # as many, in the same order
    return _Runs(line + 1, start + 1, stop + 1, one[line, start], one[line, stop + 1])


def _independent(across: _Runs, down: _Runs) -> tuple[_Runs, _Runs]:
    """Return the most chords no two of which meet, by the theorem of Koenig."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    count = len(across.line), len(down.line)
    if count[0] * count[1] > MAX_PAIRS:
        return across.take(np.zeros(0, dtype=int)), down.take(np.zeros(0, dtype=int))
    x, y = down.line, across.line[:, None]
    meet = (across.start[:, None] <= x) & (x <= across.stop[:, None])
    meet &= (down.start <= y) & (y <= down.stop)
    if not meet.any():
        return across, down
    partner = maximum_bipartite_matching(csr_array(meet), perm_type="row")  # of the columns
    free = np.ones(count[0], dtype=bool)
    free[partner[partner >= 0]] = False
    reached, seen, front = free.copy(), np.zeros(count[1], dtype=bool), free
    while front.any():
        new = meet[front].any(axis=0) & ~seen
        seen |= new
        front = np.zeros_like(reached)
        front[partner[new]] = True  # a column without partner would make the matching larger
        front &= ~reached
        reached |= front
    return across.take(reached), down.take(~seen)


def _components(
    cells: np.ndarray, levels: np.ndarray, walls: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of what cuts leave of a region, which are rectangles."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    number = np.cumsum(cells).reshape(cells.shape) - 1
    over = cells[:-1] & cells[1:] & ~levels[1:-1, :-1]
    beside = cells[:, :-1] & cells[:, 1:] & ~walls[:-1, 1:-1]
    one = np.concatenate([number[:-1][over], number[:, :-1][beside]])
    two = np.concatenate([number[1:][over], number[:, 1:][beside]])
    total = int(number[-1, -1]) + 1
    graph = coo_array((np.ones(len(one), dtype=bool), (one, two)), shape=(total, total))
    count, member = connected_components(graph, directed=False)
    lower, upper = np.full((count, 2), max(cells.shape)), np.zeros((count, 2), dtype=np.int64)
    places = np.stack(np.nonzero(cells), axis=1) - 1
    np.minimum.at(lower, member, places)
    np.maximum.at(upper, member, places + 1)
    return lower, upper
