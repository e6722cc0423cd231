"""Strategies of UPPAAL Stratego that were learned, as ``saveStrategy`` writes them: JSON.

``statevars`` are discrete, ``pointvars`` continuous variables. For each valuation of the first,
``regressors`` has for each action a tree over the others, whose numbers are expected costs: the
action of least cost is taken (of largest, without ``minimize``).
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet, Outside, check_outside
from capsyn.modelling.domain import Box
from capsyn.modelling.grid import MAX_COUNT
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree
from capsyn.sources.table import MOST_AXES, MOST_SYMBOLS, Table
from capsyn.sources.tables.json_text import json_of
from capsyn.sources.tables.numbers import number
from capsyn.sources.tables.points import Points
from capsyn.sources.tables.regressors import (
    MOST_NODES,
    Contest,
    Refuse,
    Regressor,
    least,
    regressor_of,
)
from capsyn.sources.tables.symbols import of_names
from capsyn.sources.text import check_alphabet, naming, path_text, read_bytes
from capsyn.validation import describe, finite_number, one_line

STEPS = 1 << 30
"""Lattice steps along the axis of a continuous variable."""
JUDGES = 10_000
"""Random states at which a tree is compared with the strategy."""
FARTHEST = 10**9
"""Largest value of a discrete variable."""


@dataclass(frozen=True, eq=False)
class Strategy:
    """A strategy over continuous variables, with a tree of expected costs for each action.

    Parameters
    ----------
    path : str
        Name of the file, for error messages.
    source : str
        SHA-256 of the file.
    alphabet : Alphabet
        The actions of the strategy.
    names : n strings
        Names of the discrete variables, then of the continuous variables.
    regressors : mapping
        For each valuation (tuple of ints) of the discrete variables, the trees by symbol.
    bounds : k pairs
        Bounds of the k continuous variables: a box that is wider than the cuts of the trees.
    """

    path: str
    source: str
    alphabet: Alphabet
    names: Sequence[str]
    regressors: Mapping[tuple[int, ...], Mapping[int, Regressor]]
    bounds: Sequence[tuple[float, float]]

    @property
    def discrete(self) -> int:
        """Number of the discrete variables."""
        return len(self.names) - len(self.bounds)

    @property
    def _keys(self) -> np.ndarray:
        """The valuations (K, n) of discrete variables."""
        keys = np.array(list(self.regressors), dtype=float)
        return keys.reshape(len(self.regressors), self.discrete)

    def box(self, around: int = 0) -> Box:
        """Return the box of states, with `around` more values of discrete variables at each end."""
        ends = [(v.min() - 0.5 - around, v.max() + 0.5 + around) for v in self._keys.T]
        lower, upper = zip(*ends, *self.bounds)
        return Box(lower, upper, names=list(self.names))

    def __call__(self, states: Any) -> np.ndarray:
        """Return the symbols (B,) of states (B, n) as in the file; -1 if there is none."""
        states = np.asarray(states, dtype=float)
        found = np.full(len(states), -1)
        keys = states[:, : self.discrete]
        order = np.lexsort(keys.T) if self.discrete else np.arange(len(states))
        new = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
        for rows in np.split(order, np.flatnonzero(new) + 1):
            if not len(rows) or not (trees := self.regressors.get(tuple(keys[rows[0]]))):
                continue
            costs = [tree.values(states[rows, self.discrete :]) for tree in trees.values()]
            best = np.argmin(costs, axis=0)
            none = np.isinf(np.min(costs, axis=0))
            found[rows] = np.where(none, -1, np.array(list(trees))[best])
        return found

    def policy(
        self,
        name: str = "strategy",
        *,
        default: Any = None,
        outside: Outside = "nearest",
        min_dwell: float = 0.0,
        time_unit: str = "s",
        outside_at_once: bool = False,
    ) -> DecisionTree:
        """Return the strategy as a decision tree.

        Parameters
        ----------
        name, default, outside, min_dwell, time_unit, outside_at_once
            Arguments of `Table.policy`.

        Notes
        -----
        The tree compares lattice steps, with `STEPS` steps along the axis of a continuous variable.
        A bound moves up by less than one step, so a state at a bound is on the side that the file
        says. If costs are equal, the first action wins. Under rule ``"nearest"``, a state beyond
        the domain of the continuous variables has the symbol that the strategy has there. Values of
        discrete variables that the strategy does not have are gaps.

        Raises
        ------
        ProblemError
            An argument that cannot be used, or more than `MOST_NODES` nodes.
        """
        outside = check_outside(outside, self.alphabet)
        around = int(outside == "nearest")
        domain, n = self.box(around), self.discrete
        counts = tuple(int(width) for width in domain.widths[:n])
        counts += tuple(_steps(low, high) for low, high in self.bounds)
        domain.check_resolution(counts)
        keyed = {}
        for key, trees in self.regressors.items():
            places = np.array(key) - domain.lower[:n] - 0.5
            keyed[tuple(places.astype(int).tolist())] = Contest(
                list(trees),
                list(trees.values()),
                [self._cuts(tree, domain, counts) for tree in trees.values()],
            )
        with naming(self.path):
            cells = least(counts, keyed, len(self.alphabet))
        make = functools.partial(
            DecisionTree,
            name=name,
            domain=domain,
            alphabet=self.alphabet,
            default=np.zeros(self.alphabet.m) if default is None else default,
            cells=cells,
            outside=outside,
            min_dwell=min_dwell,
            gaps=bool((cells.leaf_labels() == len(self.alphabet)).any()),
            time_unit=time_unit,
            outside_at_once=outside_at_once,
        )
        judged = Guarantee("linear", self.source)
        states = self._states(domain)
        tree = make(guarantee=judged)
        same = int((tree(states, outside=-1) == self(states)).sum())
        return make(
            guarantee=Guarantee(
                "linear",
                self.source,
                changed=1 - same / JUDGES,
                controller="function",
                states=JUDGES,
                agreeing=same,
            )
        )

    def _states(self, domain: Box) -> np.ndarray:
        """Return random states (B, n), of valuations that the strategy has."""
        states = domain.sample(JUDGES)
        keys = self._keys
        states[:, : self.discrete] = keys[np.arange(JUDGES) % len(keys)]
        return states

    def _cuts(self, tree: Regressor, domain: Box, counts: tuple[int, ...]) -> list[int]:
        """Return the lattice step (K,) from which on states are above the bound of each node."""
        cuts = np.zeros(len(tree.axis), dtype=np.int64)
        for k in range(len(self.bounds)):
            axis, rows = self.discrete + k, np.flatnonzero(tree.axis == k)
            states = np.tile(domain.lower, (len(rows), 1))
            states[:, axis] = tree.bound[rows]
            cuts[rows] = domain.locate(states, counts)[:, axis] + 1
            cuts[rows[tree.bound[rows] < domain.lower[axis]]] = 0
        return cuts.tolist()


def _steps(low: float, high: float) -> int:
    """Return `STEPS`, or as many fewer as floating point can tell apart between bounds."""
    count, finest = STEPS, max(32 * np.spacing(max(abs(low), abs(high))), 1e-299)
    while count > 2 and (high - low) / count < finest:
        count //= 2
    return count


def read_stratego(
    path: str | os.PathLike[str],
    alphabet: Alphabet | None = None,
    domain: Mapping[str, tuple[float, float]] | None = None,
) -> Table | Strategy:
    """Return the strategy in a JSON file of UPPAAL Stratego.

    A strategy without continuous variables becomes a table. The grid of the table has steps of 1,
    and its symbols are all actions of least cost.

    Parameters
    ----------
    path : path
        The file.
    alphabet : Alphabet, optional
        Control vectors by the texts of the actions, or in the order of the actions. Default: 0, 1,
        ..
    domain : mapping, optional
        Lower and upper bounds of continuous variables, by name. Default: an eighth wider at each
        end than the bounds of the trees.

    Raises
    ------
    ProblemError
        The file has another format, or a key makes no sense. The message names the key.
    """
    path = path_text(path)
    check_alphabet(alphabet)
    ranges = _ranges({} if domain is None else domain)
    text = read_bytes(path)
    data = json_of(path, text)
    refuse = Refuse(f"'{path}'")
    if not isinstance(data, dict):
        refuse("an object, as saveStrategy of UPPAAL Stratego writes it", data)
    for key, wanted in (("type", "state->regressor"), ("representation", "map")):
        if data.get(key) != wanted:
            refuse(f"{wanted!r} for '{key}'", data.get(key))
    variables = [_texts(refuse, data, key) for key in ("statevars", "pointvars")]
    names = [name.strip() for part in variables for name in part]
    if not 0 < len(names) <= MOST_AXES:
        refuse(f"1 to {MOST_AXES} variables", f"{len(names)}")
    actions = data.get("actions")
    if not isinstance(actions, dict) or not all(isinstance(t, str) for t in actions.values()):
        refuse("an object of texts for 'actions'", actions)
    found = _regressors(path, data.get("regressors"), [len(part) for part in variables])
    used = sorted({a for trees in found.values() for a in trees}, key=lambda a: (len(a), a))
    for action in used:
        if action not in actions:
            refuse("an action of 'actions'", action)
    if not used:
        refuse("an action with a number at some state", "none")
    texts = [" ".join(actions[action].split()) for action in used]
    texts = [f"{t} #{a}" if texts.count(t) > 1 else t for t, a in zip(texts, used)]
    known, alphabet = of_names(path, texts, alphabet)
    if len(alphabet) > MOST_SYMBOLS:
        refuse(f"at most {MOST_SYMBOLS} actions", len(alphabet))
    symbols = {action: known[text] for action, text in zip(used, texts)}
    keyed = {
        key: {symbols[a]: trees[a] for a in sorted(trees, key=symbols.__getitem__)}
        for key, trees in found.items()
    }
    bounds = _bounds(keyed, names[len(variables[0]) :], ranges)
    if not variables[1]:
        return _table(path, names, keyed, alphabet)
    source = hashlib.sha256(text).hexdigest()
    strategy = Strategy(path, source, alphabet, names, keyed, bounds)
    with naming(path):
        box = strategy.box(1)
    if (box.widths[: strategy.discrete] > MAX_COUNT).any():
        refuse(f"discrete variables of at most {MAX_COUNT:,} values", "more")
    return strategy


def _texts(refuse: Refuse, data: dict[str, Any], key: str) -> list[str]:
    texts = data.get(key)
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        refuse(f"a list of texts for '{key}'", texts)
    return texts


def _regressors(
    path: str, plain: Any, sizes: Sequence[int]
) -> dict[tuple[int, ...], dict[str, Regressor]]:
    """Return the trees of actions by the valuations of discrete variables."""
    refuse = Refuse(f"'{path}'")
    if not isinstance(plain, dict) or not plain:
        refuse("an object for 'regressors'", plain)
    found: dict[tuple[int, ...], dict[str, Regressor]] = {}
    minimize, room = None, MOST_NODES
    for text, entry in plain.items():
        refuse = Refuse(f"'{path}', regressor {describe(text)}")
        key = _key(text, sizes[0], refuse)
        if key in found:
            refuse("a state that has no regressor yet", text)
        if not isinstance(entry, dict) or not isinstance(entry.get("regressor"), dict):
            refuse("an object with 'regressor', an object", entry)
        if entry.get("representation") != "simpletree":
            refuse("'simpletree' for 'representation'", entry.get("representation"))
        if entry.get("minimize") not in (0, 1) or minimize not in (None, entry["minimize"]):
            refuse("the same 'minimize' for all, 0 or 1", entry.get("minimize"))
        minimize = entry["minimize"]
        trees: dict[str, Regressor] = {}
        for action, tree in entry["regressor"].items():
            made = regressor_of(tree, sizes[1], 1.0 if minimize else -1.0, refuse, room)
            room -= len(made.axis)
            if np.isfinite(made.bound[made.axis < 0]).any():
                trees[action] = made
        if trees:
            found[key] = trees
    return found


def _key(text: str, size: int, refuse: Refuse) -> tuple[int, ...]:
    """Return the valuation of discrete variables in a text such as ``(0,3)``."""
    parts = text.strip().removeprefix("(").removesuffix(")").split(",")
    if not size:
        if parts not in ([""], ["1"]):
            refuse("(1), where there are no discrete variables", text)
        return ()
    values = [number(part) for part in parts]
    if len(values) != size or not all(v == np.rint(v) and abs(v) <= FARTHEST for v in values):
        refuse(f"(VALUE,..), {size} whole numbers within +-{FARTHEST:,}", text)
    return tuple(int(value) for value in values)


def _table(
    path: str,
    names: list[str],
    keyed: dict[tuple[int, ...], dict[int, Regressor]],
    alphabet: Alphabet,
) -> Table:
    """Return the table of a strategy without continuous variables."""
    masks = []
    for trees in keyed.values():
        costs = {symbol: tree.bound[0] for symbol, tree in trees.items()}
        best = min(costs.values())
        masks.append(sum(1 << symbol for symbol, cost in costs.items() if cost == best))
    bits, lines = np.array(masks, dtype=np.uint64), np.arange(1, len(masks) + 1)
    states = np.array(list(keyed), dtype=float)
    return Points(path, names, None, states, lines, bits, "regressor").whole_table(alphabet)


def _ranges(domain: Any) -> dict[str, tuple[float, float]]:
    """Return the bounds of variables that a user gives."""
    if not isinstance(domain, Mapping):
        raise ProblemError(
            "`domain` (--domain) must map names of variables to pairs of bounds; got "
            f"{describe(domain)}"
        )
    ranges = {}
    for name, ends in domain.items():
        try:
            low, high = ends
        except (TypeError, ValueError):
            raise ProblemError(
                f"`domain` (--domain) must have a pair of bounds for {describe(name)}; got "
                f"{describe(ends)}"
            ) from None
        low, high = (finite_number(f"domain[{name!r}]", end) for end in (low, high))
        if not low < high:
            raise ProblemError(
                f"`domain` (--domain) must have a lower bound below the upper for "
                f"{describe(name)}; got {low!r} and {high!r}"
            )
        ranges[name] = low, high
    return ranges


def _bounds(
    keyed: dict[tuple[int, ...], dict[int, Regressor]],
    names: list[str],
    ranges: dict[str, tuple[float, float]],
) -> list[tuple[float, float]]:
    """Return the bounds of continuous variables."""
    for name in ranges:
        if name not in names:
            raise ProblemError(
                f"`domain` (--domain) must name continuous variables among "
                f"{one_line(', '.join(names)) or 'none'}; got {describe(name)}"
            )
    every = [tree for trees in keyed.values() for tree in trees.values()]
    bounds = []
    for k, name in enumerate(names):
        if name in ranges:
            bounds.append(ranges[name])
            continue
        cuts = np.concatenate([tree.bound[tree.axis == k] for tree in every])
        low, high = (cuts.min(), cuts.max()) if len(cuts) else (0.0, 0.0)
        more = (high - low) / 8 or max(1.0, abs(low))
        bounds.append((float(low - more), float(high + more)))
    return bounds
