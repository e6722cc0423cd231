"""Candidates for an alphabet, and problems with the alphabets that are chosen among them."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from capsyn.alphabets.names import own_symbols, value_names, with_own_names
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import MAX_SYMBOLS, Alphabet
from capsyn.modelling.domain import Box
from capsyn.modelling.problem import Problem
from capsyn.modelling.switching import DEFAULT, Switching
from capsyn.modelling.tails.riccati import FIT
from capsyn.modelling.transcription import user_program
from capsyn.programs.program import Program, is_affine
from capsyn.random_streams import stream
from capsyn.validation import describe, finite_array, numbers, whole_number, whole_numbers

STEPS = (11, 5, 3)
"""Levels of each input of a box, for one input, for two, and for more."""
DIGITS = 12
"""Significant digits of the levels of a grid, so that 0.1 + 0.2 is 0.3."""
READINGS = 64
"""Random readings at which candidates of the same effect are looked for."""
SAME = 1e-9
"""Differences of rates that are none, as a share of the largest that any candidate makes."""


def candidates_of(problem: Problem, given: Any, steps: Any = None) -> Alphabet:
    """Return the candidates for the alphabet of a problem, each value once, the first of equals.

    Parameters
    ----------
    problem : Problem
        The problem, whose inputs they have. A candidate without a name of its own that is one of
        its symbols has its name.
    given : Alphabet, (K, m) or (K,) numbers, or Box
        The candidates [input units]. A box of inputs becomes a grid with its bounds on it; on an
        input whose bounds are equal there is one level, and the upper bound of a periodic one is
        its lower one. Where the grid is too large and the model is affine in its inputs, it
        becomes the vertices of the box, and a cross: the levels of one input, the others at the
        default control, or in the middle of the box if the default is a law or outside.
    steps : int or m ints, optional
        Levels of each input of a box, at least 2. Default: 11, 5 or 3 for one, two or more inputs.

    Raises
    ------
    ProblemError
        Candidates of another number of inputs, or with other names of inputs; more than 4,096 of
        them; numbers that are not finite; or `steps` without a box.
    """
    own = problem.alphabet
    if not isinstance(given, Box) and steps is not None:
        raise ProblemError(f"`steps` must be left out where `candidates` is no box; got {steps!r}")
    names: Sequence[str] | None = None
    if isinstance(given, Box):
        values = _grid(problem, given, steps)
    elif isinstance(given, Alphabet):
        _check_inputs(own, given.inputs, tuple(f"u{i + 1}" for i in range(given.m)))
        values, names = given.values, given.names
    else:
        values = numbers("candidates", given)
        values = finite_array("candidates", values[:, None] if values.ndim == 1 else values, 2)
    if not len(values) or values.shape[1] != own.m:
        raise ProblemError(
            f"`candidates` must have shape (K, {own.m}), one column for each input of the problem; "
            f"got {values.shape if len(values) else 'none'}"
        )
    _, first = np.unique(values, axis=0, return_index=True)
    kept = np.sort(first)
    if len(kept) > MAX_SYMBOLS:
        raise ProblemError(f"`candidates` must be at most {MAX_SYMBOLS}; got {len(kept)}")
    chosen = values[kept]
    if names is not None:
        return Alphabet(chosen, [names[k] for k in kept], own.inputs, own.units)
    names = with_own_names(own, chosen, value_names(chosen))
    return Alphabet(chosen, names, own.inputs, own.units)


def actuator_combinations(problem: Problem, most: int) -> Alphabet:
    """Return all combinations of at most `most` actuators that are off their rest.

    Parameters
    ----------
    problem : Problem
        The problem, whose alphabet says which values each input has. It rests at its default
        control if that is one of them, else at the one that is nearest to 0.
    most : int
        Most inputs off their rest at once, 1 or more.

    Returns
    -------
    Alphabet
        The combinations, those of fewer inputs first. The first is named "off", the others after
        their inputs, as in "t1+t4". An input with several other values is named with its value, as
        in "fan=2".

    Raises
    ------
    ProblemError
        No problem, a `most` that is no whole number from 1 to the number of inputs, an alphabet in
        which no input leaves its rest, or more than 4,096 combinations.
    """
    if not isinstance(problem, Problem):
        raise ProblemError(f"`problem` must be a capsyn.Problem; got {describe(problem)}")
    own = problem.alphabet
    most = whole_number("most", most, least=1, most=own.m)
    rest = problem.default_control.copy()
    for i, column in enumerate(own.values.T):
        if problem.has_law or rest[i] not in column:
            rest[i] = column[np.argmin(np.abs(column))]
    levels = [[v for v in np.unique(column) if v != r] for column, r in zip(own.values.T, rest)]
    moved = [i for i, other in enumerate(levels) if other]
    if not moved:
        raise ProblemError("`problem` must have an alphabet in which inputs leave the default")
    counts = [1] + [0] * most  # of combinations, by inputs that are off their rest
    for i in moved:
        for k in range(most, 0, -1):
            counts[k] += counts[k - 1] * len(levels[i])
    if sum(counts) > MAX_SYMBOLS:
        fit = sum(total <= MAX_SYMBOLS for total in itertools.accumulate(counts)) - 1
        raise ProblemError(
            f"`most` must make at most {MAX_SYMBOLS} combinations"
            + (f", which {fit} does" if fit else "")
            + f"; got {most}, which makes {sum(counts)}"
        )
    texts = [[own.inputs[i]] for i in range(own.m)]
    for i in moved:
        if len(levels[i]) > 1:
            named = value_names(np.array(levels[i])[:, None])
            texts[i] = [f"{own.inputs[i]}={name}" for name in named]
    values, names = [], []
    for count in range(most + 1):
        for inputs in itertools.combinations(moved, count):
            for picks in itertools.product(*(range(len(levels[i])) for i in inputs)):
                value = rest.copy()
                value[list(inputs)] = [levels[i][k] for i, k in zip(inputs, picks)]
                values.append(value)
                names.append("+".join(texts[i][k] for i, k in zip(inputs, picks)) or "off")
    return Alphabet(values, names, own.inputs, own.units)


def without_dominated(
    problem: Problem,
    alphabet: Alphabet,
    prices: Mapping[str, float] | None = None,
    keep: Sequence[int] = (),
) -> tuple[np.ndarray, dict[int, int]]:
    """Return which candidates no other makes needless, and for each other one the one that does.

    Candidates have the same effect where their rates, ``f(x, u_i)``, are equal at random readings
    of the space to rounding. Of these one makes another needless if neither its effort ``u^T R u``
    nor its price is higher; of equals in both the one of least ``u^T u`` stays, then the first.
    What switching costs is not looked at.

    Parameters
    ----------
    problem : Problem
        The problem, which has the dynamics f and the weight R.
    alphabet : Alphabet
        The K candidates.
    prices : mapping, optional
        Prices of candidates by name; 0 for others.
    keep : ints
        Candidates that stay, whatever else.

    Returns
    -------
    kept : (K',) ints
        The candidates that stay, ascending.
    instead : dict
        For each that goes, the one of the same effect that stays in its place.
    """
    values, count = alphabet.values, len(alphabet)
    groups = _same_effect(_effects(problem, values))
    price = np.array([(prices or {}).get(name, 0.0) for name in alphabet.names])
    effort, size = (
        np.array([float(f"{v:.{DIGITS}g}") for v in sums])  # sums in another order are the same
        for sums in (problem.settings.efforts(values), np.einsum("si,si->s", values, values))
    )
    never = np.zeros(count, dtype=bool)
    never[list(keep)] = True
    instead: dict[int, int] = {}
    for group in groups:
        least = np.inf
        last = group[0]
        for k in sorted(group, key=lambda k: (effort[k], price[k], not never[k], size[k], k)):
            if price[k] < least:
                least, last = price[k], k
            elif not never[k]:
                instead[k] = last
    kept = np.array([k for k in range(count) if k not in instead], dtype=np.int64)
    return kept, dict(sorted(instead.items()))


def dynamics_program(problem: Problem) -> Program:
    """Return the dynamics ``(x, u) -> xdot`` of a problem, x the reading; see `Model`."""
    size, told = problem.space.n, problem.space.n - problem.domain.n
    ports = (("x", size), ("u", problem.alphabet.m)), (("xdot", size),)
    return user_program(
        "dynamics", problem.dynamics, *ports, told=told, rates=True, discrete=problem.discrete
    )


def with_alphabet(problem: Problem, alphabet: Alphabet) -> Problem:
    """Return the problem with another alphabet, and with what its rules say of symbols.

    Symbols are those of the problem's own alphabet by their values. Prices, holds, forbidden
    transitions and the symbol outside the domain follow them; holds and forbidden transitions of
    symbols that are gone go, too. A Riccati tail stays what it is under the own alphabet, so that
    alphabets are compared at the same costs.

    Raises
    ------
    ProblemError
        The alphabet has other inputs. A matrix of prices, or holds for each symbol, say nothing of
        a symbol that is new. The symbol outside the domain is gone. Or what is left of the
        transitions leaves a symbol no exit.
    """
    own = problem.alphabet
    if alphabet.inputs != own.inputs:
        raise ProblemError(
            f"`alphabet` must have the inputs of the problem ({', '.join(own.inputs)}); "
            f"got {', '.join(alphabet.inputs)}"
        )
    of = own_symbols(own, alphabet.values, alphabet.names)
    changes: dict[str, Any] = {"alphabet": alphabet}
    if isinstance(problem.outside, int) and problem.outside >= 0:
        here = np.flatnonzero((alphabet.values == own.values[problem.outside]).all(axis=1))
        if not len(here):
            name = own.names[problem.outside]
            raise ProblemError(
                f"`alphabet` must have the symbol that the problem gives outside its domain, "
                f"'{name}'; got {len(alphabet)} others"
            )
        changes["outside"] = int(here[0])
    if problem.switching is not None:
        changes["switching"] = _switching(problem.switching, own, alphabet, of)
    if isinstance(problem.tail, str) and problem.tail != FIT:
        changes["tail"] = problem.terminal
    return problem.replace(**changes)


def _switching(rules: Switching, own: Alphabet, alphabet: Alphabet, of: np.ndarray) -> Switching:
    """Return a switching for symbols of another alphabet, each `of` an own one or of none."""
    price, hold = rules.price, rules.hold
    for name, value in (("price", price), ("hold", hold)):
        if isinstance(value, tuple) and (of < 0).any():
            symbol = alphabet.names[int(np.flatnonzero(of < 0)[0])]
            raise ProblemError(
                f"`{name}` of the switching must be given by inputs, or as one number, where "
                f"symbols are new; it says nothing of '{symbol}'"
            )
    if isinstance(price, tuple):
        price = np.array(price)[np.ix_(of, of)]
        np.fill_diagonal(price, 0.0)
    if isinstance(hold, tuple):
        hold = [hold[k] for k in of]
    names: dict[str, list[str]] = {DEFAULT: [DEFAULT]}
    for name in own.names:
        names[name] = [alphabet.names[k] for k in np.flatnonzero(of == own.names.index(name))]
    if isinstance(hold, dict):
        pairs = ((new, time) for name, time in hold.items() for new in names.get(name, [name]))
        hold = dict(pairs)
    forbidden = [
        (before, after) for a, b in rules.forbidden for before in names[a] for after in names[b]
    ]
    return dataclasses.replace(rules, price=price, hold=hold, forbidden=forbidden)


def _check_inputs(own: Alphabet, given: tuple[str, ...], unnamed: tuple[str, ...]) -> None:
    """Raise unless the names of inputs are a problem's own, or as many that say nothing."""
    if len(given) != own.m or given not in (own.inputs, unnamed):
        raise ProblemError(
            f"`candidates` must be of the inputs of the problem ({', '.join(own.inputs)}); "
            f"got {', '.join(given)}"
        )


def _grid(problem: Problem, box: Box, steps: Any) -> np.ndarray:
    """Return the candidates (K, m) of a box of inputs; see `candidates_of`."""
    own = problem.alphabet
    _check_inputs(own, box.names, Box.unnamed(box.n))
    steps = STEPS[min(own.m, len(STEPS)) - 1] if steps is None else steps
    levels = []
    for i, count in enumerate(whole_numbers("steps", steps, own.m, least=2)):
        low, high, periodic = box.lower[i], box.upper[i], box.periodic[i]
        if count > MAX_SYMBOLS:
            raise ProblemError(f"`steps` must be at most {MAX_SYMBOLS}; got {count}")
        points = box.faces(i, np.arange(count), count if periodic else count - 1)
        small = 10.0**-DIGITS * max(abs(low), abs(high))
        rounded = [0.0 if abs(v) < small else float(f"{v:.{DIGITS}g}") for v in points.tolist()]
        rounded[0] = float(low)
        if not periodic:
            rounded[-1] = float(high)
        levels.append(list(dict.fromkeys(rounded)))  # one of an input that is fixed
    total = math.prod(map(len, levels))
    if total <= MAX_SYMBOLS:
        return np.array(list(itertools.product(*levels)))
    ends = 2 ** sum(len(each) > 1 for each in levels)
    least = f"; got {' x '.join(str(len(each)) for each in levels)} = {total}: lower `steps`"
    cross = sum(len(each) for each in levels)
    if ends + cross > MAX_SYMBOLS or not is_affine(dynamics_program(problem), "u"):
        raise ProblemError(f"`candidates` must be a grid of at most {MAX_SYMBOLS} symbols{least}")
    middle = np.array([float(f"{v:.{DIGITS}g}") for v in (box.lower + box.upper) / 2])
    rest = middle
    if not problem.has_law and box.contains(problem.default_control[None])[0]:
        rest = problem.default_control
    rows = list(itertools.product(*((each[0], each[-1]) for each in levels)))
    across = np.repeat(rest[None], cross + 1, axis=0)
    across[np.arange(1, cross + 1), np.repeat(np.arange(own.m), list(map(len, levels)))] = (
        np.concatenate(levels)
    )
    return np.vstack([rows, across])


def _effects(problem: Problem, values: np.ndarray) -> np.ndarray:
    """Return the rates (K, R) of candidates (K, m) at random readings, less those of the first.

    Their unit is what rounding may leave of a difference that is none: differences of less than 1
    are none.
    """
    readings = problem.space.sample(READINGS, stream(0, 23))
    (rates,) = dynamics_program(problem).evaluate(readings.T[:, None], values.T[:, :, None])
    rates = np.moveaxis(rates, 1, 0).reshape(len(values), -1)
    with np.errstate(all="ignore"):
        known = np.isfinite(rates)
        sizes = np.abs(np.where(known, rates, 0.0)).max(axis=0)
        change = rates - np.where(known[0], rates[0], 0.0)
        largest = np.abs(np.where(known, change, 0.0)).max(axis=0)
        unit = SAME * largest + 64 * np.finfo(float).eps * sizes
        return np.asarray(change / np.where(unit > 0, unit, 1.0))


def _same_effect(effects: np.ndarray) -> list[list[int]]:
    """Return groups of rows (K, R) that differ by less than 1 everywhere, and are not finite alike.

    Rows are compared along random directions: neighbours there are one group where no gap is wider
    than rounding leaves. Groups are in the order of their first rows.
    """
    known = np.isfinite(effects)
    keys = [np.unique(known, axis=0, return_inverse=True)[1].ravel()]
    rng = stream(0, 23, 1)
    plain = np.where(known, effects, 0.0)
    gap = 8 * math.sqrt(effects.shape[1])
    for _ in range(3):
        along = plain @ rng.standard_normal(effects.shape[1])
        order = np.argsort(along, kind="stable")
        steps = np.diff(along[order], prepend=along[order[0]]) > gap
        key = np.empty(len(effects), dtype=np.int64)
        key[order] = np.cumsum(steps)
        keys.append(key)
    groups: dict[tuple[int, ...], list[int]] = {}
    for k, row in enumerate(zip(*(key.tolist() for key in keys))):
        groups.setdefault(row, []).append(k)
    return list(groups.values())
