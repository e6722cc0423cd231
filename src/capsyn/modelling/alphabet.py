"""The alphabet: the finite list of actuator settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.validation import describe, distinct, finite_array, keep, numbers, plain, texts

MAX_SYMBOLS = 4096
"""Most symbols of an alphabet."""


@dataclass(frozen=True, eq=False)
class Alphabet:
    """The symbols that a controller may choose from (Definition 1 of the paper).

    Parameters
    ----------
    values : (N, m), or (N,) for one input
        Control vectors [input units], at most 4,096. Two of them may be equal only if `names` tell
        them apart.
    names : N strings, optional
        Names of the symbols. Default: their values as text.
    inputs, units : m strings, optional
        Names and units of the inputs. Default: ``u1 .. um`` and no units.

    Raises
    ------
    ProblemError
        Empty or duplicate symbols, wrong shapes, NaN or infinite numbers.
    """

    values: Any
    names: Any = None
    inputs: Any = None
    units: Any = None

    def __post_init__(self) -> None:
        values = numbers("alphabet", self.values)
        if values.ndim == 1:
            values = values[:, None]
        if values.ndim != 2 or values.shape[1] == 0 and values.shape[0]:
            raise ProblemError(f"`alphabet` must have shape (N, m); got {np.shape(self.values)}")
        if not len(values):
            raise ProblemError("`alphabet` must have at least one symbol; got none")
        if len(values) > MAX_SYMBOLS:
            raise ProblemError(
                f"`alphabet` must have at most {MAX_SYMBOLS} symbols; got {len(values)}"
            )
        values = finite_array("alphabet", values, 2)
        unique, first = np.unique(values, axis=0, return_index=True)
        if self.names is None and len(unique) < len(values):
            twice = min(set(range(len(values))) - set(first.tolist()))
            raise ProblemError(
                "`alphabet` must have distinct symbols, or names that tell them apart; "
                f"got {values[twice].tolist()} twice"
            )
        m = values.shape[1]
        names = texts("alphabet names", self.names, len(values), [_text(v) for v in values])
        distinct("alphabet names", names)
        reserved = {"error", "nearest", "default"}.intersection(names)
        if reserved:
            raise ProblemError(
                f"`alphabet names` must not be 'error', 'nearest' or 'default'; got {names!r}"
            )
        inputs = texts("alphabet inputs", self.inputs, m, [f"u{i + 1}" for i in range(m)])
        distinct("alphabet inputs", inputs)
        units = texts("alphabet units", self.units, m, [""] * m)
        keep(self, values=values, names=names, inputs=inputs, units=units)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return self.values.shape[1]

    def control(self, name: str, value: Any) -> np.ndarray:
        """Return a value as a control vector (m,) [input units], after checking it.

        Parameters
        ----------
        name : str
            The name of the argument in error messages.
        value : (m,) numbers, or one where m is 1
            The control [input units].

        Raises
        ------
        ProblemError
            The value has another shape, or numbers that are not finite.
        """
        control = finite_array(name, value, 1 if numbers(name, value).ndim else 0).reshape(-1)
        if control.shape != (self.m,):
            raise ProblemError(
                f"`{name}` must have shape ({self.m},), one entry per input; got {control.shape}"
            )
        return control

    def __len__(self) -> int:
        return len(self.values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Alphabet) and self.to_json() == other.to_json()

    def __hash__(self) -> int:
        return hash((self.values.tobytes(), self.names, self.inputs, self.units))

    def to_json(self) -> dict[str, Any]:
        """Return the alphabet as plain data."""
        return plain(self)


def _text(value: np.ndarray) -> str:
    """Return the default name of a symbol; repr keeps close values apart."""
    numbers = [repr(float(v)).removesuffix(".0") for v in value]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"


Outside = str | int


def check_outside(rule: Any, alphabet: Alphabet) -> Outside:
    """Return an out-of-domain rule, validated.

    A symbol may be given by its index, or as text by its name, else by its index.
    """
    if isinstance(rule, str):
        if rule in ("error", "nearest"):
            return rule
        if rule in alphabet.names:
            return alphabet.names.index(rule)
        if rule.removeprefix("-").isdecimal() and -1 <= int(rule) < len(alphabet):
            return int(rule)
    elif isinstance(rule, (int, np.integer)) and not isinstance(rule, bool):
        if -1 <= rule < len(alphabet):
            return int(rule)
    raise ProblemError(
        '`outside` must be "error", "nearest" or a symbol (its name, -1 for the default, or its '
        f"index, -1 to {len(alphabet) - 1}); got {describe(rule)}"
    )
