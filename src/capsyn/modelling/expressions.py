"""What users' functions give on symbols: CasADi expressions of the right size, or one line."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.interpolants import without_calls
from capsyn.validation import describe, one_line


@contextlib.contextmanager
def _numpy_functions() -> Iterator[None]:
    """Let NumPy ufuncs on CasADi values give CasADi values, without a warning, for a while."""
    options = ca.GlobalOptions
    before = options.getNumpyMode()
    options.setNumpyMode(-1)
    try:
        yield
    finally:
        options.setNumpyMode(before)


_MEANINGS = (
    ("truth value", "a symbol is neither true nor false: use casadi.if_else, fmin and fmax"),
    ("not iterable", "CasADi vectors cannot be unpacked: use x[0], x[1]"),
    ("Out of bounds", "an index is out of range"),
    ("out of bounds", "an index is out of range"),
    ("SX_get", "CasADi vectors are indexed by numbers: use x[0]"),
    (
        "'eval_sx' not defined",
        "it calls a CasADi function that has no symbolic form: make interpolants by "
        "casadi.interpolant, without `inline`",
    ),
)
"""What beginners' mistakes make CasADi and Python say, and what it means."""


def split_reading(z: ca.SX, inputs: Mapping[str, ca.SX], n: int) -> dict[str, ca.SX]:
    """Return the arguments of a user's function by name: x, `inputs` but p, w if any, and p."""
    told = {"w": z[n:]} if z.numel() > n else {}
    own = {name: value for name, value in inputs.items() if name != "p"}
    return {"x": z[:n], **own, **told, **{k: v for k, v in inputs.items() if k == "p"}}


def expression(
    name: str,
    function: Callable[..., Any],
    arguments: Mapping[str, ca.SX],
    size: int | None,
    *,
    rates: bool = False,
    parameters: bool = False,
) -> ca.SX:
    """Return what a user's function gives on symbols, as a dense column of `size` components.

    A `size` of None stands for any but 0.

    The arguments are CasADi columns by name (x, u, w, p), as many as the function takes, in order.
    `rates` says that the components are rates, one for each state; `parameters`, that the function
    may take parameters p that the user names elsewhere. Where it fails, or returns something else,
    a `ProblemError` names it in one line.
    """
    try:
        with _numpy_functions():
            value = function(*arguments.values())
    except Exception as error:  # whatever a user's function raises becomes one line
        reason = one_line(str(error)) or type(error).__name__
        reason = re.sub(r"^(Error in .*? at )?\S+\.[ch]pp:\d+: ", "", reason)  # CasADi's own places
        reason = next((text for words, text in _MEANINGS if words in reason), reason)
        if "positional argument" in reason:
            said = parameters and "p" not in arguments
            reason = f"it must be a function of {' and '.join(arguments)}" + (
                ("" if "w" in arguments else ", and of w where there is `exogenous`")
                + (", and of p where there are `parameters`" if said else "")
            )
        shapes = ", ".join(
            f"{symbol}: {argument.numel()}" for symbol, argument in arguments.items()
        )
        if parameters and "out of range" in reason:
            reason += "; it may take more parameters (`parameters`, --parameter) than are given"
        raise ProblemError(
            f"`{name}` failed on symbols with sizes ({shapes}): {one_line(reason)}"
        ) from error
    wanted = "a scalar" if size == 1 else f"{size or 'one or more'} components"
    wanted = f"{size} component(s), one per state" if rates else wanted
    try:
        with _numpy_functions():
            column = value
            if isinstance(value, (list, tuple, np.ndarray)):
                column = ca.vertcat(*list(value))
            column = ca.SX(column)
    except Exception:  # CasADi raises several types
        raise ProblemError(f"`{name}` must return {wanted}; got {describe(value)}") from None
    size = max(column.shape) if size is None else size
    if column.shape == (1, size):
        column = column.T
    if column.shape != (size, 1) or not size:
        raise ProblemError(f"`{name}` must return {wanted}; got shape {column.shape}")
    return without_calls(name, ca.densify(column), list(arguments.values()))


def casadi_function(name: str, arguments: Sequence[ca.SX], value: ca.SX) -> ca.Function:
    """Return the function of an `expression`; `ProblemError` if it uses other symbols."""
    function = ca.Function(name, list(arguments), [value], {"allow_free": True})
    foreign = function.get_free()
    if foreign:
        raise ProblemError(
            f"`{name}` must use only its arguments; it uses the undeclared symbol '{foreign[0]}'"
        )
    return function
