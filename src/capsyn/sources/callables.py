"""Labelling functions of any controller: NumPy functions, and trained agents with `predict`."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from capsyn.cells.masks import Label
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.problem import Problem
from capsyn.modelling.transcription import transcribe, transcribe_target
from capsyn.policies.policy import Policy
from capsyn.sources.delayed import Answer, delayed
from capsyn.sources.finite_control_set import MADE, FiniteControlSet
from capsyn.subdivision.subdivide import subdivide
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

    `capsyn.subdivide` and `problem_policy` take such a function. `capsyn.compress` and
    `capsyn.agreement` take it as their ``controller``.

    Parameters
    ----------
    controller : callable, or object with a method ``predict``
        A function from observations to actions, or a trained agent. The agent's ``predict`` may
        return a pair of actions and something else, as in Stable-Baselines3. ``predict`` is called
        with ``deterministic=True`` if it takes this argument.
    alphabet : Alphabet
        The symbols.
    actions : "symbols" or "controls"
        What an action is. "symbols" are symbol indices, -1 for the default control. "controls" are
        control vectors (m,), which must equal the control of a symbol.
    batched : bool
        Whether the controller takes many observations (B, ..) at once, or one at a time.
    observation : callable, optional
        A function from states (B, n) to what the controller observes (B, ..). Default: the states.

    Raises
    ------
    ProblemError
        An argument that cannot be used. When called: an action that is no symbol, with its state,
        or actions of another shape. An error of the controller or `observation` becomes its
        ``__cause__``.
    """
    predict = getattr(controller, "predict", None)
    predicts = callable(predict)
    ask = predict if predicts else controller
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
    fixed = {"deterministic": True} if predicts and _takes(ask, "deterministic") else {}
    find = _symbols if actions == "symbols" else _symbols_of_controls

    def act(observed: Any, states: np.ndarray) -> np.ndarray:
        with foreign(f"`controller` failed at {_at(states)}"):
            answer = ask(observed, **fixed)
            return np.asarray(
                answer[0] if predicts and isinstance(answer, tuple) and answer else answer
            )

    def label(states: np.ndarray) -> np.ndarray:
        observed = states.copy()  # what works in place must not move the caller's states
        if observation is not None:
            with foreign(f"`observation` failed at {_at(states)}"):
                observed = observation(observed)
            try:
                got: Any = len(observed)
            except TypeError:
                got = describe(observed)
            if got != len(states):
                raise ProblemError(
                    f"`observation` must return {len(states)} observations; got {got}"
                )
        if batched:
            array = act(observed, states)
        else:
            answers = [act(one, states[k : k + 1]) for k, one in enumerate(observed)]
            same = len({one.shape for one in answers}) < 2
            array = np.asarray(answers) if same else np.zeros(0, dtype=object)
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


@contextlib.contextmanager
def foreign(failed: str) -> Iterator[None]:
    """Make any error of somebody else's code a `ProblemError` in one line, with its cause.

    The line begins with what has `failed`, and where.
    """
    try:
        yield
    except Exception as error:  # it may be any
        reason = one_line(f"{type(error).__name__}: {error}")
        raise ProblemError(f"{failed}: {reason}") from error


def _at(states: np.ndarray) -> str:
    """Return which states (B, n) something was asked for."""
    if not len(states):
        return "no states"
    first = states[0].tolist()
    return f"state {first}" if len(states) == 1 else f"{len(states)} states, the first {first}"


def _takes(function: Callable[..., Any], name: str) -> bool:
    """Return whether a function takes an argument of a name, where that can be known."""
    import inspect

    try:
        return name in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False


def _symbols(actions: np.ndarray, states: np.ndarray, alphabet: Alphabet) -> np.ndarray:
    values = actions[:, 0]
    good = (values >= -1) & (values < len(alphabet)) & (values == np.floor(values))
    if not good.all():
        i = int(np.flatnonzero(~good)[0])
        raise ProblemError(
            f"`controller` must return symbols from -1 to {len(alphabet) - 1}; got {values[i]} at "
            f"state {states[i].tolist()}"
        )
    return values.astype(np.int64)


