"""Candidates for an alphabet, and problems with the alphabets that are chosen among them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.problem import Problem
from capsyn.modelling.switching import DEFAULT, Switching
from capsyn.modelling.tails.riccati import FIT


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
    of = own_symbols(own, alphabet)
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


def own_symbols(own: Alphabet, alphabet: Alphabet) -> np.ndarray:
    """Return which of a problem's own symbols each symbol is by its value (K,), -1 for none.

    Of several with that value it is the one of the same name, else the first.
    """
    places: dict[tuple[float, ...], int] = {}
    for k, value in reversed(list(enumerate(map(tuple, own.values.tolist())))):
        places[value] = k
    found = [places.get(value, -1) for value in map(tuple, alphabet.values.tolist())]
    for k, name in enumerate(alphabet.names):
        if name in own.names:
            same = own.names.index(name)
            if (own.values[same] == alphabet.values[k]).all():
                found[k] = same
    return np.array(found, dtype=np.int64)


def _switching(rules: Switching, own: Alphabet, alphabet: Alphabet, of: np.ndarray) -> Switching:
    """Return a switching for symbols of another alphabet, each `of` an own one or of none."""
    price, hold = rules.price, rules.hold
    for name, value in (("price", price), ("hold", hold)):
        if isinstance(value, tuple) and (of < 0).any():
            symbol = alphabet.names[int(np.flatnonzero(of < 0)[0])]
            raise ProblemError(
                f"`{name}` must be given by inputs, or as one number, where symbols are new; it "
                f"says nothing of '{symbol}'"
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
