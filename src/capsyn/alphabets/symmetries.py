"""Symmetries of a problem, and the orbits of candidates under them.

A symmetry is a signed permutation P of the states, about the middle of the domain, that the problem
cannot tell from doing nothing: it keeps the domain, the target, the limits and the costs; under the
default control rates obey ``P f(x, u) = f(P x, u)``; and ``P f(x, u_i) = f(P x, u_j)`` for a
permutation i -> j of the candidates that keeps their efforts. Then what sSAC does with some
candidates at x, it does with their images at P x. Exogenous inputs stay, or are mirrored, too.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from capsyn.alphabets.candidates import dynamics_program
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.problem import Problem
from capsyn.modelling.tails.riccati import FIT
from capsyn.modelling.targets import target_axes, target_program
from capsyn.modelling.transcription import transcribe_target, user_program
from capsyn.programs.program import Program
from capsyn.random_streams import stream

PERMUTED = 6
"""Most states of which all permutations are tried; of more states only signs."""
SIGNED = 12
"""Most states whose signs are tried."""
MOST_MAPS = 1 << 17
"""Most maps that are tried; exogenous inputs keep their signs where there would be more."""
FEW, MANY = 2, 24
"""Random readings at which all maps are looked at, and those that are left."""
PLACES, SHRINK = 256, 1e-3
"""Random readings at which it is looked whether a target stays, and the smallest box of them."""
EQUAL, NOTHING = 1e-8, 1e-12
"""Differences that are none, as a share of the largest value, and of the largest of any axis."""
CHUNK, MOST_WORK = 1 << 20, 1 << 23
"""Numbers that are worked on at once, and most of all maps and candidates."""


@dataclass(frozen=True)
class Maps:
    """Signed permutations of readings about a middle, C of them.

    They are ``(P z)[k] = middle[k] + signs[k] (z - middle)[axes[k]]``.
    """

    axes: np.ndarray  # (C, n) ints
    signs: np.ndarray  # (C, n), 1 or -1
    middle: np.ndarray  # (n,)

    def __len__(self) -> int:
        return len(self.axes)

    def some(self, which: np.ndarray | slice) -> Maps:
        """Return some of the maps."""
        return Maps(self.axes[which], self.signs[which], self.middle)

    def simplest(self, count: int) -> Maps:
        """Return at most so many of the maps, at least one, those that change the fewest axes."""
        changed = (self.axes != np.arange(self.axes.shape[1])) + (self.signs < 0)
        order = np.argsort(changed.sum(axis=1), kind="stable")
        return self.some(order[: max(1, count)])

    def turned(self, rates: np.ndarray) -> np.ndarray:
        """Return the images (n, C, S) of rates (n, S)."""
        return np.asarray(rates[self.axes.T] * self.signs.T[:, :, None])

    def images(self, readings: np.ndarray) -> np.ndarray:
        """Return the images (n, C, S) of readings (n, S)."""
        middle = self.middle[:, None]
        return self.turned(readings - middle) + middle[:, None]

    def chunks(self, size: int) -> Iterator[Maps]:
        """Yield the maps, so many at a time that `size` numbers of each are `CHUNK` numbers."""
        count = max(1, CHUNK // size)
        for k in range(0, len(self), count):
            yield self.some(slice(k, k + count))


Rates = Callable[[np.ndarray], np.ndarray]
"""Readings (n, ...) to values (N, ...)."""


def orbits(problem: Problem, values: np.ndarray) -> list[tuple[int, ...]]:
    """Return the orbits of candidates under the symmetries of a problem, each ascending.

    A set of candidates that is a union of orbits treats mirrored states alike. Found are signed
    permutations of up to six states, and mere changes of sign of up to 12, by comparing at random
    readings; equal to rounding there is equal. Candidates of the same effect and effort may stand
    for each other: `without_dominated` goes first. Of more symmetries than can be looked at with
    many candidates the simplest are, of which the others usually are made.

    Parameters
    ----------
    problem : Problem
        The problem. What its switching costs is not looked at, nor are coordinates that turn.
    values : (K, m)
        The candidates [input units].

    Returns
    -------
    list of tuples of ints
        Each candidate is in one orbit, alone where there is no symmetry. They are in the order of
        their first candidates.
    """
    count, (_, images) = len(values), symmetries(problem, values)
    first = np.arange(count)
    while True:
        lower = np.minimum(first, first[images].min(axis=0, initial=count))
        np.minimum.at(lower, images, np.broadcast_to(lower, images.shape))
        if (lower == first).all():
            break
        first = lower
    return [tuple(np.flatnonzero(first == k).tolist()) for k in np.unique(first)]


def symmetries(problem: Problem, values: np.ndarray) -> tuple[Maps, np.ndarray]:
    """Return the symmetries, C of them, and to which candidates each takes those (K, m), (C, K)."""
    maps = _of_predictions(problem)
    return _permuting(problem, values, maps.simplest(MOST_WORK // (FEW * values.size)))


def _values(program: Program) -> Rates:
    """Return what a program of readings gives."""
    return lambda z: program.evaluate(z)[0]


def _of_predictions(problem: Problem) -> Maps:
    """Return the maps that keep what a problem says, and move rates under the default control."""
    dynamics, n, told = dynamics_program(problem), problem.space.n, problem.space.n
    told -= problem.domain.n
    ports, one = (("x", n),), (("value", 1),)
    kept: list[Rates] = []
    tail = None if isinstance(problem.tail, str) and problem.tail == FIT else problem.terminal
    for name, function in (("running_cost", problem.running_cost), ("terminal_cost", tail)):
        if function is not None:
            cost = user_program(name, function, ports, one, told=told)
            kept.append(_values(cost))
    if problem.limits is not None:
        sizes = (("limits", problem.system()["limits"].numel_out(0)),)
        limits = user_program("limits", problem.limits, ports, sizes, told=told)
        kept.append(lambda z: np.sort(limits.evaluate(z)[0], axis=0))  # in any order
    if problem.has_law:
        size = (("u", problem.alphabet.m),)
        law = user_program("default", problem.default, ports, size, told=told)
    constant = None if problem.has_law else problem.default_control

    def predicted(z: np.ndarray) -> np.ndarray:
        if constant is None:
            u = law.evaluate(z)[0]
        else:
            u = constant.reshape(-1, *(1,) * (z.ndim - 1))
        return dynamics.evaluate(z, u)[0] - problem.discrete * z

    maps = _maps(problem)
    for readings in (FEW, MANY):
        for values_of in kept:
            maps = maps.some(_keeps(problem, values_of, maps, readings))
        maps = maps.some(_keeps(problem, predicted, maps, readings, moves=True))
    return maps.some(_keeps_target(problem, maps))


def _maps(problem: Problem) -> Maps:
    """Return the signed permutations that keep the box of the space, the identity first."""
    n, space = problem.domain.n, problem.space
    width, around = space.widths, np.array(space.periodic)
    alike = (np.abs(width - width[:, None]) <= 1e-12 * width) & (around == around[:, None])
    orders = np.arange(space.n)[None]
    if n <= PERMUTED:
        every = np.array(list(itertools.permutations(range(n))))
        every = every[alike[np.arange(n), every].all(axis=1)]
        orders = np.hstack([every, np.broadcast_to(orders[:, n:], (len(every), space.n - n))])
    mirrored = n if n <= SIGNED else 0
    if len(orders) * 2.0**space.n <= MOST_MAPS and mirrored:
        mirrored = space.n
    signs = np.ones((2**mirrored, space.n))
    signs[:, :mirrored] = list(itertools.product((1.0, -1.0), repeat=mirrored))
    return Maps(
        np.repeat(orders, len(signs), axis=0),
        np.tile(signs, (len(orders), 1)),
        (space.lower + space.upper) / 2,
    )


def _readings(problem: Problem, count: int, values_of: Rates) -> np.ndarray:
    """Return random readings (n, S), at most so many, where all values are finite."""
    drawn = problem.space.sample(4 * count, stream(0, 23, 2)).T
    values = values_of(drawn)
    finite = np.isfinite(values).all(axis=0).reshape(drawn.shape[1], -1).all(axis=1)
    return np.asarray(drawn[:, finite][:, :count])


def _keeps(
    problem: Problem, values_of: Rates, maps: Maps, count: int, moves: bool = False
) -> np.ndarray:
    """Return which maps leave values at so many readings as they are, or move them likewise."""
    z = _readings(problem, count, values_of)
    if not z.size:
        return np.zeros(len(maps), dtype=bool)
    own, kept = values_of(z), [np.zeros(0, dtype=bool)]
    sizes = problem.space.widths if moves else np.ones(len(own))
    for some in maps.chunks(len(z) * count):
        found = values_of(some.images(z))  # (N, C, S)
        wanted = some.turned(own) if moves else own[:, None]
        kept.append(np.asarray(_equal(found, wanted, sizes).all(axis=(0, 2))))
    return np.concatenate(kept)


def _equal(found: np.ndarray, wanted: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return which values (N, C, S) are equal to rounding; the rows' units have such `sizes`."""
    with np.errstate(all="ignore"):
        largest = np.abs(found).max(axis=2, keepdims=True)
        overall = (largest / sizes[:, None, None]).max(axis=0) * sizes[:, None, None]
        return np.asarray(np.abs(found - wanted) <= EQUAL * largest + NOTHING * overall)


