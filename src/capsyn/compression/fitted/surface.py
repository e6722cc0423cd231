"""The switching surface, where the right label changes: points of it, and planes fitted to them.

All coordinates are those of the unit cube: shares of the domain's width along each axis. Sums over
states go through ``einsum``, not a BLAS, whose rounding may depend on the number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from capsyn.cells.masks import Label, empty, masks_of_members, members
from capsyn.random_streams import stream

NEEDLES = (0.05, 0.2, 0.8)
"""Mean lengths of needles [widths of the domain]; the next where the one before hits nothing."""
ROUNDS = 4
"""Most needles per sample."""
BATCHES = 8
"""Needles are thrown in so many batches per round, until there are hits enough."""
HITS = 10_000
"""Points of the surface that are enough."""
BISECTIONS = 11
"""Halvings of a needle that crosses the surface."""
EXPLAINED = 1500
"""Most points of the surface that planes are fitted to at once."""
CUT_PENALTY = 0.1
"""What a unit of area that cuts like states counts against one between unlike states."""
GROWTHS = 6
"""Most times that a plane is fitted again to all points that it explains."""
TRIES = 24
"""Neighbourhoods on the surface that planes are fitted to, per split."""
BAND = 0.02
"""Half the width of the band of states that measures the area of a plane in a region."""
AXIS_BONUS = 1.02
"""Of planes that are as good, one perpendicular to an axis is cheaper."""
Plane = tuple[np.ndarray, float]
"""Normal (n,) and offset: states beyond it have ``normal . x >= offset``."""


@dataclass(frozen=True, eq=False)
class Samples:
    """States drawn uniformly from the unit cube, and what is right there."""

    states: np.ndarray  # (B, n)
    right: np.ndarray  # (B, L) bool: whether each label is right at each state
    axes: int | None = None  # planes combine so many first coordinates, or the rest; None: all

    def __len__(self) -> int:
        return len(self.states)

    def count_right(self, labels: np.ndarray) -> int:
        """Return the number of states at which labels (B,) are right."""
        return int(np.count_nonzero(at_labels(self.right, labels)))

    def first(self, count: int) -> Samples:
        """Return the first samples, at most `count`."""
        return Samples(self.states[:count], self.right[:count], self.axes)


@dataclass(frozen=True, eq=False)
class Surface:
    """Points of the switching surface, spread evenly by area."""

    points: np.ndarray  # (P, n)
    area: float  # that each point stands for, of a cube with edges of length 1

    def part(self, rows: np.ndarray) -> Surface:
        """Return some of the points."""
        return Surface(self.points[rows], self.area)


def at_labels(right: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return whether labels (B,) are right, of what is for each label (B, L)."""
    places = np.arange(0, right.size, right.shape[1])
    return right.reshape(-1).take(places + labels)


def draw_samples(masks: Label, n: int, labels: int, count: int, seed: list[int]) -> Samples:
    """Return `count` states of the unit cube with their right labels.

    Where a mask (B, W) is 0 no label is right.
    """
    states = stream(*seed).random((count, n))
    return Samples(states, members(masks(states), labels))


