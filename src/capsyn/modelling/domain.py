"""Sets of states: `Box` with its integer lattice, and `Ball`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.validation import (
    describe,
    distinct,
    finite_array,
    finite_number,
    is_list,
    keep,
    plain,
    texts,
)

LARGEST = 1e290
"""Largest bound of a box: no finite state minus a bound overflows, nor does a width."""


@dataclass(frozen=True, eq=False)
class Box:
    """A box of states, with names, units and periodic axes.

    Parameters
    ----------
    lower, upper : (n,)
        Bounds [state units], ``lower <= upper``. A state with equal bounds is fixed; a domain has
        no fixed state.
    names, units : n strings, optional
        Names and units of the states. Default: ``x1 .. xn`` and no units.
    periodic : n booleans, optional
        True for an axis on which ``upper`` is the same point as ``lower`` (an angle). Default: no
        axis.

    Notes
    -----
    The box has an integer lattice. Axis `i` is cut into ``counts[i]`` equal steps. The face with
    integer coordinate ``k`` lies at ``lower + (upper - lower) * (k / count)``, rounded as written,
    and the face ``k == count`` lies at ``upper``. A state belongs to step ``k`` exactly when
    ``face(k) <= state < face(k + 1)`` in floating point. On an ordinary axis, the upper face of the
    box belongs to the last step. Every backend and export follows this rule.

    Raises
    ------
    ProblemError
        Wrong shapes, bounds that are NaN or beyond `LARGEST`, or ``upper < lower``.
    """

    lower: Any
    upper: Any
    names: Any = None
    units: Any = None
    periodic: Any = None

    def __post_init__(self) -> None:
        lower = finite_array("lower", self.lower, 1)
        upper = finite_array("upper", self.upper, 1)
        n = len(lower)
        if n == 0 or upper.shape != lower.shape:
            raise ProblemError(
                f"`lower` and `upper` must have one entry per state; got {n} and {len(upper)}"
            )
        names = texts("names", self.names, n, self.unnamed(n))
        distinct("names", names)
        for name, low, high in zip(names, lower, upper):
            if not low <= high:
                raise ProblemError(
                    f"`upper` must be at least `lower` on axis '{name}'; got [{low}, {high}]"
                )
            if max(abs(low), abs(high)) > LARGEST:
                raise ProblemError(
                    f"`lower` and `upper` must be within +-{LARGEST:g} on axis '{name}'; "
                    f"got [{low}, {high}]"
                )
        units = texts("units", self.units, n, [""] * n)
        periodic = (False,) * n if self.periodic is None else self.periodic
        if not is_list(periodic, n) or not all(isinstance(p, (bool, np.bool_)) for p in periodic):
            raise ProblemError(f"`periodic` must be {n} boolean(s); got {describe(periodic)}")
        periodic = tuple(bool(p) for p in periodic)
        keep(self, lower=lower, upper=upper, names=names, units=units, periodic=periodic)

    @staticmethod
    def unnamed(n: int) -> tuple[str, ...]:
        """Return the names of `n` states that have no names of their own."""
        return tuple(f"x{i + 1}" for i in range(n))

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.lower)

    @property
    def widths(self) -> np.ndarray:
        """Widths of the axes, ``upper - lower`` (n,) [state units]."""
        return self.upper - self.lower

    @property
    def periods(self) -> np.ndarray:
        """Periods of the axes (n,) [state units]; 0 for axes that are not periodic."""
        return np.where(self.periodic, self.widths, 0.0)

    def check_wide(self, what: str) -> None:
        """Raise `ProblemError` where a state is fixed; `what` is the argument that the box is."""
        for name, low, high in zip(self.names, self.lower, self.upper):
            if not low < high:
                raise ProblemError(
                    f"`upper` must be greater than `lower` on axis '{name}' of `{what}`; got "
                    f"[{low}, {high}]"
                )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Box) and self.to_json() == other.to_json()

    def __hash__(self) -> int:
        return hash((tuple(self.lower), tuple(self.upper), self.names, self.periodic))

    def to_json(self) -> dict[str, Any]:
        """Return the box as plain data."""
        return plain(self)

    def faces(self, axis: int, k: np.ndarray, count: int) -> np.ndarray:
        """Return the positions (K,) [state unit] of the faces `k` (K,) of `count` steps on an axis.

        Face ``k`` lies at ``lower + (upper - lower) * (k / count)``, rounded as written. Face
        `count` lies at ``upper``.
        """
        low, high = self.lower[axis], self.upper[axis]
        positions = np.divide(k, count)
        positions *= high - low
        positions += low
        np.copyto(positions, high, where=k >= count)
        return positions

    def check_resolution(self, counts: Sequence[int]) -> None:
        """Check that floating point tells the faces of `counts` (n,) steps apart.

        Raises
        ------
        ProblemError
            Two neighbouring faces of an axis would be the same number.
        """
        for i, count in enumerate(counts):
            low, high = float(self.lower[i]), float(self.upper[i])
            step = (high - low) / count
            # 1e-300: `locate` needs 1 / step, which must not overflow
            if step < max(8 * np.spacing(max(abs(low), abs(high))), 1e-300):
                raise ProblemError(
                    f"`max_level` is too high: axis '{self.names[i]}' would be cut into "
                    f"{count} steps of {step:g}, finer than floating point near its bounds"
                )

    def points(self, coordinates: np.ndarray, counts: Sequence[int]) -> np.ndarray:
        """Return the states (B, n) at lattice `coordinates` (B, n), with `counts` (n,) steps."""
        return np.stack(
            [self.faces(i, coordinates[:, i], counts[i]) for i in range(self.n)], axis=1
        )

    def wrap(self, states: np.ndarray) -> np.ndarray:
        """Return the states (B, n) with periodic axes brought into ``[lower, upper)``.

        A wrapped coordinate that rounds to ``upper`` becomes ``lower``.
        """
        if not any(self.periodic):
            return states
        states = states.copy()
        for i in np.flatnonzero(self.periodic):
            low, high, x = self.lower[i], self.upper[i], states[:, i]
            with np.errstate(invalid="ignore"):
                off = ~((x >= low) & (x < high))
                rest = np.fmod(x[off] - low, high - low)
            rest = low + np.where(rest < 0, rest + (high - low), rest)
            x[off] = np.where(rest >= high, low, rest)
        return states

    def contains(self, states: np.ndarray) -> np.ndarray:
        """Return which `states` (B, n) are in the box, (B,) booleans.

        A state is in the box if it is finite, and within the bounds of all axes that are not
        periodic.
        """
        with np.errstate(invalid="ignore"):
            inside = (states >= self.lower) & (states <= self.upper)
        return np.all((inside | self.periodic) & np.isfinite(states), axis=1)

    def locate(self, states: np.ndarray, counts: Sequence[int]) -> np.ndarray:
        """Return the lattice steps (B, n) that hold the states (B, n).

        Each axis has `counts` (n,) steps. A state beyond the bounds of an ordinary axis takes the
        nearest step. Coordinates must not be NaN, and coordinates of periodic axes must be finite.
        """
        states = self.wrap(states)
        steps = np.empty(states.shape, dtype=np.int64)
        for i, count in enumerate(counts):
            low, high = self.lower[i], self.upper[i]
            x = np.clip(states[:, i], low, high)
            k = np.minimum((x - low) * (count / (high - low)), count - 1).astype(np.int64)
            k -= x < self.faces(i, k, count)
            k += (x >= self.faces(i, k + 1, count)) & (k + 1 < count)
            steps[:, i] = k
        return steps

    def sample(self, count: int, seed: int | Sequence[int] | np.random.Generator = 0) -> np.ndarray:
        """Return `count` random states (count, n), uniform in the box. A `seed` repeats them."""
        unit = np.random.default_rng(seed).random((count, self.n))
        return self.lower + unit * self.widths


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball of states: ``|x - center| <= radius``.

    Parameters
    ----------
    center : (n,)
        Centre [state units].
    radius : float
        Radius > 0 [state units].
    names : n strings, optional
        The states that the ball restricts. Default: all states, in order.
    """

    center: Any
    radius: float
    names: Any = None

    def __post_init__(self) -> None:
        center = finite_array("center", self.center, 1)
        if not len(center):
            raise ProblemError("`center` must have one entry per state; got none")
        keep(self, center=center, radius=finite_number("radius", self.radius, above=0.0))
        if self.names is not None:
            names = texts("names", self.names, len(center), ())
            distinct("names", names)
            keep(self, names=names)

    @property
    def n(self) -> int:
        """Number of states that the ball restricts."""
        return len(self.center)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Ball) and self.to_json() == other.to_json()

    def __hash__(self) -> int:
        return hash((tuple(self.center), self.radius))

    def to_json(self) -> dict[str, Any]:
        """Return the ball as plain data."""
        named = {} if self.names is None else {"names": list(self.names)}
        return {"center": self.center.tolist(), "radius": self.radius} | named

    def sample(self, count: int, seed: int | Sequence[int] = 0) -> np.ndarray:
        """Return `count` states (count, n), drawn uniformly from the ball, the same for a `seed`.

        The first states do not depend on `count`.
        """
        # streams of their own: the first points do not depend on how many there are
        direction, distance = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(2))
        normal = direction.standard_normal((count, self.n))
        radius = self.radius * distance.random(count) ** (1 / self.n)
        return self.center + normal * (radius / np.linalg.norm(normal, axis=1))[:, None]
