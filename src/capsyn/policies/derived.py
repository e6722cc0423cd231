"""What follows from the fields of a policy."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.limits.kept import Kept
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Box
from capsyn.modelling.exogenous import joined, readings
from capsyn.modelling.switching import SwitchRules
from capsyn.policies.checks import labels_in_force
from capsyn.policies.in_force import volume_shares
from capsyn.policies.lookup import row_numbers
from capsyn.programs.model import Model
from capsyn.validation import read_only


class Derived:
    """Properties of a policy; see `Policy`, whose fields these are."""

    name: str
    domain: Box
    exogenous: Box | None
    alphabet: Alphabet
    default: np.ndarray
    cells: Any
    transitions: Any
    kept: Kept | None
    model: Model | None

    @functools.cached_property
    def space(self) -> Box:
        """What the cells divide: the domain, and after its axes those of the exogenous inputs.

        A point of it is a reading: what the policy is asked with.
        """
        return joined(self.domain, self.exogenous)

    @property
    def default_control(self) -> np.ndarray:
        """The default control (m,) [input units], as of a problem."""
        return self.default

    @property
    def discrete(self) -> bool:
        """Whether it comes from a discrete-time problem: a map, and a horizon in samples."""
        return self.model is not None and self.model.sample_time is not None

    @property
    def remembers(self) -> bool:
        """Whether the next symbol depends on the symbol in force."""
        return len(self.transitions) > len(self.alphabet) + 1 or self.cells.priced

    @functools.cached_property
    def controls(self) -> np.ndarray:
        """Control vectors (N + 1, m) of the symbols, the default control last [input units]."""
        table = np.vstack([self.alphabet.values, self.default])
        return read_only(table)

    def keeps_limits(self, states: Any, exogenous: Any = None, current: Any = None) -> Any:
        """Return from which states (..., n) the sampled loop keeps the limits, booleans (...).

        It is proved for every loop with the sample time and the delay of the policy, and with
        parameters in the ranges, that `synthesize` was given; the symbol in force must be free to
        change. `exogenous` and `current` are those of a call of the policy. Elsewhere the policy
        does what violates limits least in one period.

        Raises
        ------
        ProblemError
            A policy that was not made to keep limits, states of another shape, or symbols in force
            that are none.
        """
        if self.kept is None:
            raise ProblemError(
                "`keeps_limits` needs a policy that was made with `keep_limits`; this one was not"
            )
        points = readings(states, exogenous, self.domain, self.exogenous)
        shape = points.shape[:-1]
        numbers = row_numbers(points.reshape(-1, self.space.n), self.space, self.kept.cells, False)
        now = labels_in_force(current, shape, self.alphabet)
        return self.kept.holds(numbers, now).reshape(shape)[()]

    @functools.cached_property
    def rules(self) -> SwitchRules:
        """What a change of symbols costs and waits for, for each symbol and the default."""
        return SwitchRules.of(self)

    def symbol_name(self, symbol: int) -> str:
        """Return the name of a symbol index; -1 is ``default``."""
        return "default" if symbol < 0 else self.alphabet.names[symbol]

    @functools.cached_property
    def volume_shares(self) -> np.ndarray:
        """Share of the domain's volume of each symbol, and of the default last, (N + 1,).

        It is that of the next symbol, the mean over all symbols in force where that matters. Where
        planes bound symbols it is estimated at random states, if they are fewer.
        """
        return volume_shares(self)

    @property
    def has_planes(self) -> bool:
        """Whether planes that are oblique to the axes bound symbols: affine leaves, or splits."""
        return self.cells.has_planes

    @property
    def title(self) -> str:
        """The name, and of a decision tree its mode."""
        return self.name

    def _repr_html_(self) -> str:
        """Return a small map for notebooks."""
        from capsyn.policies.picture import map_html

        return map_html(self)