def _keeps_target(problem: Problem, maps: Maps) -> np.ndarray:
    """Return which maps keep the target; of a function, as random readings around the middle tell.

    They are drawn from boxes of all sizes down to `SHRINK` of the space.
    """
    target, space = transcribe_target(problem), problem.space
    if target is None:
        return np.ones(len(maps), dtype=bool)
    if isinstance(target, (Ball, Box)):
        axes = target_axes(target, space)
        middle, reach = maps.middle.copy(), np.zeros(space.n)
        if isinstance(target, Ball):
            middle[axes], reach[axes] = target.center, target.radius
        else:
            middle[axes], reach[axes] = (target.lower + target.upper) / 2, target.widths
        off = maps.images(middle[:, None])[:, :, 0].T - middle
        off -= space.periods * np.rint(off / np.where(space.periods > 0, space.periods, 1.0))
        moved = reach[maps.axes]
        same = np.abs(off) <= EQUAL * space.widths
        same &= np.abs(moved - reach) <= EQUAL * np.minimum(moved, reach)
        return np.asarray(same.all(axis=1))
    rng = stream(0, 23, 3)
    sizes = SHRINK ** rng.random(PLACES)
    z = maps.middle[:, None] + space.widths[:, None] / 2 * sizes * rng.uniform(
        -1, 1, (space.n, PLACES)
    )
    inside, kept = target_program(target, space), [np.zeros(0, dtype=bool)]
    own = inside.evaluate(z)[0]
    for some in maps.chunks(z.size):
        moved = inside.evaluate(some.images(z))[0]
        kept.append((moved == own[:, None]).all(axis=(0, 2)))
    return np.concatenate(kept)


