"""The C of polygons, boxes and flows as functions of NumPy arrays, and exact polygons."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from capsyn.native.build import load
from capsyn.native.source import pointer
from capsyn.reach import kernel
from capsyn.reach.loop import SampledLoop

SLACK = 2.0**-43
"""Of the C source: by what share of its largest coordinate a shape may be too small."""

FLOWS = """
int test_flow(const double *u, const double *p, const double *w, const double time,
              const int32_t count, double *v, double *error, double *ends, int32_t *now)
{
    arguments a;
    shape s = {.count = count};
    box b;
    memcpy(s.v, v, sizeof(double) * SHAPE_SIZE);
    for (int j = 0; j < CONTROLS; ++j)
        a.ends[0][STATES + j][0] = a.ends[1][STATES + j][0] = u[j];
    for (int end = 0; end < 2; ++end)
        for (int j = 0; j < PARAMETERS; ++j)
            a.ends[end][STATES + CONTROLS + j][0] = p[end * PARAMETERS + j];
    const int known = flow(&a, w, time, &s, error, &b);
    memcpy(v, s.v, sizeof s.v), memcpy(ends, b.lower, sizeof b.lower);
    memcpy(ends + STATES, b.upper, sizeof b.upper);
    *now = s.count;
    return known;
}

int test_cut(const int32_t count, double *v, const double *a, const double limit, int32_t *now)
{
    shape s = {.count = count}, out;
    memcpy(s.v, v, sizeof(double) * SHAPE_SIZE);
    const int any = cut_off(&s, a, limit, &out);
    memcpy(v, out.v, sizeof out.v);
    *now = out.count;
    return any;
}

int test_hull(const int32_t one, const double *v, const int32_t two, double *w, int32_t *now)
{
    shape s = {.count = one}, t = {.count = two}, out;
    memcpy(s.v, v, sizeof(double) * SHAPE_SIZE), memcpy(t.v, w, sizeof(double) * SHAPE_SIZE);
    hull(&s, &t, &out);
    memcpy(w, out.v, sizeof out.v);
    *now = out.count;
    return 1;
}
"""


@dataclass(frozen=True)
class Pieces:
    """The functions of a loop's kernel; shapes are vertices (K, 2), or ends (2, n) of boxes."""

    loop: SampledLoop
    library: Any

    @staticmethod
    def build(loop: SampledLoop) -> Pieces:
        return Pieces(loop, load(kernel.source(loop) + FLOWS, ("-ffp-contract=off",)))

    def _room(self, shape: np.ndarray) -> np.ndarray:
        n = self.loop.space.n
        room = np.zeros(2 * kernel.MOST_VERTICES if n == 2 else 2 * n)
        room[: shape.size] = shape.ravel()
        return room

    def _shape(self, room: np.ndarray, now: Any) -> np.ndarray:
        n = self.loop.space.n
        return room[: n * now.value].reshape(-1, n)

    def flow(
        self, u: np.ndarray, time: float, shape: np.ndarray, error: np.ndarray, p: np.ndarray
    ) -> tuple[bool, np.ndarray, np.ndarray, np.ndarray]:
        """Return (known, shape, error (n,), tube (2, n)) after a time under a control."""
        n = self.loop.space.n
        v, ends, now = self._room(shape), np.zeros((2, n)), ctypes.c_int32()
        error = np.array(error, dtype=float)
        arrays = (np.asarray(u, float), np.ascontiguousarray(p, float), self.loop.space.widths)
        known = self.library.test_flow(
            *map(pointer, arrays), ctypes.c_double(time), len(shape), pointer(v), pointer(error),
            pointer(ends), ctypes.byref(now),
        )  # fmt: skip
        return bool(known), self._shape(v, now), error, ends

    def cut(self, shape: np.ndarray, a: np.ndarray, limit: float) -> np.ndarray | None:
        """Return what of a shape has ``a . x <= limit``; None where nothing."""
        v, now = self._room(shape), ctypes.c_int32()
        any_ = self.library.test_cut(
            len(shape), pointer(v), pointer(np.asarray(a, float)), ctypes.c_double(limit),
            ctypes.byref(now),
        )  # fmt: skip
        return self._shape(v, now) if any_ else None

    def hull(self, one: np.ndarray, two: np.ndarray) -> np.ndarray:
        """Return the hull of two shapes, or what is around it."""
        v, w, now = self._room(one), self._room(two), ctypes.c_int32()
        self.library.test_hull(len(one), pointer(v), len(two), pointer(w), ctypes.byref(now))
        return self._shape(w, now)


Point = tuple[Fraction, Fraction]


def exact(shape: np.ndarray) -> list[Point]:
    return [(Fraction(float(x)), Fraction(float(y))) for x, y in shape]


def turn(o: Point, a: Point, b: Point) -> Fraction:
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])


def exact_hull(points: list[Point]) -> list[Point]:
    """Return the vertices of the convex hull, counterclockwise, in exact arithmetic."""
    points = sorted(set(points))
    if len(points) < 3:
        return points
    chains = []
    for order in (points, points[::-1]):
        chain: list[Point] = []
        for point in order:
            while len(chain) > 1 and turn(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        chains += chain[:-1]
    return chains


def exact_cut(polygon: list[Point], a: np.ndarray, limit: float) -> list[Point]:
    """Return the vertices of what of a convex polygon has ``a . x <= limit``, exactly."""
    normal = Fraction(float(a[0])), Fraction(float(a[1]))
    values = [normal[0] * x + normal[1] * y - Fraction(limit) for x, y in polygon]
    kept = []
    for k, (point, value) in enumerate(zip(polygon, values)):
        then, after = polygon[(k + 1) % len(polygon)], values[(k + 1) % len(polygon)]
        if value <= 0:
            kept.append(point)
        if (value <= 0) != (after <= 0):
            t = value / (value - after)
            kept.append((point[0] + t * (then[0] - point[0]), point[1] + t * (then[1] - point[1])))
    return kept


def beyond(point: Point, hull: list[Point]) -> float:
    """Return how far a point is outside a convex hull; 0 inside."""
    count = len(hull)
    edges = [(hull[k], hull[(k + 1) % count]) for k in range(count)]
    if count > 2 and all(turn(a, b, point) >= 0 for a, b in edges):
        return 0.0
    least = math.inf
    for a, b in edges:
        along = (b[0] - a[0], b[1] - a[1])
        size = along[0] ** 2 + along[1] ** 2
        t = Fraction(0)
        if size:
            t = ((point[0] - a[0]) * along[0] + (point[1] - a[1]) * along[1]) / size
            t = min(max(t, Fraction(0)), Fraction(1))
        off = (point[0] - a[0] - t * along[0], point[1] - a[1] - t * along[1])
        least = min(least, math.hypot(float(off[0]), float(off[1])))
    return least
