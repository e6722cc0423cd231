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
        """The box that cells divide: the axes of the domain, then those of the exogenous inputs.

        A point of this box is a reading, with which the policy is asked.
        """
        return joined(self.domain, self.exogenous)

    @property
    def default_control(self) -> np.ndarray:
        """The default control (m,) [input units], under the name that a problem uses."""
        return self.default

    @property
    def discrete(self) -> bool:
        """Whether the policy comes from a discrete-time problem, whose horizon is in samples."""
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
        """Return whether the sampled loop keeps the limits from `states` (..., n), booleans (...).

        True is proved for every loop with the policy's sample time and delay, and with parameters
        in the ranges that `synthesize` was given. The symbol in force must be free to change. From
        other states, the policy does what violates limits least in one period. `exogenous` and
        `current` are those of a call of the policy.

        Raises
        ------
        ProblemError
            The policy was not made to keep limits, states have another shape, or symbols in force
            are not in the alphabet.
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
        """Prices and least times of changes of the symbol, for each symbol and the default."""
        return SwitchRules.of(self)

    def symbol_name(self, symbol: int) -> str:
        """Return the name of a symbol index; -1 is ``default``."""
        return "default" if symbol < 0 else self.alphabet.names[symbol]

    @functools.cached_property
    def volume_shares(self) -> np.ndarray:
        """Share of the domain's volume of each symbol, (N + 1,), the default control last.

        A share belongs to the next symbol, as a mean over all symbols in force if they matter. If
        planes bound the symbols, shares are estimated at random states, if these are fewer than the
        finest cells.
        """
        return volume_shares(self)

    @property
    def has_planes(self) -> bool:
        """Whether oblique planes bound the symbols, as affine leaves and oblique splits do."""
        return self.cells.has_planes

    @property
    def title(self) -> str:
        """The name of the policy, with its mode if it is a decision tree."""
        return self.name

    def _repr_html_(self) -> str:
        """Return a small map for notebooks."""
        from capsyn.policies.picture import map_html

        return map_html(self)
