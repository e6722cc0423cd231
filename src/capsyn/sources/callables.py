"""Any controller as a labelling function: NumPy functions, and trained agents with `predict`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from capsyn.alphabet import Alphabet
from capsyn.errors import ProblemError
from capsyn.masks import Label
from capsyn.policy import Policy
from capsyn.problem import Problem
from capsyn.subdivision import subdivide
from capsyn.transcription import transcribe, transcribe_target
from capsyn.validation import describe, one_line, one_of


def labels_of(
    controller: Any,
    alphabet: Alphabet,
    *,
    actions: str = "symbols",
    batched: bool = True,
    observation: Callable[[np.ndarray], Any] | None = None,
) -> Label:
    """Return the labelling function ``states (B, n) -> symbols (B,)`` of a controller.

    It is what `capsyn.subdivide`, `problem_policy`, and `capsyn.compress` and `capsyn.agreement`
    (as ``controller``) take.

    Parameters
    ----------
    controller : callable, or object with a method ``predict``
        A function of observations that gives actions; or a trained agent, whose ``predict`` may
        give a pair of actions and something else, as that of Stable-Baselines3 does. ``predict``
        is called with ``deterministic=True`` where it takes that.
    alphabet : Alphabet
        The symbols.
    actions : "symbols" or "controls"
        What an action is: a symbol index, -1 for the default control; or a control vector (m,),
        which must equal that of a symbol.
    batched : bool
        Whether the controller takes many observations (B, ..) at once; else one at a time.
    observation : callable, optional
        States (B, n) to what the controller observes (B, ..). Default: the states.

    Raises
    ------
    ProblemError
        When called: an action that is no symbol, and at which state; or another shape.
    """
    predict = getattr(controller, "predict", None)
    ask = predict if callable(predict) else controller
    if not callable(ask):
        raise ProblemError(
            "`controller` must be a function of states or have a method predict; got "
            f"{describe(controller)}"
        )
    if not isinstance(alphabet, Alphabet):
        raise ProblemError(f"`alphabet` must be a capsyn.Alphabet; got {describe(alphabet)}")
    one_of("actions", actions, ["symbols", "controls"])
    if observation is not None and not callable(observation):
        raise ProblemError(f"`observation` must be a function; got {describe(observation)}")
    knows = predict is not None and ask is predict and _takes(predict, "deterministic")
    fixed = {"deterministic": True} if knows else {}
    find = _symbols if actions == "symbols" else _symbols_of_controls

    def act(observed: Any) -> Any:
        try:
            found = ask(observed, **fixed)
        except Exception as error:  # a user's function may raise anything
            reason = one_line(f"{type(error).__name__}: {error}")
            raise ProblemError(f"`controller` failed: {reason}") from error
        return found[0] if isinstance(found, tuple) else found

    def label(states: np.ndarray) -> np.ndarray:
        given = states.copy()  # what works in place must not move the caller's states
        observed = given if observation is None else observation(given)
        if len(observed) != len(states):
            raise ProblemError(
                f"`observation` must return {len(states)} observations; got {len(observed)}"
            )
        found = act(observed) if batched else [np.asarray(act(one)) for one in observed]
        try:
            array = np.asarray(found)
        except ValueError:
            array = np.zeros(0, dtype=object)
        size = 1 if actions == "symbols" else alphabet.m
        shapes = [(len(states), size)] + [(len(states),)] * (size == 1)
        if array.dtype.kind not in "iuf" or array.shape not in shapes:
            many = f"({len(states)}, {size})" if size > 1 else f"({len(states)},)"
            raise ProblemError(
                f"`controller` must return actions of shape {many}; got {array.dtype} of shape "
                f"{array.shape}" + ("" if batched else f" from {len(states)} calls")
            )
        return find(array.reshape(len(states), size), states, alphabet)

    return label


def _takes(function: Callable[..., Any], name: str) -> bool:
    """Return whether a function takes an argument of a name, where that can be known."""
    import inspect

    try:
        return name in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False


def _symbols(found: np.ndarray, states: np.ndarray, alphabet: Alphabet) -> np.ndarray:
    values = found[:, 0]
    good = (values >= -1) & (values < len(alphabet)) & (values == np.floor(values))
    if not good.all():
        i = int(np.flatnonzero(~good)[0])
        raise ProblemError(
            f"`controller` must return symbols from -1 to {len(alphabet) - 1}; got {values[i]} at "
            f"state {states[i].tolist()}"
        )
    return values.astype(np.int64)


def _symbols_of_controls(found: np.ndarray, states: np.ndarray, alphabet: Alphabet) -> np.ndarray:
    symbols = np.full(len(found), -1)
    for symbol in range(len(alphabet) - 1, -1, -1):
        value = alphabet.values[symbol]
        if found.dtype.kind == "f":  # as a float32 agent writes it
            value = value.astype(found.dtype)
        symbols[(found == value).all(axis=1)] = symbol
    lost = np.flatnonzero(symbols < 0)
    if len(lost):
        i = int(lost[0])
        raise ProblemError(
            f"`controller` must return controls of the alphabet ({', '.join(alphabet.names)}); got "
            f"{found[i].tolist()} at state {states[i].tolist()}"
        )
    return symbols


def problem_policy(label: Label, problem: Problem, **options: Any) -> Policy:
    """Return the policy of a labelling function for a problem, by Algorithm 1.

    It is what `capsyn.subdivide` makes on the problem's domain and grid, with all of the problem
    that does not belong to sSAC: model, target, default control, outside rule and dwell time.

    Parameters
    ----------
    label : callable
        States (B, n) to symbols (B,): that of `labels_of`, a `FiniteControlSet`, any other.
    problem : Problem
        The problem.
    options
        Those of `capsyn.subdivide` that are not given by the problem, or override it.

    Raises
    ------
    ProblemError
        Something else than a problem, or what `capsyn.subdivide` refuses.
    """
    if not isinstance(problem, Problem):
        raise ProblemError(f"`problem` must be a capsyn.Problem; got {describe(problem)}")
    own = {
        name: getattr(problem, name)
        for name in ("partitions", "refinement", "max_level", "outside", "name")
    }
    policy = subdivide(label, problem.domain, problem.alphabet, **{**own, **options})
    return dataclasses.replace(
        policy,
        default=problem.default,
        min_dwell=problem.min_dwell,
        target=transcribe_target(problem),
        model=transcribe(problem),
    )
