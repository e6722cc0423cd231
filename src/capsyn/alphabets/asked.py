"""What is asked of a choice of an alphabet, checked: candidates, what is kept, prices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.alphabets.candidates import candidates_of, without_dominated
from capsyn.alphabets.names import own_symbols, value_names
from capsyn.alphabets.spread import Pool
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import MAX_SYMBOLS, Alphabet
from capsyn.modelling.domain import Box
from capsyn.modelling.problem import Problem
from capsyn.validation import describe, finite_number


@dataclass(frozen=True, eq=False)
class Asked:
    """A problem and its candidates, without those that others make needless."""

    problem: Problem
    pool: Pool  # the candidates that are left, and which are kept
    box: Box | None  # of continuous inputs, in which symbols may move, if none is excluded
    own: tuple[Alphabet, ...]  # of the user, and the problem's own where its symbols are candidates

    @staticmethod
    def of(
        problem: Problem,
        given: Any,
        steps: Any,
        keep: Sequence[Any],
        exclude: Sequence[Any],
        prices: Mapping[str, float] | None,
        own: Sequence[Any],
        weights: Mapping[str, float],
    ) -> Asked:
        """Return what is asked, from arguments of `choose_alphabet`.

        Raises
        ------
        ProblemError
            Arguments that cannot be used: unknown symbols, symbols both kept and excluded, or no
            candidate that is left.
        """
        for name, several in (("keep", keep), ("exclude", exclude), ("own", own)):
            if isinstance(several, (str, bytes)) or not np.iterable(several):
                raise ProblemError(f"`{name}` must be a list; got {describe(several)}")
        named = candidates_of(problem, given, steps)
        sets = [_alphabet(problem, named, one) for one in own]
        whole = _joined(named, [*sets, *_outside(problem)])
        kept = [_place(whole, "keep", one) for one in keep]
        kept += [k for one in _outside(problem) for k in _places(whole, one)]
        gone = {_place(whole, "exclude", one) for one in exclude}
        if both := gone & set(kept):
            raise ProblemError(f"`exclude` must leave what is kept; got {whole.names[min(both)]}")
        charged = _prices(whole, prices)
        needed = {k for one in sets for k in _places(whole, one)} - gone
        left = [k for k in range(len(whole)) if k not in gone]
        if not left:
            raise ProblemError("`exclude` must leave a candidate; got none")
        if not _by_symbols(problem):
            left = _needed(problem, whole, left, {*kept, *needed}, charged, weights)
        pool = Pool(whole).subset(left)
        keep_ = tuple(sorted({left.index(k) for k in kept}))
        box = given if isinstance(given, Box) and not gone and not _fixed(problem) else None
        first = problem.alphabet
        if (own_symbols(pool, first.values, first.names) >= 0).all():
            sets = [first, *(one for one in sets if not _same(one, first))]
        return Asked(problem, Pool(pool, keep_, box is not None, charged[left]), box, tuple(sets))

    @property
    def own_members(self) -> list[tuple[int, ...]]:
        """The own alphabets as places in the pool, without symbols that are excluded."""
        found = []
        for one in self.own:
            places = own_symbols(self.pool.candidates, one.values, one.names)
            found.append(tuple(sorted({int(k) for k in places if k >= 0})))
        return [some for some in found if some]

    def named(self, values: np.ndarray) -> Alphabet:
        """Return an alphabet of values (N, m), with the names that candidates have."""
        pool = self.pool.candidates
        order = np.lexsort(values.T[::-1])
        places = own_symbols(pool, values, [""] * len(values))
        if (places >= 0).all():
            return self.pool.subset(places)
        values, places = values[order], places[order]
        texts = value_names(values)
        names = [pool.names[k] if k >= 0 else text for k, text in zip(places, texts)]
        distinct = len(set(names)) == len(names)
        return Alphabet(values, names if distinct else texts, pool.inputs, pool.units)


def _alphabet(problem: Problem, named: Alphabet, given: Any) -> Alphabet:
    """Return an alphabet of the user: given as such, as names, or as values."""
    if isinstance(given, Alphabet):
        return candidates_of(problem, given)
    if isinstance(given, (str, bytes)) or not np.iterable(given):
        raise ProblemError(f"`own` must be lists of names or values; got {describe(given)}")
    several = list(given)
    if several and all(isinstance(one, str) for one in several):
        known = [*named.names]
        for one in several:
            if one not in known:
                raise ProblemError(f"`own` must name candidates; got {describe(one)}")
        places = [known.index(one) for one in dict.fromkeys(several)]
        return Alphabet(named.values[places], [known[k] for k in places], named.inputs, named.units)
    return candidates_of(problem, several)


def _by_symbols(problem: Problem) -> bool:
    """Return whether switches have prices by symbols or inputs, so that effects are not all."""
    rules = problem.switching
    return rules is not None and isinstance(rules.price, (tuple, dict))


def _needed(
    problem: Problem,
    whole: Alphabet,
    left: list[int],
    stay: set[int],
    prices: np.ndarray,
    weights: Mapping[str, float],
) -> list[int]:
    """Return which candidates that are left no other makes needless, ascending.

    One of the same effect does that which has no higher price, effort ``u^T R u``, nor more of what
    the objective weighs. Those that are to `stay` do.
    """
    some = Pool(whole).subset(left)
    known = dict(zip(some.names, prices[left].tolist()))
    _, instead = without_dominated(problem, some, known, [left.index(k) for k in stay])
    sums = [np.abs(some.values).sum(axis=1)] if weights.get("fuel") else []
    sums += [(some.values**2).sum(axis=1)] if weights.get("effort") else []
    needless = {k for k, j in instead.items() if all(each[j] <= each[k] for each in sums)}
    return [k for i, k in enumerate(left) if i not in needless]


def _fixed(problem: Problem) -> bool:
    """Return whether a problem says something of each symbol, and nothing of new ones."""
    rules = problem.switching
    return rules is not None and any(isinstance(x, tuple) for x in (rules.price, rules.hold))


def _same(one: Alphabet, other: Alphabet) -> bool:
    """Return whether two alphabets have the same values."""
    return {*map(tuple, one.values.tolist())} == {*map(tuple, other.values.tolist())}


def _outside(problem: Problem) -> list[Alphabet]:
    """Return the symbol of states outside the domain as an alphabet, if it is one."""
    own, k = problem.alphabet, problem.outside
    if not isinstance(k, int) or k < 0:
        return []
    return [Alphabet(own.values[[k]], [own.names[k]], own.inputs, own.units)]


def _joined(named: Alphabet, more: Sequence[Alphabet]) -> Alphabet:
    """Return candidates with the symbols of other alphabets, each value once."""
    values, names = [named.values], list(named.names)
    for one in more:
        for value, name in zip(one.values, one.names):
            if not (np.vstack(values) == value).all(axis=1).any():
                values.append(value[None])
                again = 2
                new = name
                while new in names:
                    new, again = f"{name} ({again})", again + 1
                names.append(new)
    if len(names) > MAX_SYMBOLS:
        raise ProblemError(f"`candidates` must be at most {MAX_SYMBOLS}; got {len(names)}")
    return Alphabet(np.vstack(values), names, named.inputs, named.units)


def _places(whole: Alphabet, one: Alphabet) -> list[int]:
    return [int(np.flatnonzero((whole.values == value).all(axis=1))[0]) for value in one.values]


def _place(whole: Alphabet, name: str, given: Any) -> int:
    """Return the place of a candidate that is given by its name or its value."""
    if isinstance(given, str):
        if given in whole.names:
            return whole.names.index(given)
    else:
        value = whole.control(name, given)
        same = np.flatnonzero((whole.values == value).all(axis=1))
        if len(same):
            return int(same[0])
    raise ProblemError(f"`{name}` must be candidates, by name or value; got {describe(given)}")


def _prices(whole: Alphabet, prices: Mapping[str, float] | None) -> np.ndarray:
    """Return the prices (K,) of candidates."""
    found = np.zeros(len(whole))
    if prices is not None and not isinstance(prices, Mapping):
        raise ProblemError(f"`prices` must be numbers by name; got {describe(prices)}")
    for name, price in (prices or {}).items():
        if name not in whole.names:
            raise ProblemError(f"`prices` must name candidates; got {describe(name)}")
        found[whole.names.index(name)] = finite_number(f"prices {name}", price, least=0.0)
    return found