def _permuting(problem: Problem, values: np.ndarray, maps: Maps) -> tuple[Maps, np.ndarray]:
    """Return the maps that permute the candidates (K, m), and where they take them, (C, K)."""
    program, efforts = dynamics_program(problem), problem.settings.efforts(values)
    places = np.empty((len(maps), len(values)), dtype=np.int64)

    def rates(z: np.ndarray) -> np.ndarray:
        u = values.T.reshape(problem.alphabet.m, *(1,) * (z.ndim - 1), len(values))
        return program.evaluate(z[..., None], u)[0] - problem.discrete * z[..., None]

    for count in (FEW, MANY):
        z = _readings(problem, count, rates)
        if not z.size:
            return maps.some(slice(0, 0)), places[:0]
        weights = stream(0, 23, 4, count).uniform(0.5, 1.5, z.shape[1])
        own = np.einsum("nsk,s->nk", rates(z), weights)
        which, found = [np.zeros(0, dtype=bool)], [places[:0]]
        for some in maps.chunks(z.size * len(values)):
            there = np.einsum("ncsk,s->nck", rates(some.images(z)), weights)
            same, images = _matched(some.turned(own), there, efforts, problem.space.widths)
            which.append(same)
            found.append(images)
        kept = np.concatenate(which)
        maps, places = maps.some(kept), np.concatenate(found)[kept]
    return maps, places


def _matched(
    moved: np.ndarray, there: np.ndarray, efforts: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return for which maps (C,) candidates (n, C, K) are those there, and which (C, K).

    Both are sorted along one random direction, the efforts (K,) among its axes, and then compared.
    """
    *axes, along_effort = stream(0, 23, 5).uniform(0.5, 1.5, len(moved) + 1)
    largest = np.abs(there).max(axis=2, keepdims=True)
    unit, most = largest + (largest == 0), efforts.max() or 1.0
    with np.errstate(invalid="ignore"):
        orders = [
            np.argsort(
                np.einsum("nck,n->ck", rates / unit, axes) + along_effort * efforts / most,
                axis=1,
                kind="stable",
            )
            for rates in (moved, there)
        ]
        before, after = orders
        first, second = (
            np.take_along_axis(rates, order[None], axis=2)
            for rates, order in zip((moved, there), orders)
        )
    same = _equal(second, first, sizes).all(axis=(0, 2))
    same &= (np.abs(efforts[before] - efforts[after]) <= EQUAL * most).all(axis=1)
    images = np.empty_like(before)
    np.put_along_axis(images, before, after, axis=1)
    return same, images
