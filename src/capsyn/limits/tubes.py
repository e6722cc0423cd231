"""Enclosures of flows: where all states of a box may be under a constant control, and end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.modelling.transcription import flow_programs
from capsyn.native.bounds import box_bounds
from capsyn.programs.ends import Interval
from capsyn.programs.program import Program

TRIES = 20
"""Times that a box which may hold all states on the way is widened, before none is found."""
WIDER = 0.1
"""How much wider each is than what it is to hold, as a share of the motion."""
SLACK = 1e-12
"""Share of a duration by which it may be off: what 1 over a rate, or a sum of times, rounds."""
CHUNK = 1 << 15
"""Boxes at a time: what the work on them needs stays in the cache."""


@dataclass(frozen=True)
class Tubes:
    """What encloses the flows of boxes; NaN in all rows of a box of which nothing is known.

    Every solution that starts in a box stays between `lower` and `upper` from its start to its end,
    and ends between `end_lower` and `end_upper`.
    """

    lower: np.ndarray  # (n, B) float64 [state units]
    upper: np.ndarray
    end_lower: np.ndarray
    end_upper: np.ndarray


@dataclass(frozen=True)
class Flow:
    """Bounds of the flows of ``x' = f(x, u)`` or ``f(x, u, p)``, rigorous: rounded outwards.

    An exogenous input is a component of x whose rate is 0, as in a `Model`.
    """

    dynamics: Program
    motion: Callable[..., list[Interval]]  # (x, b, u[, p], t) -> x + t f, f(b, u, p)
    end: Callable[..., list[Interval]] | None  # (x, c, b, u[, p], t), of second order

    @staticmethod
    def of(dynamics: Program, backend: str = "auto") -> Flow:
        """Return the bounds of a dynamics program: inputs x, u and, perhaps, p; output xdot."""
        motion, end = flow_programs(dynamics)
        mean = None if end is None else box_bounds(end, backend)
        return Flow(dynamics, box_bounds(motion, backend), mean)

    def tubes(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        controls: np.ndarray,
        duration: Any,
        parameters: Interval | None = None,
        steps: int = 1,
    ) -> Tubes:
        """Return where the states of boxes are under controls, on the way and at the end.

        Parameters
        ----------
        lower, upper : (n, B)
            Boxes of states, both ends included, and of exogenous inputs after them.
        controls : (m, B)
            Constant controls [input units].
        duration : float or (B,)
            Time from start to end, >= 0 [time unit].
        parameters : pair of (k,) or (k, B), optional
            Ranges of the parameters p; each is constant, and unknown.
        steps : int
            Parts that the duration is divided into, for long ones: each begins with the box that
            the one before it ends in.
        """
        lower, upper = (np.asarray(end, dtype=float) for end in (lower, upper))
        count = lower.shape[1]
        times = np.broadcast_to(np.asarray(duration, dtype=float), count)
        ranges = None
        if parameters is not None:
            ranges = [np.reshape(end, (len(end), -1)) for end in parameters]
            ranges = [np.broadcast_to(end, (len(end), count)) for end in ranges]
        found = np.empty((4, *lower.shape))
        for rows in _chunks(count):
            known = () if ranges is None else (tuple(end[:, rows] for end in ranges),)
            control = np.ascontiguousarray(controls[:, rows], dtype=float)
            inputs = ((control, control), *known)
            found[:, :, rows] = self._steps(
                lower[:, rows], upper[:, rows], inputs, times[rows][None], steps
            )
        return Tubes(*found)

    def _steps(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        inputs: tuple[Any, ...],
        times: np.ndarray,
        steps: int,
    ) -> tuple[np.ndarray, ...]:
        """Return tube and end (n, B) of boxes after all steps."""
        part = times / steps * (1 - SLACK), times / steps * (1 + SLACK)
        least, most = lower, upper
        for _ in range(steps):
            tube = self._enclosure(lower, upper, inputs, part[1])
            lower, upper = self._ends(lower, upper, tube, inputs, part)
            least, most = np.minimum(least, tube[0]), np.maximum(most, tube[1])
        return least, most, lower, upper

    def _enclosure(
        self, lower: np.ndarray, upper: np.ndarray, inputs: tuple[Any, ...], times: np.ndarray
    ) -> Interval:
        """Return boxes (n, B) that no solution leaves, by Picard's operator; NaN where none is.

        A box b that is wider than the first on every side, and holds ``x + [0, t] f(b)``, is one.
        For the first time at which a solution is about to leave is one at which it lies inside: on
        the way to b's upper side it has climbed less than ``t sup f(b)``, and not at all where that
        is negative. No more than a continuous f is asked for; where f jumps, its bounds hold both
        sides, and what is said goes for solutions in the sense of Filippov.
        """
        span = (np.zeros_like(times), times)
        box = (lower, upper)
        start = (lower, upper)
        held = np.full((2, *lower.shape), np.nan)
        left = np.arange(lower.shape[1])
        with np.errstate(all="ignore"):
            motion, _ = self.motion(start, box, *inputs, span)
            for _ in range(TRIES):
                box = _wider(start, motion)
                motion, rates = self.motion(start, box, *inputs, span)
                inside = (motion[0] >= box[0]) & (motion[1] <= box[1])  # never of NaN
                inside = inside.all(axis=0) & np.isfinite(box).all(axis=(0, 1))
                held[:, :, left[inside]] = _hull(start, motion, rates, inside)
                if inside.all():
                    break
                out = ~inside
                left = left[out]
                start, motion = _of(start, out), _of(motion, out)
                inputs = tuple(_of(pair, out) for pair in inputs)
                span = _of(span, out)
        return held[0], held[1]

    def _ends(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        tube: Interval,
        inputs: tuple[Any, ...],
        times: Interval,
    ) -> Interval:
        """Return boxes (n, B) that hold the ends; NaN where the tube is."""
        start = (lower, upper)
        with np.errstate(all="ignore"):
            (low, high), _ = self.motion(start, tube, *inputs, times)
            low, high = np.fmax(low, tube[0]), np.fmin(high, tube[1])
            if self.end is not None:
                middle = np.clip(lower + (upper - lower) / 2, lower, upper)
                ((least, most),) = self.end(start, (middle, middle), tube, *inputs, times)
                low, high = np.fmax(low, least), np.fmin(high, most)
        return np.where(np.isnan(tube[0]), np.nan, low), np.where(np.isnan(tube[0]), np.nan, high)


def _chunks(count: int) -> Iterator[slice]:
    for first in range(0, count, CHUNK):
        yield slice(first, min(first + CHUNK, count))


def _below(values: np.ndarray) -> np.ndarray:
    return np.nextafter(values, -np.inf)


def _above(values: np.ndarray) -> np.ndarray:
    return np.nextafter(values, np.inf)


def _of(pair: Interval, boxes: np.ndarray) -> Interval:
    return pair[0][:, boxes], pair[1][:, boxes]


def _hull(start: Interval, motion: Interval, rates: Interval, boxes: np.ndarray) -> np.ndarray:
    """Return the boxes (2, n, B) that hold starts and motions, for some of the boxes.

    What never falls, or never climbs, does not leave its start on that side, nor by rounding.
    """
    low = np.minimum(start[0], np.where(rates[0] >= 0, start[0], motion[0]))
    high = np.maximum(start[1], np.where(rates[1] <= 0, start[1], motion[1]))
    return np.stack([low[:, boxes], high[:, boxes]])


def _wider(start: Interval, motion: Interval) -> Interval:
    """Return boxes that hold starts and motions with something to spare on every side."""
    low, high = np.minimum(start[0], motion[0]), np.maximum(start[1], motion[1])
    spare = WIDER * (start[0] - low + high - start[1]) + 1e-12 * (np.abs(low) + np.abs(high))
    return _below(low - spare), _above(high + spare)
