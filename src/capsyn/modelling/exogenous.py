"""What a controller is told beside the state: setpoints, references, measured disturbances.

Inside, states and exogenous inputs are one vector ``z = (x, w)``, the reading; its box is the
space that cells divide. w has rate 0 in predictions, and no adjoint.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Ball, Box
from capsyn.validation import describe, numbers, state_array

COLUMNS = ("trial", "time", "cost", "symbol")
"""Columns that files of trajectories have beside those of states and inputs."""


def check_exogenous(exogenous: Any, domain: Box, alphabet: Alphabet) -> Box | None:
    """Return the box of the exogenous inputs with names of its own; None: there are none.

    Names that boxes have unless told become ``w1 .. wk``. Something else than a box, or names that
    states, control inputs or `COLUMNS` have, is a `ProblemError`.
    """
    if exogenous is None:
        return None
    if not isinstance(exogenous, Box):
        raise ProblemError(f"`exogenous` must be a capsyn.Box; got {describe(exogenous)}")
    exogenous.check_wide("exogenous")
    if exogenous.names == Box.unnamed(exogenous.n):
        names = tuple(f"w{i + 1}" for i in range(exogenous.n))
        exogenous = dataclasses.replace(exogenous, names=names)
    if own := [name for name in exogenous.names if name in COLUMNS]:
        raise ProblemError(
            f"`exogenous` must have names that no column of trajectories has; got '{own[0]}'"
        )
    for kind, others in (("state", domain.names), ("control input", alphabet.inputs)):
        shared = [name for name in exogenous.names if name in others]
        if shared:
            raise ProblemError(
                f"`exogenous` must have names that no {kind} has; '{shared[0]}' is a {kind}, too"
            )
    return exogenous


def joined(domain: Box, exogenous: Box | None) -> Box:
    """Return the box of states and exogenous inputs, these last; the domain itself without any."""
    if exogenous is None:
        return domain
    return Box(
        np.concatenate([domain.lower, exogenous.lower]),
        np.concatenate([domain.upper, exogenous.upper]),
        domain.names + exogenous.names,
        domain.units + exogenous.units,
        domain.periodic + exogenous.periodic,
    )


def of_states(target: Any, domain: Box, exogenous: Box | None) -> Any:
    """Return a target that is about the states alone where it is a ball or box without names."""
    if exogenous is None or getattr(target, "n", None) != domain.n:
        return target
    unnamed = isinstance(target, Box) and target.names == Box.unnamed(target.n)
    if unnamed or (isinstance(target, Ball) and target.names is None):
        return dataclasses.replace(target, names=domain.names)
    return target


def exogenous_text(told: Box | None) -> str:
    """Return exogenous inputs and their bounds in words; empty where there are none."""
    if told is None:
        return ""
    return ", ".join(
        f"{name} in [{low:g}, {high:g}]"
        for name, low, high in zip(told.names, told.lower, told.upper)
    )


def beyond_text(box: Box, lowest: Any, highest: Any) -> str:
    """Return which values (n,), from lowest to highest, leave a box, with its bounds; else ""."""
    beyond = []
    for i, name in enumerate(box.names):
        low, high = box.lower[i], box.upper[i]
        value = lowest[i] if lowest[i] < low else highest[i]
        if not box.periodic[i] and not low <= value <= high:
            beyond.append(f"{name} = {value:g} is not in [{low:g}, {high:g}]")
    return ", ".join(beyond)


def readings(states: Any, exogenous: Any, domain: Box, told: Box | None) -> np.ndarray:
    """Return readings (..., n + k) of states (..., n) and exogenous inputs (..., k), checked.

    Both are broadcast against each other; of one exogenous input, numbers will do. Where there are
    some and none are given, `states` are readings already.
    """
    if told is None:
        if exogenous is not None:
            raise ProblemError(
                "`exogenous` must be left out: nothing is told beside the state; got "
                + describe(exogenous)
            )
        return state_array(states, domain.n)
    if exogenous is None:
        z = numbers("states", states)
        if z.ndim == 0 or z.shape[-1] != domain.n + told.n:
            raise ProblemError(
                f"`exogenous` must be given: {', '.join(told.names)} (or readings of "
                f"{domain.n + told.n} numbers, the states first); got states of shape {z.shape}"
            )
        return z
    x, w = state_array(states, domain.n), exogenous_array(exogenous, told)
    try:
        shape = np.broadcast_shapes(x.shape[:-1], w.shape[:-1])
    except ValueError:
        raise ProblemError(
            f"`exogenous` must fit states of shape {x.shape}; got shape {w.shape}"
        ) from None
    return np.concatenate(
        [np.broadcast_to(x, (*shape, domain.n)), np.broadcast_to(w, (*shape, told.n))], axis=-1
    )


def exogenous_array(values: Any, told: Box) -> np.ndarray:
    """Return exogenous inputs (..., k) as numbers, of a mapping of names, too."""
    if isinstance(values, Mapping):
        if set(values) != set(told.names):
            raise ProblemError(
                f"`exogenous` must give {', '.join(told.names)}; got {', '.join(map(str, values))}"
            )
        given = [numbers("exogenous", values[name]) for name in told.names]
        try:
            values = np.stack(np.broadcast_arrays(*given), -1)
        except ValueError:
            raise ProblemError(
                "`exogenous` must be numbers of shapes that fit each other; got "
                + " and ".join(str(value.shape) for value in given)
            ) from None
    w = numbers("exogenous", values)
    if w.ndim == 0 and told.n == 1:
        w = w[None]
    if w.ndim == 0 or w.shape[-1] != told.n:
        raise ProblemError(
            f"`exogenous` must be numbers of shape (..., {told.n}): {', '.join(told.names)}; got "
            f"shape {w.shape}"
        )
    return w


def one_exogenous(values: Any, told: Box | None) -> np.ndarray:
    """Return exogenous inputs (k,) within their box, of a mapping of names, too; None are none."""
    if told is None:
        if values is not None:
            raise ProblemError(
                f"`exogenous` must be left out: there are none; got {describe(values)}"
            )
        return np.empty(0)
    w = exogenous_array(values, told)
    if w.shape != (told.n,) or not told.contains(w[None])[0]:
        raise ProblemError(
            f"`exogenous` must be one of each: {exogenous_text(told)}; got {describe(values)}"
        )
    return w
