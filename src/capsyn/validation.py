"""Checks of arguments: each raises a one-line `ProblemError` with what is wanted and what came.

What passed is kept in frozen dataclasses, its arrays read-only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from capsyn.errors import ProblemError

BACKENDS = ("auto", "c", "numpy")
"""What computes: compiled where there is a compiler, compiled, or NumPy."""


def describe(value: Any, limit: int = 60) -> str:
    """Return a short one-line text of a value, for messages."""
    return one_line(repr(value), limit)


def one_line(text: str, limit: int = 200) -> str:
    """Return a text as one line, cut to a length that fits a message."""
    text = " ".join(text.split())
    return text if len(text) <= limit else text[: limit - 3] + "..."


def numbers(name: str, value: Any) -> np.ndarray:
    """Return `value` as a float array, a copy only where it must be; text is no number."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biufO":
            raise TypeError
        return array.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError):
        raise ProblemError(f"`{name}` must be numbers; got {describe(value)}") from None


def state_array(value: Any, n: int) -> np.ndarray:
    """Return `states` as a float array (..., n), a copy only where it must be."""
    states = numbers("states", value)
    if states.ndim == 0 or states.shape[-1] != n:
        raise ProblemError(f"`states` must have shape (..., {n}); got {states.shape}")
    return states


def read_only(array: np.ndarray) -> np.ndarray:
    """Return a view of an array through which nothing can be written."""
    view = array.view()
    view.flags.writeable = False
    return view


def keep(frozen: Any, **fields: Any) -> None:
    """Set fields of a frozen dataclass, while it is made, to what they were checked to be."""
    for name, value in fields.items():
        object.__setattr__(frozen, name, value)


def keep_read_only(frozen: Any, *names: str) -> None:
    """Make arrays among the fields of a frozen dataclass read-only, those that are there."""
    arrays = {name: getattr(frozen, name) for name in names}
    keep(frozen, **{name: read_only(a) for name, a in arrays.items() if a is not None})


def plain(frozen: Any) -> dict[str, Any]:
    """Return the fields of a dataclass as plain data, arrays and tuples as lists."""
    values = {f.name: getattr(frozen, f.name) for f in dataclasses.fields(frozen)}
    arrays = {k: v.tolist() for k, v in values.items() if isinstance(v, np.ndarray)}
    return values | {k: list(v) for k, v in values.items() if isinstance(v, tuple)} | arrays


def finite_array(name: str, value: Any, ndim: int) -> np.ndarray:
    """Return `value` as a read-only float array of `ndim` dimensions without NaN or infinity."""
    array = np.array(numbers(name, value) + 0.0)  # + 0.0: a copy, and -0.0 becomes 0.0
    if array.ndim != ndim:
        wanted = ("a number", "a list of numbers", "a matrix of numbers")[ndim]
        raise ProblemError(f"`{name}` must be {wanted}; got {describe(value)}")
    if not np.isfinite(array).all():
        raise ProblemError(f"`{name}` must be finite; got {describe(value)}")
    return read_only(array)


def finite_number(
    name: str, value: Any, *, above: float | None = None, least: float | None = None
) -> float:
    """Return `value` as a finite float that is greater than `above` and at least `least`."""
    bound = f" > {above:g}" if above is not None else f" >= {least:g}" if least is not None else ""
    try:
        if isinstance(value, (str, bytes, bool, np.bool_)) or np.iscomplexobj(value):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise ProblemError(f"`{name}` must be a number{bound}; got {describe(value)}") from None
    wrong = (above is not None and number <= above) or (least is not None and number < least)
    if not np.isfinite(number) or wrong:
        raise ProblemError(f"`{name}` must be a finite number{bound}; got {describe(value)}")
    return number


def whole_number(name: str, value: Any, *, least: int, most: int | None = None) -> int:
    """Return `value` as an int within ``[least, most]``; a float, even 4.0, is refused."""
    wanted = f"a whole number >= {least}" + (f" and <= {most}" if most is not None else "")
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise ProblemError(f"`{name}` must be {wanted}; got {describe(value)}")
    if value < least or (most is not None and value > most):
        raise ProblemError(f"`{name}` must be {wanted}; got {describe(value)}")
    return int(value)


def is_list(value: Any, count: int) -> bool:
    """Return whether `value` is a sequence, or an array of one dimension, with `count` entries."""
    if isinstance(value, np.ndarray):
        return value.shape == (count,)
    return isinstance(value, Sequence) and not isinstance(value, str) and len(value) == count


def whole_numbers(
    name: str, value: Any, n: int, *, least: int, most: int | None = None
) -> tuple[int, ...]:
    """Return one int per axis from an int (for all axes) or a sequence of `n` ints."""
    if isinstance(value, (int, np.integer)):
        return (whole_number(name, value, least=least, most=most),) * n
    if not is_list(value, n):
        raise ProblemError(
            f"`{name}` must be a whole number or {n} of them, one per axis; got {describe(value)}"
        )
    return tuple(
        whole_number(f"{name}[{i}]", v, least=least, most=most) for i, v in enumerate(value)
    )


def texts(name: str, value: Any, count: int, default: Sequence[str]) -> tuple[str, ...]:
    """Return `count` strings, or `default` where `value` is None."""
    if value is None:
        return tuple(default)
    if (
        isinstance(value, str)
        or not isinstance(value, Sequence)
        or len(value) != count
        or not all(isinstance(v, str) and v.isprintable() for v in value)
    ):
        raise ProblemError(f"`{name}` must be {count} printable string(s); got {describe(value)}")
    return tuple(value)


def distinct(name: str, value: Sequence[str]) -> None:
    """Raise unless the strings are non-empty and all different."""
    if not all(value) or len(set(value)) < len(value):
        raise ProblemError(f"`{name}` must be non-empty and distinct; got {describe(value)}")


def true_or_false(name: str, value: Any) -> None:
    """Raise `ProblemError` unless a value is True or False."""
    if not isinstance(value, bool):
        raise ProblemError(f"`{name}` must be True or False; got {describe(value)}")


def called(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a user's function gives; what it raises becomes one line that names it."""
    try:
        return function(*arguments)
    except Exception as error:  # a user's function may raise anything
        reason = one_line(f"{type(error).__name__}: {error}")
        raise ProblemError(f"`{name}` failed: {reason}") from error


def one_of(name: str, value: Any, choices: Sequence[str]) -> str:
    """Return `value` if it is one of the `choices`."""
    if not isinstance(value, str) or value not in choices:
        raise ProblemError(
            f"`{name}` must be one of {', '.join(map(repr, choices))}; got {describe(value)}"
        )
    return value