def find_surface(masks: Label, samples: Samples, seed: list[int]) -> Surface:
    """Return points of the surface across which no label stays right, from where one is.

    A needle with a random place and direction crosses a surface of area A in the unit cube
    ``A * length * E|cos|`` times on average, wherever the surface is, so that hits are spread
    evenly by area. Needles start at the samples, whose labels are known.
    """
    n = samples.states.shape[1]
    # E|cos| of the angle between a random direction and an axis, in n dimensions
    mean_cosine = math.exp(math.lgamma(n / 2) - math.lgamma((n + 1) / 2)) / math.sqrt(math.pi)
    rng = stream(*seed)
    known = masks_of_members(samples.right)
    size = -(-len(samples) // BATCHES)
    for length in NEEDLES:
        hits, needles = [np.empty((0, n))], 0
        for k in range(ROUNDS * BATCHES):
            start, at_start = (x[k * size : (k + 1) * size] for x in (samples.states, known))
            if not len(start):
                start = rng.random((size, n))
                at_start = masks(start)
            hits.append(_crossings(masks, start, at_start, length, rng))
            needles += len(start)
            if sum(map(len, hits)) >= HITS:
                break
        points = np.concatenate(hits)
        if len(points):
            break
    area = 1 / (length * mean_cosine * needles)
    if len(points) > HITS:
        area *= len(points) / HITS
        points = rng.choice(points, HITS, replace=False)
    return Surface(points, area)


def _crossings(
    masks: Label, start: np.ndarray, at_start: np.ndarray, length: float, rng: np.random.Generator
) -> np.ndarray:
    """Return where needles from states (B, n) cross the surface, by bisection."""
    direction = rng.standard_normal(start.shape)
    # of random length around its mean, so that no regular pattern is missed
    size = length * 2 * rng.random(len(start)) / np.sqrt((direction**2).sum(axis=1))
    direction *= size[:, None]
    end = start + direction
    inside = ((end >= 0) & (end < 1)).all(axis=1)
    start, end, at_start = start[inside], end[inside], at_start[inside]
    if not len(start):
        return start
    apart = ~empty(at_start) & empty(at_start & masks(end))
    start, end, at_start = start[apart], end[apart], at_start[apart]
    for _ in range(BISECTIONS if len(start) else 0):
        middle = (start + end) / 2
        same = ~empty(masks(middle) & at_start)
        start[same], end[~same] = middle[same], middle[~same]
    return (start + end) / 2


def distances(states: np.ndarray, plane: Plane) -> np.ndarray:
    """Return the signed distances (B,) of states (B, n) from a plane with a unit normal."""
    normal, offset = plane
    along = states[:, 0] * normal[0]
    for axis in range(1, len(normal)):  # faster than a product, and alike on all processors
        along += states[:, axis] * normal[axis]
    along -= offset
    return along


def nearest_plane(points: np.ndarray) -> Plane:
    """Return the plane nearest to points (P, n), by total least squares."""
    middle = points.mean(axis=0)
    spread = points - middle
    normal = np.linalg.eigh(np.einsum("pi,pj->ij", spread, spread))[1][:, 0]
    return normal, float((normal * middle).sum())


def surface_planes(points: np.ndarray, tolerance: float, rng: np.random.Generator) -> list[Plane]:
    """Return planes through random neighbourhoods, each grown to all points that it explains.

    After each plane comes the one perpendicular to an axis that is nearest to the same points (P,
    n). A plane explains the points within the tolerance.
    """
    n = points.shape[1]
    planes: list[Plane] = []
    for _ in range(TRIES):
        distance = ((points - points[rng.integers(len(points))]) ** 2).sum(axis=1)
        share = 10 ** rng.uniform(-2, 0)  # from a hundredth of the points to all
        near = min(len(points), max(3 * n, int(len(points) * share)))
        explained = points[np.argpartition(distance, near - 1)[:near]]
        for _ in range(GROWTHS):
            plane = nearest_plane(explained)
            inside = points[np.abs(distances(points, plane)) < tolerance]
            if len(inside) < 3 * n:
                break
            explained = inside
        axis = int(np.abs(plane[0]).argmax())
        planes += [plane, (np.eye(n)[axis], float(np.median(explained[:, axis])))]
    return planes


def best_plane(
    surface: Surface,
    states: np.ndarray,
    volume: float,
    tolerance: float,
    rng: np.random.Generator,
) -> Plane:
    """Return the plane that explains most surface in a region and cuts least elsewhere.

    The states (B, n) are drawn uniformly from the region, which has a volume; a plane explains the
    points within the tolerance.
    """
    points = surface.points
    if len(points) > EXPLAINED:
        points = rng.choice(points, EXPLAINED, replace=False)
    states = states[: 2 * EXPLAINED]
    planes = surface_planes(points, tolerance, rng)
    normals = np.array([normal for normal, _ in planes])
    offsets = np.array([offset for _, offset in planes])

    def share_near(x: np.ndarray, width: float) -> np.ndarray:
        return (np.abs(np.einsum("bi,pi->bp", x, normals) - offsets) < width).mean(axis=0)

    explained = share_near(points, tolerance) * surface.area * len(surface.points)
    # the area of a plane in the region is the volume of a band around it by the band's width
    section = share_near(states, BAND) * volume / (2 * BAND)
    gain = explained - CUT_PENALTY * np.maximum(section - explained, 0)
    gain[1::2] *= AXIS_BONUS
    return planes[int(np.argmax(gain))]
