"""What a change of symbol costs, how long a symbol is held, and which changes are forbidden.

A policy with a `Switching` is the paper's transition function ``T : U x L -> U`` (Definition 2):
its next symbol also depends on the symbol in force. Arrays over symbols have N + 1 entries. The
last entry belongs to the default control, which is in force before the first decision.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet, Outside
from capsyn.validation import describe, finite_number, is_list, keep, numbers

DEFAULT = "default"
"""What the default control is called among symbols."""


@dataclass(frozen=True, eq=False)
class Switching:
    """Prices on switching, least times, and forbidden transitions.

    Parameters
    ----------
    price : number, share, (N, N) matrix or mapping
        What a change of symbol costs [cost / time unit]. The price is added to the score of the
        next symbol. One number holds for all changes. Text such as ``"1%"`` is a share of the
        median, over random states of the domain, of the worst score less the best. A matrix has a
        price for each symbol in force (rows) and next symbol. A mapping has, by names of inputs,
        numbers or shares for each unit of change of the input. Leaving the default control costs
        nothing.
    hold : number, N numbers or mapping
        Least times [time unit]: one for all symbols, one for each symbol, or a mapping. A mapping
        has times by names of symbols, ``"default"`` for the default control, and names of inputs. A
        symbol is held for its time once it is entered. An input is held for its time once it has
        changed, and other inputs may change meanwhile. The policy then depends on the symbol in
        force, which stays if it ties with the best. A single ``min_dwell`` for all symbols does not
        have this effect.
    forbidden : pairs of names
        Transitions that must not be taken, as pairs (from, to) of names of symbols. The name
        ``"default"`` stands for the start.

    Raises
    ------
    ProblemError
        A price or a time that is negative or not finite, or a transition that is no pair.

    Notes
    -----
    `Problem` checks the names, because it knows the alphabet.
    """

    price: Any = 0.0
    hold: Any = 0.0
    forbidden: Any = ()

    def __post_init__(self) -> None:
        keep(self, price=_checked_price(self.price))
        keep(self, hold=_checked_hold(self.hold))
        keep(self, forbidden=_checked_pairs(self.forbidden))

    @property
    def has_share(self) -> bool:
        """Whether the price is a share, which `with_spread` turns into a number."""
        prices = self.price.values() if isinstance(self.price, dict) else (self.price,)
        return any(isinstance(price, str) for price in prices)

    def with_spread(self, spread: float) -> Switching:
        """Return the switching with shares as numbers; `spread` is 100 % [cost / time unit].

        The numbers are rounded to nine digits, so that all backends agree on them.
        """

        def number(price: Any) -> Any:
            if not isinstance(price, str):
                return price
            return float(f"{float(price[:-1]) / 100 * spread:.9g}")

        if isinstance(self.price, dict):
            return dataclasses.replace(self, price={k: number(p) for k, p in self.price.items()})
        return dataclasses.replace(self, price=number(self.price))

    def check(self, alphabet: Alphabet, outside: Outside = "error") -> None:
        """Raise `ProblemError` unless the switching fits an `alphabet` and the rule `outside`."""
        count = len(alphabet)
        if isinstance(self.price, tuple) and len(self.price) != count:
            size = len(self.price)
            raise ProblemError(
                f"`price` must be a matrix of shape ({count}, {count}); got ({size}, {size})"
            )
        if isinstance(self.price, dict):
            for name in self.price:
                _known("price", name, alphabet.inputs, "inputs")
        if isinstance(self.hold, tuple) and len(self.hold) != count:
            raise ProblemError(
                f"`hold` must be one time, or {count} of them, one for each symbol; "
                f"got {len(self.hold)}"
            )
        if isinstance(self.hold, dict):
            for name in self.hold:
                known = (*alphabet.names, *alphabet.inputs, DEFAULT)
                _known("hold", name, known, "symbols and inputs")
                if name in alphabet.names and name in alphabet.inputs:
                    raise ProblemError(
                        f"`hold` must name a symbol or an input; '{name}' is the name of both: "
                        "give the symbol another"
                    )
        for pair in self.forbidden:
            for name in pair:
                _known("forbidden", name, (*alphabet.names, DEFAULT), "symbols")
        self._check_ways(alphabet, outside)

    def _check_ways(self, alphabet: Alphabet, outside: Outside) -> None:
        """Raise unless each symbol has an exit, the start a symbol, and the safe symbol entries."""
        forbidden, names = self.forbids(alphabet), [*alphabet.names, DEFAULT]
        count = len(alphabet)
        others = ~np.eye(count + 1, dtype=bool)[:, :count]
        stuck = ~(others & ~forbidden[:, :count]).any(axis=1)
        if stuck[count]:
            raise ProblemError(
                "`forbidden` must leave the start a symbol; got none that may be first"
            )
        if count > 1 and stuck.any():
            name = names[int(np.flatnonzero(stuck)[0])]
            raise ProblemError(f"`forbidden` must leave each symbol an exit; '{name}' has none")
        if not isinstance(outside, str) and forbidden[:, outside].any():
            name = names[int(np.flatnonzero(forbidden[:, outside])[0])]
            raise ProblemError(
                "`forbidden` must allow every transition to the symbol outside the domain; "
                f"got '{name}' to '{names[outside]}'"
            )

    def forbids(self, alphabet: Alphabet) -> np.ndarray:
        """Return the forbidden transitions (N + 1, N + 1) of an `alphabet`, from row to column."""
        places = {name: k for k, name in enumerate((*alphabet.names, DEFAULT))}
        table = np.zeros((len(places), len(places)), dtype=bool)
        for before, after in self.forbidden:
            table[places[before], places[after]] = True
        return table

    def prices(self, alphabet: Alphabet, default: np.ndarray) -> np.ndarray:
        """Return the prices (N + 1, N + 1) [cost / time unit] of transitions in an `alphabet`.

        Forbidden transitions have infinite prices. `default` (m,) is the default control. A change
        to it costs as much as a change to the first symbol of the same control. The price of the
        switching must not be a share.
        """
        assert not self.has_share
        count = len(alphabet)
        table = np.zeros((count + 1, count + 1))
        if isinstance(self.price, dict):
            controls = np.vstack([alphabet.values, default])
            for name, price in self.price.items():
                along = controls[:, alphabet.inputs.index(name)]
                table += price * np.abs(along[:, None] - along)
        elif isinstance(self.price, tuple):
            table[:count, :count] = self.price
        else:
            table[:] = self.price
        table[count] = 0.0
        np.fill_diagonal(table, 0.0)
        table[self.forbids(alphabet)] = np.inf
        same = np.flatnonzero((alphabet.values == default).all(axis=1))
        if len(same):  # going there is going to that symbol
            table[:count, count] = table[:count, same[0]]
        return table

    def holds(self, alphabet: Alphabet, default: np.ndarray) -> np.ndarray:
        """Return how long symbols of an `alphabet` are held once entered, (N + 1,) [time unit].

        If the `default` control has no time of its own, it is held as long as the first symbol of
        the same control.
        """
        count = len(alphabet)
        times = np.zeros(count + 1)
        if isinstance(self.hold, dict):
            for k, name in enumerate(alphabet.names):
                times[k] = self.hold.get(name, 0.0)
        elif isinstance(self.hold, tuple):
            times[:count] = self.hold
        else:
            times[:] = self.hold
            return times
        same = np.flatnonzero((alphabet.values == default).all(axis=1))
        own = times[same[0]] if len(same) else 0.0
        times[count] = self.hold.get(DEFAULT, own) if isinstance(self.hold, dict) else own
        return times

    def input_holds(self, alphabet: Alphabet) -> np.ndarray:
        """Return how long inputs of an `alphabet` are held once changed, (m,) [time unit]."""
        if not isinstance(self.hold, dict):
            return np.zeros(alphabet.m)
        return np.array([self.hold.get(name, 0.0) for name in alphabet.inputs])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Switching) and self.to_json() == other.to_json()

    def __hash__(self) -> int:
        return hash((str(self.price), str(self.hold), self.forbidden))

    def to_json(self) -> dict[str, Any]:
        """Return the switching as plain data."""
        lists = {
            "price": [list(row) for row in self.price] if isinstance(self.price, tuple) else None,
            "hold": list(self.hold) if isinstance(self.hold, tuple) else None,
        }
        data = {key: getattr(self, key) if value is None else value for key, value in lists.items()}
        return {**data, "forbidden": [list(pair) for pair in self.forbidden]}


def check_switching(owner: Any) -> None:
    """Raise unless the switching of a problem or a policy is None, or fits its other fields."""
    switching = owner.switching
    if switching is None:
        return
    if not isinstance(switching, Switching):
        raise ProblemError(f"`switching` must be a capsyn.Switching; got {describe(switching)}")
    switching.check(owner.alphabet, owner.outside)
    if owner.min_dwell and switching.hold != 0.0:
        raise ProblemError(
            "`min_dwell` must not be given together with the `hold` of `switching`, of which it is "
            "the short form; got both"
        )


@dataclass(frozen=True, eq=False)
class SwitchRules:
    """What a change of labels costs and waits for; labels are symbols, and the default last."""

    controls: np.ndarray  # (N + 1, m) [input units]
    prices: np.ndarray  # (N + 1, N + 1) from each to each [cost / time unit], infinite: forbidden
    holds: np.ndarray  # (N + 1,): how long each is held once entered [time unit]
    input_holds: np.ndarray  # (m,): how long each input is held once it has changed [time unit]
    kinds: np.ndarray  # (N + 1,) ints, equal where a change is no switch: the first of its kind

    @staticmethod
    def of(owner: Any, spread: float = 1.0) -> SwitchRules:
        """Return those of what has alphabet, default, least dwell, and perhaps a `Switching`.

        Where its price is a share, yet, 100 % are `spread` [cost / time unit].

        Between labels of the same control is no switch, unless going from one to another costs
        something.
        """
        alphabet, default, switching = owner.alphabet, owner.default_control, owner.switching
        controls = np.vstack([alphabet.values, default])
        count = len(controls)
        prices, inputs = np.zeros((count, count)), np.zeros(alphabet.m)
        holds = np.full(count, owner.min_dwell)
        if switching is not None:
            switching = switching.with_spread(spread)
            prices, inputs = switching.prices(alphabet, default), switching.input_holds(alphabet)
            holds = np.maximum(holds, switching.holds(alphabet, default))
        return SwitchRules(controls, prices, holds, inputs, _kinds(controls, prices))

    @property
    def forbidden(self) -> np.ndarray:
        """Transitions that must not be taken, (N + 1, N + 1) bool."""
        return np.isinf(self.prices)


def _kinds(controls: np.ndarray, prices: np.ndarray) -> np.ndarray:
    groups: dict[tuple[float, ...], list[int]] = {}
    for k, control in enumerate(map(tuple, controls.tolist())):
        groups.setdefault(control, []).append(k)
    kinds = np.arange(len(controls))
    for group in groups.values():
        if not prices[np.ix_(group, group)].any():
            kinds[group] = group[0]
    return kinds


def _known(what: str, name: str, known: Sequence[str], kind: str) -> None:
    """Raise unless a name is among those known, which are of a kind."""
    if name not in known:
        raise ProblemError(f"`{what}` must name {kind} ({', '.join(known)}); got '{name}'")


def _one_price(name: str, price: Any) -> Any:
    """Return a number, or a share as text in the form ``1%``."""
    if not isinstance(price, str):
        return finite_number(name, price, least=0.0)
    text = price.strip()
    try:
        share = float(text.removesuffix("%"))
        if not text.endswith("%") or not 0 <= share < np.inf:
            raise ValueError
    except ValueError:
        raise ProblemError(
            f'`{name}` must be a number >= 0 or a share such as "1%"; got {describe(price)}'
        ) from None
    return f"{share:g}%" if float(f"{share:g}") == share else f"{share!r}%"


def _checked_price(price: Any) -> Any:
    if isinstance(price, Mapping):
        return {str(name): _one_price(f"price of {name}", p) for name, p in price.items()}
    if isinstance(price, str) or not np.ndim(price):
        return _one_price("price", price)
    table = numbers("price", price)
    if table.ndim != 2 or table.shape[0] != table.shape[1] or not len(table):
        raise ProblemError(
            f"`price` must be a number, a share or a matrix (N, N); got shape {table.shape}"
        )
    if not (np.isfinite(table).all() and (table >= 0).all()):
        raise ProblemError(f"`price` must be >= 0 and finite everywhere; got {describe(price)}")
    if np.diagonal(table).any():
        raise ProblemError(f"`price` must be 0 on its diagonal; got {describe(price)}")
    return tuple(map(tuple, (table + 0.0).tolist()))


def _checked_hold(hold: Any) -> Any:
    if isinstance(hold, Mapping):
        return {str(k): finite_number(f"hold of {k}", v, least=0.0) for k, v in hold.items()}
    if not np.ndim(hold):
        return finite_number("hold", hold, least=0.0)
    return tuple(finite_number(f"hold[{k}]", time, least=0.0) for k, time in enumerate(hold))


def _checked_pairs(pairs: Any) -> tuple[tuple[str, str], ...]:
    wrong = ProblemError(f"`forbidden` must be pairs of names; got {describe(pairs)}")
    if isinstance(pairs, (str, Mapping)) or not isinstance(pairs, Iterable):
        raise wrong
    checked = []
    for pair in pairs:
        if not is_list(pair, 2) or not all(isinstance(name, str) for name in pair):
            raise wrong
        if pair[0] == pair[1]:
            raise ProblemError(f"`forbidden` must be pairs of two names; got '{pair[0]}' twice")
        checked.append((pair[0], pair[1]))
    return tuple(dict.fromkeys(checked))
