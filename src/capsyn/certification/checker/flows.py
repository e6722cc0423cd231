"""Where sets of states are after a time under a control, for the checker: enclosures of its own."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from capsyn.certification.checker.bounds import Interval, bounds
from capsyn.programs.continuity import jump_conditions
from capsyn.programs.program import Program

ORDER, PARTS, ROUNDING = 9, 64, 2.0**-44
Ends = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Flows:
    """Rates ``f(x, u, p)`` of n states, and parameters (2, P) that are anywhere between."""

    rates: Program
    n: int
    parameters: np.ndarray
    widths: np.ndarray  # (n,): what states are measured in

    @cached_property
    def jumps(self) -> Program:
        """Conditions that are constant where the rates are continuous."""
        return jump_conditions(self.rates)

    def _inputs(self, low: np.ndarray, high: np.ndarray, u: np.ndarray) -> list[Interval]:
        states = [Interval(low[:, i], high[:, i]) for i in range(self.n)]
        controls = [Interval(one, one) for one in u.T]
        return states + controls + [Interval(*ends) for ends in self.parameters.T]

    def rate(self, low: np.ndarray, high: np.ndarray, u: np.ndarray) -> Ends:
        """Return bounds (B, n) of the rates over boxes under controls (B, m)."""
        found, _ = bounds(self.rates, self._inputs(low, high, u))
        return _stacked(found, (len(low),))

    def slopes(self, low: np.ndarray, high: np.ndarray, u: np.ndarray, parts: int = 1) -> Ends:
        """Return bounds (B, n, n) of the Jacobian; NaN where rates may jump.

        They are of so many parts of the boxes along each axis.
        """
        if parts > 1:
            width, boxes = (high - low) / parts, []
            for place in itertools.product(range(parts), repeat=self.n):
                ends = [low + width * (np.array(place) + k) for k in (0, 1)]
                ends[1] = np.where(np.array(place) == parts - 1, high, ends[1])
                boxes.append(self.slopes(ends[0], ends[1], u))
            lows, highs = zip(*boxes)
            return np.minimum.reduce(lows), np.maximum.reduce(highs)
        inputs, unit = self._inputs(low, high, u), np.eye(self.n)[:, :, None]
        seeds: list[Interval | None] = [Interval(e, e) for e in unit]
        _, found = bounds(self.rates, inputs, seeds + [None] * (len(inputs) - self.n))
        sides, _ = bounds(self.jumps, inputs)
        steady = np.ones(len(low), bool)
        for side in sides:
            steady &= side.low == side.high
        none = Interval(np.float64(0.0), np.float64(0.0))
        least, most = _stacked([one or none for one in found], (self.n, len(low)))
        lost = np.where(steady, 0.0, np.nan)[:, None, None]
        return least + lost, most + lost

    def tube(
        self, low: np.ndarray, high: np.ndarray, u: np.ndarray, times: np.ndarray
    ) -> tuple[Ends, Ends]:
        """Return boxes (B, n) that solutions from boxes stay in for times (B,), NaN if unknown.

        There are two, the second within the first. They do where ``x + [0, t] f(box)`` lies in the
        box for all x at first (Picard); then they stay in that, too.
        """
        t, size = times[:, None], np.maximum(np.abs(low), np.abs(high))

        def reached(rate: Ends, more: float, pad: float) -> Ends:
            wide = more * (rate[1] - rate[0])
            down, up = t * np.minimum(rate[0] - wide, 0), t * np.maximum(rate[1] + wide, 0)
            return low + down * (1 + pad) - pad * size, high + up * (1 + pad) + pad * size

        tried, done = reached(self.rate(low, high, u), 0.0, 2.0**-44), np.zeros(len(low), bool)
        for _ in range(14):
            rate = self.rate(*tried, u)
            inner = reached(rate, 0.0, 2.0**-48)
            done |= ((inner[0] >= tried[0]) & (inner[1] <= tried[1])).all(axis=1)
            if done.all():
                break
            wider = reached(rate, 0.1, 2.0**-44)
            keep = done[:, None]
            tried = np.where(keep, tried[0], wider[0]), np.where(keep, tried[1], wider[1])
        lost = np.where(done, 0.0, np.nan)[:, None]
        return (tried[0] + lost, tried[1] + lost), inner

    def affine(
        self, points: np.ndarray, error: np.ndarray, u: np.ndarray, times: np.ndarray, tube: Ends,
        parts: int = 1,
    ) -> Ends:  # fmt: skip
        """Return sets along ``F + J (x - middle)``, and by how much solutions stray from there.

        With slopes J(y) on the way from the middle m to x, ``f(x) - f(m)`` is the mean of
        J(m + s (x - m)) (x - m) over s: that for s < 1/2 in the inner half of the tube.
        """
        n, t = self.n, times[:, None]
        middle, half = (tube[0] + tube[1]) / 2, (tube[1] - tube[0]) / 2 * (1 + 2.0**-48)
        low, high = self.slopes(*tube, u, parts)
        near = half / 2 + 2.0**-50 * np.abs(middle)
        inner = self.slopes(middle - near, middle + near, u, parts)
        at = self.rate(middle, middle, u)
        F, J = (at[0] + at[1]) / 2, (low + high) / 2
        off = (np.maximum(high - J, J - low) + np.maximum(inner[1] - J, J - inner[0])) / 2
        rest = (at[1] - at[0]) / 2 + _apply(off, half)
        rest += 2.0**-48 * (np.abs(F) + _apply(np.abs(J), half))
        phi = np.zeros_like(J)
        for k in range(ORDER, 0, -1):  # t I + t^2 / 2 J + .., Horner's rule
            phi = (np.eye(n) + J @ phi) * (t / k)[:, :, None]
        turn = phi @ J
        M, shift = np.eye(n) + turn, _apply(phi, F) - _apply(turn, middle)
        rate = np.abs(F) + _apply(np.abs(J), half)
        strayed, cut = self._series(np.abs(J), rest, t)
        _, more = self._series(np.abs(J), rate, t)
        far = np.maximum(np.abs(tube[0]), np.abs(tube[1]))
        size = far + _apply(np.abs(M) + np.abs(turn), far) + _apply(np.abs(phi), np.abs(F))
        size += _apply(np.abs(M), far) + t * rate
        grown = (_apply(np.abs(M), error) + strayed + self.widths * (cut + more)) * (1 + 2.0**-40)
        if points.shape[2] != 2:
            center, wide = points.mean(axis=1), (points[:, 1] - points[:, 0]) / 2
            center, wide = _apply(M, center) + shift, _apply(np.abs(M), wide)
            moved = np.stack([center - wide, center + wide], axis=1)
        else:
            moved = points @ M.transpose(0, 2, 1) + shift[:, None]
        return moved, grown + ROUNDING * size

    def _series(self, J: np.ndarray, v: np.ndarray, t: np.ndarray) -> Ends:
        """Return what |z| grows to if ``|z'| <= J |z| + v``: terms, and the rest in widths."""
        term = total = t * v
        for k in range(2, ORDER + 1):
            term = _apply(J, term) * (t / k)
            total = total + term
        ratio = (
            1.001 * t * (_apply(J, self.widths) / self.widths).max(axis=1)[:, None] / (ORDER + 1)
        )
        rest = 1.001 * (term / self.widths).max(axis=1)[:, None] * ratio / (1 - ratio)
        return total, np.where(ratio < 0.5, rest, np.nan)

    def faces(
        self, low: np.ndarray, high: np.ndarray, b_low: np.ndarray, b_high: np.ndarray,
        u: np.ndarray, times: np.ndarray,
    ) -> Ends:  # fmt: skip
        """Return boxes after times: each face moves at most as states do that may get near it."""
        rate, count = self.rate(b_low, b_high, u), len(low)
        reach = times[:, None] * np.maximum(np.abs(rate[0]), np.abs(rate[1])) * (1 + 1e-12)
        axis = np.repeat(np.tile(np.arange(self.n), 2), count)
        sign = np.repeat([-1.0, 1.0], self.n * count)
        every, of = np.arange(len(axis)), np.tile(np.arange(count), 2 * self.n)
        face, reach = np.where(sign > 0, high[of, axis], low[of, axis]), reach[of, axis]
        pad, slab = 2.0**-48 * np.abs(face), (b_low[of], b_high[of])
        slab[0][every, axis] = np.maximum(slab[0][every, axis], face - reach - pad)
        slab[1][every, axis] = np.minimum(slab[1][every, axis], face + reach + pad)
        most = times[of] * self.most(*slab, u[of], axis, sign)
        moved = sign * face + np.maximum(-reach, most)
        moved = sign * (moved + 2.0**-46 * (np.abs(face) + reach + np.abs(most)))
        ends = moved.reshape(2, self.n, count).transpose(0, 2, 1)
        return np.maximum(b_low, ends[0]), np.minimum(b_high, ends[1])

    def most(
        self, low: np.ndarray, high: np.ndarray, u: np.ndarray, axis: np.ndarray, sign: np.ndarray,
        enough: float = -np.inf,
    ) -> np.ndarray:  # fmt: skip
        """Return upper bounds (B,) of rates along axes (B,), signs turned, over boxes.

        The part of a box with the largest is halved, until there are `PARTS`, or all are `enough`.
        """
        every = np.arange(len(low))

        def over(low: np.ndarray, high: np.ndarray) -> np.ndarray:
            least, most = self.rate(low, high, u)
            found = np.where(sign > 0, most[every, axis], -least[every, axis])
            return np.where(np.isnan(found), np.inf, found)

        full = np.where(high > low, high - low, np.inf)
        boxes = np.stack([low, high])[:, :, None].repeat(PARTS, axis=2)
        worst = np.full((len(low), PARTS), -np.inf)
        worst[:, 0] = over(low, high)
        for count in range(1, PARTS):
            top = worst.argmax(axis=1)
            if (worst[every, top] <= enough).all():
                break
            first = boxes[:, every, top].copy()
            widest = ((first[1] - first[0]) / full).argmax(axis=1)
            second = first.copy()
            middle = first[:, every, widest].mean(axis=0)
            first[1, every, widest] = second[0, every, widest] = middle
            boxes[:, every, top], boxes[:, :, count] = first, second
            worst[every, top], worst[:, count] = over(*first), over(*second)
        return worst.max(axis=1)


def _stacked(found: list[Interval], shape: tuple[int, ...]) -> Ends:
    """Return the ends (B, size, ...) of intervals (..., B)."""
    low = [np.broadcast_to(one.low, shape).T for one in found]
    high = [np.broadcast_to(one.high, shape).T for one in found]
    return np.stack(low, axis=1), np.stack(high, axis=1)


def _apply(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (matrices * vectors[..., None, :]).sum(axis=-1)