def _symbols_of_controls(actions: np.ndarray, states: np.ndarray, alphabet: Alphabet) -> np.ndarray:
    symbols, finite = np.full(len(actions), -1), np.isfinite(actions).all(axis=1)
    for symbol in range(len(alphabet) - 1, -1, -1):
        value = alphabet.values[symbol]
        if actions.dtype.kind == "f":  # as a float32 agent writes it
            with np.errstate(over="ignore"):
                value = value.astype(actions.dtype)
        symbols[finite & (actions == value).all(axis=1)] = symbol
    lost = np.flatnonzero(symbols < 0)
    if len(lost):
        i = int(lost[0])
        raise ProblemError(
            f"`controller` must return controls of the alphabet ({', '.join(alphabet.names)}); got "
            f"{actions[i].tolist()} at state {states[i].tolist()}"
        )
    return symbols


def problem_policy(label: Callable[[np.ndarray], Any], problem: Problem, **options: Any) -> Policy:
    """Return the policy of a labelling function for a problem, by Algorithm 1.

    `capsyn.subdivide` makes the policy on the problem's domain and grid. The policy has everything
    of the problem that does not belong to sSAC: model, target, default control, outside rule, dwell
    time, switching and delay. It also has the problem's settings, from which closed loops take the
    sample time; a `FiniteControlSet` has a sample time of its own.

    Parameters
    ----------
    label : callable
        A function from states (B, n) to symbols (B,), such as that of `labels_of`, or a
        `FiniteControlSet`. If the problem has a delay, the function is asked at the states where
        its decision will take effect. These states may be beyond the domain.
    problem : Problem
        The problem. If it has prices on switching or forbidden transitions, the function must
        return symbols for each symbol in force (``in_force=True``). A `FiniteControlSet` of the
        same problem does this.
    options
        Options of `capsyn.subdivide`, which override the problem. Leaves are constant unless an
        option says otherwise, because functions need not give scores.

    Raises
    ------
    ProblemError
        `problem` is no problem, or `capsyn.subdivide` refuses an argument. Or the function cannot
        do what the problem's switching asks for.
    """
    if not isinstance(problem, Problem):
        raise ProblemError(f"`problem` must be a capsyn.Problem; got {describe(problem)}")
    own = {
        name: getattr(problem, name)
        for name in ("partitions", "refinement", "max_level", "outside", "name")
    }
    options = {**own, **options}
    switching, settings, source = problem.switching, problem.settings, dict[str, Any]()
    if isinstance(label, FiniteControlSet):
        switching = label.switching_for(problem)
        settings = dataclasses.replace(settings, sample_time=label.made["sample_time"])
        source = {"source": {MADE: dict(label.made)}}
        if label.in_force > 1:
            label, options = label.masks, {**options, "returns": "masks", "in_force": True}
    elif callable(label):
        in_force = options.get("in_force") is True
        _check_payable(problem, in_force)
        if problem.delay:
            label = delayed(_columns(label, len(problem.alphabet) + 1, in_force), problem)
            options["in_force"] = True
    policy = subdivide(label, problem.space, problem.alphabet, **options)
    return dataclasses.replace(
        policy,
        default=problem.default_control,
        min_dwell=problem.min_dwell,
        time_unit=problem.time_unit,
        outside_at_once=problem.outside_at_once,
        switching=switching,
        delay=problem.delay,
        domain=problem.domain,
        exogenous=problem.exogenous,
        target=transcribe_target(problem),
        model=transcribe(problem),
        settings=settings,
        statistics=policy.statistics | source,
    )


def _check_payable(problem: Problem, in_force: bool) -> None:
    """Raise unless a function can do what the switching of a problem says.

    `in_force` is whether it gives symbols for each symbol in force.
    """
    switching = problem.switching
    if switching is None:
        return
    if in_force and switching.has_share:
        raise ProblemError(
            "`switching` must have a price in numbers for a labelling function; got "
            f"{describe(switching.price)}"
        )
    prices = switching.with_spread(1.0).prices(problem.alphabet, problem.default_control)
    if not in_force and prices.any():
        raise ProblemError(
            "`label` must be a FiniteControlSet of the problem, or give symbols for each symbol in "
            "force (`in_force=True`), where `switching` has prices or forbidden transitions"
        )


def _columns(label: Callable[[np.ndarray], Any], count: int, in_force: bool) -> Answer:
    """Return a labelling function as one of states (B, n) and some of `count` labels in force."""

    def answer(states: np.ndarray, labels: np.ndarray) -> np.ndarray:
        found = np.asarray(label(states))
        if not in_force:
            return np.repeat(found[:, None], len(labels), axis=1)
        if found.shape[1:2] != (count,):
            raise ProblemError(
                f"`label` must return labels for {count} symbols in force, the default's last; got "
                f"shape {found.shape}"
            )
        return found[:, labels]

    return answer
